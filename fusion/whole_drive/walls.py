"""Map of the pose graph: walls seen by the key scans, placed at the key poses and merged.

If the filter did not recognise a place at once, its map has the walls there twice. This map has them once.
"""

from __future__ import annotations

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints, MapLine, Measurements

SAME_TURN_RAD, SAME_OFFSET_M, SAME_GAP_M = np.radians(4.0), 0.12, 0.5  # largest differences within one wall
MIN_SIGHTINGS = 3


def straightened(m: Measurements, readings: Ints, x: Array, P: Array) -> list[MapLine]:
    """Return the merged walls seen by readings (n,) from poses x (n, 3) with covariances P (n, 3, 3)."""
    walls = _Walls()
    for k, reading in enumerate(readings.tolist()):
        at = slice(int(m.first[reading]), int(m.first[reading + 1]))
        for z, R, ends in zip(m.z[at], m.covariances(at), m.extra["ends"][at], strict=True):
            walls.add(z, R, ends, x[k], P[k])
    return walls.lines()


class _Walls:
    """Walls merged from their sightings, as mean (rho, beta) weighted by information."""

    def __init__(self) -> None:
        self.middle = np.zeros((0, 2))
        self.beta = np.zeros(0)
        self.span = np.zeros((0, 2))  # along the tangent, from the map's origin
        self.seen: list[list[tuple[float, float, Array]]] = []  # rho, beta, covariance
        self.free: list[Array] = []

    def add(self, z: Array, R: Array, ends: Array, pose: Array, P: Array) -> None:
        """Add a sighting (r, psi) with covariance R and ends [m], seen from a pose with covariance P."""
        beta = float(z[1] + pose[2])
        n, t = np.array([np.cos(beta), np.sin(beta)]), np.array([-np.sin(beta), np.cos(beta)])
        along = float(t @ pose[:2])
        rho, span = float(z[0] + n @ pose[:2]), ends + along
        points = rho * n + span[:, None] * t
        k = self._same(beta, points)
        J = np.array([[n[0], n[1], 0.0], [0.0, 0.0, 1.0]])
        if k is None:
            k = len(self.beta)
            self.beta = np.append(self.beta, beta)
            self.middle = np.vstack((self.middle, points.mean(axis=0)))
            self.span = np.vstack((self.span, span))
            self.seen.append([])
            self.free.append(J @ P @ J.T)
        own, rho_own, beta_own = self.beta[k], rho, beta
        if np.cos(beta - own) < 0.0:
            rho_own, beta_own = -rho, beta + np.pi
        beta_own = own + se2.wrap(beta_own - own)
        self.seen[k].append((rho_own, beta_own, R))
        tangent = np.array([-np.sin(own), np.cos(own)])
        reach = points @ tangent
        self.span[k] = min(self.span[k, 0], reach.min()), max(self.span[k, 1], reach.max())

    def _same(self, beta: float, points: Array) -> int | None:
        """Return the index of the wall that a sighting belongs to; None if it is a new wall."""
        if not len(self.beta):
            return None
        turn = np.abs(se2.wrap_all(beta - self.beta))
        turn = np.minimum(turn, np.pi - turn)
        normal = np.stack((np.cos(self.beta), np.sin(self.beta)), axis=-1)
        tangent = np.stack((-normal[:, 1], normal[:, 0]), axis=-1)
        off = np.abs(((points.mean(axis=0) - self.middle) * normal).sum(axis=1))
        reach = points @ tangent.T  # (2, walls)
        gap = np.maximum(self.span[:, 0] - reach.max(axis=0), reach.min(axis=0) - self.span[:, 1])
        same = (turn < SAME_TURN_RAD) & (off < SAME_OFFSET_M) & (gap < SAME_GAP_M)
        if not same.any():
            return None
        return int(np.where(same, off, np.inf).argmin())

    def lines(self) -> list[MapLine]:
        """Return the walls with at least MIN_SIGHTINGS sightings, each the mean of its sightings."""
        found: list[MapLine] = []
        for k, seen in enumerate(self.seen):
            if len(seen) < MIN_SIGHTINGS:
                continue
            rho, beta, P = _mean(seen)
            ends = (float(self.span[k, 0]), float(self.span[k, 1]))
            if rho < 0.0:
                rho, beta, ends = -rho, beta + np.pi, (-ends[1], -ends[0])
            found.append(MapLine(len(found), rho, se2.wrap(beta), ends, P, len(seen), P + self.free[k]))
        return found


def _mean(seen: list[tuple[float, float, Array]]) -> tuple[float, float, Array]:
    """Return the weighted mean (rho, beta) and its covariance, scaled up if the sightings scatter more."""
    values = np.array([(rho, beta) for rho, beta, _ in seen])
    weights = np.array([np.linalg.inv(R) for _, _, R in seen])
    total = np.linalg.inv(weights.sum(axis=0))
    mean = total @ np.einsum("nij,nj->i", weights, values)
    off = values - mean
    chi2 = float(np.einsum("ni,nij,nj->", off, weights, off)) / max(2 * len(seen) - 2, 1)
    return float(mean[0]), float(mean[1]), total * max(chi2, 1.0)
