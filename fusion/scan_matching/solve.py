"""Pose-graph solver: sparse Gauss-Newton with a direct factorisation (Dellaert and Kaess 2006).

The variables are poses (x, y, theta) in the map, then states of sensors. An edge measures pose j in the frame of
pose i: e = between(x_i, x_j) - z with a wrapped angle; its information is in the frame of pose i. An edge with i =
NOWHERE measures the pose in the map: e = x_j - z.
"""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints, LocfuseError

from .match import Columns

NOWHERE = -1  # index i of an edge that starts at the origin of the map
MAX_STEPS, STEPS_BETWEEN = 10, 2  # most Gauss-Newton steps with the last kernel width; with each before
MIN_STEP = 1e-4  # m, rad: Gauss-Newton stops after a smaller step
COLUMNS_AT_ONCE = 384  # columns of the covariance computed at once, to save memory
# prior standard deviations of the systematic errors of a drive: heading drift along the path, and yaw error of the
# laser mount (by which the robot seems to move sideways). Without these states the map would be bent
SYSTEMATIC_SIGMAS = (np.radians(0.1), np.radians(1.0))  # rad per metre; rad


class Edges(Columns, frozen=True):
    """Edges (m) of a pose graph: relative poses, each with a robust kernel of `width` [sigmas]; inf: none."""

    i: Ints  # (m,)
    j: Ints  # (m,)
    z: Array  # (m, 3) pose j in the frame of pose i
    information: Array  # (m, 3, 3) in the frame of i
    width: Array  # (m,)
    by: Array  # (m, 3, 2) derivative of z by the systematic errors of the drive (SYSTEMATIC_SIGMAS)

    @classmethod
    def none(cls) -> Edges:
        """Return an empty table of edges."""
        nothing = np.zeros(0, np.int64)
        return cls.of(nothing, nothing, np.zeros((0, 3)), np.zeros((0, 3, 3)), np.inf)

    @classmethod
    def of(cls, i: Ints, j: Ints, z: Array, information: Array, width: float) -> Edges:
        """Return edges with one kernel `width` [sigmas]. Their z do not depend on the systematic errors."""
        return cls(i, j, z, information, np.full(len(i), width), np.zeros((len(i), 3, len(SYSTEMATIC_SIGMAS))))

    @classmethod
    def known(cls, j: int, pose: Array, information: Array) -> Edges:
        """Return a prior on pose j, as an edge from NOWHERE."""
        return cls.of(np.array([NOWHERE]), np.array([j]), pose[None], information[None], np.inf)

    def errors(self, x: Array, systematic: Array | None = None) -> Array:
        """Return the errors e (m, 3) of all edges, for poses x (n, 3) and systematic errors (2,) of wheels."""
        e: Array = se2.between(self._from(x), x[self.j]) - self.z
        if systematic is not None:
            e += self.by @ systematic
        e[:, 2] = se2.wrap_all(e[:, 2])
        return e

    def chi2(self, x: Array, systematic: Array | None = None) -> Array:
        """Return the squared error e' Omega e of every edge, (m,)."""
        e = self.errors(x, systematic)
        return np.asarray(np.einsum("ni,nij,nj->n", e, self.information, e))

    def weights(self, x: Array, systematic: Array | None = None, graduation: float = 1.0) -> Array:
        """Return Geman-McClure weights (m,); the kernel is convex for a large `graduation` (Yang et al. 2020)."""
        c2 = graduation * self.width**2
        with np.errstate(invalid="ignore"):
            w = (c2 / (c2 + self.chi2(x, systematic))) ** 2
        return np.where(np.isfinite(self.width), w, 1.0)

    def jacobians(self, x: Array) -> tuple[Array, Array]:
        """Return the derivatives of e by pose i and by pose j, (m, 3, 3) each."""
        by_i, by_j = se2.between_jacobians(self._from(x), x[self.j])
        by_i[self.i == NOWHERE] = 0.0
        return by_i, by_j

    def _from(self, x: Array) -> Array:
        """Return the poses (m, 3) at which the edges start; zero for NOWHERE."""
        return np.where((self.i == NOWHERE)[:, None], 0.0, x[self.i])


