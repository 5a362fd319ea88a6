"""Poses from another estimator (visual odometry, AMCL, UWB, scan matching), used as measurements.

The frame of the poses (setting `frame`) determines the measurement:

- "map": the map of this run. z = p + noise.
- "own": a frame of the source that is fixed in the map. The first pose determines its transform.
- "drift": a frame that drifts (REP 105, "odom"). Only the motion between two poses counts.

For the last two frames, an earlier pose B of the robot is a state (a "clone", Roumeliotis and Burdick 2002). At B,
the source's pose was z_B. The source's motion u = (-)z_B (+) z equals the robot's motion,

    u = (-)B (+) p + noise

relative to B. (If both were compared in the map frame, B (+) u = p, the derivatives by the headings would differ
by the innovation, and the filter would be overconfident: ANEES 2.7 instead of 1.3.) In a drifting frame, B is
cloned again at every reading, as the gyro does with the heading. In an own frame, B is the first pose, which is
moved by u at every reading, so that its error remains that of the first reading.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Literal

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import (
    PLANE_ROWS,
    Array,
    Colour,
    Component,
    Ints,
    LocfuseError,
    Mask,
    Measurements,
    Stream,
    plausible,
)
from locfuse.fusion.ekf.map_frame import pose_by_frame
from locfuse.fusion.kernels.ekf import Innovation
from locfuse.fusion.mount import ASK_MOUNT
from locfuse.fusion.se2 import wrap
from locfuse.fusion.sensor import (
    Ask,
    Belief,
    Block,
    Matrix,
    Model,
    PoseRows,
    Reversal,
    Sensor,
    SensorSettings,
    WheelMotion,
)
from locfuse.fusion.statistics import chi_square
from locfuse.fusion.streams import arrays, count_dropped, seconds
from locfuse.fusion.wheels.odometry import ODOMETRY, POSE

from .points import spread_in_other_frame

CLONE = "_pose_before"
MIN_SIGMAS = (0.002, math.radians(0.05))  # m, rad: no estimate is more exact, whatever it claims
MAX_SIGMA = (1e3, 1e3)  # m, rad: a larger sigma means that a number was not measured
ARM_M = 0.15  # m of distance that cause as much drift as a turn by 1 rad
STUCK_M = 0.5  # m driven by the wheels, beyond which a constant pose is an error
MIN_QUATERNION_SQUARE = 0.25  # a shorter quaternion is no orientation: drivers leave it zero
MIN_READINGS = 20  # before a source is called stuck, or far from the start
WITH_COVARIANCE = ("nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseWithCovarianceStamped")
IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
DRIFTING = (ODOMETRY, "geometry_msgs/msg/TransformStamped")  # types of frames that drift
DRIFT_SIGMAS = ("sigma_drift", "sigma_drift_deg")
Pose = tuple[float, float, float]


class PoseSettings(SensorSettings, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Settings of [pose] in robot.toml."""

    # not set: "drift" of an Odometry and of /tf, else "own"
    frame: Literal["map", "own", "drift"] | None = None
    covariance: Literal["message", "sigma"] = "message"  # "sigma": the keys below, whatever the messages claim
    sigma: float = 0.05  # m per axis, if the messages have no covariance
    sigma_theta_deg: float = 2.0  # degrees, likewise
    heading: bool = True  # false: only x and y are used
    correlated: float = 0.0  # s over which the error is constant: the readings in this time count as one reading
    sigma_drift: float = 0.02  # m per sqrt(m) of way, in a drifting frame
    sigma_drift_deg: float = 1.0  # degrees per sqrt(m) of way, in a drifting frame
    x: float = 0.0  # m, position of the tracked body on the base
    y: float = 0.0  # m, likewise
    yaw_deg: float = 0.0  # degrees, likewise

    positive: ClassVar[tuple[str, ...]] = (*SensorSettings.positive, "sigma_theta_deg", *DRIFT_SIGMAS)

    def __post_init__(self) -> None:
        """Raise ValueError for a sigma of 0, and for positions without headings in a frame that is not the map."""
        super().__post_init__()
        if not self.heading and self.frame != "map":
            raise ValueError('heading = false needs frame = "map": points do not tell how another frame is turned')


