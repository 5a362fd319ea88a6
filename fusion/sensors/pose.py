"""Poses that somebody else estimated (visual odometry, AMCL, UWB, scan matching) as measurements.

Whose frame a pose is given in decides what it can say (`frame`):

- "map": the map of this run. z = p + noise.
- "own": a frame of the source's own, which stands still in the map. Where it lies is found with the first pose.
- "drift": a frame that drifts (REP 105, "odom"). Only the motion between two poses counts.

For the last two the state keeps a pose of an earlier instant (a "clone", Roumeliotis and Burdick 2002): B, where
the robot was at the source's pose z_B. The motion by the source u = (-)z_B (+) z should be the robot's own,

    u = (-)B (+) p + noise

seen from B. (Compared in the map as B (+) u = p, the levers of both sides differ by the innovation itself, which
the filter takes for knowledge of the heading: ANEES 2.7 instead of 1.3.) In a drifting frame B is taken anew with
every reading, as the gyro does with the heading; in an own frame it is the first pose, carried on by u, so that
its error stays that of the first reading.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Literal, cast

import numpy as np
from numpy.typing import NDArray

from locfuse.fusion import se2
from locfuse.fusion.chi_square import chi_square
from locfuse.fusion.core import poses as core
from locfuse.fusion.core import tables
from locfuse.fusion.core.room import Room
from locfuse.fusion.data import Array, Colour, Component, Ints, LocfuseError, Measurements, Stream, plausible
from locfuse.fusion.mount import ASK_MOUNT
from locfuse.fusion.se2 import wrap
from locfuse.fusion.sensor import (
    GATE,
    Ask,
    Belief,
    Block,
    Columns,
    Innovation,
    Matrix,
    Model,
    PoseRows,
    Reversal,
    Sensor,
    SensorSettings,
    WheelMotion,
    untold,
)
from locfuse.fusion.streams import count_dropped
from locfuse.fusion.wheels.odometry import ODOMETRY, POSE

KEPT = "_pose_before"
FLOOR = (0.002, math.radians(0.05))  # m, rad: standard deviations that no estimate goes below, whatever it claims
MAX_SIGMA = (1e3, 1e3)  # m, rad: larger ones say that a number was not measured
ARM_M = 0.15  # m: turning by one radian counts as this way
STUCK_M = 0.5  # m by the wheels, beyond which a pose that never changes is none
MIN_QUATERNION_SQUARE = 0.25  # a shorter quaternion is no orientation: drivers leave it zero
MIN_READINGS = 20  # before a source is called stuck, or far from the start
WITH_COVARIANCE = ("nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseWithCovarianceStamped")
PLANE = (0, 1, 5)  # where x, y and yaw stand in a covariance of ROS
IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
Pose = tuple[float, float, float]


class PoseSettings(SensorSettings, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """[pose]."""

    # None: "drift" of an Odometry and of /tf, else "own"
    frame: Literal["map", "own", "drift"] | None = None
    covariance: Literal["message", "sigma"] = "message"  # "sigma": the keys below, whatever the messages claim
    sigma: float = 0.05  # m per axis, where the messages say nothing
    sigma_theta_deg: float = 2.0  # degrees, likewise
    heading: bool = True  # false: only x and y count
    correlated: float = 0.0  # s over which its errors stay the same: the readings inside count as one
    sigma_drift: float = 0.02  # m per sqrt(m) of way, in a drifting frame
    sigma_drift_deg: float = 1.0  # degrees per sqrt(m) of way, in a drifting frame
    x: float = 0.0  # m, the body whose pose it is, on the base
    y: float = 0.0
    yaw_deg: float = 0.0

    def __post_init__(self) -> None:
        """Refuse a source without noise, and points in a frame whose direction nobody knows."""
        super().__post_init__()
        if not self.heading and self.frame != "map":
            raise ValueError('heading = false needs frame = "map": points do not tell how another frame is turned')
        for key in ("sigma_theta_deg", "sigma_drift", "sigma_drift_deg"):
            if getattr(self, key) <= 0.0:
                raise ValueError(f"{key} = {getattr(self, key)}: no sensor is exact, it must be positive")


class PoseSensor(Sensor):
    """Reads poses that are somebody's estimate."""

    name = "pose"
    locates = True
    Settings = PoseSettings
    components = (Component("x", "m"), Component("y", "m"), Component("heading", "deg", math.degrees(1.0)))
    colour = Colour("#1f6f8b", "#7b6bff")
    noise_keys = ("sigma", "sigma_theta_deg")
    extra = True
    asked_only = "an estimate may repeat what wheels and laser say, and count it twice"
    sees = "pose"
    asks: ClassVar[Mapping[str, Ask]] = {
        "frame": Ask('"map", "own" (stands still, but where is not known) or "drift" (an odometry)'),
        **dict.fromkeys(("x", "y", "yaw_deg"), Ask(f"m, m, degrees: {ASK_MOUNT}", blank=True)),
        "sigma": Ask("m: where the messages say nothing"),
        "sigma_theta_deg": Ask("degrees: where the messages say nothing"),
        "correlated": Ask("s over which its errors stay the same"),
    }
    reads: ClassVar[Mapping[str, tuple[str, ...]]] = {
        kind: (*fields, "pose.covariance") if kind in WITH_COVARIANCE else fields for kind, fields in POSE.items()
    }

    def mount(self, settings: PoseSettings) -> Pose:
        """Return where the body whose pose it is sits on the base: x [m], y [m], yaw [rad]."""
        return settings.x, settings.y, math.radians(settings.yaw_deg)

    def concerns(self, key: str, msgtype: str) -> bool:
        """Return whether a key means anything to messages of this type."""
        return not key.startswith("sigma_drift") or msgtype in DRIFTING

    def measure(self, stream: Stream, settings: PoseSettings, wheels: WheelMotion, epoch_ns: int) -> Measurements:
        """Turn poses into z (n, 3) x, y [m], heading [rad] of the base, in the source's frame.

        Raises LocfuseError where no message holds a pose, or all hold the same while the robot drives.
        """
        fields = POSE[stream.msgtype]
        columns = cast("dict[str, Array]", stream.columns(*self.reads[stream.msgtype]))
        values = np.stack([np.asarray(columns[name], np.float64) for name in fields], axis=-1)
        dropped = dict(stream.dropped)
        keep = _usable(values, stream, settings, dropped)
        values, t = values[keep], (stream.t_ns[keep] - epoch_ns) * np.float64(1e-9) + settings.time_offset
        theta = se2.yaw(*values[:, 2:].T) if settings.heading else np.zeros(len(values))
        z = np.column_stack((values[:, :2], theta))
        _refuse_stuck(t, z, wheels, stream.topic)
        own = np.broadcast_to(_own(settings), (len(z), 3))
        R, told = plane_covariance(columns.get("pose.covariance"), keep, settings.covariance, own)
        off = se2.inverse(np.array(self.mount(settings)))
        J = _by_pose(z, off)
        n = len(z)
        return Measurements(
            t=t,
            first=np.arange(n + 1),
            z=se2.compose(z, off),
            R_unit=J @ R @ J.transpose(0, 2, 1) * _in_a_row(t, settings.correlated) / settings.sigma**2,
            scale=settings.sigma,
            floor=np.diag([FLOOR[0] ** 2, FLOOR[0] ** 2, FLOOR[1] ** 2]),
            extra={
                "drifts": np.full(n, float(_frame(settings, stream.msgtype) == "drift")),
                "told": told.astype(np.float64),
            },
            dropped=dropped,
        )

    def heading(self, m: Measurements) -> tuple[Array, Array]:
        """Return times (n,) and headings (n,) [rad, unwrapped] by the source."""
        return m.t, np.unwrap(m.z[:, 2])

    def reversal(self, settings: PoseSettings, msgtype: str) -> Reversal:
        """Return why it turns the other way round: its z axis looks down, which no setting of ours turns."""
        return Reversal("its z axis looks down (NED): it has to be turned before it is recorded")

    def says_noise(self, m: Measurements) -> bool:
        """Return whether the messages say how good their poses are: then `sigma` changes nothing."""
        return bool(m.extra["told"].any())

    def model(self, settings: PoseSettings) -> Model:
        """Return the source's side of a new run."""
        return InMapModel(settings) if settings.frame == "map" else KeptPoseModel(settings)


