"""Walls out of an occupancy grid: against the walls from which the grid was drawn."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from locfuse.fusion import se2
from locfuse.fusion.data import LocfuseError, MapLine
from locfuse.fusion.map.given_walls import Grid, walls_of

Array = NDArray[np.float64]
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
