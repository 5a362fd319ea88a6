"""The promise about bad disks and signals: one line, and never half a file under a final name."""

from __future__ import annotations

import json
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from bags import drive, write
from commands import locfuse, ok

ROBOT = {"robot.toml": b"[wheels]\nradius = 0.05\ntrack = 0.4\n"}
FINAL = (
    "robot.toml",
    "trajectory.tum",
    "trajectory.csv",
    "estimates.mcap",
    "estimates.foxglove.json",
    "estimates.plotjuggler.xml",
    "run.json",
)
# the .mcap is the one file that is not made in memory
EXPORT = ("--export", "mcap", "--write", "all", "--no-smooth")
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
FOREVER = """
import contextlib, sys
from locfuse.cli.main import main
while True:
    with contextlib.suppress(SystemExit):
        main(sys.argv[1:])
    print('ready', flush=True)
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
def test_output_directory_that_cannot_be_written_is_one_line(
    log: Path, tmp_path: Path, command: str, out: str
) -> None:
    """Root may write to a read-only folder; nobody may in /proc or below a file."""
    (tmp_path / "file").write_text("mine")
    done = locfuse(command, log, "-o", out.format(file=tmp_path / "file"))
    assert done.exit_code == 1
    assert one_line(done.stderr), done.stderr
    assert (tmp_path / "file").read_text() == "mine"


def test_disk_full_is_one_line_and_leaves_nothing(log: Path, tmp_path: Path) -> None:
    with start(FULL, "run", log, "-o", tmp_path / "out") as process:
        _, stderr = process.communicate(timeout=300)
    assert process.returncode == 1
    assert one_line(stderr), stderr
    assert not (tmp_path / "out").exists()


def test_disk_full_keeps_the_result_that_was_there(log: Path, tmp_path: Path) -> None:
    ok("run", log, "-o", tmp_path)
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}

    with start(FULL, "run", log, "-o", tmp_path) as process:
        assert one_line(process.communicate(timeout=300)[1])
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before


def test_output_exists_and_is_not_ours_is_refused_and_untouched(log: Path, tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("mine")
    done = locfuse("run", log, "-o", tmp_path)
    assert done.exit_code == 1
    assert one_line(done.stderr)
    assert "--overwrite" in done.stderr
    assert [p.name for p in tmp_path.iterdir()] == ["thesis.tex"]
    ok("run", log, "-o", tmp_path, "--overwrite")
    assert (tmp_path / "thesis.tex").read_text() == "mine"


@pytest.mark.parametrize("where", ["locfuse.fusion.fuse:fuse", "os:fsync"], ids=["fusing", "writing"])
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_ctrl_c_and_sigterm_end_with_their_code_one_line_and_no_half_file(
    log: Path, tmp_path: Path, number: signal.Signals, code: int, where: str
) -> None:
    with start(HELD, where, "run", log, "-o", tmp_path / "out") as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        process.send_signal(number)
        _, stderr = process.communicate(timeout=300)
    assert process.returncode == code
    assert [line for line in stderr.splitlines() if line] == stderr.splitlines()[-1:], stderr
    assert "nothing was left half-written" in stderr
    assert not (tmp_path / "out").exists()


def test_kill_9_at_random_times_leaves_no_half_file_under_a_final_name(log: Path, tmp_path: Path) -> None:
    """A program that writes its result again and again is killed somewhere on the way, six times."""
    ok("run", log, "-o", tmp_path / "whole", *EXPORT)
    whole = {name: (tmp_path / "whole" / name).read_bytes() for name in FINAL}
    rng = random.Random(9)
    folders = [tmp_path / str(i) for i in range(6)]
    running = [start(FOREVER, "run", log, "-o", folder, "-q", *EXPORT) for folder in folders]
    for process in running:
        assert process.stdout is not None
        assert any("ready" in line for line in iter(process.stdout.readline, ""))
    for process in running:
        time.sleep(rng.uniform(0.0, 0.15))
        process.kill()
        process.communicate()
    for folder in folders:
        there = {p.name: p.read_bytes() for p in folder.iterdir() if not p.name.startswith(".")}
        assert there == whole
        assert np.isfinite(np.loadtxt(folder / "trajectory.tum")).all()
        assert json.loads(there["run.json"])
