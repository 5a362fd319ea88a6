"""What a log is known by, and how little of it is read for that."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from pathlib import Path
from typing import Any

import pytest
from commands import ok
from mcap.writer import CompressionType, Writer

from locfuse import sample_logs
from locfuse.formats.container.file_bytes import FileBytes
from locfuse.formats.container.losses import Losses
from locfuse.formats.container.mcap_source import McapSource
from locfuse.formats.logs.files import files_of, identity_of

PICTURE = 900_000  # bytes


@pytest.fixture(scope="module")
def raw(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Uncompressed pictures in chunks of 1 MB with small messages between them: the shape of a raw-image bag."""
    path = tmp_path_factory.mktemp("raw") / "raw.mcap"
    with path.open("wb") as file:
        writer: Any = Writer(file, chunk_size=1 << 20, compression=CompressionType.NONE)
        writer.start()
        schema = writer.register_schema("a/msg/B", "ros2msg", b"uint8[] data")
        pictures, ticks = (writer.register_channel(topic, "cdr", schema) for topic in ("/raw", "/ticks"))
        for i in range(40):
            writer.add_message(pictures, 100 * i, os.urandom(PICTURE), 100 * i)
            for j in range(20):
                writer.add_message(ticks, 100 * i + j, b"\0" * 40, 100 * i + j)
        writer.finish()
    return path


def test_opening_a_log_of_raw_pictures_reads_a_hundredth_of_it(raw: Path) -> None:
    losses = Losses()
    data = FileBytes(raw, losses)
    source = McapSource(data, losses)
    assert {c.topic: c.n for c in source.channels.values()} == {"/raw": 40, "/ticks": 800}
    assert not losses
    assert data.read_bytes <= 0.01 * data.size
    assert not data.all_read


def test_bytes_that_are_read_twice_count_once(raw: Path) -> None:
    data = FileBytes(raw, Losses())
    for at in (0, 1000, 0, 500_000):
        data.read(at, 300_000)
    assert data.read_bytes == 301_000 + 300_000
    data.feed(lambda piece: None)
    for at in range(0, data.size, 1_000_000):
        data.read(at, 1_000_000)
    assert data.all_read


def test_the_window_gives_the_bytes_of_the_file_wherever_it_is_asked(raw: Path) -> None:
    data, whole = FileBytes(raw, Losses()), raw.read_bytes()
    for at, n in ((0, 9), (5000, 9), (5009, 4000), (9100, 100), (9200, 60_000), (3, 5), (len(whole) - 4, 9)):
        assert data.read(at, n) == whole[at : at + n]


def test_a_copy_has_the_identity_of_the_log_and_another_log_has_another(raw: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy.mcap"
    shutil.copy(raw, copy)
    known = identity_of(files_of([raw]))
    assert identity_of(files_of([copy])) == known
    assert known.size == raw.stat().st_size
    with copy.open("ab") as file:
        file.write(b"x")  # no end mark any more: known by its ends
    assert identity_of(files_of([copy])).digest != known.digest
    other = sample_logs.path("rounded_rectangle")
    assert identity_of(files_of([other])).digest != known.digest


def test_every_byte_is_hashed_where_all_were_read_or_the_user_asks(tmp_path: Path) -> None:
    words = ("--sensors", "odometry", "--write", "json", "--no-advice", "-q")
    log = sample_logs.path("rounded_rectangle")
    ok("compare", "rounded_rectangle", *words, "-o", tmp_path / "a", "--hash")
    source = json.loads((tmp_path / "a" / "report.json").read_text())["input"]
    assert source["sha256"] == hashlib.sha256(log.read_bytes()).hexdigest()
    assert source["identity"] == identity_of(files_of([log])).digest
    assert source["size"] == log.stat().st_size
