"""Reading a rosbag2 sqlite3 file (.db3).

A database can contain code that sqlite runs. So only plain tables are read (no views, no computed columns), with
values of bounded size and a time limit for every step (https://sqlite.org/security.html). Files before ROS 2 Iron
have no definitions of their message types: those of common types ship with locfuse.
"""

from __future__ import annotations

import os
import re
import shutil
import sqlite3
import tempfile
import time
import tomllib
from collections.abc import Collection, Iterator
from contextlib import closing, contextmanager
from functools import cache, cached_property
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from locfuse.formats.inputs import MAX_CHUNK, MAX_DATABASE_SECONDS, MAX_MESSAGE
from locfuse.formats.whole_files import scratch_prefix
from locfuse.fusion.data import LocfuseError

from .file_bytes import FileBytes, Place
from .source import Batch, ChannelInfo, Messages, Source, by_channel, message_type

ERRORS = (sqlite3.Error, UnicodeDecodeError, ValueError, MemoryError)  # raised for a damaged database
BATCH_BYTES = 1 << 20
DAMAGED = "the database is damaged: rows may be missing"
CUT_SHORT = "the messages behind a damaged place of the database are lost"

TABLES = ("messages", "topics", "message_definitions")  # tables that are read
STEPS_PER_CHECK = 10_000  # sqlite instructions between two checks of the time limit
TOPIC = "COALESCE(CAST(topic_id AS INTEGER), -1)"  # some writers keep numbers as text
BYTES_PER_SECOND = 20e6  # checking a database is faster than this

Row = tuple[int, int, bytes | None]  # topic, time in ns, message


class TimeLimit:
    """Aborts an sqlite step that takes too long; a signal (Ctrl-C) aborts any step.

    sqlite calls `_late` every STEPS_PER_CHECK instructions. An exception in `_late` aborts the step, but its type
    is lost. So a step that was aborted before its time limit was aborted by a signal.
    """

    def __init__(self, path: Place, size: int) -> None:
        self._path = path
        self._allowed_s = MAX_DATABASE_SECONDS + size / BYTES_PER_SECOND
        self._end_s = 0.0

    def hold(self, database: sqlite3.Connection) -> None:
        """Set the time and size limits of a connection."""
        database.set_progress_handler(self._late, STEPS_PER_CHECK)
        database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_CHUNK)

    def begin(self) -> None:
        """Start the time limit of the current step again."""
        self._end_s = time.thread_time() + self._allowed_s

    def _late(self) -> bool:
        return time.thread_time() > self._end_s

    @contextmanager
    def step(self) -> Iterator[None]:
        """Context manager: limit a step. Raises LocfuseError after the limit, KeyboardInterrupt for a signal."""
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

    def rows(self, database: sqlite3.Connection, query: str, *values: int) -> list[Any]:
        """Return all rows of a query; [] if the database is damaged or has no such table."""
        try:
            with self.step():
                return database.execute(query, values).fetchall()
        except ERRORS:
            return []


