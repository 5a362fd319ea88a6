"""What people see of `compare`: little, each thing once, and the rest where they ask for it."""

import re
import shutil
from collections import Counter
from pathlib import Path

import click
import pytest
from commands import Done, locfuse, ok

from locfuse import sample_logs
from locfuse.cli.commands.compare import compare
from locfuse.cli.terminal.options import HELP_GROUPS

MAX_LINES, MAX_WORDS, MAX_OPTIONS = 12, 128, 14
OPTION = re.compile(r"^  (?:-\w, )?(--[a-z-]+)", re.MULTILINE)


@pytest.fixture(scope="module", params=["rounded_rectangle", "labyrinth"])
def printed(
    request: pytest.FixtureRequest, plain: tuple[Done, Path], tmp_path_factory: pytest.TempPathFactory
) -> tuple[Done, Path]:
    if request.param == "rounded_rectangle":
        return plain
    out = tmp_path_factory.mktemp("short") / "out"
    return ok("compare", request.param, "-o", out), out


def test_a_good_log_takes_few_lines_none_of_them_twice_and_few_files(printed: tuple[Done, Path]) -> None:
    done, out = printed
    lines = [line for line in done.stdout.splitlines() if line.strip()]
    assert len(lines) <= MAX_LINES
    assert len(done.stdout.split()) <= MAX_WORDS
    assert done.stderr == ""
    assert lines[-1].startswith(f"report: {out / 'report.html'}")
    found = Counter(re.findall(r"(?<=[.] )[A-Z][^.]+[.](?= |$)", printed[0].stdout, re.MULTILINE))
    assert [sentence for sentence, times in found.items() if times > 1] == []
    out = printed[1]
    names = {p.name for p in out.iterdir()} - {"fixes.toml", "timing.json"}
    assert {n for n in names if not n.endswith(".tum")} == {"report.html", "report.json", "robot.toml"}
    assert {"odometry.tum", "truth.tum"} < names


def test_the_notes_and_the_table_of_sensors_are_printed_where_they_are_asked_for(tmp_path: Path) -> None:
    words = ("compare", "labyrinth", "--no-advice", "-o", tmp_path / "out", "--overwrite")
    short, long = locfuse(*words), locfuse(*words, "--verbose")
    (count,) = re.findall(r"\((\d+) notes?: -v\)", short.stdout)
    assert len(long.stderr.splitlines()) == int(count)
    assert "accepted" in long.stdout
    assert "accepted" not in short.stdout
    assert set(short.stdout.splitlines()[:1]) < set(long.stdout.splitlines())
    assert "-v" not in locfuse(*words, "--quiet").stdout


def test_every_kind_of_file_is_written_on_request(tmp_path: Path) -> None:
    ok("compare", "labyrinth", "--no-advice", "--write", "all", "-o", tmp_path / "out")
    assert {f"report.{kind}" for kind in ("html", "json", "md", "csv", "tex")} <= {
        p.name for p in (tmp_path / "out").iterdir()
    }


def test_help_shows_the_options_that_come_first_and_help_all_every_one() -> None:
    first, every = (set(OPTION.findall(locfuse("compare", word).stdout)) for word in ("--help", "--help-all"))
    assert len(first) <= MAX_OPTIONS
    assert first < every
    shown = {p.opts[-1] for p in compare.params if isinstance(p, click.Option) and not p.hidden}
    assert shown == every - {"--help"}
    hidden = {"--jobs", "--cluster", "--each", "--sweep"}
    assert hidden.isdisjoint(every)
    assert hidden < {o for p in compare.params for o in p.opts}, "for one release they go on working here"


def test_the_groups_of_help_name_parameters_that_exist() -> None:
    from locfuse.cli.commands.fleet import fleet
    from locfuse.cli.commands.run import run
    from locfuse.cli.commands.view import view

    known = {p.name for command in (compare, fleet, run, view) for p in command.params}
    assert {name for names in HELP_GROUPS.values() for name in names} <= known


def test_on_a_narrow_terminal_words_wrap_and_figures_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    monkeypatch.setenv("NO_COLOR", "1")
    done = locfuse("compare", "rounded_rectangle", "--no-advice", "--no-smooth", "-o", tmp_path / "o")
    lines = done.stdout.splitlines()[:-1]  # the last one is a path, which is copied whole
    assert max(map(len, lines)) <= 40
    assert "\x1b" not in done.stdout
    (row,) = (line for line in lines if line.startswith("odometry"))
    assert row.split()[1] == "572.7"


def test_a_log_with_a_long_name_is_compared_like_any_other(tmp_path: Path) -> None:
    log = tmp_path / f"{'n' * 200}.mcap"
    shutil.copy(Path(str(sample_logs.__path__[0])) / "labyrinth.mcap", log)
    done = ok("compare", log, "--no-advice", "-o", tmp_path / "out")
    assert (tmp_path / "out" / "report.html").is_file()
    assert len(done.stdout.split()) <= MAX_WORDS
