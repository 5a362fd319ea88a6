"""Sonar: compares the measured distance with that of the nearest mapped wall (laser's line map) in its cone.

A smooth wall reflects sound back only where it is perpendicular to a ray of the cone. So an echo measures the
distance to a wall whose foot point (of the perpendicular from the sonar) lies within the cone and on the wall; no
other mapped wall may be nearer. Objects that are not in the map return echoes too, anywhere before the wall. An
echo is assigned to the wall only if that is more likely.

With the sonar at p and the wall n.(q - a) = rho, the distance is C = rho - n.(p - a) (paper eq. 17 without its
sign).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import msgspec
import numpy as np

from locfuse.fusion.data import Colour, Component, Measurements, RowVerdict, Stream, totals
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.kernels.ekf import Innovation
from locfuse.fusion.mount import ASK_MOUNT
from locfuse.fusion.se2 import wrap
from locfuse.fusion.sensor import Ask, Model, Sensor, SensorSettings, WheelMotion
from locfuse.fusion.statistics import chi_square
from locfuse.fusion.streams import MergedStream, arrays, count_dropped, parts_of, seconds

if TYPE_CHECKING:
    from locfuse.fusion.map.line_map import LineMap

CLUTTER_SHARE = 0.25  # share of echoes from unmapped objects, anywhere before the wall
Mount = tuple[float, float, float]
MAX_OVERHANG_M = 0.05  # m that a wall may extend beyond its seen part
CLEAR_SIGMAS = 3.0  # standard deviations: no prediction if another wall is nearer than the echo by more
MIN_SLOPE = 1e-6  # least cosine at which an edge of the cone meets a wall


class SonarSettings(SensorSettings, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Settings of [sonar] in robot.toml: one or several ultrasonic rangers, treated as one sensor."""

    topics: tuple[str, ...] = ()  # none: all topics of the type
    mounts: dict[str, Mount] = msgspec.field(default_factory=dict)  # topic -> x [m], y [m], yaw [deg] on the base
    sigma: float = 0.03  # m
    widen_deg: float = 3.0  # degrees by which the cone is widened on each side, since the heading is not exact


class Sonar(Sensor):
    """Ultrasonic rangers: read Range messages."""

    name = "sonar"
    locates = True
    Settings = SonarSettings
    components = (Component("distance", "m"),)
    colour = Colour("#a93fc6", "#ec92fd")
    noise_keys = ("sigma",)
    extra = True
    several = True
    needs: ClassVar[Mapping[str, str]] = {"lrf": "held against the map of lrf"}
    placed = True
    sees = "echo"
    asks: ClassVar[Mapping[str, Ask]] = {
        "mounts": Ask(f'{{ "/topic" = [m, m, degrees] }}: {ASK_MOUNT}', blank=True)
    }
    reads: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "sensor_msgs/msg/Range": ("field_of_view", "min_range", "max_range", "range")
    }

    def measure(self, stream: Stream, settings: SonarSettings, wheels: WheelMotion, epoch_ns: int) -> Measurements:
        """Measure distances z (m, 1) [m]; a reading without an echo has no row."""
        columns = arrays(stream, *self.reads[stream.msgtype])
        distance = columns["range"].astype(np.float64)
        t = seconds(stream.t_ns, epoch_ns, settings.time_offset)
        known = ~np.isnan(distance)
        dropped = dict(stream.dropped)
        count_dropped(dropped, not_finite=~known)
        # a value at the end of the range means that there was no echo (inf by REP 117, max_range from old drivers)
        echo = (distance > columns["min_range"]) & (distance < columns["max_range"]) & np.isfinite(distance)
        rows = np.flatnonzero(known & echo)
        places = np.array([settings.mounts.get(part.topic, (0.0, 0.0, 0.0)) for part in parts_of(stream)])
        mounts = places[stream.source[rows] if isinstance(stream, MergedStream) else np.zeros_like(rows)]
        return Measurements(
            t=t[known],
            first=totals(echo[known], np.int64),
            z=distance[rows, None],
            R_unit=np.ones((len(rows), 1, 1)),
            scale=settings.sigma,
            floor=np.zeros((1, 1)),
            extra={
                "x": mounts[:, 0],
                "y": mounts[:, 1],
                "yaw": np.radians(mounts[:, 2]),
                "half": 0.5 * columns["field_of_view"].astype(np.float64)[rows],
            },
            dropped=dropped,
        )

    def model(self, settings: SonarSettings) -> Model:
        """Return the filter model of the rangers for a new run."""
        return SonarModel(settings)


class SonarModel(Model):
    """Model of an echo: distance z = C + noise, with C the distance to the mapped wall that should reflect it."""

    teaches = False
    local = True

    def __init__(self, settings: SonarSettings) -> None:
        self.threshold = chi_square(settings.gate, 1)
        self.widen = math.radians(settings.widen_deg)
        self._laser: Any = None  # the laser's model, whose line map is read

    def meet(self, others: Mapping[str, Model]) -> None:
        """Link the laser's model, whose line map the echoes are compared with."""
        self._laser = others.get("lrf")

    def innovations(self, m: Measurements, i: int, belief: Any) -> list[Innovation]:
        """Return the innovation of one echo, compared with the nearest mapped wall in the sonar's cone."""
        plain = m.plain
        row = plain["first"][i]
        lines = None if self._laser is None else self._laser.map
        if row == plain["first"][i + 1] or lines is None or len(lines) == 0:
            return []
        cone = Cone(plain["x"][row], plain["y"][row], plain["yaw"][row], plain["half"][row], self.widen)
        z, variances = m.scalars
        echo = nearest_echo(lines, belief, cone, math.sqrt(variances[row]))
        if echo is None:
            return [Innovation.unpredicted(row, RowVerdict.UNMATCHED, 1, self.threshold)]
        y, R = z[row] - echo.distance, ((variances[row] + echo.map_variance,),)
        seen = belief.compare(row, (y,), echo.H, R, self.threshold, echo.columns, echo.H_block)
        seen.landmark = echo.line
        seen.threshold = min(self.threshold, likelier(echo.distance, seen.sigma[0]))
        seen.verdict = 0 if seen.nis <= seen.threshold else RowVerdict.GATE
        return [seen]


