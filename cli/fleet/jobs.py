"""Jobs of a fleet: from the command line to jobs, and from their folders to rows of the summary.

A job consists of plain values, so another machine can run it. A job is skipped if its results are complete: each
report.json has the key that this run would write, all its files exist, and the log is older.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import msgspec
from msgspec.structs import replace

from locfuse.cli.advice.together import ask
from locfuse.cli.analysis.gates import Gates
from locfuse.cli.analysis.grouping import logs_of, named
from locfuse.cli.analysis.load import find_log
from locfuse.cli.analysis.results import lost_in
from locfuse.cli.analysis.robot_tables import given_layers, given_tables, key
from locfuse.cli.analysis.settings import OF_COMPARISON, Asked, LogOptions, Outputs, cells, swept
from locfuse.cli.rerun.record import file_in
from locfuse.formats.inputs import MAX_REPORT, read_small
from locfuse.formats.logs.files import files_of, identity_of
from locfuse.formats.report.fleet import Entry, slim
from locfuse.formats.whole_files import TEMPORARY
from locfuse.fusion.checks.together import Look
from locfuse.fusion.checks.tried import Fixes
from locfuse.fusion.data import LocfuseError, UsageError

ROBOT_PLACEHOLDER = "{robot}"  # in --robot: replaced by the robot's name
REPORT_IS_GONE = "its report.json is gone or cannot be read; run it again with --again"
REPORT = "report.json"
OTHER_FILES = ("robot.toml", "estimates.mcap")  # files of a result beside the kinds of output
OF_KIND = {kind: f"report.{kind}" for kind in OF_COMPARISON if kind != "tum"}


class SweepCell(msgspec.Struct, frozen=True):
    """One combination of swept settings, added to the job's settings; without a sweep one unnamed cell."""

    name: str = ""  # "lrf.sigma_range=0.03 compass.sigma_deg=2"
    sets: tuple[str, ...] = ()

    @property
    def folder(self) -> str:
        """The name of the cell's folder."""
        return self.name.replace(" ", ",")


class Job(msgspec.Struct, frozen=True):
    """The comparison of one log, with its options and its folder of results."""

    name: str
    log: tuple[str, ...]  # its parts
    folder: Path  # of results; cells of a sweep have subfolders
    how: LogOptions
    asked: Asked
    outputs: Outputs
    robot: str | None = None  # the log's robot
    cells: tuple[SweepCell, ...] = (SweepCell(),)
    recordings: Path | None = None  # folder of the drives' recordings
    again: bool = False  # run it even if its results are complete
    tries: tuple[Fixes, ...] = ()  # settings to fuse the log under, instead of a comparison
    refused: str = ""  # why it is not run, such as a missing log

    def recording_of(self, cell: SweepCell) -> str:
        """Return the name of a cell's Rerun recording."""
        return f"{self.name},{cell.folder}" if cell.name else self.name

    def place(self, cell: SweepCell) -> Path:
        """Return the folder of a cell's results."""
        return self.folder / cell.folder


class JobOutcome(msgspec.Struct, frozen=True):
    """The outcome of a job; its results are in its folder."""

    name: str
    state: Literal["done", "failed"]
    reason: str = ""  # why it failed, in one line
    misused: bool = False  # failed because of an option, not the log
    resumed: bool = False  # skipped, since its results were complete
    warnings: tuple[str, ...] = ()  # such as a recording that could not be written
    looks: Mapping[Fixes, Look] = {}  # figures under the settings in `tries`


def is_finished(job: Job) -> bool:
    """Return whether a job's results are complete. Raises LocfuseError if its log or settings cannot be read."""
    if job.again or job.tries or job.outputs.export or job.outputs.figures is not None:
        return False  # exports and figures are not checked
    reports = [read_report(job.place(cell)) for cell in job.cells]
    if None in reports:
        return False
    files = files_of(find_log(job.log))
    content = identity_of(files)
    changed_ns = max((file.stat().st_mtime_ns for file in files if isinstance(file, Path)), default=0)
    return all(
        report.get("key") == key(content, given_tables(job.how, cell.sets), job.asked)
        and _is_complete(job, cell, report, changed_ns)
        for cell, report in zip(job.cells, filter(None, reports), strict=True)
    )


def _is_complete(job: Job, cell: SweepCell, report: Mapping[str, Any], changed_ns: int) -> bool:
    """Return whether a result's files exist and are newer than the log, and the recording is newer still."""
    folder = job.place(cell)
    written_ns = (folder / REPORT).stat().st_mtime_ns
    names = [OF_KIND[kind] for kind in job.outputs.write if kind in OF_KIND]
    names += [f"{name}.tum" for name in report["configurations"]] if "tum" in job.outputs.write else []
    if written_ns < changed_ns or not all((folder / name).is_file() for name in names):
        return False
    recording = None if job.recordings is None else file_in(job.recordings, job.recording_of(cell))
    return recording is None or (recording.is_file() and recording.stat().st_mtime_ns >= written_ns)


def is_replaceable(folder: Path) -> bool:
    """Return whether a folder has only files of a result, or only cells of a sweep, so that it may be replaced.

    A report is not needed: a killed run and the folder of a sweep have none.
    """
    known = {*OF_KIND.values(), *OTHER_FILES}
    return not folder.is_dir() or all(
        path.name in known
        or path.name.endswith((".tum", TEMPORARY))
        or (path.is_dir() and ((path / REPORT).is_file() or is_replaceable(path)))
        for path in folder.iterdir()
    )


