"""The size of a noise of known shape: restricted likelihood with linear nuisance parameters.

e_i = X_i p + noise, noise ~ N(0, s Q_i + T_i), p ~ N(0, P0): p is integrated out, so that what p explains is not
counted as noise (Patterson and Thompson 1971). With T = 0 and a vague prior, s is the sum of squares over its
degrees of freedom, and the interval is the chi-square one.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np

from locfuse.fusion.chi_square import chi_square
from locfuse.fusion.data import Array

CONFIDENCE = 0.95
S_BOUNDS = (1e-10, 10.0)  # where s is looked for
LN_S_TOLERANCE = 1e-6  # of ln s


class Figure(msgspec.Struct, frozen=True):
    """An estimate with its interval at CONFIDENCE."""

    value: float
    low: float
    high: float


class Residuals(msgspec.Struct, frozen=True):
    """Errors of n pieces with d components, their regressors, and their covariances."""

    e: Array  # (n, d)
    X: Array  # (n, d, p)
    Q: Array  # (n, d, d) per unit of the scale that is looked for
    T: Array  # (n, d, d) known
    prior: Array  # (p,) standard deviations of the nuisance parameters

    def parameters(self, scale: float) -> tuple[Array, Array]:
        """Return the nuisance parameters (p,) and their covariance (p, p) at a scale."""
        V = scale * self.Q + self.T
        VX = np.linalg.solve(V, self.X)
        M = np.diag(self.prior**-2.0) + np.einsum("nij,nik->jk", self.X, VX)
        b = np.einsum("nij,ni->j", VX, self.e)
        return np.linalg.solve(M, b), np.linalg.inv(M)

    def squares(self, scale: float, p: Array) -> Array:
        """Return the squared Mahalanobis distance of each piece, (n,)."""
        r = self.e - self.X @ p
        distances: Array = np.einsum("ni,ni->n", r, np.linalg.solve(scale * self.Q + self.T, r[..., None])[..., 0])
        return distances

    def ln_likelihood(self, scale: float) -> float:
        """Return ln of the likelihood of a scale, up to a constant."""
        V = scale * self.Q + self.T
        p, spread = self.parameters(scale)
        Ve = np.linalg.solve(V, self.e[..., None])[..., 0]
        explained = p @ np.linalg.solve(spread, p)
        quadratic = float((self.e * Ve).sum()) - float(explained)
        determinants = float(np.linalg.slogdet(V)[1].sum()) - float(np.linalg.slogdet(spread)[1])
        return -0.5 * (quadratic + determinants)

    def best(self) -> tuple[float, float]:
        """Return the likeliest scale, and ln of its likelihood."""
        from scipy.optimize import minimize_scalar

        bounds = tuple(map(math.log, S_BOUNDS))
        tight = {"xatol": LN_S_TOLERANCE}
        found = minimize_scalar(
            lambda x: -self.ln_likelihood(math.exp(x)), bounds=bounds, method="bounded", options=tight
        )
        return math.exp(found.x), -float(found.fun)

    def fit(self) -> tuple[Figure, float]:
        """Return the likeliest scale with its likelihood-ratio interval, and ln of its likelihood."""
        scale, top = self.best()
        low, high = (math.exp(self._edge(math.log(scale), math.log(end), top)) for end in S_BOUNDS)
        return Figure(scale, low, high), top

    def _edge(self, inside: float, outside: float, top: float) -> float:
        """Return ln of the scale, between two, at which the likelihood falls to the interval's edge."""
        from scipy.optimize import brentq

        drop = 0.5 * chi_square(CONFIDENCE, 1)
        if top - self.ln_likelihood(math.exp(outside)) <= drop:
            return outside
        edge: float = brentq(
            lambda x: top - self.ln_likelihood(math.exp(x)) - drop, inside, outside, xtol=LN_S_TOLERANCE
        )
        return edge
