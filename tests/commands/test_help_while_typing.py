"""What the terminal does for who types: nearest words, units, completion, the report's place, comments kept."""

import os
import pty
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from click.shell_completion import BashComplete
from commands import locfuse, ok, refused
from hostile import write
from wheel_bags import GEOMETRY, angles, joint_states, log_of

from locfuse.cli import main as cli
from locfuse.formats.report.table import written

LOG = "rounded_rectangle"


def test_a_mistyped_file_names_the_one_beside_it_and_a_sensor_is_explained(tmp_path: Path) -> None:
    (tmp_path / "monday_run.mcap").touch()
    assert f"did you mean {tmp_path}/monday_run.mcap?" in locfuse("info", tmp_path / "monday_rum.mcap").stderr
    done = locfuse("explain", "LRF")
    assert (done.exit_code, done.stderr) == (0, "")
    assert "LaserScan" in done.stdout


def offered(*words: str) -> set[str]:
    """Return what bash would offer for the last of these words."""
    shell = BashComplete(cli.locfuse, {}, "locfuse", "_LOCFUSE_COMPLETE")
    return {item.value for item in shell.get_completions(list(words[1:-1]), words[-1])}


def test_the_shell_completes_logs_sensors_keys_and_topics_of_the_log(monkeypatch: pytest.MonkeyPatch) -> None:
    assert {"rounded_rectangle", "rounded_triangle"} <= offered("locfuse", "compare", "rou")
    assert {"compass,lrf", "compass,landmarks"} == offered("locfuse", "compare", LOG, "--sensors", "compass,l")
    assert "lrf.sigma_range=" in offered("locfuse", "compare", LOG, "--set", "lrf.sigma")
    words = ("locfuse", "compare", LOG, "--set", "lrf.topic=/s")
    monkeypatch.setenv("COMP_WORDS", shlex.join(words))  # as the shell's script does
    assert offered(*words) == {"lrf.topic=/scan"}
    assert "compare" in offered("locfuse", "com")


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_prints_a_script_for_the_shell(shell: str) -> None:
    done = ok("completion", shell)
    assert "_LOCFUSE_COMPLETE" in done.stdout


def test_the_last_line_names_the_report_and_open_shows_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
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
    file, log = tmp_path / "robot.toml", write(tmp_path / "short.mcap")
    printed = locfuse("init", log).stdout
    ok("init", log, "-o", file)
    assert file.read_text() == printed.replace("--robot robot.toml", f"--robot {file}")
    assert locfuse("init", log, "-o", file).exit_code != 0
    ok("init", log, "-o", file, "--overwrite")


def test_init_adds_to_a_file_what_it_does_not_say(tmp_path: Path) -> None:
    file, log = tmp_path / "robot.toml", write(tmp_path / "short.mcap")
    file.write_text("# mine\n[wheels]\nradius = 0.051  # by ruler\n")
    ok("init", log, "--update", file, "-q")
    text = file.read_text()
    assert text.startswith("# mine\n[wheels]\nradius = 0.051  # by ruler\n")
    assert tomllib.loads(text)["lrf"]["topic"] == "/scan"
    ok("init", log, "--update", file, "-q")
    assert file.read_text() == text


def test_calibrate_keeps_what_people_wrote_beside_the_numbers(tmp_path: Path) -> None:
    file, out = tmp_path / "robot.toml", tmp_path / "found.toml"
    file.write_text("# Anna's robot\n[compass]\nhard_iron = [0.0, 0.0]  # before the new motor\n")
    ok("calibrate", LOG, "--robot", file, "-o", out, "-q")
    lines = out.read_text().splitlines()
    assert lines[0] == "# Anna's robot"
    assert any(line.startswith("hard_iron = [") and line.endswith("  # before the new motor") for line in lines)


# --- a word that is nearly right is answered with the right one, before any work is done


def test_a_truth_beside_the_log_is_a_table_of_poses(tmp_path: Path) -> None:
    page = tmp_path / "README.md"
    page.write_text("# no poses")
    refusal = refused("compare", LOG, "--truth", page, "-o", tmp_path / "out", code=2)
    assert f"--truth {page}: a .tum, or a .csv" in refusal


@pytest.mark.parametrize(
    ("value", "form", "text"),
    [
        (-0.0, "{:.2f}", "0.00"),
        (-0.004, "{:.2f}", "0.00"),
        (-0.006, "{:.2f}", "-0.01"),
        (-0.001, "{:.0%}", "0%"),
        (-0.5, "{:.0%}", "-50%"),
    ],
)
def test_nothing_is_minus_nothing(value: float, form: str, text: str) -> None:
    assert written(value, form) == text


# --- `init` asks the person at a terminal for what no log can tell, and nobody else


def at_a_terminal(typed: str, *words: object) -> tuple[int, str]:
    """Type lines into a command at a pseudo-terminal; return its exit code and what its screen shows."""
    ours, theirs = pty.openpty()
    os.write(ours, typed.encode())
    command = [sys.executable, "-m", "locfuse", *map(str, words)]
    with subprocess.Popen(command, stdin=theirs, stdout=subprocess.PIPE, stderr=theirs) as run:
        os.close(theirs)
        shown = b""
        try:
            while part := os.read(ours, 4096):
                shown += part
        except OSError:  # how a pseudo-terminal says that its other end is closed
            pass
        os.close(ours)
        return run.wait(), shown.decode()


def a_log(folder: Path) -> Path:
    t, angle = angles()
    return log_of(folder / "x.mcap", joint_states(t, angle))


def test_a_person_is_asked_for_what_is_missing_and_a_wrong_answer_is_asked_again(tmp_path: Path) -> None:
    log, out = a_log(tmp_path), tmp_path / "mine.toml"
    code, screen = at_a_terminal("five\n0.05\n0.3\n", "init", log, "-o", out)
    assert code == 0, screen
    assert "wheels.radius [m]: not in this log" in screen
    assert "must be a number, in metres" in screen
    assert screen.count("value:") == 3, "two answers, and one that did not fit"
    wheels = tomllib.loads(out.read_text())["wheels"]
    assert (wheels["radius"], wheels["track"]) == (0.05, 0.3)
    assert f"--robot {out}" in screen
    assert "robot.toml" not in screen.replace(str(out), ""), "another file is named than the one that was written"


def test_an_empty_answer_leaves_the_line_as_it_was(tmp_path: Path) -> None:
    log, out = a_log(tmp_path), tmp_path / "mine.toml"
    code, screen = at_a_terminal("\n\n", "init", log, "-o", out)
    assert code == 0, screen
    assert "fill in wheels.radius, wheels.track" in screen
    ok("init", log, "-o", tmp_path / "other.toml")
    assert out.read_text().replace("mine", "other") == (tmp_path / "other.toml").read_text()


def test_nobody_is_asked_where_nothing_is_missing_or_the_file_goes_to_a_pipe(tmp_path: Path) -> None:
    log = a_log(tmp_path)
    assert "No log can tell" not in at_a_terminal("", "init", log)[1]
    assert "No log can tell" not in at_a_terminal("", "init", log, "-o", tmp_path / "a.toml", *GEOMETRY)[1]
