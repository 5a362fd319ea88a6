"""CPU time of one update of the filter: python -m benchmarks.instants. A Markdown table with goals.

The times are medians of `Filter.advance` over all update times of a kind, with the installed kernels.
"""

import time
from functools import cache
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np

import locfuse
from benchmarks import experiment, golden_cases
from benchmarks.__main__ import make_log
from locfuse.fusion.fuse import Filter, due_readings, steps_of


class Kind(NamedTuple):
    """Updates of one drive with certain sensors: those at which exactly the readings `due` are used."""

    name: str
    log: str
    sensors: list[str]
    due: list[str]
    goal: str = ""  # us, at most


EVERY, BOTH = "every_5", ["compass", "lrf"]  # a simulated drive with all sensors (benchmarks.golden_cases)
KINDS = (
    Kind("a scan", "ten", BOTH, ["lrf"], "20"),
    Kind("a heading", "ten", BOTH, ["compass"], "5"),
    Kind("nothing due", "ten", BOTH, []),
    *(Kind(s, EVERY, [s], [s], "10") for s in ("gps", "pose", "twist", "landmarks")),
    Kind("gyro", EVERY, ["gyro"], ["gyro"], "5"),
    Kind("sonar, in the laser's map", EVERY, ["lrf", "sonar"], ["sonar"], "5"),
)


@cache
def loaded(log: Path) -> locfuse.Session:
    sets = (*golden_cases.TOPICS, f"landmarks.file={log.with_suffix('.csv')}") if log.stem == EVERY else ()
    return locfuse.load(log, sets=sets)


def microseconds(kind: Kind, folder: Path) -> float:
    """Fuse the drive and return the median time [us] of an update of this kind."""
    session = loaded(folder / f"{kind.log}.mcap")
    run, drive, steps, found = Filter(session.robot, kind.sensors), session.drive, steps_of(session.drive), []
    for k, due in enumerate(due_readings(drive, kind.sensors)):
        begin = time.perf_counter()
        run.advance(k, steps, due, drive.measurements)
        took = time.perf_counter() - begin
        if [sensor for sensor, _ in due] == kind.due:
            found.append(1e6 * took)
    return float(np.median(found))


@click.command()
def main() -> None:
    """Print the table."""
    where = experiment.scratch()
    make_log(where / "ten.mcap", 10)
    golden_cases.simulate(where, EVERY)
    lines = [(kind.name, f"{microseconds(kind, where):.1f}", kind.goal) for kind in KINDS]
    click.echo("\n".join(experiment.table(("instant", "us", "goal"), lines, "12")))


if __name__ == "__main__":
    main()
