"""Databases of strangers: no silent loss from a journal, no view without end, no value that fills the memory."""

import random
import signal
import sqlite3
import struct
import subprocess
import sys
import textwrap
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import drive, write
from commands import locfuse, ok, refused
from hostile import START, chunk, crashed_recording, sample, write as sample_write

from locfuse.formats.container import rosbag2_sqlite
from locfuse.formats.container.decompress import DamagedError
from locfuse.formats.container.ros1_bag import scan_chunk
from locfuse.formats.container.rosbag2_sqlite import HEADER_BYTES, TimeLimit, journal_of
from locfuse.formats.container.source import most_records
from locfuse.formats.inputs import FREE_RECORDS, MAX_TOPICS
from locfuse.formats.logs.files import log_files
from locfuse.formats.logs.log import open_log
from locfuse.fusion.data import LocfuseError

PAGE = 4096
FRAME = PAGE + 24
TOPICS = (
    "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);"
    "INSERT INTO topics VALUES(1, '/a', 'std_msgs/msg/String', 'cdr');"
)
MESSAGES = "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);"
ENDLESS = "WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c)"


def database(path: Path, script: str) -> Path:
    with closing(sqlite3.connect(path)) as made:
        made.executescript(script)
        made.commit()
    return path


@pytest.fixture(scope="module")
def crashed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return crashed_recording(tmp_path_factory.mktemp("crash"))


@pytest.fixture
def recording(crashed: Path, tmp_path: Path) -> Path:
    for ending in ("", "-wal"):
        (tmp_path / f"bag.db3{ending}").write_bytes(Path(f"{crashed}{ending}").read_bytes())
    return tmp_path / "bag.db3"


def messages_by_sqlite(path: Path) -> int:
    with closing(sqlite3.connect(path)) as read:
        return int(read.execute("SELECT count(*) FROM messages").fetchone()[0])


def count(path: Path) -> tuple[int, list[str]]:
    log = open_log([path])
    return sum(topic.count for topic in log.topics.values()), log.losses.lines()


def test_the_journal_of_a_crash_is_read_whole_and_nothing_appears_beside_the_bag(recording: Path) -> None:
    assert count(recording) == (600, [])
    assert sorted(p.name for p in recording.parent.iterdir()) == ["bag.db3", "bag.db3-wal"]
    ok("info", recording)


def test_no_damage_of_a_journal_loses_messages_in_silence(recording: Path) -> None:
    """Whatever is cut off, flipped or overwritten: either all is there, or a loss is told."""
    wal = Path(f"{recording}-wal")
    whole = wal.read_bytes()
    rng = random.Random(1)
    for trial in range(60):
        data = bytearray(whole)
        at = rng.randrange(len(data))
        if trial % 3 == 0:
            del data[at:]
        elif trial % 3 == 1:
            data[at] ^= 1 << rng.randrange(8)
        else:
            data[at : at + 64] = rng.randbytes(len(data[at : at + 64]))
        wal.write_bytes(data)
        try:
            n, losses = count(recording)
        finally:
            assert wal.read_bytes() == data
        if at % FRAME == HEADER_BYTES and trial % 3 == 0:
            continue  # cut between two frames: nobody can see what is missing
        assert n == 600 or losses, (trial, at)


@pytest.mark.parametrize("at", [0, 5, 18, 25, HEADER_BYTES + 9, HEADER_BYTES + 100])
def test_a_journal_that_sqlite_takes_for_empty_stays_as_it_is(recording: Path, at: int) -> None:
    """sqlite, closing a database, deletes a journal without one good frame, even where it may only read."""
    wal = Path(f"{recording}-wal")
    data = bytearray(wal.read_bytes())
    data[at] ^= 1
    wal.write_bytes(data)
    assert journal_of(recording) == (0, len(data))
    assert locfuse("info", recording).exit_code in {1, 3}
    assert wal.read_bytes() == data
    assert sorted(p.name for p in recording.parent.iterdir()) == ["bag.db3", "bag.db3-wal"]


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_the_end_that_is_used_is_the_one_that_sqlite_uses(recording: Path, share: float) -> None:
    """sqlite reads as many messages from a damaged journal as from one that ends where we say it stops."""
    wal = Path(f"{recording}-wal")
    data = bytearray(wal.read_bytes())
    data[HEADER_BYTES + int(share * len(data) / FRAME) * FRAME + 100] ^= 4
    wal.write_bytes(data)
    used, lost = journal_of(recording)
    assert lost > 0
    cut = recording.with_name("cut.db3")
    cut.write_bytes(recording.read_bytes())
    Path(f"{cut}-wal").write_bytes(data[:used])
    assert journal_of(cut) == (used, 0)
    assert 0 < messages_by_sqlite(recording) == messages_by_sqlite(cut) < 600


