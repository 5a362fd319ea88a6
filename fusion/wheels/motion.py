"""Wheel motion model (paper eq. 1-3, 7, 8): exact arcs between any two times, and its parameters as states.

All wheel readings are converted at once to body twists. For each interval between two updates of the filter, the
motion, its covariance and its derivative by the wheel parameters are summed. So the filter's speed does not depend
on the encoder rate.

With `wheels.estimate`, radius, ratio and track are states of the filter. The motion is linear in the states a, b,
q: the left and right wheel roll (1 + a) and (1 + b) times the configured distance, and a difference of distances
turns the robot by (1 + s - q) / track, where s is the mean of a and b. Reports give radius, ratio and track: if
the configured track is 15 % too small, q is 13 %.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import msgspec
import numpy as np
from msgspec.structs import replace

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Component, Ints, Motions, changes, interpolate, totals
from locfuse.fusion.robot import WheelSettings
from locfuse.fusion.sensor import Block
from locfuse.fusion.statistics import Plane, sums
from locfuse.fusion.streams import gap_limit

INTERVALS_PER_BLOCK = 2048  # intervals processed at once, to save memory


def body_increments(ds_left: Array, ds_right: Array, track: float) -> tuple[Array, Array]:
    """Paper eq. 2: path length of the body's centre [m] and turn of the body [rad]."""
    return 0.5 * (ds_left + ds_right), (ds_right - ds_left) / track


STANDS_M, STANDS_RAD = 0.02, 0.02  # m, rad: largest extent of the path of a robot at rest


