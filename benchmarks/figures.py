"""What is measured, against what, and how good it must be."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

Command = tuple[str, ...]


class Logs(NamedTuple):
    """The logs that figures are taken on."""

    minute: Path  # with pictures
    ten: Path  # ten minutes of compass and laser
    hour: Path
    building: Path | None = None  # a recorded one (aces), where LOCFUSE_DATA has it


class Figure(NamedTuple):
    """Two whole processes, ours and the yardstick, and the ratio of their CPU times that is the goal."""

    name: str
    goal: float
    ours: Command
    theirs: Command
    peak: float | None = None  # MB: our peak memory is a figure too


class Kernel(NamedTuple):
    """Two inner loops in one process (benchmarks.kernels) and the goal for their ratio."""

    name: str
    goal: float
    command: Command


MINUTE = ("--minutes", "1", "--image-hz", "10")
TEN = ("--minutes", "10")
FROZEN = ("--set", "lrf.map=first-scan")


def module(name: str, *words: str | Path) -> Command:
    """Return the command that runs a module of this folder."""
    return (sys.executable, "-m", f"benchmarks.{name}", *map(str, words))


def locfuse(*words: str | Path) -> Command:
    """Return a command line of the product."""
    return (sys.executable, "-m", "locfuse.cli", *map(str, words))


def figures(logs: Logs, out: Path, length: str) -> list[Figure]:
    """Return what is measured in whole processes; `length` is that of the long log, in words."""
    advised = ("--write", "json", "--quiet", "--overwrite", "--no-smooth", "--out", out)
    how = (*advised, "--no-advice")  # how often advice fuses again depends on what looks wrong with the log
    stock, stock_minute = decoded(logs.hour), decoded(logs.minute)
    ours = module("decode", "ours", logs.hour)
    one = locfuse("run", logs.hour, *FROZEN, *how)
    five = locfuse("compare", logs.hour, *FROZEN, *how)
    recorded = (*five, "--rerun-save", f"{out}.rrd")
    pictures = locfuse("compare", logs.minute, *how)
    ten = locfuse("compare", logs.ten, *how)
    buildings = [] if logs.building is None else [of_building(logs.building, how)]
    return [
        Figure("60 s, 600 pictures: five configurations / stock", 1.40, pictures, stock_minute),
        Figure("60 s, 600 pictures: five configurations / one", 1.25, pictures, locfuse("run", logs.minute, *how)),
        Figure(f"{length}: one configuration, frozen map / stock", 0.35, one, stock),
        Figure(f"{length}: five configurations, frozen map / stock", 0.50, five, stock, peak=200.0),
        Figure(f"{length}: five configurations with a Rerun recording / without", 1.5, recorded, five, peak=340.0),
        Figure(
            f"{length}: five configurations with advice / without",
            3.0,
            locfuse("compare", logs.hour, *FROZEN, *advised),
            five,
        ),
        Figure(f"{length}: one configuration, `grow` / stock", 0.45, locfuse("run", logs.hour, *how), stock),
        Figure(f"{length}: reading and decoding / stock", 0.10, ours, stock),
        Figure(f"{length}: reading and decoding / rosbags", 0.35, ours, module("decode", "rosbags", logs.hour)),
        Figure(f"{length}: five configurations / one", 1.50, five, one),
        Figure("10 min, compass and laser: `compare`, `grow` / stock", 0.50, ten, decoded(logs.ten)),
        *buildings,
        Figure(
            "`locfuse --help` / `import click`", 1.50, locfuse("--help"), (sys.executable, "-c", "import click")
        ),
    ]


def of_building(log: Path, how: Sequence[str | Path]) -> Figure:
    """Return what comparing a recorded building costs."""
    return Figure(f"{log.stem}, a building: `compare` / stock", 15.0, locfuse("compare", log, *how), decoded(log))


def decoded(log: Path) -> Command:
    """Return the yardstick of a log."""
    return module("decode", "stock", log)


def kernels(logs: Logs) -> list[Kernel]:
    """Return the inner loops that are measured."""
    return [
        Kernel("EKF step, predict + heading / filterpy", 0.30, module("kernels", "ekf_heading", logs.minute)),
        Kernel(
            "EKF step, predict + six lines, matched and recorded / filterpy",
            0.30,
            module("kernels", "ekf_lines", logs.minute),
        ),
        Kernel("lines of a 361-beam scan / small_gicp ICP", 0.025, module("kernels", "lines", logs.minute)),
        Kernel("omni bearing, decoding included / imdecode", 0.90, module("kernels", "omni", logs.minute)),
    ]
