"""Ground truth from reference poses, points, motion capture or satellite fixes; never used for estimation."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise
from shlex import quote
from typing import cast

import numpy as np

from locfuse.fusion.wheels.odometry import POSE, pose_fields
from locfuse.fusion.wheels.repairs import limits, spikes

from . import se2
from .data import Array, Column, LocfuseError, Mask, Ragged, Stream, Truth, plausible
from .geodesy import on_map
from .robot import TruthSettings
from .streams import blank, count_dropped, seconds

BODIES = "mocap4r2_msgs/msg/RigidBodies"
FIX = "sensor_msgs/msg/NavSatFix"
NO_TRUTH = "truth.topic=none"  # setting by which a truth is left out
# Types with several bodies (motion capture, Gazebo) -> the fields of the bodies' names and poses.
SEVERAL: Mapping[str, tuple[str, ...]] = {
    kind: (names, *pose_fields(pose))
    for kind, names, pose in (
        (BODIES, "rigidbodies.rigid_body_name", "rigidbodies.pose"),
        ("gazebo_msgs/msg/ModelStates", "name", "pose"),
        ("gazebo_msgs/msg/LinkStates", "name", "pose"),
    )
}
KNOWN_TRUTH = (BODIES, "gazebo_msgs/msg/ModelStates")  # types that count as truth under any topic name
POINTS: Mapping[str, tuple[str, ...]] = {
    "geometry_msgs/msg/PointStamped": ("point.x", "point.y"),
    FIX: ("latitude", "longitude"),
}
TRUTH_READS: Mapping[str, tuple[str, ...]] = {**POSE, **SEVERAL, **POINTS}
MIN_MOVED_M = 0.1  # m: a body that moves less cannot be the robot
MAX_BEND_SHARE = 0.05  # largest standard deviation across a path without bends, as share of that along it
# flips of a heading: least step, rad; fastest turn of a robot, rad/s; largest number, as share of the readings
MIN_FLIP_RAD, MAX_TURN_RADPS, MAX_FLIP_SHARE = math.radians(150.0), 5.0, 0.01
FAR_JUMP_FACTOR, MAX_AWAY_SHARE = 3.0, 0.5  # jump / largest plausible step; share of the truth by another body
TRUTH_NAMES = (  # must not match /odom or /amcl_pose
    *("ground_truth", "groundtruth", "gt", "mocap"),
    *("vicon", "optitrack", "vrpn", "qualisys", "natnet", "leica"),
)


def looks_like_truth(topic: str) -> bool:
    """Return whether the name of a topic is typical of ground truth, such as "mocap"."""
    parts = topic.lower().strip("/").replace("-", "_").split("/")
    return any(name == part or (name != "gt" and name in part) for part in parts for name in TRUTH_NAMES)


def read_truth(stream: Stream, settings: TruthSettings, epoch_ns: int) -> tuple[Truth, dict[str, int]]:
    """Return the truth with strictly increasing times, and the counts of unused readings by reason."""
    dropped = dict(stream.dropped)
    values = _values(stream, settings, dropped)
    values[:, 2:] = se2.turning_only(values[:, 2:])
    finite = plausible(values).all(axis=1)
    count_dropped(dropped, not_finite=int((~finite).sum()) - dropped.get("other_bodies", 0))
    rows = np.flatnonzero(finite)
    later = np.diff(stream.t_ns[rows], prepend=-1) > 0
    same = (values[rows] == values[np.roll(rows, 1)]).all(axis=1)
    count_dropped(dropped, repeat=~later & same, same_stamp=~later & ~same)
    rows = rows[later]
    lost = blank(values[rows, :2])
    count_dropped(dropped, zeros=lost)
    rows = rows[~lost]
    if settings.max_speed is not None and len(rows) > 2:
        t = seconds(stream.t_ns[rows], stream.t_ns[rows[0]])
        xy = values[rows, :2]
        away = elsewhere(t, xy, limits(t, np.hypot(*np.diff(xy, axis=0).T), settings.max_speed))
        count_dropped(dropped, jump=away)
        rows = rows[~away]
    if len(rows) == 0:
        words = f"{stream.topic} has no usable reading of {len(stream.t_ns)}"
        hint = f"(to judge without it: --set {NO_TRUTH})"
        raise LocfuseError(words, role="truth", fixes=(NO_TRUTH,), hint=hint)
    headings = _has_headings(values[rows])
    if w_first := headings and se2.is_about_x(values[rows, 2:]):
        values[:, 2:] = np.roll(values[:, 2:], -1, axis=1)
    theta = se2.yaw(*values[rows, 2:].T) - math.radians(settings.yaw_deg) if headings else None
    t, turned = seconds(stream.t_ns[rows], epoch_ns, settings.time_offset), 0
    if theta is not None:
        theta, turned = _turned_back(t, theta)
    return (
        Truth(
            topic=stream.topic,
            t=t,
            xy=values[rows, :2],
            theta=theta,
            point=(settings.x, settings.y),
            sigma=settings.sigma,
            sigma_theta=math.radians(settings.sigma_theta_deg),
            time_offset=settings.time_offset,
            w_first=w_first,
            turned=turned,
        ),
        dropped,
    )


def _turned_back(t: Array, theta: Array) -> tuple[Array, int]:
    """Return the headings (n,) [rad] without flips by 180 degrees, and the number of readings that were flipped.

    A tracker whose markers look the same from behind takes the front for the back. The rarer direction is wrong.
    """
    step, dt = np.abs(se2.wrap_all(np.diff(theta))), np.diff(t)
    flips = (step > MIN_FLIP_RAD) & (step > MAX_TURN_RADPS * dt)
    if not 0 < flips.sum() <= MAX_FLIP_SHARE * len(t):
        return theta, 0
    flipped = np.append(0, np.cumsum(flips)) % 2 == 1
    flipped = ~flipped if 2 * flipped.sum() > len(t) else flipped
    return theta + math.pi * flipped, int(flipped.sum())


def elsewhere(t: Array, xy: Array, limit: Array) -> Mask:
    """Mark the readings (n,) between a jump away and the next jump, if this undoes it.

    A tracker then follows another body, for as long as it hides the right one. A jump is a step between positions
    `xy` (n, 2) [m] above `limit` (n-1,) [m]. Two far jumps undo each other if both are longer than the way from
    the last reading before to the first one after. Short times are those of `spikes`.
    """
    out, size = spikes(t, xy, limit), np.hypot(*np.diff(xy, axis=0).T)
    far = (size > FAR_JUMP_FACTOR * limit) & ~(out[1:] | out[:-1])
    for away, back in pairwise(np.flatnonzero(far).tolist()):
        both = float(np.hypot(*(xy[back + 1] - xy[away])))
        short = t[back + 1] - t[away] < MAX_AWAY_SHARE * (t[-1] - t[0])
        if short and not out[away] and both < min(size[away], size[back]):
            out[away + 1 : back + 1] = True
    return out


def _has_headings(values: Array) -> bool:
    """Return whether (n, 2) or (n, 6) hold headings: a path that bends cannot have one heading throughout.

    Drivers without a heading fill in zeros or the identity.
    """
    place, quaternion = values[:, :2], values[:, 2:]
    if np.ptp(quaternion, axis=0).any():
        return True
    narrow, wide = np.linalg.eigvalsh(np.cov(place.T)).tolist() if len(place) > 1 else (0.0, 0.0)
    return bool(quaternion.any()) and narrow <= MAX_BEND_SHARE**2 * wide


def _values(stream: Stream, settings: TruthSettings, dropped: dict[str, int]) -> Array:
    """Return x, y [m] and, if recorded, a quaternion: (n, 2) or (n, 6); NaN for a row without a pose."""
    columns = stream.columns(*TRUTH_READS[stream.msgtype])
    if stream.msgtype in SEVERAL:
        return _of_body(stream.topic, columns, settings.body, dropped)
    values = np.stack([np.asarray(column, np.float64) for column in columns.values()], axis=-1)
    if stream.msgtype != FIX:
        return values
    return se2.rotated(np.array(math.radians(settings.east_deg)), on_map(values, settings.origin, "truth"))


def _of_body(topic: str, columns: dict[str, Column], body: str | None, dropped: dict[str, int]) -> Array:
    """Return the poses (n, 6) of one rigid body; NaN for messages without this body."""
    names, *fields = columns.values()
    rows = cast("list[tuple[str, ...]]", names)
    known = sorted({name for row in rows for name in row})
    if body is None and len(moving := _moving(rows, cast("list[Ragged]", fields), known)) == 1:
        body = moving[0]
    if body not in known:
        fix = f"truth.body={known[0]}" if known else ""
        problem = f"{topic} tracks {', '.join(known) or 'nothing'}" + (f", not {body}" if body is not None else "")
        hint = f"Choose one with --set {quote(fix)}" if fix else ""
        raise LocfuseError(f"{problem}.", role="truth", fixes=(fix,) if fix and len(known) == 1 else (), hint=hint)
    place = np.array([row.index(body) if body in row else -1 for row in rows])
    held = place >= 0
    count_dropped(dropped, other_bodies=~held)
    values = np.full((len(rows), len(fields)), np.nan)
    for i, column in enumerate(cast("list[Ragged]", fields)):
        values[held, i] = column.values[column.first[:-1][held] + place[held]]
    return values


def _moving(rows: list[tuple[str, ...]], fields: list[Ragged], known: list[str]) -> list[str]:
    """Return the names of the bodies that move more than MIN_MOVED_M.

    If only one body is known, it is always returned.
    """
    if len(known) == 1:
        return known
    found = []
    for body in known:
        at = [(i, row.index(body)) for i, row in enumerate(rows) if body in row]
        x, y = (np.array([column.values[column.first[i] + k] for i, k in at]) for column in fields[:2])
        away = np.hypot(x - x[0], y - y[0])
        if np.nanmax(away, initial=0.0) > MIN_MOVED_M:
            found.append(body)
    return found


def heading_notes(truth: Truth, msgtype: str) -> tuple[str, ...]:
    """Return notes on headings that messages of this type have: not recorded, flipped, or with w first."""
    order = "its quaternions turn about the x axis: read as w, x, y, z. Let its driver write x, y, z, w"
    flips = "its heading flips by 180° between two readings, as with symmetric markers"
    notes = (truth.w_first, order), (truth.turned > 0, f"{flips}: {truth.turned} readings are turned back")
    if found := tuple(words for seen, words in notes if seen):
        return found
    if truth.theta is not None or msgtype in POINTS:
        return ()
    return ("its heading never changes: only its positions are used",)


def poses_at(truth: Truth, t: Array) -> Array:
    """Return poses (n, 3) of the base at times t (n,) [s].

    For a truth without headings, they are the positions of the tracked point, with theta NaN.
    """
    if truth.theta is not None:
        return body_poses(truth, t)
    return np.stack([*(np.interp(t, truth.t, column) for column in truth.xy.T), np.full(len(t), np.nan)], axis=-1)


def body_poses(truth: Truth, t: Array) -> Array:
    """Return poses (n, 3) of the robot's base, interpolated from the truth at times t (n,) [s]; theta not wrapped.

    The truth must have headings: they convert the position of the tracked point to the position of the base.
    """
    assert truth.theta is not None
    x, y, theta = (np.interp(t, truth.t, column) for column in (*truth.xy.T, np.unwrap(truth.theta)))
    return se2.compose(np.stack((x, y, theta), axis=-1), np.array([*(-np.array(truth.point)), 0.0]))
