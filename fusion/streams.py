"""Streams of readings: joining and selecting rows, merging topics, finding gaps, integrating rates."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any, cast

import msgspec
import numpy as np
from numpy.typing import NDArray

from .data import Array, ArrayStream, Block, Column, Ints, LocfuseError, Mask, Ragged, Stream, stretches, totals

MAX_DELAY_S = 1.0  # a larger difference of stamp and recording time means two clocks, not a delay
MIN_GAP_S, GAP_PERIODS = 0.5, 5.0  # a gap is longer than both: s, median periods
MIN_BLANK_STEPS = 20.0  # median steps: from a larger value, a step to zero is no motion
# least readings to compare; largest ratio of the change over two readings to that over one (one source: 1 to 2)
MIN_IN_TURN, MAX_TURN_RATIO = 20, 0.5
# of readings that are stuck: least time with one value, least turn in it, share of this turn that is not shown
MIN_STUCK_S, MIN_STUCK_TURN_RAD, MAX_SHOWN_SHARE = 1.0, 0.35, 0.5


def concat(parts: Sequence[Column]) -> Column:
    """Concatenate columns of one kind."""
    head = parts[0]
    if len(parts) == 1:
        return head
    if isinstance(head, Ragged):
        ragged = [part for part in parts if isinstance(part, Ragged)]
        lengths = np.concatenate([part.lengths for part in ragged])
        values = np.concatenate([part.values[part.first[0] : part.first[-1]] for part in ragged])
        return Ragged(values, totals(lengths))
    if isinstance(head, list):
        return [value for part in parts if isinstance(part, list) for value in part]
    return np.concatenate([part for part in parts if isinstance(part, np.ndarray)])


def take(column: Column, rows: NDArray[Any]) -> Column:
    """Return the rows of a column with the indices `rows` (k,), in this order."""
    if isinstance(column, list):
        return [column[i] for i in rows.tolist()]
    if isinstance(column, np.ndarray):
        picked: NDArray[Any] = column[rows]
        return picked
    matrix = column.matrix()
    if matrix is not None:
        n = matrix.shape[1]
        return Ragged(matrix[rows].ravel(), np.arange(len(rows) + 1) * n)
    lengths = column.lengths[rows]
    first = totals(lengths)
    at = np.repeat(column.first[rows] - first[:-1], lengths) + np.arange(first[-1])
    return Ragged(column.values[at], first)


def seconds(t_ns: Ints, zero_ns: int, offset: float = 0.0) -> Array:
    """Return stamps (n,) [ns] as seconds since `zero_ns`, plus an offset [s]."""
    return (t_ns - zero_ns) * np.float64(1e-9) + offset


def arrays(stream: Stream, *fields: str) -> dict[str, Array]:
    """Return the columns of these fields, which hold one number or as many numbers in every reading."""
    return cast("dict[str, Array]", stream.columns(*fields))


def numbers(stream: Stream, *fields: str) -> Array:
    """Return the numbers of these fields, (n, fields), in all readings of a stream."""
    columns = arrays(stream, *fields)
    return np.stack([columns[name] for name in fields], axis=-1).astype(np.float64)


def taken(stream: Stream, rows: Ints, *fields: str) -> ArrayStream:
    """Return a stream of the rows with these indices (k,), at least one, with these fields in memory."""
    parts: list[Block] = []
    for at, columns in stream.blocks(*fields):
        if len(kept := np.flatnonzero(np.isin(at, rows))):
            parts.append((at[kept], {name: take(column, kept) for name, column in columns.items()}))
    numbers = np.concatenate([at for at, _ in parts])
    order = np.argsort(numbers)
    data = {name: take(concat([columns[name] for _, columns in parts]), order) for name in fields}
    return ArrayStream(stream.topic, stream.msgtype, stream.t_ns[numbers[order]], data, stream.frame_id)


def gap_limit(t: Array) -> float:
    """Return the longest step [s] between stamps t (n,) that is no gap: 5 median periods, at least 0.5 s."""
    return max(MIN_GAP_S, GAP_PERIODS * float(np.median(np.diff(t)))) if len(t) > 1 else MIN_GAP_S


def outside(t: Array, of_drive: Array, role: str, offset: float, recorded: float | None = None) -> LocfuseError:
    """Return the error that all times t (n,) [s] of a role are outside the drive, with the offset to try.

    `offset` [s] is the present time_offset, `recorded` [s] the one by recording times (`recorded_apart`).
    """
    begin, end = float(of_drive[0]), float(of_drive[-1])
    off = begin - float(t.min())
    side = "before" if off > 0.0 else "after"
    words = f"none of its {len(t)} readings lies within the {end - begin:.1f} s of the drive: "
    words += f"they begin {abs(off):.1f} s {side} it"
    more = 0.0 if recorded is None else recorded - offset
    if recorded is not None and t.min() + more <= end and t.max() + more >= begin:
        off, words = more, f"{words}, but were recorded with it: another clock."
    else:
        words += ". It is another drive or, if both began together, another clock:"
    fix = f"{role}.time_offset={offset + off:z.3f}"
    return LocfuseError(words, role=role, fixes=(fix,), hint=f"--set {fix}")


def recorded_apart(stream: Any, of_drive: Any) -> float | None:
    """Return the offset [s] of a stream's stamps from the drive's by recording times; None if unknown.

    Below MAX_DELAY_S it is the time to process a message, and both have one clock: 0.
    """
    delays = [getattr(parts_of(one)[0], "delay_s", None) for one in (stream, of_drive)]
    if delays[0] is None or delays[1] is None:
        return None
    apart = float(delays[0] - delays[1])
    return 0.0 if abs(apart) < MAX_DELAY_S else apart


def count_dropped(dropped: dict[str, int], **unused: Any) -> None:
    """Add numbers of unused readings to `dropped`, reason -> number.

    Each keyword argument is a reason with a number, or with flags (n,). A reason that never occurs is not listed.
    """
    for reason, which in unused.items():
        if n := int(np.sum(which)):
            dropped[reason] = dropped.get(reason, 0) + n


def blank(values: Array) -> Mask:
    """Return flags (n,) of the rows of values (n, k) that are zeros in place of a reading.

    The rows before and after such zeros are similar, and larger than MIN_BLANK_STEPS median steps.
    """
    out: Mask = (values == 0.0).all(axis=1)
    known, at = np.flatnonzero(~out), np.flatnonzero(out)
    step = np.hypot.reduce(np.diff(values[known], axis=0), axis=1)
    if not len(at) or not step.any():
        return np.zeros(len(values), bool)
    i = np.searchsorted(known, at)
    left, right = (values[known[np.clip(k, 0, len(known) - 1)]] for k in (i - 1, i))
    size = np.minimum(np.hypot.reduce(left, axis=1), np.hypot.reduce(right, axis=1))
    usual = MIN_BLANK_STEPS * float(np.median(step[step > 0.0]))
    out[at] = (size > usual) & (np.hypot.reduce(left - right, axis=1) < 0.5 * size)
    return out


def in_turn(values: Array) -> bool:
    """Return whether readings (n, k) change less over two readings than over one: two sources in turn."""
    if len(values) < MIN_IN_TURN:
        return False
    values = np.where(np.isfinite(values), values, 0.0)
    one, two = (float(np.median(np.abs(values[k:] - values[:-k]).mean(axis=1))) for k in (1, 2))
    return two < MAX_TURN_RATIO * one


class MergedStream(msgspec.Struct, frozen=True, dict=True):
    """Several streams of numbers merged into one, in time order."""

    parts: tuple[Stream, ...]

    @property
    def topic(self) -> str:
        """Topics of all parts, joined by "and"."""
        return " and ".join(part.topic for part in self.parts)

    @property
    def msgtype(self) -> str:
        """Message type of the first part."""
        return self.parts[0].msgtype

    @property
    def frame_id(self) -> str:
        """frame_id of the first part."""
        return self.parts[0].frame_id

    @cached_property
    def dropped(self) -> Mapping[str, int]:
        """Reason -> number of messages without a row, over all parts."""
        return dict(sum((Counter(part.dropped) for part in self.parts), Counter()))

    @cached_property
    def _order(self) -> Ints:
        return np.argsort(np.concatenate([part.t_ns for part in self.parts]), kind="stable")

    @cached_property
    def t_ns(self) -> Ints:
        """Stamps of the readings, (n,) ns, never decreasing."""
        return np.concatenate([part.t_ns for part in self.parts])[self._order]

    @cached_property
    def source(self) -> Ints:
        """Index of the part from which each row comes, (n,)."""
        counts = [len(part.t_ns) for part in self.parts]
        return np.repeat(np.arange(len(self.parts)), counts)[self._order]

    def columns(self, *fields: str) -> dict[str, Column]:
        """Return the numbers of all n rows for each of these fields, by dotted field path."""
        found = [arrays(part, *fields) for part in self.parts]
        return {name: np.concatenate([columns[name] for columns in found])[self._order] for name in fields}

    def blocks(self, *fields: str, rows: int = 256) -> Iterator[Block]:
        """Yield all rows as one block."""
        yield np.arange(len(self.t_ns)), self.columns(*fields)


def parts_of(stream: Any) -> tuple[Any, ...]:
    """Return the streams that a merged stream consists of; another stream is its own only part."""
    return stream.parts if isinstance(stream, MergedStream) else (stream,)


def merged(streams: Sequence[Stream]) -> Stream | MergedStream:
    """Return several streams merged into one; a single stream is returned unchanged."""
    return streams[0] if len(streams) == 1 else MergedStream(tuple(streams))


def summed(t: Array, rates: Array) -> tuple[Array, Ints]:
    """Integrate rates (n, ...) over times t (n,) [s] by trapezoids; nothing is added across a gap.

    Returns the integrals (n, ...) from t[0] to each time, and the number (n,) of gaps before each time.
    """
    gap = np.diff(t) > gap_limit(t)
    held = np.where(gap, 0.0, np.diff(t)).reshape(-1, *[1] * (rates.ndim - 1))
    total = np.zeros_like(rates)
    np.cumsum(0.5 * (rates[1:] + rates[:-1]) * held, axis=0, out=total[1:])
    return total, totals(gap)[: len(t)]


def stuck(value: Array, rate: Array, t: Array, turned: Callable[[Array], Array]) -> Mask:
    """Return flags (n,) of readings that repeat one value for MIN_STUCK_S while the robot turns otherwise.

    `value` (n,) at times t (n,) [s] means a turning rate (n,) [rad/s]; `turned` gives the headings by the wheels.
    """
    flags = np.zeros(len(t), dtype=bool)
    for first, last in stretches(np.diff(value) == 0.0):
        held = slice(first, last + 2)
        if t[last + 1] - t[first] < MIN_STUCK_S:
            continue
        by_wheels = turned(t[held])
        turns, off = np.ptp(by_wheels), np.ptp(by_wheels - rate[first] * t[held])
        # at standstill a coarse sensor without noise repeats one value too
        flags[held] = turns > MIN_STUCK_TURN_RAD and off > MAX_SHOWN_SHARE * turns
    return flags


def last_of_periods(t: Array, period: float) -> Ints:
    """Return the index of the last reading in every period of length `period` [s].

    The times t (n,) [s] of the readings are strictly increasing.
    """
    cell = np.floor(t / period) if period > 0.0 else t
    return np.flatnonzero(np.append(np.diff(cell) > 0, True)[: len(t)])
