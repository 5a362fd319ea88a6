"""A job: one log, its options, and its outcome. Plain values, so that another machine can run it.

Results that a job would only repeat are left as they are. They are there when every report.json has the key that
this run would give it, all its files lie beside it, and no file of the log was changed after it was written.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import msgspec

from locfuse.cli.analysis.load import find_log
from locfuse.cli.analysis.robot_tables import given_tables, key
from locfuse.cli.analysis.settings import OF_COMPARISON, Asked, LogOptions, Outputs
from locfuse.cli.rerun.record import file_in
from locfuse.formats.caps import MAX_REPORT
from locfuse.formats.inputs import read_small
from locfuse.formats.logs.files import files_of, identity_of
from locfuse.formats.whole_files import TEMPORARY
from locfuse.fusion.checks.together import Look
from locfuse.fusion.checks.tried import Fixes
from locfuse.fusion.data import LocfuseError


class SweepCell(msgspec.Struct, frozen=True):
    """One cell of a sweep: settings on top of the job's own. Without a sweep there is one without a name."""

    name: str = ""  # "lrf.sigma_range=0.03 compass.sigma_deg=2"
    sets: tuple[str, ...] = ()

    @property
    def folder(self) -> str:
        """The name of its folder."""
        return self.name.replace(" ", ",")


class Job(msgspec.Struct, frozen=True):
    """One log to be compared into a folder of its own."""

    name: str
    log: tuple[str, ...]  # its parts
    folder: Path  # of its results; a sweep's cells have folders in it
    how: LogOptions
    asked: Asked
    outputs: Outputs
    robot: str | None = None  # the one that the log is of
    cells: tuple[SweepCell, ...] = (SweepCell(),)
    recordings: Path | None = None  # folder of the drives' recordings
    again: bool = False  # run it even where its results are there
    tries: tuple[Fixes, ...] = ()  # settings to fuse it under, instead of being compared

    def recording_of(self, cell: SweepCell) -> str:
        """Return the name of a cell's recording."""
        return f"{self.name},{cell.folder}" if cell.name else self.name

    def place(self, cell: SweepCell) -> Path:
        """Return the folder of a cell's results."""
        return self.folder / cell.folder


class JobOutcome(msgspec.Struct, frozen=True):
    """How a job ended. Its results are in its folder."""

    name: str
    state: Literal["done", "failed"]
    reason: str = ""  # why it failed, in one line
    misused: bool = False  # it failed by what was asked for, not by the log
    resumed: bool = False  # its results were there already
    warnings: tuple[str, ...] = ()  # what did not work beside its results
    looks: Mapping[Fixes, Look] = msgspec.field(default_factory=dict)  # what it shows under each of what it tries


REPORT = "report.json"
OTHER_FILES = ("robot.toml", "estimates.mcap")  # files of a result beside the kinds of output
OF_KIND = {kind: f"report.{kind}" for kind in OF_COMPARISON if kind != "tum"}


def is_finished(job: Job) -> bool:
    """Return whether a job's results are complete. Raises LocfuseError if its log or settings cannot be read."""
    if (
        job.again or job.tries or job.outputs.export or job.outputs.figures is not None
    ):  # exports are not looked for
        return False
    if not all((job.place(cell) / REPORT).is_file() for cell in job.cells):
        return False
    if job.recordings is not None and not all(_is_recorded(job, cell) for cell in job.cells):
        return False
    files = files_of(find_log(job.log))
    content = identity_of(files)
    changed = max((file.stat().st_mtime_ns for file in files if isinstance(file, Path)), default=0)
    return all(
        _is_there(job, cell, changed, key(content, given_tables(job.how, cell.sets), job.asked))
        for cell in job.cells
    )


def _is_there(job: Job, cell: SweepCell, changed_ns: int, expected: str) -> bool:
    folder = job.place(cell)
    report = read_report(folder)
    if report is None or report.get("key") != expected:
        return False
    if (folder / REPORT).stat().st_mtime_ns < changed_ns:
        return False
    names = [OF_KIND[kind] for kind in job.outputs.write if kind in OF_KIND]
    names += [f"{name}.tum" for name in report["configurations"]] if "tum" in job.outputs.write else []
    return all((folder / name).is_file() for name in names)


def _is_recorded(job: Job, cell: SweepCell) -> bool:
    """Return whether a result's recording exists and is not older than the result."""
    assert job.recordings is not None
    file, report = file_in(job.recordings, job.recording_of(cell)), job.place(cell) / REPORT
    return file.is_file() and file.stat().st_mtime_ns >= report.stat().st_mtime_ns


def is_replaceable(folder: Path) -> bool:
    """Return whether a folder holds only files of a result, or only a sweep's cells with theirs.

    Such a folder has no report of its own where its writing was ended by force, or where a sweep wrote it.
    """
    known = {*OF_KIND.values(), *OTHER_FILES}
    return not folder.is_dir() or all(
        path.name in known
        or path.name.endswith((".tum", TEMPORARY))
        or (path.is_dir() and ((path / REPORT).is_file() or is_replaceable(path)))
        for path in folder.iterdir()
    )


def read_report(folder: Path) -> dict[str, Any] | None:
    """Return the report of a folder, None if it is missing or incomplete."""
    try:
        report = json.loads(read_small(folder / REPORT, MAX_REPORT))
        return report if isinstance(report["configurations"], dict) and isinstance(report["input"], dict) else None
    except (LocfuseError, ValueError, KeyError, TypeError, RecursionError):
        return None
