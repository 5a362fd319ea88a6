"""Several topics of one sensor: two wheels on two topics, a ring of sonars; and the gaps of a stream."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any, cast

import msgspec
import numpy as np

from .data import Array, Block, Column, Ints, Stream

GAP, GAP_PERIODS = 0.5, 5.0  # s, median periods


def gap_limit(t: Array) -> float:
    """Return the longest step [s] in stamps t (n,) that is not a gap: 5 median periods, at least half a second."""
    return max(GAP, GAP_PERIODS * float(np.median(np.diff(t)))) if len(t) > 1 else GAP


def count_dropped(dropped: dict[str, int], **unused: Any) -> None:
    """Count the readings that are not used, by reason: their number, or a flag for each of n.

    A reason that never occurs is not listed.
    """
    for reason, which in unused.items():
        if n := int(np.sum(which)):
            dropped[reason] = dropped.get(reason, 0) + n


class MergedStream(msgspec.Struct, frozen=True, dict=True):
    """Streams of numbers as one Stream, in time order; `source` is the part that each row came from."""

    parts: tuple[Stream, ...]

    @property
    def topic(self) -> str:
        """The parts' topics in words."""
        return " and ".join(part.topic for part in self.parts)

    @property
    def msgtype(self) -> str:
        """The first part's type."""
        return self.parts[0].msgtype

    @property
    def frame_id(self) -> str:
        """The first part's frame."""
        return self.parts[0].frame_id

    @cached_property
    def dropped(self) -> Mapping[str, int]:
        """Messages of all parts that gave no row, by reason."""
        return dict(sum((Counter(part.dropped) for part in self.parts), Counter()))

    @cached_property
    def _order(self) -> Ints:
        return np.argsort(np.concatenate([part.t_ns for part in self.parts]), kind="stable")

    @cached_property
    def t_ns(self) -> Ints:
        """The times of the readings, (n,) ns, never decreasing."""
        times: Ints = np.concatenate([part.t_ns for part in self.parts])[self._order]
        return times

    @cached_property
    def source(self) -> Ints:
        """Position in `parts` of every row, (n,)."""
        counts = [len(part.t_ns) for part in self.parts]
        return np.repeat(np.arange(len(self.parts)), counts)[self._order]

    def columns(self, *fields: str) -> dict[str, Column]:
        """Return whole columns of numbers by dotted field path, each with n rows."""
        found = [cast("dict[str, Array]", part.columns(*fields)) for part in self.parts]
        return {name: np.concatenate([columns[name] for columns in found])[self._order] for name in fields}

    def blocks(self, *fields: str, rows: int = 256) -> Iterator[Block]:
        """Yield all rows as one block, since numbers need little memory."""
        yield np.arange(len(self.t_ns)), self.columns(*fields)


def parts_of(stream: Any) -> tuple[Any, ...]:
    """Return the single topics' streams that a stream is made of."""
    return stream.parts if isinstance(stream, MergedStream) else (stream,)


def merged(streams: Sequence[Stream]) -> Stream | MergedStream:
    """Return several streams as one; a single stream is returned unchanged."""
    return streams[0] if len(streams) == 1 else MergedStream(tuple(streams))


def summed(t: Array, rates: Array) -> tuple[Array, Ints]:
    """Return the integrals (n, ...) of rates (n, ...) since the first reading, by trapezoids, and the gaps so far.

    Over a gap the way is unknown: nothing is added there.
    """
    gap = np.diff(t) > gap_limit(t)
    held = np.where(gap, 0.0, np.diff(t)).reshape(-1, *[1] * (rates.ndim - 1))
    total = np.zeros_like(rates)
    np.cumsum(0.5 * (rates[1:] + rates[:-1]) * held, axis=0, out=total[1:])
    return total, np.concatenate(([0], np.cumsum(gap)))[: len(t)]


def last_of_periods(t: Array, period: float) -> Ints:
    """Return the last reading of every period, at strictly increasing times (n,) [s]."""
    cell = np.floor(t / period) if period > 0.0 else t
    return np.flatnonzero(np.append(np.diff(cell) > 0, True)[: len(t)])