class PoseSensor(Sensor):
    """Sensor of poses by another estimator: reads Odometry, PoseStamped, /tf and similar messages."""

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

    def concerns(self, key: str, msgtype: str) -> bool:
        """Return whether a setting applies to a message type: drift settings apply to drifting frames only."""
        return not key.startswith("sigma_drift") or msgtype in DRIFTING

    def measure(self, stream: Stream, settings: PoseSettings, wheels: WheelMotion, epoch_ns: int) -> Measurements:
        """Measure poses z (n, 3) of the base: x, y [m], heading [rad], in the frame of the other estimator.

        Raises LocfuseError if no message has a pose, or if the pose does not change while the robot drives.
        """
        fields = POSE[stream.msgtype]
        columns = arrays(stream, *self.reads[stream.msgtype])
        values = np.stack([np.asarray(columns[name], np.float64) for name in fields], axis=-1)
        dropped = dict(stream.dropped)
        keep = _usable(values, stream, settings, dropped)
        values, t = values[keep], seconds(stream.t_ns[keep], epoch_ns, settings.time_offset)
        # several readings have the same error: with this factor on their variances they count as one reading
        shared = max(1.0, settings.correlated / float(np.median(np.diff(t)))) if len(t) > 1 else 1.0
        theta = se2.yaw(*values[:, 2:].T) if settings.heading else np.zeros(len(values))
        z = np.column_stack((values[:, :2], theta))
        _refuse_stuck(t, z, wheels, stream.topic)
        turn = math.radians(settings.sigma_theta_deg) if settings.heading else MAX_SIGMA[1]
        own = np.broadcast_to(np.square((settings.sigma, settings.sigma, turn)), (len(z), 3))
        R, has_covariance = plane_covariance(columns.get("pose.covariance"), keep, settings.covariance, own)
        off = se2.inverse(np.array(self.mount(settings)))
        J = pose_by_frame(z, np.broadcast_to(off, z.shape))
        n, frame = len(z), settings.frame or ("drift" if stream.msgtype in DRIFTING else "own")
        return Measurements(
            t=t,
            first=np.arange(n + 1),
            z=se2.compose(z, off),
            R_unit=se2.propagated(J, R) * shared / settings.sigma**2,
            scale=settings.sigma,
            floor=np.diag([MIN_SIGMAS[0] ** 2, MIN_SIGMAS[0] ** 2, MIN_SIGMAS[1] ** 2]),
            extra={
                "drifts": np.full(n, float(frame == "drift")),
                "has_covariance": has_covariance.astype(np.float64),
            },
            dropped=dropped,
        )

    def heading(self, m: Measurements) -> tuple[Array, Array]:
        """Return times (n,) [s] and headings (n,) [rad, unwrapped] of the other estimator."""
        return m.t, np.unwrap(m.z[:, 2])

    def misfit(self, m: Measurements, settings: PoseSettings, poses: Array) -> float | None:
        """Return the spread [m] of the positions about poses (n, 3), for any body and frame; None for a drift."""
        return None if m.extra["drifts"].any() else spread_in_other_frame(m.z, poses)

    def reversal(self, settings: PoseSettings, msgtype: str) -> Reversal:
        """Return why poses turn opposite to the wheels: their z axis points down; no setting corrects that."""
        return Reversal("its z axis looks down (NED): it has to be turned before it is recorded")

    def model(self, settings: PoseSettings) -> Model:
        """Return the filter model of the poses for a new run."""
        return InMapModel(settings) if settings.frame == "map" else KeptPoseModel(settings)


def _usable(values: Array, stream: Stream, settings: PoseSettings, dropped: dict[str, int]) -> Ints:
    """Return the rows of messages with a valid pose and a new stamp; count the others by reason."""
    finite = np.asarray(plausible(values[:, :2]).all(axis=1))
    turned = np.ones(len(values), dtype=bool)
    if settings.heading:
        finite &= np.isfinite(values[:, 2:]).all(axis=1)
        turned = np.square(np.where(finite[:, None], values[:, 2:], 0.0)).sum(axis=1) > MIN_QUATERNION_SQUARE
    later = np.diff(stream.t_ns, append=np.iinfo(np.int64).max) > 0
    good: Mask = finite & turned & later
    count_dropped(dropped, not_finite=~finite, no_orientation=finite & ~turned, repeat=finite & turned & ~later)
    if not good.any():
        why = ", ".join(f"{n} {reason.replace('_', ' ')}" for reason, n in dropped.items()) or "no messages"
        raise LocfuseError(f"{stream.topic} has no usable pose in {len(values)} messages ({why})", role="pose")
    return np.flatnonzero(good)