class SqliteSource(Source):
    """One .db3 file."""

    def __init__(self, data: FileBytes) -> None:
        super().__init__(data)
        self._limit = TimeLimit(self.path, data.size)
        self._readable = 2**63 - 1  # last rowid before a damaged place
        where = data.where.resolve()
        self._journal = Path(f"{where}-wal")
        self._journal_is_used = False
        if self._has_journal:
            try:
                used, lost = journal_of(where)
            except OSError:
                used, lost = 1, 0  # sqlite cannot read the journal either; _connect records the loss
            if lost:
                data.lose(JOURNAL_LOST, used, lost)
            self._journal_is_used = used > 0
        try:
            with closing(self._connect()) as database, self._limit.step():
                self._refuse_computed(database)
                self._check(database)
                self.channels, self._counts = _channels(database, self._limit)
        except ERRORS as problem:
            raise LocfuseError(f"{self.path}: not a readable rosbag2 database: {problem}") from None

    @property
    def _has_journal(self) -> bool:
        return self._journal.exists() and self._journal.stat().st_size > 0

    def _refuse_computed(self, database: sqlite3.Connection) -> None:
        """Raise LocfuseError for views, virtual tables and computed columns: their rows may never end."""
        listed = "SELECT lower(name), type, sql FROM sqlite_master WHERE lower(name) IN (?, ?, ?)"
        for name, kind, sql in database.execute(listed, TABLES).fetchall():
            if kind != "table" or str(sql).upper().startswith("CREATE VIRTUAL"):
                what = kind if kind != "table" else "virtual table"
                raise LocfuseError(f"{self.path}: its {name} is a {what}; only plain tables are read")
            if any(column[-1] for column in database.execute(f"PRAGMA table_xinfo({name})")):
                words = f"its table {name} has computed columns; only stored ones are read"
                raise LocfuseError(f"{self.path}: {words}")

    def _check(self, database: sqlite3.Connection) -> None:
        """Check the database for damage, and record damage as a loss.

        A query alone would leave out rows that sqlite cannot reach, without an error.
        """
        try:
            with self._limit.step():
                verdict = str(database.execute("PRAGMA quick_check(1)").fetchone()[0])
        except ERRORS as problem:
            verdict = str(problem)
        if verdict != "ok":
            self.data.lose(DAMAGED, 0, 0)

    def _connect(self) -> sqlite3.Connection:
        """Open the database read-only, with the journal of a crashed recording if the journal can be read."""
        self.data.check_unchanged()
        where = self.data.where.resolve()
        if self._has_journal:
            # if no recorder has the file open, open it without locks: sqlite then writes no file next to the bag
            alone = not Path(f"{where}-shm").exists()
            if alone and not self._journal_is_used:  # sqlite would delete an unused journal, even read-only
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
            self.data.lose("its journal (-wal) cannot be read", 0, self._journal.stat().st_size)
        return self._open(where, "&immutable=1")

    def _open(self, where: Path, options: str) -> sqlite3.Connection:
        quoted = str(where).replace("%", "%25").replace("?", "%3f").replace("#", "%23")
        database = sqlite3.connect(f"file:{quoted}?mode=ro{options}", uri=True)
        self._limit.hold(database)
        for pragma in ("trusted_schema=OFF", "cell_size_check=ON", "mmap_size=0"):
            database.execute(f"PRAGMA {pragma}")
        return database

    @cached_property
    def time_span_ns(self) -> tuple[int, int] | None:
        """First and last time, None without messages."""
        with closing(self._connect()) as database:
            found = self._limit.rows(database, "SELECT min(timestamp), max(timestamp) FROM messages")
        try:
            return next(((int(first), int(last)) for first, last in found if first is not None), None)
        except ValueError:
            return None

    def batches(self, wanted: Collection[int]) -> Iterator[Batch]:
        """Yield the messages of the wanted topics in file order, about a megabyte at a time."""
        rows: list[Row] = []
        size = 0
        for row in self._rows(wanted):
            rows.append(row)
            size += len(row[2] or b"")
            if size >= BATCH_BYTES:
                yield _batch(rows)
                self._limit.begin()  # time that the caller spent on the batch does not count
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
                with self._limit.step():
                    for row in database.execute(query, (MAX_MESSAGE, *topics, self._readable)):
                        n, last = n + 1, row[3]
                        yield row[:3]
            except ERRORS:
                # a later pass might read beyond the damage: let all passes end at the last row of this one
                self._readable = min(self._readable, last)
                expected = sum(self._counts.get(topic, 0) for topic in topics)
                self.data.lose(CUT_SHORT, 0, 0, max(expected - n, 0) or None)


def _channels(database: sqlite3.Connection, limit: TimeLimit) -> tuple[dict[int, ChannelInfo], dict[int, int]]:
    database.text_factory = lambda text: text.decode("utf-8", "replace")
    # since ROS 2 Iron
    defined = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
    rows = limit.rows(database, defined)
    texts = {str(name): (str(language), str(text)) for name, language, text in rows if text}
    counts = dict(limit.rows(database, f"SELECT {TOPIC}, count(*) FROM messages GROUP BY 1"))
    first_messages = (
        f"SELECT {TOPIC}, CAST(data AS BLOB) FROM messages WHERE rowid IN "
        f"(SELECT min(rowid) FROM messages GROUP BY {TOPIC}) AND length(data) <= ?"
    )
    samples = {ident: data or b"" for ident, data in limit.rows(database, first_messages, MAX_SAMPLE)}
    found = {}
    topics = "SELECT CAST(id AS INTEGER), name, type, serialization_format FROM topics ORDER BY 1"
    for ident, *texts_of_topic in database.execute(topics):
        topic, msgtype, encoding = (str(text or "") for text in texts_of_topic)
        language, text = texts.get(msgtype) or (
            "ros2msg",
            definition(message_type(msgtype), samples.get(ident, b"")),
        )
        schema = (language, text.encode()) if text else ("", b"")
        found[ident] = ChannelInfo(topic, msgtype, encoding, *schema, counts.get(ident, 0))
    return found, counts


def _batch(rows: list[Row]) -> Batch:
    """Return rows as a batch in one buffer; a message without data (too large) becomes empty."""
    topic = np.array([row[0] for row in rows], np.int64)
    length = np.array([len(row[2] or b"") for row in rows], np.int64)
    time_ns = np.array([row[1] for row in rows], np.int64)
    everything = Messages(np.cumsum(length) - length, length, time_ns, np.zeros(len(rows), np.int64), time_ns)
    data = np.frombuffer(b"".join(row[2] or b"" for row in rows), np.uint8)
    return Batch(data, by_channel(topic, everything))


