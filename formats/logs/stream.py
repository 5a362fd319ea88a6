"""One topic of a log as fusion sees it: its clock is settled, its fields are columns on request."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Protocol, cast

import numpy as np
from msgspec.structs import replace

from locfuse.formats.columns import concat, n_bytes, take
from locfuse.fusion.data import Block, Column, Ints, LocfuseError, Ragged

from . import clock as clocks
from .adapters import OF_PATH, POSE, PRESENTED
from .file_stream import FileStream
from .table import CHANGED, Raw, Table

NUMBER = "std_msgs/msg/Float64"  # what a number of any message is presented as
BLOCK_BYTES = 32 * 1024 * 1024


class Reader(Protocol):
    """What a stream asks of its log."""

    def read(self, wants: Mapping[str, Sequence[str]]) -> dict[str, Table]:
        """Make sure that the fields of the topics are in memory."""

    def raw(self, topic: str, fields: Sequence[str]) -> Iterator[Raw]:
        """Yield the messages of one topic, of which `fields` will be asked, batch by batch."""

    def left_out(self, topic: str) -> Mapping[str, int]:
        """Count the messages on a topic that are of another type than the rest of it."""

    @property
    def stamps_clock(self) -> tuple[Ints, Ints] | None:
        """Log times and stamps of the other topics, where these are of a clock that is not the recording's."""


class LogStream(clocks.Dated):
    """One topic: its clock is settled, its fields are columns on request (fusion.data.Stream)."""

    def __init__(self, log: Reader, topic: str, msgtype: str, order: str) -> None:
        self.topic = topic
        self.msgtype = msgtype
        self.order = order
        self._log = log

    @property
    def _table(self) -> Table:
        return self._log.read({self.topic: ()})[self.topic]

    @cached_property
    def _clock(self) -> clocks.Clock:
        table = self._table
        assert table.log_time is not None
        stamp = np.asarray(table.columns[table.stamp]) if table.stamp else None
        clock = clocks.settle(table.log_time, stamp, self.order)
        if stamp is None and self.order == "auto" and (known := self._log.stamps_clock) is not None:
            clock = clocks.on_clock(clock, known)
        return replace(clock, notes=(*clock.notes, _jittered(table.jittered))) if table.jittered else clock

    @property
    def frame_id(self) -> str:
        """The frame of the first message's header, "" without one."""
        return self._table.frame_id

    @property
    def t_ns(self) -> Ints:
        """When the readings were taken, (n,), never decreasing."""
        return self._clock.t_ns

    @property
    def delay_s(self) -> float | None:
        """By how much recording lags behind the header stamps, median [s]; None without headers or messages."""
        table = self._table
        if table.stamp is None or table.log_time is None or not len(table.log_time):
            return None
        return float(np.median(table.log_time - np.asarray(table.columns[table.stamp]))) * 1e-9

    @property
    def dropped(self) -> Mapping[str, int]:
        """Messages that are not among the rows, by reason."""
        return {**self._log.left_out(self.topic), **self._table.bad, **self._clock.dropped}

    def columns(self, *fields: str) -> dict[str, Column]:
        """Return whole columns by dotted field path, each with n rows."""
        table = self._log.read({self.topic: fields})[self.topic]
        rows = self._clock.rows
        return {name: table.columns[name] if rows is None else take(table.columns[name], rows) for name in fields}

    def blocks(self, *fields: str, rows: int = 256) -> Iterator[Block]:
        """Yield (row numbers (k,), columns), k at most `rows`, in file order; every row exactly once."""
        row_of = self._row_of_walk()
        waiting: list[Block] = []
        room, size, at = rows, 0, 0
        for raw in self._log.raw(self.topic, fields):
            while len(raw.messages.start):
                some, raw = raw.split(min(room, _at_once(raw.messages.length)))  # noqa: PLW2901
                decoded = some.columns(fields)
                here = row_of[at : at + int(decoded.good.sum())]
                at += int(decoded.good.sum())
                if at > len(row_of):
                    raise LocfuseError(f"{self.topic}: {CHANGED}")
                waiting.append(_rows(here, decoded.columns))
                room -= len(waiting[-1][0])
                size += _bytes(waiting[-1])
                if room <= 0 or size >= BLOCK_BYTES:
                    yield _joined(waiting)
                    waiting, room, size = [], rows, 0
        if room < rows:
            yield _joined(waiting)

    def _row_of_walk(self) -> Ints:
        """Return the row of every readable message in file order, -1 for none."""
        recorded = self._table.row
        if self._clock.rows is None:
            return recorded
        row = np.full(len(recorded) + 1, -1, np.int64)  # the last one answers for -1
        row[self._clock.rows] = np.arange(len(self._clock.rows))
        return row[recorded]


def _jittered(n: int) -> str:
    """Say that times ran backwards and the order of the file was kept."""
    return (
        f"recording times jitter: {n} run backwards or are off the beat; the order of the messages in the file "
        "is kept, and those are dated evenly between their neighbours"
    )


def _rows(numbers: Ints, columns: dict[str, Column]) -> Block:
    keep = numbers >= 0
    if keep.all():
        return numbers, columns
    rows = np.flatnonzero(keep)
    return numbers[rows], {name: take(column, rows) for name, column in columns.items()}


