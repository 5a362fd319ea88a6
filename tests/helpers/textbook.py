"""Oracles written straight from the book: slow, plain, and sharing no code with the product."""

from __future__ import annotations

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