def likelier(distance: float, sigma: float) -> float:
    """Return the NIS below which an echo is more likely from the wall than from clutter; 0 if it never is.

    `distance` [m] is the predicted distance of the wall, `sigma` [m] the standard deviation of the echo. Clutter
    is anywhere before the wall.
    """
    odds = (1.0 - CLUTTER_SHARE) / CLUTTER_SHARE * distance / (math.sqrt(math.tau) * sigma)
    return 2.0 * math.log(odds) if odds > 1.0 else 0.0


# ---- the wall that returns the echo, its distance, and the derivatives of the distance ----


class Cone(NamedTuple):
    """Mount of a sonar on the base, and the opening angle of its cone."""

    x: float  # m
    y: float
    yaw: float  # rad
    half: float  # rad, half of the opening angle
    widen: float  # rad, added to `half` for walls perpendicular to a ray just outside the cone


class Echo(NamedTuple):
    """Predicted echo: distance, wall and derivatives."""

    distance: float  # m, predicted
    line: int  # id in the map
    H: tuple[tuple[float, float, float], ...]  # (1, 3) derivative by the pose
    columns: tuple[int, ...]  # state columns of the wall; empty if the wall is not a state
    H_block: tuple[tuple[float, ...], ...]  # (1, 2) derivative by (rho, beta)
    map_variance: float  # m^2, variance of the distance by a wall that is not a state


def nearest_echo(lines: LineMap, belief: JointBelief, cone: Cone, sigma: float) -> Echo | None:
    """Predict the echo of the nearest wall perpendicular to a ray; None if there is none, or it is occluded."""
    px, py, theta = belief.pose()
    if not math.isfinite(theta):
        return None
    c, s = math.cos(theta), math.sin(theta)
    lever_x, lever_y = c * cone.x - s * cone.y, s * cone.x + c * cone.y
    half = max(min(cone.half, math.pi), 0.0)  # the value of a message may be invalid
    axis, widest = theta + cone.yaw, half + cone.widen
    rho, beta = lines.values(belief).T
    with np.errstate(invalid="ignore"):  # an infinite beta gives NaN, which returns no echo
        n_x, n_y = np.cos(beta), np.sin(beta)
    dx, dy = px + lever_x - lines.anchor[:, 0], py + lever_y - lines.anchor[:, 1]
    distance, foot = rho - dx * n_x - dy * n_y, dy * n_x - dx * n_y
    perpendicular = math.cos(axis) * n_x + math.sin(axis) * n_y >= (math.cos(widest) if widest < math.pi else -2.0)
    perpendicular &= (lines.lo - MAX_OVERHANG_M <= foot) & (foot <= lines.hi + MAX_OVERHANG_M)
    ahead = distance > 0.0
    echoing = (perpendicular & ahead).nonzero()[0]
    if not len(echoing):
        return None
    j = int(echoing[distance[echoing].argmin()])
    nearest = distance.item(j)
    clear = nearest - CLEAR_SIGMAS * sigma
    # a wall met at an angle is at least as far as its perpendicular distance
    for k in ((distance < clear) & ahead & ~perpendicular).nonzero()[0].tolist():
        ends, off = (lines.lo.item(k), lines.hi.item(k)), wrap(beta.item(k) - axis)
        if _oblique_range(distance.item(k), foot.item(k), off, half, ends) < clear:
            return None
    by_x, by_y, u = -n_x.item(j), -n_y.item(j), -foot.item(j)
    H = ((by_x, by_y, by_y * lever_x - by_x * lever_y),)
    column = lines.column.item(j)
    if column >= 0:
        return Echo(nearest, lines.ids.item(j), H, (column, column + 1), ((1.0, u),), 0.0)
    (rr, rb), (_, bb) = lines.P[j].tolist()
    return Echo(nearest, lines.ids.item(j), H, (), (), rr + u * (2.0 * rb + u * bb))


def _oblique_range(distance: float, foot: float, off: float, half: float, ends: tuple[float, float]) -> float:
    """Return the distance [m] of the nearest point of a wall among edge points and ends; inf if there are none.

    Edge points are the intersections of the wall with both edges of the cone; ends count if they are in the cone.
    The perpendicular from the sonar has the length `distance` [m], meets the wall at `foot` [m along it], and its
    direction differs from the cone's axis by `off` [rad]. `half` [rad] is half the opening angle; `ends` [m] are
    the wall's ends along it.
    """
    nearest = math.inf
    for edge, end in ((-half, ends[0]), (half, ends[1])):
        slope = math.cos(off - edge)
        if slope > MIN_SLOPE and ends[0] <= foot + distance * math.tan(edge - off) <= ends[1]:
            nearest = min(nearest, distance / slope)
        along = end - foot
        if abs(wrap(math.atan2(along, distance) + off)) <= half:
            nearest = min(nearest, math.sqrt(distance * distance + along * along))
    return nearest
