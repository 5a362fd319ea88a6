"""One topic of a log, read into columns in recording order: (log time, sequence), never position in the file."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from locfuse.formats.caps import MAX_LONG
from locfuse.formats.columns import Growing, take
from locfuse.formats.container.source import Messages
from locfuse.formats.messages.decoded import Decoded, MessageDecoder
from locfuse.formats.messages.fields import frame_path, stamp_path
from locfuse.fusion.data import END_OF_TIME, Column, Ints, LocfuseError

from . import jitter


class Raw(NamedTuple):
    """The messages of one channel in one batch, and what decodes them."""

    data: NDArray[np.uint8]
    messages: Messages
    decoder: MessageDecoder
    undated: int = 0  # messages left out: their recording time is absurd

    def columns(self, fields: Sequence[str]) -> Decoded:
        """Decode the named fields."""
        return self.decoder.decode(self.data, self.messages.start, self.messages.length, fields)

    def split(self, n: int) -> tuple[Raw, Raw]:
        """Return the first n messages and the rest."""
        first, rest = self.messages.take(slice(n)), self.messages.take(slice(n, None))
        return self._replace(messages=first), self._replace(messages=rest)


LONG_BYTES = 64 * 1024  # bytes: no message that is read into columns for a whole log is nearly as long
CHANGED = "the log changed while it was being read, or is damaged so that two readings of it differ"
NO_TIMES: tuple[Ints, Ints] = (np.empty(0, np.int64), np.empty(0, np.int64))


class Pass:
    """What one walk over the files collects."""

    def __init__(self, fields: Sequence[str], rows: int) -> None:
        self.fields = tuple(fields)
        self.columns = {name: Growing(rows) for name in self.fields}
        self.log_time = Growing(rows)
        self.sequence = Growing(rows)
        self.long = 0  # bytes of the messages that are longer than LONG_BYTES


class Table:
    """The readable messages of one topic. Row = place in recording order; walk row = place in the files."""

    def __init__(self, topic: str, decoder: MessageDecoder, expected: int) -> None:
        self.topic = topic
        self.decoder = decoder
        self._expected = expected  # messages, as the files say
        self.stamp = stamp_path(decoder.message)  # the field that dates the messages
        self._frame = frame_path(decoder.message)
        self.frame_id = ""
        self.bad: Counter[str] = Counter()  # reason -> messages that are no rows
        self.log_time: Ints | None = None  # (n,) recording order; None before the first read
        self.columns: dict[str, Column] = {}
        self.jittered = 0  # log times that ran backwards and were replaced
        self._walk_rows: Ints | None = None  # row -> walk row; None: the same
        self._pass = Pass((), 0)
        self._earliest: int | None = None
        self._n = 0  # readable messages
        self._times = NO_TIMES  # log time and sequence in walk order, until the rows are sorted

    def missing(self, fields: Sequence[str]) -> tuple[str, ...]:
        """Return the fields that a walk has yet to read, the stamp among them."""
        wanted = dict.fromkeys(fields)
        if self.stamp:
            wanted[self.stamp] = None
        return tuple(name for name in wanted if name not in self.columns)

    @property
    def known(self) -> bool:
        """Whether the messages were read once."""
        return self.log_time is not None

    def begin(self, fields: Sequence[str]) -> None:
        """Start collecting what is missing of `fields`."""
        self._pass = Pass(self.missing(fields), self._expected)

    def feed(self, raw: Raw) -> None:
        """Take the next messages in file order."""
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
            self._take_frame(raw, decoded.good, self._frame)

    def _refuse_too_much(self, raw: Raw, held: NDArray[np.bool_]) -> None:
        """Bound the memory: a small compressed file can hold any number of giant messages."""
        fields = [name for name in self._pass.fields if name != self.stamp]
        long = held & (raw.messages.length > LONG_BYTES)
        if not fields or not long.any():
            return
        self._pass.long += int(raw.messages.length[long].sum())
        if self._pass.long > MAX_LONG:
            raise LocfuseError(
                f"{self.topic}: its messages are up to {int(raw.messages.length.max())} bytes long, more than "
                f"{MAX_LONG >> 20} MiB in all: too much to hold {', '.join(fields)}. "
                "Is this the right topic?"
            )

    def _take_frame(self, raw: Raw, good: NDArray[np.bool_], path: str) -> None:
        rows = np.flatnonzero(good)
        first = rows[np.argmin(raw.messages.log_time[rows])]
        at = int(raw.messages.log_time[first])
        if self._earliest is None or at < self._earliest:
            self._earliest = at
            one = raw._replace(messages=raw.messages.take(np.array([first])))
            self.frame_id = str(one.columns((path,)).columns[path][0])

    def end(self) -> bool:
        """End the walk; return whether messages share a log time, so that their bytes must decide."""
        collected, self._pass = self._pass, Pass((), 0)
        columns = {name: self._finished(name, column) for name, column in collected.columns.items()}
        log_time, sequence = _integers(collected.log_time), _integers(collected.sequence)
        if self.known:
            self._add(columns, len(log_time))
            return False
        self.columns = columns
        self._n = len(log_time)
        self._times = log_time, sequence
        ordered = log_time if (np.diff(log_time) >= 0).all() else np.sort(log_time)
        return bool((np.diff(ordered) == 0).any())

    def _finished(self, name: str, growing: Growing) -> Column:
        column = growing.column()
        if column is None:
            none = np.empty(0, np.int64)
            column = self.decoder.decode(np.empty(0, np.uint8), none, none, (name,)).columns[name]
        return column

    def _add(self, columns: dict[str, Column], n: int) -> None:
        if n != self._n:
            raise LocfuseError(f"{self.topic}: {CHANGED}")
        rows = self._walk_rows
        self.columns |= {k: c if rows is None else take(c, rows) for k, c in columns.items()}

    def tied(self) -> Ints:
        """Return the log times that several messages share."""
        times, counts = np.unique(self._times[0], return_counts=True)
        return times[counts > 1]

    def sort(self, digests: Ints | None) -> None:
        """Put the rows into recording order; `digests` (n,) of the bytes, walk order, settle ties.

        That is the order of their log times, or, where these jitter, the order in which they lie in the file.
        """
        log_time, sequence = self._times
        self._times = NO_TIMES  # needed no more
        steady = jitter.pooled(log_time)
        if steady is not None:
            self.log_time, self.jittered = steady
            return
        if digests is None and (np.diff(log_time) > 0).all():
            self.log_time = log_time
            return
        keys = (sequence, log_time) if digests is None else (digests, sequence, log_time)
        order = np.lexsort(keys)
        if digests is not None:
            order = self._without_repeats(order, keys)
        self._walk_rows = order
        self.log_time = log_time[order]
        self.columns = {name: take(column, order) for name, column in self.columns.items()}

    @property
    def row(self) -> Ints:
        """Return the row of every readable message in walk order, -1 for none, (n,)."""
        if self._walk_rows is None:
            return np.arange(self._n)
        row = np.full(self._n, -1, np.int64)
        row[self._walk_rows] = np.arange(len(self._walk_rows))
        return row

    def _without_repeats(self, order: Ints, keys: tuple[Ints, ...]) -> Ints:
        """Leave out messages with the log time and the bytes of another: recorded twice, not measured twice."""
        digests, sequence, log_time = keys
        by_content = np.lexsort((sequence, digests, log_time))
        same = (
            (np.diff(log_time[by_content]) == 0)
            & (np.diff(digests[by_content]) == 0)
            & (digests[by_content[1:]] != 0)
        )
        repeats = by_content[1:][same]
        if len(repeats):
            self.bad["repeat"] += len(repeats)
            keep = np.ones(len(order), bool)
            keep[repeats] = False
            order = order[keep[order]]
        return order


def _integers(growing: Growing) -> Ints:
    column = growing.column()
    return NO_TIMES[0] if column is None else np.asarray(column)


def dated(raw: Raw) -> Raw:
    """Leave out messages recorded before 1970 or after 2116: their log time is not a time."""
    plausible = (raw.messages.log_time >= 0) & (raw.messages.log_time < END_OF_TIME)
    if plausible.all():
        return raw
    return raw._replace(messages=raw.messages.take(plausible), undated=int((~plausible).sum()))


def digest(raw: Raw, tied: Ints) -> Ints:
    """Return a number for the bytes of each readable message whose log time is among `tied`, 0 for the others."""
    decoded = raw.columns(())
    messages = raw.messages.take(decoded.good)
    found = np.zeros(len(messages.start), np.int64)
    for i in np.flatnonzero(np.isin(messages.log_time, tied)).tolist():
        start = int(messages.start[i])
        payload = raw.data[start : start + int(messages.length[i])].tobytes()
        found[i] = int.from_bytes(hashlib.blake2b(payload, digest_size=8).digest(), "little") >> 1 | 1
    return found
