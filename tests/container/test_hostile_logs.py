"""Logs built to take memory or minutes: what they cost is bounded by their size on disk."""

from __future__ import annotations

import struct
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest
from bags import drive, write
from hostile import MAGIC, START, chunk
from hostile import write as sample_write
from mcap.writer import CompressionType

from locfuse.formats.caps import FREE_RECORDS, MAX_TOPICS
from locfuse.formats.container.chunked import most_records
from locfuse.formats.container.decompress import DamagedError
from locfuse.formats.container.ros1_bag import scan_chunk
from locfuse.formats.logs.files import log_files
from locfuse.formats.logs.log import open_log
from locfuse.fusion.data import LocfuseError

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


def test_more_topics_than_any_robot_has_are_refused_by_their_cap(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert MAX_TOPICS > 1000
    monkeypatch.setattr("locfuse.formats.logs.log.MAX_TOPICS", 2)
    with pytest.raises(LocfuseError, match="too many topics: 3, more than the cap of 2"):
        open_log([write(tmp_path / "x.mcap", drive(20))])


def test_no_record_of_a_real_log_meets_a_cap(tmp_path: Path) -> None:
    """A thousand small messages that look alike are as many as a chunk of a megabyte may well hold."""
    said = [one for one in drive(2000) if one.topic == "/heading"]
    path = write(tmp_path / "x.mcap", said, compression=CompressionType.ZSTD, chunk_size=1 << 20)
    assert path.read_bytes().startswith(MAGIC)
    log = open_log([path])
    assert len(log.stream("/heading").t_ns) == len(said)
    assert not log.losses


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


@pytest.mark.parametrize(
    "text",
    [
        "rosbag2_bagfile_information:\n  relative_file_paths:\n    - b.mcap\n    - 'a.mcap'\n  duration: 1\n",
        'relative_file_paths:\r\n- b.mcap\r\n- "a.mcap"\r\n',
    ],
)
def test_a_metadata_file_names_its_files_in_order(tmp_path: Path, text: str) -> None:
    for name in ("a.mcap", "b.mcap", "c.mcap"):
        sample_write(tmp_path / name)
    (tmp_path / "metadata.yaml").write_text(text)
    assert [file.name for file in log_files(tmp_path)] == ["b.mcap", "a.mcap"]
