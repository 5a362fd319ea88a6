"""Many drives into one table: cases x seeds -> rows -> table, resumable, several at a time.

A question of benchmarks/ is a function that makes the row of one task, and one that makes a table of all rows:

    found = experiment.rows(work, [(case, seed) for seed in seeds for case in cases], Path("out.jsonl"), jobs=2)

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
from pathlib import Path
from typing import Any

import click

Part = str | int | bool
Task = tuple[Part, ...]
Row = dict[str, Any]
FAILED = "failed"


def rows(
    work: Callable[..., Mapping[str, Any]],
    tasks: Iterable[Task],
    out: Path | None = None,
    jobs: int = 1,
    unit: Callable[[Task], Any] = lambda task: task,
    show: Callable[[Row], str] = lambda row: f"{row['task']}",
) -> list[Row]:
    """Return the rows of all tasks, in their order: {"task": [...], ...} and what `work` returned.

    Args:
        work: makes one row; with several jobs it must be a function of a module.
        tasks: what it is called with.
        out: a file of rows, one JSON object per line; None: nothing is kept.
        jobs: processes; 1 works in this one.
        unit: neighbouring tasks with the same unit run in the same process, one after the other.
        show: words for stderr when a row is there.
    """
    wanted = list(tasks)
    done = {task: row for task, row in _kept(out) if FAILED not in row}
    left = [list(group) for _, group in itertools.groupby((t for t in wanted if t not in done), unit)]
    for row in _made(work, left, jobs):
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
