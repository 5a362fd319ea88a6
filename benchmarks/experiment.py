"""Experiments with many drives and one table: cases x seeds -> rows -> table, resumable, in parallel.

An experiment consists of a function that makes the row of one task, and a function that makes a table of all rows:

    main = experiment.command(work, table, CASES)

`work(*task)` returns a dict that JSON can store. Every row is appended to the file at once, and tasks with a row
in the file are not repeated, so that an experiment can be stopped at any time. If a task raises an error, its row
has the message under "failed", and the task is repeated in the next run. Delete the file when the code changes:
all rows of a table must be made by the same code.
"""

import atexit
import contextlib
import io
import itertools
import json
import multiprocessing
import shutil
import signal
import tempfile
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache, lru_cache, partial
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any, NamedTuple

import click

from locfuse.cli.analysis.robot_tables import make_robot
from locfuse.cli.main import main as command_line
from locfuse.formats.robot import robot_toml
from locfuse.fusion.data import ArrayStream, Drive
from locfuse.fusion.measure import measure
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.sample_logs.scenario import load
from locfuse.sample_logs.simulate import Outcome, in_memory

FIRST_SEED = 1000  # the shipped logs use small seeds; drives with these seeds are not used elsewhere
Task = tuple[str | int | bool, ...]
Row = dict[str, Any]
Work = Callable[..., Mapping[str, Any]]
FAILED = "failed"


class Simulated(NamedTuple):
    """A simulated drive in memory, before measuring."""

    streams: dict[str, ArrayStream]  # by role
    tables: dict[str, dict[str, Any]]  # of the robot.toml that its user would write
    outcome: Outcome

    def robot(self, sets: Iterable[str] = ()) -> Robot:
        """Return the robot under more settings of robot.toml."""
        return make_robot(robot_toml.layered(self.tables, robot_toml.apply_sets(tuple(sets))))

    def measured(self, sets: Iterable[str] = ()) -> tuple[Drive, Robot]:
        """Return the measured drive, and the robot under more settings of robot.toml."""
        robot = self.robot(sets)
        return measure(self.streams, robot), robot


@lru_cache(maxsize=16)  # tasks often share a drive
def simulated(scenario: str, sets: tuple[str, ...], seed: int) -> Simulated:
    """Return a drive of a scenario with changed settings."""
    topics, tables, outcome = in_memory(load(scenario, sets), seed)
    roles = ("wheels", "truth", *REGISTRY)
    streams = {r: topics[tables[r]["topic"]] for r in roles if r in tables and tables[r].get("topic") in topics}
    return Simulated(streams, tables, outcome)


@cache
def scratch() -> Path:
    """Return a temporary folder that this process removes at its end, in memory if possible."""
    folder = tempfile.mkdtemp(prefix="locfuse-", dir="/dev/shm" if Path("/dev/shm").is_dir() else None)
    atexit.register(shutil.rmtree, folder)
    return Path(folder)


class Done(NamedTuple):
    """Exit code and output of a command."""

    exit_code: int
    stdout: str
    stderr: str


def locfuse(*words: Any) -> Done:
    """Run the command line in this process; an exception that it does not catch is raised."""
    out, err, code = io.StringIO(), io.StringIO(), 0
    handler = signal.getsignal(signal.SIGTERM)
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            command_line([str(word) for word in words])
    except SystemExit as e:
        code = int(e.code or 0)
    finally:
        signal.signal(signal.SIGTERM, handler)
    return Done(code, out.getvalue(), err.getvalue())


def in_processes(work: Callable[[Any], Any], units: Iterable[Any], jobs: int) -> Iterator[tuple[Any, Any]]:
    """Yield (unit, result of `work`) as they finish, each from its own forked process; RuntimeError if it died."""
    fork, left = multiprocessing.get_context("fork"), iter(units)
    running: dict[Any, Any] = {}  # pipe end that receives the result -> process, unit
    while True:
        for unit in itertools.islice(left, jobs - len(running)):
            end, its_end = fork.Pipe(duplex=False)
            process = fork.Process(target=_answer, args=(its_end, work, unit))
            process.start()
            its_end.close()
            running[end] = process, unit
        if not running:
            return
        ready: list[Any] = wait(list(running))
        for ended in ready:
            process, unit = running.pop(ended)
            try:
                found = ended.recv()
            except EOFError:
                process.join()
                found = RuntimeError(f"exit code {process.exitcode}")
            process.join()
            yield unit, found


def _answer(pipe: Any, work: Callable[[Any], Any], unit: Any) -> None:
    pipe.send(work(unit))


