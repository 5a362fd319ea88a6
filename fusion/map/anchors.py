"""The graph of anchors: poses of the small maps of a building, and the edges between them.

What absolute sensors (a compass, GPS) measured of an anchor is an edge from NOWHERE. Solved from the present poses
(Lu and Milios 1997; Grisetti et al., "A tutorial on graph-based SLAM", 2010) by scan_matching.solve.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array
from locfuse.fusion.scan_matching.solve import NOWHERE, Edges, Problem, relative

MIN_STEP = 1e-9  # m, rad: a Gauss-Newton step that changes less is the last
EXACT_VARIANCE = 1e-12  # m^2, rad^2: of what is known exactly, so that it can be inverted
MIN_EIGENVALUE = 1e-14  # of a correlation: below, the numbers themselves are no better


class Edge(NamedTuple):
    """Anchor `to` relative to anchor `of`, or to the map if that is NOWHERE."""

    of: int
    to: int
    z: Array  # (3,)
    information: Array  # (3, 3)


class Anchors:
    """Poses of anchors in the map, (n, 3), and the edges between them."""

    def __init__(self) -> None:
        self.pose: Array = np.zeros((0, 3))
        self.edges: list[Edge] = []
        self._P: Array | None = None  # (n, 3, n, 3), kept until an edge comes or goes

    def __len__(self) -> int:
        """Return the number of anchors."""
        return len(self.pose)

    def first(self, pose: Array, P: Array) -> int:
        """Add an anchor with a known pose (3,) and covariance (3, 3); return its number."""
        self.pose = np.vstack((self.pose, pose))
        self.add(Edge(NOWHERE, len(self.pose) - 1, np.asarray(pose), inverted(P)))
        return len(self.pose) - 1

    def next(self, of: int, z: Array, P: Array) -> int:
        """Add an anchor at z (3,) with covariance (3, 3) relative to another one; return its number."""
        self.pose = np.vstack((self.pose, se2.compose(self.pose[of], z)))
        self.add(Edge(of, len(self.pose) - 1, np.asarray(z), inverted(P)))
        return len(self.pose) - 1

    def add(self, edge: Edge) -> None:
        """Add a relative pose of two anchors."""
        self.edges.append(edge)
        self._P = None

    def remove(self, edge: Edge) -> None:
        """Remove an edge."""
        self.edges = [e for e in self.edges if e is not edge]
        self._P = None

    def loosen(self, of: int, to: int, factor: float) -> None:
        """Multiply the covariances of all edges between two anchors by a variance factor.

        That is the variance factor of what was observed, chi-square over degrees of freedom.
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
        """Return the anchors to which an edge leads from this one."""
        edges = [e for e in self.edges if e.of != NOWHERE and node in (e.of, e.to)]
        return {e.to if e.of == node else e.of for e in edges}

    def covariance(self, nodes: tuple[int, ...]) -> Array:
        """Return the joint covariance of some anchors, (3k, 3k), in the frame of the map."""
        at, n = list(nodes), 3 * len(nodes)
        P: Array = self._joint()[at][:, :, at].reshape(n, n)
        return P

    def relative(self, of: int, to: int) -> tuple[Array, Array]:
        """Return anchor `to` relative to anchor `of`, (3,), and its covariance (3, 3)."""
        z, P = relative(self.pose, self._joint(), np.array([of]), np.array([to]))
        return z[0], P[0]

    def _joint(self) -> Array:
        """Return the covariance of all anchors, (n, 3, n, 3)."""
        if self._P is None:
            self._P = Problem().normal(self.pose, self._all_edges()).joint(np.arange(len(self.pose)))
        return self._P

    def cost(self) -> float:
        """Return the sum of e' L e over all edges."""
        return float(self._all_edges().chi2(self.pose).sum())

    def solve(self) -> None:
        """Move the anchors to the poses of least cost."""
        self.pose, normal = Problem().solve(self.pose, self._all_edges(), min_step=MIN_STEP)
        self._P = normal.joint(np.arange(len(self.pose)))

    def _all_edges(self) -> Edges:
        i, j, z, information = (np.array(column) for column in zip(*self.edges, strict=True))
        return Edges.of(i, j, z, information, np.inf)


def inverted(P: Array) -> Array:
    """Return the information (3, 3) of a covariance that may be singular, as after an exact start.

    In units of its own sigmas: where nothing is known, place and heading may be 10^9 times apart.
    """
    P = 0.5 * (P + P.T) + EXACT_VARIANCE * np.eye(3)
    scale = np.sqrt(np.diagonal(P))
    values, vectors = np.linalg.eigh(P / np.outer(scale, scale))
    half = vectors / np.sqrt(np.maximum(values, MIN_EIGENVALUE)) / scale[:, None]
    return np.asarray(half @ half.T, np.float64)
