"""Advice in commands: what `info --check` tries, what --no-advice leaves out, why a command exits with 3."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from commands import locfuse
from trap_logs import Drive
from traps_sensors import elsewhere, pitched_imu, upside_down


@pytest.fixture(scope="module")
def hanging(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A laser that is mounted upside-down."""
    drive = Drive()
    upside_down(drive)
    return drive.record(tmp_path_factory.mktemp("hanging") / "log.mcap")


def test_info_check_says_what_its_fix_did(hanging: Path) -> None:
    done = locfuse("info", hanging, "--check")
    assert done.exit_code == 3
    tried = done.stdout.partition("tried by fusing")[2]
    (line,) = (line for line in tried.splitlines() if line.startswith("lrf: "))
    assert "mounted upside-down" in line
    assert "error" in line.partition("Fix (tried with")[2]
    assert "--set lrf.flipped=true" in line


def test_without_advice_nothing_is_fused_again(hanging: Path, tmp_path: Path) -> None:
    assert "tried by fusing" not in locfuse("info", hanging, "--check", "--no-advice").stdout
    words = ("--no-advice", "-o", tmp_path / "out", "--write", "json")
    assert locfuse("compare", hanging, *words).exit_code == 3  # lost, and said so
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["findings"] is None
    assert not (tmp_path / "out" / "fixes.toml").exists()


def test_a_sensor_that_cannot_be_used_is_judged_by_no_run(tmp_path: Path) -> None:
    drive = Drive()
    pitched_imu(drive)
    done = locfuse("info", drive.record(tmp_path / "log.mcap"), "--check")
    assert done.exit_code == 3
    assert "gravity says that it is mounted" in done.stdout


@pytest.mark.parametrize("command", ["run", "compare"])
def test_quiet_commands_that_exit_with_3_say_why_on_one_line(command: str, tmp_path: Path) -> None:
    drive = Drive()
    elsewhere(drive)
    log = drive.record(tmp_path / "log.mcap")
    done = locfuse(command, log, "-q", "--no-advice", "-o", tmp_path / "out", "--write", "json")
    assert done.exit_code == 3
    (line,) = done.stderr.splitlines()
    assert line.startswith("lost: the truth starts 3.26 m from where the drive starts")