def rows(
    work: Work, tasks: Iterable[Task], out: Path | None = None, jobs: int = 1, about: Mapping[str, Any] = {}
) -> list[Row]:
    """Return a row for each task, in order: {"task": [...], ...} with the result of `work`.

    With a file `out` (one JSON object per line), its rows are not made again, unless they were made with other
    options `about`. With one job the tasks run in this process.
    """
    wanted, options = list(tasks), json.loads(json.dumps(about))
    done = {tuple(row["task"]): row for row in _kept(out) if FAILED not in row and row.get("about", {}) == options}
    left = [task for task in wanted if task not in done]
    scratch()  # create the folder in this process, which removes it at its end
    for made in map(partial(_row, work), left) if jobs == 1 else _in_turn(work, left, jobs):
        row = {**made, "about": options} if options else made
        done[tuple(row["task"])] = row
        click.echo(f"{row['task']}{' FAILED: ' + row[FAILED] if FAILED in row else ''}", err=True)
        if out is not None:
            with out.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")
    return [done[task] for task in wanted]


def _kept(out: Path | None) -> list[Row]:
    """Return the rows in a file, and remove an incomplete last line from it."""
    if out is None or not out.exists():
        return []
    lines = out.read_text(encoding="utf-8").splitlines(keepends=True)
    if lines and not lines[-1].endswith("\n"):
        out.write_text("".join(lines[:-1]), encoding="utf-8")
    return [json.loads(line) for line in lines if line.endswith("\n")]


def _in_turn(work: Work, tasks: Iterable[Task], jobs: int) -> Iterator[Row]:
    for task, found in in_processes(partial(_row, work), tasks, jobs):
        died = isinstance(found, RuntimeError)
        yield {"task": list(task), FAILED: f"the process died: {found}"} if died else found


def _row(work: Work, task: Task) -> Row:
    try:
        return {"task": list(task), **work(*task)}
    except Exception as error:  # any error; the other tasks go on
        where = traceback.extract_tb(error.__traceback__)[-1]
        return {"task": list(task), FAILED: f"{type(error).__name__}: {error} ({where.name}, line {where.lineno})"}


def well(found: Iterable[Row]) -> list[Row]:
    """Return the rows of tasks that did not fail."""
    return [row for row in found if FAILED not in row]


def failures(found: Iterable[Row]) -> list[str]:
    """Return a line for each task that failed."""
    return [f"failed: {' '.join(map(str, row['task']))}: {row[FAILED]}" for row in found if FAILED in row]


def by_case(found: Iterable[Row]) -> dict[str, list[Row]]:
    """Return the rows of each case, the first part of a task."""
    cases: dict[str, list[Row]] = {}
    for row in found:
        cases.setdefault(row["task"][0], []).append(row)
    return cases


def table(head: Sequence[str], lines: Iterable[Sequence[Any]], right: str = "") -> list[str]:
    """Return a Markdown table; `right` has the indices of right-aligned columns, such as "123"."""
    rule = ("--:" if str(i) in right else "---" for i in range(len(head)))
    words = [" | ".join(map(str, cells)) for cells in (head, *lines)]
    return [f"| {words[0]} |", f"|{'|'.join(rule)}|", *(f"| {line} |" for line in words[1:])]


def option(*names: str, **how: Any) -> click.Option:
    """Return an option for `command`."""
    return click.Option(names, show_default=True, **how)


def command(
    work: Work,
    table: Callable[[list[Row]], Iterable[str]],
    cases: Iterable[str] = (),
    *,
    drives: int = 20,
    first: int = FIRST_SEED,
    options: Sequence[click.Option] = (),
) -> click.Command:
    """Return a command that runs `work` on every case and seed and prints `table` of the rows that did not fail.

    `work` is called with (case, seed) and the values of `options`; case or seed is left out if there is none.
    With `drives` = 0 the cases are recorded logs, without seeds.
    """

    def main(
        words: tuple[str, ...], jobs: int, out: Path | None, drives: int = 0, first: int = 0, **more: Any
    ) -> None:
        names: list[Task] = [(name,) for name in cases if not words or any(word in name for word in words)] or [()]
        seeds: list[Task] = [(seed,) for seed in range(first, first + drives)] or [()]
        tasks = [(*name, *seed) for seed in seeds for name in names]
        made = rows(partial(work, **more), tasks, out, jobs, about=more)
        click.echo("\n".join([*table(well(made)), *failures(made)]))

    of_seeds = [
        option("--drives", "--seeds", "drives", default=drives),
        option("--first", default=first, help="The first seed."),
    ]
    usual = [
        *(of_seeds if drives else ()),
        option("--case", "--log", "words", multiple=True, help="Only cases whose name holds this. Repeatable."),
        option("--jobs", default=2),
        option("-o", "out", type=click.Path(path_type=Path), help="File of rows: goes on where it stopped."),
    ]
    return click.Command(None, callback=main, params=[*usual, *options], help="Print a table over drives.")