class Wheels(msgspec.Struct, frozen=True):
    """Wheel odometry of a whole drive, with a constant body twist between two readings."""

    t: Array  # (n,) s, strictly increasing, n >= 2
    twist: Array  # (n-1, 3) forward [m], left [m], turn [rad] over each interval
    rolled: Array  # (n-1, 2) distance of left, right wheel [m], signed: the noise is proportional to it
    pose: Array  # (n, 3) dead reckoning from (0, 0, 0)
    track: float  # m
    noise: float  # m: variance per metre rolled
    # (n-1, 2) for gaps: variance of the end position [m^2], largest turning rate [rad/s]; else 0
    gap_uncertainty: Array
    matched: Array | None = None  # (n-1, 3, 3) covariance of each twist, for scan-matched odometry

    @classmethod
    def from_wheels(cls, t: Array, left: Array, right: Array, track: float, noise: float) -> Wheels:
        """Build from the distances rolled by each wheel since the start, (n,) m."""
        rolled = np.column_stack((np.diff(left), np.diff(right)))
        ds, turn = body_increments(rolled[:, 0], rolled[:, 1], track)
        twist = np.column_stack((ds, np.zeros_like(ds), turn))
        return cls(t, twist, rolled, dead_reckoning(twist), track, noise, gap_uncertainties(t, rolled, turn))

    def rerolled(self, rolled: Array, track: float) -> Wheels:
        """Return wheels that rolled (n-1, 2) [m] from reading to reading of these, `track` [m] apart."""
        left, right = totals(rolled).T
        return Wheels.from_wheels(self.t, left, right, track, self.noise)

    @classmethod
    def from_twists(cls, t: Array, twist: Array, track: float, noise: float) -> Wheels:
        """Build from body twists (n-1, 3) between times t (n,). Gaps add no noise: the twist is valid in gaps too.

        For a base that drives sideways (mecanum, legs), the noise is that of wheels that point in the direction of
        motion.
        """
        half = 0.5 * track * twist[:, 2]
        distance = np.copysign(np.hypot(twist[:, 0], twist[:, 1]), twist[:, 0])
        rolled = np.column_stack((distance - half, distance + half))
        return cls(t, twist, rolled, dead_reckoning(twist), track, noise, np.zeros_like(rolled))

    @classmethod
    def from_matches(cls, t: Array, twist: Array, P: Array, track: float, noise: float) -> Wheels:
        """Build from body twists (n-1, 3) between the times t (n,), with covariances P (n-1, 3, 3)."""
        return replace(cls.from_twists(t, twist, track, noise), matched=P)

    @property
    def stands(self) -> bool:
        """Return whether the robot is at rest in the whole log."""
        x, y, theta = (float(np.ptp(column)) for column in self.pose.T)
        return max(x, y) <= STANDS_M and theta <= STANDS_RAD

    def window(self, begin: float, end: float) -> Wheels:
        """Return the readings between two times [s]; times and poses are not shifted."""
        first, last = np.searchsorted(self.t, [begin, end], side="left")
        last = min(last + int(last < len(self.t) and self.t[last] == end), len(self.t))
        rows, between = slice(first, last), slice(first, max(last - 1, first))
        return replace(
            self,
            t=self.t[rows],
            twist=self.twist[between],
            rolled=self.rolled[between],
            pose=self.pose[rows],
            gap_uncertainty=self.gap_uncertainty[between],
            matched=None if self.matched is None else self.matched[between],
        )

    def at(self, t: Array) -> tuple[Ints, Array, Array]:
        """Return for each time the wheel interval's index, its elapsed share, and the pose by odometry.

        Times up to one interval beyond either end are extrapolated, for the last beams of a scan.
        """
        k = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, len(self.twist) - 1)
        share = self._passed(k, t)
        return k, share, se2.compose(self.pose[k], se2.exp(share[..., None] * self.twist[k]))

    def relative(self, t_from: Array, t_to: Array) -> Array:
        """Return the poses (..., 3) at times t_to relative to those at times t_from, by odometry."""
        return se2.between(self.at(t_from)[2], self.at(t_to)[2])

    def heading(self, t: Array) -> Array:
        """Return the heading (...) [rad, not wrapped] by odometry at times t (...) within the drive."""
        return np.interp(t, self.t, self.pose[:, 2])

    def driven(self, t: Array) -> Array:
        """Return the distance (...) [m, never decreasing] that the faster wheel rolled until times t (...) [s]."""
        steps = np.abs(self.rolled).max(axis=1)
        return np.asarray(np.interp(t, self.t, totals(steps)))

    def slips(self, t: Array) -> Array:
        """Return the variances (..., k - 1, 2) [m^2] of each wheel's distance between times t (..., k) [s]."""
        if self.matched is None:
            steps = self.noise * np.abs(self.rolled)
        else:  # the variance of wheels that would cause the same variance of the turn
            steps = np.repeat(0.5 * self.track**2 * self.matched[:, 2, 2, None], 2, axis=1)
        return np.diff(interpolate(t, self.t, totals(steps)), axis=-2)

    def between(self, t_from: Array, t_to: Array, parameters: bool = False) -> Motions:
        """Pre-integrate n intervals [t_from, t_to], (n,) s each.

        Noise is independent per wheel with variance `noise` times the distance rolled, for any encoder rate (the
        paper's eq. 9 depends on the period). An interval is cut at every reading, and each piece between two cuts
        contributes by the corrected eq. 8 plus the lever arm to the interval's end.
        """
        parts = []
        for at in range(0, max(len(t_from), 1), INTERVALS_PER_BLOCK):
            rows = slice(at, at + INTERVALS_PER_BLOCK)
            parts.append(self._between(t_from[rows], t_to[rows], parameters))
        return Motions(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))

    def _between(self, t_from: Array, t_to: Array, parameters: bool) -> tuple[Array, Array, Array]:
        """Return motions u, covariances Q and derivatives J of n intervals, without splitting into blocks."""
        (first, _, begin), (last, _, end) = self.at(t_from), self.at(t_to)
        count = np.where(t_to > t_from, last - first + 1, 0)
        of = np.repeat(np.arange(len(count)), count)
        k = np.arange(len(of)) - np.repeat(np.cumsum(count) - count - first, count)
        edges = (first, t_from, 0.0), (last, t_to, 1.0)
        share = [np.where(k == edge[of], self._passed(k, t[of]), whole) for edge, t, whole in edges]
        with np.errstate(invalid="ignore", over="ignore"):
            noise, J = self._pieces(k, share[0], share[1] - share[0], end[of], parameters)
            back = np.swapaxes(se2.rotation(begin[:, 2]), 1, 2)
            Q = se2.symmetric(se2.propagated(back, _sums(noise, count)))
            return se2.between(begin, end), Q, back @ _sums(J, count)

    def _passed(self, k: Ints, t: Array) -> Array:
        """Return the share of wheel intervals k (...) passed at times t (...): 0 at their start, 1 at their end.

        Times outside the interval give shares below 0 or above 1, limited to -1 ... 2.
        """
        return np.clip((t - self.t[k]) / (self.t[k + 1] - self.t[k]), -1.0, 2.0)

    def _pieces(self, k: Ints, begin: Array, share: Array, end: Array, parameters: bool) -> tuple[Array, Array]:
        """Return noise (m, 3, 3) of the poses `end` (m, 3) from m pieces of wheel intervals, and derivatives.

        A piece is the part of wheel interval k from share `begin` to `begin` + `share`. The derivatives (m, 3, 3)
        of `end` are by the wheel parameters.
        """
        twist = share[:, None] * self.twist[k]
        (ahead, left, turned), rolled = twist.T, share[:, None] * self.rolled[k]
        start = se2.compose(self.pose[k], se2.exp(begin[:, None] * self.twist[k]))
        lever = (end - se2.compose(start, se2.exp(twist)))[:, :2]
        middle, one = start[:, 2] + 0.5 * turned, np.ones_like(turned)
        chord = se2.rotated(middle, twist[:, :2])
        # derivative of the end pose by the turn: of the chord, and of the lever arm from the piece to the end
        by_turn = np.stack((-0.5 * chord[:, 1] - lever[:, 1], 0.5 * chord[:, 0] + lever[:, 0], one), axis=-1)
        # the direction of travel is within +-pi/2 of the body's axis; 0 is straight
        back = np.where(ahead < 0.0, -1.0, 1.0)
        sideways = (left != 0.0) & np.isfinite(left) & np.isfinite(ahead)
        direction = middle + np.where(sideways, np.arctan2(back * left, back * ahead + 0.0), 0.0)
        by_distance = np.stack((np.cos(direction), np.sin(direction), 0.0 * direction), axis=-1)
        half, turning = 0.5 * by_distance, by_turn / self.track
        by_wheels = np.stack((half - turning, half + turning), axis=-1)
        if self.matched is None:
            noise = (by_wheels * (self.noise * np.abs(rolled))[:, None]) @ np.swapaxes(by_wheels, 1, 2)
            variance, rate = self.gap_uncertainty[k].T
            if rate.any():
                # the counters give the heading after the gap; within the gap the heading is uncertain
                most = np.minimum(rate * share * (self.t[k + 1] - self.t[k]), np.pi)
                noise[:, (0, 1), (0, 1)] += (share * variance)[:, None]
                noise[:, 2, 2] += (1.0 - share) * most**2 / 3.0
        else:
            lever_of = se2.rotation(middle)
            lever_of[:, :2, 2] = by_turn[:, :2]
            noise = share[:, None, None] * se2.propagated(lever_of, self.matched[k])
        if not parameters:
            return noise, np.zeros((len(k), 3, 0))
        by_track = (-turned[:, None] * by_turn)[..., None]
        return noise, np.concatenate((by_wheels * rolled[:, None], by_track), axis=-1)


