"""The promises, failure by failure: one clear outcome, the loss in numbers, and never half a file.

Failing sensors, lying wheels, robots that are carried off, hostile logs, bad disks and signals. Random damage:
test_benchmarks. A missing viewer: test_rerun_robust.
"""

import functools
import io
import json
import re
import signal
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from bags import T0, S, Said, cdr, drive, header, write
from commands import Done, Reported, locfuse, ok, refused, reported
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType
from msgspec.structs import replace
from present import present
from rewrite_log import rewritten
from wheel_bags import GEOMETRY, angles, joint_states, log_of
from worlds import World

from locfuse import sample_logs
from locfuse.cli.analysis.load import load
from locfuse.cli.analysis.settings import LogOptions
from locfuse.fusion.data import Array
from locfuse.fusion.fuse import fuse

PLAIN = LogOptions(quiet=True)
ROBOT = {"robot.toml": b"[wheels]\nradius = 0.05\ntrack = 0.4\n[camera]\nlandmark = [1.0, 1.0]\n"}
ROBOT["robot.toml"] += b"centre = [8.0, 8.0]\ninner = 2.0\nouter = 7.0\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("simulated")


@functools.cache
def simulated(folder: Path, fault: str = "", scenario: str = "rounded_rectangle") -> Path:
    """A drive of a minute with compass and laser, and one fault."""
    path = folder / f"{len(list(folder.iterdir()))}.mcap"
    sets = ["--set", "camera.enabled=false", *(("--set", f"faults=[{{{fault}}}]") if fault else ())]
    ok("simulate", scenario, "-o", path, *sets)
    return path


def run(path: Path, *words: str) -> tuple[Done, Array, dict[str, Any]]:
    out = path.parent / f"{path.stem}-out"
    done = locfuse("run", path, "--no-advice", "--no-smooth", "--write", "all", "-v", "-o", out, *words)
    assert done.exit_code in {0, 3}, done.stderr
    return done, trajectory(out), json.loads((out / "run.json").read_text())


def trajectory(out: Path) -> Array:
    """The rows of trajectory.csv, held to: finite, P positive, time never backward."""
    rows: Array = np.loadtxt(out / "trajectory.csv", delimiter=",", skiprows=1)
    P = rows[:, [4, 5, 6, 5, 7, 8, 6, 8, 9]].reshape(-1, 3, 3)
    assert np.isfinite(rows).all()
    assert (np.linalg.eigvalsh(P) >= -1e-12).all()
    assert (np.diff(rows[:, 0]) >= 0).all()
    return rows


@pytest.mark.parametrize(
    ("name", "start", "end"), [("drops out", 15.0, 25.0), ("starts late", -1.0, 8.0), ("ends early", 40.0, 99.0)]
)
def test_a_gap_of_a_sensor_is_as_if_masked_there(folder: Path, name: str, start: float, end: float) -> None:
    clean = simulated(folder)
    cut = rewritten(
        folder / f"{name}.mcap", source=clean, keep=lambda topic, t: topic != "/scan" or not start <= t < end
    )
    whole, gap = load([clean], PLAIN), load([cut], PLAIN)
    scans = whole.drive.measurements["lrf"]
    keep = np.flatnonzero(np.isin(scans.t.round(6), gap.drive.measurements["lrf"].t.round(6)))
    assert len(scans.t) - len(keep) > 70
    masked = replace(
        whole.drive,
        measurements={**whole.drive.measurements, "lrf": scans.take(keep)},
        instant={**whole.drive.instant, "lrf": whole.drive.instant["lrf"][keep]},
    )
    a, b = fuse(gap.drive, gap.robot, ["lrf"]), fuse(masked, gap.robot, ["lrf"])
    np.testing.assert_allclose(a.pose, b.pose[np.isin(b.t, a.t)], atol=1e-6)
    silent = (a.t > start + 0.2) & (a.t < end)
    assert (np.diff(a.P[silent, 2, 2]) >= 0.0).all()  # nothing is seen: P grows
    if name == "drops out":
        assert re.search("lrf: a gap of 10.1 s", locfuse("info", cut).stdout)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_nan_or_inf_anywhere_is_skipped_and_counted(folder: Path, value: float) -> None:
    t, angle = angles(10.0)
    said = list(joint_states(t, angle))
    bad = np.full(2, value)
    for i, ns in enumerate(range(T0, T0 + 10 * 10**9, 2 * 10**8)):
        odd = i % 5 == 2
        v = value if odd else 0.02 * i  # of the heading, the truth's x and some ranges
        ranges = np.linspace(1.0, 2.0, 90)
        ranges[10:20] = v
        said += [
            *[Said("/joint_states", "sensor_msgs/msg/JointState", joint(ns + 10**6, bad), ns + 10**6)][: int(odd)],
            Said(
                "/scan",
                "sensor_msgs/msg/LaserScan",
                cdr(
                    "sensor_msgs/msg/LaserScan",
                    header=header(ns, "laser"),
                    angle_min=-1.5,
                    angle_increment=v if i == 12 else 0.03,
                    range_max=30.0,
                    ranges=ranges.astype(np.float32),
                ),
                ns,
            ),
            Said("/heading", "std_msgs/msg/Float64", cdr("std_msgs/msg/Float64", data=v), ns),
            Said(
                "/ground_truth",
                "geometry_msgs/msg/PoseStamped",
                cdr(
                    "geometry_msgs/msg/PoseStamped",
                    header=header(ns),
                    pose={"position": {"x": v}, "orientation": {"w": 1.0}},
                ),
                ns,
            ),
        ]
    path = log_of(folder / "nan.mcap", said)
    with np.errstate(all="ignore"):  # as the program does for its user
        _, _, report = run(path, *GEOMETRY)
    dropped = report["input"]["dropped"]
    for stream in ("wheels", "compass", "truth"):
        assert sum(dropped.get(stream, {}).values()) >= 5, (stream, dropped)


