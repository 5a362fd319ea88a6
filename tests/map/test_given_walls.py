"""Walls out of an occupancy grid: against the walls from which the grid was drawn."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
import ring_drive
from numpy.typing import NDArray
from present import present
from ring_drive import Held, box

from locfuse.fusion import se2
from locfuse.fusion.data import Array, LocfuseError, MapLine
from locfuse.fusion.map.given_search import at_start, find_start
from locfuse.fusion.map.given_walls import Grid, walls_of
from locfuse.fusion.wheels.motion import Wheels

CELL = 0.05


def drawn(inside: NDArray[np.bool_], thick: int, origin: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Grid:
    """A grid whose free cells are given; around them a wall of some cells, beyond it nothing is known."""
    wall, grown = np.zeros_like(inside), inside
    for _ in range(thick):
        padded = np.pad(grown, 1)
        grown = padded[1:-1, 1:-1] | padded[2:, 1:-1] | padded[:-2, 1:-1] | padded[1:-1, 2:] | padded[1:-1, :-2]
        wall |= grown & ~inside
    return Grid(wall, inside, CELL, np.array(origin))


def centres(rows: int, columns: int) -> tuple[Array, Array]:
    """X and y [m] of the middles of cells, (rows, columns) each."""
    y, x = np.meshgrid((np.arange(rows) + 0.5) * CELL, (np.arange(columns) + 0.5) * CELL, indexing="ij")
    return x, y


def room(thick: int, origin: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Grid:
    """A room of 6 m x 4 m whose lower left corner is at (0.5, 0.5) in the grid."""
    x, y = centres(100, 140)
    return drawn((x > 0.5) & (x < 6.5) & (y > 0.5) & (y < 4.5), thick, origin)


def by_direction(lines: list[MapLine]) -> dict[int, MapLine]:
    return {round(math.degrees(line.beta)) % 360: line for line in lines}


@pytest.mark.parametrize(("thick", "depth"), [(4, 0.0), (1, CELL / 2.0)])
def test_a_room_has_four_walls_with_their_normals_outward(thick: int, depth: float) -> None:
    """Thick walls lie where they begin, walls of one cell in its middle."""
    found = by_direction(walls_of(room(thick)))
    assert sorted(found) == [0, 90, 180, 270]
    for degrees, rho in {0: 6.5, 90: 4.5, 180: -0.5, 270: -0.5}.items():
        assert found[degrees].rho == pytest.approx(rho + depth, abs=1e-6)
    lengths = {degrees: line.ends[1] - line.ends[0] for degrees, line in found.items()}
    assert lengths[0] == pytest.approx(4.0, abs=2 * CELL)
    assert lengths[90] == pytest.approx(6.0, abs=2 * CELL)


def test_the_grid_lies_where_its_origin_says() -> None:
    turned = math.radians(30.0)
    found = by_direction(walls_of(room(4, (1.0, -2.0, turned))))
    assert sorted(found) == [30, 120, 210, 300]
    corner = se2.transform(np.array([1.0, -2.0, turned]), np.array([6.5, 4.5]))
    for degrees in (30, 120):
        line = found[degrees]
        assert corner @ (math.cos(line.beta), math.sin(line.beta)) == pytest.approx(line.rho, abs=1e-6)


@pytest.mark.parametrize("degrees", [7.0, 20.0, 33.0, 45.0, 68.0])
@pytest.mark.parametrize("thick", [1, 4])
def test_a_wall_across_the_grid_is_found_as_one(degrees: float, thick: int) -> None:
    """Its staircase leaves it by less than a cell; all errors lie within three of its sigmas."""
    x, y = centres(160, 160)
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    grid = drawn((c * x + s * y < 5.0) & (x > 0.5) & (y > 0.5) & (x < 7.0) & (y < 7.0), thick)
    line = max(
        walls_of(grid),
        key=lambda one: (one.ends[1] - one.ends[0]) * (abs(one.beta - math.radians(degrees)) < 0.05),
    )
    assert line.ends[1] - line.ends[0] > 2.5
    middle = 0.5 * (line.ends[0] + line.ends[1])
    G = np.array([[1.0, -middle], [0.0, 1.0]])  # what is known of its middle
    offset, angle = np.sqrt(np.diagonal(G @ line.P @ G.T))
    assert abs(line.beta - math.radians(degrees)) < 3.0 * angle
    at = line.rho * np.array([math.cos(line.beta), math.sin(line.beta)]) + middle * np.array(
        [-math.sin(line.beta), math.cos(line.beta)]
    )
    depth = 0.5 * CELL if thick == 1 else 0.0
    assert abs(at @ (c, s) - 5.0 - depth) < 3.0 * offset


def test_a_door_parts_a_wall_and_a_short_piece_is_none() -> None:
    grid = room(1)
    occupied, free = grid.occupied.copy(), grid.free.copy()
    occupied[:, 40:60][90] = False  # a door of 1 m in the northern wall
    free[90:, 40:60] = True
    occupied[30:33, 30:33], free[30:33, 30:33] = True, False  # a post of 15 cm
    north = [
        line for line in walls_of(Grid(occupied, free, CELL, grid.origin)) if abs(line.beta - math.pi / 2) < 0.1
    ]
    assert len(north) == 2
    assert len(walls_of(Grid(occupied, free, CELL, grid.origin))) == 5


def test_a_wall_between_two_rooms_is_seen_from_both_sides() -> None:
    grid = room(1)
    occupied, free = grid.occupied.copy(), grid.free.copy()
    occupied[10:90, 70], free[10:90, 70] = True, False
    found = [line for line in walls_of(Grid(occupied, free, CELL, grid.origin)) if abs(math.cos(line.beta)) > 0.9]
    middle = [line for line in found if abs(abs(line.rho) - 70.5 * CELL) < 1e-6]
    assert sorted(round(math.degrees(line.beta)) % 360 for line in middle) == [0, 180]


def test_a_picture_of_noise_is_refused_before_its_cells_are_walked() -> None:
    black = np.indices((1024, 1024)).sum(axis=0) % 2 == 1  # 2 100 000 sides of cells in a picture of 2 kB
    with pytest.raises(LocfuseError, match="more than 1000000 sides"):
        walls_of(Grid(black, ~black, CELL, np.zeros(3)))


# --- where a drive began in a given map: found, refused where the map is of another place, and left open

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
    until = present(re.search(r"the first (\d+) s", str(problem.value)))
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
