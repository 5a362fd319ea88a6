"""A rosbag2 sqlite3 file (.db3) as a source of message batches.

sqlite runs what a database tells it to. On a stranger's file it is kept on a leash: tables only, no views, no
computed columns, values of bounded size, a deadline for every step (https://sqlite.org/security.html).
"""

from __future__ import annotations

import sqlite3
import struct
import time
from collections.abc import Collection, Iterator, Mapping
from contextlib import closing, contextmanager
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from locfuse.formats.caps import MAX_CHUNK, MAX_DATABASE_SECONDS, MAX_MESSAGE
from locfuse.fusion.data import Ints, LocfuseError

from .file_bytes import FileBytes
from .known_types import MAX_SAMPLE, definition
from .losses import Losses
from .source import Batch, ChannelInfo, Messages, message_type
from .url import Place

ERRORS = (sqlite3.Error, UnicodeDecodeError, ValueError, MemoryError)  # of a damaged database
BATCH_BYTES = 1 << 20
DAMAGED = "the database is damaged: rows may be missing"
CUT_SHORT = "the messages behind a damaged place of the database are lost"

TABLES = ("messages", "topics", "message_definitions")  # what is asked for
STEPS_PER_LOOK = 10_000  # of sqlite's machine between two looks at the clock
TOPIC = "COALESCE(CAST(topic_id AS INTEGER), -1)"  # some writers keep numbers as text
BYTES_PER_SECOND = 20e6  # a whole database is checked faster than that

Row = tuple[int, int, bytes | None]  # topic, time in ns, message


class Leash:
    """Aborts a step of sqlite that takes too long; a signal aborts any step.

    sqlite calls back after some instructions and drops exceptions from there: a step that was interrupted before
    its time was interrupted by a signal.
    """

    def __init__(self, path: Place, size: int) -> None:
        self._path = path
        self._allowed_s = MAX_DATABASE_SECONDS + size / BYTES_PER_SECOND
        self._end_s = 0.0

    def hold(self, database: sqlite3.Connection) -> None:
        """Limit the steps of a connection."""
        database.set_progress_handler(self._late, STEPS_PER_LOOK)
        database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_CHUNK)

    def begin(self) -> None:
        """Restart the clock."""
        self._end_s = time.thread_time() + self._allowed_s

    def _late(self) -> bool:
        return time.thread_time() > self._end_s

    @contextmanager
    def step(self) -> Iterator[None]:
        """Limit one step. Raises LocfuseError if it takes too long, KeyboardInterrupt for a signal."""
        self.begin()
        try:
            yield
        except sqlite3.OperationalError as problem:
            if problem.sqlite_errorcode != sqlite3.SQLITE_INTERRUPT:
                raise
            if not self._late():
                raise KeyboardInterrupt from None
            words = f"the database keeps sqlite busy for more than the cap of {self._allowed_s:.0f} s"
            raise LocfuseError(f"{self._path}: {words}") from None


