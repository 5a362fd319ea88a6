"""The border where errors become exit codes: one line each, and bugs are seen."""

from __future__ import annotations

import errno
import os
import signal
import sys

import click
import pytest
from commands import locfuse, ok

from locfuse.cli import main as border
from locfuse.fusion.data import LocfuseError, UsageError


def fails_with(monkeypatch: pytest.MonkeyPatch, problem: BaseException) -> None:
    def broken(*_: object, **__: object) -> int:
        raise problem

    monkeypatch.setattr(border.locfuse, "main", broken)


def caused(by: BaseException) -> RuntimeError:
    problem = RuntimeError("error calling __set_name__")
    problem.__cause__ = by
    return problem


@pytest.mark.parametrize(
    ("problem", "code", "line"),
    [
        (LocfuseError("the log\n  is   odd"), 1, "the log is odd"),
        (UsageError("--set: what?"), 2, "--set: what?"),
        (FileNotFoundError(errno.ENOENT, "x", "a/b"), 1, "No such file or directory: a/b"),
        (
            OSError(errno.ENOSPC, "x", "a"),
            1,
            "No space left on device: a. Free some space or choose another folder with -o",
        ),
        (
            OSError(errno.ENOSPC, "x"),
            1,
            "No space left on device. Free some space or choose another folder with -o",
        ),
        (OSError(errno.EIO, "x"), 1, "Input/output error"),
        (MemoryError(), 1, "out of memory"),
        (
            ImportError("x.so\nfailed to map segment from shared object"),
            1,
            "out of memory: a library could not be loaded (failed to map segment from shared object)",
        ),
        (RuntimeError("can't start new thread"), 1, "out of memory: a thread could not be started"),
        (click.BadParameter("not a number."), 2, "Invalid value: not a number; see: locfuse --help"),
        (click.Abort(), 130, "interrupted; nothing was left half-written"),
        (KeyboardInterrupt(), 130, "interrupted; nothing was left half-written"),
        (border._Stopped(signal.SIGINT), 130, "interrupted; nothing was left half-written"),
        (border._Stopped(signal.SIGTERM), 143, "terminated; nothing was left half-written"),
        (caused(border._Stopped(signal.SIGINT)), 130, "interrupted; nothing was left half-written"),
        (caused(border._Stopped(signal.SIGTERM)), 143, "terminated; nothing was left half-written"),
    ],
    ids=repr,
)
def test_an_error_is_one_line_and_its_code(
    monkeypatch: pytest.MonkeyPatch, problem: BaseException, code: int, line: str
) -> None:
    fails_with(monkeypatch, problem)
    done = locfuse("info", "x")
    assert (done.exit_code, done.stdout, done.stderr) == (code, "", f"locfuse: {line}\n")


@pytest.mark.parametrize(
    "bug", [ValueError("bug"), caused(ValueError()), OSError("no number"), ImportError("no module"), KeyError("a")]
)
def test_a_bug_is_seen(monkeypatch: pytest.MonkeyPatch, bug: Exception) -> None:
    fails_with(monkeypatch, bug)
    with pytest.raises(type(bug)) as seen:
        locfuse("info", "x")
    assert seen.value is bug


@pytest.mark.parametrize(("code", "expected"), [(0, 0), (3, 3), (None, 0)])
def test_a_command_says_its_own_code(monkeypatch: pytest.MonkeyPatch, code: int | None, expected: int) -> None:
    monkeypatch.setattr(border.locfuse, "main", lambda **_: code)
    assert locfuse("info", "x").exit_code == expected
    fails_with(monkeypatch, click.exceptions.Exit(code or 0))
    assert locfuse("info", "x").exit_code == expected


def test_no_words_show_the_help_and_name_every_command() -> None:
    done = locfuse()
    assert done.exit_code == 2
    for command in border.COMMANDS:
        assert f"\n  {command} " in done.stdout + done.stderr


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_work_with_its_line(monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    def interrupted(**_: object) -> int:
        os.kill(os.getpid(), number)
        for _step in range(1000):  # its handler runs between two steps
            pass
        raise AssertionError("the signal was lost")

    monkeypatch.setattr(border.locfuse, "main", interrupted)
    done = locfuse("info", "x")
    word = "interrupted" if number == signal.SIGINT else "terminated"
    assert done.exit_code == 128 + number
    assert done.stderr == f"locfuse: {word}; nothing was left half-written\n"


def test_on_a_terminal_the_line_begins_behind_that_of_the_key(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(**_: object) -> int:
        monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
        border._stop(signal.SIGINT, None)
        return 0

    monkeypatch.setattr(border.locfuse, "main", interrupted)
    assert locfuse("info", "x").stderr == "\nlocfuse: interrupted; nothing was left half-written\n"


def test_an_ignored_interrupt_stays_ignored(monkeypatch: pytest.MonkeyPatch) -> None:
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)  # as `nohup` leaves it
    try:
        seen: list[object] = []

        def asked(**_: object) -> int:
            seen.append(signal.getsignal(signal.SIGINT))
            return 0

        monkeypatch.setattr(border.locfuse, "main", asked)
        ok("info", "x")
        assert seen == [signal.SIG_IGN]
    finally:
        signal.signal(signal.SIGINT, before)
