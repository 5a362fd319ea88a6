"""GPS: positions in east and north; offset and rotation from the map frame are states unless configured.

With R = [[cos e, sin e], [-sin e, cos e]], e the direction of east in the map, the fix of an antenna at p is

    (east, north) = R (p - p_ref) + (c, d) + noise

At the start the direction e is unknown, so a linearisation about a guess of e would be wrong. Therefore the states
are a = cos e and b = sin e at first: the fix is linear in them, and any direction is found without a guess. Once
the sigma of e is below ten degrees, e replaces them, and the constraint a^2 + b^2 = 1 is used once.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Colour, Component, LocfuseError, Measurements, Stream, plausible
from locfuse.fusion.geodesy import on_map
from locfuse.fusion.kernels.ekf import Innovation
from locfuse.fusion.lines.scans import frozen
from locfuse.fusion.mount import ASK_MOUNT
from locfuse.fusion.sensor import (
    NO_BLOCK,
    NO_COLUMNS,
    Ask,
    Block,
    Matrix,
    Model,
    PoseRows,
    Sensor,
    SensorSettings,
    WheelMotion,
)
from locfuse.fusion.statistics import chi_square
from locfuse.fusion.streams import arrays, count_dropped, seconds

from .points import detector_at, spread_in_other_frame

FRAME = "_gps_frame"
FIRST_FIX_SIGMA_M = 100.0  # m, 1 sigma of the error of the first fix
MAX_KNOWN_DIRECTION_RAD = math.radians(10.0)  # 1 sigma, below which the direction of east becomes one angle
UNIT_LENGTH_SIGMA = 1e-4  # standard deviation of the constraint |(a, b)| = 1
OF_GPSD = ("gps_common/msg/GPSFix", "gps_msgs/msg/GPSFix")  # drivers also publish these fixes as NavSatFix
MIN_SIGMA_M = 1e-3  # m, of a standard deviation
DEGREE_M, MAX_DIGIT_STEPS = 111_320.0, 2.0  # m per degree at the equator; steps of the last digit on one fix

Tie = tuple[float, float, float, float]
Geographic = tuple[float, float]


class GpsSettings(SensorSettings, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Settings of [gps] in robot.toml."""

    origin: Geographic | None = None  # latitude, longitude [deg] of the map's origin; not set: estimated
    east_deg: float | None = None  # where east lies in the map, ccw from its x axis; not set: estimated
    x: float = 0.0  # m, antenna on the base
    y: float = 0.0  # m, likewise
    covariance: Literal["message", "sigma"] = "message"  # "sigma": the key below, whatever the receiver claims
    sigma: float = 1.5  # m per axis, if the receiver reports no covariance


class Gps(Sensor):
    """The GPS receiver: reads NavSatFix, GPSFix and Foxglove's LocationFix."""

    name = "gps"
    locates = True
    Settings = GpsSettings
    components = (Component("east", "m"), Component("north", "m"))
    colour = Colour("#4f3510", "#7d7a3c")
    noise_keys = ("sigma",)
    extra = True
    second_best = OF_GPSD
    asks: ClassVar[Mapping[str, Ask]] = {
        **dict.fromkeys(("x", "y"), Ask(f"m: {ASK_MOUNT}", blank=True)),
        "origin": Ask("[latitude, longitude] of the map's origin; left out, estimated"),
        "sigma": Ask("m: where the receiver does not say"),
    }
    reads: ClassVar[Mapping[str, tuple[str, ...]]] = {
        **dict.fromkeys(
            ("sensor_msgs/msg/NavSatFix", *OF_GPSD),
            ("status.status", "latitude", "longitude", "position_covariance", "position_covariance_type"),
        ),
        **dict.fromkeys(
            ("foxglove.LocationFix", "foxglove_msgs/msg/LocationFix"),
            ("latitude", "longitude", "position_covariance", "position_covariance_type"),
        ),
    }

    def measure(self, stream: Stream, settings: GpsSettings, wheels: WheelMotion, epoch_ns: int) -> Measurements:
        """Measure positions z (n, 2) [m]: east and north of the configured origin, else of the first fix."""
        columns = arrays(stream, *self.reads[stream.msgtype])
        where = np.column_stack((columns["latitude"], columns["longitude"])).astype(np.float64)
        dropped = dict(stream.dropped)
        t = seconds(stream.t_ns, epoch_ns, settings.time_offset)
        good = _usable(where, columns.get("status.status"), dropped)
        if not good.any():
            reasons = ", ".join(f"{n} {why.replace('_', ' ')}" for why, n in dropped.items())
            words = f"{stream.topic} has no fix in {len(good)} messages ({reasons or 'none'})"
            raise LocfuseError(words, role="gps")
        held = _held(where[good], t[good], wheels)
        count_dropped(dropped, repeat=held)
        good[good] = ~held
        where = where[good]
        n = len(where)
        return Measurements(
            t=t[good],
            first=np.arange(n + 1),
            z=on_map(where, settings.origin, "gps"),
            R_unit=_covariance(columns, settings)[good] / settings.sigma**2,
            scale=settings.sigma,
            floor=np.zeros((2, 2)),
            dropped=dropped,
        )

    def brings_covariance(self, m: Measurements) -> bool:
        """Return whether the receiver reports covariances, which replace the setting `sigma`."""
        return bool((m.R_unit != np.eye(2)).any())

    def misfit(self, m: Measurements, settings: GpsSettings, poses: Array) -> float | None:
        """Return the spread [m] of the fixes about poses (n, 3), with any antenna and direction of east."""
        return spread_in_other_frame(m.z, poses)

    def model(self, settings: GpsSettings) -> Model:
        """Return the filter model of the GPS receiver for a new run."""
        return GpsModel(settings)


