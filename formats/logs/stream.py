"""Streams: one topic of a log with its chosen times, and message fields as columns on request.

A table holds the columns in recording order: by (log time, sequence), not by position in the file.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from typing import NamedTuple, Protocol, cast

import numpy as np
from msgspec.structs import replace

from locfuse.formats.columns import Bytes, Growing, GrowingArray, n_bytes
from locfuse.formats.container.source import Messages
from locfuse.formats.inputs import MAX_LONG
from locfuse.formats.messages.schema import Decoded, MessageDecoder, frame_path, stamp_path
from locfuse.fusion.data import END_OF_TIME, Array, Block, Column, Ints, LocfuseError, Mask, Ragged
from locfuse.fusion.streams import MAX_DELAY_S, concat, take

from . import clock as clocks
from .adapters import BEGIN, OF_CLOUDS, OF_PATH, POSE, PRESENTED
from .file_stream import RANGES, in_time_order


class Raw(NamedTuple):
    """The messages of one channel in one batch, with their decoder."""

    data: Bytes
    messages: Messages
    decoder: MessageDecoder
    undated: int = 0  # number of messages left out for an invalid recording time

    def columns(self, fields: Sequence[str]) -> Decoded:
        """Decode these fields of the messages."""
        return self.decoder.decode(self.data, self.messages.start, self.messages.length, fields)

    def split(self, n: int) -> tuple[Raw, Raw]:
        """Return the first n messages and the rest."""
        first, rest = self.messages.take(slice(n)), self.messages.take(slice(n, None))
        return self._replace(messages=first), self._replace(messages=rest)


LONG_BYTES = 64 * 1024  # usual messages with columns are much shorter
FRAMES_PER_BATCH = 20  # messages whose frame_id is read, to notice two publishers
CHANGED = "the log changed while it was being read, or is damaged so that two readings of it differ"
NO_TIMES: tuple[Ints, Ints] = (np.empty(0, np.int64), np.empty(0, np.int64))


class Pass:
    """The columns collected in one pass over the files."""

    def __init__(self, fields: Sequence[str], rows: int) -> None:
        self.fields = tuple(fields)
        self.columns = {name: Growing(rows) for name in self.fields}
        self.log_time = GrowingArray(rows)
        self.sequence = GrowingArray(rows)
        self.long = 0  # total bytes of messages longer than LONG_BYTES


class TopicTable:
    """The readable messages of one topic as columns, one row per message.

    A "row" is an index in recording order; a "file row" is an index in file order.
    """

    def __init__(self, topic: str, decoder: MessageDecoder, expected: int) -> None:
        self.topic = topic
        self.decoder = decoder
        self._expected = expected  # number of messages according to the files
        self.stamp = stamp_path(decoder.message)  # path of the header stamp, None without one
        self._frame = frame_path(decoder.message)
        self._first: tuple[int, str] | None = None  # log time and frame_id of the earliest message
        self.frames: list[str] = []  # frame_ids of the first FRAMES_PER_BATCH messages of every batch
        self.bad: Counter[str] = Counter()  # reason -> messages left out of the rows
        self.log_time: Ints | None = None  # (n,) recording order; None before the first read
        self.columns: dict[str, Column] = {}
        self.jittered = 0  # number of log times that were replaced by clocks.pooled
        self._file_rows: Ints | None = None  # row -> file row; None if both are equal
        self._pass = Pass((), 0)
        self._n = 0  # readable messages
        self._times = NO_TIMES  # log time and sequence in file order, until the rows are sorted

    @property
    def frame_id(self) -> str:
        """frame_id of the first message, "" without one."""
        return "" if self._first is None else self._first[1]

    def missing(self, fields: Sequence[str]) -> tuple[str, ...]:
        """Return the fields that are not in memory, of `fields` and the header stamp."""
        wanted = dict.fromkeys(fields)
        if self.stamp:
            wanted[self.stamp] = None
        return tuple(name for name in wanted if name not in self.columns)

    @property
    def known(self) -> bool:
        """Whether a pass over the messages was completed."""
        return self.log_time is not None

    def begin(self, fields: Sequence[str]) -> None:
        """Start a pass that collects the `fields` that are not in memory."""
        self._pass = Pass(self.missing(fields), self._expected)

    def feed(self, raw: Raw) -> None:
        """Add the next messages in file order."""
        decoded = raw.columns(self._pass.fields)
        self._refuse_too_much(raw, decoded.good)
        for name, piece in decoded.columns.items():
            self._pass.columns[name].add(piece)
        self._pass.log_time.add(raw.messages.log_time[decoded.good])
        if self.known:
            return
        self._pass.sequence.add(raw.messages.sequence[decoded.good])
        self.bad.update(decoded.bad)
        if raw.undated:
            self.bad["absurd recording time"] += raw.undated
        if self._frame and decoded.good.any():
            self._update_frame_id(raw, decoded.good, self._frame)

    def _refuse_too_much(self, raw: Raw, good: Mask) -> None:
        """Raise LocfuseError if the messages longer than LONG_BYTES have more than MAX_LONG bytes in total.

        Their columns would not fit in memory: even a small compressed file can contain many long messages.
        """
        fields = [name for name in self._pass.fields if name != self.stamp]
        long = good & (raw.messages.length > LONG_BYTES)
        if not fields or not long.any():
            return
        self._pass.long += int(raw.messages.length[long].sum())
        if self._pass.long > MAX_LONG:
            raise LocfuseError(
                f"{self.topic}: its messages are up to {int(raw.messages.length.max())} bytes long, more than "
                f"{MAX_LONG >> 20} MiB in all: too much to hold {', '.join(fields)}. "
                "Is this the right topic?"
            )

    def _update_frame_id(self, raw: Raw, good: Mask, path: str) -> None:
        rows = np.flatnonzero(good)
        some = raw._replace(messages=raw.messages.take(rows[:FRAMES_PER_BATCH]))
        self.frames += cast("list[str]", some.columns((path,)).columns[path])
        first = rows[np.argmin(raw.messages.log_time[rows])]
        at = int(raw.messages.log_time[first])
        if self._first is None or at < self._first[0]:
            one = raw._replace(messages=raw.messages.take(np.array([first])))
            self._first = at, str(one.columns((path,)).columns[path][0])

    def end(self) -> bool:
        """End the pass; return whether messages must be ordered by digests of their bytes.

        They must after the first pass over the topic, if messages may repeat others.
        """
        collected, self._pass = self._pass, Pass((), 0)
        none = np.empty(0, np.int64)
        empty = self.decoder.decode(np.empty(0, np.uint8), none, none, collected.fields).columns
        columns = {name: column.column(empty[name]) for name, column in collected.columns.items()}
        log_time, sequence = collected.log_time.array(), collected.sequence.array()
        if self.known:
            if len(log_time) != self._n:
                raise LocfuseError(f"{self.topic}: {CHANGED}")
            rows = self._file_rows
            self.columns |= {k: c if rows is None else take(c, rows) for k, c in columns.items()}
            return False
        self.columns = columns
        self._n = len(log_time)
        self._times = log_time, sequence
        return len(self.tied()) > 0

    @property
    def _stamps(self) -> Ints:
        """Header stamps (n,) [ns] in the order of the columns; zeros without any."""
        return np.zeros(self._n, np.int64) if self.stamp is None else np.asarray(self.columns[self.stamp])

    def tied(self) -> Ints:
        """Return the log times (k,) [ns] of messages that may repeat others: equal log times, or equal stamps.

        Equal stamps count only if stamps also run back, as if two publishers send the same.
        """
        log_time, stamp = self._times[0], self._stamps
        ordered = log_time if (np.diff(log_time) >= 0).all() else np.sort(log_time)
        tied = ordered[1:][np.diff(ordered) == 0]
        if (np.diff(stamp) < 0).any():
            stamps, counts = np.unique(stamp[stamp != 0], return_counts=True)
            tied = np.append(tied, log_time[np.isin(stamp, stamps[counts > 1])])
        return np.unique(tied)

    def sort(self, digests: Ints | None) -> None:
        """Sort the rows by log time, sequence, stamp, digest of the bytes (n,) and file order.

        If the log times jitter, the rows stay in file order. Many recorders write no sequence; then stamps give
        the order of messages with the same log time.
        """
        log_time, sequence = self._times
        self._times = NO_TIMES
        repaired = clocks.pooled(log_time)
        if repaired is not None:
            self.log_time, self.jittered = repaired
            return
        if digests is None and (np.diff(log_time) > 0).all():
            self.log_time = log_time
            return
        stamp = () if self.stamp is None else (np.asarray(self.columns[self.stamp]),)
        order = np.lexsort((*(() if digests is None else (digests,)), *stamp, sequence, log_time))
        if digests is not None:
            order = self._without_repeats(order, (digests, sequence, log_time))
        self._file_rows = order
        self.log_time = log_time[order]
        self.columns = {name: take(column, order) for name, column in self.columns.items()}

    @property
    def row(self) -> Ints:
        """Row of every readable message in file order (n,); -1 for a message recorded twice."""
        if self._file_rows is None:
            return np.arange(self._n)
        row = np.full(self._n, -1, np.int64)
        row[self._file_rows] = np.arange(len(self._file_rows))
        return row

    def _without_repeats(self, order: Ints, keys: tuple[Ints, ...]) -> Ints:
        """Return `order` without messages recorded twice: the bytes and the log time of an earlier message.

        With a header stamp, the log times may differ by less than MAX_DELAY_S.
        """
        digests, sequence, log_time = keys
        by_content = np.lexsort((sequence, log_time, digests))
        later = by_content[1:]
        apart = np.diff(log_time[by_content])
        same = (apart == 0) | ((apart < MAX_DELAY_S * 1e9) & (self._stamps[later] != 0))
        repeats = later[same & (np.diff(digests[by_content]) == 0) & (digests[later] != 0)]
        if len(repeats):
            self.bad["repeat"] += len(repeats)
            keep = np.ones(len(order), bool)
            keep[repeats] = False
            order = order[keep[order]]
        return order


def plausibly_recorded(raw: Raw) -> Raw:
    """Return the messages with a valid log time, from 1970 to 2116."""
    plausible = (raw.messages.log_time >= 0) & (raw.messages.log_time < END_OF_TIME)
    if plausible.all():
        return raw
    return raw._replace(messages=raw.messages.take(plausible), undated=int((~plausible).sum()))


def digest(raw: Raw, tied: Ints) -> Ints:
    """Return a hash (n,) of each readable message whose log time is in `tied`, 0 for the others."""
    decoded = raw.columns(())
    messages = raw.messages.take(decoded.good)
    found = np.zeros(len(messages.start), np.int64)
    for i in np.flatnonzero(np.isin(messages.log_time, tied)).tolist():
        start = int(messages.start[i])
        payload = raw.data[start : start + int(messages.length[i])].tobytes()
        found[i] = int.from_bytes(hashlib.blake2b(payload, digest_size=8).digest(), "little") >> 1 | 1
    return found


# --- Streams

NUMBER = "std_msgs/msg/Float64"  # message type of a topic derived from a numeric field
BLOCK_BYTES = 32 * 1024 * 1024


class _LogReader(Protocol):  # the part of formats.logs.log.Log that a stream uses
    def read(self, wants: Mapping[str, Sequence[str]]) -> dict[str, TopicTable]: ...
    def raw(self, topic: str, fields: Sequence[str]) -> Iterator[Raw]: ...
    def frame_ids(self, topic: str) -> list[str]: ...
    def left_out(self, topic: str) -> Mapping[str, int]: ...
    @property
    def stamps_clock(self) -> tuple[Ints, Ints] | None: ...


class LogStream:
    """A recorded topic with chosen times, and fields as columns on request (fusion.data.Stream)."""

    def __init__(self, log: _LogReader, topic: str, msgtype: str, order: str) -> None:
        self.topic = self._recorded = topic
        self.msgtype = msgtype
        self.order = order
        self._log = log

    @property
    def _table(self) -> TopicTable:
        return self._log.read({self._recorded: ()})[self._recorded]

    @cached_property
    def clock(self) -> clocks.RowTimes:
        """Times of the rows and their source: header stamps or recording times."""
        table = self._table
        assert table.log_time is not None
        stamp = np.asarray(table.columns[table.stamp]) if table.stamp else None
        clock = clocks.settle(table.log_time, stamp, self.order, lambda: self._log.stamps_clock)
        if not table.jittered:
            return clock
        note = (
            f"recording times jitter: {table.jittered} run backwards or are off the beat; the order of the "
            "messages in the file is kept, and those are dated evenly between their neighbours"
        )
        return replace(clock, notes=(*clock.notes, note))

    @property
    def t_ns(self) -> Ints:
        """Times of the rows, (n,) [ns], never decreasing."""
        return self.clock.t_ns

    @property
    def frame_id(self) -> str:
        """The frame_id of the first message's header; "" without one."""
        return self._table.frame_id

    @property
    def frames(self) -> Sequence[str]:
        """The frame_ids of some messages in file order."""
        return self._log.frame_ids(self._recorded)

    @property
    def delay_s(self) -> float | None:
        """Median of recording time - header stamp [s]; None without headers or messages.

        For repaired stamps, and for times converted to the clock of other topics' stamps, these times replace the
        stamps.
        """
        table = self._table
        if (self.clock.on_stamps or self.clock.repaired) and len(self.t_ns):
            return float(np.median(cast("Ints", table.log_time) - self.t_ns)) * 1e-9
        if table.stamp is None or table.log_time is None or not len(table.log_time):
            return None
        return float(np.median(table.log_time - np.asarray(table.columns[table.stamp]))) * 1e-9

    @property
    def recorded_at_once(self) -> bool:
        """Whether most messages with the header stamp of the one before have its recording time too."""
        table = self._table
        if table.stamp is None or table.log_time is None:
            return False
        repeats = np.diff(np.asarray(table.columns[table.stamp])) == 0
        return bool(repeats.any() and (np.diff(table.log_time)[repeats] == 0).mean() > 0.5)

    @property
    def dropped(self) -> Mapping[str, int]:
        """Reason -> number of messages that are not among the rows of the stream."""
        return {**self._log.left_out(self._recorded), **self._table.bad, **self.clock.dropped}

    def columns(self, *fields: str) -> dict[str, Column]:
        """Return whole columns by dotted field path, each with n rows."""
        table = self._log.read({self._recorded: fields})[self._recorded]
        rows = self.clock.rows
        return {name: table.columns[name] if rows is None else take(table.columns[name], rows) for name in fields}

    def blocks(self, *fields: str, rows: int = 256) -> Iterator[Block]:
        """Yield (row numbers (k,), columns), k at most `rows`, in file order; every row occurs exactly once."""
        row_of = self._table.row  # of every readable message in file order; -1 for a dropped one
        if self.clock.rows is not None:
            row = np.full(len(row_of) + 1, -1, np.int64)  # index -1: the last entry
            row[self.clock.rows] = np.arange(len(self.clock.rows))
            row_of = row[row_of]
        waiting: list[Block] = []
        room, size, at = rows, 0, 0
        for raw in self._log.raw(self._recorded, fields):
            while len(raw.messages.start):
                fitting = int(np.searchsorted(np.cumsum(raw.messages.length), BLOCK_BYTES, "right"))
                some, raw = raw.split(min(room, max(fitting, 1)))  # noqa: PLW2901
                decoded = some.columns(fields)
                here = row_of[at : at + int(decoded.good.sum())]
                at += int(decoded.good.sum())
                if at > len(row_of):
                    raise LocfuseError(f"{self.topic}: {CHANGED}")
                waiting.append(_rows(here, decoded.columns))
                room -= len(waiting[-1][0])
                size += sum(n_bytes(column) for column in waiting[-1][1].values())
                if room <= 0 or size >= BLOCK_BYTES:
                    yield _joined(waiting)
                    waiting, room, size = [], rows, 0
        if room < rows:
            yield _joined(waiting)


