"""Reading wheels: joint angles, ticks, or another odometry's poses become one chain of body motion."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, cast

import numpy as np

from .data import Array, Ints, LocfuseError, Ragged, Stream
from .motion import Wheels
from .robot import VIRTUAL_TRACK, WheelSettings

ODOMETRY = (
    "pose.pose.position.x",
    "pose.pose.position.y",
    "pose.pose.orientation.x",
    "pose.pose.orientation.y",
    "pose.pose.orientation.z",
    "pose.pose.orientation.w",
    "twist.twist.linear.x",
    "twist.twist.angular.z",
)
# In order of preference: angles of the wheels before somebody else's dead reckoning.
WHEEL_READS: Mapping[str, tuple[str, ...]] = {
    "sensor_msgs/msg/JointState": ("name", "position"),
    "nav_msgs/msg/Odometry": ODOMETRY,
}


def read_wheels(stream: Stream, settings: WheelSettings) -> tuple[Wheels, int, dict[str, int]]:
    """Return the wheel motion, the drive's epoch (its first reading, ns), and what was dropped by reason."""
    columns = stream.columns(*WHEEL_READS[stream.msgtype])
    dropped = dict(stream.dropped)
    if stream.msgtype == "nav_msgs/msg/Odometry":
        values = _odometry(cast("dict[str, Array]", columns))
    else:
        values = _joints(columns, stream, settings)
    keep = _usable(stream.t_ns, values, dropped)
    if len(keep) < 2:
        raise LocfuseError(
            f"wheels: {stream.topic} has {len(keep)} usable readings of {len(stream.t_ns)}; two are the least"
        )
    epoch_ns = int(stream.t_ns[keep[0]]) + round(settings.time_offset * 1e9)
    t = (stream.t_ns[keep] - stream.t_ns[keep[0]]) * 1e-9
    values = values[keep]
    if stream.msgtype == "nav_msgs/msg/Odometry":
        track = settings.track or VIRTUAL_TRACK
        return _from_odometry(t, values, track, settings.noise), epoch_ns, dropped
    radius, track = _geometry(settings, stream)
    turn = 2.0 * math.pi / settings.ticks_per_revolution if settings.ticks_per_revolution else 1.0
    rolled = radius * turn * values
    return Wheels.from_wheels(t, rolled[:, 0], rolled[:, 1], track, settings.noise), epoch_ns, dropped


def _geometry(settings: WheelSettings, stream: Stream) -> tuple[float, float]:
    missing = [key for key in ("radius", "track") if getattr(settings, key) is None]
    if missing:
        raise LocfuseError(
            f"wheels: {stream.topic} gives wheel angles, "
            f"so wheels.{' and wheels.'.join(missing)} must be known. "
            f"Set them in robot.toml or with --set wheels.{missing[0]}=<metres>"
        )
    radius, track = float(settings.radius or 0.0), float(settings.track or 0.0)
    if radius <= 0.0 or track <= 0.0:
        raise LocfuseError(f"wheels: radius {radius:g} m and track {track:g} m must both be positive")
    return radius, track


def _usable(t_ns: Ints, values: Array, dropped: dict[str, int]) -> Ints:
    """Return the rows that are finite and later than the row before; count the others."""
    finite = np.isfinite(values).all(axis=1)
    if not finite.all():
        dropped["not_finite"] = dropped.get("not_finite", 0) + int((~finite).sum())
    rows = np.flatnonzero(finite)
    if len(rows) == 0:
        return rows
    # of several readings with one stamp the last one counts: a repeat carries the newest value
    last = np.append(t_ns[rows[1:]] > t_ns[rows[:-1]], True)
    same = (values[rows[1:]] == values[rows[:-1]]).all(axis=1) & ~last[:-1]
    repeats, clashes = int(same.sum()), int((~last[:-1] & ~same).sum())
    if repeats:
        dropped["repeat"] = dropped.get("repeat", 0) + repeats
    if clashes:
        dropped["same_stamp"] = dropped.get("same_stamp", 0) + clashes
    usable: Ints = rows[last]
    return usable


def _joints(columns: Mapping[str, Any], stream: Stream, settings: WheelSettings) -> Array:
    """Return (n, 2) left, right wheel positions; NaN in messages that lack them. Matched by name only."""
    names, positions = columns["name"], cast("Ragged", columns["position"])
    left, right = _joint_names(names, stream, settings)
    out = np.full((len(names), 2), np.nan)
    at: dict[tuple[str, ...], list[int]] = {}
    for i, row in enumerate(names):
        at.setdefault(row, []).append(i)
    lengths = positions.lengths
    for row, where in at.items():
        rows = np.array(where)
        for side, joint in enumerate((left, right)):
            if joint in row:
                k = row.index(joint)
                ok = rows[lengths[rows] > k]
                out[ok, side] = positions.values[positions.first[ok] + k]
    neither = np.isnan(out).all(axis=1)
    if neither.all():
        raise LocfuseError(f"wheels: no message on {stream.topic} holds a position of {left} or {right}")
    return out


def _joint_names(names: list[tuple[str, ...]], stream: Stream, settings: WheelSettings) -> tuple[str, str]:
    """Return the joints of the left and right wheel: as set, else the only pair whose names say so."""
    known = sorted({joint for row in set(names) for joint in row})
    found = []
    for side, given in (("left", settings.left), ("right", settings.right)):
        if given is not None:
            if given not in known:
                raise LocfuseError(
                    f"wheels: {stream.topic} has no joint {given!r}; it has {', '.join(known) or 'none'}. "
                    f"Name one with --set wheels.{side}=<joint>"
                )
            found.append(given)
            continue
        guesses = [j for j in known if side in j.lower()]
        guesses = [j for j in guesses if "wheel" in j.lower()] or guesses
        if len(guesses) != 1:
            what = "several joints are" if guesses else "no joint is"
            raise LocfuseError(
                f"wheels: {what} named like the {side} wheel on {stream.topic} "
                f"({', '.join(known) or 'no joints'}). Name it with --set wheels.{side}=<joint>"
            )
        found.append(guesses[0])
    return found[0], found[1]


def _odometry(columns: Mapping[str, Array]) -> Array:
    """Return (n, 5) x, y, yaw, forward speed, turning rate of an Odometry topic."""
    x, y, z, w = (columns[f"pose.pose.orientation.{a}"] for a in "xyzw")
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    position = (columns["pose.pose.position.x"], columns["pose.pose.position.y"])
    return np.stack((*position, yaw, columns["twist.twist.linear.x"], columns["twist.twist.angular.z"]), axis=-1)


def _from_odometry(t: Array, values: Array, track: float, noise: float) -> Wheels:
    """Use the poses' increments; the twist only where the pose never changes."""
    poses, twist = values[:, :3], values[:, 3:]
    if np.ptp(poses, axis=0).max() > 0.0 or not twist.any():
        return Wheels.from_poses(t, poses, track, noise)
    dt = np.diff(t)
    ds, turn = (0.5 * (twist[1:, i] + twist[:-1, i]) * dt for i in (0, 1))
    left, right = ds - 0.5 * track * turn, ds + 0.5 * track * turn
    return Wheels.from_wheels(t, np.append(0.0, np.cumsum(left)), np.append(0.0, np.cumsum(right)), track, noise)
