"""Roll and pitch of the robot from an IMU, to project a magnetic field onto the horizontal plane.

In most places the earth's field is inclined by 60 degrees and more: a degree of roll turns a heading by two
degrees. The vertical direction comes from the IMU's orientation if it has one, else from gravity and turning rates
by a complementary filter (Mahony, Hamel and Pflimlin 2008, without its integral term):

    u' = -w x u + (a / |a| - u) / T,    T = 5 s

with the up direction u in the IMU's axes, the rates w minus their median, and the accelerations a. If u changes by
less than 3 degrees, the field is not rotated.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from locfuse.fusion.data import Array, Block, Column, Ints, Stream, interpolate
from locfuse.fusion.se2 import rotated_3d
from locfuse.fusion.streams import arrays

IMU = "sensor_msgs/msg/Imu"
FIELD = "sensor_msgs/msg/MagneticField"
AXES = "xyz"
ORIENTATION = tuple(f"orientation.{a}" for a in "xyzw")
RATES = tuple(f"angular_velocity.{a}" for a in AXES)
ACCELERATIONS = tuple(f"linear_acceleration.{a}" for a in AXES)
READS = (*ORIENTATION, "orientation_covariance", *RATES, "angular_velocity_covariance", *ACCELERATIONS)
MIN_TILT_RAD = math.radians(3.0)  # a robot tilts if 5 % of the readings are tilted by more than this
MAX_APART_RAD = math.radians(25.0)  # between measured and configured up: with more the mount is wrong
SETTLING_S = 5.0  # T above: an acceleration of the robot that lasts a second has a fifth of its full effect
STEP_S = 0.02  # readings are averaged over this time
MAX_GRAVITY_DEVIATION = 0.1  # largest relative difference of gravity from the usual acceleration
MIN_UP_CHANGE = 1e-9  # an orientation is constant if its up direction changes by less
MAX_STEP_S = 0.5  # longest step over which rates are integrated: after a longer gap the filter restarts


class Tilt(NamedTuple):
    """Vertical direction over time, in the base frame."""

    t_ns: Ints  # (n,)
    up: Array  # (n, 3) unit vectors in the base's axes
    words: str  # how it was measured (orientation or gravity), and the topic


class LevelledField:
    """A magnetometer's stream with the vertical direction `up` (n, 3) for each reading."""

    def __init__(self, stream: Stream, tilt: Tilt) -> None:
        self.topic, self.msgtype, self.frame_id = stream.topic, stream.msgtype, stream.frame_id
        self.t_ns, self.dropped = stream.t_ns, stream.dropped
        self._stream = stream
        zero = self.t_ns[0] if len(self.t_ns) else 0
        t, at = (self.t_ns - zero) * 1e-9, (tilt.t_ns - zero) * 1e-9
        up = interpolate(t, at, tilt.up)
        self.up: Array = up / np.linalg.norm(up, axis=1, keepdims=True)  # (n, 3) in the base's axes
        degrees = math.degrees(float(np.quantile(_angles_to(self.up, np.array([0.0, 0.0, 1.0])), 0.95)))
        self.note = f"the robot tilts by up to {degrees:.0f}° by {tilt.words}: the field is levelled by that"

    def columns(self, *fields: str) -> dict[str, Column]:
        """Return columns of the magnetometer's stream, by field name."""
        return self._stream.columns(*fields)

    def blocks(self, *fields: str, rows: int = 256) -> Iterator[Block]:
        """Yield the magnetometer's readings in blocks."""
        yield from self._stream.blocks(*fields, rows=rows)


def tilt_of(stream: Stream, R: Array) -> Tilt | None:
    """Return the vertical direction in the base frame over time, by an IMU; None if the robot hardly tilts.

    R (3, 3) is the rotation from IMU axes to base axes. Also None if the IMU has neither an orientation nor
    accelerations and rates, or if up contradicts the configured mount (`locfuse info` reports that).
    """
    columns = arrays(stream, *READS)
    up, words = by_orientation(columns), "the orientation"
    if up is None:
        up, words = by_gravity(stream.t_ns, columns), "gravity and turning rates"
    if up is None:
        return None
    good = np.isfinite(up).all(axis=1)
    t_ns, up = stream.t_ns[good], up[good] @ R.T
    if not len(t_ns):
        return None
    middle = np.median(up, axis=0)
    if middle[2] < 0.0:  # the axes are north, east, down, or gravity has the opposite sign
        up, middle = -up, -middle
    vertical = np.array([0.0, 0.0, 1.0])
    size = float(np.linalg.norm(middle))
    if size < 0.5 or _angles_to(middle[None] / size, vertical)[0] > MAX_APART_RAD:
        return None
    moves = float(np.quantile(_angles_to(up, middle / size), 0.95))
    return Tilt(t_ns, up, f"{words} of {stream.topic}") if moves > MIN_TILT_RAD else None


