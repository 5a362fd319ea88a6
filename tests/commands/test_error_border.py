"""The border where errors become exit codes: one line each, and bugs are seen."""

import errno
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import click
import pytest
from commands import locfuse, ok
from hostile import Put, fix, sample, write
from hypothesis import given, strategies as st

from locfuse.cli import main as border
from locfuse.formats.report import json_report
from locfuse.formats.text import UNSEEN, escaped, visible, visible_lines, writable
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


# --- text of a log does nothing but stand there: on a terminal, in .md and .html, in any encoding

TITLE = "\x1b]0;pwned\x07"
ENTRY = [sys.executable, "-m", "locfuse"]


@given(st.text())
def test_visible_text_holds_nothing_unseen_and_the_rest_as_it_was(text: str) -> None:
    shown = visible(text)
    assert not UNSEEN.search(shown)
    shown.encode()
    assert visible(shown) == shown
    if not UNSEEN.search(text):
        assert shown == text


@given(st.text(st.characters(codec="utf-8")))
def test_escaped_json_is_the_same_value(text: str) -> None:
    document = json_report.encode({"a": text})
    assert json.loads(document) == {"a": text}
    assert not UNSEEN.search(document.replace("\n", ""))
    assert escaped(document) == document


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("/scan", "/scan"),
        ("°é漢", "°é漢"),
        ("a\x1b[2Jb", r"a\x1b[2Jb"),
        ("a\rb\tc\n", r"a\x0db\x09c\x0a"),
        ("\x9b31m", r"\x9b31m"),
        ("\u202egnp", r"\u202egnp"),
        ("bad\udcff", r"bad\udcff"),
    ],
)
def test_what_acts_is_shown_by_its_number(text: str, shown: str) -> None:
    assert visible(text) == shown


def test_line_ends_of_our_own_stay() -> None:
    assert visible_lines("a\nb\x07\n") == "a\nb\\x07\n"
    assert writable("a\n\udc80") == "a\n\\udc80"


def renamed(put: Put) -> Put:
    return put._replace(topic=put.topic.replace("/compass", f"/c{TITLE}\x1b[31m\u202e"))


def acting(text: str) -> list[str]:
    return UNSEEN.findall(text.replace("\n", ""))


@pytest.mark.parametrize("command", ["info", "init", "run", "compare"])
@pytest.mark.parametrize("words", [[], ["--json"]])
def test_no_command_lets_a_topics_name_act(tmp_path: Path, command: str, words: list[str]) -> None:
    if command == "init" and words:
        return
    robot = sample()[1].replace(b'topic = "/scan"', b'topic = "\\u001b]0;pwned\\u0007"')
    log = write(tmp_path / "f.mcap", renamed, robot=robot)
    out = ["-o", str(tmp_path / "o")] if command in {"run", "compare"} else []
    done = locfuse(command, log, *out, *words)
    assert done.exit_code in {0, 3}
    assert not acting(done.stdout)
    assert not acting(done.stderr)
    assert "pwned" in done.stdout + done.stderr
    for ending in ("md", "html", "json", "toml"):
        for file in (tmp_path / "o").glob(f"*.{ending}"):
            assert not acting(file.read_text()), file


def test_a_frame_of_half_a_character_is_shown(tmp_path: Path) -> None:
    log = write(tmp_path / "f.mcap", extra=[fix(i, frame_id="\ud800") for i in range(9)])
    done = ok("info", log)
    assert r"\ud800" in done.stdout


def start(*words: object, **options: object) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run([*ENTRY, *map(str, words)], capture_output=True, check=False, **options)  # type: ignore[call-overload, no-any-return]


def test_names_and_encodings_that_cannot_hold_all_text_cost_no_result(tmp_path: Path) -> None:
    log = Path(os.fsdecode(os.fsencode(tmp_path) + b"/bad\xff.mcap"))
    write(log)
    ok("compare", log, "--no-advice", "-o", tmp_path / "o", "--export", "mcap")
    report = json.loads((tmp_path / "o" / "report.json").read_bytes())
    assert report["input"]["name"] == r"bad\udcff"
    ok("run", log, "--no-advice", "-o", tmp_path / "p", "--save-map", tmp_path / "map.json")
    log = write(tmp_path / "f.mcap")
    done = start(
        "compare",
        log,
        "--no-advice",
        "--write",
        "json",
        "-o",
        tmp_path / "o",
        env={**os.environ, "PYTHONIOENCODING": "ascii"},
    )
    assert done.returncode == 0, done.stderr[-500:]
    assert rb"\xb0" in done.stdout  # the degree sign, in letters


@pytest.mark.parametrize("closed", [1, 2])
def test_a_closed_stream_costs_no_result(tmp_path: Path, closed: int) -> None:
    log = write(tmp_path / "f.mcap")
    done = subprocess.run(
        [*ENTRY, "run", str(log), "--no-advice", "-o", str(tmp_path / "o")],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        preexec_fn=lambda: os.close(closed),
        check=False,
    )
    assert done.returncode == 0
    assert json.loads((tmp_path / "o" / "run.json").read_bytes())["configurations"]


def test_a_reader_who_has_gone_costs_neither_files_nor_exit_code(tmp_path: Path) -> None:
    log = write(tmp_path / "f.mcap")
    for end, out in (("stdout", tmp_path / "o"), ("stderr", tmp_path / "e")):
        read, written = os.pipe()
        os.close(read)
        command = [*ENTRY, "run", str(log), "-v", "--no-advice", "-o", str(out)]
        done = subprocess.run(command, check=False, **{end: written})  # type: ignore[call-overload]
        os.close(written)
        assert done.returncode == 0
        assert (out / "run.json").is_file()