def _at_once(length: Ints) -> int:
    """Return how many messages of these lengths (k,) to decode together: those of BLOCK_BYTES, at least one."""
    return max(int(np.searchsorted(np.cumsum(length), BLOCK_BYTES, "right")), 1)


def _bytes(block: Block) -> int:
    return sum(n_bytes(column) for column in block[1].values())


def _joined(blocks: list[Block]) -> Block:
    numbers = np.concatenate([block[0] for block in blocks])
    return numbers, {name: concat([block[1][name] for block in blocks]) for name in blocks[0][1]}


def field_of(name: str) -> tuple[str, str] | None:
    """Return topic and field of a name like "/status:heading.value", None for any other name."""
    parts = name.split(":")
    return (parts[0], parts[1]) if len(parts) == 2 and all(parts) else None


class DerivedStream(clocks.Dated):
    """A topic made of another one, with its clock and the face of a topic (formats.logs.stream.LogStream)."""

    msgtype = ""

    def __init__(self, topic: str, source: LogStream) -> None:
        self.topic = topic
        self._source = source

    @property
    def order(self) -> str:
        """The order in which the source is read."""
        return self._source.order

    @property
    def frame_id(self) -> str:
        """The frame of the first message's header, "" without one."""
        return self._source.frame_id

    @property
    def t_ns(self) -> Ints:
        """When the readings were taken, (n,), never decreasing."""
        return self._source.t_ns

    @property
    def delay_s(self) -> float | None:
        """By how much recording lags behind the header stamps, median [s]."""
        return self._source.delay_s

    @property
    def _clock(self) -> clocks.Clock:
        return self._source._clock

    @property
    def dropped(self) -> Mapping[str, int]:
        """Messages that are not among the rows, by reason."""
        return self._source.dropped


class NumberStream(DerivedStream):
    """A field of a topic."""

    msgtype = NUMBER

    def __init__(self, topic: str, source: LogStream, field: str) -> None:
        super().__init__(topic, source)
        self._field = field

    def columns(self, *fields: str) -> dict[str, Column]:
        """Return the number as the column "data"."""
        values = np.asarray(self._source.columns(self._field)[self._field], dtype=np.float64)
        return dict.fromkeys(fields, values)

    def blocks(self, *fields: str, rows: int = 256) -> Iterator[Block]:
        """Yield everything as one block: numbers are light."""
        yield np.arange(len(self.t_ns)), self.columns(*fields)


class PresentedStream(DerivedStream):
    """Messages of one type as those of another (formats.logs.adapters)."""

    def __init__(self, topic: str, source: LogStream) -> None:
        super().__init__(topic, source)
        self._how = PRESENTED[source.msgtype]
        self.msgtype = self._how.msgtype

    @property
    def frame_id(self) -> str:
        """The frame in which the messages made are."""
        return self._how.frame(self._source.frame_id)

    def columns(self, *fields: str) -> dict[str, Column]:
        """Return whole columns of the type that it is presented as; the source is read block by block."""
        blocks = list(self.blocks(*fields))
        if not blocks:
            return self._made(self._source.columns(*self._how.fields), fields)
        order = np.argsort(np.concatenate([rows for rows, _ in blocks]), kind="stable")
        return {name: take(concat([made[name] for _, made in blocks]), order) for name in fields}

    def blocks(self, *fields: str, rows: int = 256) -> Iterator[Block]:
        """Yield (row numbers (k,), columns), k at most `rows`, in file order; every row exactly once."""
        for numbers, columns in self._source.blocks(*self._how.fields, rows=rows):
            yield numbers, self._made(columns, fields)

    def _made(self, columns: Mapping[str, Column], fields: tuple[str, ...]) -> dict[str, Column]:
        assert self._how.make is not None
        return self._how.make(columns, fields, self._source.frame_id)


class PathStream(FileStream):
    """The poses of the last nav_msgs/Path of a topic, each at its own stamp.

    A program that draws the way it thinks the robot took publishes it again and again, longer each time and with
    what it corrected since. Raises LocfuseError where the poses have no times of their own: a plan.
    """

    clock = "stamps of its poses"

    def __init__(self, topic: str, source: LogStream) -> None:
        last = _last_message(source)
        stamps: Ints = np.asarray(last.pop(OF_PATH[0]), np.int64)
        if len(stamps) < 2 or np.ptp(stamps) == 0:
            raise LocfuseError(
                f"{source.topic}: the {len(stamps)} poses of its last message have no times of their own: a plan, "
                "not a way that was driven"
            )
        super().__init__(Path(topic), POSE, stamps, {name.removeprefix("poses."): c for name, c in last.items()})
        self.frame_id = source.frame_id
        self.order = source.order


def _last_message(source: LogStream) -> dict[str, Column]:
    """Return the columns of the poses in the last message; of the others nothing is kept."""
    found: dict[str, Column] = {name: np.empty(0) for name in OF_PATH}
    latest = -1
    for rows, columns in source.blocks(*OF_PATH, rows=16):
        i = int(np.argmax(rows))
        if len(rows) and rows[i] > latest:
            latest = int(rows[i])
            found = {name: cast("Ragged", column)[i] for name, column in columns.items()}
    return found