def _usable(where: Array, status: Array | None, dropped: dict[str, int]) -> NDArray[np.bool_]:
    """Return which messages (n,) hold a valid fix; count the others in `dropped` by reason."""
    finite = plausible(where).all(axis=1)
    fixed = finite if status is None else finite & (np.asarray(status) >= 0)
    real: NDArray[np.bool_] = fixed & (np.abs(where[:, 0]) <= 90.0) & (where != 0.0).any(axis=1)
    count_dropped(dropped, not_finite=~finite, no_fix=finite & ~fixed, nowhere=fixed & ~real)
    return real


def _held(where: Array, t: Array, wheels: WheelMotion) -> NDArray[np.bool_]:
    """Return which fixes (n, 2) [deg] at times t (n,) [s] repeat the last one while the robot drives on."""
    steps = np.abs(np.diff(where, axis=0))
    # fixes with few digits repeat too, within a step of these digits
    digits = np.where(steps > 0.0, steps, np.inf).min(axis=0, initial=np.inf)
    coarse = MAX_DIGIT_STEPS * DEGREE_M * math.hypot(*np.where(np.isfinite(digits), digits, 0.0))
    return frozen(np.append(False, ~steps.any(axis=1)), t, wheels, coarse, math.inf)


def _covariance(columns: Mapping[str, Any], settings: GpsSettings) -> Array:
    """Return covariances of (east, north), (n, 2, 2) [m^2]: the receiver's if valid and wanted, else sigma^2 I."""
    column = columns["position_covariance"]
    if isinstance(column, np.ndarray):
        matrix = column.astype(np.float64).reshape(-1, 9)
    else:  # from JSON: zeros where a message has not 9 numbers
        whole, matrix = column.lengths == 9, np.zeros((len(column), 9))
        matrix[whole] = column.values[column.first[:-1][whole][:, None] + np.arange(9)]
    own = matrix[:, [0, 1, 3, 4]].reshape(-1, 2, 2)
    known = (np.asarray(columns["position_covariance_type"]) > 0) & (settings.covariance == "message")
    known &= (own[:, 0, 0] > MIN_SIGMA_M**2) & (own[:, 1, 1] > MIN_SIGMA_M**2) & np.isfinite(own).all(axis=(1, 2))
    known &= np.linalg.det(np.where(known[:, None, None], own, np.eye(2))) > 0.0
    return np.where(known[:, None, None], se2.symmetric(own), settings.sigma**2 * np.eye(2))


def fix(
    pose: se2.Plain, lever: tuple[float, float], reference: tuple[float, float], tie: Tie, known: bool
) -> tuple[tuple[float, float], PoseRows, Matrix]:
    """Return the antenna's (east, north) [m], and derivatives by the pose (2, 3) and by the states `tie` (2, 4).

    (east, north) = R (p - p_ref) + (c, d), with p = (x, y) + R(theta) lever and `reference` p_ref, both [m, map].
    `tie` has the four states of the transform from map to earth: (cos e, sin e, c, d), in which the fix is linear,
    or (e, 1, c, d) if the direction e is `known`.
    """
    (x, y, theta), (a, b, east, north) = pose, tie
    if known:
        a, b = se2.direction(a)
    c, s = se2.direction(theta)
    lever_x, lever_y = c * lever[0] - s * lever[1], s * lever[0] + c * lever[1]
    dx, dy = x + lever_x - reference[0], y + lever_y - reference[1]
    to_east, to_north = a * dx + b * dy, a * dy - b * dx
    by_pose = (a, b, b * lever_x - a * lever_y), (-b, a, b * lever_y + a * lever_x)
    by_tie = (dx, dy, 1.0, 0.0), (dy, -dx, 0.0, 1.0)
    if known:
        by_tie = (to_north, 0.0, 1.0, 0.0), (-to_east, 0.0, 0.0, 1.0)
    return (to_east + east, to_north + north), by_pose, by_tie


