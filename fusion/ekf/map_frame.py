"""The map frame as three static states: where the local frame of a run lies in the map.

What a map is built from never says where north is, or where the start was. So a growing map gets a frame of its
own, which begins at its first scan: there the local pose q is exactly zero, and G = (X, Y, Th) takes over what the
pose was and how uncertain. Wheels, laser, sonar and gyro observe q and the lines only. The pose in the map is

    p = G o q = (X + c qx - s qy, Y + s qx + c qy, Th + qt),    c, s of Th
    dp/dq = J_q = diag(R(Th), 1)
    dp/dG = J_G = [[1, 0, -ry], [0, 1, rx], [0, 0, 1]],    (rx, ry) = R(Th) (qx, qy)

and what observes p (compass, bearing, GPS) observes both by the chain rule: H_q = H J_q, H_G = H J_G. A filter
whose lines and pose stand in the map itself gains information about Th that no scan has (Julier and Uhlmann 2001;
Huang, Mourikis, Roumeliotis 2010; docs/trust.md). Compare robocentric maps (Castellanos et al. 2007).
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.core.filter import bent
from locfuse.fusion.data import Array
from locfuse.fusion.sensor import Matrix, PoseRows

Pose = tuple[float, float, float]
Triangle = tuple[float, float, float, float, float, float]  # xx, xy, xt, yy, yt, tt
Floats = list[list[float]]


class Together(NamedTuple):
    """The local pose and the map frame, with their covariances."""

    q: Pose
    G: Pose
    P: Triangle  # of q
    across: Floats  # cov(q, G), (3, 3)
    own: Floats  # cov(G, G), (3, 3)


class Framed(Protocol):
    """A belief whose pose is local."""

    frame: int | None  # first column of G in the state

    @property
    def theta(self) -> float:
        """Heading of q."""

    def frame_pose(self) -> Pose | None:
        """Return G, None where the local frame is the map."""

    def located(self, in_map: bool = False) -> tuple[Pose, Triangle]:
        """Return the pose, local or that in the map, and its covariance's upper triangle."""

    def by_local(self, H: tuple[float, float, float]) -> list[float]:
        """Return the derivative (6,) by q and G of what has the derivative H by the pose in the map."""

    def block(self, name: str) -> tuple[int, Any]:
        """Return (first state column, values) of a block."""

    def spread(self, H: Any, columns: Any = (), H_block: Any = ()) -> Matrix:
        """Return H P H' for derivatives by q and by state columns."""


class InMap:
    """A belief with a map frame as sensors see it that observe the pose in the map.

    By the chain rule, which stands in `core.filter.by_local`.
    """

    __slots__ = ("_belief", "_first")

    def __init__(self, belief: Any) -> None:
        self._belief: Framed = belief
        self._first: int = belief.frame

    def __getattr__(self, name: str) -> Any:
        """Return what does not depend on the pose: covariance, correct, transform ..."""
        return getattr(self._belief, name)

    @property
    def x(self) -> float:
        """X of the pose in the map [m]."""
        return self.pose()[0]

    @property
    def y(self) -> float:
        """Y of the pose in the map [m]."""
        return self.pose()[1]

    @property
    def theta(self) -> float:
        """Heading of the pose in the map [rad], not wrapped."""
        together = self._belief.frame_pose()
        return self._belief.theta + (together[2] if together is not None else 0.0)

    def pose(self) -> Pose:
        """Return the pose in the map, G o q."""
        return self.located()[0]

    def triangle(self) -> Triangle:
        """Return the upper triangle of the covariance of the pose in the map."""
        return self.located()[1]

    def located(self) -> tuple[Pose, Triangle]:
        """Return the pose in the map and its covariance's triangle."""
        return self._belief.located(in_map=True)

    def matrix(self) -> Array:
        """Return the covariance of the pose in the map, (3, 3)."""
        xx, xy, xt, yy, yt, tt = self.triangle()
        return np.array([[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]])

    def block(self, name: str) -> tuple[int, Any]:
        """Return (first state column, values) of a block."""
        return self._belief.block(name)

    def spread(self, H: PoseRows, columns: tuple[int, ...] = (), H_block: Matrix = ()) -> Matrix:
        """Return H P H' (d, d), H by the pose in the map."""
        return self.observed(H, columns, H_block)[0]

    def observed(
        self, H: PoseRows, columns: tuple[int, ...] = (), H_block: Matrix = ()
    ) -> tuple[Matrix, PoseRows, tuple[int, ...], Matrix]:
        """Return H P H', and the derivatives by q, blocks and G for those by the pose in the map and blocks."""
        first = self._first
        if len(H) == 1 and not H[0][0] and not H[0][1]:  # a heading: linear, and without a lever
            columns, H_block = (*columns, first + 2), ((*(H_block[0] if H_block else ()), H[0][2]),)
            return self._belief.spread(H, columns, H_block), H, columns, H_block
        rows = [self._belief.by_local(h) for h in H]
        by_q = tuple([(a, b, t) for a, b, t, *_ in rows])
        H_block = tuple([(*own, *row[3:]) for own, row in zip(H_block or ((),) * len(H), rows, strict=True)])
        columns = (*columns, first, first + 1, first + 2)
        return self._belief.spread(by_q, columns, H_block), by_q, columns, H_block


def in_map_P(G: Array, q: Array, P: Array) -> Array:
    """Return covariances (n, 3, 3) of G o q from those of (q, G), (n, 6, 6): `core.filter.locate` in NumPy."""
    J = np.concatenate((se2.rotation(G[:, 2]), by_frame(G, q)), axis=2)
    r = se2.rotated(G[:, 2], q[:, :2])
    out: Array = J @ P @ J.transpose(0, 2, 1)
    e = np.array([bent(tt) for tt in P[:, 5, 5].tolist()])
    out[:, :2, :2] += e[:, None, None] * r[:, :, None] * r[:, None, :]
    return out


def by_frame(G: Array, q: Array) -> Array:
    """Return J_G = d(G o q)/dG, (n, 3, 3)."""
    r = se2.rotated(G[:, 2], q[:, :2])
    J = np.zeros((len(G), 3, 3))
    J[:] = np.eye(3)
    J[:, 0, 2], J[:, 1, 2] = -r[:, 1], r[:, 0]
    return J
