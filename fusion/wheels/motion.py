"""Wheel motion (paper eq. 1-3, 7, 8): exact arcs, pre-integrated between any two instants.

Encoder rate costs nothing in the filter: all wheel readings are turned at once into a chain of body twists, and
the motion, its covariance and its derivative by the wheel parameters are summed per interval with NumPy.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints, Motions

MIN_GAP_S, MIN_GAP_PERIODS = 0.5, 5.0  # s, median periods: over a longer one the way is not known, only the sums
INTERVALS_AT_ONCE = 8192  # intervals at a time: what is needed on the way is many times larger than the result
PARAMETERS = ("scale_left", "scale_right", "track")  # relative corrections, 0 = as given


def body_increments(ds_left: Array, ds_right: Array, track: float) -> tuple[Array, Array]:
    """Paper eq. 2: path length of the body's centre [m] and its turn [rad]."""
    return 0.5 * (ds_left + ds_right), (ds_right - ds_left) / track


@dataclass(frozen=True)
class Wheels:
    """Wheel odometry of a whole drive: between two readings the body twist is constant."""

    t: Array  # (n,) s, strictly increasing, n >= 2
    twist: Array  # (n-1, 3) forward [m], left [m], turn [rad] over each interval
    rolled: Array  # (n-1, 2) left, right wheel [m], signed: what the noise grows with
    pose: Array  # (n, 3) dead reckoning from (0, 0, 0)
    track: float  # m
    noise: float  # m: variance per metre rolled
    silence: Array  # (n-1, 2) where the way between two readings is not known: variance of the place [m^2], rad/s
    matched: Array | None = None  # (n-1, 3, 3) covariance of each twist, where scans say it and no wheel rolled

    @classmethod
    def from_wheels(cls, t: Array, left: Array, right: Array, track: float, noise: float) -> Wheels:
        """Build from the distances that either wheel has rolled since the start, (n,) m."""
        rolled = np.column_stack((np.diff(left), np.diff(right)))
        ds, turn = body_increments(rolled[:, 0], rolled[:, 1], track)
        twist = np.column_stack((ds, np.zeros_like(ds), turn))
        return cls(t, twist, rolled, dead_reckoning(twist), track, noise, silences(t, rolled, turn))

    @classmethod
    def from_twists(cls, t: Array, twist: Array, track: float, noise: float) -> Wheels:
        """Build from body twists (n-1, 3) between the times t (n,): they are known over a silence too.

        A base that drives sideways (mecanum, legs) is taken for one whose wheels point the way it goes.
        """
        half = 0.5 * track * twist[:, 2]
        way = np.copysign(np.hypot(twist[:, 0], twist[:, 1]), twist[:, 0])
        rolled = np.column_stack((way - half, way + half))
        return cls(t, twist, rolled, dead_reckoning(twist), track, noise, np.zeros_like(rolled))

    @classmethod
    def from_matches(cls, t: Array, twist: Array, P: Array, track: float, noise: float) -> Wheels:
        """Build from body twists (n-1, 3) between the times t (n,), each with its covariance P (n-1, 3, 3)."""
        return replace(cls.from_twists(t, twist, track, noise), matched=P)

    def window(self, begin: float, end: float) -> Wheels:
        """Return the readings between two times [s]; times and poses stay those of the whole drive."""
        first, last = np.searchsorted(self.t, [begin, end], side="left")
        last = min(last + int(last < len(self.t) and self.t[last] == end), len(self.t))
        rows, between = slice(first, last), slice(first, max(last - 1, first))
        return replace(
            self,
            t=self.t[rows],
            twist=self.twist[between],
            rolled=self.rolled[between],
            pose=self.pose[rows],
            silence=self.silence[between],
            matched=None if self.matched is None else self.matched[between],
        )

    def at(self, t: Array) -> tuple[Ints, Array, Array]:
        """Return for each time the wheel interval, the share of it that has passed, and the dead-reckoned pose.

        Up to one interval beyond either end is extrapolated: the last beams of a scan may need it.
        """
        k = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, len(self.twist) - 1)
        share = np.clip((t - self.t[k]) / (self.t[k + 1] - self.t[k]), -1.0, 2.0)
        return k, share, se2.compose(self.pose[k], se2.exp(share[..., None] * self.twist[k]))

    def relative(self, t_from: Array, t_to: Array) -> Array:
        """Return the poses (..., 3) at t_to seen from those at t_from."""
        return se2.between(self.at(t_from)[2], self.at(t_to)[2])

    def heading(self, t: Array) -> Array:
        """Return the heading (...) [rad, not wrapped] by the wheels alone at times t (...) within the drive."""
        return np.interp(t, self.t, self.pose[:, 2])

    def slips(self, t: Array) -> Array:
        """Return the variances (..., k - 1, 2) [m^2] of what either wheel rolled between times t (..., k) [s]."""
        if self.matched is None:
            steps = self.noise * np.abs(self.rolled)
        else:  # of wheels that would leave the turn as uncertain as matching the scans does
            steps = np.repeat(0.5 * self.track**2 * self.matched[:, 2, 2, None], 2, axis=1)
        way = np.concatenate((np.zeros((1, 2)), np.cumsum(steps, axis=0)))
        return np.diff(np.stack([np.interp(t, self.t, column) for column in way.T], axis=-1), axis=-2)

    def between(self, t_from: Array, t_to: Array, parameters: bool = False) -> Motions:
        """Pre-integrate n intervals [t_from, t_to], (n,) s each, that do not overlap and are in order.

        Noise is independent per wheel with variance `noise` times the distance rolled, whatever the encoder
        rate (the paper's eq. 9 depends on the period). Each piece between two cuts contributes through
        eq. 8 in its right form plus the lever arm to the interval's end.
        """
        blocks = [slice(a, a + INTERVALS_AT_ONCE) for a in range(0, max(len(t_from), 1), INTERVALS_AT_ONCE)]
        parts = [self._between(t_from[at], t_to[at], parameters) for at in blocks]
        return Motions(*map(np.concatenate, zip(*parts, strict=True)))

    def _between(self, t_from: Array, t_to: Array, parameters: bool) -> tuple[Array, Array, Array]:
        pieces = _Pieces.cut(self, t_from, t_to)
        u = se2.between(pieces.start, pieces.end)
        columns = pieces.jacobian(self.track)  # (m, 3, 2) left, right
        if self.matched is None:
            variance = self.noise * np.abs(pieces.rolled)  # (m, 2)
            Q = pieces.total((columns * variance[:, None]) @ columns.transpose(0, 2, 1) + pieces.unseen())
        else:
            Q = pieces.total(pieces.by_match(self.matched))
        J = np.zeros((len(u), 3, 0))
        if parameters:
            J = pieces.total(pieces.by_parameters(columns))
        turn = se2.rotation(-pieces.start[:, 2])
        return u, turn @ Q @ turn.transpose(0, 2, 1), turn @ J


