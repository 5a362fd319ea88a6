"""The plan: which jobs the words of a command line make."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import msgspec

from locfuse.cli.analysis.grouping import logs_of
from locfuse.cli.analysis.key import Asked
from locfuse.cli.analysis.load import find_log
from locfuse.cli.analysis.settings import LogOptions
from locfuse.cli.rerun.recordings import Recording
from locfuse.cli.session import sweep
from locfuse.formats.logs.files import log_name
from locfuse.formats.visible import writable
from locfuse.fusion.data import UsageError

from .job import Cell, Job, Outcome
from .robots import Robots


class Wanted(msgspec.Struct, frozen=True):
    """What is asked of every log of a fleet."""

    how: LogOptions
    asked: Asked
    kinds: frozenset[str]
    export: frozenset[str]
    figures: Path | None
    overwrite: bool
    again: bool
    robots: Robots
    recording: Recording | None = None
    sweep: tuple[str, ...] = ()  # as typed: "lrf.sigma_range=0.01,0.03"

    @property
    def cells(self) -> tuple[Cell, ...]:
        """The cells of the sweep; one without a name where there is none. Raises UsageError."""
        if not self.sweep:
            return (Cell(),)
        return tuple(Cell(name, sets) for name, sets in sweep.cells(sweep.parse(self.sweep)).items())

    @property
    def swept(self) -> tuple[str, ...]:
        """The keys that a sweep varies."""
        return tuple(sweep.parse(self.sweep))


class Plan(msgspec.Struct, frozen=True):
    """Jobs to run, and logs that cannot even be tried; together in the order in which they were named."""

    names: tuple[str, ...]
    jobs: dict[str, Job]
    refused: dict[str, Outcome]
    groups: dict[str, str | None]  # the robot of each log


def plan(words: Sequence[str], wanted: Wanted, folder: Path) -> Plan:
    """Return the jobs that words name, each with a folder of its own below `folder`."""
    logs = named(logs_of(words))
    jobs, refused, groups = {}, {}, {}
    cells = wanted.cells
    for name, log in logs.items():
        groups[name] = group = wanted.robots.name(log)
        try:
            find_log(log)
            jobs[name] = _job(name, log, group, wanted, folder, cells)
        except UsageError as problem:
            refused[name] = Outcome(name, "failed", str(problem), misused=True)
    return Plan(tuple(logs), jobs, refused, groups)


def _job(
    name: str, log: Sequence[str], group: str | None, wanted: Wanted, folder: Path, cells: tuple[Cell, ...]
) -> Job:
    how = wanted.how
    return Job(
        name=name,
        log=tuple(log),
        folder=str(folder / name),
        group=group,
        robot=wanted.robots.file(group),
        sets=how.sets,
        order=how.order,
        preset=how.preset,
        begin=how.begin,
        end=how.end,
        hash_all=how.hash_all,
        asked=wanted.asked,
        kinds=tuple(sorted(wanted.kinds)),
        export=tuple(sorted(wanted.export)),
        figures=None if wanted.figures is None else str(wanted.figures / name),
        overwrite=wanted.overwrite,
        cells=cells,
        recording=wanted.recording,
        again=wanted.again,
    )


def named(logs: Sequence[Sequence[str]]) -> dict[str, Sequence[str]]:
    """Return the logs by a name for the folder of each; of equal names the later ones are numbered."""
    found: dict[str, Sequence[str]] = {}
    numbers: dict[str, int] = {}
    for parts in logs:
        name = stem = _name(parts)
        while name in found:
            numbers[stem] = numbers.get(stem, 1) + 1
            name = f"{stem}_{numbers[stem]}"
        found[name] = parts
    return found


def _name(parts: Sequence[str]) -> str:
    try:
        return log_name(find_log(parts))
    except UsageError:  # no such file: it will be a row that says so
        return writable(Path(parts[0]).stem) or "log"
