"""GPS: positions on the earth, tied to the map by a place and a direction: states, where they are not given.

With R = [[cos e, sin e], [-sin e, cos e]], e the direction of east in the map, the fix of an antenna at p is

    (east, north) = R (p - p_ref) + (c, d) + noise

Nobody knows e at the start, and a filter must not be linearised about a direction that may be anything. So while e
is unknown the state holds a = cos e and b = sin e, in which the fix is linear: any direction is found without a
guess. Once e is known to ten degrees it takes their place, and a^2 + b^2 = 1 is said once.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar, cast

import numpy as np
from numpy.typing import NDArray

from locfuse.fusion import se2
from locfuse.fusion.chi_square import chi_square
from locfuse.fusion.core import fixes as core
from locfuse.fusion.core import tables
from locfuse.fusion.core.room import Room
from locfuse.fusion.data import (
    Array,
    Colour,
    Component,
    Ints,
    LocfuseError,
    Measurements,
    Ragged,
    Stream,
    plausible,
)
from locfuse.fusion.geodesy import east_north
from locfuse.fusion.mount import ASK_MOUNT
from locfuse.fusion.sensor import (
    GATE,
    Ask,
    Block,
    Columns,
    Innovation,
    Model,
    Sensor,
    SensorSettings,
    WheelMotion,
    untold,
    upper,
)
from locfuse.fusion.streams import count_dropped

FRAME = "_gps_frame"
WIDE = 100.0  # m: how far the first fix may be from where the robot was
MAX_KNOWN_DIRECTION_RAD = math.radians(10.0)  # from here on the direction of east is a state of its own
LENGTH = 1e-4  # how well a^2 + b^2 = 1 is said
OF_GPSD = ("gps_common/msg/GPSFix", "gps_msgs/msg/GPSFix")  # drivers publish the same fixes as NavSatFix
MIN_SIGMA_M = 1e-3  # m, of a standard deviation

Rows = tuple[tuple[float, float, float], ...]
Geographic = tuple[float, float]


class GpsSettings(SensorSettings, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """[gps]."""

    origin: Geographic | None = None  # latitude, longitude [deg] of the map's origin; None: estimated
    east_deg: float | None = None  # where east lies in the map, counter-clockwise from its x axis; None: estimated
    x: float = 0.0  # m, antenna on the base
    y: float = 0.0
    sigma: float = 1.5  # m per axis, where the receiver does not say


class Gps(Sensor):
    """Reads NavSatFix, GPSFix and Foxglove's LocationFix."""

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
            (
                "status.status",
                "latitude",
                "longitude",
                "position_covariance",
                "position_covariance_type",
            ),
        ),
        **dict.fromkeys(
            ("foxglove.LocationFix", "foxglove_msgs/msg/LocationFix"),
            ("latitude", "longitude", "position_covariance", "position_covariance_type"),
        ),
    }

    def measure(self, stream: Stream, settings: GpsSettings, wheels: WheelMotion, epoch_ns: int) -> Measurements:
        """Turn fixes into z (n, 2) metres east and north of the origin, or of the first fix."""
        columns = cast("dict[str, Array]", stream.columns(*self.reads[stream.msgtype]))
        where = np.column_stack((columns["latitude"], columns["longitude"])).astype(np.float64)
        dropped = dict(stream.dropped)
        good = _usable(where, columns.get("status.status"), dropped)
        if not good.any():
            reasons = ", ".join(f"{n} {why.replace('_', ' ')}" for why, n in dropped.items())
            raise LocfuseError(
                f"{stream.topic} has no fix in {len(good)} messages ({reasons or 'none'})", role="gps"
            )
        where = where[good]
        origin = settings.origin or (float(where[0, 0]), float(where[0, 1]))
        n = len(where)
        t: Array = (stream.t_ns - epoch_ns) * np.float64(1e-9) + settings.time_offset
        return Measurements(
            t=t[good],
            first=np.arange(n + 1),
            z=east_north(where[:, 0], where[:, 1], origin),
            R_unit=_covariance(columns, settings.sigma)[good] / settings.sigma**2,
            scale=settings.sigma,
            floor=np.zeros((2, 2)),
            dropped=dropped,
        )

    def mount(self, settings: GpsSettings) -> tuple[float, float, float]:
        """Return where the antenna sits on the base: x [m], y [m], and no yaw."""
        return settings.x, settings.y, 0.0

    def says_noise(self, m: Measurements) -> bool:
        """Return whether the receiver says how good its fixes are: then `sigma` changes nothing."""
        return bool((m.R_unit != np.eye(2)).any())

    def model(self, settings: GpsSettings) -> Model:
        """Return the GPS' side of a new run."""
        return GpsModel(settings)