def _sums(pieces: Array, count: Ints) -> Array:
    """Sum consecutive pieces (m, ...) for each of n intervals: (n, ...); interval i has count[i] pieces."""
    out, some = np.zeros((len(count), *pieces.shape[1:])), count > 0
    if some.any():
        out[some] = np.add.reduceat(pieces, (np.cumsum(count) - count)[some])
    return out


def gap_uncertainties(t: Array, rolled: Array, turn: Array) -> Array:
    """Return (n-1, 2) for n-1 wheel intervals: in gaps position variance [m^2] and turning rate [rad/s], else 0.

    Over a gap of length T, the counters give the distance of each wheel but not the path: a straight line, an arc
    or two corners. With the fastest usual turning rate w, the heading deviates from a constant turn by up to w T /
    2 and comes back. Its mean deviation of w T / 4 (uniform) moves the position by this share of the path; at
    most, the position lies anywhere in a disc about the start.
    """
    span, distance = np.diff(t), 0.5 * np.abs(rolled).sum(axis=1)
    in_gap = span > gap_limit(t)
    if not in_gap.any():
        return np.broadcast_to(np.float64(0.0), (len(span), 2))  # needs no memory
    fastest = float(np.percentile(np.abs(turn[~in_gap]) / span[~in_gap], 99))
    sigma = distance * np.minimum(0.5, fastest * span / (4.0 * np.sqrt(3.0)))
    return np.where(in_gap[:, None], np.column_stack((sigma**2, np.full_like(span, fastest))), 0.0)


def dead_reckoning(twist: Array) -> Array:
    """Paper eq. 3 with exact arcs: poses (n+1, 3) after body twists (n, 3), from (0, 0, 0)."""
    return se2.chain(se2.exp(twist))


# ---- share of a sensor's readings that a motion explains ----
#
# Readings are turns of a gyro or compass, or distances between fixes. The log is cut into n windows. With the
# readings a (n,) of the sensor and b (n,) of the motion, the share is 1 - |a - b|^2 / |a|^2, at the best delay
# between both clocks. It is 0 for a motion at rest. Both signs of the turns are tried, so an axis that points down
# is not detected.

