"""Speeds that somebody else measured (visual odometry, optical flow, radar, a second odometry).

The state holds no speed: the wheels' motion is the filter's input. So speeds are summed up to how far the robot
came between two readings, forward s and turn a, and compared with the pose kept from the reading before (a
"clone", Roumeliotis and Burdick 2002). With d = (-)B (+) p, the pose seen from the kept one,

    s sinc(a / 2) = d_x cos(d_theta / 2) + d_y sin(d_theta / 2) + noise,    a = d_theta + noise

the chord of an arc. Sideways nothing is said.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Literal, cast

import numpy as np

from locfuse.fusion.chi_square import chi_square
from locfuse.fusion.core import tables, twists
from locfuse.fusion.core.room import Room
from locfuse.fusion.data import Array, Colour, Component, Ints, LocfuseError, Measurements, Stream, plausible
from locfuse.fusion.se2 import wrap
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
)
from locfuse.fusion.streams import count_dropped, gap_limit
from locfuse.fusion.wheels.odometry import SPEED

from . import pose as poses
from .pose import plane_covariance

KEPT = "_twist_before"
VARIANCES = ("forward_variance", "turn_variance")  # of way [m^2] and turn [rad^2] since the first reading
FLOOR = (0.001, math.radians(0.02))  # m, rad of one interval: standard deviations that none goes below
WITH_COVARIANCE = ("nav_msgs/msg/Odometry", "geometry_msgs/msg/TwistWithCovarianceStamped")
FORWARD_TURN = (0, 5)  # where linear x and angular z stand in a covariance of ROS


class TwistSettings(SensorSettings, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """[twist]."""

    covariance: Literal["message", "sigma"] = "message"  # "sigma": the keys below, whatever the messages claim
    sigma: float = 0.05  # m/s of one reading, where the messages say nothing
    sigma_turn_deg: float = 2.0  # degrees per s, likewise
    sigma_scale: float = 0.02  # relative error of its scale, taken as noise of every way and turn
    period: float = 0.1  # s: readings are summed up to this, so that their rate costs nothing in the filter

    def __post_init__(self) -> None:
        """Refuse a source without noise."""
        super().__post_init__()
        if self.sigma_turn_deg <= 0.0:
            raise ValueError(f"sigma_turn_deg = {self.sigma_turn_deg}: no sensor is exact, it must be positive")


class Twist(Sensor):
    """Reads forward speeds and turning rates."""

    name = "twist"
    Settings = TwistSettings
    components = (Component("forward", "m"), Component("turn", "deg", math.degrees(1.0)))
    colour = Colour("#5d6b1e", "#b8f07a")
    noise_keys = ("sigma", "sigma_turn_deg")
    extra = True
    asked_only = "speeds may be those of the same wheels, or commands that nobody measured"
    sees = "speed"
    asks: ClassVar[Mapping[str, Ask]] = {
        "sigma": Ask("m/s: where the messages say nothing"),
        "sigma_turn_deg": Ask("degrees per s: where the messages say nothing"),
    }
    reads: ClassVar[Mapping[str, tuple[str, ...]]] = {
        kind: (*fields, "twist.covariance") if kind in WITH_COVARIANCE else fields
        for kind, fields in SPEED.items()
    }

    def measure(self, stream: Stream, settings: TwistSettings, wheels: WheelMotion, epoch_ns: int) -> Measurements:
        """Sum speeds up to z (n, 2): way [m] and turn [rad] since the first one, one row every `period`.

        Raises LocfuseError where no message holds a speed.
        """
        columns = cast("dict[str, Array]", stream.columns(*self.reads[stream.msgtype]))
        speeds = np.stack([np.asarray(columns[name], np.float64) for name in SPEED[stream.msgtype]], axis=-1)
        dropped = dict(stream.dropped)
        keep = _usable(speeds, stream, dropped)
        t = (stream.t_ns[keep] - epoch_ns) * np.float64(1e-9) + settings.time_offset
        sigmas = np.array([settings.sigma, math.radians(settings.sigma_turn_deg)])
        own = np.broadcast_to(sigmas**2, (len(t), 2))
        P, told = plane_covariance(columns.get("twist.covariance"), keep, settings.covariance, own, FORWARD_TURN)
        way, variance, piece = _summed(t, speeds[keep], np.diagonal(P, axis1=1, axis2=2))
        rows = _one_each(t, settings.period)
        n = len(rows)
        R = np.zeros((n, 2, 2))
        R[:, (0, 1), (0, 1)] = np.diff(variance[rows], axis=0, prepend=np.zeros((1, 2)))
        return Measurements(
            t=t[rows],
            first=np.arange(n + 1),
            z=way[rows],
            R_unit=R / settings.sigma**2,
            scale=settings.sigma,
            floor=np.diag([FLOOR[0] ** 2, FLOOR[1] ** 2]),
            extra={
                "piece": piece[rows].astype(np.float64),
                "forward_variance": variance[rows, 0],
                "turn_variance": variance[rows, 1],
                "told": told[rows].astype(np.float64),
            },
            dropped=dropped,
        )

    def heading(self, m: Measurements) -> tuple[Array, Array]:
        """Return times (n,) and headings (n,) [rad, up to a constant and a drift] by its turning rates."""
        return m.t, m.z[:, 1]

    def says_noise(self, m: Measurements) -> bool:
        """Return whether the messages say how good their speeds are: then `sigma` changes nothing."""
        return bool(m.extra["told"].any())

    def model(self, settings: TwistSettings) -> Model:
        """Return the source's side of a new run."""
        return TwistModel(settings)