# --- The journal (-wal): number of bytes that sqlite uses, and number of bytes that it ignores without an error
# A recorder that crashes leaves its last messages in the journal. sqlite reads it up to the last commit before the
# first frame with a wrong checksum, without an error. Lost frames after this frame have the salts of the journal's
# header; frames of an older journal have other salts.
# Format: https://sqlite.org/fileformat2.html#walformat

HEADER_BYTES, FRAME_HEADER_BYTES = 32, 24
MAX_PAGE_BYTES = 65536
JOURNAL_LOST = "the end of its journal (-wal) is damaged or was not finished: it is lost"


def journal_of(database: Path) -> tuple[int, int]:
    """Return the number of bytes of a database's -wal journal that sqlite reads, and of lost bytes after them.

    sqlite counts its frames only while it writes, so a copy of the journal is used.
    """
    journal = Path(f"{database}-wal")
    size = journal.stat().st_size
    with tempfile.TemporaryDirectory(prefix=scratch_prefix()) as folder, database.open("rb") as file:
        copy = Path(folder) / "copy.db3"
        copy.write_bytes(file.read(MAX_PAGE_BYTES))  # sqlite needs the first page and the size only
        os.truncate(copy, database.stat().st_size)
        shutil.copyfile(journal, f"{copy}-wal")
        try:
            with closing(sqlite3.connect(copy)) as connection:
                frames = max(connection.execute("PRAGMA wal_checkpoint").fetchone()[1], 0)
        except sqlite3.Error:
            frames = 0
    if not frames:
        return 0, size
    with journal.open("rb") as file:
        head = file.read(HEADER_BYTES)
        frame = FRAME_HEADER_BYTES + int.from_bytes(head[8:12], "big")
        end = last = HEADER_BYTES + frames * frame
        for at in range(end, size, frame):
            file.seek(at + 8)
            if file.read(8) == head[16:24]:  # not a frame of an older journal
                last = min(at + frame, size)
    return end, last - end


DIVIDER = "=" * 80
NESTED_TYPE = re.compile(r"^\s*(\w+/\w+)", re.MULTILINE)  # the type of a field that is a message itself
ALIGNMENT_BYTES = 4  # a message may be padded at its end
RELEASES = ("LATEST", "ROS2_HUMBLE", "ROS2_FOXY")  # definitions of a type may differ between them
MAX_SAMPLE = 1 << 16  # bytes: definitions of types with larger messages never changed


def definition(msgtype: str, sample: bytes = b"") -> str | None:
    """Return the ros2msg text of a standard or common robot message type; None for an unknown type.

    Some types gained fields between ROS releases (sensor_msgs/Range its variance). So the newest definition is
    returned that gives the message `sample` of the bag its actual length. If no definition does, the result is the
    newest one for a standard type, and None for another type.
    """
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    known: dict[str, Any] = {}  # ros2msg text -> type store, newest first
    common = _texts(msgtype.replace("/msg/", "/"))
    for text in common:
        known[text] = get_typestore(Stores.EMPTY)
        known[text].register(get_types_from_msg(text, msgtype))
    for release in () if common else RELEASES:
        store = get_typestore(Stores[release])
        if msgtype in store.types:
            known.setdefault(str(store.generate_msgdef(msgtype, ros_version=2)[0]), store)
    newest = next(iter(known), None)
    if not sample or (not common and (len(known) < 2 or len(sample) > MAX_SAMPLE)):
        return newest
    return next((t for t, store in known.items() if _fits(store, msgtype, sample)), None if common else newest)


@cache
def _known_types() -> dict[str, list[str]]:
    table = tomllib.loads((files(__package__) / "known_types.toml").read_text(encoding="utf-8"))
    return {name: [re.sub(r",\s+", "\n", text) + "\n" for text in texts] for name, texts in table.items()}


def _texts(name: str) -> list[str]:
    """Return the ros2msg texts of a type in known_types.toml, with all types that it uses, newest first."""
    table = _known_types()  # type -> its field definitions, one field per line, newest first
    used = [name] if name in table else []
    for one in used:
        used += [other for text in table[one] for other in NESTED_TYPE.findall(text) if other not in used]
    versions = max((len(table[one]) for one in used), default=0)
    chosen = [[table[one][min(i, len(table[one]) - 1)] for one in used] for i in range(versions)]
    return [f"\n{DIVIDER}\n".join([own, *map("MSG: {}\n{}".format, used[1:], rest)]) for own, *rest in chosen]


def _fits(store: Any, msgtype: str, sample: bytes) -> bool:
    """Return whether `sample` (CDR), decoded and encoded again as `msgtype`, has the same length up to padding."""
    try:
        message = store.deserialize_cdr(sample, msgtype)
        written = len(store.serialize_cdr(message, msgtype, little_endian=sample[1:2] == b"\x01"))
    except Exception:
        return False
    return abs(len(sample) - written) < ALIGNMENT_BYTES
