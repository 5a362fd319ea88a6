"""The graph of anchors: where the small maps of a building lie, by what leads from one to another.

Every edge says that anchor j, seen from anchor i, lies at z with information L (in the frame of anchor i):

    e = (inverse(x_i) o x_j) - z,    cost = sum e' L e,    theta wrapped

What absolute sensors (a compass, GPS) said of an anchor is an edge from nowhere: e = x_j - z. Gauss-Newton from
the poses as they stand (Lu and Milios 1997; Grisetti et al., "A tutorial on graph-based SLAM", 2010); covariances
are blocks of the inverse of its normal matrix.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints

STEPS, ENOUGH = 20, 1e-9  # Gauss-Newton steps at most; m, rad: a step that changes no more is the last
EXACT = 1e-12  # m^2, rad^2: variance of what is known exactly, so that it can be inverted
LEAST = 1e-14  # of the eigenvalues of a correlation: below, the numbers themselves are no better
NOWHERE = -1


class Edge(NamedTuple):
    """Anchor `to` seen from anchor `of`, or from the map where that is NOWHERE."""

    of: int
    to: int
    z: Array  # (3,)
    information: Array  # (3, 3)


class Anchors:
    """Poses of anchors in the map, (n, 3), and the edges between them."""

    def __init__(self) -> None:
        self.pose: Array = np.zeros((0, 3))
        self.edges: list[Edge] = []
        self._P: Array | None = None  # (3n, 3n), kept until an edge comes or goes

    def __len__(self) -> int:
        """Return the number of anchors."""
        return len(self.pose)

    def first(self, pose: Array, P: Array) -> int:
        """Add an anchor that is known by itself, pose (3,) with covariance (3, 3); return its number."""
        self.pose = np.vstack((self.pose, pose))
        self.add(Edge(NOWHERE, len(self.pose) - 1, np.asarray(pose), inverted(P)))
        return len(self.pose) - 1

    def next(self, of: int, z: Array, P: Array) -> int:
        """Add an anchor that is seen from another one at z (3,) with covariance (3, 3); return its number."""
        self.pose = np.vstack((self.pose, se2.compose(self.pose[of], z)))
        self.add(Edge(of, len(self.pose) - 1, np.asarray(z), inverted(P)))
        return len(self.pose) - 1

    def add(self, edge: Edge) -> None:
        """Add what is known of two anchors."""
        self.edges.append(edge)
        self._P = None

    def remove(self, edge: Edge) -> None:
        """Take back an edge."""
        self.edges = [e for e in self.edges if e is not edge]
        self._P = None

    def loosen(self, of: int, to: int, factor: float) -> None:
        """Multiply the covariances of all edges along the way between two anchors by the factor that it was worse.

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
        joint = np.asarray(np.linalg.inv(self._normal()[0]), np.float64) if self._P is None else self._P
        self._P = joint
        at = np.concatenate([np.arange(3 * k, 3 * k + 3) for k in nodes])
        P: Array = joint[np.ix_(at, at)]
        return P

    def relative(self, of: int, to: int) -> tuple[Array, Array]:
        """Return where anchor `to` is seen from anchor `of`, (3,), and its covariance (3, 3)."""
        J = np.hstack(se2.between_jacobians(self.pose[of], self.pose[to]))
        return se2.between(self.pose[of], self.pose[to]), J @ self.covariance((of, to)) @ J.T

    def cost(self) -> float:
        """Return the sum of e' L e over all edges."""
        e = self.errors()
        return float(np.einsum("ni,nij,nj->", e, np.array([edge.information for edge in self.edges]), e))

    def errors(self) -> Array:
        """Return by how much the poses contradict each edge, (edges, 3)."""
        return self._contradictions()[3]

    def _contradictions(self) -> tuple[Ints, Array, Ints, Array]:
        """Return of all edges the anchor they start from, its pose, the anchor they lead to, and the error."""
        of, to = np.array([(edge.of, edge.to) for edge in self.edges]).T
        seen_from = np.where((of == NOWHERE)[:, None], 0.0, self.pose[of])
        e: Array = se2.between(seen_from, self.pose[to]) - np.array([edge.z for edge in self.edges])
        e[:, 2] = se2.wrap_all(e[:, 2])
        return of, seen_from, to, e

    def solve(self) -> None:
        """Move the anchors to where the edges are contradicted least."""
        for _ in range(STEPS):
            A, b = self._normal()
            step = np.linalg.solve(A, b).reshape(-1, 3)
            self.pose = self.pose + step
            if np.abs(step).max() < ENOUGH:
                break
        self._P = None

    def _normal(self) -> tuple[Array, Array]:
        """Return the normal equations A dx = b, (3n, 3n) and (3n,)."""
        n = 3 * len(self.pose)
        A, b = np.zeros((n, n)), np.zeros(n)
        of, seen_from, to, e = self._contradictions()
        L = np.array([edge.information for edge in self.edges])
        J_of, J_to = se2.between_jacobians(seen_from, self.pose[to])
        J_of[of == NOWHERE] = 0.0  # so that its rows and columns, those of the last anchor, add nothing
        at = 3 * np.stack((of, to), axis=-1)[:, :, None] + np.arange(3)  # (edges, 2, 3)
        rows = at.reshape(len(at), 6) % n
        JL = np.concatenate((J_of, J_to), axis=2).transpose(0, 2, 1) @ L
        np.add.at(A, (rows[:, :, None], rows[:, None, :]), JL @ np.concatenate((J_of, J_to), axis=2))
        np.add.at(b, rows, -np.einsum("nij,nj->ni", JL, e))
        return A, b


def inverted(P: Array) -> Array:
    """Return the information (3, 3) of a covariance that may be singular, as after an exact start.

    In units of its own sigmas: where nothing is known, place and heading may be 10^9 times apart.
    """
    P = 0.5 * (P + P.T) + EXACT * np.eye(3)
    scale = np.sqrt(np.diagonal(P))
    values, vectors = np.linalg.eigh(P / np.outer(scale, scale))
    half = vectors / np.sqrt(np.maximum(values, LEAST)) / scale[:, None]
    return np.asarray(half @ half.T, np.float64)
