"""The graph of anchors: closed loops, and what the filter's state learns from it."""

import math

import numpy as np
import pytest
from present import present
from worlds import ROOM, World

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Estimates
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.map.line_map import LineMap
from locfuse.fusion.map.place_search import find_closure, rival_spread
from locfuse.fusion.map.small_maps import (
    Anchors,
    Edge,
    FrozenMap,
    SubmapPath,
    begin_submap,
    heading_among,
    inverted,
    shared_walls,
)
from locfuse.fusion.scan_matching.solve import NOWHERE

P_STEP = np.diag(np.square((0.1, 0.05, 0.02)))


def square_with_a_closure() -> Anchors:
    """Four sides of 10 m driven with an error, and the start recognised at the end."""
    rng = np.random.default_rng(3)
    graph = Anchors()
    at = graph.append(NOWHERE, np.zeros(3), np.zeros((3, 3)))
    for _ in range(4):
        z = np.array([10.0, 0.0, np.pi / 2]) + rng.normal(0.0, (0.1, 0.05, 0.02))
        at = graph.append(at, z, P_STEP)
    return graph


def test_a_closure_makes_the_far_anchor_as_certain_as_the_closure_and_moves_it_home() -> None:
    graph = square_with_a_closure()
    drifted, before = np.hypot(*graph.pose[4, :2]), graph.covariance(4)
    graph.add(Edge(0, 4, np.zeros(3), np.diag((1e4, 1e4, 1e6))))
    graph.solve()
    assert drifted > 0.2
    assert np.hypot(*graph.pose[4, :2]) < 0.01
    after = graph.covariance(4)
    assert np.diagonal(before)[:2].min() > 0.02
    assert np.diagonal(after)[:2].max() < 1.1e-4


def test_where_one_anchor_is_seen_from_another_has_the_covariance_of_the_edge_between_them() -> None:
    graph = square_with_a_closure()
    z, P = graph.relative(2, 3)
    np.testing.assert_allclose(z, graph.edges[3].z, atol=1e-9)
    np.testing.assert_allclose(P, P_STEP, atol=1e-9)


def test_a_frame_that_is_known_better_teaches_the_rest_as_a_reading_of_it_would() -> None:
    """The textbook update by a reading of the frame gives a posterior; told only that, the rest must follow."""
    rng = np.random.default_rng(5)
    belief = JointBelief((1.0, 2.0, 0.3), (0.04, 0.01, 0.0, 0.05, 0.002, 0.003), ())
    belief.begin_frame()
    belief.augment(np.array([3.0, 0.4]), np.eye(3)[:2], 0.01 * np.eye(2))
    root = rng.normal(size=(belief.n, belief.n))
    belief._P[: belief.n, : belief.n] += 0.01 * root @ root.T  # everything has to do with everything
    x, P = belief.state.copy(), belief.covariance.copy()
    at = np.arange(3, 6)
    z, R = x[at] + (0.05, -0.02, 0.01), np.diag((0.01, 0.02, 0.001))
    K = P[:, at] @ np.linalg.inv(P[np.ix_(at, at)] + R)
    wanted_x, wanted_P = x + K @ (z - x[at]), P - K @ P[at]
    belief.know_frame(wanted_x[at], wanted_P[np.ix_(at, at)])
    np.testing.assert_allclose(belief.state, wanted_x, atol=1e-9)
    np.testing.assert_allclose(belief.covariance, wanted_P, atol=1e-9)


def test_a_path_that_was_worse_than_claimed_is_widened_until_its_error_is_an_ordinary_one() -> None:
    """The closure contradicts the path by 10 sigma; by the variance factor its chi-square becomes about 3."""
    graph = Anchors()
    at = graph.append(NOWHERE, np.zeros(3), np.zeros((3, 3)))
    for _ in range(2):
        at = graph.append(at, np.array([10.0, 0.0, 0.0]), P_STEP)
    other = graph.append(at, np.array([5.0, 0.0, 0.0]), P_STEP)
    aside = graph.relative(at, other)[1].copy()
    z, P = graph.relative(0, at)
    z = z + 10.0 * np.sqrt(np.diagonal(P)) * (0.0, 1.0, 0.0)
    closure = Edge(0, at, z, np.diag((1e6, 1e6, 1e8)))
    graph.add(closure)
    graph.solve()
    worse = graph.cost()
    assert worse > 30.0
    graph.remove(closure)
    graph.scale_covariances(0, at, worse / 3.0)
    graph.add(closure)
    graph.solve()
    assert 1.5 < graph.cost() < 4.5
    np.testing.assert_allclose(graph.pose[at, :2], z[:2], atol=0.01)
    np.testing.assert_allclose(graph.relative(at, other)[1], aside, atol=1e-12)  # what lies beyond is as it was


def test_a_covariance_beyond_all_bounds_has_an_information() -> None:
    """Of a log whose stamps lie: its numbers do not know that it is positive."""
    xx, xy, xt = 1.25829551e25, 1.71387634e25, 1.68172119e16
    yy, yt, tt = 2.33440562e25, 2.29060831e16, 2.24763272e07
    P = np.array([[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]])
    L = inverted(P)
    assert np.isfinite(L).all()
    assert np.linalg.eigvalsh(L).min() >= -1e-12 * np.abs(L).max()


# --- the walls that lead from one map to the next keep what is known of them: held to drawn poses and walls