def plane_covariance(
    column: Any, rows: Ints, which: str, own: Array, axes: Sequence[int] = PLANE_ROWS
) -> tuple[Array, Mask]:
    """Return planar covariances (n, d, d), and which of them are from the messages (n,).

    The other ones are diagonal, with the variances `own` (n, d). `column` has 6 x 6 matrices of x, y, z, roll,
    pitch, yaw; their rows and columns `axes` (d,) are returned. Covariances with zeros or NaN, or that are not
    positive definite, are not used. Variances above MAX_SIGMA^2 were not measured: they are reduced to this value
    with the same correlations, so that rounding errors cannot make the matrix indefinite.
    """
    n, d = own.shape
    P = own[:, :, None] * np.eye(d)
    if column is None or which == "sigma":
        return P, np.zeros(n, dtype=bool)
    full = np.asarray(column, np.float64).reshape(-1, 6, 6)[rows][:, axes][:, :, axes]
    diagonal = np.diagonal(full, axis1=1, axis2=2)
    has_covariance = np.asarray(np.isfinite(full).all(axis=(1, 2)) & (diagonal > 0.0).all(axis=1))
    limit = np.array(MAX_SIGMA)[[0, *([0] * (d - 2)), 1]] ** 2
    shrink = np.sqrt(np.minimum(1.0, limit / np.where(has_covariance[:, None], diagonal, 1.0)))
    scaled = np.where(has_covariance[:, None, None], full, np.eye(d)) * shrink[:, :, None] * shrink[:, None, :]
    scaled = se2.symmetric(scaled)
    has_covariance = has_covariance & (np.linalg.eigvalsh(scaled)[:, 0] > 0.0)
    P[has_covariance] = scaled[has_covariance]
    unused = own[:, -1] >= MAX_SIGMA[1] ** 2  # the heading is not used
    P[unused, -1, :], P[unused, :, -1], P[unused, -1, -1] = 0.0, 0.0, own[unused, -1]
    return P, has_covariance


def _refuse_stuck(t: Array, z: Array, wheels: WheelMotion, topic: str) -> None:
    """Raise LocfuseError if the pose never changes while the robot drives."""
    if len(t) < MIN_READINGS or np.ptp(z, axis=0).max() > 0.0:
        return
    distance = np.hypot(*wheels.relative(np.full(len(t), t[0]), t)[:, :2].T).max()
    if distance > STUCK_M:
        words = f"{topic} says the same pose in all {len(t)} messages while the wheels drove {distance:.1f} m"
        raise LocfuseError(words, role="pose")


class InMapModel(Model):
    """Model of poses given in the map frame: z = pose + noise."""

    def __init__(self, settings: PoseSettings) -> None:
        self.threshold = chi_square(settings.gate, 3 if settings.heading else 2)
        self._seen = self._far = 0

    def innovations(self, m: Measurements, i: int, belief: Belief) -> list[Innovation]:
        """Return the innovation of pose i."""
        z, (x, y, theta) = m.plain["z"], belief.pose()
        e = z[i, 0] - x, z[i, 1] - y, wrap(z[i, 2] - theta)
        seen = belief.compare(i, e, IDENTITY, _covariance_of(m, i), self.threshold)
        self._seen += 1
        self._far += seen.verdict != 0
        return [seen]

    def notes(self, belief: Any) -> list[str]:
        """Return a note if at least half of the poses are rejected: their frame may not be the map."""
        if self._seen < MIN_READINGS or 2 * self._far < self._seen:
            return []
        words = (
            f"{self._far} of {self._seen} poses are beyond the gate: is [start] right, and is their frame the map?"
        )
        return [f"{words} If not: pose.frame=own"]