DRIFTING = (ODOMETRY, "geometry_msgs/msg/TransformStamped")


def _frame(settings: PoseSettings, msgtype: str) -> str:
    return settings.frame or ("drift" if msgtype in DRIFTING else "own")


def _own(settings: PoseSettings) -> Array:
    """Return the variances (3,) of a pose that comes without any."""
    turn = math.radians(settings.sigma_theta_deg) if settings.heading else MAX_SIGMA[1]
    return np.array([settings.sigma, settings.sigma, turn]) ** 2


def _usable(values: Array, stream: Stream, settings: PoseSettings, dropped: dict[str, int]) -> Ints:
    """Return the rows of messages that hold a pose at a time of its own; count the others."""
    finite = np.asarray(plausible(values[:, :2]).all(axis=1))
    turned = np.ones(len(values), dtype=bool)
    if settings.heading:
        finite &= np.isfinite(values[:, 2:]).all(axis=1)
        turned = np.square(np.where(finite[:, None], values[:, 2:], 0.0)).sum(axis=1) > MIN_QUATERNION_SQUARE
    later = np.diff(stream.t_ns, append=np.iinfo(np.int64).max) > 0
    good: NDArray[np.bool_] = finite & turned & later
    for reason, out in (
        ("not_finite", ~finite),
        ("no_orientation", finite & ~turned),
        ("repeat", finite & turned & ~later),
    ):
        count_dropped(dropped, reason, int(out.sum()))
    if not good.any():
        why = ", ".join(f"{n} {reason.replace('_', ' ')}" for reason, n in dropped.items()) or "no messages"
        raise LocfuseError(f"{stream.topic} has no usable pose in {len(values)} messages ({why})", role="pose")
    return np.flatnonzero(good)


