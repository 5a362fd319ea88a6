"""Experiments of benchmarks/ go on where they stopped, and a task that fails is a row."""

from __future__ import annotations

import json
import os
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from benchmarks import experiment

TASKS = [(name, seed) for seed in (1, 2) for name in ("a", "b", "bad")]


def work(name: str, seed: int, folder: Path) -> dict[str, Any]:
    """Note the call in a file, so that other processes can be asked as well."""
    with (folder / "calls").open("a") as file:
        file.write(f"{name}{seed}\n")
    if name == "bad":
        raise ValueError("no such thing")
    return {"value": f"{name}{seed}", "process": os.getpid()}


def calls(folder: Path) -> list[str]:
    return (folder / "calls").read_text().split()


@pytest.mark.parametrize("jobs", [1, 2])
def test_rows_come_in_the_order_of_the_tasks_and_failures_stand_among_them(tmp_path: Path, jobs: int) -> None:
    found = experiment.rows(partial(work, folder=tmp_path), TASKS, tmp_path / "rows", jobs)
    assert [row["task"] for row in found] == [list(task) for task in TASKS]
    assert [row["value"] for row in experiment.well(found)] == ["a1", "b1", "a2", "b2"]
    assert [line.partition(" (")[0] for line in experiment.failures(found)] == [
        "failed: bad 1: ValueError: no such thing",
        "failed: bad 2: ValueError: no such thing",
    ]
    assert sorted(calls(tmp_path)) == sorted(f"{name}{seed}" for name, seed in TASKS)


def test_what_stands_in_the_file_is_not_done_again_but_what_failed_is(tmp_path: Path) -> None:
    out = tmp_path / "rows"
    first = experiment.rows(partial(work, folder=tmp_path), TASKS[:3], out)
    (tmp_path / "calls").unlink()
    again = experiment.rows(partial(work, folder=tmp_path), TASKS, out)
    assert again[:2] == first[:2]
    assert calls(tmp_path) == ["bad1", "a2", "b2", "bad2"]


def test_a_row_that_was_cut_off_is_made_again(tmp_path: Path) -> None:
    out = tmp_path / "rows"
    whole = experiment.rows(partial(work, folder=tmp_path), TASKS[:2], out)
    out.write_text(out.read_text()[:-9])
    assert experiment.rows(partial(work, folder=tmp_path), TASKS[:2], out) == whole
    assert calls(tmp_path) == ["a1", "b1", "b1"]
    assert [json.loads(line)["value"] for line in out.read_text().splitlines()] == ["a1", "b1"]


def test_tasks_of_one_unit_run_in_one_process(tmp_path: Path) -> None:
    tasks = [(name, seed) for seed in range(4) for name in ("a", "b")]
    found = experiment.rows(partial(work, folder=tmp_path), tasks, jobs=2, unit=lambda task: task[1])
    for a, b in zip(found[::2], found[1::2], strict=True):
        assert a["process"] == b["process"]


def test_a_table_is_put_between_its_marks(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("above\n<!-- drives -->\nold\n<!-- end -->\nbelow\n")
    lines = experiment.table(("what", "mm"), [("a", 1), ("b", 2)], right="1")
    experiment.put(page, "drives", lines)
    table = "| what | mm |\n|---|--:|\n| a | 1 |\n| b | 2 |"
    assert page.read_text() == f"above\n<!-- drives -->\n{table}\n<!-- end -->\nbelow\n"
