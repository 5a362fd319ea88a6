"""Given maps of walls for localisation: from --map (lines, or an occupancy grid), or from a topic of the log.

The walls of an occupancy grid are converted to lines. The start pose in a grid is searched for, unless [start] is
set.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from msgspec.structs import replace

from locfuse.formats.inputs import MAX_WALLS, names_its_cap
from locfuse.fusion.data import LocfuseError, MapLine, Ragged, UsageError

from .load import Loaded, start_notes

if TYPE_CHECKING:
    from locfuse.fusion.map.given_map import Grid

UNKNOWN_START_M = 1.0  # a configured start with a larger standard deviation is searched for
FOUND_XY, FOUND_THETA_RAD = 0.15, math.radians(3.0)  # m, rad: standard deviations of a start found in the map
GRID = "nav_msgs/msg/OccupancyGrid"
ORIGIN = tuple(f"info.origin.{part}" for part in ("position.x", "position.y", "orientation.z", "orientation.w"))


def give(loaded: Loaded, file: Path) -> Loaded:
    """Return the log with a map file for localisation: lines as JSON, or the .yaml of an occupancy grid.

    Raises LocfuseError for a bad file and a map of another building, UsageError for the paper's filter, whose map
    is the first scan.
    """
    from locfuse.formats.robot import map_files, map_image
    from locfuse.fusion.map.given_map import Grid

    if loaded.robot.preset == "paper":
        raise UsageError("--map: the paper's filter knows its first scan's walls only; leave --preset paper out")
    if file.suffix in map_image.PICTURES:
        raise UsageError(f"--map {file}: name the .yaml beside the image, which says where it lies")
    if file.suffix not in map_image.SUFFIXES:
        return _with_map(replace(loaded, given=None), map_files.read_lines(file), str(file))
    return _give_grid(replace(loaded, given=None), Grid(*map_image.read(file)), str(file))


def give_topic(loaded: Loaded) -> Loaded:
    """Return the log with the map of the topic `[lrf] map_topic`; unchanged without that setting.

    Raises LocfuseError if the topic is missing, or has no map, or the map of another building.
    """
    topic = loaded.robot.settings("lrf").map_topic
    if topic is None or loaded.robot.preset == "paper":
        return loaded
    from locfuse.formats.robot import map_image
    from locfuse.fusion.map.given_map import Grid

    info = loaded.log.find(topic)
    if info is None or info.msgtype != GRID:
        what = "is not there" if info is None else f"is {info.msgtype}"
        raise LocfuseError(f"lrf.map_topic: {topic} {what}; it takes a {GRID}", role="lrf")
    stream, shape = loaded.log.stream(topic, loaded.robot.order), ("info.resolution", "info.width", "info.height")
    columns = stream.columns(*ORIGIN, *shape, "data")
    cells = columns["data"]
    if not isinstance(cells, Ragged) or not len(cells):
        raise LocfuseError(f"lrf.map_topic: {topic} holds no map", role="lrf")
    x, y, qz, qw, cell, width, height = (float(np.asarray(columns[name])[-1]) for name in (*ORIGIN, *shape))
    origin = np.array([x, y, 2.0 * math.atan2(qz, qw)])
    last = cells.values[cells.first[-2] : cells.first[-1]]
    image = map_image.of_message(last, int(width), int(height), cell, origin, topic)
    return _give_grid(loaded, Grid(*image), topic)


def _give_grid(loaded: Loaded, grid: Grid, name: str) -> Loaded:
    """Return the log with a grid's walls as its map; an unknown start is found by the first scans."""
    from locfuse.fusion.map.given_map import at_start, find_start, walls_of

    drive, robot = loaded.drive, loaded.robot
    if (m := drive.measurements.get("lrf")) is None:
        raise drive.lacks("lrf")
    known = robot.start_given and robot.start.sigma_xy < UNKNOWN_START_M
    if m.points is None and not known:
        raise LocfuseError(f"the start in {name} cannot be looked for: set [start] x, y, theta_deg", role="start")
    try:
        lines = walls_of(grid)
        if not lines:
            raise LocfuseError("no wall of 0.3 m or more: nothing can be localised in it")
        found = find_start(grid, m.t, m.points, drive.wheels) if m.points is not None and not known else None
    except LocfuseError as problem:
        raise LocfuseError(f"{name}: {problem.message}", role="map") from None
    loaded = _with_map(loaded, lines, name)
    if found is None:
        return loaded
    x, y, theta = pose = at_start(found, drive.wheels).tolist()
    words = (
        f"the drive begins in {name} at x {x:.2f} m, y {y:.2f} m, {math.degrees(theta):.0f} deg: looked for in "
        f"all of the map by the scans up to {found.until:.1f} s ({found.share:.0%} of the beams end at walls)"
    )
    placed = loaded.robot.begun_at(pose, FOUND_XY, FOUND_THETA_RAD)
    stale = start_notes(robot, drive)  # notes on the old start
    notes = (*(note for note in drive.notes if note not in stale), words, *start_notes(placed, drive))
    return replace(loaded, robot=placed, drive=replace(drive, notes=notes))


def _with_map(loaded: Loaded, lines: list[MapLine], name: str) -> Loaded:
    """Return the log with the lines of a given map. Raises LocfuseError if there are more than MAX_WALLS."""
    if len(lines) > MAX_WALLS:
        many = names_its_cap(name, len(lines), MAX_WALLS, "walls")
        raise LocfuseError(f"{many}; keep only the part that the drive is in", role="map")
    robot, lrf = loaded.robot, replace(loaded.robot.settings("lrf"), map="given")
    return replace(loaded, robot=replace(robot, sensors={**robot.sensors, "lrf": lrf}, lines=tuple(lines)))
