"""A rosbag2 sqlite3 file (.db3) as a source of message batches."""

from __future__ import annotations

import sqlite3
from collections.abc import Collection, Iterator, Mapping
from contextlib import closing
from functools import cached_property
from pathlib import Path

import numpy as np

from locfuse.fusion.data import LocfuseError

from .file_bytes import FileBytes
from .known_types import definition
from .losses import Losses
from .source import MAX_MESSAGE, Batch, ChannelInfo, Messages, message_type

ERRORS = (sqlite3.Error, UnicodeDecodeError, ValueError, MemoryError)  # of a damaged database
BATCH_BYTES = 1 << 20
DAMAGED = "the database is damaged: rows may be missing"
CUT_SHORT = "the messages behind a damaged place of the database are lost"

Row = tuple[int, int, bytes | None]  # topic, time in ns, message


class SqliteSource:
    """One .db3 file."""

    attachments: Mapping[str, bytes] = {}

    def __init__(self, data: FileBytes, losses: Losses) -> None:
        self.path = data.path
        self.losses = losses
        self._data = data
        try:
            with closing(self._connect()) as database:
                self._check(database)
                self.channels, self._counts = _channels(database)
        except ERRORS as problem:
            raise LocfuseError(f"{self.path}: not a readable rosbag2 database: {problem}") from None

    def _check(self, database: sqlite3.Connection) -> None:
        """Look for damage, which sqlite would meet in silence: rows it cannot reach are just not there."""
        try:
            verdict = str(database.execute("PRAGMA quick_check(1)").fetchone()[0])
        except ERRORS as problem:
            verdict = str(problem)
        if verdict != "ok":
            self.losses.add(str(self.path), DAMAGED, 0, 0)

    def _connect(self) -> sqlite3.Connection:
        """Open read-only; with the journal of a crashed recording where there is one and it can be read."""
        where = self._data.where.resolve()
        quoted = str(where).replace("%", "%25").replace("?", "%3f").replace("#", "%23")
        journal = Path(f"{where}-wal")
        if journal.exists() and journal.stat().st_size:
            try:
                database = sqlite3.connect(f"file:{quoted}?mode=ro", uri=True)
                database.execute("SELECT count(*) FROM sqlite_master")
            except ERRORS:
                self.losses.add(str(self.path), "its journal (-wal) cannot be read", 0, journal.stat().st_size)
            else:
                return database
        return sqlite3.connect(f"file:{quoted}?mode=ro&immutable=1", uri=True)

    @cached_property
    def time_span_ns(self) -> tuple[int, int] | None:
        """First and last time, None without messages."""
        with closing(self._connect()) as database:
            try:
                first, last = database.execute("SELECT min(timestamp), max(timestamp) FROM messages").fetchone()
                return None if first is None else (int(first), int(last))
            except ERRORS:
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
                rows, size = [], 0
        if rows:
            yield _batch(rows)

    def _rows(self, wanted: Collection[int]) -> Iterator[Row]:
        topics = sorted(wanted)
        query = (
            "SELECT topic_id, COALESCE(CAST(timestamp AS INTEGER), -1), "
            "CASE WHEN length(data) <= ? THEN CAST(data AS BLOB) END FROM messages "
            f"WHERE topic_id IN ({','.join('?' * len(topics))}) ORDER BY id"
        )
        n = 0
        with closing(self._connect()) as database:
            try:
                for row in database.execute(query, (MAX_MESSAGE, *topics)):
                    n += 1
                    yield row
            except ERRORS:
                expected = sum(self._counts.get(topic, 0) for topic in topics)
                self.losses.add(str(self.path), CUT_SHORT, 0, 0, max(expected - n, 0) or None)


def _channels(database: sqlite3.Connection) -> tuple[dict[int, ChannelInfo], dict[int, int]]:
    database.text_factory = lambda text: text.decode("utf-8", "replace")
    texts = _definitions(database)
    try:
        counts = dict(database.execute("SELECT topic_id, count(*) FROM messages GROUP BY topic_id"))
    except ERRORS:
        counts = {}
    found = {}
    for ident, *texts_of_topic in database.execute(
        "SELECT id, name, type, serialization_format FROM topics ORDER BY id"
    ):
        topic, msgtype, encoding = (str(text or "") for text in texts_of_topic)
        language, text = texts.get(msgtype) or ("ros2msg", definition(message_type(msgtype)))
        schema = (language, text.encode()) if text else ("", b"")
        found[ident] = ChannelInfo(topic, msgtype, encoding, *schema, counts.get(ident, 0))
    return found, counts


def _definitions(database: sqlite3.Connection) -> dict[str, tuple[str, str]]:
    """Return type -> (language, text) as the bag itself says, since ROS 2 Iron."""
    columns = "topic_type, encoding, encoded_message_definition"
    try:
        rows = database.execute(f"SELECT {columns} FROM message_definitions").fetchall()
    except ERRORS:
        return {}
    return {str(name): (str(language), str(text)) for name, language, text in rows if text}


def _batch(rows: list[Row]) -> Batch:
    """Lay the messages one behind the other; one that is too large comes out empty."""
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
