"""Equations of the filter by their numbers in the paper: 5-7 (predict) and 10-12 (correct), in NumPy.

They are used where speed does not matter: prediction at the truth's stamps, smoother, tuning. The filter
(`kernels.ekf.State`) has the same equations written out. State x = (x, y, theta) [m, m, rad] in the map, followed
by other states. Leading axes (...) are allowed everywhere. The paper's W (eq. 8) and Q (eq. 9) are for wheel
speeds. Here u and Q are the relative pose of one motion and its covariance, in the frame at its start
(fusion.wheels.motion), so W is the rotation of (x, y, theta) by theta.
"""

from __future__ import annotations

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array


def eq5_x(x: Array, u: Array) -> Array:
    """Eq. 5 (eq. 3 with exact arcs): poses (..., 3) after the relative poses u (..., 3); theta is not wrapped."""
    return se2.compose(x, u)


def eq6_P(P: Array, A: Array, W: Array, Q: Array) -> Array:
    """Eq. 6: P <- A P A' + W Q W', all (..., 3, 3)."""
    return se2.propagated(A, P) + eq6_noise(W, Q)


def eq6_noise(W: Array, Q: Array) -> Array:
    """Return the second term of eq. 6, W Q W' (..., 3, 3): the noise of a motion in the map frame."""
    return se2.propagated(W, Q)


def eq7_A(x: Array, x_next: Array) -> Array:
    """Eq. 7: derivative (..., 3, 3) of a later pose x_next (..., 3) by an earlier pose x (..., 3)."""
    return se2.lever(x[..., 1] - x_next[..., 1], x_next[..., 0] - x[..., 0])


def predicted(x: Array, P: Array, u: Array, Q: Array) -> tuple[Array, Array]:
    """Eq. 5-7: poses (..., 3) and covariances (..., 3, 3) after motions u (..., 3) of covariance Q (..., 3, 3)."""
    x_next = eq5_x(x, u)
    return x_next, eq6_P(P, eq7_A(x, x_next), se2.rotation(x[..., 2]), Q)


def eq10_12(PH: Array, S: Array, y: Array) -> tuple[Array, Array, Array]:
    """Return V (..., m, n), e (..., m) and the Cholesky factor L (..., m, m) of S = H P H' + R, for eq. 10-12.

    Arguments: P H' (..., n, m), S (..., m, m) and the innovation y (..., m). V = L^-1 H P; the elements of e =
    L^-1 y are independent and have variance 1. The gain of eq. 10 is K = V' L^-1. So eq. 11 is x <- x + V' e, and
    eq. 12 is P <- P - V' V, symmetric by construction. Raises np.linalg.LinAlgError if S is not positive definite.
    """
    L = np.asarray(np.linalg.cholesky(se2.symmetric(S)), np.float64)
    right = np.concatenate((np.swapaxes(PH, -1, -2), y[..., None]), axis=-1)
    V = np.asarray(np.linalg.solve(L, right), np.float64)
    return V[..., :-1], V[..., -1], L
