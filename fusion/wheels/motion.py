"""Wheel motion (paper eq. 1-3, 7, 8): exact arcs, pre-integrated between any two instants.

Encoder rate costs nothing in the filter: all wheel readings are turned at once into a chain of body twists, and
the motion, its covariance and its derivative by the wheel parameters are summed per interval.
"""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import numpy as np
from msgspec.structs import replace

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints, Motions
from locfuse.fusion.streams import gap_limit

INTERVALS_PER_BLOCK = 2048  # so that the pieces of an hour take a few MB


def body_increments(ds_left: Array, ds_right: Array, track: float) -> tuple[Array, Array]:
    """Paper eq. 2: path length of the body's centre [m] and its turn [rad]."""
    return 0.5 * (ds_left + ds_right), (ds_right - ds_left) / track


STANDS_M, STANDS_RAD = 0.02, 0.02  # m, rad: a robot that stays within is on no drive


class Wheels(msgspec.Struct, frozen=True):
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
        """Build from the distances rolled by either wheel since the start, (n,) m."""
        rolled = np.column_stack((np.diff(left), np.diff(right)))
        ds, turn = body_increments(rolled[:, 0], rolled[:, 1], track)
        twist = np.column_stack((ds, np.zeros_like(ds), turn))
        return cls(t, twist, rolled, dead_reckoning(twist), track, noise, silences(t, rolled, turn))

    @classmethod
    def from_twists(cls, t: Array, twist: Array, track: float, noise: float) -> Wheels:
        """Build from body twists (n-1, 3) between the times t (n,), which are known during a gap too.

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

    @property
    def stands(self) -> bool:
        """Whether the robot does not move in the whole log."""
        x, y, theta = (float(np.ptp(column)) for column in self.pose.T)
        return max(x, y) <= STANDS_M and theta <= STANDS_RAD

    def window(self, begin: float, end: float) -> Wheels:
        """Return the wheel readings between two times [s]; times and poses are not shifted."""
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
        """Return for each time the wheel interval, its share that has passed, and the dead-reckoned pose.

        Up to one interval beyond either end is extrapolated: the last beams of a scan may need it.
        """
        k = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, len(self.twist) - 1)
        share = self._passed(k, t)
        return k, share, se2.compose(self.pose[k], se2.exp(share[..., None] * self.twist[k]))

    def relative(self, t_from: Array, t_to: Array) -> Array:
        """Return the poses (..., 3) at t_to relative to those at t_from."""
        return se2.between(self.at(t_from)[2], self.at(t_to)[2])

    def heading(self, t: Array) -> Array:
        """Return the heading (...) [rad, not wrapped] by the wheels alone at times t (...) within the drive."""
        return np.interp(t, self.t, self.pose[:, 2])

    def driven(self, t: Array) -> Array:
        """Return the distance (...) [m, never decreasing] of the faster wheel until times t (...) [s]."""
        steps = np.abs(self.rolled).max(axis=1)
        return np.interp(t, self.t, np.concatenate(([0.0], np.cumsum(steps))))

    def slips(self, t: Array) -> Array:
        """Return the variances (..., k - 1, 2) [m^2] of either wheel's distance between times t (..., k) [s]."""
        if self.matched is None:
            steps = self.noise * np.abs(self.rolled)
        else:  # of wheels that would leave the turn as uncertain as matching the scans does
            steps = np.repeat(0.5 * self.track**2 * self.matched[:, 2, 2, None], 2, axis=1)
        way = np.concatenate((np.zeros((1, 2)), np.cumsum(steps, axis=0)))
        return np.diff(np.stack([np.interp(t, self.t, column) for column in way.T], axis=-1), axis=-2)

    def between(self, t_from: Array, t_to: Array, parameters: bool = False) -> Motions:
        """Pre-integrate n intervals [t_from, t_to], (n,) s each.

        Noise is independent per wheel with variance `noise` times the distance rolled, whatever the encoder
        rate (the paper's eq. 9 depends on the period). An interval is cut at every reading, and each piece between
        two cuts contributes through eq. 8 in its right form plus the lever arm to the interval's end.
        """
        parts = []
        for at in range(0, max(len(t_from), 1), INTERVALS_PER_BLOCK):
            rows = slice(at, at + INTERVALS_PER_BLOCK)
            parts.append(self._between(t_from[rows], t_to[rows], parameters))
        return Motions(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))

    def _between(self, t_from: Array, t_to: Array, parameters: bool) -> tuple[Array, Array, Array]:
        """Return u, Q and J of some intervals, all their pieces in memory at once."""
        (first, _, begin), (last, _, end) = self.at(t_from), self.at(t_to)
        count = np.where(t_to > t_from, last - first + 1, 0)
        of = np.repeat(np.arange(len(count)), count)
        k = np.arange(len(of)) - np.repeat(np.cumsum(count) - count - first, count)
        share = [
            np.where(k == edge[of], self._passed(k, t[of]), whole)
            for edge, t, whole in ((first, t_from, 0.0), (last, t_to, 1.0))
        ]
        with np.errstate(invalid="ignore", over="ignore"):
            noise, J = self._pieces(k, share[0], share[1] - share[0], end[of], parameters)
            back = np.swapaxes(se2.rotation(begin[:, 2]), 1, 2)
            Q = back @ _sums(noise, count) @ np.swapaxes(back, 1, 2)
            return se2.between(begin, end), 0.5 * (Q + np.swapaxes(Q, 1, 2)), back @ _sums(J, count)

    def _passed(self, k: Ints, t: Array) -> Array:
        """Return the share of interval k (...) that has passed at times t (...), at most one beyond either end."""
        return np.clip((t - self.t[k]) / (self.t[k + 1] - self.t[k]), -1.0, 2.0)

    def _pieces(self, k: Ints, begin: Array, share: Array, end: Array, parameters: bool) -> tuple[Array, Array]:
        """Return noise and derivative (m, 3, 3) that pieces (m,) of intervals k add to poses `end` (m, 3).

        Piece i is the `share` of interval k from the share `begin` on. The derivative is by the wheel parameters.
        """
        twist = share[:, None] * self.twist[k]
        (ahead, left, turned), rolled = twist.T, share[:, None] * self.rolled[k]
        start = se2.compose(self.pose[k], se2.exp(begin[:, None] * self.twist[k]))
        lever = (end - se2.compose(start, se2.exp(twist)))[:, :2]
        middle, one = start[:, 2] + 0.5 * turned, np.ones_like(turned)
        chord = se2.rotated(middle, twist[:, :2])
        # the derivative of the end by the turn: that of the chord, and the lever arm from the piece to the end
        by_turn = np.stack((-0.5 * chord[:, 1] - lever[:, 1], 0.5 * chord[:, 0] + lever[:, 0], one), axis=-1)
        way = middle + _aside(ahead, left)
        by_way = np.stack((np.cos(way), np.sin(way), 0.0 * way), axis=-1)
        by_wheels = np.stack((0.5 * by_way - by_turn / self.track, 0.5 * by_way + by_turn / self.track), axis=-1)
        if self.matched is None:
            noise = (by_wheels * (self.noise * np.abs(rolled))[:, None]) @ np.swapaxes(by_wheels, 1, 2)
            astray, rate = self.silence[k].T
            if rate.any():
                # after a whole silence the difference of the sums gives the heading; within it the heading is open
                most = np.minimum(rate * share * (self.t[k + 1] - self.t[k]), np.pi)
                noise[:, (0, 1), (0, 1)] += (share * astray)[:, None]
                noise[:, 2, 2] += (1.0 - share) * most**2 / 3.0
        else:
            lever_of = se2.rotation(middle)
            lever_of[:, :2, 2] = by_turn[:, :2]
            noise = share[:, None, None] * (lever_of @ self.matched[k] @ np.swapaxes(lever_of, 1, 2))
        if not parameters:
            return noise, np.zeros((len(k), 3, 0))
        return noise, np.concatenate(
            (by_wheels * rolled[:, None], (-turned[:, None] * by_turn)[..., None]), axis=-1
        )


