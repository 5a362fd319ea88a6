"""Graph of submap poses: each submap has an anchor (its frame in the map); edges are relative poses.

Absolute measurements of an anchor's pose (compass, GPS) are edges from NOWHERE. The graph is solved by
scan_matching.solve (Lu and Milios 1997; Grisetti et al., "A tutorial on graph-based SLAM", 2010).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array
from locfuse.fusion.scan_matching.solve import NOWHERE, Edges, Problem, relative

MIN_STEP = 1e-9  # m, rad: Gauss-Newton stops after a smaller step
EXACT_VARIANCE = 1e-12  # m^2, rad^2: added to covariances, which may be zero, before inversion
MIN_EIGENVALUE = 1e-14  # least eigenvalue of a correlation matrix: smaller ones are rounding errors


class Edge(NamedTuple):
    """Pose of anchor `to` relative to anchor `of`, or relative to the map if `of` is NOWHERE."""

    of: int
    to: int
    z: Array  # (3,)
    information: Array  # (3, 3)


class Anchors:
    """Anchor poses in the map, (n, 3), and the edges between the anchors."""

    def __init__(self) -> None:
        self.pose: Array = np.zeros((0, 3))
        self.edges: list[Edge] = []
        self._P: Array | None = None  # (n, 3, n, 3) joint covariance; None after a change of the edges

    def __len__(self) -> int:
        """Return the number of anchors."""
        return len(self.pose)

    def append(self, of: int, z: Array, P: Array) -> int:
        """Add an anchor with pose z (3,) and covariance P (3, 3) relative to anchor `of`; return its index.

        If `of` is NOWHERE, the pose is relative to the map frame.
        """
        self.pose = np.vstack((self.pose, z if of == NOWHERE else se2.compose(self.pose[of], z)))
        self.add(Edge(of, len(self.pose) - 1, np.asarray(z), inverted(P)))
        return len(self.pose) - 1

    def add(self, edge: Edge) -> None:
        """Add an edge."""
        self.edges.append(edge)
        self._P = None

    def remove(self, edge: Edge) -> None:
        """Remove an edge."""
        self.edges = [e for e in self.edges if e is not edge]
        self._P = None

    def scale_covariances(self, of: int, to: int, factor: float) -> None:
        """Multiply the covariances of the edges between consecutive anchors from `of` to `to` by `factor`.

        It is chi-square over degrees of freedom, an estimate of the ratio of actual to claimed covariance.
        """
        first, last = min(of, to), max(of, to)
        self.edges = [
            e._replace(information=e.information / factor)
            if e.of != NOWHERE and e.to == e.of + 1 and first <= e.of < last
            else e
            for e in self.edges
        ]
        self._P = None

    def beside(self, node: int) -> set[int]:
        """Return the indices of the anchors that share an edge with anchor `node`."""
        edges = [e for e in self.edges if e.of != NOWHERE and node in (e.of, e.to)]
        return {e.to if e.of == node else e.of for e in edges}

    def covariance(self, node: int) -> Array:
        """Return the covariance (3, 3) of the pose of an anchor, in the map frame."""
        return self._joint()[node, :, node]

    def relative(self, of: int, to: int) -> tuple[Array, Array]:
        """Return the pose (3,) of anchor `to` relative to anchor `of`, and its covariance (3, 3)."""
        z, P = relative(self.pose, self._joint(), np.array([of]), np.array([to]))
        return z[0], P[0]

    def _joint(self) -> Array:
        """Return the joint covariance of all anchor poses, (n, 3, n, 3)."""
        if self._P is None:
            self._P = Problem().normal(self.pose, self._all_edges()).joint(np.arange(len(self.pose)))
        return self._P

    def cost(self) -> float:
        """Return the chi-square of the graph: the sum of e' Omega e over all edges."""
        return float(self._all_edges().chi2(self.pose).sum())

    def solve(self) -> None:
        """Optimise the anchor poses by least squares."""
        self.pose, normal = Problem().solve(self.pose, self._all_edges(), min_step=MIN_STEP)
        self._P = normal.joint(np.arange(len(self.pose)))

    def _all_edges(self) -> Edges:
        i, j, z, information = (np.array(column) for column in zip(*self.edges, strict=True))
        return Edges.of(i, j, z, information, np.inf)


def inverted(P: Array) -> Array:
    """Return the information matrix (3, 3) of a covariance P (3, 3) that may be singular.

    P is scaled to a correlation matrix first: the sigmas of position and heading may differ by a factor of 10^9.
    """
    P = se2.symmetric(P) + EXACT_VARIANCE * np.eye(3)
    scale = np.sqrt(np.diagonal(P))
    values, vectors = np.linalg.eigh(P / np.outer(scale, scale))
    half = vectors / np.sqrt(np.maximum(values, MIN_EIGENVALUE)) / scale[:, None]
    return np.asarray(half @ half.T, np.float64)