def plane_covariance(
    column: Any, rows: Ints, which: str, own: Array, axes: Sequence[int] = PLANE
) -> tuple[Array, NDArray[np.bool_]]:
    """Return covariances (n, d, d) of some rows: the messages' own where they say one (n,), else diag(own (n, d)).

    `column` holds 6 x 6 matrices of x, y, z, roll, pitch, yaw, of which `axes` (d,) are wanted. A covariance of
    zeros, one that is not positive, and NaN say nothing. What is larger than MAX_SIGMA was not measured: it is cut
    there, and its correlations with it, so that no rounding makes the matrix indefinite.
    """
    n, d = own.shape
    P = own[:, :, None] * np.eye(d)
    if column is None or which == "sigma":
        return P, np.zeros(n, dtype=bool)
    full = np.asarray(column, np.float64).reshape(-1, 6, 6)[rows][:, axes][:, :, axes]
    diagonal = np.diagonal(full, axis1=1, axis2=2)
    told = np.asarray(np.isfinite(full).all(axis=(1, 2)) & (diagonal > 0.0).all(axis=1))
    limit = np.array(MAX_SIGMA)[[0, *([0] * (d - 2)), 1]] ** 2
    shrink = np.sqrt(np.minimum(1.0, limit / np.where(told[:, None], diagonal, 1.0)))
    scaled = np.where(told[:, None, None], full, np.eye(d)) * shrink[:, :, None] * shrink[:, None, :]
    scaled = 0.5 * (scaled + scaled.transpose(0, 2, 1))
    told = told & (np.linalg.eigvalsh(scaled)[:, 0] > 0.0)
    P[told] = scaled[told]
    unused = own[:, -1] >= MAX_SIGMA[1] ** 2  # its heading does not count
    P[unused, -1, :], P[unused, :, -1], P[unused, -1, -1] = 0.0, 0.0, own[unused, -1]
    return P, told


def _refuse_stuck(t: Array, z: Array, wheels: WheelMotion, topic: str) -> None:
    """Raise LocfuseError where the pose never changes while the robot drives."""
    if len(t) < MIN_READINGS or np.ptp(z, axis=0).max() > 0.0:
        return
    way = np.hypot(*wheels.relative(np.full(len(t), t[0]), t)[:, :2].T).max()
    if way > STUCK_M:
        raise LocfuseError(
            f"{topic} says the same pose in all {len(t)} messages while the wheels drove {way:.1f} m", role="pose"
        )


def _by_pose(z: Array, off: Array) -> Array:
    """Return d(z (+) off)/dz, (n, 3, 3)."""
    r = se2.rotated(z[:, 2], np.broadcast_to(off[:2], (len(z), 2)))
    J = np.zeros((len(z), 3, 3))
    J[:] = np.eye(3)
    J[:, 0, 2], J[:, 1, 2] = -r[:, 1], r[:, 0]
    return J