POSE = (2.0, -1.0, 0.7)
WALLS = np.array([(6.0, 0.0, 0.1), (2.0, 5.0, 1.6), (-4.0, 1.0, 3.0)])  # m, m, rad: anchor and direction of each
ENDS = ((-1.0, 2.0), (-3.0, 0.5), (-0.2, 0.2))


def drive() -> tuple[JointBelief, LineMap]:
    """Return a pose, and walls that were seen from it: what is known of them hangs together."""
    belief = JointBelief(POSE, (1e-8, 2e-9, 1e-9, 3e-8, -1e-9, 2e-8))
    lines, rng = LineMap(), np.random.default_rng(5)
    for (x, y, beta), ends in zip(WALLS, ENDS, strict=True):
        G = rng.normal(size=(2, 3))
        column = belief.augment(np.array([0.0, beta]), G, np.diag((1e-10, 4e-10)))
        lines.append(np.array([x, y]), np.array([0.0, beta]), np.zeros((2, 2)), column, ends, 4)
    lines.hits = np.array([7, 3, 9])
    return belief, lines


def seen(pose: Array, rho: Array, beta: Array) -> Array:
    """Return r and psi of the walls as seen from poses (n, 3), (n, 2k): how far, and where to."""
    away = WALLS[:, :2] - pose[:, None, :2]
    r = rho + away[..., 0] * np.cos(beta) + away[..., 1] * np.sin(beta)
    return np.stack((r, beta - pose[:, 2:]), axis=-1).reshape(len(pose), -1)


def test_what_is_seen_from_the_pose_spreads_as_drawn_poses_and_walls_do() -> None:
    belief, lines = drive()
    draws = np.random.default_rng(6).multivariate_normal(belief.state, belief.covariance, 200_000, method="eigh")
    drawn = seen(draws[:, :3], draws[:, lines.column], draws[:, lines.column + 1])
    shared = shared_walls(lines, np.arange(3), belief)
    sigma = np.sqrt(np.diagonal(shared.P))
    assert np.stack((shared.r, shared.psi), axis=-1).reshape(-1) == pytest.approx(drawn.mean(axis=0), abs=1e-5)
    assert shared.P / np.outer(sigma, sigma) == pytest.approx(np.cov(drawn.T) / np.outer(sigma, sigma), abs=0.02)


def test_the_next_map_knows_of_its_walls_what_the_last_one_knew() -> None:
    belief, lines = drive()
    ends = {int(line): lines.hi[k] - lines.lo[k] for k, line in enumerate(lines.ids)}
    shared = shared_walls(lines, np.arange(3), belief)
    belief.remove(lines.drop(np.arange(3)))
    belief.begin_frame()
    begin_submap(shared, lines, belief, 4)
    assert belief.pose() == (0.0, 0.0, 0.0)
    again = shared_walls(lines, np.arange(3), belief)
    assert again.r == pytest.approx(shared.r)
    assert again.psi == pytest.approx(shared.psi)
    assert again.ends == pytest.approx(shared.ends)
    assert pytest.approx(shared.P, rel=1e-9, abs=1e-18) == again.P
    assert lines.hits.tolist() == [7, 3, 9]
    assert (lines.hi - lines.lo).tolist() == pytest.approx(list(ends.values()))


def test_the_heading_among_walls_is_what_is_left_of_it_once_they_are_given() -> None:
    belief, lines = drive()
    walls = np.concatenate([lines.column, lines.column + 1])
    P = belief.covariance
    left = P[2, 2] - P[2, walls] @ np.linalg.solve(P[np.ix_(walls, walls)], P[walls, 2])
    assert heading_among(lines, np.arange(3), belief) == pytest.approx(np.sqrt(left), rel=1e-3)


# --- recognising a place: what walls tell of it, what stays open, and a robot that is carried to an unknown room

SIGMA = np.diag(np.square((0.02, math.radians(0.3))))


def map_of(walls: Array, frame: Array) -> FrozenMap:
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
    return FrozenMap(0, lines, SubmapPath(), (np.zeros(2), np.zeros(2)), np.zeros(3), np.zeros((0, 0)))


def corridor(doors: float) -> Array:
    """Return two walls of 24 m, 2 m apart, with niches every `doors` m: walls (k, 4) seen from inside."""
    walls = [(24.0, 1.0, 0.0, 1.0), (0.0, -1.0, 24.0, -1.0)]
    for x in np.arange(2.0, 23.0, doors):
        walls += [(x, 1.6, x, 1.0), (x + 1.0, 1.0, x + 1.0, 1.6)]
    return np.array(walls)


def test_along_a_corridor_whose_doors_repeat_the_place_stays_open_and_across_it_does_not() -> None:
    wide = np.diag(np.square((2.0, 2.0, 0.2)))
    frame = np.array([12.0, 0.2, 0.0])
    here, there = map_of(corridor(2.0), np.zeros(3)), map_of(corridor(2.0)[:12], frame)
    found = present(find_closure(here, there, frame, wide))
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
    P = rival_spread(rivals)
    np.testing.assert_allclose(along @ P[:2, :2] @ along, 16.0, rtol=1e-9)
    np.testing.assert_allclose(np.linalg.eigvalsh(P)[:2], 0.0, atol=1e-9)
    assert not rival_spread(rivals[1:2]).any()


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
    drive, robot = world.measured()
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
