"""A job: one log, what is asked of it, and how it ended. Plain values, so that another machine can run it."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import msgspec

from locfuse.cli.analysis.settings import Asked, LogOptions, Outputs
from locfuse.cli.rerun.recordings import Recording


class FleetOptions(msgspec.Struct, frozen=True):
    """What is asked of many logs beyond a single one."""

    jobs: int = 1  # at once
    max_failures: int | None = None
    again: bool = False
    each: tuple[str, ...] = ()  # folders
    robot_from: str | None = None
    sweep: tuple[str, ...] = ()  # as typed: "lrf.sigma_range=0.01,0.03"
    cluster: str | None = None

    @property
    def asked(self) -> bool:
        """Whether even a single log is treated as one of many."""
        return bool(self.each or self.robot_from or self.sweep or self.again or self.cluster)


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
    recording: Recording | None = None
    again: bool = False  # run it even where its results are there

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