def _aside(ahead: Array, left: Array) -> Array:
    """Return the direction of travel relative to the body's axis (n,) [rad], within +-pi/2; 0 is straight."""
    back = np.where(ahead < 0.0, -1.0, 1.0)
    sideways = (left != 0.0) & np.isfinite(left) & np.isfinite(ahead)
    return np.where(sideways, np.arctan2(back * left, back * ahead + 0.0), 0.0)


def _sums(pieces: Array, count: Ints) -> Array:
    """Return the sums (n, ...) of the pieces (m, ...) of each interval, which has `count` (n,) of them."""
    out, some = np.zeros((len(count), *pieces.shape[1:])), count > 0
    if some.any():
        out[some] = np.add.reduceat(pieces, (np.cumsum(count) - count)[some])
    return out


def silences(t: Array, rolled: Array, turn: Array) -> Array:
    """Return for each gap in wheel data the variance of the end place [m^2] and the turn rate [rad/s], else 0.

    Both are 0 but where the wheels were silent: there the counters say how far either wheel rolled and not in
    which order, so that a straight line, an arc and two corners look the same. With the fastest usual turning w
    the heading strays from the even turn by up to w T / 2 and back, uniformly w T / 4 on average, and the place
    by that much of the way; at most it lies anywhere in a disc about the start.
    """
    span, way = np.diff(t), 0.5 * np.abs(rolled).sum(axis=1)
    silent = span > gap_limit(t)
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


