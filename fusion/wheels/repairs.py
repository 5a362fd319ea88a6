"""Repair of wheel counters: rollovers, spikes and restarts are removed, with notes on the repairs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from locfuse.fusion.data import Array, Ints, LocfuseError, Mask, stretches, totals

WINDOW_STEPS = 11  # steps whose median speed is the present speed
# a jump is longer than JUMP_FACTOR times the present speed, plus JUMP_SLACK_MPS, times dt, plus MIN_JUMP_M
JUMP_FACTOR, JUMP_SLACK_MPS, MIN_JUMP_M = 8.0, 0.5, 0.02
MAX_HELD_FACTOR = 4.0  # largest ratio of the speeds before, during and after a time with a constant counter
SPEED_SETTING = "wheels.max_speed [m/s] limits a step"
CAUGHT_UP = "stood still and then caught up"  # words of the note on such a time
# of ticks since the message before: least time [s] and number of stretches at 0, readings that are more than an
# encoder flickering on an edge, and least sum of the changes in spans; a counter must reverse as often to reach it
MIN_REST_S, MIN_RESTS, MIN_SPAN_TICKS, MIN_SPANS = 1.0, 2, 3.0, 10.0
# of readings that arrive in bursts: least number, longest step in a burst in periods, least share of bursts of the
# usual size, largest ratio of the ways (and times) from reading to reading within a burst and between two
MIN_BURST_READINGS, MAX_CLOSE_PERIODS, MIN_USUAL_SHARE, MAX_WAY_RATIO = 100, 0.25, 0.8, 1.5
MAX_FAST_SHARE = 0.1  # of all steps: more of them are not faults; the limit is wrong
MAX_SPEED_MPS = 1e6  # m/s: faster than any counter, in any unit
MAX_SPIKE_READINGS, MAX_SPIKE_S = 10, 0.5  # longest duration of a spike
COUNTER_BITS = (8, 10, 12, 13, 14, 15, 16, 18, 20, 24, 32)  # known widths of counters
MAX_WHOLE = 2.0**53  # largest float whose neighbours are whole numbers, too
MAX_FRACTION_QUANTA = 0.02  # largest deviation of a counter's step from a multiple of its quantum


class Side(NamedTuple):
    """Readings of one wheel: finite values at strictly increasing times."""

    name: str  # left or right
    t: Array  # (n,) s
    value: Array  # (n,) in the message's unit
    likely: tuple[float, ...] = ()  # moduli suggested by the message type


class Repaired(NamedTuple):
    """Repaired distance of one wheel, and notes on the repairs."""

    keep: Ints  # (k,) indices of the readings without spikes
    rolled: Array  # (k,) m since the first reading
    spikes: int
    notes: tuple[str, ...]


def repaired(side: Side, metres: float, modulus: float | None, max_speed: float | None) -> Repaired:
    """Return the distance rolled by a wheel, without rollovers, spikes and restarts.

    `metres` is the distance per unit of the readings; `modulus` and `max_speed` are wheels.rollover and
    wheels.max_speed.
    """
    count = unrolled(side.value, modulus, side.likely)
    rolled = count.values * metres
    bad = spikes(side.t, rolled[:, None], limits(side.t, np.diff(rolled), max_speed))
    if bad.any():  # spikes may have disturbed the search for the modulus
        count = unrolled(side.value[~bad], modulus, side.likely)
    keep = np.flatnonzero(~bad)
    rolled = count.values * metres
    held = held_readings(side.t[keep], rolled, max_speed)
    still = held_note(f"{side.name} counter", side.t[keep] - side.t[0], held)
    keep, rolled = keep[~held], rolled[~held]
    t, steps = side.t[keep], np.diff(rolled)
    restarts = np.abs(steps) > limits(t, steps, max_speed)
    check_limit(restarts, steps / np.diff(t), max_speed)
    distance = totals(without_restarts(t, steps[:, None], restarts)[:, 0])
    notes = []
    if count.modulus is not None:
        notes.append(
            f"{side.name} counter rolled over {times(count.turns)}, taken as modulo {count.modulus:.10g}; "
            f"if that is wrong, set wheels.rollover (0: it never does)"
        )
    jumps = [f"by {jump:+.6g}" for jump in (steps[restarts] / metres).tolist()]
    notes += jump_notes(f"{side.name} counter", int(bad.sum()), "started anew", jumps)
    return Repaired(keep, distance, int(bad.sum()), (*notes, *still))


def increments(side: Side) -> bool:
    """Return whether the readings of a wheel are ticks since the message before, not a counter.

    They change all the time while the wheel rolls, and are 0 whenever it stands. A counter stands at other values.
    """
    steps, span = np.diff(side.value), np.ptp(side.value)
    if span < MIN_SPAN_TICKS or np.abs(steps).sum() < MIN_SPANS * span:
        return False
    rests = [(a, side.t[b + 1] - side.t[a]) for a, b in stretches(steps == 0.0)]
    at_zero = [(side.value[a] == 0.0, length) for a, length in rests if length > MIN_REST_S]
    zeros = [length for zero, length in at_zero if zero]
    return len(zeros) >= MIN_RESTS and 2.0 * sum(zeros) > sum(length for _, length in at_zero)


def spread(t: Array, way: Array) -> tuple[Array, tuple[str, ...]]:
    """Return times t (n,) [s] of readings, those that arrived in bursts made even, and a note on that.

    A serial line may deliver several readings at once, which its driver stamps on arrival. Then the `way` (n-1,)
    from reading to reading, in any unit, is as long within a burst as between two. The last reading of a burst
    keeps its time.
    """
    step = np.diff(t)
    if len(t) < MIN_BURST_READINGS:
        return t, ()
    close = step < MAX_CLOSE_PERIODS * float(t[-1] - t[0]) / len(step)
    last = np.flatnonzero(np.append(~close, True))  # of each burst
    size = np.diff(last, prepend=-1)
    usual = int(np.median(size))
    ways = [way[some & (way > 0.0)] for some in (close, ~close)]
    if usual < 2 or (size == usual).mean() < MIN_USUAL_SHARE or not min(map(len, ways)):
        return t, ()
    if not 1.0 / MAX_WAY_RATIO < np.median(ways[0]) / np.median(ways[1]) < MAX_WAY_RATIO:
        return t, ()
    period = float(np.median(np.diff(t[last]))) / usual
    apart = np.diff(t[last], prepend=-np.inf) / size
    apart[apart > MAX_WAY_RATIO * period] = period  # a burst was lost
    burst = np.repeat(np.arange(len(last)), size)
    words = (
        f"stamps come in bursts of {usual} every {usual * period:.3f} s, but the way between readings is even: "
        "the times are made even. Let the driver stamp when it measures"
    )
    return t[last][burst] - (last[burst] - np.arange(len(t))) * apart[burst], (words,)


def held_note(what: str, t: Array, held: Mask) -> list[str]:
    """Return the note on the readings at t (n,) [s] of a counter or a pose that were held (`held_readings`)."""
    if not held.any():
        return []
    (first, last), *more = stretches(held)
    when = f"from {t[first - 1]:.1f} s to {t[last + 1]:.1f} s" + (f" and {times(len(more))} more" if more else "")
    return [f"{what} {CAUGHT_UP} ({when}): its {int(held.sum())} equal readings are not used"]


def held_readings(t: Array, rolled: Array, max_speed: float | None) -> Mask:
    """Return which readings (n,) repeat an old value while the wheel rolled on; then the counter jumps.

    Such a jump is the distance of the whole time, at a speed similar to those before and after it. (A counter that
    restarts while the robot stands jumps too, but then the robot does not drive before and after.)
    """
    out, steps = np.zeros(len(t), bool), np.diff(rolled)
    rate = steps / np.diff(t)
    for last in np.flatnonzero(np.abs(steps) > limits(t, steps, max_speed)).tolist():
        moving = np.flatnonzero(steps[:last])
        first = int(moving[-1]) + 1 if len(moving) else 0
        if not 0 < first < last < len(rate) - 1:
            continue
        beside = rate[[first - 1, last + 1]]
        speed = steps[last] / (t[last + 1] - t[first])
        ratio = np.divide(beside, speed)
        out[first + 1 : last + 1] = (ratio.min() > 1.0 / MAX_HELD_FACTOR) and (ratio.max() < MAX_HELD_FACTOR)
    return out


def jump_notes(what: str, spiked: int, jumped: str, jumps: Sequence[str]) -> list[str]:
    """Return notes on readings of `what`: `spiked` ones that jumped away and returned, and `jumps` that stayed.

    `jumped` says what such a jump is; the text of each jump is its time or its size.
    """
    words = []
    if spiked:
        words.append(f"{what} jumped away and returned (readings not used: {spiked}); {SPEED_SETTING}")
    if jumps:
        shown = ", ".join(jumps[:3]) + (" ..." if len(jumps) > 3 else "")
        around = "the motion there is taken from around it"
        words.append(f"{what} {jumped} {times(len(jumps))} ({shown}); {around}; {SPEED_SETTING}")
    return words


def times(n: int) -> str:
    """Return "once", "twice", or "3 times" for a number n."""
    return {1: "once", 2: "twice"}.get(n, f"{n} times")


def gaps_of(n: int, longest_s: float) -> str:
    """Return "a gap of 1.2 s", or "3 gaps, the longest 1.2 s"."""
    return f"a gap of {longest_s:.1f} s" if n == 1 else f"{n} gaps, the longest {longest_s:.1f} s"


# ---- counters that roll over ----


class Unrolled(NamedTuple):
    """Counter values without rollovers."""

    values: Array  # (n,)
    modulus: float | None  # in counter units; None without a rollover
    turns: int  # number of rollovers


def unrolled(values: Array, modulus: float | None = None, likely: Sequence[float] = ()) -> Unrolled:
    """Return counter `values` (n,) with rollovers removed.

    A rollover changes the counter by `modulus`; 0: the counter never rolls over; None: the modulus is searched
    among `likely`, a turn in radians or degrees, and powers of two in ticks. The found modulus must explain every
    long step, and the values must span no more than it.
    """
    steps = np.diff(values)
    if modulus is None and len(steps):
        longest, span = float(np.abs(steps).max()), float(values.max() - values.min())
        known = {*likely, 2.0 * math.pi, 360.0, *_powers(steps, longest)}
        modulus = next((m for m in sorted(known) if _explains(m, steps, span, longest)), None)
    if not modulus:
        return Unrolled(values, None, 0)
    turns = np.rint(steps / modulus)
    rollovers = int(np.count_nonzero(turns))
    if not rollovers:
        return Unrolled(values, None, 0)
    return Unrolled(values - modulus * totals(turns), modulus, rollovers)


def _explains(modulus: float, steps: Array, span: float, longest: float) -> bool:
    """Return whether a counter that rolls over at `modulus` explains all long `steps` (n,).

    With the rollovers removed, these steps must be about as short as the others. `span` is the largest minus the
    smallest value, and `longest` the largest absolute step; all are in counter units.
    """
    if not 0.5 * modulus < longest < modulus or span > modulus * (1.0 + 1e-6):
        return False
    long = np.abs(steps) > 0.5 * modulus
    ordinary = float(np.abs(steps[~long]).max(initial=0.0))
    rest = modulus - np.abs(steps[long])
    return bool((rest <= 1.5 * ordinary + 1e-9 * modulus).all())


def _powers(steps: Array, longest: float) -> list[float]:
    """Return values at which a binary counter may roll over: 2^bits ticks, in the unit of `steps` (n-1,).

    The smallest step, or the greatest common divisor of whole ones, is taken as 1 to 5 ticks of the counter.
    Returns [] if the steps are not multiples of it. `longest` is the largest absolute step.
    """
    sizes = np.abs(steps[steps != 0.0])
    quantum = float(sizes.min()) if len(sizes) else 0.0
    if quantum <= 1e-12 * longest:
        return []
    if longest < MAX_WHOLE and (sizes == np.rint(sizes)).all():
        quantum = float(np.gcd.reduce(sizes.astype(np.int64)))
    else:
        wholes = np.rint(sizes / quantum)
        short = wholes < 1000
        if not short.any() or np.abs(sizes / quantum - wholes)[short].max() > MAX_FRACTION_QUANTA:
            return []
        quantum = float(sizes[short].sum() / wholes[short].sum())
    # every step may have several ticks, so the smallest step is a multiple of the counter's quantum
    return [quantum / part * 2.0**bits for bits in COUNTER_BITS for part in (1, 2, 3, 4, 5)]


# ---- impossible steps: spikes and restarts ----


def limits(t: Array, steps: Array, max_speed: float | None = None) -> Array:
    """Return the largest plausible steps (n-1,) [m]: by the present speed with a margin, or by `max_speed`.

    At least the median dt is used, since dt may be tiny in a burst of messages.
    """
    dt = np.diff(t)
    if not len(dt):
        return np.zeros(0)
    usual = np.maximum(dt, np.median(dt))
    if max_speed is not None:
        return max_speed * usual + MIN_JUMP_M
    least: Array = JUMP_SLACK_MPS * usual + MIN_JUMP_M
    suspects = np.flatnonzero(np.abs(steps) > least)
    out = least.copy()
    if len(suspects):
        speed, window = np.abs(steps) / usual, min(WINDOW_STEPS, len(steps))
        begin = np.clip(suspects - WINDOW_STEPS // 2, 0, len(steps) - window)
        present = np.median(speed[begin[:, None] + np.arange(window)], axis=1)
        out[suspects] += JUMP_FACTOR * present * usual[suspects]
    return np.minimum(out, MAX_SPEED_MPS * usual)


def check_limit(fast: Mask, speeds: Array, max_speed: float | None) -> None:
    """Raise LocfuseError if many `speeds` (n,) [m/s] of a wheel or of a body are `fast` (n,): above max_speed."""
    if max_speed is not None and fast.sum() > MAX_FAST_SHARE * len(fast):
        usual = float(np.quantile(np.abs(speeds), 1.0 - MAX_FAST_SHARE))
        words = f"{fast.mean():.0%} of the readings are faster than wheels.max_speed={max_speed:g} m/s."
        hint = f"Set a higher value, or none: 90% of them are below {usual:.2g} m/s"
        raise LocfuseError(words, role="wheels", hint=hint)


def spikes(t: Array, values: Array, limit: Array) -> Mask:
    """Mark the readings (n,) between a jump away and a jump back soon afterwards.

    A jump is a step between values (n, k) that is longer than the largest plausible one, `limit` (n-1,).
    """
    out = np.zeros(len(t), dtype=bool)
    jumps = np.flatnonzero(_length(np.diff(values, axis=0)) > limit)
    at = 0
    while at < len(jumps):
        end = _return_of(t, values, limit, jumps, at)
        if end is None:
            at += 1
            continue
        out[jumps[at] + 1 : jumps[end] + 1] = True
        at = end + 1
    return out


def _return_of(t: Array, values: Array, limit: Array, jumps: Ints, at: int) -> int | None:
    """Return the index in `jumps` of the jump back to the value before jump `at`; None without one."""
    before = int(jumps[at])
    for later in range(at + 1, len(jumps)):
        after = int(jumps[later]) + 1
        if after - before > MAX_SPIKE_READINGS or t[after] - t[before] > MAX_SPIKE_S:
            return None
        allowed = float(limit[before:after].min()) * (after - before)
        if float(_length(values[after] - values[before])) <= min(allowed, float(limit[before])):
            return later
    return None


def without_restarts(t: Array, steps: Array, jumps: Mask) -> Array:
    """Replace steps (n-1, k) at restarts by a motion with the mean speed of the neighbouring steps.

    At a restart, the step between two counter values does not measure the motion.
    """
    out = steps.copy()
    dt = np.diff(t)
    good = np.flatnonzero(~jumps)
    for i in np.flatnonzero(jumps).tolist():
        near = np.searchsorted(good, i)
        beside = good[max(0, near - 1) : near + 1]
        rate = (steps[beside] / dt[beside, None]).mean(axis=0) if len(beside) else 0.0
        out[i] = rate * dt[i]
    return out


def _length(steps: Array) -> Array:
    return np.asarray(np.hypot.reduce(steps, axis=-1))  # squares of absurd steps would overflow