def test_frames_of_an_older_journal_are_no_loss(tmp_path: Path) -> None:
    live = tmp_path / "a.db3"
    with closing(sqlite3.connect(live)) as writer:
        writer.execute("PRAGMA journal_mode=wal")
        writer.executescript(TOPICS + MESSAGES)
        row = (1, 10**18, bytes(3000))
        writer.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES(?, ?, ?)", [row] * 50)
        writer.commit()
        writer.execute("PRAGMA wal_checkpoint(RESTART)")
        writer.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES(?, ?, ?)", row)
        writer.commit()
        for ending in ("", "-wal"):
            (tmp_path / f"b.db3{ending}").write_bytes(Path(f"{live}{ending}").read_bytes())
    assert journal_of(tmp_path / "b.db3")[1] == 0
    assert count(tmp_path / "b.db3") == (51, [])


ENDLESS_VIEW = (
    f"CREATE VIEW messages AS {ENDLESS} SELECT x AS id, 1 AS topic_id, x AS timestamp, x'00' AS data FROM c;"
)
GIANT_VIEW = (
    "CREATE VIEW topics AS SELECT 1 AS id, CAST(zeroblob(900000000) AS TEXT) AS name, 'x' AS type, "
    "'cdr' AS serialization_format;"
)
COMPUTED = MESSAGES.replace("data BLOB", "data BLOB AS (zeroblob(60000000))")
VIRTUAL = "CREATE VIRTUAL TABLE messages USING fts5(id, topic_id, timestamp, data);"


@pytest.mark.parametrize(
    ("script", "words"),
    [
        (TOPICS + ENDLESS_VIEW, "its messages is a view"),
        (MESSAGES + GIANT_VIEW, "its topics is a view"),
        (TOPICS + COMPUTED, "computed columns"),
        (TOPICS + VIRTUAL, "is a virtual table"),
    ],
)
def test_what_a_database_computes_is_not_read(tmp_path: Path, script: str, words: str) -> None:
    assert words in refused("info", database(tmp_path / "f.db3", script))


def endless(path: Path) -> Iterator[tuple[TimeLimit, sqlite3.Connection]]:
    limit = TimeLimit(path, 0)
    with closing(sqlite3.connect(":memory:")) as made:
        limit.hold(made)
        yield limit, made


def test_a_query_without_end_meets_its_deadline(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rosbag2_sqlite, "MAX_DATABASE_SECONDS", 0.05)
    for limit, made in endless(tmp_path):
        with pytest.raises(LocfuseError, match="busy for more than the cap of"), limit.step():
            made.execute(f"{ENDLESS} SELECT count(*) FROM c").fetchall()


def test_a_signal_ends_a_query_without_end(tmp_path: Path) -> None:
    before = signal.signal(signal.SIGALRM, signal.default_int_handler)
    try:
        for limit, made in endless(tmp_path):
            signal.setitimer(signal.ITIMER_REAL, 0.1)
            with pytest.raises(KeyboardInterrupt), limit.step():
                made.execute(f"{ENDLESS} SELECT count(*) FROM c").fetchall()
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def copied(recording: Path, script: str) -> Path:
    """The recording with its tables rewritten by a script."""
    with closing(sqlite3.connect(recording)) as changed:
        changed.execute("PRAGMA journal_mode=delete")
        changed.executescript(script)
        changed.commit()
    return recording