# ---- how much of another sensor's readings a motion explains: turns of a gyro or compass, ways between fixes ----
#
# The log is cut into windows; of n windows with what the sensor saw, a (n,), and what the motion says, b (n,), the
# share explained is 1 - |a - b|^2 / |a|^2, at the delay between both clocks that suits the motion best. A motion
# that stands explains nothing. What it does not see: an axis that points down (both senses of turning are tried).

TURN_WINDOW_S, WAY_WINDOW_S, MIN_WINDOWS = 1.0, 5.0, 5
LAGS_S = np.arange(-1.0, 1.01, 0.1)  # between the clocks of a motion and a sensor
MIN_TURN_RAD = np.radians(3.0)  # rms over the windows: a sensor that turns less tells nothing
MIN_WAY_M = 15.0  # m in all: fixes of a receiver that stands wander by some metres


def turns_explained(wheels: Wheels, t: Array, heading: Array) -> float | None:
    """Return the share of a sensor's turning that a motion explains; None if the sensor hardly turns.

    `heading` (n,) [rad], not wrapped, is the sensor's at times t (n,) [s] on the clock of the motion.
    """
    start = np.arange(t[0], t[-1] - TURN_WINDOW_S, TURN_WINDOW_S)
    own = np.interp(start + TURN_WINDOW_S, t, heading) - np.interp(start, t, heading)
    if len(start) < MIN_WINDOWS or np.sqrt(np.mean(own**2)) < MIN_TURN_RAD:
        return None

    def turned(at: Array) -> Array:
        return wheels.heading(at + TURN_WINDOW_S) - wheels.heading(at)

    return max(_explained(own, start, turned), _explained(-own, start, turned))


def ways_explained(wheels: Wheels, t: Array, xy: Array, least: float = MIN_WAY_M) -> float | None:
    """Return the share of the distances between places that a motion explains; None below `least` [m] in all.

    `xy` (n, 2) [m] are the places at times t (n,) [s] on the clock of the motion; only distances count.
    """
    start = np.arange(t[0], t[-1] - WAY_WINDOW_S, WAY_WINDOW_S)
    own = _far(start, t, xy)
    if len(start) < MIN_WINDOWS or own.sum() < least:
        return None
    return _explained(own, start, lambda at: _far(at, wheels.t, wheels.pose[:, :2]))


def _far(start: Array, t: Array, xy: Array) -> Array:
    ends = [np.stack([np.interp(at, t, column) for column in xy.T]) for at in (start, start + WAY_WINDOW_S)]
    return np.asarray(np.hypot(*(ends[1] - ends[0])))


def _explained(own: Array, start: Array, motion: Callable[[Array], Array]) -> float:
    left = min(float(((own - motion(start + lag)) ** 2).sum()) for lag in LAGS_S.tolist())
    return max(0.0, 1.0 - left / float((own**2).sum()))
