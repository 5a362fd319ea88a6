"""What the terminal does for who types: nearest words, units, completion, the report's place, comments kept."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from commands import locfuse

LOG = "rounded_rectangle"


def test_a_mistyped_file_names_the_one_beside_it(tmp_path: Path) -> None:
    (tmp_path / "monday_run.mcap").touch()
    assert f"did you mean {tmp_path}/monday_run.mcap?" in locfuse("info", tmp_path / "monday_rum.mcap").stderr


@pytest.mark.parametrize(
    ("setting", "needed"),
    [
        ("wheels.radius=big", "must be a number, in metres"),
        ("compass.sigma_deg=true", "must be a number, in degrees"),
        ("wheels.time_offset=[1]", "must be a number, in seconds"),
        ("start.sigma_xy=-1", "must be a number >= 0.0, in metres"),
        ("lrf.min_points=2.5", "must be a whole number"),
    ],
)
def test_a_value_of_the_wrong_kind_says_which_is_needed_in_which_unit(setting: str, needed: str) -> None:
    done = locfuse("compare", LOG, "--set", setting)
    assert done.exit_code == 2
    assert needed in done.stderr


def offered(*words: str) -> set[str]:
    """Return what bash would offer for the last of these words."""
    asked = {
        "_LOCFUSE_COMPLETE": "bash_complete",
        "COMP_WORDS": shlex.join(words),
        "COMP_CWORD": str(len(words) - 1),
    }
    done = subprocess.run(
        [sys.executable, "-m", "locfuse.cli"],
        env={**os.environ, **asked},
        capture_output=True,
        text=True,
        check=False,
    )
    return {line.partition(",")[2] for line in done.stdout.splitlines()}


def test_the_shell_completes_logs_sensors_keys_and_topics_of_the_log() -> None:
    assert {"rounded_rectangle", "rounded_triangle"} <= offered("locfuse", "compare", "rou")
    assert {"compass,lrf", "compass,landmarks"} == offered("locfuse", "compare", LOG, "--sensors", "compass,l")
    assert "lrf.sigma_range=" in offered("locfuse", "compare", LOG, "--set", "lrf.sigma")
    assert offered("locfuse", "compare", LOG, "--set", "lrf.topic=/s") == {"lrf.topic=/scan"}
    assert "compare" in offered("locfuse", "com")


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_prints_a_script_for_the_shell(shell: str) -> None:
    done = locfuse("completion", shell)
    assert done.exit_code == 0
    assert "_LOCFUSE_COMPLETE" in done.stdout


def test_the_last_line_says_where_the_report_is_and_open_shows_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown: list[str] = []

    def show(address: str) -> bool:
        shown.append(address)
        return True

    monkeypatch.setattr("webbrowser.open", show)
    words = ("compare", LOG, "--sensors", "compass", "--no-advice", "--write", "html")
    done = locfuse(*words, "-o", tmp_path / "out", "--open")
    assert done.stdout.splitlines()[-1] == f"report: {tmp_path}/out/report.html"
    assert shown == [(tmp_path / "out" / "report.html").as_uri()]


def test_open_without_a_page_or_a_browser_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("webbrowser.open", lambda address: False)
    words = ("compare", LOG, "--sensors", "compass", "--no-advice", "--open")
    assert "add html to --write" in locfuse(*words, "--write", "json", "-o", tmp_path / "a").stderr
    assert "no browser was found" in locfuse(*words, "--write", "html", "-o", tmp_path / "b").stderr


def test_init_writes_a_file_and_never_over_one_that_is_there(tmp_path: Path) -> None:
    file = tmp_path / "robot.toml"
    printed = locfuse("init", LOG).stdout
    assert locfuse("init", LOG, "-o", file).exit_code == 0
    assert file.read_text() == printed.replace("--robot robot.toml", f"--robot {file}")
    assert locfuse("init", LOG, "-o", file).exit_code != 0
    assert locfuse("init", LOG, "-o", file, "--overwrite").exit_code == 0


def test_init_adds_to_a_file_what_it_does_not_say(tmp_path: Path) -> None:
    file = tmp_path / "robot.toml"
    file.write_text("# mine\n[wheels]\nradius = 0.051  # by ruler\n")
    assert locfuse("init", LOG, "--update", file, "-q").exit_code == 0
    text = file.read_text()
    assert text.startswith("# mine\n[wheels]\nradius = 0.051  # by ruler\n")
    assert tomllib.loads(text)["lrf"]["topic"] == "/scan"
    again = locfuse("init", LOG, "--update", file, "-q")
    assert again.exit_code == 0
    assert file.read_text() == text


def test_calibrate_keeps_what_people_wrote_beside_the_numbers(tmp_path: Path) -> None:
    file, out = tmp_path / "robot.toml", tmp_path / "found.toml"
    file.write_text("# Anna's robot\n[compass]\nhard_iron = [0.0, 0.0]  # before the new motor\n")
    done = locfuse("calibrate", LOG, "--robot", file, "-o", out, "-q")
    assert done.exit_code == 0, done.stderr
    lines = out.read_text().splitlines()
    assert lines[0] == "# Anna's robot"
    assert any(line.startswith("hard_iron = [") and line.endswith("  # before the new motor") for line in lines)