def levelled(m: Array, up: Array) -> tuple[Array, Array]:
    """Return the horizontal components (n,), forward and left, of fields (n, 3) given in the base frame.

    Forward is the base's x axis, projected onto the horizontal plane. So the heading is the yaw, for any roll and
    pitch.
    """
    ahead = np.array([1.0, 0.0, 0.0]) - up[:, :1] * up
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    left = np.cross(up, ahead)
    return (m * ahead).sum(axis=1), (m * left).sum(axis=1)


def by_orientation(columns: dict[str, Array]) -> Array | None:
    """Return up directions (n, 3) in the IMU frame by its orientation; None if it is missing or constant."""
    q = np.stack([columns[name] for name in ORIENTATION], axis=-1).astype(np.float64)
    none = (columns["orientation_covariance"][:, 0] == -1.0) | ~((q**2).sum(axis=1) >= 0.25)
    if none.all():
        return None
    up = rotated_3d(q * np.array([-1.0, -1.0, -1.0, 1.0]), np.array([0.0, 0.0, 1.0]))
    up[none] = np.nan
    return up if float(np.nanmax(np.nanmax(up, axis=0) - np.nanmin(up, axis=0))) > MIN_UP_CHANGE else None


def by_gravity(t_ns: Ints, columns: dict[str, Array]) -> Array | None:
    """Return up (n, 3) in the IMU frame from accelerations and turning rates; None if either is missing."""
    vectors = ([columns[name] for name in names] for names in (ACCELERATIONS, RATES))
    a, w = (np.stack(axes, axis=-1).astype(np.float64) for axes in vectors)
    good = np.isfinite(a).all(axis=1) & np.isfinite(w).all(axis=1)
    if not good.any() or (columns["angular_velocity_covariance"][good, 0] == -1.0).all() or not w[good].any():
        return None
    strength = np.linalg.norm(a[good], axis=1)
    usual = float(np.median(strength))
    if usual <= 0.0:
        return None
    t = (t_ns[good] - t_ns[0]) * 1e-9
    first = np.flatnonzero(np.diff(np.floor(t / STEP_S), prepend=-1.0))
    n = np.diff(np.append(first, len(t)))
    ts, a, w = t[first], np.add.reduceat(a[good], first) / n[:, None], np.add.reduceat(w[good], first) / n[:, None]
    up, bias = np.median(a, axis=0), np.median(w, axis=0)  # the bias of the rates about horizontal axes
    up /= max(float(np.linalg.norm(up)), 1e-9)
    found = _complementary(ts, a, w - (bias - (bias @ up) * up), usual)
    out = np.full((len(t_ns), 3), np.nan)
    out[good] = interpolate(t, ts, found)
    return out


def _complementary(t: Array, a: Array, w: Array, usual: float) -> Array:
    """Return up (n, 3) by a complementary filter; accelerations far from gravity's strength are not used."""
    x, y, z = (float(v) for v in np.median(a[t < t[0] + MAX_STEP_S], axis=0) / usual)
    found = []
    before = float(t[0])
    for now, (ax, ay, az), (wx, wy, wz) in zip(t.tolist(), a.tolist(), w.tolist(), strict=True):
        dt = now - before
        before = now
        size = math.sqrt(ax * ax + ay * ay + az * az)
        is_gravity = abs(size / usual - 1.0) < MAX_GRAVITY_DEVIATION
        if dt > MAX_STEP_S and is_gravity:
            x, y, z = ax, ay, az
        else:
            x, y, z = x - (wy * z - wz * y) * dt, y - (wz * x - wx * z) * dt, z - (wx * y - wy * x) * dt
            if is_gravity:
                share = dt / (SETTLING_S + dt)
                x, y, z = x + share * (ax / size - x), y + share * (ay / size - y), z + share * (az / size - z)
        length = math.sqrt(x * x + y * y + z * z) or 1.0
        x, y, z = x / length, y / length, z / length
        found.append((x, y, z))
    return np.array(found)


def _angles_to(up: Array, middle: Array) -> Array:
    """Return the angles (n,) [rad] between unit vectors (n, 3) and one unit vector (3,)."""
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(up, middle), axis=1), up @ middle))
