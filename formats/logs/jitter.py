"""Repair of jittered times: messages are in the right order, but some of their times run backwards.

If a time is earlier than that of the previous message, there are two possible causes. The message was written
late: then its time is right, and the times of other messages have a gap there. Or its time is wrong: then the gap
is at the message's place in the file, between its two neighbours.
"""

from __future__ import annotations

from bisect import bisect_right

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from locfuse.fusion.data import Array, Ints, totals

MAX_BACK_NS = 2 * 10**9  # a larger step back is no jitter: the clock or the order of files has changed
MAX_BACK_SHARE = 0.25  # largest share of times in the wrong order; with more, the right times are unknown

WINDOW_READINGS = 7  # neighbours on either side that determine the expected time
MIN_OFF_DEVIATIONS, MIN_OFF_PERIODS = 8.0, 0.25  # a time is wrong if it is off by both: robust sigmas, periods


def credibility(times: Ints) -> tuple[Array, NDArray[np.bool_]]:
    """Return weights (n,), low for times that do not fit regular steps, and a mask (n,) of irregular times.

    The expected time at i is the median of t_j + (i - j) T over the neighbours j, with their median step T. Most
    streams are regular. So if two times are in the wrong order, the one with the lower weight is wrong.
    """
    n = len(times)
    if n <= 2 * WINDOW_READINGS:
        return np.ones(n), np.zeros(n, bool)
    t = (times - times[0]).astype(np.float64)
    steps = np.pad(np.diff(t), WINDOW_READINGS, mode="reflect")
    period = np.median(sliding_window_view(steps, 2 * WINDOW_READINGS), axis=1)[:n]
    places = np.arange(-WINDOW_READINGS, WINDOW_READINGS + 1)
    inner = np.arange(WINDOW_READINGS, n - WINDOW_READINGS)
    expected = t.copy()
    expected[inner] = np.median(t[inner[:, None] + places] - places * period[inner, None], axis=1)
    off = np.abs(t - expected)
    scale = max(float(np.median(off[inner])), 1e6)
    return cauchy(off / scale), (off > MIN_OFF_DEVIATIONS * scale) & (off > MIN_OFF_PERIODS * period)


def cauchy(deviations: Array) -> Array:
    """Return the weights (n,) of a Cauchy distribution (long tails) for deviations (n,) [robust sigmas]."""
    return 1.0 / (1.0 + deviations**2) + 1e-6  # > 0: of two equal sums, the one of more times wins


def pooled(times: Ints) -> tuple[Ints, int] | None:
    """Return never-decreasing times (n,) in file order, and the number of replaced times.

    The least credible times are replaced by times evenly spaced between their neighbours (isotonic regression in
    the L0 norm: a wrong time does not move a right one). If any time runs backwards, irregular times are replaced
    too. None if the times are in order, or if the times are right and the file's order is wrong.
    """
    if len(times) < 3 or (np.diff(times) >= 0).all():
        return None
    weights, off = credibility(times)
    keep = never_decreasing(times, weights)
    backwards = np.flatnonzero(~keep)
    if len(backwards) > MAX_BACK_SHARE * len(times) or not _gap_in_file(times, keep, backwards):
        return None
    keep &= ~off
    wrong = np.flatnonzero(~keep)
    if len(wrong) > MAX_BACK_SHARE * len(times):
        return None
    even = _evenly_filled(times, keep)
    if np.abs(even - times)[wrong].max() > MAX_BACK_NS:
        return None
    return even, len(wrong)


def in_order(times: Ints) -> Ints:
    """Return rising times (n,) in file order, with the smallest changes (isotonic regression).

    Irregular times are replaced first. Moved times are at least half a median step apart.
    """
    from scipy.optimize import isotonic_regression

    weights, off = credibility(times)
    t = _evenly_filled(times, ~off) if not off.all() else times
    steps = np.diff(t)
    half = 0.5 * float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    apart = np.where((steps > 0) | (np.diff(times) == 0), np.minimum(half, np.maximum(steps, 0)), half)
    room = totals(apart)
    level = isotonic_regression(t - t[0] - room, weights=weights).x
    out: Ints = t[0] + np.rint(level + room).astype(np.int64)
    return out