class GpsModel(Model):
    """(east, north) = R(e) (p - p_ref) + (c, d) + noise, with antenna p and direction e of east in the map.

    There are four states: (a, b, c, d) until the direction is known, then (e, |(a, b)|, c, d).
    """

    def __init__(self, settings: GpsSettings) -> None:
        self.settings = settings
        self.threshold = chi_square(settings.gate, 2)
        self.lever = (settings.x, settings.y)
        self.known = settings.east_deg is not None  # whether the first state is the angle e, not cos e
        self.tie = (math.radians(settings.east_deg or 0.0), 1.0, 0.0, 0.0)  # initial states if e is known
        self.fixed = self.known and settings.origin is not None
        self.reference: tuple[float, float] | None = (0.0, 0.0) if settings.origin is not None else None

    def blocks(self) -> list[Block]:
        """Return the states of the transform from map to earth; empty if origin and east direction are given."""
        if self.fixed:
            return []
        place = 0.0 if self.settings.origin is not None else FIRST_FIX_SIGMA_M**2
        x = np.array(self.tie) if self.known else np.zeros(4)
        # for an unknown direction, a and b have mean 0 and variance 1/2
        direction = 0.0 if self.known else 0.5
        return [Block(FRAME, x, np.diag([direction, direction, place, place]), np.zeros(4))]

    def innovations(self, m: Measurements, i: int, belief: Any) -> list[Innovation]:
        """Return the innovation of fix i, (east, north) [m]."""
        pose = belief.pose()
        if self.reference is None:
            self.reference = detector_at(pose, (*self.lever, 0.0))
        tie, columns = self.tie, NO_COLUMNS
        if not self.fixed:
            first = belief.column(FRAME)
            columns = (first, first + 1, first + 2, first + 3)
            tie = belief.value(first), belief.value(first + 1), belief.value(first + 2), belief.value(first + 3)
        (east, north), H, H_block = fix(pose, self.lever, self.reference, tie, self.known)
        z, noise = m.plain["z"], m.plain["R"]
        y = z[i, 0] - east, z[i, 1] - north
        R = (noise[i, 0, 0], noise[i, 0, 1]), (noise[i, 0, 1], noise[i, 1, 1])
        return [belief.compare(i, y, H, R, self.threshold, columns, H_block if columns else NO_BLOCK)]

    def learn(self, m: Measurements, i: int, belief: Any) -> None:
        """Replace the states (cos e, sin e) by the angle e when its standard deviation is below 10 degrees."""
        if self.known:
            return
        first = belief.column(FRAME)
        a, b = belief.value(first), belief.value(first + 1)
        length = math.hypot(a, b)
        if length < 0.5:
            return
        by_a, by_b = -b / length**2, a / length**2
        if belief.variance((0.0, 0.0, 0.0), (first, first + 1), (by_a, by_b)) > MAX_KNOWN_DIRECTION_RAD**2:
            return
        G = (by_a, by_b), (a / length, b / length)
        belief.transform((first, first + 1), (math.atan2(b, a), length), G)
        belief.know((1.0 - length,), ((UNIT_LENGTH_SIGMA**2,),), (first + 1,), ((1.0,),))
        self.known = True

    def notes(self, belief: Any) -> list[str]:
        """Return a note with the estimated direction of east and its standard deviation."""
        if self.fixed or self.settings.east_deg is not None:
            return []
        if not self.known:
            return ["the drive was too short to tell where east lies; fixes hardly counted (gps.east_deg)"]
        first, now = belief.block(FRAME)
        east = math.degrees(float(now[0]))
        sigma = math.degrees(math.sqrt(max(float(belief.covariance[first, first]), 0.0)))
        return [f"east lies {east:.1f} deg (1 sigma: {sigma:.1f}) from the map's x axis (gps.east_deg)"]