def _rows(numbers: Ints, columns: dict[str, Column]) -> Block:
    keep = numbers >= 0
    if keep.all():
        return numbers, columns
    rows = np.flatnonzero(keep)
    return numbers[rows], {name: take(column, rows) for name, column in columns.items()}


def _joined(blocks: list[Block]) -> Block:
    numbers = np.concatenate([block[0] for block in blocks])
    return numbers, {name: concat([block[1][name] for block in blocks]) for name in blocks[0][1]}


def field_of(name: str) -> tuple[str, str] | None:
    """Return topic and field of a name like "/status:heading.value"; None for another name."""
    parts = name.split(":")
    return (parts[0], parts[1]) if len(parts) == 2 and all(parts) else None


SAMPLED_CLOUDS, MIN_SHIFT_S = 8, 0.001


class PresentedStream(LogStream):
    """A topic converted to another message type by an adapter (formats.logs.adapters), block by block."""

    def __init__(self, name: str, source: LogStream) -> None:
        self._how = PRESENTED[source.msgtype]
        super().__init__(source._log, source.topic, self._how.msgtype, source.order)
        self.topic = name

    @property
    def frame_id(self) -> str:
        """The frame_id of the adapted messages."""
        return self._how.frame(super().frame_id)

    @cached_property
    def clock(self) -> clocks.RowTimes:
        """Times of the rows; those of clouds are moved to their first beams, by the times of the points."""
        clock = self.__dict__["clock"] = super().clock  # used by `blocks`
        if self._how.make not in OF_CLOUDS or not clock.as_stamped:
            return clock
        rows, columns = next(self.blocks(BEGIN, rows=SAMPLED_CLOUDS), (NO_TIMES[0], {BEGIN: np.empty(0)}))
        begin = cast("Array", columns[BEGIN])
        late = np.where(np.abs(begin) > MAX_DELAY_S, begin - clock.t_ns[rows] * 1e-9, begin)  # of a date or not
        shift = float(np.nanmedian(late)) if np.isfinite(late).any() else 0.0
        if not MIN_SHIFT_S < abs(shift) < MAX_DELAY_S:
            return clock
        note = f"its stamps are moved by {shift:.3f} s to the first beams, by the times of the points"
        return replace(clock, t_ns=clock.t_ns + round(shift * 1e9), notes=(*clock.notes, note))

    def columns(self, *fields: str) -> dict[str, Column]:
        """Return whole columns of the target type; the source is read block by block."""
        blocks = list(self.blocks(*fields))
        if not blocks:
            return self._adapted(super().columns(*self._how.fields), fields)
        order = np.argsort(np.concatenate([rows for rows, _ in blocks]), kind="stable")
        return {name: take(concat([made[name] for _, made in blocks]), order) for name in fields}

    def blocks(self, *fields: str, rows: int = 256) -> Iterator[Block]:
        """Yield (row numbers (k,), columns), k at most `rows`, in file order; every row occurs exactly once."""
        for numbers, columns in super().blocks(*self._how.fields, rows=rows):
            yield numbers, self._adapted(columns, fields)

    def _adapted(self, columns: Mapping[str, Column], fields: tuple[str, ...]) -> dict[str, Column]:
        assert self._how.make is not None
        made = self._how.make(columns, fields, super().frame_id)
        return {name: made[name] for name in fields}


