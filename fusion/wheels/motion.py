"""Wheel motion (paper eq. 1-3, 7, 8): exact arcs, pre-integrated between any two instants.

Encoder rate costs nothing in the filter: all wheel readings are turned at once into a chain of body twists, and
the motion, its covariance and its derivative by the wheel parameters are summed per interval (`kernels.wheels`).
"""

from __future__ import annotations

import msgspec
import numpy as np
from msgspec.structs import replace

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints, Motions
from locfuse.fusion.kernels import wheels as kernel
from locfuse.fusion.kernels.arrays import view

MIN_GAP_S, MIN_GAP_PERIODS = 0.5, 5.0  # s, median periods: over a longer one the way is not known, only the sums


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

    @property
    def stands(self) -> bool:
        """Whether the robot stays where it is for the whole log."""
        x, y, theta = (float(np.ptp(column)) for column in self.pose.T)
        return max(x, y) <= STANDS_M and theta <= STANDS_RAD

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

    def driven(self, t: Array) -> Array:
        """Return the way (...) [m, never falling] that the faster wheel has rolled by times t (...) [s]."""
        steps = np.abs(self.rolled).max(axis=1)
        return np.interp(t, self.t, np.concatenate(([0.0], np.cumsum(steps))))

    def slips(self, t: Array) -> Array:
        """Return the variances (..., k - 1, 2) [m^2] of what either wheel rolled between times t (..., k) [s]."""
        if self.matched is None:
            steps = self.noise * np.abs(self.rolled)
        else:  # of wheels that would leave the turn as uncertain as matching the scans does
            steps = np.repeat(0.5 * self.track**2 * self.matched[:, 2, 2, None], 2, axis=1)
        way = np.concatenate((np.zeros((1, 2)), np.cumsum(steps, axis=0)))
        return np.diff(np.stack([np.interp(t, self.t, column) for column in way.T], axis=-1), axis=-2)

    def between(self, t_from: Array, t_to: Array, parameters: bool = False) -> Motions:
        """Pre-integrate n intervals [t_from, t_to], (n,) s each.

        Noise is independent per wheel with variance `noise` times the distance rolled, whatever the encoder
        rate (the paper's eq. 9 depends on the period). Each piece between two cuts contributes through
        eq. 8 in its right form plus the lever arm to the interval's end.
        """
        n, parts = len(t_from), 9 if parameters else 0
        u, Q, J = np.empty((n, 3)), np.empty((n, 9)), np.empty((n, parts))
        kernel.integrate(kernel.Odometer(self), view(t_from), view(t_to), kernel.Intervals(u, Q, J))
        return Motions(u, Q.reshape(n, 3, 3), J.reshape(n, 3, parts // 3))


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
