"""Many drives into one table: cases x seeds -> rows -> table, resumable, several at a time.

A question of benchmarks/ is a function that makes the row of one task, and one that makes a table of all rows:

    found = experiment.rows(work, [(case, seed) for seed in seeds for case in cases], Path("out.jsonl"), jobs=2)

Most are a command of these two: `main = experiment.command(work, table, CASES)`. `simulated` makes their drives.

`work(*task)` returns a dict that JSON can hold. Every row is appended to the file as soon as it is there; tasks
that the file holds are not done again, so that an experiment can be stopped at any time. A task that raises an
error is a row as well, with the error's words under "failed", and is done again the next time. Delete the file
when the code changes: all rows of a table are of one state of it.
"""

from __future__ import annotations

import itertools
import json
import re
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import click

from locfuse.cli.analysis.robot_tables import make_robot
from locfuse.formats.robot import robot_toml
from locfuse.fusion.data import ArrayStream, Drive
from locfuse.fusion.measure import measure
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.sample_logs.load import load
from locfuse.sample_logs.record import in_memory
from locfuse.sample_logs.simulate import Outcome

FIRST_SEED = 1000  # the shipped logs use small seeds: nothing here has been looked at before
Part = str | int | bool
Task = tuple[Part, ...]
Row = dict[str, Any]
FAILED = "failed"


class Simulated(NamedTuple):
    """A simulated drive in memory, not measured yet."""

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


@lru_cache(maxsize=8)
def simulated(scenario: str, sets: tuple[str, ...], seed: int) -> Simulated:
    """Return a drive of a scenario under more settings of it; tasks in a row often share their drives."""
    topics, tables, outcome = in_memory(load(scenario, sets), seed)
    return Simulated(streams_by_role(topics, tables), tables, outcome)


def streams_by_role(topics: Mapping[str, ArrayStream], tables: Mapping[str, Any]) -> dict[str, ArrayStream]:
    """Return the streams that the robot's tables name."""
    roles = ("wheels", "truth", *REGISTRY)
    return {r: topics[tables[r]["topic"]] for r in roles if r in tables and tables[r].get("topic") in topics}


def rows(
    work: Callable[..., Mapping[str, Any]],
    tasks: Iterable[Task],
    out: Path | None = None,
    jobs: int = 1,
    unit: Callable[[Task], Any] = lambda task: task,
    show: Callable[[Row], str] = lambda row: f"{row['task']}",
    about: Mapping[str, Any] | None = None,
) -> list[Row]:
    """Return the rows of all tasks, in their order: {"task": [...], ...} and what `work` returned.

    Args:
        work: makes one row; with several jobs it must be a function of a module.
        tasks: what it is called with.
        out: a file of rows, one JSON object per line; None: nothing is kept.
        jobs: processes; 1 works in this one.
        unit: neighbouring tasks with the same unit run in the same process, one after the other.
        show: words for stderr when a row is there.
        about: options under which the rows are made; a row of other options is not taken from the file.
    """
    wanted, options = list(tasks), json.loads(json.dumps(about or {}))
    done = {task: row for task, row in _kept(out) if FAILED not in row and row.get("about", {}) == options}
    left = [list(group) for _, group in itertools.groupby((t for t in wanted if t not in done), unit)]
    for made in _made(work, left, jobs):
        row = {**made, "about": options} if options else made
        done[_key(row["task"])] = row
        click.echo(f"{row['task']} FAILED: {row[FAILED]}" if FAILED in row else show(row), err=True)
        if out is not None:
            with out.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")
    return [done[task] for task in wanted]


def _kept(out: Path | None) -> Iterator[tuple[Task, Row]]:
    """Yield the rows of a file; a last line that was cut off while it was written is left out."""
    if out is None or not out.exists():
        return
    lines = out.read_text(encoding="utf-8").splitlines()
    for i, line in enumerate(lines):
        try:
            row = json.loads(line)
        except json.JSONDecodeError:
            if i + 1 < len(lines):
                raise
            out.write_text("".join(f"{whole}\n" for whole in lines[:i]), encoding="utf-8")
            return
        yield _key(row["task"]), row


def _key(parts: Sequence[Part]) -> Task:
    return tuple(parts)


