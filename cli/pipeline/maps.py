"""A map leaves one run and is given to another: --save-map and --map; landmarks as a .csv."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import msgspec

from locfuse.fusion.data import Estimates, UsageError

from .load import Loaded


def give(loaded: Loaded, file: Path) -> Loaded:
    """Return the log with a robot that localises in the map of a file.

    Raises LocfuseError for a bad file, UsageError for the printed filter: its map is the first scan's.
    """
    if loaded.robot.preset == "paper":
        raise UsageError("--map: the paper's filter knows its first scan's walls only; leave --preset paper out")
    from locfuse.formats.robot import line_map

    robot = loaded.robot
    lrf = msgspec.structs.replace(robot.settings("lrf"), map="given")
    lines = tuple(line_map.read(file))
    return replace(loaded, asked=None, robot=replace(robot, sensors={**robot.sensors, "lrf": lrf}, lines=lines))


def keep(estimates: Estimates, file: Path, made_from: str) -> None:
    """Write the map that a run ended with."""
    from locfuse.formats.robot import line_map
    from locfuse.formats.whole_files import whole_file

    with whole_file(file) as path:
        path.write_text(line_map.encode(estimates.final_map, made_from))


def keep_landmarks(estimates: Estimates, file: Path) -> None:
    """Write the landmarks that a run placed, as the .csv that `landmarks.map` reads."""
    from locfuse.formats.robot import landmark_map
    from locfuse.formats.whole_files import whole_file

    with whole_file(file) as path:
        path.write_text(landmark_map.encode(estimates.points))
