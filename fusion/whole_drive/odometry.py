"""Dead reckoning over a whole drive, with its covariance between any two instants by subtraction.

The error of a way is written as a small rigid motion xi = (x, y, theta) seen from the odometry's origin, which
moves all of the way behind it: so errors add, and the covariance of xi between two instants is a difference of
two sums. (Left-invariant error: Barfoot 2017, "State Estimation for Robotics", 7.3; in the plane its adjoint is
a lever arm.)
"""

from __future__ import annotations

import msgspec
import numpy as np
from msgspec.structs import replace

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Drive, Ints, Motions

# m^2, rad^2 per metre driven and per radian turned: slips, uneven floors. The wheels' own noise leaves directions
# out, and a bridge that has to end where they cannot lead would swing wide.
LEFT_OUT_VARIANCES = np.array([2e-4, 2e-4, np.radians(0.5) ** 2])


class Odometry(msgspec.Struct, frozen=True):
    """The wheels' motion at n instants: poses, and covariances relative to the first."""

    pose: Array  # (n, 3) in the odometry's frame, theta not wrapped
    C: Array  # (n, 3, 3) covariance of xi since the first instant
    left_out: Array | None = None  # (3,) what C holds beside the wheels' own noise, per metre and radian

    def way(self) -> Array:
        """Distance driven until each instant, (n,) [m]."""
        return np.append(0.0, np.cumsum(np.hypot(*np.diff(self.pose[:, :2], axis=0).T)))

    def at(self, k: Ints) -> Odometry:
        """Return the odometry at some of the instants, k (m,)."""
        return Odometry(self.pose[k], self.C[k], self.left_out)

    def loosened(self) -> Odometry:
        """Return the odometry with variances added for errors that the wheels' own noise does not include."""
        u = se2.between(self.pose[:-1], self.pose[1:])
        more = np.cumsum(at_origin(self.pose[:-1], u, evenly(u, LEFT_OUT_VARIANCES)), axis=0)
        return replace(self, C=self.C + np.concatenate((np.zeros((1, 3, 3)), more)), left_out=LEFT_OUT_VARIANCES)

    def scaled(self, share: float) -> Odometry:
        """Return the same odometry with its covariance multiplied by `share`."""
        return replace(self, C=share * self.C)

    def between(self, a: Ints, b: Ints) -> tuple[Array, Array]:
        """Return the motions from instants a to b (m,), (m, 3), and the covariances of xi about the pose at a."""
        u = se2.between(self.pose[a], self.pose[b])
        return u, moved(self.C[b] - self.C[a], se2.inverse(self.pose[a]))

    def grown(self, k: Ints, motions: Motions, wheels: Array | None) -> Odometry:
        """Return the odometry after further motions: motion i begins at instant k[i], k (m,)."""
        u = motions.u if wheels is None else motions.u + motions.J @ wheels
        pose = se2.compose(self.pose[k], u)
        Q = motions.Q if self.left_out is None else motions.Q + evenly(u, self.left_out)
        return Odometry(pose, self.C[k] + at_origin(self.pose[k], u, Q), self.left_out)


def odometry_of(drive: Drive, lag: float = 0.0, wheels: Array | None = None) -> Odometry:
    """Return the wheels' motion at the drive's instants.

    `lag` [s] is added to the instants before the wheels are asked. `wheels` (3,): corrections of scales and track.
    """
    motions = drive.motions
    if lag:
        t = np.clip(drive.t + lag, drive.wheels.t[0], drive.wheels.t[-1])
        motions = drive.wheels.between(np.append(t[:1], t[:-1]), t, motions.J.shape[2] > 0)
    u = motions.u if wheels is None else motions.u + motions.J @ wheels
    pose = dead_reckoned(u)
    before = np.concatenate((pose[:1], pose[:-1]))
    return Odometry(pose, np.cumsum(at_origin(before, u, motions.Q), axis=0))


def dead_reckoned(u: Array) -> Array:
    """Return the poses (n, 3) after motions u (n, 3), one after another from (0, 0, 0)."""
    theta = np.cumsum(u[:, 2])
    step = se2.rotated(np.append(0.0, theta[:-1]), u[:, :2])
    return np.column_stack((np.cumsum(step, axis=0), theta))


def evenly(u: Array, variances: Array) -> Array:
    """Return covariances (n, 3, 3) of motions u (n, 3), proportional to distance and turn, by variances (3,)."""
    far = np.hypot(u[:, 0], u[:, 1]) + np.abs(u[:, 2])
    return far[:, None, None] * np.diag(variances)


def at_origin(start: Array, u: Array, Q: Array) -> Array:
    """Return Q of motions u (n, 3) from poses `start` (n, 3) as covariances of xi at the odometry's origin.

    Q is that of the motion's end as it is seen from its start: first its lever about the end is taken back.
    """
    return moved(at_start(u, Q), start)


def at_start(u: Array, Q: Array) -> Array:
    """Return Q (n, 3, 3) of motions u (n, 3), converted from numbers at the end to rigid motions at the start."""
    return by_lever(Q, u[:, 1], -u[:, 0])


def moved(C: Array, frame: Array) -> Array:
    """Return covariances C (n, 3, 3) of xi about a frame as those about the parent of that `frame` (n, 3)."""
    R = se2.rotation(frame[:, 2])
    return by_lever(R @ C @ R.transpose(0, 2, 1), frame[:, 1], -frame[:, 0])


def by_lever(C: Array, x: Array, y: Array) -> Array:
    """Return C with the heading error's effect on the place added, for a lever (x, y) [m]."""
    L = np.broadcast_to(np.eye(3), C.shape).copy()
    L[:, 0, 2], L[:, 1, 2] = x, y
    out: Array = L @ C @ L.transpose(0, 2, 1)
    return out
