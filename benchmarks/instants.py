"""What an instant of the filter costs: python -m benchmarks.instants. A markdown table, with the goals beside it.

Microseconds are medians of `Filter.advance` over all instants of a kind, with the kernels as they are installed.
Files and calls are those of the median instant in the first minute, counted in a second process whose kernels are
interpreted: a profiler does not see calls of compiled ones. Each entry into a kernel counts as one call of C.
"""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

import click

import locfuse
from benchmarks import golden_cases
from benchmarks.__main__ import TEN, module
from benchmarks.mutants import first_on_path, laid_out
from locfuse.fusion.fuse import Filter, due_readings, steps_of
from locfuse.fusion.kernels import uncompiled

COUNTED_S = 60.0  # of a drive: interpreted kernels take their time
SOURCES = Path(uncompiled.__file__).parent
KERNELS = {uncompiled.__file__} | {str(path.with_suffix(".py")) for path in SOURCES.glob("*.pxd")}
SCAN, ONE, FEW = "20 us, 12 files, 50 calls of Python", "5 us", "10 us"  # goals: at most


class Kind(NamedTuple):
    """Instants of one drive, under one set of sensors, at which just these readings are due."""

    name: str
    log: str
    sensors: list[str]
    due: list[str]
    goal: str = ""


EVERY, BOTH = "every_5", ["compass", "lrf"]  # a simulated drive with all sensors (benchmarks.golden_cases)
KINDS = (
    Kind("compass and a scan", "ten", BOTH, BOTH, SCAN),
    Kind("a heading", "ten", BOTH, ["compass"], ONE),
    Kind("nothing due", "ten", BOTH, []),
    *(Kind(s, EVERY, [s], [s], FEW) for s in ("gps", "pose", "twist", "landmarks")),
    Kind("gyro", EVERY, ["gyro"], ["gyro"], ONE),
    Kind("sonar, in the laser's map", EVERY, ["lrf", "sonar"], ["sonar"], ONE),
)


class Calls:
    """Calls of one instant, by a profiler: files of the product, calls of Python, calls of C."""

    def __init__(self) -> None:
        self.files, self.python, self.c = set[str](), 0, 0

    def __call__(self, frame: FrameType, event: str, what: Any) -> None:
        """Count one event."""
        file, caller = frame.f_code.co_filename, frame.f_back.f_code.co_filename if frame.f_back else ""
        if event == "c_call":
            self.c += file not in KERNELS and what is not sys.setprofile
        elif event == "call":
            self.files |= {file} if str(SOURCES.parent) in file and file != uncompiled.__file__ else set()
            self.python += file not in KERNELS
            self.c += file in KERNELS and caller not in KERNELS


@cache
def loaded(log: Path, seconds: float | None) -> locfuse.Session:
    """Return a measured drive, or its beginning."""
    sets = (*golden_cases.TOPICS, f"landmarks.file={log.with_suffix('.csv')}") if log.stem == EVERY else ()
    return locfuse.load(log, sets=sets, between=(None, seconds))


def instants(kind: Kind, folder: Path, count: bool) -> Iterator[tuple[float, int, int, int]]:
    """Fuse the drive; yield time [us], files, calls of Python and of C of every instant of this kind."""
    session = loaded(folder / f"{kind.log}.mcap", COUNTED_S if count else None)
    run, drive, steps = Filter(session.robot, kind.sensors), session.drive, steps_of(session.drive)
    for k, due in enumerate(due_readings(drive, kind.sensors)):
        calls = Calls()
        sys.setprofile(calls if count else None)
        begin = time.perf_counter()
        run.advance(k, steps, due, drive.measurements)
        took = time.perf_counter() - begin
        sys.setprofile(None)
        if [sensor for sensor, _ in due] == kind.due:
            yield 1e6 * took, len(calls.files), calls.python, calls.c


@click.command()
@click.option("--folder", type=click.Path(file_okay=False, path_type=Path), help="Where logs are made, and kept.")
@click.option("--count", is_flag=True, help="Print files and calls as JSON: the second process.")
def main(folder: Path | None, count: bool) -> None:
    """Print the table."""
    if count:
        found = [sorted(instants(kind, folder or Path(), count), key=lambda each: each[2]) for kind in KINDS]
        click.echo(json.dumps([each[len(each) // 2][1:] for each in found]))
        return
    with tempfile.TemporaryDirectory() as temporary:
        where, package = folder or Path(temporary), laid_out(Path(temporary))
        if not (where / "ten.mcap").exists():
            subprocess.run(module("make_log", where / "ten.mcap", *TEN), check=True)
        golden_cases.simulate(where, EVERY)
        command = module("instants", "--count", "--folder", where)
        done = subprocess.run(command, env=first_on_path(package), stdout=subprocess.PIPE, check=True)
        click.echo("| instant | us | files | calls of Python | calls of C | goal |\n|---|--:|--:|--:|--:|---|")
        for kind, counts in zip(KINDS, json.loads(done.stdout), strict=True):
            us = statistics.median(each[0] for each in instants(kind, where, count=False))
            click.echo(f"| {kind.name} | {us:.1f} | {' | '.join(map(str, counts))} | {kind.goal} |")


if __name__ == "__main__":
    main()