def read_report(folder: Path) -> dict[str, Any] | None:
    """Return the report in a folder; None if it is missing or incomplete."""
    try:
        report = json.loads(read_small(folder / REPORT, MAX_REPORT))
        return report if isinstance(report["configurations"], dict) and isinstance(report["input"], dict) else None
    except (LocfuseError, ValueError, KeyError, TypeError, RecursionError):
        return None


def plan(words: Sequence[str], every: Job, robot_from: str | None, sweeps: Sequence[str]) -> dict[str, Job]:
    """Return a job for each log in `words`: the job `every` with the log, its name, its folder, or its refusal.

    Raises UsageError for invalid settings, an invalid pattern or an invalid sweep.
    """
    robot_of = _robot_by(robot_from, every.how.robots)
    fixed = tuple(file for file in every.how.robots if ROBOT_PLACEHOLDER not in str(file))
    given_layers(replace(every.how, robots=fixed))
    of_sweep = tuple(SweepCell(*found) for found in cells(swept(sweeps)).items()) if sweeps else every.cells
    for cell in of_sweep:
        given_layers(replace(every.how, robots=()), cell.sets)
    figures, jobs = every.outputs.figures, {}
    for name, log in named(logs_of(words)).items():
        jobs[name] = job = replace(
            every,
            name=name,
            log=tuple(log),
            folder=every.folder / name,
            outputs=replace(every.outputs, figures=figures and figures / name),
            robot=robot_of(log[0]),
            cells=of_sweep,
        )
        try:
            find_log(log)
            files = tuple(_file_of(file, job.robot) for file in every.how.robots)
            jobs[name] = replace(job, how=replace(job.how, robots=files))
        except UsageError as problem:
            jobs[name] = replace(job, refused=str(problem))
    return jobs


def _robot_by(text: str | None, files: Sequence[Path]) -> Callable[[str], str | None]:
    """Return a function from a log's path to its robot or None, by --robot-from, which must be valid."""
    if text is None:
        if unnamed := [file for file in files if ROBOT_PLACEHOLDER in str(file)]:
            raise UsageError(f"--robot {unnamed[0]}: say how a log's path names its robot with --robot-from REGEX")
        return lambda path: None
    try:
        pattern = re.compile(text)
    except re.error as problem:
        raise UsageError(f"--robot-from {text!r}: not a regular expression: {problem}") from None
    if not pattern.groups:
        fix = "put the robot's name in a group, such as 'fleet/(?P<robot>[^/]+)/'"
        raise UsageError(f"--robot-from {text!r}: {fix}")

    def robot_of(path: str) -> str | None:
        found = pattern.search(path) or pattern.search(Path(path).resolve().as_posix())
        return found and found["robot" if "robot" in pattern.groupindex else 1]

    return robot_of


def _file_of(file: Path, robot: str | None) -> Path:
    """Return a robot.toml with the robot's name in its path. Raises UsageError if it does not exist."""
    if ROBOT_PLACEHOLDER not in str(file):
        return file
    if robot is None or "/" in robot or robot.startswith("."):
        raise UsageError(f"--robot-from finds no robot in its path, and --robot {file} needs one")
    found = Path(str(file).replace(ROBOT_PLACEHOLDER, robot))
    if not found.is_file():
        raise UsageError(f"--robot {file}: {found} is no file")
    return found


class FleetRows(msgspec.Struct, frozen=True):
    """The rows of a fleet's summary, and lines of text on gates and losses."""

    entries: list[Entry] = []
    gates: list[str] = []  # a line per gate that a log fails
    lost: list[str] = []  # a line per loss of a log

    def add(self, job: Job, gates: Gates, strict: bool) -> None:
        """Add the row of a finished job by the reports in its folder, its failed gates and its losses."""
        reports = {cell.name: read_report(job.place(cell)) for cell in job.cells}
        whole = {cell: report for cell, report in reports.items() if report is not None}
        if len(whole) < len(reports):
            self.entries.append(Entry(job.name, job.robot, "failed", REPORT_IS_GONE))
            return
        lost: list[str] = []
        for cell, report in whole.items():
            title = f"{job.name} [{cell}]" if cell else job.name
            self.gates.extend(f"{title}: {line}" for line in gates.failures(report))
            lost = lost_in(report, strict) or lost
        self.lost.extend(f"{job.name}: {line}" for line in lost)
        self.entries.append(Entry(job.name, job.robot, report=slim(whole), cells=tuple(whole)))


def robots(
    entries: Sequence[Entry], jobs: Mapping[str, Job], run: Callable[[Sequence[Job]], Mapping[str, JobOutcome]]
) -> list[dict[str, Any]]:
    """Return for each robot with several logs the values that they share, and settings that help all."""
    of: dict[str | None, dict[str, Mapping[str, Any]]] = {}
    for e in entries:
        if e.report.get("measured"):
            of.setdefault(e.robot, {})[e.name] = e.report["measured"]

    def look(names: Sequence[str], sets: Sequence[Fixes]) -> dict[str, Mapping[Fixes, Look]]:
        ended = run([replace(jobs[name], tries=tuple(sets)) for name in names])
        return {name: ended[name].looks for name in names if name in ended}

    return [{"robot": robot, **ask(logs, look)} for robot, logs in of.items() if len(logs) > 1]
