"""Where a drive began in a given map: found, refused where the map is of another place, and left open."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
import ring_drive
from numpy.typing import NDArray
from ring_drive import Held, box

from locfuse.fusion import se2
from locfuse.fusion.data import LocfuseError
from locfuse.fusion.map.given_search import at_start, find_start
from locfuse.fusion.map.given_walls import Grid
from locfuse.fusion.wheels.motion import Wheels

Array = NDArray[np.float64]
CELL = 0.05
MAP = np.array([3.0, -7.0, math.radians(40.0)])  # where the ring lies in the map
OTHER = np.array(box(-3.0, -5.0, 19.0, 12.0) + box(0.0, -2.0, 3.0, 9.0) + box(6.0, 1.0, 15.0, 3.0))


def grid_of(segments: Array, origin: Array = MAP) -> Grid:
    """A plan of walls (k, 4) of one cell, in the frame of the ring; all else is free."""
    low = segments.reshape(-1, 2).min(axis=0) - 1.0
    columns, rows = np.ceil((segments.reshape(-1, 2).max(axis=0) + 1.0 - low) / CELL).astype(int)
    occupied = np.zeros((rows, columns), dtype=bool)
    for x0, y0, x1, y1 in segments.tolist():
        n = 2 + int(2.0 * math.hypot(x1 - x0, y1 - y0) / CELL)
        i, j = np.floor((np.linspace((x0, y0), (x1, y1), n) - low) / CELL).astype(int).T
        occupied[j, i] = True
    return Grid(occupied, ~occupied, CELL, se2.compose(origin, np.array([*low, 0.0])))


def drive(segments: Array, first: int = 0, last: int = 250) -> tuple[Array, Held, Wheels, Array]:
    """Times, scans, wheels, and the true first pose in the map."""
    t, pose = ring_drive.path(1.0)
    t, pose = t[first:last] - t[first], pose[first:last]
    rng = np.random.default_rng(5)
    every = slice(0, None, 4)
    scans = [ring_drive.scan(one, segments, rng) for one in pose[every]]
    steps = se2.log(se2.between(pose[:-1], pose[1:])) * (1.02, 1.0, 0.98)  # wheels that are a little wrong
    return t[every], Held(scans), Wheels.from_twists(t, steps, 0.3, 4e-4), se2.compose(MAP, pose[0])


@pytest.mark.parametrize(("first", "last"), [(0, 150), (40, 240)])
def test_the_start_is_found_in_all_of_the_map(first: int, last: int) -> None:
    walls = ring_drive.walls(alike=False)
    t, scans, wheels, true = drive(walls, first, last)
    found = find_start(grid_of(walls), t, scans, wheels)
    off = se2.between(true, at_start(found, wheels))
    assert math.hypot(off[0], off[1]) < 0.15
    assert abs(se2.wrap(float(off[2]))) < math.radians(3.0)
    assert found.share > 0.9


def test_a_map_of_another_building_is_refused_within_thirty_seconds() -> None:
    t, scans, wheels, _ = drive(ring_drive.walls(alike=False), last=420)
    with pytest.raises(LocfuseError, match=r"no place in the map fits.*Is it a map of this building\?") as problem:
        find_start(grid_of(OTHER), t, scans, wheels)
    until = re.search(r"the first (\d+) s", str(problem.value))
    assert until is not None
    assert int(until[1]) <= 31


def test_where_two_places_look_alike_none_is_taken() -> None:
    """The ring turned by half a turn is the same ring: no drive can tell."""
    walls = ring_drive.walls(alike=True)
    t, scans, wheels, _ = drive(walls, last=420)
    with pytest.raises(LocfuseError, match=r"several places in the map fit.*start\.x"):
        find_start(grid_of(walls), t, scans, wheels)


def test_a_robot_that_sees_nothing_is_told_so() -> None:
    t, scans, wheels, _ = drive(ring_drive.walls(alike=False), last=100)
    with pytest.raises(LocfuseError, match="too little is seen"):
        find_start(grid_of(OTHER), t, Held([np.zeros((0, 2)) for _ in scans.scans]), wheels)