TURN_WINDOW_S, DISTANCE_WINDOW_S, MIN_WINDOWS = 1.0, 5.0, 5
LAGS_S = np.arange(-1.0, 1.01, 0.1)  # between the clocks of a motion and a sensor
MIN_TURN_RAD = np.radians(3.0)  # least rms turn of the sensor in a window
MIN_DISTANCE_M = 15.0  # m, least total distance: fixes of a receiver at rest drift by some metres
MAX_COUNT = 100_000  # windows
PART_S = 20.0  # s in which two paths keep their directions: wheels slip


def turns_explained(wheels: Wheels, t: Array, heading: Array) -> float | None:
    """Return the share of a sensor's turns that a motion explains; None if the sensor hardly turns.

    `heading` (n,) [rad], not wrapped, is the sensor's heading at times t (n,) [s] on the clock of the motion.
    """
    start = _spaced(t[0], t[-1] - TURN_WINDOW_S, TURN_WINDOW_S)
    seen = changes(start, TURN_WINDOW_S, t, heading)
    if len(start) < MIN_WINDOWS or np.sqrt(np.mean(seen**2)) < MIN_TURN_RAD:
        return None

    def turned(at: Array) -> Array:
        return wheels.heading(at + TURN_WINDOW_S) - wheels.heading(at)

    return max(_explained(seen, start, turned), _explained(-seen, start, turned))


def distances_explained(wheels: Wheels, t: Array, xy: Array, least: float = MIN_DISTANCE_M) -> float | None:
    """Return how much of the distance between positions a motion explains, as a share in [0, 1].

    None if there are too few positions, or less than `least` [m] between them in total. `xy` (n, 2) [m] are the
    positions at times t (n,) [s] on the clock of the motion.
    """
    start = _spaced(t[0], t[-1] - DISTANCE_WINDOW_S, DISTANCE_WINDOW_S)
    seen = _far(start, t, xy)
    if len(start) < MIN_WINDOWS or seen.sum() < least:
        return None
    return _explained(seen, start, lambda at: _far(at, wheels.t, wheels.pose[:, :2]))