def chi2_of(poses: Array, expected: Array, P: Array) -> Array:
    """Return the squared Mahalanobis distances (n,) of poses (n, 3) from `expected` (3,).

    P (3, 3) or (n, 3, 3) are the covariances of the differences.
    """
    off = se2.difference(poses, expected)
    return np.asarray(np.einsum("ni,nij,nj->n", off, np.broadcast_to(np.linalg.inv(P), (len(off), 3, 3)), off))


class Summands(msgspec.Struct, frozen=True):
    """Summands of the normal equations H dx = g from terms that are not edges.

    They are linearised at the present poses.
    """

    at: Ints  # (k, d) state columns of each block; blocks at equal columns are added
    H: Array  # (k, d, d)
    g: Array  # (k, d) right side: H dx = g


def _not_fixed(n: int, why: str) -> LocfuseError:
    """Return the error that the matches of scans do not determine the n poses."""
    return LocfuseError(f"the matches of scans do not fix the {n} poses of the whole drive ({why})")


class Normal:
    """Factorised normal equations at poses x and systematic errors s; they give steps and covariances.

    The state has the poses (3 n), the systematic errors (2), and the states of other sensors.
    """

    def __init__(
        self, x: Array, s: Array, edges: Edges, weights: Array, rows: list[Summands], states: int
    ) -> None:
        from scipy.sparse import coo_matrix
        from scipy.sparse.linalg import splu

        n = 3 * len(x) + len(s) + states
        e, Omega = edges.errors(x, s), edges.information * weights[:, None, None]
        at = [3 * np.maximum(edges.i, 0)[:, None] + np.arange(3), 3 * edges.j[:, None] + np.arange(3)]
        at.append(np.broadcast_to(3 * len(x) + np.arange(len(s)), (len(edges), len(s))))
        J = np.concatenate((*edges.jacobians(x), edges.by), axis=2)
        JO = J.transpose(0, 2, 1) @ Omega
        prior = np.diag(1.0 / np.square(SYSTEMATIC_SIGMAS))
        rows = [
            Summands(np.hstack(at), JO @ J, -np.einsum("nij,nj->ni", JO, e)),
            Summands(3 * len(x) + np.arange(len(s))[None], prior[None], -(prior @ s)[None]),
            *rows,
        ]
        self.g, self.n = np.zeros(n), n
        data, down, across = [], [], []
        for block in rows:
            self.g += np.bincount(block.at.ravel(), block.g.ravel(), n)
            data.append(block.H.ravel())
            down.append(np.repeat(block.at, block.at.shape[1], axis=1).ravel())
            across.append(np.tile(block.at, (1, block.at.shape[1])).ravel())
        where = (np.concatenate(down), np.concatenate(across))
        H = coo_matrix((np.concatenate(data), where), shape=(n, n)).tocsc()
        how = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
        try:
            self._lu = splu(H, **how)
        except RuntimeError as singular:
            raise _not_fixed(len(x), "the normal equations are singular") from singular

    def step(self) -> Array:
        """Return the Gauss-Newton step (n,) of the state."""
        return np.asarray(self._lu.solve(self.g))

    def columns(self, poses: Ints) -> Array:
        """Return the columns (n, 3 k) of the covariance that belong to the poses with indices (k,)."""
        at = (3 * poses[:, None] + np.arange(3)).ravel()
        unit = np.zeros((self.n, len(at)))
        unit[at, np.arange(len(at))] = 1.0
        return np.asarray(self._lu.solve(unit))

    def joint(self, poses: Ints) -> Array:
        """Return the joint covariance (k, 3, k, 3) of the poses with indices (k,)."""
        at = (3 * poses[:, None] + np.arange(3)).ravel()
        found, few = np.empty((len(at), len(at))), COLUMNS_AT_ONCE // 3
        for first in range(0, len(poses), few):  # all columns at once would take hundreds of MB
            found[:, 3 * first : 3 * (first + few)] = self.columns(poses[first : first + few])[at]
        return found.reshape(len(poses), 3, len(poses), 3)

    def chain(self, n: int) -> tuple[Array, Array]:
        """Return the covariances of poses (n, 3, 3), and those between each pose and the next one (n - 1, 3, 3).

        Raises LocfuseError if a variance is not positive.
        """
        own, after = np.empty((n, 3, 3)), np.empty((max(n - 1, 0), 3, 3))
        for first in range(0, n, COLUMNS_AT_ONCE // 3):
            last = min(first + COLUMNS_AT_ONCE // 3, n)
            found = self.columns(np.arange(first, last)).reshape(self.n, last - first, 3)
            for k in range(first, last):
                own[k] = found[3 * k : 3 * k + 3, k - first]
                if k + 1 < n:
                    after[k] = found[3 * k + 3 : 3 * k + 6, k - first].T
        if not (np.diagonal(own, axis1=1, axis2=2) > 0.0).all():
            raise _not_fixed(n, "a variance is not positive")
        return 0.5 * (own + own.transpose(0, 2, 1)), after


def relative(x: Array, joint: Array, i: Ints, j: Ints) -> tuple[Array, Array]:
    """Return poses j (c,) relative to poses i (c,), (c, 3), and their covariances (c, 3, 3).

    `joint` (n, 3, n, 3) is the joint covariance of the poses x (n, 3).
    """
    A, B = se2.between_jacobians(x[i], x[j])
    At, Bt = A.transpose(0, 2, 1), B.transpose(0, 2, 1)
    mixed = A @ joint[i, :, j, :] @ Bt
    P = A @ joint[i, :, i, :] @ At + B @ joint[j, :, j, :] @ Bt + mixed + mixed.transpose(0, 2, 1)
    return se2.between(x[i], x[j]), P


class Problem:
    """Pose-graph problem for several solves: prior on the start, other sensors, and systematic errors.

    `others` (whole_drive.others) has terms that are not edges, with their own states.
    """

    def __init__(self, start: Edges | None = None, others: Any = None) -> None:
        self.start, self.others = Edges.none() if start is None else start, others
        self.systematic = np.zeros(len(SYSTEMATIC_SIGMAS))

    def solve(
        self, x: Array, edges: Edges, graduations: tuple[float, ...] = (1.0,), min_step: float = MIN_STEP
    ) -> tuple[Array, Normal]:
        """Return the least-squares poses (n, 3), found from poses x (n, 3), and the normal equations there.

        `graduations` are factors on the kernel widths that are used one after another; the last is 1.
        """
        x, n, edges = x.copy(), 3 * len(x), Edges.joined(self.start, edges)
        for graduation in graduations:
            for _ in range(MAX_STEPS if graduation == graduations[-1] else STEPS_BETWEEN):
                step = self._normal(x, edges, graduation).step()
                x += step[:n].reshape(-1, 3)
                self.systematic = self.systematic + step[n : n + len(SYSTEMATIC_SIGMAS)]
                if self.others is not None:
                    self.others.move(step[n + len(SYSTEMATIC_SIGMAS) :])
                if np.abs(step[:n]).max() < min_step:
                    break
        return x, self._normal(x, edges, graduations[-1])

    def normal(self, x: Array, edges: Edges) -> Normal:
        """Return the normal equations at poses x (n, 3), without solving."""
        return self._normal(x, Edges.joined(self.start, edges), 1.0)

    def _normal(self, x: Array, edges: Edges, graduation: float) -> Normal:
        rows, states = ([], 0) if self.others is None else (self.others.rows(x), self.others.states)
        weights = edges.weights(x, self.systematic, graduation)
        return Normal(x, self.systematic, edges, weights, rows, states)