@dataclass(frozen=True)
class _Pieces:
    """Intervals cut at every wheel reading: m pieces of n intervals, on each of which the twist is constant."""

    interval: Ints  # (m,)
    count: int  # n
    a: Array  # (m, 3) dead-reckoned pose at the piece's start
    b: Array  # (m, 3) at its end
    twist: Array  # (m, 3)
    rolled: Array  # (m, 2)
    wheel: Ints  # (m,) the wheel interval
    share: Array  # (m,) of the wheel interval
    span: Array  # (m,) s
    silence: Array  # (m, 2) of the wheel interval
    start: Array  # (n, 3) at the interval's start
    end: Array  # (n, 3)

    @classmethod
    def cut(cls, wheels: Wheels, t_from: Array, t_to: Array) -> _Pieces:
        k0, f0, start = wheels.at(t_from)
        k1, f1, end = wheels.at(t_to)
        counts = np.where(t_to > t_from, k1 - k0 + 1, 0)
        interval = np.repeat(np.arange(len(t_from)), counts)
        nth = np.arange(len(interval)) - np.repeat(np.cumsum(counts) - counts, counts)
        k = k0[interval] + nth
        share_a = np.where(nth == 0, f0[interval], 0.0)
        share_b = np.where(k == k1[interval], f1[interval], 1.0)
        share = share_b - share_a
        a = se2.compose(wheels.pose[k], se2.exp(share_a[:, None] * wheels.twist[k]))
        twist = share[:, None] * wheels.twist[k]
        b = se2.compose(a, se2.exp(twist))
        rolled, span = share[:, None] * wheels.rolled[k], share * (wheels.t[k + 1] - wheels.t[k])
        return cls(interval, len(t_from), a, b, twist, rolled, k, share, span, wheels.silence[k], start, end)

    def total(self, terms: Array) -> Array:
        """Sum terms (m, ...) over the pieces of each interval, (n, ...)."""
        out = np.zeros((self.count, *terms.shape[1:]))
        if len(terms):
            first = np.flatnonzero(np.diff(self.interval, prepend=-1))
            out[self.interval[first]] = np.add.reduceat(terms, first, axis=0)
        return out

    def unseen(self) -> Array:
        """Covariance of each piece by what the wheels did unseen, (m, 3, 3): none but in a silence.

        A whole silence leaves no doubt about the heading, which is the difference of the sums; a part of it does.
        """
        out = np.zeros((len(self.share), 3, 3))
        out[:, 0, 0] = out[:, 1, 1] = self.share * self.silence[:, 0]
        turned = np.minimum(self.silence[:, 1] * self.span, np.pi)  # at most any way round
        out[:, 2, 2] = (1.0 - self.share) * turned**2 / 3.0
        return out

    def by_match(self, P: Array) -> Array:
        """Covariance of each piece, (m, 3, 3), by that of the twists: its share, with the lever arm to the end."""
        m = self.a[:, 2] + 0.5 * self.twist[:, 2]
        J = se2.rotation(m)
        J[:, :, 2] = self.turning()
        out: Array = J @ (self.share[:, None, None] * P[self.wheel]) @ J.transpose(0, 2, 1)
        return out

    def jacobian(self, track: float) -> Array:
        """Derivative of the interval's end pose by the (left, right) distance rolled in each piece, (m, 3, 2).

        Paper eq. 8 in its right form (docs/paper.md), plus the turn's lever arm from the piece to the end.
        """
        m = self.a[:, 2] + 0.5 * self.twist[:, 2] + self.aside()
        along = np.column_stack((np.cos(m), np.sin(m), np.zeros_like(m)))
        turning = self.turning() / track
        return np.stack((0.5 * along - turning, 0.5 * along + turning), axis=-1)

    def turning(self) -> Array:
        """Derivative of the interval's end pose by the turn of each piece, (m, 3)."""
        m = self.a[:, 2] + 0.5 * self.twist[:, 2]
        (ds, left), end = self.twist[:, :2].T, self.end[self.interval]
        x = -0.5 * (ds * np.sin(m) + left * np.cos(m)) - (end[:, 1] - self.b[:, 1])
        y = 0.5 * (ds * np.cos(m) - left * np.sin(m)) + (end[:, 0] - self.b[:, 0])
        return np.column_stack((x, y, np.ones_like(m)))

    def aside(self) -> Array:
        """Direction of travel from the body's axis (m,) [rad], at most a quarter turn: 0 forward and backward."""
        ahead, left = self.twist[:, 0], self.twist[:, 1]
        out: Array = np.arctan2(np.where(np.signbit(ahead), -left, left), np.abs(ahead))
        return out

    def by_parameters(self, columns: Array) -> Array:
        """Derivative by PARAMETERS, (m, 3, 3)."""
        by_track = -self.twist[:, 2:3] * self.turning()
        scales = columns * self.rolled[:, None, :]
        return np.concatenate((scales, by_track[:, :, None]), axis=2)


