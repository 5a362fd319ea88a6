"""A job: one log, what is asked of it, and what became of it. Plain values, so that another machine can run it."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import msgspec

from locfuse.cli.analysis.key import Asked
from locfuse.cli.analysis.settings import LogOptions
from locfuse.cli.rerun.recordings import Recording

State = Literal["done", "failed"]


class Cell(msgspec.Struct, frozen=True):
    """One cell of a sweep: settings on top of the job's own. Without a sweep there is one without a name."""

    name: str = ""  # "lrf.sigma_range=0.03 compass.sigma_deg=2"
    sets: tuple[str, ...] = ()


class Job(msgspec.Struct, frozen=True, kw_only=True):
    """One log to be compared into a folder of its own."""

    name: str
    log: tuple[str, ...]  # its parts
    folder: str  # of its results; a sweep's cells have folders in it
    group: str | None = None  # the robot that it is of
    robot: str | None = None  # robot.toml
    sets: tuple[str, ...] = ()
    order: str | None = None
    preset: str | None = None
    begin: float | None = None  # s since the first wheel reading: only what comes later is used
    end: float | None = None  # s: only what comes earlier
    hash_all: bool = False
    asked: Asked
    kinds: tuple[str, ...]  # of output
    export: tuple[str, ...] = ()
    figures: str | None = None  # folder
    overwrite: bool = False
    cells: tuple[Cell, ...] = (Cell(),)
    recording: Recording | None = None
    again: bool = False  # run it even where its results are there
    within: str | None = None  # the folder that paths are meant from; None: the current one

    @property
    def how(self) -> LogOptions:
        """How its log is read."""
        robot = None if self.robot is None else Path(self.robot)
        return LogOptions(
            robot,
            self.sets,
            self.order,
            strict=False,
            quiet=True,
            preset=self.preset,
            begin=self.begin,
            end=self.end,
            hash_all=self.hash_all,
        )

    def recording_of(self, cell: Cell) -> str:
        """Return the name of a cell's recording."""
        return f"{self.name},{cell.name.replace(' ', ',')}" if cell.name else self.name

    def place(self, cell: Cell) -> Path:
        """Return the folder of a cell's results."""
        return Path(self.folder) / cell.name.replace(" ", ",") if cell.name else Path(self.folder)


class Outcome(msgspec.Struct, frozen=True):
    """What became of a job. Its results are in its folder."""

    name: str
    state: State
    reason: str = ""  # why it failed, in one line
    misused: bool = False  # it failed by what was asked for, not by the log
    resumed: bool = False  # its results were there already
    warnings: tuple[str, ...] = ()  # what did not work beside its results
