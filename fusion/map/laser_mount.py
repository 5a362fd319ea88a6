"""A laser with an uncertain mount: its lines in the base by the estimated mount, and their added covariance.

A line (r, psi) in the base frame follows from the laser's own one and the mount (x, y, yaw) by psi = psi_L + yaw,
r = r_L + x cos(psi) + y sin(psi). So what is predicted for the laser's reading depends on the mount by

    d(r, psi)/d(x, y, yaw) = [[-cos(psi), -sin(psi), x sin(psi) - y cos(psi)], [0, 0, -1]]

at the measured psi, in which this is exact. (At the predicted one the wheels' error in heading would enter, which
goes with their error in distance: y came out wrong by k / (2 dtheta), 8 mm.) Derivatives by pose and line stay.
"""

from __future__ import annotations

import math

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.ekf.map_frame import Pose
from locfuse.fusion.kernels.sight import Seat
from locfuse.fusion.mount import Mount


def seat_of(mount: Mount | None, belief: JointBelief) -> Seat:
    """Return the laser's mount for the kernel: its configured values, and which of them are states."""
    if mount is None:
        return Seat(np.zeros(3), np.zeros(0, np.intp), np.zeros(0, np.intp))
    columns = np.array(mount.columns(belief), np.intp)
    return Seat(np.array(mount.told, np.float64), np.array(mount.free, np.intp), columns)


def by_mount(mount: Mount, belief: JointBelief, psi: float) -> Array:
    """Return the derivative of a predicted line at psi [rad, base frame] by the mount's states, (2, f)."""
    x, y, _ = mount.now(belief)
    c, s = math.cos(psi), math.sin(psi)
    whole = np.array(((-c, -s, x * s - y * c), (0.0, 0.0, -1.0)))
    chosen: Array = whole[:, list(mount.free)]
    return chosen


def moved_mount(mount: Mount, belief: JointBelief) -> Pose:
    """Return the motion from the base by the configured mount to that by the estimated mount."""
    x, y, yaw = se2.compose(np.array(mount.now(belief)), se2.inverse(np.array(mount.told))).tolist()
    return x, y, yaw
