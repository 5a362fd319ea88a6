"""`init` asks the person at a terminal for what no log can tell, and nobody else."""

from __future__ import annotations

import os
import pty
import subprocess
import sys
import tomllib
from pathlib import Path

from commands import locfuse
from wheel_bags import GEOMETRY, angles, joint_states, log_of


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
    assert "to be filled in: wheels.radius, wheels.track" in screen
    assert locfuse("init", log, "-o", tmp_path / "other.toml").exit_code == 0
    assert out.read_text().replace("mine", "other") == (tmp_path / "other.toml").read_text()


def test_nobody_is_asked_where_nothing_is_missing_or_the_file_goes_to_a_pipe(tmp_path: Path) -> None:
    log = a_log(tmp_path)
    assert "No log can tell" not in at_a_terminal("", "init", log)[1]
    assert "No log can tell" not in at_a_terminal("", "init", log, "-o", tmp_path / "a.toml", *GEOMETRY)[1]