class SqliteSource:
    """One .db3 file."""

    attachments: Mapping[str, bytes] = {}

    def __init__(self, data: FileBytes, losses: Losses) -> None:
        self.path = data.path
        self.losses = losses
        self.data = data
        self._leash = Leash(self.path, data.size)
        self._readable = 2**63 - 1  # rowid up to which a walk has come that met damage
        self._journal_is_used = self._count_unused_journal()
        try:
            with closing(self._connect()) as database, self._leash.step():
                self._refuse_programs(database)
                self._check(database)
                self.channels, self._counts = _channels(database, self._leash)
        except ERRORS as problem:
            raise LocfuseError(f"{self.path}: not a readable rosbag2 database: {problem}") from None

    def _count_unused_journal(self) -> bool:
        """Count the part of a crashed recording's journal that sqlite ignores; return whether it uses any."""
        journal = self._journal
        try:
            if not journal.exists() or not journal.stat().st_size:
                return False
            used, tail = journal_of(journal)
        except OSError:
            return True  # then sqlite cannot read it either, and that is counted
        if tail is not None:
            self.losses.add(str(self.path), tail.reason, tail.offset, tail.bytes)
        return used

    @property
    def _journal(self) -> Path:
        return Path(f"{self.data.where.resolve()}-wal")

    def _refuse_programs(self, database: sqlite3.Connection) -> None:
        """Refuse tables with computed rows, which may have no end."""
        listed = "SELECT lower(name), type, sql FROM sqlite_master WHERE lower(name) IN (?, ?, ?)"
        for name, kind, sql in database.execute(listed, TABLES).fetchall():
            if kind != "table" or str(sql).upper().startswith("CREATE VIRTUAL"):
                what = kind if kind != "table" else "virtual table"
                raise LocfuseError(f"{self.path}: its {name} is a {what}; only plain tables are read")
            if any(column[-1] for column in database.execute(f"PRAGMA table_xinfo({name})")):
                raise LocfuseError(
                    f"{self.path}: its table {name} has computed columns; only stored ones are read"
                )

    def _check(self, database: sqlite3.Connection) -> None:
        """Search for damage that sqlite would not report: rows that it cannot reach are just missing."""
        try:
            with self._leash.step():
                verdict = str(database.execute("PRAGMA quick_check(1)").fetchone()[0])
        except ERRORS as problem:
            verdict = str(problem)
        if verdict != "ok":
            self.losses.add(str(self.path), DAMAGED, 0, 0)

    def _connect(self) -> sqlite3.Connection:
        """Open read-only; with the journal of a crashed recording if it can be read."""
        self.data.still_the_same()
        where = self.data.where.resolve()
        journal = self._journal
        if journal.exists() and journal.stat().st_size:
            # where no recorder has the file open, without locks: nothing is then written beside the user's bag
            alone = not Path(f"{where}-shm").exists()
            if alone and not self._journal_is_used:  # sqlite would delete it, read-only or not: to it, it is empty
                return self._open(where, "&immutable=1")
            for options in ("&vfs=unix-none", "") if alone else ("", "&vfs=unix-none"):
                try:
                    database = self._open(where, options)
                    if options:
                        database.execute("PRAGMA locking_mode=EXCLUSIVE")
                    database.execute("SELECT count(*) FROM sqlite_master")
                except ERRORS:
                    continue
                return database
            self.losses.add(str(self.path), "its journal (-wal) cannot be read", 0, journal.stat().st_size)
        return self._open(where, "&immutable=1")

    def _open(self, where: Path, options: str) -> sqlite3.Connection:
        quoted = str(where).replace("%", "%25").replace("?", "%3f").replace("#", "%23")
        database = sqlite3.connect(f"file:{quoted}?mode=ro{options}", uri=True)
        self._leash.hold(database)
        for pragma in ("trusted_schema=OFF", "cell_size_check=ON", "mmap_size=0"):
            database.execute(f"PRAGMA {pragma}")
        return database

    @cached_property
    def time_span_ns(self) -> tuple[int, int] | None:
        """First and last time, None without messages."""
        with closing(self._connect()) as database:
            try:
                with self._leash.step():
                    found = database.execute("SELECT min(timestamp), max(timestamp) FROM messages").fetchone()
                first, last = found
                return None if first is None else (int(first), int(last))
            except ERRORS:
                return None

    def published(self, data: NDArray[np.uint8], messages: Messages) -> Ints:
        """Return the log times: the file keeps no others."""
        return messages.log_time

    def batches(self, wanted: Collection[int]) -> Iterator[Batch]:
        """Yield the messages of the wanted topics in file order, about a megabyte at a time."""
        rows: list[Row] = []
        size = 0
        for row in self._rows(wanted):
            rows.append(row)
            size += len(row[2] or b"")
            if size >= BATCH_BYTES:
                yield _batch(rows)
                self._leash.begin()  # what was done with them is none of sqlite's time
                rows, size = [], 0
        if rows:
            yield _batch(rows)

    def _rows(self, wanted: Collection[int]) -> Iterator[Row]:
        topics = sorted(wanted)
        query = (
            f"SELECT {TOPIC}, COALESCE(CAST(timestamp AS INTEGER), -1), "
            "CASE WHEN length(data) <= ? THEN CAST(data AS BLOB) END, rowid FROM messages "
            f"WHERE {TOPIC} IN ({','.join('?' * len(topics))}) AND rowid <= ? ORDER BY rowid"
        )
        n, last = 0, 0
        with closing(self._connect()) as database:
            try:
                with self._leash.step():
                    for row in database.execute(query, (MAX_MESSAGE, *topics, self._readable)):
                        n, last = n + 1, row[3]
                        yield row[:3]
            except ERRORS:
                # another walk might get past the damage: then it would have other rows than this one
                self._readable = min(self._readable, last)
                expected = sum(self._counts.get(topic, 0) for topic in topics)
                self.losses.add(str(self.path), CUT_SHORT, 0, 0, max(expected - n, 0) or None)


def _channels(database: sqlite3.Connection, leash: Leash) -> tuple[dict[int, ChannelInfo], dict[int, int]]:
    database.text_factory = lambda text: text.decode("utf-8", "replace")
    texts = _definitions(database, leash)
    try:
        with leash.step():
            counts = dict(database.execute(f"SELECT {TOPIC}, count(*) FROM messages GROUP BY 1"))
    except ERRORS:
        counts = {}
    samples = _samples(database, leash)
    found = {}
    for ident, *texts_of_topic in database.execute(
        "SELECT CAST(id AS INTEGER), name, type, serialization_format FROM topics ORDER BY 1"
    ):
        topic, msgtype, encoding = (str(text or "") for text in texts_of_topic)
        language, text = texts.get(msgtype) or (
            "ros2msg",
            definition(message_type(msgtype), samples.get(ident, b"")),
        )
        schema = (language, text.encode()) if text else ("", b"")
        found[ident] = ChannelInfo(topic, msgtype, encoding, *schema, counts.get(ident, 0))
    return found, counts


