"""Recognising a place: what walls tell of it, what stays open, and a robot that is carried to an unknown room."""

from __future__ import annotations

import math

import numpy as np
import pytest
from worlds import ROOM, World

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Estimates
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.map.line_map import LineMap
from locfuse.fusion.map.place_search import Here, find_closure, left_open
from locfuse.fusion.map.way import Way
from locfuse.fusion.measure import measure

SIGMA = np.diag(np.square((0.02, math.radians(0.3))))


def map_of(walls: Array, frame: Array) -> Here:
    """Walls (k, 4) as a map seen from `frame` (3,), every one from the left of its direction."""
    lines = LineMap()
    back = se2.inverse(frame)
    for x0, y0, x1, y1 in walls:
        a, b = se2.transform(back, np.array([[x0, y0], [x1, y1]]))
        middle, along = 0.5 * (a + b), b - a
        half = 0.5 * float(np.hypot(*along))
        beta = math.atan2(along[1], along[0]) - math.pi / 2
        lines.append(middle, np.array([0.0, beta]), SIGMA, -1, (-half, half), 0)
    lines.hits = np.full(len(walls), 20)
    return Here(lines, lines.value, lines.P, Way())


def corridor(doors: float) -> Array:
    """Return two walls of 24 m, 2 m apart, with niches every `doors` m: walls (k, 4) seen from inside."""
    walls = [(24.0, 1.0, 0.0, 1.0), (0.0, -1.0, 24.0, -1.0)]
    for x in np.arange(2.0, 23.0, doors):
        walls += [(x, 1.6, x, 1.0), (x + 1.0, 1.0, x + 1.0, 1.6)]
    return np.array(walls)


def test_along_a_corridor_whose_doors_repeat_the_place_stays_open_and_across_it_does_not() -> None:
    wide = np.diag(np.square((2.0, 2.0, 0.2)))
    frame = np.array([12.0, 0.2, 0.0])
    found = find_closure(map_of(corridor(2.0), np.zeros(3)), map_of(corridor(2.0)[:12], frame), frame, wide)
    assert found is not None
    assert math.sqrt(found.P[0, 0]) > 1.5  # a door further on fits as well
    assert abs(found.pose[1] - 0.2) < 0.02
    assert math.sqrt(found.P[1, 1]) < 0.1
    assert math.sqrt(found.P[2, 2]) < math.radians(1.0)


def test_two_directions_that_fit_alike_close_nothing() -> None:
    """A bare rectangle, turned by 180 degrees, is itself."""
    walls = np.array(ROOM, float)
    open_ = np.diag(np.square((5.0, 5.0, 2.0)))
    middle = np.array([4.0, 3.0, 0.0])
    assert find_closure(map_of(walls, middle), map_of(walls, middle), np.zeros(3), open_) is None


@pytest.mark.parametrize("angle", [0.0, 0.4, 2.0])
def test_what_stays_open_is_as_wide_as_the_farthest_rival_and_along_the_rivals(angle: float) -> None:
    along = np.array([math.cos(angle), math.sin(angle)])
    rivals = np.array([[*(step * along), 0.0] for step in (-2.0, 0.1, 2.0, 4.0)])
    P = left_open(rivals)
    np.testing.assert_allclose(along @ P[:2, :2] @ along, 16.0, rtol=1e-9)
    np.testing.assert_allclose(np.linalg.eigvalsh(P)[:2], 0.0, atol=1e-9)
    assert not left_open(rivals[1:2]).any()


FAR = np.array((30.0, 0.0, 30.0, 0.0))
L_SHAPED = ((0, 0, 8, 0), (8, 0, 8, 4), (8, 4, 6, 4), (6, 4, 6, 6), (6, 6, 0, 6), (0, 6, 0, 0))
# two rooms that nobody takes for one another, nor for themselves turned round, 30 m apart
ROOMS = (
    *L_SHAPED,
    (3, 0, 3, 1),
    (0, 3.5, 1.2, 3.5),
    *(tuple(np.array(w) + FAR) for w in ((0, 0, 6, 0), (6, 0, 6, 9), (6, 9, 0, 9), (0, 9, 0, 0), (0, 6, 1.5, 6))),
)


class Visiting(World):
    """A robot that drives in circles in one room, is carried to another one, and back."""

    there: float = 60.0  # s
    back: float = 1e9
    seconds: float = 120.0
    speed: float = 0.5
    turning: float = 0.35
    start: tuple[float, float, float] = (4.0, 1.6, 0.0)
    walls: tuple[tuple[float, ...], ...] = ROOMS
    beams: int = 361

    def pose(self, t: Array, x0: tuple[float, float, float] | None = None) -> Array:
        """In the other room it stands elsewhere and looks elsewhere."""
        path = super().pose(t, x0)
        other = super().pose(t, (29.5 + 3.5, 3.0, 1.9))
        inside = (t >= self.there) & (t < self.back)
        return np.where(inside[:, None], other, path)


def known_errors(world: World) -> tuple[Estimates, Array, Array]:
    """Fuse; return the position errors [m] outside of being lost, and the sigmas [m] there."""
    robot = world.robot()
    drive = measure(world.streams(), robot)
    found = fuse(drive, robot, ["lrf"])
    judged = evaluate(found, drive)
    known = np.ones(len(judged.t), bool)
    for a, b in found.lost:
        known &= (judged.t < a) | (judged.t > b)
    sigma = np.sqrt(np.interp(judged.t, found.t, found.P[:, 0, 0] + found.P[:, 1, 1]))
    return found, np.hypot(*judged.deviation.T)[known], sigma[~known]


def test_a_robot_carried_to_an_unknown_room_maps_it_and_does_not_claim_to_know_where_it_is() -> None:
    found, errors, sigma = known_errors(Visiting())
    assert len(found.lost) == 1
    assert found.lost[0][1] == found.t[-1]
    assert errors.max() < 0.1
    assert sigma[len(sigma) // 5 :].min() > 2.0
    assert len(found.final_map) >= 10  # both rooms
    assert any("2 submaps" in note for note in found.notes)


def test_a_robot_that_comes_back_from_an_unknown_room_is_found_again() -> None:
    found, errors, _ = known_errors(Visiting(back=110.0, seconds=190.0))
    assert found.lost[-1][1] < 185.0
    assert errors.max() < 0.1