def path_alike(wheels: Wheels, t: Array, xy: Array) -> float | None:
    """Return how well the bends of a path fit those of a motion: 1 for one robot, also with y to the right.

    None if there are few positions. `xy` (n, 2) [m] are those at times t (n,) [s] on the clock of the motion. With
    the steps a and b of both paths as complex numbers, minus their means over PART_S, this is the correlation
    sum |sum a b'| / (|a| |b|), the inner sum over a part, whose directions may differ, at the best delay.
    """
    margin = float(LAGS_S[-1])
    first, last = max(t[0], wheels.t[0]) + margin, min(t[-1], wheels.t[-1]) - margin - TURN_WINDOW_S
    start = _spaced(first, last, 0.5 * TURN_WINDOW_S)
    if len(start) < MIN_WINDOWS:
        return None
    parts = min(math.ceil((last - first) / PART_S), len(start) // MIN_WINDOWS)
    part = ((start - first) * parts / (last - first)).astype(np.int64)

    def bends(at: Array, t: Array, xy: Array) -> Plane:
        step: Plane = np.asarray(changes(at, TURN_WINDOW_S, t, xy) @ (1.0, 1.0j), np.complex128)
        return np.asarray(step - (sums(part, step) / np.bincount(part))[part])

    own, found = bends(start, t, xy), [0.0]
    for lag in LAGS_S.tolist():
        theirs = bends(start + lag, wheels.t, wheels.pose[:, :2])
        size = float(np.linalg.norm(own) * np.linalg.norm(theirs))
        if size > 0.0:
            found += [float(np.abs(sums(part, own * b)).sum()) / size for b in (theirs, theirs.conj())]
    return max(found)


def _spaced(first: float, last: float, step: float) -> Array:
    """Return times from `first` to `last` [s], at most MAX_COUNT: one wrong stamp may make a log decades long."""
    return np.arange(first, last, max(step, (last - first) / MAX_COUNT))


def _far(start: Array, t: Array, xy: Array) -> Array:
    return np.asarray(np.hypot(*changes(start, DISTANCE_WINDOW_S, t, xy).T))


def _explained(seen: Array, start: Array, motion: Callable[[Array], Array]) -> float:
    rest = min(float(((seen - motion(start + lag)) ** 2).sum()) for lag in LAGS_S.tolist())
    return max(0.0, 1.0 - rest / float((seen**2).sum()))


WHEELS = "wheels"
WHEEL_STATES: dict[str, Sequence[Component]] = {
    WHEELS: (
        Component("left wheel's scale", "%", 100.0),
        Component("right wheel's scale", "%", 100.0),
        Component("track, to first order", "%", 100.0),
    )
}
MAX_PRIOR_SHARE = 0.7  # a state with a larger share of its prior standard deviation is not identifiable
MAX_PRIOR_SIGMAS = 2.0  # prior standard deviations beyond which the distance scales of wheels and sensors differ


def wheel_block(wheels: WheelSettings) -> Block:
    """Return the wheel states with their prior: corrections of left wheel, right wheel and track, initially 0."""
    variance = np.array([wheels.sigma_scale, wheels.sigma_scale, wheels.sigma_track]) ** 2
    return Block(WHEELS, np.zeros(3), np.diag(variance), np.zeros(3))


def geometry_of_states(x: Array) -> Array:
    """Return the relative corrections (3,) of radius, ratio right / left, and track, for states x (3,)."""
    s, q = 0.5 * (x[0] + x[1]), x[2]
    return np.array([s, (1.0 + x[1]) / (1.0 + x[0]) - 1.0, (1.0 + s) / (1.0 + s - q) - 1.0])


def geometry_by_states(x: Array) -> Array:
    """Return the derivative (3, 3) of `geometry_of_states` by the states x (3,)."""
    a, b, q = x.tolist()
    s = 0.5 * (a + b)
    by_scale, by_turn = -0.5 * q / (1.0 + s - q) ** 2, (1.0 + s) / (1.0 + s - q) ** 2
    return np.array(
        [[0.5, 0.5, 0.0], [-(1.0 + b) / (1.0 + a) ** 2, 1.0 / (1.0 + a), 0.0], [by_scale, by_scale, by_turn]]
    )


def wheel_words(
    settings: WheelSettings, x: Array, P: Array, sensors: Sequence[str], metric: Mapping[str, str | None]
) -> list[str]:
    """Return notes for the user on the estimated wheel states x (3,) with covariance P (3, 3).

    `metric` maps each sensor that measures distances to the setting of its distance scale, or None.
    """
    found, G = geometry_of_states(x), geometry_by_states(x)
    sigma = np.sqrt(np.maximum(np.diagonal(G @ P @ G.T), 0.0))
    prior = settings.sigma_scale / math.sqrt(2.0)  # of the radius, the mean of both
    parts = []
    for key, change, s in zip(("radius", "ratio", "track"), found.tolist(), sigma.tolist(), strict=True):
        value = getattr(settings, key)
        if value is None:
            parts.append(f"{key} {100.0 * change:+.2f} % (1 sigma: {100.0 * s:.2f} %)")
        else:
            parts.append(f"{key} {value * (1.0 + change):.4g} (1 sigma: {value * s:.2g})")
    words = [f"found {', '.join(parts)}"]
    if sigma[0] > MAX_PRIOR_SHARE * prior:
        quotient = G[2] / (1.0 + found[2]) - G[0] / (1.0 + found[0])  # derivative of ln(track / radius)
        seen = math.sqrt(float(quotient @ P @ quotient)) < MAX_PRIOR_SHARE * settings.sigma_track
        tail = ": only track over radius is" if seen else ""
        words.append(f"radius and track are not identifiable from {' and '.join(sensors) or 'wheels alone'}{tail}")
    elif sigma[2] > MAX_PRIOR_SHARE * settings.sigma_track:
        words.append("the track is not identifiable: the robot hardly turned")
    elif abs(found[0]) > MAX_PRIOR_SIGMAS * prior:
        words += _scale_words(settings, found, prior, metric)
    return words


def _scale_words(
    settings: WheelSettings, found: Array, prior: float, metric: Mapping[str, str | None]
) -> list[str]:
    """Return notes for the user on the distance scale of wheels relative to sensors; [] if `metric` is empty.

    Only the ratio is observed, so a note cannot name which of the two is wrong. `found` (3,) are the relative
    corrections of radius, ratio and track. `metric` maps each sensor that measures distances to the setting of its
    distance scale, or None.
    """
    if not metric:
        return []
    scale, _, track = found.tolist()
    words = (
        f"by the distance scale of {' and '.join(metric)} the wheels are {100.0 * abs(scale):.1f} % "
        f"{'larger' if scale > 0 else 'smaller'} than configured, and {100.0 * prior:.1f} % was expected. "
    )
    keys = [f"{sensor}.{key}" for sensor, key in metric.items() if key]
    if len(metric) > 1 or not keys:
        return [words + "One of the two is wrong, and which is not identifiable here"]
    track_words = f", the track is {settings.track * (1.0 + track) / (1.0 + scale):.4g}" if settings.track else ""
    return [
        words + f"Which is wrong is not identifiable from them: if the radius is right, {keys[0]} should be "
        f"{1.0 / (1.0 + scale):.4g} times what it is{track_words}; if {keys[0]} is right, the figures above hold"
    ]