class KeptPoseModel(Model):
    """Model of poses in a frame other than the map: only motions between two poses are measured.

    The motion is u = (-)B (+) p, with the robot's pose p and its cloned earlier pose B, which is a state.
    A source in an unknown frame gives no absolute heading.
    """

    local = True
    maps = True

    def __init__(self, settings: PoseSettings) -> None:
        self.threshold = chi_square(settings.gate, 3)
        self.drift = settings.sigma_drift**2, math.radians(settings.sigma_drift_deg) ** 2  # per m
        self._last: Pose | None = None  # the source's pose at B

    def blocks(self) -> list[Block]:
        """Return the state block of the cloned pose B."""
        return [Block(CLONE, np.zeros(3), np.zeros((3, 3)), np.zeros(3))]

    def begins_map(self, m: Measurements, i: int) -> bool:
        """Return whether no pose was used yet: the local frame can begin here."""
        return self._last is None

    def innovations(self, m: Measurements, i: int, belief: Any) -> list[Innovation]:
        """Return the innovation of the motion since the cloned pose B; [] at the first reading."""
        if self._last is None:
            return []
        column = belief.column(CLONE)
        columns = column, column + 1, column + 2
        u = seen_from(self._last, _pose_of(m, i))[0]
        moved, by_kept, by_pose = seen_from(tuple(map(belief.value, columns)), belief.pose())
        if m.plain["drifts"][i]:  # by length and turn of the motion
            distance = math.hypot(u[0], u[1]) + ARM_M * abs(wrap(u[2]))
            xy = self.drift[0] * distance + m.floor.item(0, 0)
            R: Matrix = (xy, 0.0, 0.0), (0.0, xy, 0.0), (0.0, 0.0, self.drift[1] * distance + m.floor.item(2, 2))
        else:
            R = _turned(_covariance_of(m, i), -self._last[2])
        y = u[0] - moved[0], u[1] - moved[1], wrap(u[2] - moved[2])
        return [belief.compare(i, y, by_pose, R, self.threshold, columns, by_kept)]

    def learn(self, m: Measurements, i: int, belief: Any) -> None:
        """Prepare the cloned pose B for the next reading.

        If the frame drifts, or at the first reading, B becomes the present pose. Else the measured motion moves B.
        """
        column, last, drifts = belief.column(CLONE), self._last, m.plain["drifts"][i]
        self._last = now = _pose_of(m, i)
        if last is None or drifts:
            belief.clone_pose(column)
        if drifts:
            return
        if last is None:
            R = _turned(_covariance_of(m, i), belief.theta - now[2])
            belief.add_variance(np.arange(column, column + 3), np.diagonal(np.array(R)))
        else:
            at = column, column + 1, column + 2
            x, y, theta = map(belief.value, at)
            u, (c, s) = seen_from(last, now)[0], se2.direction(theta)
            dx, dy = c * u[0] - s * u[1], s * u[0] + c * u[1]
            by_kept = (1.0, 0.0, -dy), (0.0, 1.0, dx), (0.0, 0.0, 1.0)
            belief.transform(at, (x + dx, y + dy, theta + u[2]), by_kept)


def _pose_of(m: Measurements, i: int) -> Pose:
    z = m.plain["z"]
    return z[i, 0], z[i, 1], z[i, 2]


def _covariance_of(m: Measurements, i: int) -> Matrix:
    R = m.plain["R"]
    return tuple((R[i, a, 0], R[i, a, 1], R[i, a, 2]) for a in range(3))


def _turned(R: Matrix, angle: float) -> Matrix:
    """Return a pose covariance R (3, 3) in a frame that is rotated by an angle [rad]."""
    (xx, xy, xt), (_, yy, yt), (_, _, tt) = R
    c, s = se2.direction(angle)
    across = c * s * (xx - yy) + (c * c - s * s) * xy
    turned_xx = c * c * xx - 2.0 * c * s * xy + s * s * yy
    turned_yy = s * s * xx + 2.0 * c * s * xy + c * c * yy
    turned_xt, turned_yt = c * xt - s * yt, s * xt + c * yt
    return (turned_xx, across, turned_xt), (across, turned_yy, turned_yt), (turned_xt, turned_yt, tt)


def seen_from(a: Sequence[float], b: Sequence[float]) -> tuple[Pose, PoseRows, PoseRows]:
    """Return pose b relative to pose a, (-)a (+) b, and its derivatives (3, 3) by a and by b."""
    c, s = se2.direction(a[2])
    dx, dy = b[0] - a[0], b[1] - a[1]
    x, y = c * dx + s * dy, c * dy - s * dx
    by_a = (-c, -s, y), (s, -c, -x), (0.0, 0.0, -1.0)
    by_b = (c, s, 0.0), (-s, c, 0.0), (0.0, 0.0, 1.0)
    return (x, y, b[2] - a[2]), by_a, by_b
