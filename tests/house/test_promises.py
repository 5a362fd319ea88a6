"""The promise about damaged and hostile logs, failure by failure: one clear outcome, the loss in numbers.

Bad data: test_promises_data. Bad disks and signals: test_promises_disk. A missing viewer: test_rerun_robust.
"""

from __future__ import annotations

import io
import json
import re
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from bags import T0, S, Said, cdr, drive, header, write
from commands import Done, locfuse
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType

from locfuse import sample_logs

ROBOT = {"robot.toml": b"[wheels]\nradius = 0.05\ntrack = 0.4\n[camera]\nlandmark = [1.0, 1.0]\n"}
ROBOT["robot.toml"] += b"centre = [8.0, 8.0]\ninner = 2.0\nouter = 7.0\n"
CAUSAL = ("--no-smooth", "--no-advice", "--write", "all")
WHEELS, SCAN = "sensor_msgs/msg/JointState", "sensor_msgs/msg/LaserScan"


def log(path: Path, said: Any = None, **options: Any) -> Path:
    return write(path, drive(100) if said is None else said, attachments=ROBOT, **{"chunk_size": 4000, **options})


def run(path: Path, *words: str) -> Done:
    """Run and hold what every outcome has in common."""
    done = locfuse("run", path, "-o", path.parent / "out", "--overwrite", "-v", *CAUSAL, *words)
    assert "Traceback" not in done.stderr
    if done.exit_code == 1:
        assert re.fullmatch(r"locfuse: [^\n]+\n", done.stderr)
    if done.exit_code == 3:
        assert re.search(r"^lost: .*\d+", done.stderr, re.MULTILINE)
    return done


def trajectory(path: Path) -> np.ndarray[Any, np.dtype[np.float64]]:
    rows = np.loadtxt(path.parent / "out" / "trajectory.csv", delimiter=",", skiprows=1)
    P = rows[:, [4, 5, 6, 5, 7, 8, 6, 8, 9]].reshape(-1, 3, 3)
    assert np.isfinite(rows).all()
    assert (np.linalg.eigvalsh(P) >= -1e-12).all()
    return rows


