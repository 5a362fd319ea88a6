"""Clock checks: all pairs of clocks are compared, and the smallest set of wrong clocks is reported.

Two clocks are compared by turns at every lag; a truth without headings is compared by speeds. Since wheels slip,
they show a lag to 7 ms at best over a lap of the paper's robot (docs/trust.md), and a slip changes the lags of all
sensors equally. Two sensors measure the same turns, so their comparison has no such error. The truth is one of the
clocks: if two sensors have the same lag relative to the truth, and no lag relative to the wheels, the truth's
clock is wrong.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import partial
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import LASER, Array, Drive, Estimates, Ints, Measurements, Stream, Truth, changes
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.statistics import jackknife, robust_sigma
from locfuse.fusion.streams import parts_of
from locfuse.fusion.truth import poses_at
from locfuse.fusion.wheels.motion import Wheels

from .finding import Finding
from .lag import (
    MAX_READINGS,
    MIN_READINGS,
    PART_COUNT,
    SAID_SIGMAS,
    HeadingReference,
    Lag,
    by_wheels,
    find_lag,
    headings,
)
from .start import MIN_START_ERROR_M, MIN_START_ERROR_RAD
from .tracked_point import swing_by_positions

WINDOW_S = 1.0  # s over which distances are compared
MAX_LAG_S, LAG_STEP_S = 1.5, 0.02  # s
# for a lag above MAX_LAG_S: s of the drive that are compared, s between windows, least number of windows
MAX_FAR_S, FAR_STEP_S, MIN_FAR_STEPS = 600.0, 0.1, 200
MAX_RIVAL_CORRELATION = 0.7  # at other lags: a drive that repeats itself would fit at several lags
MIN_FAR_CHANGE = 0.02  # m or rad per window, least standard deviation from which a lag is found
MIN_TRUTH_LAG_S, MAX_MISFIT_RATIO, MIN_CORRELATION = 0.06, 0.75, 0.9
SEVERE_LAG_S = 0.1  # s: at half a metre per second and a radian per second this is centimetres and degrees
MIN_LAG_S = 0.01  # s: a smaller lag is not reported
SPEED_SIGMA_S = 0.03  # s, 1 sigma of a lag by speeds or positions
MODEL_SIGMA_S = 0.002  # s, 1 sigma by model errors, added to the sigma of every lag
# chi-square added to explanations with these clocks, so that other clocks are preferred
PREFERENCE_COST = {"truth": 0.1, "wheels": 0.2}
EARLY_COST = 0.5  # the same for one early clock: stamps are taken after the measurement, so most are late
NEAR_CHI2 = 4.0  # explanations whose chi-square differs by less are equally good
CLOCK = "lag"  # code of the finding on a wrong clock
MAX_WRONG = 3  # largest number of wrong clocks in one log
UNEVEN = "uneven"  # code of the finding that stamps scatter about an even clock
EQUAL = "equal stamps"  # code of the finding that messages of a topic share their stamps
MAX_EQUAL_SHARE = 0.1  # largest share of readings with the same stamp as the reading before
MIN_SCATTER_S, MIN_SCATTER_SHARE = 0.01, 0.1  # s and share of the period, 1 sigma: less is not reported
MAX_EVEN_CORRELATION = -0.35  # of neighbouring intervals: it is -0.5 for an even clock, 0 if periods vary
MAX_ALTERNATING_CORRELATION = 0.3  # of every second interval: it is 0 for an even clock, 1 for long, short, long
MIN_EVEN_PERIODS = 50
WHEEL_LAG_SHARE = 0.1  # share of the wheels' lag that a laser's run may contain
MAX_PLACED, PLACE_STEP_S = 2000, 0.05  # readings that are used; s, steps of the lag
LAG_STEPS = 6  # to each side of the best lag, that a parabola is fitted to
MAX_FAR_PLACES_S, MAX_FAR_RATIO = 60.0, 0.5  # s, such as leap seconds; largest ratio of the residuals there
# s: 1 sigma of a lag by residuals of positions, by model errors; largest sigma, which slow drives exceed
PLACES_SIGMA_S, MAX_PLACES_SIGMA_S = 0.02, 0.1
Pair = tuple[str, str]  # two clocks


class Clock(NamedTuple):
    """A wrong clock, with its offset by comparison with other clocks."""

    name: str
    offset: float  # s to add to its stamps
    sigma: float  # s
    against: tuple[str, ...]  # the clocks that it was compared with


def of_clocks(drive: Drive, robot: Robot) -> list[Finding]:
    """Return findings on wrong clocks, with the time offset that corrects each.

    If either of two clocks may be wrong, and neither is the laser's, there is no fix: the laser's run in `compare`
    shows which clock is wrong.
    """
    explanations = wrong_clocks(differences(drive, robot), SAID_SIGMAS)
    rival = rival_of(explanations)
    found = []
    for clock in explanations[0] if explanations else ():
        offset = offset_of(clock, robot, 2 if clock.sigma > MIN_LAG_S else 3)
        words, fixes = f"{clock_words(clock)}{rival_words(rival, robot)}", [offset]
        if rival is not None and LASER in drive.measurements and LASER not in {clock.name, rival.name}:
            either = f"either {offset} or {offset_of(rival, robot, 2)}. To find out which: locfuse compare"
            words, fixes = f"{clock_words(clock)}: {either}", []
        found.append(Finding(clock.name, CLOCK, words, tuple(fixes), abs(clock.offset) > SEVERE_LAG_S))
    return found


def rival_of(explanations: Sequence[Sequence[Clock]]) -> Clock | None:
    """Return the wrong clock of another explanation, if it and the first have one wrong clock each; else None.

    Explanations are equally good; each is a list of wrong clocks.
    """
    first, *others = explanations or ((),)
    return next((e[0] for e in others if len(first) == len(e) == 1 and e[0].name != first[0].name), None)


def rival_words(rival: Clock | None, robot: Robot) -> str:
    """Return a clause with the time offset of the other clock that may be wrong, `rival`; "" for None."""
    if rival is None:
        return ""
    return f" (equivalent: {offset_of(rival, robot, 2)}); no third clock shows which of the two is wrong"


def of_uneven_stamps(name: str, t: Array) -> list[Finding]:
    """Report stamps t (n,) [s] that scatter about an even clock: a short interval follows each long one.

    If the periods themselves vary, neighbouring intervals are independent.
    """
    if len(t) <= MIN_EVEN_PERIODS:
        return []
    dt = np.diff(t)
    period = float(np.median(dt))
    # an interval has the errors of two stamps
    sigma = robust_sigma(dt - period) / math.sqrt(2.0)
    if sigma < max(MIN_SCATTER_S, MIN_SCATTER_SHARE * period):
        return []
    off = np.clip(dt, 0.0, 2.0 * period)  # limits the effect of dropped readings
    one, two = (float(np.corrcoef(off[k:], off[:-k])[0, 1]) for k in (1, 2))
    if one > MAX_EVEN_CORRELATION or two > MAX_ALTERNATING_CORRELATION:
        return []
    words = (
        f"stamps scatter by {sigma:.3f} s (1 sigma) about an even period of {period:.3f} s. If it measures "
        "evenly, its stamps are wrong by that: let the driver stamp by the sensor's own clock"
    )
    return [Finding(name, UNEVEN, words)]


def of_equal_stamps(drive: Drive, stream: Callable[[str], Stream]) -> list[Finding]:
    """Report topics whose stamps stand still: consecutive, different readings have the same stamp.

    The mean error of such stamps is half the time to the next stamp. Equal stamps of different topics are normal.
    `stream` returns the raw readings of a role.
    """
    times = {"wheels": drive.wheels.t, **{name: m.t for name, m in drive.measurements.items()}}
    times |= {} if drive.truth is None else {"truth": drive.truth.t}
    found = []
    for role, t in times.items():
        step, dropped = np.diff(t), drive.dropped.get(role, {})
        n, equal = len(t) + sum(dropped.values()), int((step == 0.0).sum()) + dropped.get("same_stamp", 0)
        period = float(np.median(step[step > 0.0])) if step.any() else math.inf
        if equal <= MAX_EQUAL_SHARE * n or 0.5 * equal / n * period < MIN_SCATTER_S:
            continue
        part, *others = parts_of(stream(role))
        if others:
            continue
        if getattr(part, "recorded_at_once", False):  # harmless
            words = f"{part.topic}: messages with the header stamp of the one before have its recording time too: "
            words += "no time of theirs is known. Let the driver stamp each message"
            found.append(Finding(role, "recorded at once", words))
            continue
        if getattr(part, "delay_s", None) is None:  # a file has no times of recording
            words = f"{part.topic}: {equal} of {n} rows have the time of the row before. Export all decimals"
            found.append(Finding(role, EQUAL, words, severe=True))
            continue
        words = f"{part.topic}: {equal} of {n} messages have the header stamp of the one before: these stamps "
        words += "cannot be used. Let the driver stamp each message; for this log use recording times"
        found.append(Finding(role, EQUAL, words, ("order=recorded",), severe=True))
    return found


def clock_words(clock: Clock) -> str:
    """Return a text like "stamps look 0.12 s late (1 sigma: 0.005 s) against the wheels and the compass"."""
    side = "late" if clock.offset < 0.0 else "early"
    *most, last = (f"the {name}" for name in clock.against)
    whom = f"{', '.join(most)} and {last}" if most else last
    size = f"{abs(clock.offset):.{2 if abs(clock.offset) > SEVERE_LAG_S else 3}f}"
    return f"stamps look {size} s {side} (1 sigma: {clock.sigma:.3f} s) against {whom}"


def offset_of(clock: Clock, robot: Robot, digits: int = 3, sigmas: float = 0.0) -> str:
    """Return the setting that corrects a clock, such as "lrf.time_offset=-0.16".

    `sigmas` adds this multiple of the standard deviation of the clock's offset.
    """
    tables: dict[str, Any] = {"wheels": robot.wheels, "truth": robot.truth}
    now = float((tables.get(clock.name) or robot.settings(clock.name)).time_offset)
    return f"{clock.name}.time_offset={now + clock.offset + sigmas * clock.sigma:z.{digits}f}"


def start_kept(offset: float, drive: Drive, robot: Robot) -> tuple[str, ...]:
    """Return the start settings that keep the path in its frame if the wheels' clock changes by `offset` [s].

    [start] is the pose at the first wheel reading. If the robot moves then, another clock would rotate and shift
    the whole path. The result is () if the robot stands, if the start has its own time, or if neither a truth nor
    a configured start determines where the path lies.
    """
    start, wheels = robot.start, drive.wheels
    if start.at or not (robot.start_given or drive.truth is not None):
        return ()
    moved = wheels.relative(wheels.t[0], wheels.t[0] + np.float64(abs(offset)))
    if np.hypot(*moved[:2]) < MIN_START_ERROR_M and abs(moved[2]) < MIN_START_ERROR_RAD:
        return ()
    x, y, theta = se2.compose(np.array(start.pose), moved if offset > 0.0 else se2.inverse(moved)).tolist()
    return f"start.x={x:z.3f}", f"start.y={y:z.3f}", f"start.theta_deg={np.degrees(theta):z.1f}"


def differences(drive: Drive, robot: Robot, runs: Iterable[Estimates] = ()) -> dict[Pair, Lag]:
    """Return the lag of each pair of clocks: the time to add to the first clock to match the second.

    If `runs` has a run with only the laser, this run may show the laser's clock better than turns from scan to
    scan; but its lag may contain a part of the wheels' lag. The smaller sigma counts.
    """
    wheels, truth = drive.wheels, drive.truth
    turned = headings(drive.measurements)
    base = LASER if wheels.matched is not None else "wheels"  # if scans give the motion
    found = {(name, base): wheel_lag(*h, wheels) for name, h in turned.items() if name != base}
    by_run = next((e for e in runs if e.sensors == (LASER,) and not e.smoothed and not e.lost), None)
    others = sorted(turned, key=LASER.__eq__)  # the laser is the second of a pair
    for one, other in combinations(others, 2):  # each sensor is the reference once; the smaller sigma counts
        there = find_lag(*turned[one], HeadingReference.of(*turned[other], wheels))
        back = find_lag(*turned[other], HeadingReference.of(*turned[one], wheels))
        lags = [there, None if back is None else back._replace(offset=-back.offset)]
        found[one, other] = min(filter(None, lags), key=lambda lag: lag.sigma, default=None)
    if by_run is not None:
        path = Truth("", by_run.t, by_run.pose[:, :2], by_run.pose[:, 2])
        of_run = {s: lag for s, lag in lags_by_truth(drive, path).items() if s != LASER}
        direct = found
        found = {pair: lag for pair, lag in found.items() if not {LASER, *of_run}.issuperset(pair)}
        for s, lag in of_run.items():
            lags = [_of_a_run(lag, found.get((LASER, base))), direct.get((s, LASER))]
            found[s, LASER] = min(filter(None, lags), key=lambda lag: lag.sigma)
    if truth is not None:
        by_motion, by_turns = truth_lag(drive), lags_by_truth(drive, truth)
        found |= {(name, "truth"): lag for name, lag in by_turns.items()}
        own = None if by_run is None else lag_of_run(drive, truth, by_run)
        if own is not None:
            found[LASER, "truth"] = _of_a_run(own, by_motion)
        found["truth", base] = by_motion
        found = {**_lags_by_places(drive, robot, by_turns), **found}
    return {pair: _known(lag) for pair, lag in found.items() if lag is not None}


def _known(lag: Lag) -> Lag:
    """Return a lag with a realistic sigma, which includes model errors.

    If a lag was found by correlation only, its sigma is computed from SPEED_SIGMA_S and its spread over parts of
    the drive; its offset becomes 0 if it is not significant.
    """
    if math.isfinite(lag.sigma):
        return lag._replace(sigma=math.hypot(lag.sigma, MODEL_SIGMA_S))
    clearly = 1.0 - lag.correlation <= MAX_MISFIT_RATIO * (1.0 - lag.without)
    significant = abs(lag.offset) >= MIN_TRUTH_LAG_S and lag.correlation >= MIN_CORRELATION and clearly
    return lag._replace(offset=lag.offset if significant else 0.0, sigma=math.hypot(SPEED_SIGMA_S, lag.spread))


def _of_a_run(lag: Lag, by_wheels: Lag | None) -> Lag:
    """Return a lag that was found by a run's headings, with a larger sigma.

    Such a lag may contain a part of the wheels' lag `by_wheels`, so WHEEL_LAG_SHARE of the latter is added to the
    sigma.
    """
    drawn = 0.0 if by_wheels is None else WHEEL_LAG_SHARE * by_wheels.offset
    return lag._replace(sigma=math.hypot(lag.sigma, drawn))


def wrong_clocks(
    pairs: Mapping[Pair, Lag], sigmas: float, least: float = MIN_LAG_S, early: float = EARLY_COST
) -> list[tuple[Clock, ...]]:
    """Return the smallest set of wrong clocks that explains the lags, then equally good sets; [] for none.

    Each wrong clock adds `sigmas`^2 to chi-square, and a single early one `early`, so that of two clocks the late
    one is first. With three clocks, the one that the two others contradict is wrong; with two clocks, either may
    be wrong. Lags relative to the wheels share the error by slip, so several of them are as uncertain as one.
    Offsets below `least` [s] are left out.
    """
    names = sorted({name for pair in pairs for name in pair})
    number = {name: sum(name in pair for pair in pairs) for name in names}
    of_wheels = max(number.get("wheels", 1), 1) ** 0.5
    sizes = {p: lag.sigma * (of_wheels if "wheels" in p else 1.0) for p, lag in pairs.items()}
    found: list[tuple[float, tuple[Clock, ...]]] = []
    for count in range(min(len(names), MAX_WRONG + 1)):
        for off in combinations(names, count):
            chi, clocks = explained(pairs, sizes, off)
            cost = chi + sigmas**2 * count + sum(PREFERENCE_COST.get(name, 0.0) for name in off)
            cost += early if len(clocks) == 1 and clocks[0].offset > 0.0 else 0.0
            found.append((cost, clocks))
    found.sort(key=lambda one: one[0])
    best = [clocks for cost, clocks in found if cost < found[0][0] + NEAR_CHI2]
    if not best or not best[0]:
        return []
    named = (tuple(c for c in clocks if abs(c.offset) >= least) for clocks in best)
    return [clocks for clocks in named if clocks]


def explained(
    pairs: Mapping[Pair, Lag], sizes: Mapping[Pair, float], off: Sequence[str]
) -> tuple[float, tuple[Clock, ...]]:
    """Fit the offsets of the clocks `off` to the lags of pairs (least squares); return chi-square and the clocks.

    `sizes` are the assumed errors of the lags [s]. Returns (inf, ()) if the lags do not determine all offsets.
    """
    rows = [p for p in pairs if p[0] in off or p[1] in off]
    signs = [[(p[0] == name) - float(p[1] == name) for name in off] for p in pairs]
    A = np.array(signs).reshape(len(pairs), len(off))
    y, w = np.array([lag.offset for lag in pairs.values()]), np.array([1.0 / sizes[p] for p in pairs])
    x, _, rank, _ = np.linalg.lstsq(A * w[:, None], y * w, rcond=None)
    if rank < len(off):
        return math.inf, ()
    rest = (y - A @ x) * w
    chi = float(rest @ rest)
    worse = max(1.0, chi / max(1, len(y) - len(off)))
    C = np.linalg.inv((A * w[:, None]).T @ (A * w[:, None])) * worse if len(off) else np.zeros((0, 0))
    against = {
        name: [q for p in rows for q in p if name in p and q not in off]
        or [q for p in rows for q in p if name in p and q != name]
        for name in off
    }
    return chi, tuple(
        Clock(name, float(x[i]), math.sqrt(float(C[i, i])), tuple(dict.fromkeys(against[name])))
        for i, name in enumerate(off)
    )


def _lags_by_places(drive: Drive, robot: Robot, others: Collection[str]) -> dict[Pair, Lag]:
    """Return the lag of each sensor of positions, such as landmarks, but of `others`, relative to the truth."""
    truth, found = drive.truth, dict[Pair, Lag]()
    if truth is None:
        return found
    for name, every in drive.measurements.items():
        if name in others:
            continue
        m = every.take(np.arange(0, len(every.t), 1 + len(every.t) // MAX_PLACED))
        misfit = partial(REGISTRY[name].misfit, settings=robot.settings(name))
        if len(m.t) >= MIN_READINGS and (lag := _lag_by_places(m, misfit, truth)) is not None:
            found[name, "truth"] = lag
    return found


def _lag_by_places(m: Measurements, misfit: Callable[..., float | None], truth: Truth) -> Lag | None:
    """Return the time offset at which a sensor's readings fit the truth's poses best; None if it is not clear.

    Without a clear one below MAX_LAG_S, larger ones are tried, such as leap seconds.
    """

    def spreads(some: Measurements, lags: Array) -> Array:
        found = []
        for lag in lags.tolist():
            inside = np.flatnonzero(truth.spans(some.t + lag))
            seen = some.take(inside) if 2 * len(inside) > len(some.t) else None
            spread = None if seen is None else misfit(seen, poses=poses_at(truth, seen.t + lag))
            found.append(math.inf if spread is None or math.isnan(spread) else spread)
        return np.array(found)

    def about(middle: float, steps: int, most: float) -> Lag | None:
        lags: Array = middle + PLACE_STEP_S * np.arange(-steps, steps + 1, dtype=np.float64)
        if not np.isfinite(spreads(m, lags)).all():
            return None

        def lag(rows: Ints) -> float:
            second, first, _ = np.polyfit(lags, np.square(spreads(m.take(rows), lags)), 2).tolist()
            return float(-0.5 * first / second)

        offset, sigma = lag(np.arange(len(m.t))), float(jackknife(lag, len(m.t), PART_COUNT))
        if not (sigma < most and lags[0] < offset < lags[-1]):
            return None
        return Lag(offset, 1.0, 0.0, math.hypot(sigma, PLACES_SIGMA_S))

    near: Array = np.arange(-MAX_LAG_S, MAX_LAG_S + PLACE_STEP_S / 2, PLACE_STEP_S, dtype=np.float64)
    far: Array = np.arange(-MAX_FAR_PLACES_S, MAX_FAR_PLACES_S, LAG_STEPS * PLACE_STEP_S, dtype=np.float64)
    scores = spreads(m, near)
    found = about(float(near[np.argmin(scores)]), LAG_STEPS, MAX_PLACES_SIGMA_S)
    if found is not None and abs(found.offset) < MAX_LAG_S:
        return found
    farther = spreads(m, far)
    if not farther.min() < MAX_FAR_RATIO * scores.min():
        return None
    return about(float(far[np.argmin(farther)]), 2 * LAG_STEPS, MAX_LAG_S)


def lags_by_truth(drive: Drive, truth: Truth | None) -> dict[str, Lag]:
    """Return the lag of each sensor's clock relative to the truth's clock, by headings.

    `truth` may also be a run with headings better than those of the wheels.
    """
    reference = _by_headings(drive, truth)
    if reference is None:
        return {}
    known = headings(drive.measurements).items()
    return {name: lag for name, heading in known if (lag := find_lag(*heading, reference)) is not None}


def lag_of_run(drive: Drive, truth: Truth | None, run: Estimates) -> Lag | None:
    """Return the lag of the clock of a run's only sensor relative to the truth's, by the headings of the run.

    For a laser the sigma is about half of that by turns from scan to scan, since its map determines the heading at
    each scan. With a sensor that has less weight than the wheels, the run would show only a part of the lag.
    """
    reference, (sensor,) = _by_headings(drive, truth), run.sensors
    if reference is None or len(drive.instant[sensor]) < MIN_READINGS:
        return None
    at = np.unique(drive.instant[sensor])[:MAX_READINGS]
    return find_lag(run.t[at], run.pose[at, 2], reference)


def _by_headings(drive: Drive, truth: Truth | None) -> HeadingReference | None:
    """Return the truth's headings as the reference for a lag; None without headings."""
    if truth is None or truth.theta is None or len(truth.t) < MIN_READINGS:
        return None
    return HeadingReference.of(truth.t, np.unwrap(truth.theta), drive.wheels, wanders=False)