@pytest.mark.parametrize(
    "table",
    [
        "CREATE TABLE m AS SELECT topic_id, timestamp, data FROM messages;",  # without ids, read by its rows
        "CREATE TABLE m(id TEXT, topic_id TEXT, timestamp TEXT, data BLOB);"
        "INSERT INTO m SELECT id, topic_id, timestamp, data FROM messages;",
    ],
    ids=["without ids", "ids that are text"],
)
def test_tables_without_numbers_as_ids_are_read(recording: Path, table: str) -> None:
    copied(recording, f"{table} DROP TABLE messages; ALTER TABLE m RENAME TO messages")
    log = open_log([recording])
    assert len(log.stream("/joint_states").t_ns) == log.topics["/joint_states"].count > 0


def test_where_all_messages_are_lost_the_file_is_named_and_not_the_wheels(recording: Path) -> None:
    copied(recording, "ALTER TABLE messages RENAME COLUMN data TO payload")
    robot = recording.parent / "robot.toml"
    robot.write_bytes(sample()[1])
    refusal = refused("run", recording, "-o", recording.parent / "o", "--robot", robot)
    assert "messages on /joint_states can be read" in refusal
    assert "damaged place of the database" in refusal


class DamagedForTwo:
    """A database whose rows from the 15th on are damaged for whoever asks for two topics at once."""

    def __init__(self, real: sqlite3.Connection) -> None:
        self._real = real

    def __getattr__(self, name: str) -> Any:
        return getattr(self._real, name)

    def execute(self, query: str, values: tuple[Any, ...] = ()) -> Any:
        rows = self._real.execute(query, values)
        return self._damaged(rows) if "rowid FROM messages" in query and len(values) == 4 else rows

    def _damaged(self, rows: Iterator[Any]) -> Iterator[Any]:
        for row in rows:
            if row[3] > 14:
                raise sqlite3.DatabaseError("database disk image is malformed")
            yield row


def test_where_a_walk_met_damage_no_later_one_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    topics = "".join(f"INSERT INTO topics VALUES({k}, '/{k}', 'std_msgs/msg/Float64', 'cdr');" for k in (2, 3))
    rows = "".join(
        f"INSERT INTO messages VALUES({i}, {2 + i % 2}, {1_700_000_000_000_000_000 + i}, x'00010000{i:016x}');"
        for i in range(1, 21)
    )
    path = database(tmp_path / "bag.db3", TOPICS + topics + MESSAGES + rows)
    connect = rosbag2_sqlite.SqliteSource._connect
    monkeypatch.setattr(rosbag2_sqlite.SqliteSource, "_connect", lambda self: DamagedForTwo(connect(self)))
    log = open_log([path])
    both = log.read({"/2": ("data",), "/3": ("data",)})
    assert [len(both[t].columns["data"]) for t in ("/2", "/3")] == [7, 7]
    assert sum(len(raw.messages.start) for raw in log.raw("/2", ("data",))) == 7  # 10 without the damage
    assert [len(columns["data"]) for _, columns in log.stream("/3").blocks("data")] == [7]
    assert any("damaged place of the database are lost (6 messages)" in line for line in log.losses.lines())


# --- logs built to take minutes or gigabytes

EMPTY_SCHEMA = struct.pack("<BQ", 3, 0)
EMPTY_MESSAGE = struct.pack("<BQHIQQ", 5, 22, 1, 0, 1, 1)
LIMITED = """
    import resource, sys, time
    from pathlib import Path
    from locfuse.formats.logs.log import open_log
    resource.setrlimit(resource.RLIMIT_AS, (1 << 30, 1 << 30))
    resource.setrlimit(resource.RLIMIT_CPU, (20, 20))
    log = open_log([Path(sys.argv[1])])
    for name in log.topics:
        print(name, len(log.stream(name).t_ns))
    print(log.losses.lines())
"""


def limited(path: Path) -> str:
    """What a log says within a gigabyte and twenty seconds of CPU."""
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(LIMITED), str(path)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-300:]
    return done.stdout


