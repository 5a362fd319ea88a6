"""From a command line to the jobs of a fleet, and from the jobs' folders to rows."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import msgspec
from msgspec import field
from msgspec.structs import replace

from locfuse.cli.analysis.gates import Gates
from locfuse.cli.analysis.grouping import logs_of, named
from locfuse.cli.analysis.load import find_log
from locfuse.cli.analysis.results import lost_in
from locfuse.cli.analysis.robot_tables import given_layers
from locfuse.cli.analysis.settings import cells, swept
from locfuse.formats.fleet.entry import Entry, slim
from locfuse.fusion.data import UsageError

from .job import Job, JobOutcome, SweepCell, read_report

ROBOT_PLACEHOLDER = "{robot}"  # in --robot: where the name of the robot goes
REPORT_IS_GONE = "its report.json is gone or cannot be read; run it again with --again"


class FleetPlan(msgspec.Struct, frozen=True):
    """Jobs to run, and logs that cannot be opened; all in the order of the command line."""

    robots: dict[str, str | None]  # of each log
    jobs: dict[str, Job]
    refused: dict[str, JobOutcome]


def plan(words: Sequence[str], every: Job, robot_from: str | None, sweeps: Sequence[str]) -> FleetPlan:
    """Return a job for each log in the words, with the options of `every` and a folder of its own.

    Raises UsageError for settings, a pattern or a sweep that fit no log at all.
    """
    pattern = _pattern(robot_from, every.how.robots)
    fixed = tuple(file for file in every.how.robots if ROBOT_PLACEHOLDER not in str(file))
    given_layers(_with_robots(every, fixed).how)
    of_sweep = tuple(SweepCell(*found) for found in cells(swept(sweeps)).items()) if sweeps else every.cells
    for cell in of_sweep:
        given_layers(replace(every.how, robots=(), sets=(*every.how.sets, *cell.sets)))
    figures = every.outputs.figures
    robots: dict[str, str | None] = {}
    jobs, refused = {}, {}
    for name, log in named(logs_of(words)).items():
        robots[name] = robot = None if pattern is None else robot_of(pattern, log)
        try:
            find_log(log)
            jobs[name] = replace(
                _with_robots(every, [_file_of(file, robot) for file in every.how.robots]),
                name=name,
                log=tuple(log),
                folder=every.folder / name,
                outputs=replace(every.outputs, figures=figures and figures / name),
                robot=robot,
                cells=of_sweep,
            )
        except UsageError as problem:
            refused[name] = JobOutcome(name, "failed", str(problem), misused=True)
    return FleetPlan(robots, jobs, refused)


def _with_robots(job: Job, files: Sequence[Path]) -> Job:
    return replace(job, how=replace(job.how, robots=tuple(files)))


def _pattern(text: str | None, files: Sequence[Path]) -> re.Pattern[str] | None:
    """Return the pattern of --robot-from. Raises UsageError if it is invalid, or missing but needed by --robot."""
    if text is None:
        if unnamed := [file for file in files if ROBOT_PLACEHOLDER in str(file)]:
            raise UsageError(f"--robot {unnamed[0]}: say how a log's path names its robot with --robot-from REGEX")
        return None
    try:
        pattern = re.compile(text)
    except re.error as problem:
        raise UsageError(f"--robot-from {text!r}: not a regular expression: {problem}") from None
    if not pattern.groups:
        raise UsageError(
            f"--robot-from {text!r}: put the robot's name in a group, such as 'fleet/(?P<robot>[^/]+)/'"
        )
    return pattern


def robot_of(pattern: re.Pattern[str], log: Sequence[str]) -> str | None:
    """Return a log's robot by its path, as given or in full; None if the pattern does not match."""
    for path in (log[0], Path(log[0]).resolve().as_posix()):
        if found := pattern.search(path):
            return found["robot"] if "robot" in pattern.groupindex else found[1]
    return None


def _file_of(file: Path, robot: str | None) -> Path:
    """Return a robot.toml with the robot's name in its path. Raises UsageError if there is none."""
    if ROBOT_PLACEHOLDER not in str(file):
        return file
    if robot is None or "/" in robot or robot.startswith("."):
        raise UsageError(f"--robot-from finds no robot in its path, and --robot {file} needs one")
    found = Path(str(file).replace(ROBOT_PLACEHOLDER, robot))
    if not found.is_file():
        raise UsageError(f"--robot {file}: {found} is no file")
    return found


class FleetRows(msgspec.Struct, frozen=True):
    """A fleet as rows, and the lines to print about it."""

    entries: list[Entry] = field(default_factory=list)
    gates: list[str] = field(default_factory=list)  # a line per gate that a log fails
    lost: list[str] = field(default_factory=list)  # a line per loss of a log

    @property
    def void(self) -> list[str]:
        """A line per reason why figures of a log are void."""
        return [f"{e.name}: {line}" for e in self.entries for line in e.void]


def gather(
    plan: FleetPlan, outcomes: Mapping[str, JobOutcome], stopped: str, gates: Gates, strict: bool
) -> FleetRows:
    """Read the report of every finished job; the reason for the others is what `stopped` them.

    Results are read from the jobs' folders: the same whether they ran now or long ago.
    """
    found = FleetRows()
    for name, robot in plan.robots.items():
        outcome = outcomes.get(name) or plan.refused.get(name)
        if outcome is None:
            found.entries.append(Entry(name, robot, "not run", stopped))
        elif outcome.state == "failed":
            found.entries.append(Entry(name, robot, "failed", outcome.reason))
        else:
            found.entries.append(_entry(plan.jobs[name], found, gates, strict))
    return found


def _entry(job: Job, found: FleetRows, gates: Gates, strict: bool) -> Entry:
    """Return the short form of one log; its full report is freed."""
    reports = {cell.name: read_report(job.place(cell)) for cell in job.cells}
    whole = {cell: report for cell, report in reports.items() if report is not None}
    if len(whole) < len(reports):
        return Entry(job.name, job.robot, "failed", REPORT_IS_GONE)
    lost: list[str] = []
    for cell, report in whole.items():
        title = f"{job.name} [{cell}]" if cell else job.name
        found.gates.extend(f"{title}: {line}" for line in gates.failures(report))
        lost = lost_in(report, strict) or lost
    found.lost.extend(f"{job.name}: {line}" for line in lost)
    return Entry(job.name, job.robot, report=slim(whole), cells=tuple(whole))
