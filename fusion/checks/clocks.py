"""Checks of the clocks: every two of them are compared, and the fewest wrong ones that explain it are named.

Turning is compared for sensors and for a truth with headings, speed for one without, at every lag. Wheels slip:
over a lap of the paper's robot they show a lag to 7 ms at best (docs/trust.md), and slips move the lags of all
sensors alike. Two sensors see the same turning, slips and all. So the truth is a clock like any other: where two
sensors are equally late against it, and in time with the wheels, its clock is the one that is off.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from locfuse.fusion.chi_square import MAD
from locfuse.fusion.data import Array, Drive, Estimates, Measurements, Truth
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.truth import body_poses
from locfuse.fusion.wheels.motion import Wheels

from .finding import Finding
from .lag import SAID_SIGMAS, Lag, Reference, by_wheels, find_lag

WINDOW_S = 1.0  # s over which ways are compared
MAX_LAG_S, LAG_STEP_S = 1.5, 0.02  # s
MIN_TRUTH_LAG_S, MAX_MISFIT_RATIO, MIN_CORRELATION = 0.06, 0.75, 0.9
SEVERE_LAG_S = 0.1  # s: at half a metre per second and a radian per second this is centimetres and degrees
MAX_STAMPED_RATIO = 0.85  # of the misfits as stamped and shifted: nearer to 1 they say nothing of the clock
MIN_LAG_S = 0.01  # s: a smaller lag is not named
SPEED_SIGMA_S = 0.03  # s, 1 sigma of a lag that speeds or places tell
MODEL_SIGMA_S = 0.002  # s, 1 sigma of what two clocks differ by beside what their readings show
RELUCTANCE = {"truth": 0.1, "wheels": 0.2}  # of chi-square: who is accused last where it could be any of them
NEAR = 4.0  # of chi-square: explanations that differ by less are as good as each other
CLOCK = "lag"  # code of the finding on one
OPEN_CLOCK = "clocks"  # of a truth and one other clock that differ: either may be off, so the user decides
LASER = "lrf"
MAX_WRONG = 3  # clocks of one log
RUN_BY_WHEELS = 0.1  # of the wheels' lag, by which a laser's run may be late too
UNEVEN = "uneven"  # code of the finding that stamps scatter about an even clock
MIN_SCATTER_S, MIN_SCATTER_SHARE = 0.01, 0.1  # s and share of the period, 1 sigma: less is not reported
MAX_EVEN_CORRELATION = -0.35  # of neighbouring intervals: -0.5 about an even clock, 0 where periods vary
MIN_EVEN_PERIODS = 50
AS_STAMPED = Lag(0.0, 1.0, 1.0)
Pair = tuple[str, str]  # two clocks


class Clock(NamedTuple):
    """A clock that the clocks of other sensors contradict."""

    name: str
    offset: float  # s to add to its stamps
    sigma: float  # s
    against: tuple[str, ...]  # the clocks that it was compared with


def of_clocks(drive: Drive, robot: Robot) -> list[Finding]:
    """Return the streams whose clock is off, with the offset that they need."""
    explanations = wrong_clocks(differences(drive, robot), SAID_SIGMAS)
    if not explanations:
        return []
    equal = [other for (other,) in (e for e in explanations[1:] if len(e) == 1)]
    found = []
    for clock in explanations[0]:
        rival = equal[0] if len(explanations[0]) == 1 and equal else None
        words = clock_words(clock)
        if rival is not None:
            words += (
                f"; no third clock shows which of the two is wrong: {offset_of(rival, robot, 2)} is equivalent"
            )
        severe = abs(clock.offset) > SEVERE_LAG_S
        digits = 2 if clock.sigma > MIN_LAG_S else 3
        code = CLOCK if rival is None or "truth" not in {clock.name, rival.name} else OPEN_CLOCK
        found.append(Finding(clock.name, code, words, (offset_of(clock, robot, digits),), severe))
    return found


def of_uneven_stamps(name: str, t: Array) -> list[Finding]:
    """Report stamps t (n,) [s] that scatter about an even clock: intervals that are too long, then too short.

    Where periods vary by themselves, neighbouring intervals do not depend on each other.
    """
    if len(t) <= MIN_EVEN_PERIODS:
        return []
    dt = np.diff(t)
    period = float(np.median(dt))
    sigma = float(np.median(np.abs(dt - period))) / MAD / math.sqrt(2.0)  # it has the errors of two stamps
    if sigma < max(MIN_SCATTER_S, MIN_SCATTER_SHARE * period):
        return []
    off = np.clip(dt, 0.0, 2.0 * period)  # of dropped readings, a part
    if np.corrcoef(off[1:], off[:-1])[0, 1] > MAX_EVEN_CORRELATION:
        return []
    words = (
        f"stamps scatter by {sigma:.3f} s (1 sigma) about an even period of {period:.3f} s. If it measures "
        "evenly, its stamps are wrong by that: let the driver stamp by the sensor's own clock"
    )
    return [Finding(name, UNEVEN, words)]


def clock_words(clock: Clock) -> str:
    """Return "stamps look 0.12 s late (1 sigma: 0.005 s) against the wheels and the compass"."""
    side = "late" if clock.offset < 0.0 else "early"
    *most, last = (f"the {name}" for name in clock.against)
    whom = f"{', '.join(most)} and {last}" if most else last
    size = f"{abs(clock.offset):.{2 if abs(clock.offset) > SEVERE_LAG_S else 3}f}"
    return f"stamps look {size} s {side} (1 sigma: {clock.sigma:.3f} s) against {whom}"


def offset_of(clock: Clock, robot: Robot, digits: int = 3, sigmas: float = 0.0) -> str:
    """Return the setting that corrects a clock; `sigmas` standard deviations are added to its value."""
    tables: dict[str, Any] = {"wheels": robot.wheels, "truth": robot.truth}
    now = float((tables.get(clock.name) or robot.settings(clock.name)).time_offset)
    return f"{clock.name}.time_offset={now + clock.offset + sigmas * clock.sigma:z.{digits}f}"


def differences(drive: Drive, robot: Robot, runs: Iterable[Estimates] = ()) -> dict[Pair, Lag]:
    """Return for every pair of clocks the lag: the time to add to the first clock to match the second.

    `runs` may hold the laser's own: its map holds the heading at each scan, which shows its clock better. It goes
    by the wheels too, and is late by a part of what they are.
    """
    wheels, truth = drive.wheels, drive.truth
    turned = {name: h for name, m in drive.measurements.items() if (h := _heading(name, m)) is not None}
    base = LASER if wheels.matched is not None else "wheels"  # there the scans are the motion
    found = {(name, base): find_lag(*h, by_wheels(wheels)) for name, h in turned.items() if name != base}
    by_run = next((e for e in runs if e.sensors == (LASER,) and not e.smoothed and not e.lost), None)
    for one, other in combinations(turned, 2):
        found[one, other] = _between_two(turned[one], turned[other], wheels)
    if by_run is not None:
        headings = Truth("", by_run.t, by_run.pose[:, :2], by_run.pose[:, 2])
        of_run = {s: lag for s, lag in lags_by_truth(drive, headings).items() if s != LASER}
        found = {pair: lag for pair, lag in found.items() if not {LASER, *of_run}.issuperset(pair)}
        found |= {(s, LASER): _of_a_run(lag, found.get((LASER, base))) for s, lag in of_run.items()}
    if truth is not None:
        by_motion = truth_lag(drive)
        found |= {(name, "truth"): lag for name, lag in lags_by_truth(drive, truth).items()}
        own = None if by_run is None else lag_of_run(drive, truth, by_run)
        if own is not None:
            found[LASER, "truth"] = _of_a_run(own, by_motion)
        found["truth", base] = by_motion
        found |= dict.fromkeys(_on_truths_clock(drive, robot, by_motion), AS_STAMPED)
    return {pair: _known(lag, pair) for pair, lag in found.items() if lag is not None}


def _known(lag: Lag, pair: Pair) -> Lag:
    """Return a lag with a realistic sigma; a lag found only by speed is set to 0 unless significant."""
    if math.isfinite(lag.sigma):
        return lag._replace(sigma=math.hypot(lag.sigma, MODEL_SIGMA_S))
    return lag._replace(offset=lag.offset if off_by(lag) else 0.0, sigma=SPEED_SIGMA_S)


def _of_a_run(lag: Lag, by_wheels: Lag | None) -> Lag:
    """Return a run's lag; its sigma is increased by the share of the wheels' lag that the run may contain."""
    drawn = 0.0 if by_wheels is None else RUN_BY_WHEELS * by_wheels.offset
    return lag._replace(sigma=math.hypot(lag.sigma, drawn))


def _between_two(one: tuple[Array, Array], other: tuple[Array, Array], wheels: Wheels) -> Lag | None:
    """Return the lag of one heading to another one, found in both directions; the more certain one wins."""
    spans = [(float(t[0]), float(t[-1])) for t, _ in (one, other)]
    there = find_lag(*one, Reference(partial(_interpolated, *other), spans[1], wheels.heading))
    back = find_lag(*other, Reference(partial(_interpolated, *one), spans[0], wheels.heading))
    found = [there, None if back is None else back._replace(offset=-back.offset)]
    return min((lag for lag in found if lag is not None), key=lambda lag: lag.sigma, default=None)


def wrong_clocks(pairs: Mapping[Pair, Lag], sigmas: float, least: float = MIN_LAG_S) -> list[tuple[Clock, ...]]:
    """Return the smallest set of wrong clocks that explains the lags; equally good sets follow; [] for none.

    A clock that is off costs the square of `sigmas`; others that explain as much are returned too. With three
    clocks the one that two others contradict is off; of two clocks alone either may be. Lags against wheels that
    slip have one cause of error, so that several are no surer than one. Lags below `least` [s] are not named.
    """
    names = sorted({name for pair in pairs for name in pair})
    number = {name: sum(name in pair for pair in pairs) for name in names}
    of_wheels = max(number.get("wheels", 1), 1) ** 0.5
    sizes = {p: lag.sigma * (of_wheels if "wheels" in p else 1.0) for p, lag in pairs.items()}
    found: list[tuple[float, tuple[Clock, ...]]] = []
    for count in range(min(len(names), MAX_WRONG + 1)):
        for off in combinations(names, count):
            chi, clocks = explained(pairs, sizes, off)
            cost = chi + sigmas**2 * count + sum(RELUCTANCE.get(name, 0.0) for name in off)
            found.append((cost, clocks))
    found.sort(key=lambda one: one[0])
    best = [clocks for cost, clocks in found if cost < found[0][0] + NEAR]
    if not best or not best[0]:
        return []
    named = (tuple(c for c in clocks if abs(c.offset) >= least) for clocks in best)
    return [clocks for clocks in named if clocks]


def explained(
    pairs: Mapping[Pair, Lag], sizes: Mapping[Pair, float], off: Sequence[str]
) -> tuple[float, tuple[Clock, ...]]:
    """Fit the offsets of these clocks to the lags (least squares); return chi-square and the clocks."""
    rows = [p for p in pairs if p[0] in off or p[1] in off]
    A = np.array([[(p[0] == name) - float(p[1] == name) for name in off] for p in pairs]).reshape(
        len(pairs), len(off)
    )
    y, w = np.array([lag.offset for lag in pairs.values()]), np.array([1.0 / sizes[p] for p in pairs])
    x, _, rank, _ = np.linalg.lstsq(A * w[:, None], y * w, rcond=None)
    if rank < len(off):
        return math.inf, ()
    rest = (y - A @ x) * w
    chi = float(rest @ rest)
    worse = max(1.0, chi / max(1, len(y) - len(off)))
    C = np.linalg.inv((A * w[:, None]).T @ (A * w[:, None])) * worse if len(off) else np.zeros((0, 0))
    against = {name: [q for p in rows for q in p if name in p and q not in off] for name in off}
    return chi, tuple(
        Clock(name, float(x[i]), math.sqrt(float(C[i, i])), tuple(dict.fromkeys(against[name])))
        for i, name in enumerate(off)
    )


def _on_truths_clock(drive: Drive, robot: Robot, lag: Lag | None) -> list[Pair]:
    """Return (sensor, truth) pairs of sensors that fit the truth clearly better with unshifted stamps.

    They know places, not turning: landmarks. A robot that follows its commands late looks like a late truth.
    """
    truth = drive.truth
    if truth is None or truth.theta is None or lag is None or abs(lag.offset) < MIN_LAG_S:
        return []
    found = []
    for name, every in drive.measurements.items():
        inside = (every.t > truth.t[0] + MAX_LAG_S) & (every.t < truth.t[-1] - MAX_LAG_S)
        m = every.take(np.flatnonzero(inside))
        spreads = [
            REGISTRY[name].misfit(m, robot.settings(name), body_poses(truth, m.t - shift))
            for shift in (0.0, lag.offset)
        ]
        stamped, shifted = spreads
        if stamped is not None and shifted is not None and stamped < MAX_STAMPED_RATIO * shifted:
            found.append((name, "truth"))
    return found


def lags_by_truth(drive: Drive, truth: Truth | None) -> dict[str, Lag]:
    """Return how far each sensor's clock is from the truth's, by the truth's headings: these never slip.

    In place of the truth there may be a run that knows its heading better than the wheels do.
    """
    reference = _by_headings(drive, truth)
    if reference is None:
        return {}
    turned = {
        name: heading for name, m in drive.measurements.items() if (heading := _heading(name, m)) is not None
    }
    found = {name: find_lag(*heading, reference) for name, heading in turned.items()}
    return {name: lag._replace(against="truth") for name, lag in found.items() if lag is not None}


def lag_of_run(drive: Drive, truth: Truth | None, run: Estimates) -> Lag | None:
    """Return how far the clock of a run's only sensor is from the truth's, by the headings of the run.

    The run of a laser turns by the clock of its scans, since its map holds the heading at each of them, and with
    less noise than turns from scan to scan have: the lag's sigma is about half as large. A sensor that the wheels
    outweigh would show a part of its lag only.
    """
    reference, (sensor,) = _by_headings(drive, truth), run.sensors
    if reference is None or len(drive.instant[sensor]) < MIN_READINGS:
        return None
    at = np.unique(drive.instant[sensor])[:MAX_READINGS]
    found = find_lag(run.t[at], run.pose[at, 2], reference)
    return None if found is None else found._replace(against="truth")


def _by_headings(drive: Drive, truth: Truth | None) -> Reference | None:
    """Return the truth's headings as the reference for a lag; None if it has none."""
    if truth is None or truth.theta is None or len(truth.t) < MIN_READINGS:
        return None
    span = (float(truth.t[0]), float(truth.t[-1]))
    return Reference(
        partial(_interpolated, truth.t, np.unwrap(truth.theta)), span, drive.wheels.heading, wanders=False
    )