def _usable(speeds: Array, stream: Stream, dropped: dict[str, int]) -> Ints:
    """Return the rows (k,) that hold speeds at a time of their own; count the others."""
    finite = plausible(speeds).all(axis=1)
    later = np.diff(stream.t_ns, append=np.iinfo(np.int64).max) > 0
    for reason, out in (("not_finite", ~finite), ("repeat", finite & ~later)):
        count_dropped(dropped, reason, int(out.sum()))
    keep = np.flatnonzero(finite & later)
    if not len(keep):
        raise LocfuseError(f"{stream.topic} has no usable speed in {len(speeds)} messages", role="twist")
    if len(keep) > 2 and not speeds[keep].any():
        raise LocfuseError(
            f"{stream.topic} says 0 in all {len(keep)} messages: nobody measures there", role="twist"
        )
    return keep


def _summed(t: Array, speeds: Array, variances: Array) -> tuple[Array, Array, Array]:
    """Return way and turn (n, 2) since the first reading, their variance (n, 2), and the gaps until then (n,).

    By trapezoids; the errors of two readings are independent.
    """
    dt = np.diff(t)
    gap = dt > gap_limit(t)  # over a longer silence nobody knows how far it came
    held = np.where(gap, 0.0, dt)[:, None]
    steps, spread = 0.5 * (speeds[1:] + speeds[:-1]) * held, 0.5 * (variances[1:] + variances[:-1]) * held**2
    zero = np.zeros((1, 2))
    ways, total = (np.concatenate((zero, np.cumsum(part, axis=0))) for part in (steps, spread))
    return ways, total, np.concatenate((np.zeros(1), np.cumsum(gap)))


def _one_each(t: Array, period: float) -> Ints:
    """Return the last reading of every period."""
    cell = np.floor(t / period) if period > 0.0 else t
    return np.flatnonzero(np.append(np.diff(cell) > 0, True))


class TwistModel(Model):
    """Way and turn since the kept pose, in the local frame."""

    local = True

    def __init__(self, settings: TwistSettings) -> None:
        self.scale = settings.sigma_scale**2
        self.threshold = chi_square(settings.gate, 2)
        self._last: int | None = None  # the reading whose pose is kept

    def blocks(self) -> list[Block]:
        """Return the kept pose."""
        return [Block(KEPT, np.zeros(3), np.zeros((3, 3)), np.zeros(3))]

    def innovations(self, m: Measurements, i: int, belief: Any) -> list[Innovation]:
        """Compare way and turn since the last reading with the belief; the first, and one after a gap, begins."""
        last = self._last
        if last is None or m.extra["piece"][i] != m.extra["piece"][last]:
            return []
        way, turn = (m.z[i] - m.z[last]).tolist()
        column, kept = belief.block(KEPT)
        h, H, H_block = _predicted(kept, (belief.x, belief.y, belief.theta))
        core, floor = Room.here(twists).functions, np.diagonal(m.floor).tolist()
        y = (core.straight(way, turn) - h[0], wrap(turn - h[1]))
        rs, ra = (
            core.sum_noise(float(m.extra[name][i] - m.extra[name][last]), self.scale, value, least)
            for name, value, least in zip(VARIANCES, (way, turn), floor, strict=True)
        )
        R, columns = ((rs, 0.0), (0.0, ra)), (column, column + 1, column + 2)
        return [Innovation.of(i, y, H, R, belief, self.threshold, columns=columns, H_block=H_block)]

    @property
    def last(self) -> int | None:
        """The reading whose pose is kept."""
        return self._last

    def keep(self, i: int) -> None:
        """Take in that the pose of reading i was kept."""
        self._last = i

    def columns(self, m: Measurements, when: Ints) -> Columns:
        """Return all readings for the core, which takes them once there is a pose to compare with."""
        return TwistColumns(self, m, when)

    def learn(self, m: Measurements, i: int, belief: Any) -> None:
        """Keep the pose as it is now."""
        belief.clone_pose(belief.block(KEPT)[0])
        self._last = i


def _predicted(kept: Array, pose: Sequence[float]) -> tuple[tuple[float, float], Any, Any]:
    """Return chord [m] and turn [rad] from the kept pose to the pose, and the derivatives by both."""
    room = Room.here(twists)
    out = room.floats(twists.CHORD)
    room.functions.chord(poses.seen_from(kept, pose), out)
    v = room.listed(out, twists.CHORD)
    return (v[0], v[1]), (tuple(v[8:11]), tuple(v[11:])), (tuple(v[2:5]), tuple(v[5:8]))


class TwistColumns(Columns):
    """All ways and turns for the core."""

    kind = "twists"

    def __init__(self, model: TwistModel, m: Measurements, when: Ints) -> None:
        self._model, self.when, self.first = model, when, np.arange(len(when) + 1)
        variance = np.column_stack([m.extra[name] for name in VARIANCES])
        self._of = np.ascontiguousarray(m.z), variance, np.ascontiguousarray(m.extra["piece"])
        self._floor = np.diagonal(m.floor).tolist()
        self.told, self.joint = untold(len(m.z), 2), np.zeros((0, 2))

    @property
    def ready(self) -> bool:
        """Whether a pose is kept."""
        return self._model.last is not None

    def table(self, belief: Any) -> Any:
        """Return the readings, and the states of the kept pose."""
        model = self._model
        return Room.here(tables).on_arrays.Twists(
            self.when, *self._of, self.told, belief.block(KEPT)[0], model.scale, *self._floor, model.threshold,
            float(GATE), model.last or 0, len(self.when), 0,
        )  # fmt: skip

    def passed(self, first: int, last: int) -> None:
        """Take in which pose is kept now."""
        if last > first:
            self._model.keep(last - 1)