def joint(ns: int, position: Array) -> bytes:
    names = ["left_wheel", "right_wheel"]
    return cdr("sensor_msgs/msg/JointState", header=header(ns), name=names, position=position)


@pytest.fixture(scope="module")
def disturbed() -> Reported:
    return reported("compare", "disturbed", "--no-advice", "--write", "json,html")


def test_disturbances_are_gated_and_shown_and_the_compass_is_at_most_a_tenth_worse(disturbed: Reported) -> None:
    found = disturbed.rows
    assert found["compass"]["position_rmse_m"] <= 1.1 * found["odometry"]["position_rmse_m"]
    assert found["all"]["sensors"]["compass"]["rejected"] > 50
    found = disturbed.rows
    assert found["all"]["position_rmse_m"] < 0.02
    assert found["lrf"]["sensors"]["lrf"]["rejected"] > 0  # people
    camera = found["camera"]["sensors"]["camera"]
    assert camera["rejected"] > 10  # the wrong one
    assert camera["absent"] > 0  # the hidden one
    page = (disturbed.out / "report.html").read_text()
    for count in (found["lrf"]["sensors"]["lrf"]["rejected"], camera["rejected"]):
        assert str(count) in page


def test_one_corridor_corrects_only_the_observable_directions() -> None:
    """Between parallel walls along x nothing says how far along the robot is: P_xx must keep growing."""
    corridor = ((-50, 0, 50, 0), (50, 2, -50, 2))
    world = World(seconds=15, turning=0.0, start=(0.0, 1.0, 0.0), walls=corridor, mount=(0.0, 0.0, 0.0))
    drive, robot = world.measured()
    alone, lrf = fuse(drive, robot, []), fuse(drive, robot, ["lrf"])
    assert lrf.P[-1, 0, 0] == pytest.approx(alone.P[-1, 0, 0], rel=0.05)
    assert lrf.P[-1, 1, 1] < 0.01 * alone.P[-1, 1, 1]


def test_a_driver_that_stamps_whole_seconds_gives_many_readings_one_instant_and_no_traceback(folder: Path) -> None:
    log = rewritten(
        folder / "seconds.mcap",
        source=simulated(folder),
        data=lambda topic, old: old[:8] + bytes(4) + old[12:] if topic == "/compass" else old,
    )
    run(log, "--sensors", "all")
    done = locfuse("compare", log, "--no-advice", "--write", "json", "-o", folder / "seconds")
    assert done.exit_code in {0, 3}, done.stderr


def test_a_lost_chunk_leaves_seconds_without_wheels_and_no_estimate_that_is_sure_and_wrong(tmp_path: Path) -> None:
    content = bytearray((Path(str(sample_logs.__path__[0])) / "rounded_rectangle.mcap").read_bytes())
    content[len(content) // 2] ^= 4
    (tmp_path / "flipped.mcap").write_bytes(content)
    done = reported("compare", tmp_path / "flipped.mcap", "--no-advice", code=3)
    assert sum(reason["messages"] for reason in done.report["input"]["losses"].values()) > 10
    assert re.search(r"wheels: a gap of \d\.\d s \(23\.\d-31\.\d s\)", json.dumps(done.report))
    for name, values in done.rows.items():
        assert values["anees"] < 3.0, name
        assert values["final_position_error_m"] < 0.01 or "lrf" not in values["sensors"]
    # of many logs none is examined by fusing; this one gives no verdict to their mean either
    assert [(v["code"], v["void"]) for v in done.report["validity"]] == [("hole", False)]
    assert done.report["credit"] is None
    assert {v["verdict"] for v in done.report["verdicts"].values()} == {"no verdict"}


def test_info_says_that_without_checksums_a_corrupted_value_cannot_be_seen(tmp_path: Path) -> None:
    log = write(tmp_path / "x.mcap", drive(100), enable_crcs=False)
    assert "no checksums: a corrupted value would go unnoticed" in locfuse("info", log).stdout


# --- the promise about bad disks and signals: one line, and never half a file under a final name

ONCE = "import sys; from locfuse.cli.main import main; print('ready', flush=True); main(sys.argv[1:])"
# RLIMIT_FSIZE stands for a full disk: no file may grow beyond 2000 bytes
FULL = """
import resource, signal
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))
"""
FULL += ONCE
# stops where it is told, says so, and waits for the signal: no clock decides where the program is hit
HELD = """
import importlib, sys, time
module, name = sys.argv.pop(1).split(':')
def held(*_, **__):
    print('held', flush=True)
    time.sleep(60)
setattr(importlib.import_module(module), name, held)
from locfuse.cli.main import main
main(sys.argv[1:])
"""


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("log") / "x.mcap", drive(100), attachments=ROBOT)