def _in_a_row(t: Array, correlated: float) -> float:
    """Return how many readings share one error: that many times the variance makes them count as one."""
    if len(t) < 2 or correlated <= 0.0:
        return 1.0
    return max(1.0, correlated / float(np.median(np.diff(t))))


class InMapModel(Model):
    """z = p + noise, both in the map."""

    def __init__(self, settings: PoseSettings) -> None:
        self.threshold = chi_square(settings.gate, 3 if settings.heading else 2)
        self._seen = self._far = 0

    def innovations(self, m: Measurements, i: int, belief: Belief) -> list[Innovation]:
        """Compare one pose with the belief."""
        x, y, theta = m.z[i].tolist()
        e = (x - belief.x, y - belief.y, wrap(theta - belief.theta))
        seen = Innovation.of(i, e, IDENTITY, _matrix(m.R[i]), belief, self.threshold)
        self.count(1, int(seen.verdict != 0))
        return [seen]

    def count(self, seen: int, far: int) -> None:
        """Take in so many poses, of which some were beyond the gate."""
        self._seen, self._far = self._seen + seen, self._far + far

    def columns(self, m: Measurements, when: Ints) -> Columns:
        """Return all poses for the core."""
        return MapPoseColumns(self, m, when)

    def notes(self, belief: Any) -> list[str]:
        """Say where nearly all poses are far from the robot: their frame is not the map."""
        if self._seen < MIN_READINGS or 2 * self._far < self._seen:
            return []
        words = (
            f"{self._far} of {self._seen} poses are beyond the gate: is [start] right, and is their frame the map?"
        )
        return [f"{words} If not: pose.frame=own"]


class KeptPoseModel(Model):
    """u = (-)B (+) p + noise, in the local frame: a source whose frame nobody knows never says where north is."""

    local = True
    maps = True

    def __init__(self, settings: PoseSettings) -> None:
        self.threshold = chi_square(settings.gate, 3)
        self.drift = settings.sigma_drift**2, math.radians(settings.sigma_drift_deg) ** 2  # per m
        self._last: Array | None = None  # the source's pose at B
        self.row = 0  # of that pose among the measurements

    def blocks(self) -> list[Block]:
        """Return the kept pose."""
        return [Block(KEPT, np.zeros(3), np.zeros((3, 3)), np.zeros(3))]

    def begins_map(self, m: Measurements, i: int) -> bool:
        """Return whether this is the first pose, with which a local frame can begin."""
        return self._last is None

    def innovations(self, m: Measurements, i: int, belief: Any) -> list[Innovation]:
        """Compare the motion since the kept pose with the belief; the first reading only begins."""
        if self._last is None:
            return []
        room = Room.here(core)
        column, kept = belief.block(KEPT)
        u = room.listed(seen_from(self._last, m.z[i]), 3)
        v = room.listed(seen_from(kept, (belief.x, belief.y, belief.theta)), core.SEEN_FROM)
        R = self._drifted(u, m.floor) if m.extra["drifts"][i] else self._turned(m, i, -float(self._last[2]))
        H, H_block = (tuple(tuple(v[at : at + 3]) for at in (first, first + 3, first + 6)) for first in (12, 3))
        y, columns = (u[0] - v[0], u[1] - v[1], wrap(u[2] - v[2])), (column, column + 1, column + 2)
        return [
            Innovation.of(i, y, cast("PoseRows", H), R, belief, self.threshold, columns=columns, H_block=H_block)
        ]

    def _turned(self, m: Measurements, i: int, angle: float) -> Matrix:
        """Return R of reading i in a frame in which the source's frame is turned by an angle [rad]."""
        room = Room.here(core)
        out = room.floats(6)
        room.functions.turned_noise(room.flat(_triangles(m.covariances(slice(i, i + 1))).tolist()), angle, out)
        return _whole(room.listed(out, 6))

    def _drifted(self, u: Sequence[float], floor: Array) -> Matrix:
        """Return the covariance of what a drifting source misses on its way u (3,)."""
        room = Room.here(core)
        out, least = room.floats(6), (float(floor[0, 0]), float(floor[2, 2]))
        room.functions.way_noise(room.flat((u,)), *self.drift, ARM_M, *least, out)
        return _whole(room.listed(out, 6))

    @property
    def last(self) -> Array | None:
        """The source's pose (3,) when the pose was kept."""
        return self._last

    def keep(self, i: int, z: Array) -> None:
        """Take in that the pose was kept with reading i, when the source's was z (3,)."""
        self.row, self._last = i, z.copy()

    def columns(self, m: Measurements, when: Ints) -> Columns:
        """Return all poses for the core, which takes them once there is one to compare with."""
        return KeptPoseColumns(self, m, when)

    def learn(self, m: Measurements, i: int, belief: Any) -> None:
        """Keep the pose as it is now; in a frame that stands still carry on the one that is kept."""
        column, kept = belief.block(KEPT)
        at, last = np.arange(column, column + 3), self._last
        self.keep(i, m.z[i])
        if last is None or m.extra["drifts"][i]:
            belief.clone_pose(column)
        else:
            u = se2.between(last, m.z[i])
            carried = se2.compose(np.array(kept), u)
            belief.transform(at, carried, _by_pose(np.array([kept]), u)[0])
        if last is None and not m.extra["drifts"][i]:
            R = self._turned(m, i, belief.theta - float(m.z[i, 2]))
            belief.loosen(at, np.diagonal(np.array(R)))


