"""What is taken as the motion of each real log, and why.

LOCFUSE_DATA=folder python -m benchmarks.motions
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from benchmarks.real_logs import FILES, KNOWN, folder
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

TRICYCLE = (
    "wheels.radius=0.0016893",
    "wheels.ticks_per_revolution=5000",
    "wheels.servo_gain=13038",
    "wheels.wheelbase=1.4",
)
LOGS: Mapping[str, tuple[str, ...]] = {
    **dict.fromkeys(FILES, ()),
    "uwb": set_words(KNOWN["uwb"]),
    "tricycle": TRICYCLE,
    "warthog": ("wheels.radius=0.3", "wheels.track=1.14"),
}


def row(path: Path, sets: tuple[str, ...]) -> str:
    """Return a log's line of the table."""
    log, robot = open_log([path]), make_robot(apply_sets(sets))
    try:
        choice = choose(log, robot)
    except LocfuseError as problem:
        return f"| {path.name} | nothing | {problem.message} |"
    topics = choice.of("wheels")
    words = [f"with {len(sets)} settings: {choice.why['wheels']}" if sets else choice.why["wheels"]]
    words += [note.words for note in choice.notes if note.role == "wheels" and not note.spoils]
    if log.topics[topics[0]].msgtype != SCANS:
        reading = read_wheels(merged([log.stream(topic) for topic in topics]), robot.wheels)
        words += [
            *reading.notes[:1],
            *(f"**void**: {note.words}" for note in spoiling(log, robot, choice, reading)),
        ]
    taken = " and ".join(f"`{topic}`" for topic in topics)
    return f"| {path.name} | {taken} | {'; '.join(dict.fromkeys(words))} |"


def main() -> None:
    """Print the table."""
    print("| log | taken | why |\n|---|---|---|")
    for name, sets in LOGS.items():
        print(row(folder() / FILES[name], sets))


if __name__ == "__main__":
    main()