def truth_lag(drive: Drive) -> Lag | None:
    """Return the lag between truth and wheels by headings, else by speeds or positions; None if none shows one."""
    truth, wheels = drive.truth, drive.wheels
    if truth is None or len(truth.t) < 5:
        return None
    theta = None if truth.theta is None else np.unwrap(truth.theta)
    turning = None if theta is None else find_lag(truth.t, theta, by_wheels(wheels))
    found = turning or way_lag(truth, drive)
    if theta is None and (swings := swing_by_positions(truth, drive)) and swings.lag:
        offset, sigma = swings.lag  # more exact than by speeds, which know no tracked point
        if found is None or abs(offset - found.offset) < SAID_SIGMAS * math.hypot(SPEED_SIGMA_S, found.spread):
            return Lag(offset, 1.0, 0.0, math.hypot(sigma, PLACES_SIGMA_S))
    return found or far_lag(truth.t, truth.xy, theta, wheels)


def far_lag(t: Array, xy: Array | None, theta: Array | None, wheels: Wheels) -> Lag | None:
    """Return a lag to the wheels above MAX_LAG_S, by turns or speeds; None if no lag or several lags fit.

    `xy` (n, 2) [m] and `theta` (n,) [rad, unwrapped] are positions and headings at times t (n,) [s], if known.
    """
    ends = ((t[0], min(t[-1], t[0] + MAX_FAR_S) - WINDOW_S) for t in (t, wheels.t))
    own, theirs = (np.arange(first, last, FAR_STEP_S) for first, last in ends)
    if min(len(own), len(theirs)) < MIN_FAR_STEPS:
        return None
    moved, pairs = wheels.relative(theirs, theirs + WINDOW_S), list[tuple[Array, Array]]()
    if theta is not None:
        pairs.append((changes(own, WINDOW_S, t, theta), moved[:, 2]))
    if xy is not None:
        pairs.append((np.hypot(*changes(own, WINDOW_S, t, xy).T), np.hypot(*moved[:, :2].T)))
    least = min(len(own), len(theirs)) // 2  # of the steps that overlap
    # step i of the wheels is compared with step i + shift of the truth
    shifts = np.arange(least - len(theirs), len(own) - least + 1)
    lags = (theirs[0] - own[0]) - FAR_STEP_S * shifts
    for a, b in pairs:
        overlaps = ((a[max(0, k) : len(b) + k], b[max(0, -k) : len(a) - k]) for k in shifts.tolist())
        scores = np.array(
            [np.corrcoef(*pair)[0, 1] if min(map(np.std, pair)) > MIN_FAR_CHANGE else 0.0 for pair in overlaps]
        )
        best = int(np.argmax(scores))
        others = np.abs(lags - lags[best]) > 3.0 * WINDOW_S
        rival, near = (float(scores[some].max(initial=0.0)) for some in (others, np.abs(lags) <= MAX_LAG_S))
        if scores[best] >= MIN_CORRELATION and rival < MAX_RIVAL_CORRELATION and abs(lags[best]) > MAX_LAG_S:
            return Lag(float(lags[best]), float(scores[best]), near, spread=FAR_STEP_S)
    return None


