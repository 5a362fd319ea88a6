"""What a reader needs to get the same result: the command, and the settings with units and sources."""

import re
import shlex
import shutil
from pathlib import Path
from typing import Any

import msgspec
import pytest
from bags import real_log
from commands import reported

import locfuse as api
from locfuse import sample_logs
from locfuse.cli.analysis.robot_tables import table_types
from locfuse.formats.robot import robot_toml

SETS = ("--sensors", "odometry", "--sensors", "compass", "--align", "origin", "--set", "compass.sigma_deg=4")


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A user's own file with a space in its name, in a folder of the same name, which is not what was named."""
    path = tmp_path_factory.mktemp("logs") / "my drive" / "my drive.mcap"
    path.parent.mkdir()
    shutil.copy(sample_logs.path("rounded_rectangle"), path)
    return path


@pytest.fixture(scope="module")
def report(log: Path) -> dict[str, Any]:
    return compared(log, log.parent / "out", *SETS)


def compared(log: Path | str, out: Path, *words: str) -> dict[str, Any]:
    return reported("compare", log, *words, "--no-advice", "-o", out).report


def test_the_command_gives_the_same_figures_and_names_no_path(
    report: dict[str, Any], log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = shlex.split(report["repeat"])
    assert words[:3] == ["locfuse", "compare", "my drive.mcap"]
    assert str(log.parent) not in report["repeat"]
    shutil.copy(log, tmp_path)
    shutil.copy(log.parent / "out" / "robot.toml", tmp_path)
    monkeypatch.chdir(tmp_path)
    again = compared(words[2], tmp_path / "again", *words[3:])
    for key in ("configurations", "settings", "verdicts", "repeat"):
        assert again[key] == report[key], key


def test_the_command_is_the_same_from_python_and_changed_settings_say_unit_and_source(
    report: dict[str, Any], log: Path
) -> None:
    result = api.load(log, sets={"compass.sigma_deg": 4}).compare(
        ["odometry", "compass"], align="origin", advice=False
    )
    assert result.report["repeat"] == report["repeat"]
    assert result.report["changed_settings"] == report["changed_settings"]
    changed = report["changed_settings"]
    assert changed["compass.sigma_deg"] == {"value": 4, "unit": "°", "from": "--set"}
    assert changed["wheels.radius"]["unit"] == "m"
    assert changed["wheels.radius"]["from"] == "robot.toml in the log"
    assert "compass.gate" not in changed  # as by default
    assert not [key for key in changed if key.split(".")[0] in report["absent"]]


def test_a_sample_log_is_named_and_every_choice_is_in_the_command(tmp_path: Path) -> None:
    words = ("--from", "2", "--to", "20.5", "--smooth", "--sensors", "compass")
    found = compared("rounded_rectangle", tmp_path / "out", *words)["repeat"]
    expected = "locfuse compare rounded_rectangle --robot robot.toml --sensors compass --smooth --from 2 --to 20.5"
    assert found == expected


def test_every_number_of_robot_toml_has_a_unit_or_is_known_to_have_none() -> None:
    none = {
        "wheels.ratio",
        "wheels.scale",
        "wheels.turn_scale",
        "wheels.servo_offset",
        "wheels.sigma_scale",
        "wheels.sigma_track",
        "compass.field_tolerance",
        "compass.soft_iron",
        "lrf.range_scale",
        "lrf.min_points",
        "camera.red_ratio",
        "camera.min_slender",
        "gyro.sigma_scale",
        "landmarks.ignore",
        "gyro.scale",
        "ranges.ignore",
        "landmarks.range_depth",
        "twist.sigma_scale",
    }
    for table, kind in table_types().items():
        for field in msgspec.structs.fields(kind):
            path = f"{table}.{field.encode_name}"
            if re.search(r"float|\bint\b", str(field.type)):
                unit = robot_toml.unit_of(table, field.encode_name)
                assert bool(unit) != (path in none or path.endswith(".gate")), path


def test_the_exact_mount_of_scan_matching_is_not_said_to_be_in_the_log() -> None:
    log = real_log("strangers/laser_only")
    changed = reported("compare", log, "--no-advice", "--no-smooth").report["changed_settings"]
    assert changed["lrf.sigma_x"]["from"] == "scan matching does not show the mount"