def _usable(where: Array, status: Array | None, dropped: dict[str, int]) -> NDArray[np.bool_]:
    """Return which fixes (n,) are fixes; count the others."""
    finite = plausible(where).all(axis=1)
    fixed = finite if status is None else finite & (np.asarray(status) >= 0)
    real: NDArray[np.bool_] = fixed & (np.abs(where[:, 0]) <= 90.0) & (where != 0.0).any(axis=1)
    for reason, n in (("not_finite", ~finite), ("no_fix", finite & ~fixed), ("nowhere", fixed & ~real)):
        count_dropped(dropped, reason, int(n.sum()))
    return real


def _covariance(columns: Mapping[str, Any], sigma: float) -> Array:
    """Return the covariance of (east, north), (n, 2, 2): the receiver's where it says one, else sigma^2."""
    matrix = _nine(columns["position_covariance"])
    own = matrix[:, [0, 1, 3, 4]].reshape(-1, 2, 2)
    told = np.asarray(columns["position_covariance_type"]) > 0
    told &= (own[:, 0, 0] > MIN_SIGMA_M**2) & (own[:, 1, 1] > MIN_SIGMA_M**2) & np.isfinite(own).all(axis=(1, 2))
    told &= np.linalg.det(np.where(told[:, None, None], own, np.eye(2))) > 0.0
    return np.where(told[:, None, None], 0.5 * (own + own.transpose(0, 2, 1)), sigma**2 * np.eye(2))


def _nine(column: Array | Ragged) -> Array:
    """Return covariances as (n, 9); one of another length, as JSON may hold, is none: zeros."""
    if isinstance(column, np.ndarray):
        return column.astype(np.float64).reshape(-1, 9)
    whole = column.lengths == 9
    matrix = np.zeros((len(column), 9))
    matrix[whole] = column.values[column.first[:-1][whole][:, None] + np.arange(9)]
    return matrix