def way_lag(truth: Truth, drive: Drive) -> Lag | None:
    """Return the lag with the best correlation of speeds of truth and wheels; None if the speed hardly changes."""
    wheels = drive.wheels
    inside = (truth.t > wheels.t[0] + MAX_LAG_S) & (truth.t < wheels.t[-1] - MAX_LAG_S - WINDOW_S)
    start = truth.t[inside & (truth.t + WINDOW_S <= truth.t[-1])]
    if len(start) < 20:
        return None
    own = np.hypot(*changes(start, WINDOW_S, truth.t, truth.xy).T)
    if own.std() < 0.02 or own.std() < 0.1 * own.mean():
        return None
    lags = np.arange(-MAX_LAG_S, MAX_LAG_S + LAG_STEP_S / 2, LAG_STEP_S)
    theirs = [np.hypot(*wheels.relative(start + lag, start + lag + WINDOW_S)[:, :2].T) for lag in lags.tolist()]

    def scored(some: Ints) -> list[float]:
        of = own[some]
        return [float(np.corrcoef(of, one[some])[0, 1]) if one[some].std() > 0 else 0.0 for one in theirs]

    scores = scored(np.arange(len(own)))
    best = int(np.argmax(scores))
    if scores[best] < MIN_CORRELATION or best in {0, len(lags) - 1}:
        return None
    spread = float(jackknife(lambda some: lags[np.argmax(scored(some))], len(own), PART_COUNT))
    return Lag(float(lags[best]), scores[best], scores[int(np.argmin(np.abs(lags)))], spread=spread)


def wheel_lag(t: Array, heading: Array, wheels: Wheels) -> Lag | None:
    """Return the lag of headings (n,) [rad, unwrapped] at t (n,) [s] relative to the wheels, also a large one."""
    return find_lag(t, heading, by_wheels(wheels)) or far_lag(t, None, heading, wheels)


def clock_lags(measurements: Mapping[str, Measurements], wheels: Wheels) -> dict[str, Lag]:
    """Return the lag of each sensor's clock relative to the wheels', from the first readings of the drive."""
    known = headings(measurements).items()
    return {name: lag for name, heading in known if (lag := wheel_lag(*heading, wheels)) is not None}