def silences(t: Array, rolled: Array, turn: Array) -> Array:
    """Return for each interval the variance of the place reached [m^2] and the turning rate [rad/s], (n-1, 2).

    Both are 0 but where the wheels were silent: there the counters say how far either wheel rolled and not in
    which order, so that a straight line, an arc and two corners look the same. With the fastest usual turning w
    the heading strays from the even turn by up to w T / 2 and back, uniformly w T / 4 on average, and the place
    by that much of the way; at most it lies anywhere in a disc about the start.
    """
    span, way = np.diff(t), 0.5 * np.abs(rolled).sum(axis=1)
    silent = span > max(MIN_GAP_S, MIN_GAP_PERIODS * float(np.median(span)))
    if not silent.any():
        return np.broadcast_to(np.float64(0.0), (len(span), 2))  # holds nothing
    fastest = float(np.percentile(np.abs(turn[~silent]) / span[~silent], 99))
    astray = way * np.minimum(0.5, fastest * span / (4.0 * np.sqrt(3.0)))
    return np.where(silent[:, None], np.column_stack((astray**2, np.full_like(span, fastest))), 0.0)


def dead_reckoning(twist: Array) -> Array:
    """Paper eq. 3 with exact arcs: poses (n+1, 3) from (0, 0, 0) through body twists (n, 3)."""
    theta = np.concatenate(([0.0], np.cumsum(twist[:, 2])))
    step = se2.exp(twist)
    c, s = np.cos(theta[:-1]), np.sin(theta[:-1])
    x = np.cumsum(c * step[:, 0] - s * step[:, 1])
    y = np.cumsum(s * step[:, 0] + c * step[:, 1])
    return np.column_stack((np.append(0.0, x), np.append(0.0, y), theta))
