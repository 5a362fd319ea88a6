"""What is taken as the motion of each real log, and why: LOCFUSE_DATA=folder python -m benchmarks.motions."""

from __future__ import annotations

from collections.abc import Iterator

from benchmarks import experiment
from benchmarks.experiment import Row
from benchmarks.real_logs import FILES, KNOWN, are_there, folder
from locfuse.cli.analysis.choose import choose
from locfuse.cli.analysis.refused_motion import spoiling
from locfuse.cli.analysis.robot_tables import make_robot
from locfuse.cli.analysis.settings import set_words
from locfuse.formats.logs.log import open_log
from locfuse.formats.robot.robot_toml import apply_sets
from locfuse.fusion.data import LocfuseError
from locfuse.fusion.streams import merged
from locfuse.fusion.wheels.odometry import SCANS
from locfuse.fusion.wheels.read import read_wheels

SETS: dict[str, tuple[str, ...]] = {
    "uwb": set_words(KNOWN["uwb"]),
    "tricycle": (
        *("wheels.radius=0.0016893", "wheels.ticks_per_revolution=5000"),
        *("wheels.servo_gain=13038", "wheels.wheelbase=1.4"),
    ),
    "warthog": ("wheels.radius=0.3", "wheels.track=1.14"),
}


def work(name: str) -> Row:
    """Return what is taken of a log, and why."""
    path, sets = folder() / FILES[name], SETS.get(name, ())
    log, robot = open_log([path]), make_robot(apply_sets(sets))
    try:
        choice = choose(log, robot)
    except LocfuseError as problem:
        return {"cells": [path.name, "nothing", problem.message]}
    topics, why = choice.of("wheels"), choice.why["wheels"]
    words = [f"with {len(sets)} settings: {why}" if sets else why]
    words += [note.words for note in choice.notes if note.role == "wheels" and not note.spoils]
    if log.topics[topics[0]].msgtype != SCANS:
        reading = read_wheels(merged([log.stream(topic) for topic in topics]), robot.wheels)
        words += reading.notes[:1]
        words += [f"**void**: {note.words}" for note in spoiling(log, robot, choice, reading)]
    taken = " and ".join(f"`{topic}`" for topic in topics)
    return {"cells": [path.name, taken, "; ".join(dict.fromkeys(words))]}


def table(rows: list[Row]) -> Iterator[str]:
    """Yield a line for each log."""
    yield from experiment.table(("log", "taken", "why"), [row["cells"] for row in rows])


main = experiment.command(work, table, FILES if are_there() else (), drives=0)

if __name__ == "__main__":
    main()