def number_in(name: str, source: LogStream, field: str) -> clocks.MadeStream:
    """Return a numeric field of a topic as a stream of Float64."""
    values = np.asarray(source.columns(field)[field], dtype=np.float64)
    return _derived(name, source, NUMBER, source.t_ns, {"data": values})


def ranges_in(name: str, source: LogStream, fields: str) -> clocks.MadeStream:
    """Return two fields of a topic, "ids,ranges", as a stream of ranges; lists give one row per element.

    Raises LocfuseError for lists of different lengths.
    """
    ids, ranges = source.columns(*fields.split(",")).values()
    t_ns = source.t_ns
    if isinstance(ids, Ragged) and isinstance(ranges, Ragged):
        if not np.array_equal(ids.lengths, ranges.lengths):
            i = int(np.flatnonzero(ids.lengths != ranges.lengths)[0])
            raise LocfuseError(f"{name}: message {i} has {ids.lengths[i]} ids and {ranges.lengths[i]} ranges")
        t_ns = np.repeat(t_ns, ids.lengths)
        ids, ranges = (c.values[c.first[0] : c.first[-1]] for c in (ids, ranges))
    return _derived(name, source, RANGES, t_ns, {"id": np.asarray(ids), "range": np.asarray(ranges)})


def _derived(
    name: str, source: LogStream, msgtype: str, t_ns: Ints, data: Mapping[str, Column]
) -> clocks.MadeStream:
    """Return the columns `data` as a derived stream, with the clock, frame, delay and drop counts of `source`."""
    of = source.frame_id, source.dropped
    return clocks.MadeStream(name, msgtype, t_ns, data, *of, clock=source.clock, delay_s=source.delay_s)


def path_in(name: str, source: LogStream) -> clocks.MadeStream:
    """Return the poses of the last nav_msgs/Path of a topic, each at its own stamp.

    SLAM software publishes the path up to now again and again, each time longer and corrected; so only the last
    message is used. Raises LocfuseError if the poses have no times of their own, as in a planned path.
    """
    last: dict[str, Column] = {name: np.empty(0) for name in OF_PATH}
    latest = -1
    for rows, columns in source.blocks(*OF_PATH, rows=16):
        i = int(np.argmax(rows))
        if len(rows) and rows[i] > latest:
            latest = int(rows[i])
            last = {name: cast("Ragged", column)[i] for name, column in columns.items()}
    stamps: Ints = np.asarray(last.pop(OF_PATH[0]), np.int64)
    if len(stamps) < 2 or np.ptp(stamps) == 0:
        raise LocfuseError(
            f"{source.topic}: the {len(stamps)} poses of its last message have no times of their own: a plan, "
            "not a way that was driven"
        )
    poses = {field.removeprefix("poses."): column for field, column in last.items()}
    return replace(in_time_order(name, POSE, stamps, poses, "stamps of its poses"), frame_id=source.frame_id)