def _matrix(R: Array) -> Matrix:
    return tuple(map(tuple, R.tolist()))


def _triangles(R: Array) -> Array:
    """Return the upper triangles of covariances (n, 3, 3), (n, 6), row by row."""
    return np.ascontiguousarray(R.reshape(-1, 9)[:, (0, 1, 2, 4, 5, 8)])


def _whole(R: Sequence[float]) -> Matrix:
    """Return the covariance of such a triangle."""
    xx, xy, xt, yy, yt, tt = R
    return ((xx, xy, xt), (xy, yy, yt), (xt, yt, tt))


def seen_from(a: Sequence[float] | Array, b: Sequence[float] | Array) -> Any:
    """Return what `core.poses.see_from` writes of pose b (3,) as it is seen from pose a (3,)."""
    room = Room.here(core)
    out = room.floats(core.SEEN_FROM)
    room.functions.see_from(room.flat((list(map(float, a)),)), room.flat((list(map(float, b)),)), out)
    return out


class PoseColumns(Columns):
    """All poses for the core."""

    kind = "poses"

    def __init__(self, m: Measurements, when: Ints) -> None:
        self.when, self.first = when, np.arange(len(when) + 1)
        self.z = np.ascontiguousarray(m.z)
        self._R, self._drifts = _triangles(m.covariances(slice(None))), np.asarray(m.extra["drifts"], np.intp)
        self._floor = float(m.floor[0, 0]), float(m.floor[2, 2])
        self.told, self.joint = untold(len(m.z), 3), np.zeros((0, 2))

    def of(self, in_map: bool, at_kept: int, drift: tuple[float, float], threshold: float, last: int) -> Any:
        """Return the table."""
        return Room.here(tables).on_arrays.Poses(
            self.when, self.z, self._R, self._drifts, self.told, in_map, at_kept, *drift, ARM_M, *self._floor,
            threshold, float(GATE), last, len(self.when), 0,
        )  # fmt: skip


class MapPoseColumns(PoseColumns):
    """Poses in the map."""

    def __init__(self, model: InMapModel, m: Measurements, when: Ints) -> None:
        super().__init__(m, when)
        self._model = model

    def table(self, belief: Any) -> Any:
        """Return the poses."""
        return self.of(True, -1, (0.0, 0.0), self._model.threshold, 0)

    def passed(self, first: int, last: int) -> None:
        """Count what was beyond the gate."""
        self._model.count(last - first, int(np.count_nonzero(self.told[first:last, 0])))


class KeptPoseColumns(PoseColumns):
    """Poses of a frame of their own."""

    def __init__(self, model: KeptPoseModel, m: Measurements, when: Ints) -> None:
        super().__init__(m, when)
        self._model = model

    @property
    def ready(self) -> bool:
        """Whether a pose is kept."""
        return self._model.last is not None

    def table(self, belief: Any) -> Any:
        """Return the poses, and the states of the one that is kept."""
        return self.of(False, belief.block(KEPT)[0], self._model.drift, self._model.threshold, self._model.row)

    def passed(self, first: int, last: int) -> None:
        """Take in which pose is kept now."""
        if last > first:
            self._model.keep(last - 1, self.z[last - 1])
