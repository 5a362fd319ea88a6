"""Map frame as three static states: the pose of the local frame of a run in the map.

The scans of a growing map do not measure absolute position or heading. So a growing map gets its own frame, which
begins at the first scan: there the local pose q is exactly zero, and G = (X, Y, Th) gets the pose and its
covariance. Wheels, laser, sonar and gyro measure only q and the lines. The pose in the map is

    p = G o q = (X + c qx - s qy, Y + s qx + c qy, Th + qt),    c, s of Th
    dp/dq = J_q = diag(R(Th), 1)
    dp/dG = J_G = [[1, 0, -ry], [0, 1, rx], [0, 0, 1]],    (rx, ry) = R(Th) (qx, qy)

and sensors that measure p (compass, bearing, GPS) measure both by the chain rule: H_q = H J_q, H_G = H J_G. A
filter with lines and pose directly in the map gains information about Th that scans do not have (Julier and
Uhlmann 2001; Huang, Mourikis, Roumeliotis 2010; docs/trust.md). Compare robocentric maps (Castellanos et al.
2007).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array
from locfuse.fusion.kernels.ekf import bent

Pose = tuple[float, float, float]
Triangle = tuple[float, float, float, float, float, float]  # xx, xy, xt, yy, yt, tt


class InMap:
    """View of a belief with its pose in the map, for sensors that measure this pose (chain rule: State.derive)."""

    def __init__(self, belief: Any) -> None:
        self.belief, self.column, self.value = belief, belief.column, belief.value
        self.pose: Callable[[], Pose] = belief.pose_in_map
        self.compare = partial(belief.compare, in_map=True)
        self.variance = partial(belief.variance, in_map=True)

    def __getattr__(self, name: str) -> Any:
        """Return attributes of the belief that do not depend on the frame (covariance, block, ...)."""
        return getattr(self.belief, name)

    @property
    def x(self) -> float:
        """Return the x coordinate of the pose in the map [m]."""
        return self.pose()[0]

    @property
    def y(self) -> float:
        """Return the y coordinate of the pose in the map [m]."""
        return self.pose()[1]

    @property
    def theta(self) -> float:
        """Return the heading in the map [rad], not wrapped."""
        return self.pose()[2]


def map_covariance(G: Array, q: Array, P: Array) -> Array:
    """Return the covariances (n, 3, 3) of poses G o q in the map; P (n, 6, 6) is the covariance of (q, G)."""
    J = np.concatenate((se2.rotation(G[:, 2]), pose_by_frame(G, q)), axis=2)
    r = se2.rotated(G[:, 2], q[:, :2])
    out = se2.propagated(J, P)
    e = np.array([bent(tt) for tt in P[:, 5, 5].tolist()])
    out[:, :2, :2] += e[:, None, None] * r[:, :, None] * r[:, None, :]
    return out


def pose_by_frame(G: Array, q: Array) -> Array:
    """Return the derivative J_G = d(G o q)/dG, (n, 3, 3)."""
    r = se2.rotated(G[:, 2], q[:, :2])
    return se2.lever(-r[:, 1], r[:, 0])
