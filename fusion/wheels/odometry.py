"""Body motion from an odometry topic: increments of its poses, or its speeds.

Only increments of poses are used, so the first pose does not matter. Some drivers ignore the sign of the wheel
turns in the pose, but not in the twist: then the pose moves forward while the twist is negative (fr079: 513
messages).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, LocfuseError, Mask, Stream, stretches, totals
from locfuse.fusion.robot import WheelSettings
from locfuse.fusion.streams import arrays, gap_limit, in_turn

from .repairs import (
    MAX_SPEED_MPS,
    check_limit,
    held_note,
    held_readings,
    jump_notes,
    limits,
    spikes,
    without_restarts,
)

ODOMETRY = "nav_msgs/msg/Odometry"
TRANSFORM = "geometry_msgs/msg/TransformStamped"


def pose_fields(prefix: str, position: str = "position", orientation: str = "orientation") -> tuple[str, ...]:
    """Return the names of the six fields of a planar pose: x, y, and a quaternion x, y, z, w."""
    axes = [*(f"{position}.{axis}" for axis in "xy"), *(f"{orientation}.{axis}" for axis in "xyzw")]
    return tuple(f"{prefix}.{axis}" for axis in axes)


TURTLESIM = "turtlesim/msg/Pose"
# Message type -> fields of the pose: x, y and a quaternion (6).
POSE: Mapping[str, tuple[str, ...]] = {
    ODOMETRY: pose_fields("pose.pose"),
    TRANSFORM: pose_fields("transform", "translation", "rotation"),
    "geometry_msgs/msg/PoseStamped": pose_fields("pose"),
    "geometry_msgs/msg/PoseWithCovarianceStamped": pose_fields("pose.pose"),
    "geometry_msgs/msg/Pose": tuple(name.removeprefix("pose.") for name in pose_fields("pose")),
    "foxglove.PoseInFrame": pose_fields("pose"),
    "foxglove_msgs/msg/PoseInFrame": pose_fields("pose"),
}
# Message type -> fields of x, y [m] and the heading [rad].
PLANAR: Mapping[str, tuple[str, ...]] = dict.fromkeys(("geometry_msgs/msg/Pose2D", TURTLESIM), ("x", "y", "theta"))
# Message type -> fields of the forward speed [m/s] and the turning rate [rad/s].
SPEED: Mapping[str, tuple[str, str]] = {
    ODOMETRY: ("twist.twist.linear.x", "twist.twist.angular.z"),
    "geometry_msgs/msg/TwistStamped": ("twist.linear.x", "twist.angular.z"),
    "geometry_msgs/msg/TwistWithCovarianceStamped": ("twist.twist.linear.x", "twist.twist.angular.z"),
    "geometry_msgs/msg/Twist": ("linear.x", "angular.z"),
    "duckietown_msgs/msg/Twist2DStamped": ("v", "omega"),
    TURTLESIM: ("linear_velocity", "angular_velocity"),
    "autoware_auto_vehicle_msgs/msg/VelocityReport": ("longitudinal_velocity", "heading_rate"),
    "autoware_vehicle_msgs/msg/VelocityReport": ("longitudinal_velocity", "heading_rate"),
}
# Message type -> fields of the speed and the steering angle: turning rate = speed * tan(angle) / wheelbase. Some
# drivers write a turning rate or the heading instead of the angle (wheels.steering).
STEERED: Mapping[str, tuple[str, str]] = {
    "ackermann_msgs/msg/AckermannDriveStamped": ("drive.speed", "drive.steering_angle"),
    "ackermann_msgs/msg/AckermannDrive": ("speed", "steering_angle"),
}
SCANS = "sensor_msgs/msg/LaserScan"  # odometry by scan matching (motion_by_scans)
BODY_READS: Mapping[str, tuple[str, ...]] = {
    **{
        kind: tuple(field for fields in (POSE, PLANAR, SPEED, STEERED) for field in fields.get(kind, ()))
        for kind in (*POSE, *PLANAR, *SPEED, *STEERED)
    },
    SCANS: (),
}
MIN_STEP_M = 1e-3  # m: smaller steps have no direction
MAX_STEP_RATIO = 3.0  # largest ratio of |pose step| and |twist| dt that agree
MIN_AGREEING_SHARE = 0.8  # least share of agreeing steps with which the twist is used
# words in names of topics with commands, and of topics with measurements although their type is for commands
COMMANDED = ("cmd", "command", "control", "target", "setpoint", "goal", "initial", "waypoint", "teleop", "joy")
MEASURED = ("state", "status", "feedback", "report", "measured", "actual", "odom")
MAX_HOLD_S = 1.0  # s, longest duration of a command: then drivers stop the robot
MAX_TURN_RADPS = 1e6  # faster than any body, in any unit
TWO_SOURCES = "its poses jump to and fro between two paths: two publishers. Record each on a topic of its own"
# misfit to the axes of the poses' frame, as share of that to the body's, for speeds in this frame
MAX_FRAME_SHARE = 0.5
MIN_BODY_MISFIT = 0.3  # least misfit to the body's axes, as share of the distance, for speeds in the poses' frame
MAX_SIDEWAYS_MPS = 3.0  # m/s, limit of the 95th percentile of the sideways speed
MAX_JUMP_MPS, MAX_JUMPS_SHARE = 10.0, 0.05  # m/s of a jump, and largest share of jumps among the steps
MIN_UNSEEN_TURN_RAD = 1.0  # turn by the rates, beside a heading that never changes
# smallest grid of positions that is too coarse; number of steps; largest distance from the grid as share of it
MIN_GRID_M, MIN_GRID_STEPS, MAX_OFF_GRID = 0.02, 20, 1e-3
MIN_GRID_RATIO = 1.3  # least ratio of a grid to the usual step by the speeds
# length of the mean unit step in the body's frame: least one with which steps have one direction; gain by a mirror
MIN_ALONG, MIN_MIRROR_GAIN = 0.9, 0.3
MAX_SPEED_MISFIT = 0.3  # mean difference of steps by speed and by pose, as share of the step, if speeds are used
MIN_OFF_RAD, MAX_OFF_RAD = math.radians(3.0), math.radians(150.0)  # beyond: the speed may have the wrong sign
# largest rest of sideways motion, as share of that without turns, if it is of a body ahead of the axle
MAX_REST_BY_TURNS = 0.7
MAX_REVERSE_SHARE = 0.1  # largest ratio of steps that are reverse in pose and speed to those reverse in speed only


class OdometryMotion(NamedTuple):
    """Motion given by an odometry topic."""

    keep: Mask  # (n,) readings used
    twist: Array  # (k-1, 3) forward, left [m], turn [rad] between the readings used
    spikes: int
    notes: tuple[str, ...]
    doubt: str = ""  # why the motion is impossible for a robot


def pose_and_speed(stream: Stream, settings: WheelSettings) -> Array:
    """Read (n, 5) x, y [m], yaw [rad], forward speed [m/s], turning rate [rad/s]; missing values are zero.

    Raises LocfuseError if a steering angle needs a wheelbase that is not configured.
    """
    kind = stream.msgtype
    columns = arrays(stream, *BODY_READS[kind])
    values = np.zeros((len(stream.t_ns), 5))
    if kind in POSE:
        x, y, *q = (columns[name].astype(np.float64) for name in POSE[kind])
        values[:, :3] = np.stack((x, y, se2.yaw(*se2.turning_only(np.stack(q, axis=-1)).T)), axis=-1)
    if kind in PLANAR:
        values[:, :3] = np.stack([columns[name] for name in PLANAR[kind]], axis=-1)
    if kind in SPEED:
        values[:, 3:] = np.stack([columns[name] for name in SPEED[kind]], axis=-1)
    if kind in STEERED:
        speed, steered = (columns[name].astype(np.float64) for name in STEERED[kind])
        values[:, 3] = speed
        if settings.steering == "heading":
            values[:, :3] = _poses_by_heading(stream.t_ns * np.float64(1e-9), speed, steered)
        elif settings.steering == "rate":
            values[:, 4] = steered
        else:
            values[:, 4] = speed * np.tan(steered) / wheelbase_of(stream, settings)
    return values


def has_pose(msgtype: str, settings: WheelSettings) -> bool:
    """Return whether messages of this type have poses, or speed and heading, which can be integrated to poses."""
    return msgtype in POSE or msgtype in PLANAR or (msgtype in STEERED and settings.steering == "heading")


def _poses_by_heading(t: Array, speed: Array, heading: Array) -> Array:
    """Integrate poses (n, 3) from speeds [m/s] and headings [rad] at times t (n,) [s], along arcs.

    An arc of length s that turns by d has the chord s sin(d / 2) / (d / 2), in the direction of the mean heading.
    """
    finite = np.isfinite(speed) & np.isfinite(heading)
    out = np.full((len(t), 3), np.nan)
    t, speed, heading = t[finite], speed[finite], heading[finite]
    arc = 0.5 * (speed[1:] + speed[:-1]) * np.diff(t)
    turn = se2.wrap_all(np.diff(heading))
    chord, middle = arc * np.sinc(turn / (2.0 * np.pi)), heading[:-1] + 0.5 * turn
    steps = np.stack((chord * np.cos(middle), chord * np.sin(middle)), axis=-1)
    places = totals(steps)[: len(t)]
    out[finite] = np.column_stack((places, heading))
    return out


def commanded(topic: str, msgtype: str) -> bool:
    """Return whether a topic has commands instead of measurements, by its name and type.

    Odometry messages are always measurements: /husky_velocity_controller/odom.
    """
    name = topic.lower()
    if msgtype in STEERED and not any(word in name for word in MEASURED):
        return True
    return msgtype not in (ODOMETRY, TRANSFORM) and any(word in name for word in COMMANDED)


def obeyed(t: Array, speeds: Array) -> tuple[Array, Array]:
    """Return the motion of a body that obeys commands (n, 2) of speed [m/s] and rate [rad/s] at times t (n,) [s].

    A command lasts until the next one, at most MAX_HOLD_S; then the body is at rest. Returns times (m,) and the
    twists (m-1, 3) between them.
    """
    span = np.diff(t)
    lasts = np.minimum(span, MAX_HOLD_S)
    twist = np.stack((speeds[:-1, 0] * lasts, np.zeros_like(lasts), speeds[:-1, 1] * lasts), axis=-1)
    ended = np.flatnonzero(lasts < span)
    times: Array = np.insert(t, ended + 1, t[ended] + MAX_HOLD_S)
    return times, np.insert(twist, ended + 1, 0.0, axis=0)


def wheelbase_of(stream: Stream, settings: WheelSettings) -> float:
    """Return the configured distance between the axles [m]. Raises LocfuseError if there is none."""
    if not settings.wheelbase or settings.wheelbase <= 0.0:
        raise LocfuseError(
            f"{stream.topic} gives a steering angle, so the distance between the axles must be known.",
            role="wheels",
            hint="Set it with --set wheels.wheelbase=<metres>, or say what it holds instead: "
            "--set wheels.steering=rate (rad/s) or heading (rad)",
        )
    return settings.wheelbase


def travelled(
    t: Array, values: Array, by_twist: bool, max_speed: float | None, posed: bool = True
) -> OdometryMotion:
    """Return the motion by an odometry's values (n, 5): x, y [m], yaw [rad], speed [m/s], turning rate [rad/s].

    The steps are those of the poses; with `by_twist`, a negative speed marks a step as backwards. If the position
    never changes, or in coarse steps, the speeds are integrated. `posed` is whether the messages have a pose.
    """
    useless, turns = _useless(t, values) if posed else ("", False)
    placed = posed and not useless
    if useless and turns:
        values = np.column_stack((_poses_by_heading(t, values[:, 3], values[:, 2]), values[:, 3:]))
    elif not placed:
        notes = (f"its {useless}: its twist is used",) if posed else ()
        keep = possible(values[:, 3:], max_speed)
        return OdometryMotion(keep, _integrated(t[keep], values[keep, 3:]), int((~keep).sum()), notes)
    values, words = along_the_way(t, values)
    two = in_turn(values[:, :2])
    bad = spikes(t, values[:, :2], _limits(t, values, max_speed))
    rows = np.flatnonzero(~bad)
    distance = np.cumsum(np.hypot(*np.diff(values[rows, :2], axis=0, prepend=values[rows[:1], :2]).T))
    held = held_readings(t[rows], distance, max_speed)
    longest = gap_limit(t)
    for first, last in stretches(held):  # a pose that is sent two or three times is a slow one
        if t[rows[last]] - t[rows[first]] < longest:
            held[first : last + 1] = False
    still = held_note("its pose", t[rows], held)
    t, values = t[rows[~held]], values[rows[~held]]
    twist = _steps(values)
    distance = np.hypot(twist[:, 0], twist[:, 1])
    far = distance > _limits(t, values, max_speed)
    check_limit(far, distance / np.diff(t), max_speed)
    doubt = TWO_SOURCES if two else unlike_a_robot(t, twist, far)
    steps = without_restarts(t, twist, far)
    # over a gap the speeds at its ends do not give the distance
    by_speed = 0.5 * (values[1:, 3] + values[:-1, 3]) * np.where(np.diff(t) > gap_limit(t), 0.0, np.diff(t))
    in_frame = bool(by_speed.any()) and along_the_frame(steps[:, 0], np.diff(values[:, 0]), by_speed)
    backing = backing_up(steps, by_speed) if by_twist and not in_frame else np.zeros(len(steps), dtype=bool)
    steps[backing, :2] *= -1.0
    words += [f"its {useless}: its speed is used along its heading"] if useless else []
    words += ["its speeds are given along the axes of its poses, not of the body: not used"] if in_frame else []
    words += still
    words += jump_notes("its pose", int(bad.sum()), "jumped", [f"at {at:.1f} s" for at in t[1:][far].tolist()])
    if n := int(backing.sum()):
        words.append(
            f"its pose moves forward in {n} steps while its velocity says reverse; they are taken as reverse "
            "(wheels.reverse_by_twist=false keeps them)"
        )
    used = ~bad
    used[rows[held]] = False
    return OdometryMotion(used, steps, int(bad.sum()), tuple(words), doubt)


def _useless(t: Array, values: Array) -> tuple[str, bool]:
    """Return why poses (n, 5) are useless beside their speeds, "" if they are not; and whether they turn.

    The position never changes, or is rounded to a coarse grid; or the heading never changes although it turns.
    """
    dt, speeds, turns = np.diff(t), np.abs(values[1:, 3:]), bool(np.ptp(values[:, 2]) > 0.0)
    if not speeds.any():
        return "", turns
    steps = np.abs(np.diff(values[:, :2], axis=0))
    if not steps.any():
        return f"{'position' if turns else 'pose'} never changes", turns
    if not turns and float(dt @ speeds[:, 1]) > MIN_UNSEEN_TURN_RAD:
        return "heading never changes", False
    steps, driven = steps[steps > MIN_STEP_M], (dt * speeds[:, 0])[speeds[:, 0] > 0.0]
    if len(steps) < MIN_GRID_STEPS or not len(driven):
        return "", turns
    grid = float(steps.min())
    coarse = grid > max(
        MIN_GRID_M, MIN_GRID_RATIO * float(np.median(driven))
    )  # a robot at a constant speed has equal steps
    coarse &= float(np.abs(steps / grid - np.round(steps / grid)).max()) < MAX_OFF_GRID
    return (f"position changes in steps of {grid:.2g} m" if coarse else ""), turns


def unlike_a_robot(t: Array, twist: Array, far: Mask) -> str:
    """Return the reason why no robot can move by the steps `twist` (n-1, 3); "" if a robot can.

    `far` (n-1,) marks steps that are too long, t (n,) are the times [s].
    """
    dt = np.diff(t)
    dt = np.maximum(dt, np.median(dt)) if len(dt) else dt  # dt may be tiny in a burst of messages
    sideways = float(np.percentile(np.abs(twist[:, 1]) / dt, 95.0)) if len(dt) else 0.0
    if sideways > MAX_SIDEWAYS_MPS:
        return f"it moves sideways at {sideways:.0f} m/s: its heading is not that of the body"
    jumps = float(np.mean(far & (np.hypot(twist[:, 0], twist[:, 1]) > MAX_JUMP_MPS * dt))) if len(dt) else 0.0
    if jumps > MAX_JUMPS_SHARE:
        return f"{jumps:.0%} of its steps are jumps at more than {MAX_JUMP_MPS:.0f} m/s"
    return ""


def along_the_way(t: Array, values: Array) -> tuple[Array, list[str]]:
    """Return an odometry's values (n, 5) with headings along its path, and notes on what was changed.

    Some drivers give y or the headings the wrong sign, or headings that are off by a constant angle: the path is a
    mirror image of the headings, or goes aside although the speed is ahead.
    """
    step = np.diff(values[:, :2] @ (1.0, 1.0j))
    moving = np.abs(step) > MIN_STEP_M
    if not moving.any():
        return values, []
    by_speed = (0.5 * np.diff(t) * (values[1:, 3] + values[:-1, 3]))[moving]
    middle = (values[:-1, 2] + 0.5 * se2.wrap_all(np.diff(values[:, 2])))[moving]
    step, size = step[moving], np.abs(step[moving])
    weights = np.minimum(size, MAX_STEP_RATIO * float(np.median(size)))  # limits the effect of jumps
    weights /= weights.sum()
    own, other = (way / size * np.exp(-1.0j * middle) for way in (step, step.conj()))
    measured = float(np.abs(np.abs(by_speed) - size) @ (weights / size)) < MAX_SPEED_MISFIT
    straight = complex(other**2 @ weights)  # 1: along the x axis, if y had the other sign; -1: along the y axis
    mirror = abs(own**2 @ weights) < abs(straight) - MIN_MIRROR_GAIN
    mirror &= (abs(straight) if measured else straight.real) > MIN_ALONG
    ahead = complex((other if mirror else own) * np.sign(by_speed) @ weights)
    off = float(np.angle(ahead)) if measured and abs(ahead) > MIN_ALONG else 0.0
    if off:  # a body ahead of the axle moves aside too, but only in turns
        turn = se2.wrap_all(np.diff(values[:, 2]))[moving]
        A = (np.sqrt(weights) / size)[:, None] * np.stack((by_speed, 1.0j * turn), axis=-1)
        y = np.sqrt(weights) * (other if mirror else own)
        alone, both = (np.linalg.lstsq(A[:, :k], y)[0] for k in (1, 2))
        rest, left = (float(np.linalg.norm(y - A[:, : len(x)] @ x)) for x in (alone, both))
        off = float(np.angle(both[0])) if left < MAX_REST_BY_TURNS * rest else off
    off, words = off if MIN_OFF_RAD < abs(off) < MAX_OFF_RAD else 0.0, []
    values = values + np.array([0.0, 0.0, off, 0.0, 0.0])
    if off:
        words.append(f"it drives {math.degrees(off):.0f}° aside of its headings: they are turned by that")
    if mirror:  # the turning rates show which of both is right
        turned = se2.wrap_all(np.diff(values[:, 2])) @ (values[1:, 4] + values[:-1, 4])
        values = values * ((1.0, 1.0, -1.0, 1.0, 1.0) if turned < 0.0 else (1.0, -1.0, 1.0, 1.0, 1.0))
        side = "its headings are" if turned < 0.0 else "y is"
        words.append(f"its path is a mirror image of its headings: {side} taken with the other sign")
    return values, words


def on_base(twist: Array, x: float, y: float) -> Array:
    """Return the base's motion (n, 3) from that of a body at x, y [m] on it, with the base's directions.

    The body's speed is v + omega x r. Where no step goes sideways, only speeds ahead are given.
    """
    ahead, left, turn = twist.T
    return np.stack((ahead + y * turn, left - x * turn if left.any() else left, turn), axis=-1)


def backing_up(steps: Array, by_speed: Array) -> Mask:
    """Mark steps (n-1, 3) that go forward by the poses but backward by the speeds: `by_speed` (n-1,) [m] < 0.

    Marks no step if the speeds disagree with most steps, or if the poses have reverse motion too: then the
    disagreement has another reason.
    """
    ahead = steps[:, 0]
    moving = (np.abs(ahead) > MIN_STEP_M) & (np.abs(by_speed) > MIN_STEP_M)
    wrong = moving & (by_speed < 0.0) & (ahead > 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.abs(by_speed / ahead)
    agrees = moving & (ratio < MAX_STEP_RATIO) & (ratio > 1.0 / MAX_STEP_RATIO)
    forward = moving & (by_speed > 0.0) & (ahead > 0.0)
    reverse = moving & (by_speed < 0.0) & (ahead < 0.0)
    reliable = agrees.sum() >= MIN_AGREEING_SHARE * moving.sum() and forward.sum() > wrong.sum()
    no_reverse = reverse.sum() <= MAX_REVERSE_SHARE * wrong.sum()
    return (by_speed < 0.0) & (ahead > 0.0) & bool(reliable and no_reverse and wrong.any())


def along_the_frame(ahead: Array, dx: Array, by_speed: Array) -> bool:
    """Return whether speeds are along the x axis of the poses' frame, instead of the body's (REP 103).

    `by_speed` (n,) [m] is the distance by the speeds; `ahead` and `dx` are the poses' distances forward and along
    x.
    """
    most = MAX_STEP_RATIO * np.maximum(np.abs(by_speed), np.abs(ahead))  # limits the effect of jumps
    distances = dx, np.copysign(ahead, by_speed)
    in_frame, in_body = (float(np.minimum(np.abs(distance - by_speed), most).sum()) for distance in distances)
    return in_frame < MAX_FRAME_SHARE * in_body and in_body > MIN_BODY_MISFIT * float(np.abs(by_speed).sum())


def _steps(values: Array) -> Array:
    step = se2.between(values[:-1, :3], values[1:, :3])
    step[:, 2] = se2.wrap_all(step[:, 2])
    return se2.log(step)


def _limits(t: Array, values: Array, max_speed: float | None) -> Array:
    return limits(t, np.hypot(*np.diff(values[:, :2], axis=0).T), max_speed)


def possible(speeds: Array, max_speed: float | None) -> Mask:
    """Mark pairs (n, 2) of speed [m/s] and turning rate [rad/s] that are possible for a body.

    Raises LocfuseError as `check_limit`.
    """
    fast = np.abs(speeds[:, 0]) > (MAX_SPEED_MPS if max_speed is None else max_speed)
    check_limit(fast, speeds[:, 0], max_speed)
    return ~fast & (np.abs(speeds[:, 1]) <= MAX_TURN_RADPS)


def _integrated(t: Array, speeds: Array) -> Array:
    """Return twists (n-1, 3) from speeds and turning rates (n, 2) at times t (n,): the trapezoidal rule."""
    dt = np.diff(t)
    ds, turn = (0.5 * (speeds[1:, i] + speeds[:-1, i]) * dt for i in (0, 1))
    return np.stack((ds, np.zeros_like(ds), turn), axis=-1)