def report(path: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((path.parent / "out" / "run.json").read_text())
    return found


def chunks(content: bytes | bytearray) -> list[tuple[int, int]]:
    """Where the chunks of a healthy file begin and end."""
    found, at = [], 8
    while at < len(content) - 8:
        stop = at + 9 + struct.unpack_from("<Q", content, at + 1)[0]
        if content[at] == 6:
            found.append((at, stop))
        at = stop
    return found


def test_a_bit_flipped_without_checksums_stays_finite_and_info_says_that_it_cannot_be_seen(tmp_path: Path) -> None:
    content = log(tmp_path / "whole.mcap", enable_crcs=False).read_bytes()
    payloads = [content.index(m.data) for m in drive(100)[::20]]
    for at in payloads:
        bad = bytearray(content)
        bad[at + 40] ^= 64
        (tmp_path / "bad.mcap").write_bytes(bad)
        if run(tmp_path / "bad.mcap").exit_code in {0, 3}:
            trajectory(tmp_path / "bad.mcap")
    words = "no checksums: a corrupted value would go unnoticed"
    assert words in locfuse("info", tmp_path / "whole.mcap").stdout


def test_a_lost_chunk_leaves_seconds_without_wheels_and_no_estimate_that_is_sure_and_wrong(tmp_path: Path) -> None:
    content = bytearray((Path(str(sample_logs.__path__[0])) / "rounded_rectangle.mcap").read_bytes())
    content[len(content) // 2] ^= 4
    (tmp_path / "flipped.mcap").write_bytes(content)
    done = locfuse("compare", tmp_path / "flipped.mcap", "--no-advice", "--write", "json", "-o", tmp_path / "out")
    assert done.exit_code == 3
    written = (tmp_path / "out" / "report.json").read_text()
    assert sum(reason["messages"] for reason in json.loads(written)["input"]["losses"].values()) > 10
    assert re.search(r"wheels: a gap of \d\.\d s \(23\.\d-31\.\d s\)", written)
    for name, values in json.loads(written)["configurations"].items():
        assert values["anees"] < 3.0, name
        assert values["final_position_error_m"] < 0.01 or "lrf" not in values["sensors"]


LIMITED = """
import resource, sys
import cv2, rosbags.typesys, zstandard
import locfuse.cli.analysis.load, locfuse.cli.commands.run, locfuse.cli.analysis.results
import locfuse.fusion.judge.evaluate
from locfuse.cli.main import main
size = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize() + (400 << 20)
resource.setrlimit(resource.RLIMIT_AS, (size, size))
main(sys.argv[1:])
"""


def run_in_400_mb(path: Path, *words: str) -> Done:
    command: list[Any] = [sys.executable, "-c", LIMITED, "run", path, "-o", path.parent / "out", *CAUSAL, *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert "Traceback" not in done.stderr, done.stderr[-1500:]
    return Done(done.returncode, done.stdout, done.stderr)


@pytest.mark.parametrize(
    ("said", "words"), [(1 << 30, "claims more than 256 MiB"), (50_000, "size is not the declared one")]
)
def test_decompression_bomb_is_refused_at_its_cap(tmp_path: Path, said: int, words: str) -> None:
    """A gigabyte of zeros in some kilobytes of zstd, which says so or lies."""
    content = log(tmp_path / "x.mcap", compression=CompressionType.ZSTD).read_bytes()
    packer = zstandard.ZstdCompressor(level=1).compressobj()
    bomb = b"".join(packer.compress(bytes(1 << 20)) for _ in range(1024)) + packer.flush()
    head = struct.pack("<QQQII4sQ", T0, T0, said, 0, 4, b"zstd", len(bomb))
    start, _ = chunks(content)[1]
    record = struct.pack("<BQ", 6, len(head) + len(bomb)) + head + bomb
    (tmp_path / "x.mcap").write_bytes(content[:start] + record + content[start:])
    done = run_in_400_mb(tmp_path / "x.mcap")
    assert done.exit_code == 3, done.stderr
    assert words in done.stderr
    assert trajectory(tmp_path / "x.mcap")[-1, 0] == pytest.approx(T0 / S + 99 / 20)


def test_10_to_the_6_beam_scans_and_a_huge_string_are_refused_at_their_caps(tmp_path: Path) -> None:
    scan: dict[str, Any] = {
        "angle_min": -1.5,
        "angle_increment": 3e-6,
        "range_max": 30.0,
        "ranges": np.full(10**6, 2.0),
    }
    said = drive(100)
    for i in range(12):
        t = T0 + i * S // 5 + 1
        said.append(Said("/scan", SCAN, cdr(SCAN, header=header(t, "laser"), **scan), t, 1000 + i))
    for i in range(30):
        t = T0 + i * S // 20 + 2
        name = ["left", "right", "x" * (8 << 20)]
        long = cdr(WHEELS, header=header(t), name=name, position=[0.0, 0.0, 0.0])
        said.append(Said("/joint_states", WHEELS, long, t, 1000 + i))
    path = log(tmp_path / "x.mcap", said, compression=CompressionType.ZSTD, chunk_size=1 << 22)
    assert path.stat().st_size < 2_000_000
    done = run_in_400_mb(path)
    assert done.exit_code == 3, done.stderr
    assert "12 too many beams" in done.stderr
    assert "30 a text longer than 4 MiB" in done.stderr
    trajectory(path)


def test_no_chunk_of_a_sample_log_is_without_checksum() -> None:
    for name in sample_logs.names():
        records = StreamReader(io.BytesIO(sample_logs.path(name).read_bytes()), emit_chunks=True).records
        assert all(r.uncompressed_crc for r in records if isinstance(r, Chunk))
