"""Poses between two key poses: the wheels' path, corrected so that it ends at the second key and passes each fix.

The wheels' error grows along the way as a random walk. Given where it ends, the share of it at an instant is
that of its covariance (a Brownian bridge). Errors are rigid motions xi about the key before, so that turning both
key poses alike turns what lies between.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints
from locfuse.fusion.scan_matching.clouds import Columns

from .odometry import Odometry, by_lever, moved

REST_P = np.diag([1e-9, 1e-9, 1e-9])  # m^2, rad^2: a robot at rest has no bridge


class Spans(Columns, frozen=True):
    """Stamps (n,) between keys: the key before each, and the wheels' way from there."""

    a: Ints  # (n,) key before, or the last but one
    b: Ints  # (n,) key after
    inside: NDArray[np.bool_]  # (n, 1, 1) whether the stamp lies between the two
    beyond: NDArray[np.bool_]  # (n, 1, 1) whether it lies behind the last key
    home: Array  # (n, 3) the odometry's origin seen from its pose at key a
    u: Array  # (n, 3) the stamp seen from key a, by the wheels
    C: Array  # (n, 3, 3) covariance of xi since key a
    C_ab: Array  # (n, 3, 3) that from key a to key b

    @classmethod
    def of(cls, odometry: Odometry, stamps: Odometry, k: Ints, keys: Ints) -> Spans:
        """Return those of stamps whose last instant is k (n,), between the instants `keys` (m,)."""
        a = np.clip(np.searchsorted(keys, k, side="right") - 1, 0, max(len(keys) - 2, 0))
        b = np.minimum(a + 1, len(keys) - 1)
        home = se2.inverse(odometry.pose[keys[a]])
        u = se2.compose(home, stamps.pose)
        C = moved(stamps.C - odometry.C[keys[a]], home)
        C_ab = moved(odometry.C[keys[b]] - odometry.C[keys[a]], home) + REST_P
        inside, beyond = (k >= keys[a]) & (k < keys[b]), k >= keys[b]
        return cls(a, b, inside[:, None, None], beyond[:, None, None], home, u, C, C_ab)

    @property
    def share(self) -> Array:
        """The share of key b in the error at each stamp, (n, 3, 3)."""
        return np.where(self.inside, self.C @ np.linalg.inv(self.C_ab), np.where(self.beyond, np.eye(3), 0.0))


class Fixes(Columns, frozen=True):
    """Instants at which the wheels' error since the key before is known: both keys of every span, scans between.

    Sorted by key, then by instant; of every span the first row is its key (no error yet), the last the next one.
    """

    a: Ints  # (f,) key before
    instant: Ints  # (f,)
    xi: Array  # (f, 3) error of the wheels since the key, seen from it
    rest: Array  # (f, 3, 3) its covariance, were both keys exact

    @classmethod
    def of_keys(cls, odometry: Odometry, keys: Ints, x: Array) -> Fixes:
        """Return those of the keys alone: instants (m,), poses x (m, 3)."""
        a = np.arange(len(keys) - 1)
        whole = se2.between(odometry.pose[keys[:-1]], odometry.pose[keys[1:]])
        error = se2.compose(se2.between(x[:-1], x[1:]), se2.inverse(whole))
        error[:, 2] = se2.wrap_all(error[:, 2])
        both = np.stack((keys[:-1], keys[1:]), axis=1).ravel()
        xi = np.stack((np.zeros_like(error), error), axis=1).reshape(-1, 3)
        return cls(np.repeat(a, 2), both, xi, np.zeros((len(xi), 3, 3)))

    def at(self, odometry: Odometry, k: Ints, spans: Spans) -> tuple[Array, Array]:
        """Return the wheels' error at stamps after the instants k (n,): xi (n, 3), its covariance (n, 3, 3)."""
        size = len(odometry.pose) + 1
        last = len(self.a) - 1
        f = np.searchsorted(self.a * size + self.instant, spans.a * size + k, side="right") - 1
        f, g = np.clip(f, 0, last), np.clip(f + 1, 0, last)
        origin = odometry.C[self.instant[np.searchsorted(self.a, spans.a)]]
        C_f = moved(odometry.C[self.instant[f]] - origin, spans.home)
        C_fg = moved(odometry.C[self.instant[g]] - origin, spans.home) - C_f + REST_P
        since = spans.C - C_f
        share = np.where(spans.inside, since @ np.linalg.inv(C_fg), 0.0)
        xi = self.xi[f] + np.einsum("nij,nj->ni", share, self.xi[g] - self.xi[f])
        nearer = np.clip(share[:, 2, 2], 0.0, 1.0)[:, None, None]  # errors of neighbouring scans are alike
        rest = (1.0 - nearer) * self.rest[f] + nearer * self.rest[g] + since - share @ since
        return xi, rest


def bridged(
    odometry: Odometry, stamps: Odometry, k: Ints, keys: Ints, x: Array, P: Array, after: Array, fixes: Fixes
) -> tuple[Array, Array]:
    """Return poses (n, 3) and covariances (n, 3, 3) at stamps whose last instant is k (n,).

    `keys` (m,) are the instants of the key poses x (m, 3), with covariances P (m, 3, 3), and `after` (m - 1, 3, 3)
    with the next one. The first is at or before all stamps; behind the last one the wheels lead on alone.
    """
    spans = Spans.of(odometry, stamps, k, keys)
    xi, rest = fixes.at(odometry, k, spans)
    pose = se2.compose(x[spans.a], se2.compose(xi, spans.u))
    return pose, _spread(x, P, after, spans, rest, pose)


def _spread(x: Array, P: Array, after: Array, spans: Spans, rest: Array, pose: Array) -> Array:
    """Return covariances of the poses' numbers, by those of both keys and of what lies between."""
    a, b = spans.a, spans.b
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
    S = turn @ spans.share @ turn.transpose(0, 2, 1)
    own = np.eye(3) - S
    out = own @ P_a @ own.transpose(0, 2, 1) + S @ P_b @ S.transpose(0, 2, 1)
    mixed = own @ cross @ S.transpose(0, 2, 1)
    out += mixed + mixed.transpose(0, 2, 1) + turn @ rest @ turn.transpose(0, 2, 1)
    lever = pose[:, :2] - x[a, :2]
    out = by_lever(out, -lever[:, 1], lever[:, 0])
    return 0.5 * (out + out.transpose(0, 2, 1))
