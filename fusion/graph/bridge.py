"""Between two key poses: the wheels' way, bent so that it leads from the one to the other.

The wheels' error grows along the way as a random walk. Given where it ends, the share of it at an instant is
that of its covariance (a Brownian bridge). Errors are rigid motions xi about the key before, so that turning both
key poses alike turns what lies between.
"""

from __future__ import annotations

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints

from .odometry import Odometry, by_lever, moved

REST = np.diag([1e-9, 1e-9, 1e-9])  # m^2, rad^2: a robot at rest has no bridge


def bridged(
    odometry: Odometry, stamps: Odometry, k: Ints, keys: Ints, x: Array, P: Array, after: Array
) -> tuple[Array, Array]:
    """Return poses (n, 3) and covariances (n, 3, 3) at stamps whose last instant is k (n,).

    `keys` (m,) are the instants of the key poses x (m, 3), with covariances P (m, 3, 3), and `after` (m - 1, 3, 3)
    with the next one. Before the first key and behind the last one the wheels lead on alone.
    """
    a = np.clip(np.searchsorted(keys, k, side="right") - 1, 0, max(len(keys) - 2, 0))
    b = np.minimum(a + 1, len(keys) - 1)
    start, end = odometry.pose[keys[a]], odometry.pose[keys[b]]
    home = se2.inverse(start)
    u, whole = se2.compose(home, stamps.pose), se2.compose(home, end)
    inside = ((k >= keys[a]) & (k < keys[b]))[:, None, None]
    C = moved(stamps.C - odometry.C[keys[a]], home)
    C_ab = moved(odometry.C[keys[b]] - odometry.C[keys[a]], home) + REST
    share = C @ np.linalg.inv(C_ab)
    beyond = (k >= keys[b])[:, None, None]
    share = np.where(inside, share, np.where(beyond, np.eye(3), 0.0))
    error = se2.compose(se2.between(x[a], x[b]), se2.inverse(whole))
    error[:, 2] = se2.wrap_all(error[:, 2])
    xi = np.einsum("nij,nj->ni", share, error)
    pose = se2.compose(x[a], se2.compose(xi, u))
    rest = np.where(inside, C - share @ C, np.where(beyond, C - C_ab, _sized(C)))
    return pose, _spread(x, P, after, a, b, share, rest, pose)


def _sized(C: Array) -> Array:
    """Return what lies before the first key: its covariance runs backward, and its sign with it."""
    return np.where(np.diagonal(C, axis1=1, axis2=2).sum(axis=1)[:, None, None] < 0.0, -C, C)


def _spread(x: Array, P: Array, after: Array, a: Ints, b: Ints, share: Array, rest: Array, pose: Array) -> Array:
    """Return covariances of the poses' numbers, by those of both keys and of what lies between."""
    arm = x[b, :2] - x[a, :2]
    P_a = P[a]
    P_b = by_lever(P[b], arm[:, 1], -arm[:, 0])
    cross = after[np.minimum(a, max(len(after) - 1, 0))] if len(after) else np.zeros_like(P_a)
    L = np.broadcast_to(np.eye(3), cross.shape).copy()
    L[:, 0, 2], L[:, 1, 2] = arm[:, 1], -arm[:, 0]
    cross = cross @ L.transpose(0, 2, 1)
    same = (a == b)[:, None, None]
    cross = np.where(same, P_a, cross)
    turn = se2.rotation(x[a, 2])
    S = turn @ share @ turn.transpose(0, 2, 1)
    own = np.eye(3) - S
    out = own @ P_a @ own.transpose(0, 2, 1) + S @ P_b @ S.transpose(0, 2, 1)
    mixed = own @ cross @ S.transpose(0, 2, 1)
    out += mixed + mixed.transpose(0, 2, 1) + turn @ rest @ turn.transpose(0, 2, 1)
    lever = pose[:, :2] - x[a, :2]
    out = by_lever(out, -lever[:, 1], lever[:, 0])
    return 0.5 * (out + out.transpose(0, 2, 1))
