"""Wheel odometry over a whole drive, with the covariance of the motion between any two update times.

The odometry error is a small rigid motion xi = (x, y, theta) in the frame of the odometry's origin, which moves
all later poses. In this form errors add, and the covariance of xi between two update times is the difference of
two sums. (Left-invariant error: Barfoot 2017, "State Estimation for Robotics", 7.3; in the plane its adjoint is
a lever arm.)
"""

from __future__ import annotations

import msgspec
import numpy as np
from msgspec.structs import replace

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Drive, Ints, Motions, totals

# m^2, rad^2 per metre driven and per radian turned: slips, uneven floors. The noise of the wheels alone is zero
# in some directions, and an error in these directions would be interpolated badly between key poses.
LEFT_OUT_VARIANCES = np.array([2e-4, 2e-4, np.radians(0.5) ** 2])


class Odometry(msgspec.Struct, frozen=True):
    """Wheel odometry at n update times: poses, and the covariance of each relative to the first."""

    pose: Array  # (n, 3) in the odometry's frame, theta not wrapped
    C: Array  # (n, 3, 3) covariance of xi since the first instant
    left_out: Array | None = None  # (3,) variances in C in addition to the wheels' noise, per metre and radian

    def path_length(self) -> Array:
        """Return the path length driven until each update time, (n,) [m]."""
        return totals(np.hypot(*np.diff(self.pose[:, :2], axis=0).T))

    def at(self, k: Ints) -> Odometry:
        """Return the odometry at the update times with indices k (m,)."""
        return Odometry(self.pose[k], self.C[k], self.left_out)

    def with_slip_noise(self) -> Odometry:
        """Add variance for slips and uneven floors (LEFT_OUT_VARIANCES), which wheel noise does not include."""
        u = se2.between(self.pose[:-1], self.pose[1:])
        more = np.cumsum(to_origin(self.pose[:-1], u, even_covariance(u, LEFT_OUT_VARIANCES)), axis=0)
        return replace(self, C=self.C + np.concatenate((np.zeros((1, 3, 3)), more)), left_out=LEFT_OUT_VARIANCES)

    def between(self, a: Ints, b: Ints) -> tuple[Array, Array]:
        """Return motions (m, 3) from update times a to b, (m,) each, and covariances of xi in the frames at a."""
        u = se2.between(self.pose[a], self.pose[b])
        return u, to_parent_frame(self.C[b] - self.C[a], se2.inverse(self.pose[a]))

    def grown(self, k: Ints, motions: Motions, wheels: Array | None) -> Odometry:
        """Return the odometry at the ends of m motions that begin at the update times k (m,).

        `wheels` are corrections of the wheel parameters, None without.
        """
        u = motions.corrected(wheels)
        pose = se2.compose(self.pose[k], u)
        Q = motions.Q if self.left_out is None else motions.Q + even_covariance(u, self.left_out)
        return Odometry(pose, self.C[k] + to_origin(self.pose[k], u, Q), self.left_out)


def odometry_of(drive: Drive, lag: float = 0.0, wheels: Array | None = None) -> Odometry:
    """Return the wheel odometry at the update times of the drive.

    `lag` [s] is added to the update times to convert them to the wheels' clock. `wheels` (3,): corrections of both
    wheel radii and the track.
    """
    motions = drive.motions
    if lag:
        t = np.clip(drive.t + lag, drive.wheels.t[0], drive.wheels.t[-1])
        motions = drive.wheels.between(np.append(t[:1], t[:-1]), t, motions.J.shape[2] > 0)
    u = motions.corrected(wheels)
    pose = se2.chain(u)
    return Odometry(pose[1:], np.cumsum(to_origin(pose[:-1], u, motions.Q), axis=0))


def even_covariance(u: Array, variances: Array) -> Array:
    """Return covariances (n, 3, 3) that grow evenly along motions u (n, 3).

    `variances` (3,) of x, y, theta are per metre driven and per radian turned.
    """
    far = np.hypot(u[:, 0], u[:, 1]) + np.abs(u[:, 2])
    return far[:, None, None] * np.diag(variances)


def to_origin(start: Array, u: Array, Q: Array) -> Array:
    """Convert covariances Q (n, 3, 3) of motions to those of the odometry error xi at the odometry's origin.

    The motions are u (n, 3) from poses `start` (n, 3). Q is the covariance of each motion's (x, y, theta) in the
    frame of its start. A small rigid motion about the start moves the end by a lever arm, which is removed first.
    """
    return to_parent_frame(add_lever_arm(Q, u[:, 1], -u[:, 0]), start)


def to_parent_frame(C: Array, frame: Array) -> Array:
    """Convert covariances C (n, 3, 3) of xi from the frames `frame` (n, 3) to the parent of these frames."""
    return add_lever_arm(se2.turned_covariance(C, frame[:, 2]), frame[:, 1], -frame[:, 0])


def add_lever_arm(C: Array, x: Array, y: Array) -> Array:
    """Return covariances C (n, 3, 3) after adding the heading error times x (n,), y (n,) [m] to x and y."""
    return se2.propagated(se2.lever(x, y), C)