def start(program: str, *words: object) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", program, *(str(w) for w in words)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def one_line(stderr: str) -> bool:
    return stderr.startswith("locfuse: ") and stderr.count("\n") == 1


@pytest.mark.parametrize("command", ["run", "compare"])
@pytest.mark.parametrize("out", ["/proc/nothing/out", "{file}/out", "/dev/full"])
def test_an_unwritable_output_folder_is_one_line(log: Path, tmp_path: Path, command: str, out: str) -> None:
    """Root may write to a read-only folder; nobody may in /proc or below a file."""
    (tmp_path / "file").write_text("mine")
    refusal = refused(command, log, "-o", out.format(file=tmp_path / "file"))
    assert one_line(refusal)
    assert (tmp_path / "file").read_text() == "mine"


def test_disk_full_is_one_line_leaves_nothing_and_keeps_the_result_of_before(log: Path, tmp_path: Path) -> None:
    ok("run", log, "--no-advice", "-o", tmp_path / "old")
    before = {p.name: p.read_bytes() for p in (tmp_path / "old").iterdir()}
    for out in ("old", "new"):
        with start(FULL, "run", log, "--no-advice", "-o", tmp_path / out) as process:
            _, stderr = process.communicate(timeout=300)
        assert process.returncode == 1
        assert one_line(stderr), stderr
    assert {p.name: p.read_bytes() for p in (tmp_path / "old").iterdir()} == before
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("where", ["locfuse.fusion.fuse:fuse", "os:fsync"], ids=["fusing", "writing"])
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_ctrl_c_and_sigterm_end_with_their_code_one_line_and_no_half_file(
    log: Path, tmp_path: Path, number: signal.Signals, code: int, where: str
) -> None:
    with start(HELD, where, "run", log, "--no-advice", "-o", tmp_path / "out") as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        process.send_signal(number)
        _, stderr = process.communicate(timeout=300)
    assert process.returncode == code
    assert [line for line in stderr.splitlines() if line] == stderr.splitlines()[-1:], stderr
    assert "nothing was left half-written" in stderr
    assert not (tmp_path / "out").exists()


# --- logs built to take memory: refused at their caps

WHEELS, SCAN = "sensor_msgs/msg/JointState", "sensor_msgs/msg/LaserScan"
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


def lost_in_400_mb(path: Path) -> str:
    """What a run says that loses something."""
    words = ("--no-smooth", "--no-advice", "--write", "all", "-o", path.parent / "out")
    with start(LIMITED, "run", path, *words) as process:
        _, stderr = process.communicate(timeout=300)
    assert process.returncode == 3, stderr[-1500:]
    assert re.search(r"^lost: .*\d+", stderr, re.MULTILINE)
    return stderr


@pytest.mark.parametrize(
    ("said", "words"), [(1 << 30, "claims more than 256 MiB"), (50_000, "size is not the declared one")]
)
def test_decompression_bomb_is_refused_at_its_cap(tmp_path: Path, said: int, words: str) -> None:
    """A gigabyte of zeros in some kilobytes of zstd, which says so or lies."""
    path = write(tmp_path / "x.mcap", drive(100), attachments=ROBOT, chunk_size=4000)
    content = path.read_bytes()
    packer = zstandard.ZstdCompressor(level=1).compressobj()
    bomb = b"".join(packer.compress(bytes(1 << 20)) for _ in range(1024)) + packer.flush()
    head = struct.pack("<QQQII4sQ", T0, T0, said, 0, 4, b"zstd", len(bomb))
    with path.open("rb") as file:
        at = present(make_reader(file).get_summary()).chunk_indexes[1].chunk_start_offset
    record = struct.pack("<BQ", 6, len(head) + len(bomb)) + head + bomb
    path.write_bytes(content[:at] + record + content[at:])
    assert words in lost_in_400_mb(path)
    assert trajectory(tmp_path / "out")[-1, 0] == pytest.approx(T0 / S + 99 / 20)


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
    how: dict[str, Any] = {"compression": CompressionType.ZSTD, "chunk_size": 1 << 22}
    path = write(tmp_path / "x.mcap", said, attachments=ROBOT, **how)
    assert path.stat().st_size < 2_000_000
    stderr = lost_in_400_mb(path)
    assert "12 too many beams" in stderr
    assert "30 a text longer than 4 MiB" in stderr
    trajectory(tmp_path / "out")


def test_no_chunk_of_a_sample_log_is_without_checksum() -> None:
    for name in sample_logs.names():
        records = StreamReader(io.BytesIO(sample_logs.path(name).read_bytes()), emit_chunks=True).records
        assert all(r.uncompressed_crc for r in records if isinstance(r, Chunk))