def filled(times: Ints, keep: NDArray[np.bool_], at: Ints, pace: int) -> Ints:
    """Return times (n,) [ns] in which all times outside the mask `keep` are replaced.

    Replaced times are interpolated over `at` (n,). Before the first and after the last kept time they are
    extrapolated with the slope `pace`.
    """
    known = np.flatnonzero(keep)
    first, last = known[0], known[-1]
    x, lost = at - at[first], np.flatnonzero(~keep)
    out: Ints = times.copy()
    between = np.interp(x[lost], x[known], times[known] - times[first])
    out[lost] = times[first] + np.rint(between).astype(np.int64)
    out[:first] = times[first] + pace * (at[:first] - at[first])
    out[last + 1 :] = times[last] + pace * (at[last + 1 :] - at[last])
    return out


def _evenly_filled(times: Ints, keep: NDArray[np.bool_]) -> Ints:
    """Return times (n,) in which times outside the mask `keep` are replaced by evenly spaced ones.

    At both ends of the series the spacing is the median period.
    """
    period = int(np.median(np.diff(times[keep]))) if keep.sum() > 1 else 0
    return filled(times, keep, np.arange(len(times)), period)


def _gap_in_file(times: Ints, keep: NDArray[np.bool_], wrong: Ints) -> bool:
    """Return whether most of the times with indices `wrong` are really wrong, and not of messages written late.

    For a wrong time, the gap in the kept times is larger at the message's place in the file than at its time.
    """
    known, kept = np.flatnonzero(keep), times[keep]
    after = np.searchsorted(known, wrong)
    inner = (after > 0) & (after < len(known))
    if not inner.any():
        return False
    wrong, after = wrong[inner], after[inner]
    between = known[after] - known[after - 1]  # number of steps from the kept neighbour before to the one after
    in_file: Array = (kept[after] - kept[after - 1]) / between
    by_time = np.clip(np.searchsorted(kept, times[wrong]), 1, len(kept) - 1)
    in_time: Array = (kept[by_time] - kept[by_time - 1]) / 2.0
    return bool(2 * np.count_nonzero(in_file > in_time) > len(wrong))


# --- The stamps to trust: the never-decreasing subsequence of greatest weight


def never_decreasing(values: Ints, weights: Array) -> NDArray[np.bool_]:
    """Return the mask (n,) of the never-decreasing subsequence of `values` with the largest sum of `weights` > 0.

    The values are split into blocks; no value of a block is above any value of the next one. Ordered values are
    blocks of length one, so only disordered parts are searched.
    """
    keep = np.ones(len(values), bool)
    if len(values) < 2:
        return keep
    highest = np.maximum.accumulate(values)[:-1]
    lowest = np.minimum.accumulate(values[::-1])[::-1][1:]
    edges = np.concatenate(([0], np.flatnonzero(highest <= lowest) + 1, [len(values)]))
    for i in np.flatnonzero(np.diff(edges) > 1).tolist():
        block = slice(int(edges[i]), int(edges[i + 1]))
        keep[block] = _heaviest(values[block], weights[block])
    return keep


def _heaviest(values: Ints, weights: Array) -> NDArray[np.bool_]:
    """Return the mask (n,) of the never-decreasing subsequence of a block with the largest weight, in O(n log n).

    `series` has the candidate subsequences, sorted by last value and by weight. A candidate with a higher last
    value but a lower weight than another one is removed, since it cannot become part of the best.
    """
    last_values: list[int] = []
    series: list[tuple[float, int]] = []  # weight, last element
    before: list[int] = []  # element -> previous element of its best subsequence, -1: none
    for i, (value, weight) in enumerate(zip(values.tolist(), weights.tolist(), strict=True)):
        at = bisect_right(last_values, value)
        so_far, previous = series[at - 1] if at else (0.0, -1)
        before.append(previous)
        longer, end = (so_far + weight, i), at
        while end < len(series) and series[end] < longer:
            end += 1
        last_values[at:end], series[at:end] = [value], [longer]
    keep = np.zeros(len(values), bool)
    i = series[-1][1]
    while i >= 0:
        keep[i] = True
        i = before[i]
    return keep
