"""Jitter in times: the messages are in the right order, but some of their times run backwards.

A time that lies before that of the message before it has one of two reasons. The message was written late: then
its time is right, and where it belongs by its time there is a hole that it fills. Or its time was taken wrongly:
then the hole is where the message lies, between the two beside it, and where its time would put it is no room.
"""

from __future__ import annotations

from bisect import bisect_right

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from locfuse.fusion.data import Array, Ints

MAX_BACK_NS = 2 * 10**9  # a time that runs back by more is no jitter: another clock, or files in another order
MAX_SHARE = 0.25  # of the times may contradict the order; with more of them it is unclear which are right

WINDOW_READINGS = 7  # neighbours on either side by which the beat of a stream is known
OFF_BEAT, OFF_PERIODS = 8.0, 0.25  # robust deviations and periods off the beat: a time like that is wrong


def credibility(times: Ints) -> tuple[Array, NDArray[np.bool_]]:
    """Weight times (n,) in their true order by the regularity of their steps; mark irregular ones.

    The beat at i is the median of t_j + (i - j) T over the neighbours j, T their median step. Most streams keep
    it, and then it tells which of two times in the wrong order is the wrong one, and which one is wrong without
    contradicting the order.
    """
    n = len(times)
    if n <= 2 * WINDOW_READINGS:
        return np.ones(n), np.zeros(n, bool)
    t = (times - times[0]).astype(np.float64)
    steps = np.pad(np.diff(t), WINDOW_READINGS, mode="reflect")
    period = np.median(sliding_window_view(steps, 2 * WINDOW_READINGS), axis=1)[:n]
    places = np.arange(-WINDOW_READINGS, WINDOW_READINGS + 1)
    inner = np.arange(WINDOW_READINGS, n - WINDOW_READINGS)
    beat = t.copy()
    beat[inner] = np.median(t[inner[:, None] + places] - places * period[inner, None], axis=1)
    off = np.abs(t - beat)
    scale = max(float(np.median(off[inner])), 1e6)
    return cauchy(off / scale), (off > OFF_BEAT * scale) & (off > OFF_PERIODS * period)


def cauchy(deviations: Array) -> Array:
    """Weight times by their deviations (n,) [robust sigmas], with the long tail of a Cauchy distribution."""
    return 1.0 / (1.0 + deviations**2) + 1e-6  # all else equal, the more times the better


def pooled(times: Ints) -> tuple[Ints, int] | None:
    """Return times (n,) in file order that never decrease, and how many of them were replaced.

    None where the times are in order, or where they are right and the order of the file is not. The least credible
    times that make the others an ordered series are replaced, evenly between their neighbours: isotonic regression
    in the norm that counts outliers, so that a time that is right is never moved by one that is not. Where times
    run backwards, those that are off the beat without running backwards are wrong too.
    """
    if len(times) < 3 or (np.diff(times) >= 0).all():
        return None
    weights, off = credibility(times)
    keep = never_decreasing(times, weights)
    backwards = np.flatnonzero(~keep)
    if len(backwards) > MAX_SHARE * len(times) or not _room_in_file(times, keep, backwards):
        return None
    keep &= ~off
    wrong = np.flatnonzero(~keep)
    if len(wrong) > MAX_SHARE * len(times):
        return None
    even = _evenly_filled(times, keep)
    if np.abs(even - times)[wrong].max() > MAX_BACK_NS:
        return None
    return even, len(wrong)


def in_order(times: Ints) -> Ints:
    """Return times (n,) that rise in the order given, with the smallest changes: isotonic regression.

    A time that is off the beat of its neighbours is replaced first. Times that had to be moved lie half a usual
    step apart at least.
    """
    from scipy.optimize import isotonic_regression

    weights, off = credibility(times)
    t = _evenly_filled(times, ~off) if not off.all() else times
    steps = np.diff(t)
    half = 0.5 * float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    apart = np.where((steps > 0) | (np.diff(times) == 0), np.minimum(half, np.maximum(steps, 0)), half)
    room = np.concatenate(([0.0], np.cumsum(apart)))
    level = isotonic_regression(t - t[0] - room, weights=weights).x
    out: Ints = t[0] + np.rint(level + room).astype(np.int64)
    return out


def filled(times: Ints, keep: NDArray[np.bool_], at: Ints, pace: int) -> Ints:
    """Replace times (n,) not in `keep`: interpolated over `at` between kept times, else extrapolated by `pace`."""
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
    """Replace times that are not kept: evenly between kept times, after the last one by the usual period."""
    period = int(np.median(np.diff(times[keep]))) if keep.sum() > 1 else 0
    return filled(times, keep, np.arange(len(times)), period)


def _room_in_file(times: Ints, keep: NDArray[np.bool_], wrong: Ints) -> bool:
    """Return whether most `wrong` times fit better at their place in the file than at their time."""
    known, kept = np.flatnonzero(keep), times[keep]
    after = np.searchsorted(known, wrong)
    inner = (after > 0) & (after < len(known))
    if not inner.any():
        return False
    wrong, after = wrong[inner], after[inner]
    between = known[after] - known[after - 1]  # steps from neighbour to neighbour in the file
    in_file: Array = (kept[after] - kept[after - 1]) / between
    by_time = np.clip(np.searchsorted(kept, times[wrong]), 1, len(kept) - 1)
    in_time: Array = (kept[by_time] - kept[by_time - 1]) / 2.0
    return bool(2 * np.count_nonzero(in_file > in_time) > len(wrong))


# --- Which of a series of stamps to trust: the consistent ones with the greatest weight


def never_decreasing(values: Ints, weights: Array) -> NDArray[np.bool_]:
    """Mark the never-decreasing subsequence of `values` (n,) with the greatest sum of positive `weights` (n,).

    The series falls into blocks with everything before below everything behind: ordinary values are blocks of
    one, so that only the disordered places are searched.
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
    """Search one block in O(n log n): of all series up to an element, only those that another may still extend.

    Their last values rise, and their weights with them: a lighter series that ends higher is never extended.
    """
    last_values: list[int] = []
    series: list[tuple[float, int]] = []  # weight, last element
    before: list[int] = []  # element -> the one before it in its best series, -1 for none
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
