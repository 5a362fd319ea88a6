"""Bags, folders and pipes built to take minutes."""

from __future__ import annotations

import struct
import time
from pathlib import Path

import numpy as np
import pytest
from hostile import write

from locfuse.formats.container.decompress import DamagedError
from locfuse.formats.container.ros1_bag import scan_chunk
from locfuse.formats.logs.files import log_files
from locfuse.formats.logs.log import open_log


def cpu_seconds(path: Path) -> float:
    begin = time.process_time()
    open_log([path])
    return time.process_time() - begin


@pytest.mark.parametrize("word", [b"compression=", b"\x0f\0\0\0compression=bz2", b"\x50\0\0\0" * 5])
def test_a_bag_of_nothing_but_hints_costs_seconds_at_most(tmp_path: Path, word: bytes) -> None:
    path = tmp_path / "f.bag"
    path.write_bytes(b"#ROSBAG V2.0\n\xff\xff\xff\xff" + word * (1_000_000 // len(word)))
    assert cpu_seconds(path) < 10.0  # of CPU; it was minutes


def test_a_chunk_of_more_records_than_bytes_is_refused_by_its_cap() -> None:
    header = b"\x04\0\0\0op=\x07" + b"\x09\0\0\0conn=\0\0\0\0"
    connection = struct.pack("<I", len(header)) + header + bytes(4)
    assert len(scan_chunk(np.frombuffer(connection * 3, np.uint8), 3).connections) == 1
    many = np.frombuffer(connection * 4, np.uint8)
    with pytest.raises(DamagedError, match="more than 3 records, the cap for its size"):
        scan_chunk(many, 3)


def test_blank_lines_in_a_metadata_file_cost_nothing(tmp_path: Path) -> None:
    log = write(tmp_path / "a.mcap")
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
        write(tmp_path / name)
    (tmp_path / "metadata.yaml").write_text(text)
    assert [file.name for file in log_files(tmp_path)] == ["b.mcap", "a.mcap"]