def _made(work: Callable[..., Mapping[str, Any]], units: list[list[Task]], jobs: int) -> Iterator[Row]:
    """Yield the rows of all units of work, as they come."""
    if jobs == 1:
        for task in itertools.chain.from_iterable(units):
            yield _row(work, task)
        return
    with ProcessPoolExecutor(jobs) as pool:
        waiting = {pool.submit(_rows, work, unit): unit for unit in units}
        for future in as_completed(waiting):
            error = future.exception()  # the process died: nobody could make rows of it
            yield from (
                future.result()
                if error is None
                else ({"task": list(task), FAILED: f"{type(error).__name__}: {error}"} for task in waiting[future])
            )


def _rows(work: Callable[..., Mapping[str, Any]], unit: Sequence[Task]) -> list[Row]:
    return [_row(work, task) for task in unit]


def _row(work: Callable[..., Mapping[str, Any]], task: Task) -> Row:
    try:
        return {"task": list(task), **work(*task)}
    except Exception as error:  # whatever it is, the other tasks go on
        where = traceback.extract_tb(error.__traceback__)[-1]
        return {"task": list(task), FAILED: f"{type(error).__name__}: {error} ({where.name}, line {where.lineno})"}


def well(found: Iterable[Row]) -> list[Row]:
    """Return the rows that did not fail."""
    return [row for row in found if FAILED not in row]


def failures(found: Iterable[Row]) -> list[str]:
    """Return a line for each row that failed."""
    return [f"failed: {' '.join(map(str, row['task']))}: {row[FAILED]}" for row in found if FAILED in row]


def table(head: Sequence[str], lines: Iterable[Sequence[Any]], right: str = "") -> list[str]:
    """Return a Markdown table; the columns whose index stands in `right`, such as "123", are aligned right."""
    rule = ("--:" if str(i) in right else "---" for i in range(len(head)))
    return [_line(head), f"|{'|'.join(rule)}|", *map(_line, lines)]


def _line(cells: Sequence[Any]) -> str:
    return f"| {' | '.join(map(str, cells))} |"


def put(page: Path, name: str, lines: Sequence[str]) -> None:
    """Put lines into a page, between <!-- name --> and <!-- end -->."""
    block = re.compile(rf"<!-- {name} -->\n.*?<!-- end -->", re.DOTALL)
    text = page.read_text(encoding="utf-8")
    if not block.search(text):
        raise click.ClickException(f"{page} has no place for {name}")
    whole = "\n".join((f"<!-- {name} -->", *lines, "<!-- end -->"))
    page.write_text(block.sub(lambda _: whole, text), encoding="utf-8")


def command(
    work: Callable[..., Mapping[str, Any]],
    table: Callable[[list[Row]], Iterable[str]],
    cases: Iterable[str] = (),
    *,
    drives: int = 20,
    first: int = FIRST_SEED,
    options: Sequence[click.Option] = (),
) -> click.Command:
    """Return a command that runs `work` on every case and seed and prints `table` of the rows.

    Args:
        work: called with (case, seed), of which either may be missing, and the values of `options`.
        table: returns lines of the rows that did not fail.
        cases: names; `--case` takes those that hold a word.
        drives: seeds, unless `--drives` says another number; 0: cases have none, they are recorded logs.
        first: the first seed.
        options: more options of the command; they change the rows.
    """

    def main(
        words: tuple[str, ...], jobs: int, out: Path | None, drives: int = 0, first: int = 0, **more: Any
    ) -> None:
        names: list[Task] = [(name,) for name in cases if not words or any(word in name for word in words)] or [()]
        seeds: list[Task] = [(seed,) for seed in range(first, first + drives)] or [()]
        tasks = [(*name, *seed) for seed in seeds for name in names]
        made = rows(partial(work, **more), tasks, out, jobs, about=more)
        for line in (*table(well(made)), *failures(made)):
            click.echo(line)

    of_seeds = [
        click.Option(("--drives", "--seeds", "drives"), default=drives, show_default=True),
        click.Option(("--first",), default=first, show_default=True, help="The first seed."),
    ]
    usual = [
        *(of_seeds if drives else ()),
        click.Option(
            ("--case", "--log", "words"), multiple=True, help="Only cases whose name holds this word. Repeatable."
        ),
        click.Option(("--jobs",), default=2, show_default=True),
        click.Option(
            ("-o", "out"), type=click.Path(path_type=Path), help="File of rows: goes on where it stopped."
        ),
    ]
    return click.Command(None, callback=main, params=[*usual, *options], help="Print a table over drives.")


def option(*names: str, **how: Any) -> click.Option:
    """Return an option for `command`."""
    return click.Option(names, show_default=True, **how)