def _samples(database: sqlite3.Connection, leash: Leash) -> dict[int, bytes]:
    """Return the first message of every topic, without messages that are too long."""
    query = (
        f"SELECT {TOPIC}, CAST(data AS BLOB) FROM messages WHERE rowid IN "
        f"(SELECT min(rowid) FROM messages GROUP BY {TOPIC}) AND length(data) <= ?"
    )
    try:
        with leash.step():
            return {int(ident): bytes(data) for ident, data in database.execute(query, (MAX_SAMPLE,)) if data}
    except ERRORS:
        return {}


def _definitions(database: sqlite3.Connection, leash: Leash) -> dict[str, tuple[str, str]]:
    """Return type -> (language, text) by the bag's own table, since ROS 2 Iron."""
    columns = "topic_type, encoding, encoded_message_definition"
    try:
        with leash.step():
            rows = database.execute(f"SELECT {columns} FROM message_definitions").fetchall()
    except ERRORS:
        return {}
    return {str(name): (str(language), str(text)) for name, language, text in rows if text}


def _batch(rows: list[Row]) -> Batch:
    """Join the messages in one buffer; one that is too large becomes empty."""
    topic = np.array([row[0] for row in rows], np.int64)
    length = np.array([len(row[2] or b"") for row in rows], np.int64)
    everything = Messages(
        np.cumsum(length) - length,
        length,
        np.array([row[1] for row in rows], np.int64),
        np.zeros(len(rows), np.int64),
    )
    data = np.frombuffer(b"".join(row[2] or b"" for row in rows), np.uint8)
    return Batch(data, {int(ident): everything.take(topic == ident) for ident in np.unique(topic)})


# --- The journal (-wal): what sqlite uses of it, and what it ignores silently
# A recorder that dies leaves its last messages in the journal. sqlite reads it up to the last commit before the
# first frame whose checksum is wrong, and calls that normal. The frames behind that place bear the salts of the
# journal's header, which those of an older journal do not have.
# Format: https://sqlite.org/fileformat2.html#walformat

HEADER = struct.Struct(">8I")  # magic, version, page size, sequence, two salts, two checksums
FRAME = struct.Struct(">6I")  # page number, database size after a commit (0: none), two salts, two checksums
BYTE_ORDER = {0x377F0682: "<", 0x377F0683: ">"}  # of the words that are summed, by the magic number
UINT32_MASK = 0xFFFFFFFF
JOURNAL_DAMAGED = "its journal (-wal) is damaged: what was committed behind that place is lost"
JOURNAL_UNFINISHED = "its journal (-wal) ends in a transaction that was not finished"


class JournalTail(NamedTuple):
    """The end of a journal that sqlite does not use."""

    reason: str
    offset: int  # where it begins
    bytes: int


class Journal(NamedTuple):
    """sqlite's use of a journal."""

    used: bool  # whether it holds a commit that sqlite reads
    tail: JournalTail | None  # what sqlite leaves out although it was written


def journal_of(path: Path) -> Journal:
    """Return whether sqlite uses a journal, and the part that it ignores."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(HEADER.size)
        if not _is_header(head):
            return Journal(used=False, tail=JournalTail(JOURNAL_DAMAGED, 0, size))
        magic, _, page, _, *_ = HEADER.unpack(head)
        salts, summed = head[16:24], _summed(head[:24], BYTE_ORDER[magic])
        at = used = last = HEADER.size
        whole = True
        while (frame := file.read(FRAME.size + page))[8:16] == salts or len(frame) == FRAME.size + page:
            cut = len(frame) < FRAME.size + page
            at += len(frame)
            if frame[8:16] != salts:  # of an older journal
                whole = False
                continue
            if whole and not cut:
                summed = _summed(frame[:8] + frame[FRAME.size :], BYTE_ORDER[magic], summed)
            whole = whole and not cut and FRAME.unpack_from(frame)[4:] == summed
            last = size if cut else at
            if whole and FRAME.unpack_from(frame)[1]:  # it commits
                used = at
    reason = JOURNAL_UNFINISHED if whole else JOURNAL_DAMAGED
    return Journal(used > HEADER.size, JournalTail(reason, used, last - used) if last > used else None)


def _is_header(head: bytes) -> bool:
    if len(head) < HEADER.size:
        return False
    magic, _, page, *_, first, second = HEADER.unpack(head)
    is_power = 512 <= page <= 65536 and not page & (page - 1)
    return magic in BYTE_ORDER and is_power and _summed(head[:24], BYTE_ORDER[magic]) == (first, second)


def _summed(data: bytes, order: str, before: tuple[int, int] = (0, 0)) -> tuple[int, int]:
    """Return the running checksum after some words."""
    a, b = before
    words = np.frombuffer(data, f"{order}u4").tolist()
    for x, y in zip(words[::2], words[1::2], strict=True):
        a = (a + b + x) & UINT32_MASK
        b = (a + b + y) & UINT32_MASK
    return a, b