def off_by(lag: Lag) -> bool:
    """Return whether the truth's lag is large and certain enough to be reported."""
    clearly = 1.0 - lag.correlation <= MAX_MISFIT_RATIO * (1.0 - lag.without)
    return abs(lag.offset) >= MIN_TRUTH_LAG_S and lag.correlation >= MIN_CORRELATION and clearly


def truth_lag(drive: Drive) -> Lag | None:
    """Return the lag of the truth by its headings, else by its speed; None if neither shows one."""
    truth, wheels = drive.truth, drive.wheels
    if truth is None or len(truth.t) < 5:
        return None
    turning = None
    if truth.theta is not None:
        turning = find_lag(truth.t, np.unwrap(truth.theta), by_wheels(wheels))
    return turning or way_lag(truth, drive)


def way_lag(truth: Truth, drive: Drive) -> Lag | None:
    """Return the lag at which the truth's speed follows the wheels' best; None where speed hardly changes."""
    wheels = drive.wheels
    inside = (truth.t > wheels.t[0] + MAX_LAG_S) & (truth.t < wheels.t[-1] - MAX_LAG_S - WINDOW_S)
    start = truth.t[inside & (truth.t + WINDOW_S <= truth.t[-1])]
    if len(start) < 20:
        return None
    ends = [np.stack([np.interp(start + s, truth.t, c) for c in truth.xy.T], axis=-1) for s in (0.0, WINDOW_S)]
    own = np.hypot(*(ends[1] - ends[0]).T)
    if own.std() < 0.02 or own.std() < 0.1 * own.mean():
        return None
    lags = np.arange(-MAX_LAG_S, MAX_LAG_S + LAG_STEP_S / 2, LAG_STEP_S)
    scores = []
    for lag in lags.tolist():
        theirs = np.hypot(*wheels.relative(start + lag, start + lag + WINDOW_S)[:, :2].T)
        scores.append(float(np.corrcoef(own, theirs)[0, 1]) if theirs.std() > 0 else 0.0)
    best = int(np.argmax(scores))
    if scores[best] < MIN_CORRELATION or best in {0, len(lags) - 1}:
        return None
    return Lag(float(lags[best]), scores[best], scores[int(np.argmin(np.abs(lags)))])


MIN_READINGS = 20  # readings
MAX_READINGS = 3000  # enough to find a lag: five minutes of a 10 Hz laser


def clock_lags(measurements: Mapping[str, Measurements], wheels: Wheels) -> dict[str, Lag]:
    """Return how far each sensor's clock is from the wheels', from the first minutes of the drive."""
    turned = {name: heading for name, m in measurements.items() if (heading := _heading(name, m)) is not None}
    found = {name: find_lag(*heading, by_wheels(wheels)) for name, heading in turned.items()}
    return {name: lag for name, lag in found.items() if lag is not None}


def _heading(name: str, m: Measurements) -> tuple[Array, Array] | None:
    """Return times (n,) [s] and headings (n,) [rad] of a sensor that measures its own turning, else None."""
    if len(m.t) < MIN_READINGS:
        return None
    heading = REGISTRY[name].heading(m.take(np.arange(min(len(m.t), MAX_READINGS))))
    if heading is None:
        return None
    t, angle = heading
    known = np.isfinite(angle)
    return (t[known], angle[known]) if known.sum() >= MIN_READINGS else None


def _interpolated(t: Array, heading: Array, at: Array) -> Array:
    return np.interp(at, t, heading)
