"""Oracles written straight from the book: slow, plain, and sharing no code with the product."""

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def wrap(a: float) -> float:
    return math.atan2(math.sin(a), math.cos(a))


def move(x: Array, u: Array) -> Array:
    """Pose x followed by the relative pose u."""
    c, s = math.cos(x[2]), math.sin(x[2])
    return np.array([x[0] + c * u[0] - s * u[1], x[1] + s * u[0] + c * u[1], x[2] + u[2]])


def numeric_jacobian(f: Callable[[Array], Array], x: Array, h: float = 1e-6) -> Array:
    """Central differences, (len(f), len(x))."""
    columns = []
    for i in range(len(x)):
        d = np.zeros(len(x))
        d[i] = h
        columns.append((f(x + d) - f(x - d)) / (2 * h))
    return np.stack(columns, axis=1)


class TextbookEkf:
    """Thrun, Burgard, Fox: Probabilistic Robotics, table 3.3, in matrices, with the Joseph form."""

    def __init__(self, x: Array, P: Array) -> None:
        self.x, self.P = x.astype(float).copy(), P.astype(float).copy()

    def predict(self, u: Array, Q: Array, J: Array | None = None, at: Sequence[int] = ()) -> None:
        """u, Q: relative pose and covariance in the frame of the start pose; the rest of the state stays.

        u may also depend on the states `at`, of which J (3, k) is the derivative.
        """
        n = len(self.x)
        if J is not None:
            u = u + J @ self.x[list(at)]
        c, s = math.cos(self.x[2]), math.sin(self.x[2])
        A = np.eye(n)
        A[0, 2] = -s * u[0] - c * u[1]
        A[1, 2] = c * u[0] - s * u[1]
        W = np.zeros((n, 3))
        W[:3] = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        if J is not None:
            A[:3, list(at)] += W[:3] @ J
        self.x[:3] = move(self.x[:3], u)
        self.P = A @ self.P @ A.T + W @ Q @ W.T

    def correct(self, y: Array, H: Array, R: Array, kept: Sequence[int] = ()) -> None:
        """States that are kept are considered: Schmidt's gain is zero for them."""
        S = H @ self.P @ H.T + R
        K = self.P @ H.T @ np.linalg.inv(S)
        K[list(kept)] = 0.0
        self.x = self.x + K @ y
        J = np.eye(len(self.x)) - K @ H
        self.P = J @ self.P @ J.T + K @ R @ K.T


# --- split and merge as the textbook has it: recursive, point by point, no batches. An oracle, not a product


def correlated(rng: np.random.Generator, n: int, keep: float, d: int = 1) -> Array:
    """Series of unit variance (n, d) whose neighbours correlate by `keep`: AR(1)."""
    out = rng.normal(size=(n, d))
    for k in range(1, n):
        out[k] = keep * out[k - 1] + math.sqrt(1.0 - keep**2) * out[k]
    return out


def split(points: Array, tolerance: Array, start: int = 0) -> list[int]:
    """Return where the straight pieces of points (k, 2) start: cut at the farthest point from the chord."""
    (x0, y0), (x1, y1) = points[0], points[-1]
    length = math.hypot(x1 - x0, y1 - y0)
    worst, at = 1.0, 0
    for i in range(1, len(points) - 1):
        x, y = points[i]
        off = abs((x1 - x0) * (y - y0) - (y1 - y0) * (x - x0)) / length / tolerance[i]
        if off > worst:
            worst, at = off, i
    if not at:
        return [start]
    return split(points[:at], tolerance[:at], start) + split(points[at:], tolerance[at:], start + at)


def misfit(points: Array, weights: Array) -> float:
    """Weighted sum of squared distances to the best line: the smallest singular value, squared."""
    centred = points - np.average(points, axis=0, weights=weights)
    return float(np.linalg.svd(centred * np.sqrt(weights)[:, None], compute_uv=False)[-1] ** 2) * (len(points) > 1)


def merge(points: Array, weights: Array, starts: list[int], limit: float) -> list[int]:
    """Join the two neighbours that are most nearly one line, again and again, while that costs under `limit`."""
    starts = [*starts, len(points)]

    def square(a: int, b: int) -> float:
        return misfit(points[starts[a] : starts[b]], weights[starts[a] : starts[b]])

    while len(starts) > 2:
        pairs = range(len(starts) - 2)
        cost = [square(i, i + 2) - square(i, i + 1) - square(i + 1, i + 2) for i in pairs]
        best = int(np.argmin(cost))
        if cost[best] >= limit:
            break
        del starts[best + 1]
    return starts[:-1]
