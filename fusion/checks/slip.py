"""Wheel slip: observed noise of turns and distances compared with `wheels.noise`; intervals of wheel spin.

Slip of one wheel turns the robot, so the wheels' turns are compared with those of other sensors. Slip of both
wheels does not turn it, so the wheels' distances are compared with those of a path.

The variance of a turn by slip grows with the distance; the variance by a sensor's noise is constant. So the growth
of the variance from short to long windows is due to slip (Allan 1966 separates a clock's noises in the same way).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Drive, interpolate, stretches
from locfuse.fusion.statistics import robust_sigma
from locfuse.fusion.wheels.motion import Wheels

from .finding import Finding
from .lag import headings

SHORT_S, LONG_S = 0.5, 2.0  # s: windows over which turns are compared
MAX_STRETCH = 1.5  # largest time between two readings over the length of the window: with more there is a gap
MIN_WINDOWS = 15  # least number of long windows without overlap: their variance is then known to a third
MIN_EXPECTED_RAD = math.radians(0.05)  # least expected sigma of turns in a long window: below it the robot stood
MIN_EXPECTED_M = 1e-4  # likewise, of distances
MAX_FACTOR = 3.0  # the variance is unusual if it is larger or smaller than expected by more than this factor
DOUBT_SIGMAS = 2.0  # sigmas by which the factor must exceed MAX_FACTOR
# --- slip of both wheels together
WINDOW_S, STEP_S = 1.0, 0.25  # s over which distances are compared, and between the starts of two windows
MIN_SPIN_M, MIN_SPIN_SHARE, SPIN_SIGMAS = 0.08, 0.15, 6.0  # least slip: m, share of the rolled distance, sigmas
MAX_SPINNING_SHARE = 0.1  # largest share of the windows with motion: with more the error has another cause
SPIN = "spin"  # code of the finding


class WheelSlip(NamedTuple):
    """Observed and configured slip of the wheels."""

    factor: float  # by which `wheels.noise` should be multiplied
    seen: float  # rad, over LONG_S: observed 1 sigma of turns by slip
    expected: float  # rad, the same by `wheels.noise`
    by: str = ""  # reference: a sensor, or several that agree: "compass and lrf"
    sigma: float = 0.0  # of the factor, by the sensor's own noise
    ahead: tuple[float, float] | None = None  # m, over LONG_S: observed and expected, if by distances

    @property
    def unusual(self) -> bool:
        """Whether the observed slip differs from the configured one by more than chance."""
        doubt = DOUBT_SIGMAS * self.sigma
        return self.factor + doubt < 1.0 / MAX_FACTOR or self.factor - doubt > MAX_FACTOR

    @property
    def words(self) -> str:
        """Text with the observed and the configured slip."""
        turns = f"{math.degrees(self.seen):.2g}°", f"{math.degrees(self.expected):.2g}°"
        ways = ("", "") if self.ahead is None else tuple(f" and {1000.0 * way:.2g} mm" for way in self.ahead)
        return (
            f"slips are {turns[0]}{ways[0]} in {LONG_S:g} s (1 sigma, by the {self.by}); "
            f"wheels.noise says {turns[1]}{ways[1]}"
        )


class _Spread(NamedTuple):
    """Variances of turn differences [rad^2] or distance differences [m^2] over windows of one length."""

    seen: tuple[float, float]  # observed: robust (by the median), and of all windows
    expected: float  # by slip
    number: int  # of windows, one for each reading


def slip(drive: Drive) -> WheelSlip | None:
    """Return the smallest wheel slip that any sensor shows; None if no sensor shows slip.

    A sensor's drift looks like slip, so the smallest value is nearest to that of the wheels. If all sensors show
    clearly less than configured, the largest of their values is returned, since all sensors agree that the slip is
    not larger.
    """
    if drive.wheels.matched is not None or drive.wheels.noise <= 0.0:
        return None
    found = []
    for name, (t, heading) in headings(drive.measurements).items():
        short, long = (_turns(t, heading, window, drive.wheels) for window in (SHORT_S, LONG_S))
        growth = _growth(short, long, MIN_EXPECTED_RAD)
        if growth is not None and np.ptp(heading) > 0.0:  # it is 0 for scans without lines
            found.append(growth._replace(by=name))
    less = [s for s in found if s.factor < 1.0 / MAX_FACTOR]
    if len(less) > 1 and len(less) == len(found):
        names = " and ".join(s.by for s in less)
        return max(less, key=lambda s: s.factor)._replace(by=names)
    return min(found, key=lambda s: s.factor, default=None)


def beside_path(found: WheelSlip, drive: Drive, t: Array, pose: Array) -> WheelSlip:
    """Return the larger slip: `found`, or that of wheel distances against a path `pose` (n, 3) at t (n,) [s].

    `wheels.noise` is for distances and turns. If a driver computes turns by a gyro, turns are accurate, but
    distances contain slip.
    """
    begin = np.unique(np.floor(t / STEP_S)) * STEP_S
    short, long = (_distances(drive.wheels, begin, t, pose, window) for window in (SHORT_S, LONG_S))
    growth = _growth(short, long, MIN_EXPECTED_M)
    if growth is None or growth.factor <= found.factor:
        return found
    return found._replace(factor=growth.factor, sigma=growth.sigma, ahead=(growth.seen, growth.expected))


def _growth(short: _Spread | None, long: _Spread | None, least: float) -> WheelSlip | None:
    """Return the slip by the ratio of observed to expected growth of the variance from short to long windows.

    Its `seen` and `expected` have the unit of the windows [m or rad]. None if the expected slip in a long window
    is below `least`, or if the variance does not grow: then other noise hides the slip.
    """
    if short is None or long is None:
        return None
    growth = long.expected - short.expected
    if growth < least**2 * (1.0 - SHORT_S / LONG_S):
        return None
    usual, whole = (max(b - a, 0.0) / growth for a, b in zip(short.seen, long.seen, strict=True))
    # a factor below 1 must hold for both variances, so that rare slips are not overlooked
    factor = usual if usual > 1.0 else min(max(whole, usual), 1.0)
    if factor <= 0.0:
        return None
    # white noise: the variance of a variance of n values is 2 / n of its square
    sigma = math.sqrt(sum(2.0 * s.seen[1] ** 2 / s.number for s in (short, long))) / growth
    return WheelSlip(factor, math.sqrt(factor * long.expected), math.sqrt(long.expected), sigma=sigma)


def _turns(t: Array, heading: Array, window: float, wheels: Wheels) -> _Spread | None:
    """Return the spread of turn differences between a sensor and the wheels over windows [s]; or None."""
    last = np.searchsorted(t, t + window)
    first = np.flatnonzero(last < len(t))
    start, end = t[first], t[last[first]]
    whole = (end - start < MAX_STRETCH * window) & (start >= wheels.t[0]) & (end <= wheels.t[-1])
    if not whole.any() or np.ptp(start[whole]) < MIN_WINDOWS * window:
        return None
    own = (heading[last[first]] - heading[first])[whole]
    start, end = start[whole], end[whole]
    slips = wheels.slips(np.stack((start, end), axis=-1))[:, 0].sum(axis=-1) / wheels.track**2
    return _spread(own, wheels.heading(end) - wheels.heading(start), slips)


def _distances(wheels: Wheels, begin: Array, t: Array, pose: Array, window: float) -> _Spread | None:
    """Return the spread of the differences between distances of a path and of the wheels, over equal windows.

    The windows begin at the times `begin` [s] and last `window` [s]. Return None if they are too few.
    """
    begin = begin[(begin >= max(t[0], wheels.t[0])) & (begin + window <= min(t[-1], wheels.t[-1]))]
    if len(begin) < 2 or np.ptp(begin) < MIN_WINDOWS * window:
        return None
    slips = wheels.slips(np.stack((begin, begin + window), axis=-1))[:, 0].sum(axis=-1) / 4.0
    return _spread(_ahead(t, pose, begin, window), wheels.relative(begin, begin + window)[:, 0], slips)


def _ahead(t: Array, pose: Array, begin: Array, window: float) -> Array:
    """Return the forward distances (m,) [m] of a path (n, 3) in the windows [s] after times `begin` (m,)."""
    first, last = (interpolate(at, t, pose) for at in (begin, begin + window))
    return se2.between(first, last)[:, 0]


def _spread(own: Array, by_wheels: Array, slips: Array) -> _Spread:
    """Return residual variances of a sensor's motions `own` (n,), and the mean of slip variances `slips` (n,).

    They are residuals of a linear fit by the wheels' motions `by_wheels` (n,), so that scale errors (track,
    radius, sensor) do not count as noise.
    """
    A = np.stack((by_wheels, np.ones_like(by_wheels)), axis=-1)
    x, *_ = np.linalg.lstsq(A, own, rcond=None)
    rest = own - A @ x
    return _Spread((robust_sigma(rest - np.median(rest)) ** 2, float(rest.var())), float(slips.mean()), len(rest))


def of_spins(drive: Drive, t: Array, pose: Array, name: str, jumps: Sequence[float] = ()) -> list[Finding]:
    """Return findings on intervals in which wheel distance and distance of a path (n, 3) at t (n,) [s] differ.

    Windows with corrections of the path at times `jumps` [s] are left out. The median ratio removes a scale error;
    the spread of all windows allows for a late clock.
    """
    wheels = drive.wheels
    begin = t[np.diff(np.floor(t / STEP_S), prepend=-np.inf) > 0]
    begin = begin[(begin >= wheels.t[0]) & (begin + WINDOW_S <= min(t[-1], wheels.t[-1]))]
    if wheels.matched is not None or len(begin) < MIN_WINDOWS:
        return []
    moved = _ahead(t, pose, begin, WINDOW_S)
    rolled = wheels.relative(begin, begin + WINDOW_S)[:, 0]
    drove = np.abs(rolled) > MIN_SPIN_M
    for when in jumps:
        drove &= (begin > when) | (begin + WINDOW_S < when)
    if drove.sum() < MIN_WINDOWS:
        return []
    rest = rolled - moved * float(np.median(rolled[drove] / np.where(moved[drove] == 0.0, np.inf, moved[drove])))
    least = SPIN_SIGMAS * robust_sigma(rest[drove] - np.median(rest[drove]))
    far = drove & (np.abs(rest) > np.maximum(least, MIN_SPIN_SHARE * np.abs(rolled)))
    if far.sum() > MAX_SPINNING_SHARE * drove.sum():
        return []
    found = []
    for a, b in stretches(far):
        first, last = begin[a], begin[b] + WINDOW_S
        lost = float(rest[a : b + 1].sum()) * STEP_S / WINDOW_S
        if abs(lost) < MIN_SPIN_M or last - first < 2.0 * WINDOW_S:
            continue
        side = "farther" if lost * rolled[a : b + 1].sum() > 0.0 else "less far"
        words = f"from {first:.1f} s to {last:.1f} s they rolled {abs(lost):.2f} m {side} than the {name} moved"
        found.append(Finding("wheels", SPIN, f"{words}: both wheels slipped"))
    return found