@pytest.mark.parametrize("record", [EMPTY_SCHEMA, EMPTY_MESSAGE])
def test_a_chunk_of_millions_of_empty_records_is_refused_by_its_cap(tmp_path: Path, record: bytes) -> None:
    path = tmp_path / "f.mcap"
    bomb = chunk(record * (200 * 2**20 // len(record)))
    path.write_bytes(START + bomb * 3)
    words = limited(path)
    assert "records, the cap for its size" in words
    assert "3 places" in words


def test_the_cap_of_records_counts_what_the_file_holds(tmp_path: Path) -> None:
    """As many records are refused that were compressed to nothing, and read where each took its bytes."""
    many = 2 * FREE_RECORDS
    path = tmp_path / "f.mcap"
    path.write_bytes(START + chunk(EMPTY_MESSAGE * many) + chunk(EMPTY_MESSAGE * many, ""))
    found = open_log([path]).losses.by_reason()
    assert found["messages of an undefined channel"]["messages"] == many
    packed = len(chunk(EMPTY_MESSAGE * many)) - 9 - 24 - 4 - 4 - len("zstd") - 8
    assert f"a chunk unpacks to more than {most_records(packed)} records, the cap for its size" in found


def test_thousands_of_empty_records_are_read_however_small_their_chunk_is(tmp_path: Path) -> None:
    path = tmp_path / "f.mcap"
    path.write_bytes(START + chunk(EMPTY_MESSAGE * 4000))
    assert len(chunk(EMPTY_MESSAGE * 4000)) < 1000
    found = open_log([path]).losses.by_reason()
    assert found["messages of an undefined channel"]["messages"] == 4000
    assert not any("unpacks to more" in reason for reason in found)


def holes(n: int) -> bytes:
    """Empty chunks with a bad byte behind each."""
    return START + (struct.pack("<BQQQQIIQ", 6, 40, 0, 0, 0, 0, 0, 0) + b"\0") * n


def seconds(path: Path) -> float:
    begin = time.process_time()
    open_log([path])
    return time.process_time() - begin


def test_a_file_of_many_holes_costs_what_its_size_is(tmp_path: Path) -> None:
    """Twice as many holes take about twice as long: four times was what a search from each of them took."""
    path = tmp_path / "f.mcap"
    took = []
    for n in (2500, 20_000):
        path.write_bytes(holes(n))
        took.append(min(seconds(path) for _ in range(2)))
    assert took[1] < 16 * took[0]


def test_more_topics_than_any_robot_has_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert MAX_TOPICS > 1000
    monkeypatch.setattr("locfuse.formats.logs.log.MAX_TOPICS", 2)
    with pytest.raises(LocfuseError, match="too many topics: 3, more than the cap of 2"):
        open_log([write(tmp_path / "x.mcap", drive(20))])


# --- bags, folders and pipes built to take minutes


@pytest.mark.parametrize("word", [b"compression=", b"\x0f\0\0\0compression=bz2", b"\x50\0\0\0" * 5])
def test_a_bag_of_nothing_but_hints_costs_seconds_at_most(tmp_path: Path, word: bytes) -> None:
    path = tmp_path / "f.bag"
    path.write_bytes(b"#ROSBAG V2.0\n\xff\xff\xff\xff" + word * (1_000_000 // len(word)))
    assert seconds(path) < 10.0  # of CPU; it was minutes


def test_a_chunk_of_more_records_than_bytes_is_refused_by_its_cap() -> None:
    header = b"\x04\0\0\0op=\x07" + b"\x09\0\0\0conn=\0\0\0\0"
    connection = struct.pack("<I", len(header)) + header + bytes(4)
    assert len(scan_chunk(np.frombuffer(connection * 3, np.uint8), 3).definitions) == 1
    many = np.frombuffer(connection * 4, np.uint8)
    with pytest.raises(DamagedError, match="more than 3 records, the cap for its size"):
        scan_chunk(many, 3)


def test_blank_lines_in_a_metadata_file_cost_nothing(tmp_path: Path) -> None:
    log = sample_write(tmp_path / "a.mcap")
    (tmp_path / "metadata.yaml").write_text("\n" * 1_000_000 + "x")
    begin = time.process_time()
    assert log_files(tmp_path) == [log]
    assert time.process_time() - begin < 2.0  # of CPU
