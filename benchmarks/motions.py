"""What is taken as the motion of each real log, and why: the table of docs/motion.md.

python -m benchmarks.motions           print the table (LOCFUSE_DATA names the folder with the logs)
python -m benchmarks.motions --write   put it into the page
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from pathlib import Path

from locfuse.cli.analysis.choose import choose
from locfuse.cli.analysis.refused_motion import spoiling
from locfuse.cli.analysis.robot_tables import make_robot
from locfuse.formats.logs.log import open_log
from locfuse.formats.robot.robot_toml import apply_sets
from locfuse.fusion.data import LocfuseError
from locfuse.fusion.streams import merged
from locfuse.fusion.wheels.odometry import SCANS
from locfuse.fusion.wheels.read import read_wheels

PAGE = Path(__file__).parent.parent / "docs" / "motion.md"
HEAD = "| log | taken | why |\n|---|---|---|\n"
BAGS = ("controller_twist.bag", "pimouse.bag", "odometry_in_tf.bag", "laser_only", "world_frame_twist.bag")
VOID = ("standing_odometry", "setpoints.bag", "marker_in_camera.bag", "sideways.bag")
TRICYCLE = (
    "wheels.radius=0.0016893",
    "wheels.ticks_per_revolution=5000",
    "wheels.servo_gain=13038",
    "wheels.wheelbase=1.4",
)
LOGS: Mapping[str, tuple[str, ...]] = {
    **{f"strangers/{bag}": () for bag in (*BAGS, *VOID)},
    **dict.fromkeys(("turtlebot4/tb4_mcap.mcap", "turtlebot4/db3", "aces/aces.mcap", "fr079/fr079.mcap"), ()),
    **dict.fromkeys(("halls/edmonton.mcap", "halls/freiburg-101.mcap", "brenner/brenner.mcap"), ()),
    **dict.fromkeys(("mrclam/mrclam.mcap", "bags/evo/nav2_turtlebot.mcap"), ()),
    "tricycle/tricycle.mcap": TRICYCLE,
    "warthog/warthog.mcap": ("wheels.radius=0.3", "wheels.track=1.14"),
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


def main(write: bool) -> int:
    """Print the table, or put it into the page."""
    folder = Path(os.environ["LOCFUSE_DATA"])
    table = HEAD + "".join(f"{row(folder / name, sets)}\n" for name, sets in LOGS.items())
    if not write:
        print(table)
        return 0
    before, after = PAGE.read_text(encoding="utf-8").split(HEAD)
    PAGE.write_text(before + table + "\n" + after.partition("\n\n")[2], encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:] == ["--write"]))