class GpsModel(Model):
    """(east, north) = R(e) (p - p_ref) + (c, d) + noise; four states: a, b, c, d, later e, |(a, b)|, c, d."""

    def __init__(self, settings: GpsSettings) -> None:
        self.settings = settings
        self.threshold = chi_square(settings.gate, 2)
        self.lever = (settings.x, settings.y)
        self.known = settings.east_deg is not None  # whether the direction of east is a state of its own
        self.tie = (math.radians(settings.east_deg or 0.0), 1.0, 0.0, 0.0)  # at the start
        self.fixed = self.known and settings.origin is not None
        self.reference: tuple[float, float] | None = (0.0, 0.0) if settings.origin is not None else None

    def blocks(self) -> list[Block]:
        """Return the tie between map and earth as states, unless place and direction are given."""
        if self.fixed:
            return []
        place = 0.0 if self.settings.origin is not None else WIDE**2
        x = np.array(self.tie) if self.known else np.zeros(4)
        # a and b of a direction that may be anything have mean 0 and variance 1/2
        direction = 0.0 if self.known else 0.5
        return [Block(FRAME, x, np.diag([direction, direction, place, place]), np.zeros(4))]

    def columns(self, m: Measurements, when: Ints) -> Columns:
        """Return all fixes for the core, which takes them once the direction of east is known."""
        return FixColumns(self, m, when)

    def innovations(self, m: Measurements, i: int, belief: Any) -> list[Innovation]:
        """Compare one fix with the belief."""
        h, H, columns, H_block = self._predicted(belief)
        z = m.z[i]
        y = (float(z[0]) - h[0], float(z[1]) - h[1])
        (r00, r01), (_, r11) = m.R[i].tolist()
        R = ((r00, r01), (r01, r11))
        return [Innovation.of(i, y, H, R, belief, self.threshold, columns=columns, H_block=H_block)]

    def _predicted(
        self, belief: Any
    ) -> tuple[tuple[float, float], Rows, tuple[int, ...], tuple[tuple[float, ...], ...]]:
        """Return the fix as predicted, its derivative by the pose, and by the states of the tie."""
        room, pose = Room.here(core), (belief.x, belief.y, belief.theta)
        if self.reference is None:
            x, y = se2.transform(np.array(pose), np.array(self.lever)).tolist()
            self.reference = (x, y)
        columns: tuple[int, ...] = ()
        tie = self.tie
        if not self.fixed:
            first, now = belief.block(FRAME)
            columns, tie = (first, first + 1, first + 2, first + 3), tuple(now.tolist())
        out = room.floats(core.FIX)
        room.functions.fix(*pose, *self.lever, *self.reference, room.flat((tie,)), self.known, out)
        v = room.listed(out, core.FIX)
        H = ((v[2], v[3], v[4]), (v[5], v[6], v[7]))
        H_block = () if self.fixed else (tuple(v[8:12]), tuple(v[12:]))
        return (v[0], v[1]), H, columns, H_block

    def learn(self, m: Measurements, i: int, belief: Any) -> None:
        """Let the direction of east become a state of its own once it is known well enough."""
        if self.known:
            return
        first, now = belief.block(FRAME)
        columns = np.arange(first, first + 4)
        P = belief.covariance[np.ix_(columns, columns)]
        a, b = float(now[0]), float(now[1])
        length = math.hypot(a, b)
        if length < 0.5:
            return
        G = np.eye(4)
        G[0, :2], G[1, :2] = (-b / length**2, a / length**2), (a / length, b / length)
        if float(G[0] @ P @ G[0]) > MAX_KNOWN_DIRECTION_RAD**2:
            return
        belief.transform(columns, np.array([math.atan2(b, a), length, now[2], now[3]]), G)
        belief.correct([Innovation.of_states((1.0 - length,), ((LENGTH**2,),), (first + 1,), ((1.0,),))])
        self.known = True

    def notes(self, belief: Any) -> list[str]:
        """Say where east was found to lie."""
        if self.fixed or self.settings.east_deg is not None:
            return []
        if not self.known:
            return ["the drive was too short to tell where east lies; fixes hardly counted (gps.east_deg)"]
        first, now = belief.block(FRAME)
        east = math.degrees(float(now[0]))
        sigma = math.degrees(math.sqrt(max(float(belief.covariance[first, first]), 0.0)))
        return [f"east lies {east:.1f} deg (1 sigma: {sigma:.1f}) from the map's x axis (gps.east_deg)"]


class FixColumns(Columns):
    """All fixes for the core, where they are linear enough: the direction of east is known."""

    kind = "fixes"

    def __init__(self, model: GpsModel, m: Measurements, when: Ints) -> None:
        self._model, self.when, self.first = model, when, np.arange(len(when) + 1)
        self._z, self._R = np.ascontiguousarray(m.z), upper(m.covariances(slice(None)))
        self.told, self.joint = untold(len(m.z), 2), np.zeros((0, 2))

    @property
    def ready(self) -> bool:
        """Whether the first fix was seen, and where east lies is a state or given."""
        return self._model.known and self._model.reference is not None

    def table(self, belief: Any) -> Any:
        """Return the fixes, the antenna and the tie to the map."""
        model = self._model
        at = -1 if model.fixed else belief.block(FRAME)[0]
        return Room.here(tables).on_arrays.Fixes(
            self.when, self._z, self._R, self.told, *model.lever, *(model.reference or (0.0, 0.0)),
            np.array(model.tie), at, model.known, model.threshold, float(GATE), len(self.when), 0,
        )  # fmt: skip
