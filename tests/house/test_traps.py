"""Every trap of real logs, on a log made for it: `info` names it, and the cure that it prints cures it."""

import json
import re
from functools import cache
from pathlib import Path

import pytest
from commands import locfuse, ok
from present import present
from trap_logs import Drive
from traps import CAMERA_TRAPS, CLOCK_TRAPS, COMPASS_TRAPS, LASER_TRAPS, TRUTH_TRAPS, WHEEL_TRAPS

TABLES = (WHEEL_TRAPS, CLOCK_TRAPS, COMPASS_TRAPS, LASER_TRAPS, CAMERA_TRAPS, TRUTH_TRAPS)
TRAPS = {trap.name: trap for table in TABLES for trap in table}
PAGE = (Path(__file__).parents[2] / "docs" / "findings.md").read_text(encoding="utf-8")
WORSE = 1.15  # by this much the trap costs, at least
CURE = re.compile(r"--set (\S+)")


@cache
def healthy_error(sensors: str, folder: Path) -> float:
    return present(error(Drive(sensors == "camera").record(folder / f"healthy_{sensors}.mcap"), sensors))


def error(log: Path, sensors: str, *words: str, void: bool = False) -> float | None:
    """Position error [m rms] of an estimate against truth; None where there is no estimate, or only a void one.

    `void` takes void figures too: what they would have been.
    """
    out = ("-o", log.parent / "out", "--overwrite", "--write", "json")
    done = locfuse("run", log, "--sensors", sensors, "--json", "--no-advice", "--no-smooth", *out, *words)
    if done.exit_code not in {0, 3}:
        return None
    (one,) = json.loads(done.stdout)["configurations"].values()
    shown = one["void"]["figures"] if void and "void" in one else one
    rmse: float | None = shown["position_rmse_m"]
    return rmse


def said(stdout: str, words: str) -> list[str]:
    """The finding with these words: its line, and the line with its cure where it has one."""
    lines = stdout.splitlines()  # in a pipe every finding is one line
    return [
        line if not after.startswith("    fix: ") else f"{line}\n{after}"
        for line, after in zip(lines, [*lines[1:], ""], strict=True)
        if words in line
    ]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("healthy")


@cache
def documented() -> dict[str, tuple[str, str]]:
    """What docs/findings.md says of every trap: what info says, and the cure."""
    tables = PAGE.partition("## Wheels and odometry")[2].partition("\n## In CI")[0]
    rows = (line.strip("| ").split(" | ") for line in tables.splitlines() if line.startswith("| "))
    return {row[0]: (row[1].rstrip(" |"), row[2] if len(row) > 2 else "") for row in rows if row[0] != "trap"}


def test_the_page_on_findings_knows_every_trap() -> None:
    assert list(documented()) == [name for name, trap in TRAPS.items() if trap.says is not None]
    unnoticed = PAGE.partition("These need no finding")[2].partition("\n\n")[0]
    assert [n for n, trap in TRAPS.items() if trap.says is None and n not in " ".join(unnoticed.split())] == []


def keys(cures: str) -> list[str]:
    """The settings that a text names."""
    return re.findall(r"([a-z]+\.[a-z_]+)=", cures)


@pytest.mark.parametrize("name", TRAPS)
def test_info_names_the_trap_and_its_fix_is_right(name: str, tmp_path: Path, folder: Path) -> None:
    trap = TRAPS[name]
    right = 1.3 * healthy_error("odometry" if trap.sensors == "gyro" else trap.sensors, folder) + trap.blur
    drive = Drive(trap.sensors == "camera")
    trap.change(drive)
    log = drive.record(tmp_path / "log.mcap")
    told = locfuse("info", log, "--check", "--no-advice")
    spoiling = told.stdout.partition("would spoil an estimate")[2].partition("worth knowing")[0]
    assert told.exit_code == (3 if trap.spoils else 0), told.stdout
    cures: list[str] = []
    if trap.says is None:
        assert "worth knowing" not in told.stdout
    else:
        findings = said(told.stdout, trap.says)
        assert findings, told.stdout
        assert all((finding in spoiling) == trap.spoils for finding in findings)
        cures = [c for f in findings if "\n" in f for c in CURE.findall(f.splitlines()[1])]
    words, cure_told = documented().get(name, ("", ""))
    assert (trap.says or "") in words.replace("`", "")
    assert words.startswith("**") == trap.spoils
    assert keys(cure_told) == keys(" ".join(cures))
    options = [word for cure in cures for word in ("--set", cure)]
    after = error(log, trap.sensors, *options)
    assert after is not None, told.stdout
    assert after < right, told.stdout
    if trap.spoils:
        assert cures
        before = error(log, trap.sensors, void=True)
        assert before is None if trap.refused else before is not None and before > WORSE * after
    if cures:
        again = ok("info", log, "--check", "--no-advice", *options)
        assert trap.says is not None
        assert trap.says not in again.stdout
