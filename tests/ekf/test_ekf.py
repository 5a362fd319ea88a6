"""The filter against a textbook filter in plain matrices."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from rows import Told, correct, dense, matrix_in_map, some_told, step
from textbook import TextbookEkf, move, numeric_jacobian

from locfuse.fusion.data import LocfuseError
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.ekf.equations import eq5_x, eq7_A, eq10_12, predicted
from locfuse.fusion.ekf.map_frame import InMap, Triangle, map_covariance
from locfuse.fusion.kernels.ekf import bent
from locfuse.fusion.map.slips import tried
from locfuse.fusion.sensor import Block

POSE = (1.0, -2.0, 3.1)
P0 = np.array([[0.04, 0.01, 0.002], [0.01, 0.09, -0.003], [0.002, -0.003, 0.01]])
UPPER: Triangle = (0.04, 0.01, 0.002, 0.09, -0.003, 0.01)
EXACT, LOST = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), (25.0, 0.0, 0.0, 25.0, 0.0, 3.0)


def joint(rng: np.random.Generator) -> tuple[JointBelief, TextbookEkf]:
    offset = Block("offset", np.array([0.3]), np.array([[1.0]]), np.array([0.0]))
    belief = JointBelief(POSE, UPPER, [offset])
    book = TextbookEkf(np.array([*POSE, 0.3]), np.block([[P0, np.zeros((3, 1))], [np.zeros((1, 3)), np.eye(1)]]))
    for _ in range(8):  # grows past the first allocation
        G, noise = rng.normal(size=(2, 3)), np.diag(rng.uniform(0.01, 0.1, 2))
        value = rng.normal(size=2)
        belief.augment(value, G, noise)
        book.x = np.append(book.x, value)
        G = np.hstack((G, np.zeros((2, len(book.x) - 2 - 3))))
        top = book.P @ G.T
        book.P = np.block([[book.P, top], [top.T, G @ top + noise]])
    return belief, book


def test_the_joint_filter_equals_the_textbook_over_a_whole_drive() -> None:
    rng = np.random.default_rng(1)
    belief, book = joint(rng)
    for _ in range(500):
        L = 0.01 * rng.normal(size=(3, 3))
        u, Q = rng.normal(size=3) * [0.1, 0.01, 0.1], L @ L.T
        belief.predict(step(u, Q), 0)
        book.predict(u, Q)
        columns = [tuple(int(c) + k for k in range(2)) for c in rng.choice(np.arange(4, 20, 2), 3, replace=False)]
        told = [some_told(rng, 2, c) for c in columns] + [some_told(rng, 1, (3,))]
        correct(belief, *told)
        book.correct(*dense(told, belief.n))
        agrees(belief, book)


@pytest.mark.parametrize("d", [1, 2, 3])
def test_the_spread_of_a_reading_is_h_p_h(d: int) -> None:
    rng = np.random.default_rng(d)
    belief, _ = joint(rng)
    columns, H, own = (3, 9), rng.normal(size=(d, 3)), rng.normal(size=(d, 2))
    full = np.zeros((d, belief.n))
    full[:, :3], full[:, list(columns)] = H, own
    both = np.hstack((H, own))
    np.testing.assert_allclose(belief.spread(both, columns), full @ belief.covariance @ full.T, atol=1e-12)
    np.testing.assert_allclose(belief.spread(H), H @ belief.matrix() @ H.T, atol=1e-12)
    assert belief.variance(tuple(H[0].tolist())) == pytest.approx(H[0] @ belief.matrix() @ H[0], rel=1e-12)


def test_a_block_drifts_by_its_random_walk() -> None:
    belief = JointBelief(POSE, UPPER, [Block("offset", np.zeros(1), np.eye(1) * 0.1, np.array([0.02]))])
    belief.predict(step((0.0, 0.0, 0.0), np.zeros((3, 3)), dt=2.5), 0)
    assert belief.covariance[3, 3] == pytest.approx(0.1 + 0.02 * 2.5)


@pytest.mark.parametrize(
    "gone", [[6, 7], [3], [19], [18, 19], [3, 19], [4, 5, 6, 7, 12, 15, 16], [7, 6], list(range(3, 20)), []]
)
def test_removing_states_is_marginalising_them(gone: list[int]) -> None:
    belief, book = joint(np.random.default_rng(4))
    belief.remove(np.array(gone, dtype=np.int64))
    keep = [i for i in range(20) if i not in gone]
    np.testing.assert_allclose(belief.covariance, book.P[np.ix_(keep, keep)], rtol=1e-9)
    np.testing.assert_array_equal(belief.state, book.x[keep])
    belief._grow(len(gone))  # whoever comes next finds nothing
    assert not belief.state[len(keep) :].any()
    assert not belief.covariance[len(keep) :].any()
    assert not belief.covariance[:, len(keep) :].any()


# --- the equations by number, held to a textbook filter and to finite differences


def some(seed: int, n: int) -> tuple[np.random.Generator, np.ndarray]:
    g = np.random.default_rng(seed)
    A = g.normal(size=(n, n))
    return g, A @ A.T


@pytest.mark.parametrize("seed", range(4))
def test_predictions_and_corrections_are_the_textbook_filters(seed: int) -> None:
    g, P = some(seed, 3)
    Q = some(seed + 10, 3)[1]
    x, u = g.normal(size=3), g.normal(size=3)
    book = TextbookEkf(x, P)
    book.predict(u, Q)
    after, P_after = predicted(*(np.stack((v, v)) for v in (x, P, u, Q)))
    np.testing.assert_allclose(after, [book.x, book.x], atol=1e-12)
    np.testing.assert_allclose(P_after, [book.P, book.P], atol=1e-12)
    g, P = some(seed, 5)
    R = some(seed + 10, 2)[1]
    x, y, H = g.normal(size=5), g.normal(size=2), g.normal(size=(2, 5))
    book = TextbookEkf(x, P)
    book.correct(y, H, R)
    V, e, L = eq10_12(P @ H.T, H @ P @ H.T + R, y)
    np.testing.assert_allclose(x + V.T @ e, book.x, atol=1e-9)
    np.testing.assert_allclose(P - V.T @ V, book.P, atol=1e-9)
    np.testing.assert_allclose(L @ L.T, H @ P @ H.T + R, atol=1e-9)


@pytest.mark.parametrize("u", [(0.0, 0.0, 0.0), (0.3, 0.1, -2.0), (-1.0, 0.0, 3.1)])
def test_eq_7_is_the_derivative_of_eq_5(u: tuple[float, float, float]) -> None:
    x, step = np.array([1.0, -2.0, 3.0]), np.array(u)
    np.testing.assert_allclose(eq5_x(x, step), move(x, step), atol=1e-14)
    np.testing.assert_allclose(eq7_A(x, eq5_x(x, step)), numeric_jacobian(lambda p: eq5_x(p, step), x), atol=1e-8)


# --- the equations of the filter's kernel against a textbook's, whatever stands in the numbers, interpreted too

Q = np.array([[1e-4, 1e-6, 2e-6], [1e-6, 2e-5, 1e-5], [2e-6, 1e-5, 4e-4]])


def random_belief(states: int, seed: int, start: Triangle = UPPER) -> JointBelief:
    """A pose and states that hang together with it."""
    rng = np.random.default_rng(seed)
    belief = JointBelief((0.3, -0.2, 3.0), start)
    for _ in range(states):
        belief.augment(rng.normal(size=1), rng.normal(size=(1, 3)), np.array([[rng.uniform(0.01, 0.1)]]))
    return belief


def book_of(belief: JointBelief) -> TextbookEkf:
    return TextbookEkf(belief.state, belief.covariance)


def agrees(belief: JointBelief, book: TextbookEkf) -> None:
    np.testing.assert_allclose(belief.state, book.x, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(belief.covariance, book.P, rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(belief.covariance, belief.covariance.T)


@pytest.mark.parametrize("states", [0, 1, 5, 30])
@pytest.mark.parametrize("wheels", [False, True])
def test_a_prediction_is_that_of_the_textbook(states: int, wheels: bool) -> None:
    rng = np.random.default_rng(states)
    belief = random_belief(states, 1)
    book, p = book_of(belief), min(states, 3) if wheels else 0
    u, J = rng.normal(size=3), 0.1 * rng.normal(size=(3, p))
    belief.wheels = 3 if p else -1
    belief.predict(step(u, Q, 0.1, J), 0)
    book.predict(u, Q, J if p else None, range(3, 3 + p))
    agrees(belief, book)


@pytest.mark.parametrize("states", [0, 1, 5, 30])
@pytest.mark.parametrize("count", [1, 2, 3, 7])
@pytest.mark.parametrize("considered", [(), (0, 3)])
@pytest.mark.parametrize("start", [UPPER, EXACT, LOST])
def test_corrections_are_textbook(states: int, count: int, considered: tuple[int, ...], start: Triangle) -> None:
    """Readings of two numbers each, by the pose and two states."""
    belief, rng = random_belief(states, 1, start), np.random.default_rng(count)
    pairs = (
        tuple((3 + rng.choice(states, 2, replace=False)).tolist()) if states > 1 else () for _ in range(count)
    )
    told = [some_told(rng, 2, columns) for columns in [*pairs]]
    kept, book = [c for c in considered if c < belief.n], book_of(belief)
    belief.consider(np.array(kept, np.int64))
    y, H, R = dense(told, belief.n)
    S = H @ book.P @ H.T + R
    belief.begin()
    seen = [one.judged(belief) for one in told]
    for i, one in enumerate(seen):
        at = slice(2 * i, 2 * i + 2)
        assert one.nis == pytest.approx(y[at] @ np.linalg.solve(S[at, at], y[at]), rel=1e-9)
        np.testing.assert_allclose(one.sigma, np.sqrt(np.diagonal(S[at, at])), rtol=1e-12)
        belief.queue(one)
    assert belief.fit_of(0, 2 * count) == pytest.approx(y @ np.linalg.solve(S, y), rel=1e-9)
    belief.correct()
    assert belief.fit(2) == pytest.approx(seen[0].nis, rel=1e-9)  # the first alone
    book.correct(y, H, R, kept)
    agrees(belief, book)


def test_turning_the_frame_is_a_linear_map_of_the_covariance() -> None:
    belief = random_belief(5, 2)
    belief.frame = 5
    A, P = np.eye(belief.n), belief.covariance.copy()
    A[5, 7], A[6, 7] = 0.2, 0.1
    belief.turn_frame(0.1, -0.2)
    np.testing.assert_allclose(belief.covariance, A @ P @ A.T, atol=1e-12)
    np.testing.assert_array_equal(belief.covariance, belief.covariance.T)


def test_a_clone_is_the_pose_that_it_was_taken_of() -> None:
    belief = random_belief(6, 2)
    P, x = belief.covariance.copy(), belief.state.copy()
    belief.copy_pose(4)
    A = np.eye(belief.n)
    A[4:7] = A[:3]
    np.testing.assert_array_equal(belief.state, A @ x)
    np.testing.assert_allclose(belief.covariance, A @ P @ A.T, atol=1e-15)


def test_states_are_replaced_by_functions_of_themselves() -> None:
    belief, rng = random_belief(6, 2), np.random.default_rng(3)
    belief.begin_frame()
    P, x, at, G = belief.covariance.copy(), belief.state.copy(), [5, 2, 7], rng.normal(size=(3, 3))
    row = np.zeros(belief.n)
    row[at] = G[0]
    assert belief.variance((0.0, 0.0, 0.0), at, G[0]) == pytest.approx(row @ P @ row, rel=1e-12)
    belief.transform(at, (1.0, 2.0, 3.0), G)
    A = np.eye(belief.n)
    A[np.ix_(at, at)] = G
    x[at] = 1.0, 2.0, 3.0
    np.testing.assert_array_equal(belief.state, x)
    np.testing.assert_allclose(belief.covariance, A @ P @ A.T, atol=1e-12)


def test_a_number_that_is_none_is_refused_in_one_line() -> None:
    bad = Told((0.1, 0.1), np.ones((2, 3)), ((math.nan, 0.0), (0.0, 1.0)))
    with pytest.raises(LocfuseError, match="became singular"):
        correct(random_belief(0, 1), bad)


# --- the pose in the map, by that in the frame and the frame's place

Array = np.ndarray
START = (1.0, -2.0, 0.4)
P1: Triangle = (0.09, 0.01, 0.004, 0.05, -0.003, 0.02)
Q1: Triangle = (1e-4, 0.0, 0.0, 2e-5, 1e-5, 4e-4)
U = (0.3, 0.02, 0.25)
STEP = step(U, Q1)
OFFSET = Block("offset", np.array([0.7]), np.array([[0.04]]), np.zeros(1))
COMPASS = ((0.0, 0.0, 1.0),)
NORTH = ((0.6, -0.8, 0.3),)  # any row of the pose in the map


def empty(name: str, k: int) -> Block:
    return Block(name, np.zeros(k), np.zeros((k, k)), np.zeros(k))


def row(H: Any, y: float, r: float, columns: Any = (), own: Any = ()) -> Told:
    return Told((y,), H, ((r,),), columns, own)


def correct_in_map(belief: JointBelief, *told: Told) -> None:
    """One instant: what is seen of the pose in the map."""
    belief.begin()
    world = InMap(belief)
    for seen in [s.judged(world) for s in told]:
        belief.queue(seen)
    belief.correct()


def driven(belief: JointBelief) -> JointBelief:
    """Some way with a compass, a frame that begins, local rows, and a compass again: every state is correlated."""
    at = belief.column("offset")
    belief.predict(STEP, 0)
    correct(belief, row(COMPASS, 0.05, 0.01, (at,), ((1.0,),)))
    belief.begin_frame()
    for y in (0.02, -0.03, 0.01):
        belief.predict(STEP, 0)
        correct(belief, row(((0.6, 0.8, -0.2),), y, 1e-4))
        correct_in_map(belief, row(COMPASS, y, 0.02, (at,), ((1.0,),)), row(NORTH, 4 * y, 0.03))
    return belief


@pytest.mark.parametrize("tt", [1e-8, 1e-3, 0.0015, 0.01, 0.3, 3.0])
def test_a_lever_spreads_along_itself_as_samples_do(tt: float) -> None:
    angle = math.sqrt(tt) * np.linspace(-9, 9, 20001)
    weight = np.exp(-0.5 * angle**2 / tt)
    expected = float((weight * (np.cos(angle) - 1) ** 2).sum() / weight.sum())
    assert bent(tt) == pytest.approx(expected, rel=1e-6 if tt > 1e-3 else 2e-3)


def test_the_pose_in_the_map_has_the_covariance_of_finite_differences() -> None:
    belief = driven(JointBelief(START, P1, [OFFSET]))
    at = [0, 1, 2, belief.frame, belief.frame + 1, belief.frame + 2]
    x, P = np.asarray(belief.state)[at], np.asarray(belief.covariance)[np.ix_(at, at)]
    J = numeric_jacobian(lambda v: move(v[3:], v[:3]), x)
    r = (move(x[3:], x[:3]) - x[3:])[:2]
    expected = J @ P @ J.T
    expected[:2, :2] += bent(P[5, 5]) * np.outer(r, r)
    np.testing.assert_allclose(InMap(belief).pose(), move(x[3:], x[:3]), atol=1e-14)
    np.testing.assert_allclose(matrix_in_map(belief), expected, atol=1e-9)
    alone = map_covariance(x[None, 3:], x[None, :3], P[None])[0]
    np.testing.assert_allclose(alone, matrix_in_map(belief), atol=1e-14)
    np.testing.assert_array_equal(belief.covariance, belief.covariance.T)
    assert not np.allclose(matrix_in_map(belief), belief.matrix())


LANDMARK, LEVER = np.array([3.0, 1.0]), np.array([0.2, -0.1])


def bearing(p: Array) -> Array:
    return np.array([math.atan2(LANDMARK[1] - p[1], LANDMARK[0] - p[0]) - p[2]])


def antenna(p: Array) -> Array:
    return move(p, np.array([*LEVER, 0.0]))[:2]


@pytest.mark.parametrize("h", [bearing, antenna, lambda p: p[2:]])
def test_what_observes_the_pose_in_the_map_observes_both_by_the_chain_rule(h: Callable[[Array], Array]) -> None:
    belief = driven(JointBelief(START, P1, [OFFSET]))
    first = belief.frame
    H = numeric_jacobian(h, np.array(InMap(belief).pose()))
    expected = numeric_jacobian(lambda x: h(move(x[first : first + 3], x[:3])), belief.state.copy())
    d = len(H)
    seen = Told((0.1,) * d, H, np.eye(d), (3,), ((0.5,),) * d).judged(InMap(belief))
    _, columns, by, _ = belief.equation([seen])
    found = np.zeros((d, belief.n))
    found[:, columns] = by
    expected[:, 3] = 0.5
    np.testing.assert_allclose(found, expected, atol=1e-8)
    spread = found @ belief.covariance @ found.T
    np.testing.assert_allclose(seen.sigma, np.sqrt(np.diagonal(spread) + 1.0), rtol=1e-9)
    found[0, 3] = 0.0
    assert InMap(belief).variance(H[0]) == pytest.approx(found[0] @ belief.covariance @ found[0], rel=1e-9)


def test_a_frame_begins_without_a_change_in_the_map() -> None:
    """Also for a kept heading and wheel states: the joint covariance is that of the states as functions."""
    belief = JointBelief(START, P1, [empty("kept", 1), OFFSET])
    belief.add(Block("wheels", np.zeros(3), np.diag([1e-3, 2e-3, 3e-3]), np.zeros(3)))
    belief.drive_with("wheels")
    J = np.array([[0.15, 0.15, 0.0], [0.0, 0.0, 0.0], [-0.5, 0.5, -0.3]])
    belief.predict(step(U, Q1, 0.1, J), 0)
    belief.clone_heading(3)
    belief.predict(step(U, Q1, 0.1, J), 0)
    x, P, n = belief.state.copy(), belief.covariance.copy(), belief.n

    def begun(x: Array) -> Array:
        return np.concatenate((np.zeros(3), [x[3] - x[2]], x[4:n], x[:3]))

    T = numeric_jacobian(begun, x)
    pose, spread = belief.pose(), belief.matrix()
    belief.begin_frame()
    np.testing.assert_allclose(belief.state, begun(x), atol=1e-14)
    np.testing.assert_allclose(belief.covariance, T @ P @ T.T, atol=1e-9)
    assert InMap(belief).pose() == pose
    np.testing.assert_allclose(matrix_in_map(belief), spread, atol=1e-15)
    assert not belief.covariance[:3].any()
    belief.predict(step(U, Q1, 0.1, J), 0)
    belief.clone_heading(3)
    x, P, pose = belief.state.copy(), belief.covariance.copy(), InMap(belief).pose()
    belief.begin_frame()  # once more, after a map was lost

    def moved(x: Array) -> Array:
        return np.concatenate((np.zeros(3), [x[3] - x[2]], x[4:n], move(x[n : n + 3], x[:3])))

    T = numeric_jacobian(moved, x)
    np.testing.assert_allclose(belief.state, moved(x), atol=1e-14)
    np.testing.assert_allclose(belief.covariance, T @ P @ T.T, atol=1e-9)
    np.testing.assert_allclose(InMap(belief).pose(), pose, atol=1e-14)


def seen_from(p: Array, q: Array) -> Array:
    """Pose q as it is seen from pose p."""
    return move(np.array([*(-turned(-p[2]) @ p[:2]), -p[2]]), q)


def turned(angle: float) -> Array:
    return np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])


def with_kept_pose_and_point() -> tuple[JointBelief, int]:
    """A belief that keeps a pose and a heading of earlier instants, and a point seen on the way: its column."""
    belief = JointBelief(START, P1, [empty("kept", 3), empty("heading", 1)])
    belief.clone_pose(3)
    belief.predict(STEP, 0)
    belief.clone_heading(6)
    point = belief.augment(np.array([2.0, 1.0]), np.array([[1.0, 0.0, 0.4], [0.0, 1.0, -0.7]]), 0.01 * np.eye(2))
    belief.own_point("point", point)
    belief.predict(STEP, 0)
    return belief, point


def test_a_kept_pose_and_a_point_are_seen_from_where_the_frame_begins() -> None:
    belief, point = with_kept_pose_and_point()
    x, P = belief.state.copy(), belief.covariance.copy()

    def begun(x: Array) -> Array:
        place = seen_from(x[:3], np.array([*x[point : point + 2], 0.0]))[:2]
        return np.concatenate((np.zeros(3), seen_from(x[:3], x[3:6]), [x[6] - x[2]], place, x[:3]))

    T = numeric_jacobian(begun, x)
    belief.begin_frame()
    np.testing.assert_allclose(belief.state, begun(x), atol=1e-14)
    np.testing.assert_allclose(belief.covariance, T @ P @ T.T, atol=1e-9)


def test_what_is_kept_goes_along_to_the_frame_of_another_submap() -> None:
    """Else the gyro, or poses of another program, would measure the change of the frame as a motion."""
    belief, point = with_kept_pose_and_point()
    belief.begin_frame()
    belief.predict(STEP, 0)
    x, P, R, frame = belief.state.copy(), belief.covariance.copy(), np.array([9.0, -4.0, 2.5]), belief.frame

    def changed(x: Array) -> Array:
        place, back = move(R, np.array([*x[point : point + 2], 0.0]))[:2], seen_from(R, np.zeros(3))
        poses = move(R, x[:3]), move(R, x[3:6]), [x[6] + R[2]]
        return np.concatenate((*poses, place, move(x[frame : frame + 3], back)))

    T = numeric_jacobian(changed, x)
    belief.change_frame(R)
    np.testing.assert_allclose(belief.state, changed(x), atol=1e-14)
    np.testing.assert_allclose(belief.covariance, T @ P @ T.T, atol=1e-8)


def test_a_slip_turns_the_pose_and_leaves_the_way_from_what_is_kept_as_it_was() -> None:
    """The pose was wrong all along: a kept heading and a kept pose were wrong by the same."""
    belief = JointBelief(START, P1, [empty("heading", 1), empty("pose", 3)])
    belief.clone_heading(3)
    belief.clone_pose(4)
    belief.predict(STEP, 0)
    x, P = belief.state.copy(), belief.covariance.copy()
    belief.shift((0.0, 0.0, 0.2), 0.01, 0.02)
    after = belief.state
    np.testing.assert_allclose(after[:3], (x[0], x[1], x[2] + 0.2), atol=1e-15)
    np.testing.assert_allclose(belief.matrix(), P[:3, :3] + np.diag([0.01, 0.01, 0.02]), atol=1e-15)
    assert after[2] - after[3] == pytest.approx(x[2] - x[3])
    np.testing.assert_allclose(seen_from(after[:3], after[4:7]), seen_from(x[:3], x[4:7]), atol=1e-14)
    now = belief.covariance  # of the way between: exactly as long, and turned exactly as far
    J = numeric_jacobian(lambda v: seen_from(v[:3], v[4:7]), after.copy())
    np.testing.assert_allclose(J @ now @ J.T, 0.0, atol=1e-9)
    assert now[2, 2] + now[3, 3] - 2.0 * now[2, 3] == pytest.approx(0.0, abs=1e-12)


def test_a_pose_that_is_only_tried_leaves_every_bit_of_the_belief_as_it_was() -> None:
    """A kept heading that has fallen behind is no copy of the pose any more, and must not become one again."""
    belief = JointBelief(START, P1, [empty("heading", 1)])
    belief.clone_heading(3)
    belief.predict(STEP, 0)
    x, P = belief.state.copy(), belief.covariance.copy()
    with tried(belief, (0.1, -0.2, 0.3), 0.01, 0.02):
        np.testing.assert_allclose(belief.pose(), x[:3] + np.array([0.1, -0.2, 0.3]), atol=1e-15)
        np.testing.assert_allclose(belief.matrix(), P[:3, :3] + np.diag([0.01, 0.01, 0.02]), atol=1e-15)
    np.testing.assert_array_equal(belief.state, x)
    np.testing.assert_array_equal(belief.covariance, P)


def test_what_is_local_teaches_the_frame_nothing() -> None:
    belief = JointBelief(START, P1, [])
    belief.begin_frame()
    first, before = belief.frame, belief.covariance.copy()
    frame = slice(first, first + 3)
    for _ in range(50):
        belief.predict(STEP, 0)
        correct(belief, row(((0.3, -0.9, 0.2),), 0.01, 1e-6), row(COMPASS, 0.02, 1e-6))
    np.testing.assert_array_equal(belief.covariance[frame, frame], before[frame, frame])
    np.testing.assert_array_equal(belief.state[frame], START)


def test_a_lost_pose_teaches_the_frame_nothing() -> None:
    belief = driven(JointBelief(START, P1, [OFFSET]))
    frame = slice(belief.frame, belief.frame + 3)
    belief.place(belief.pose(), 25.0, 3.0)
    before, G = belief.covariance.copy(), belief.state[frame].copy()
    belief.lost = True
    correct_in_map(belief, row(COMPASS, 0.4, 1e-4), row(NORTH, 1.0, 0.01))
    np.testing.assert_array_equal(belief.state[frame], G)
    np.testing.assert_array_equal(belief.covariance[frame, frame], before[frame, frame])
    assert belief.matrix()[2, 2] < 0.1  # and the pose takes all of it
    assert np.linalg.eigvalsh(belief.covariance).min() > -1e-12


def test_listening_teaches_the_frame_nothing() -> None:
    belief = driven(JointBelief(START, P1, [OFFSET]))
    frame, G = slice(belief.frame, belief.frame + 3), belief.state.copy()
    belief.begin()
    belief.listen([row(COMPASS, 0.4, 1e-4, (3,), ((1.0,),)).judged(InMap(belief))])
    np.testing.assert_array_equal(belief.state[frame], G[frame])
    assert belief.state[3] != G[3]


@pytest.mark.parametrize("column", [0, 1])
def test_where_the_frames_place_is_corrected_its_uncertainty_turns_about_the_same_point(column: int) -> None:
    """The textbook's filter, then the lever: a turn moves the frame's new place otherwise than its old one."""
    belief = driven(JointBelief(START, P1, [OFFSET]))
    assert belief.framed
    n, f, y, r = belief.n, belief.frame, 0.3, 0.01
    x, P = np.array(belief.state)[:n].copy(), np.array(belief.covariance)[:n, :n].copy()
    H = np.eye(n)[f + column]
    K = P @ H / (H @ P @ H + r)
    moved, P = x + K * y, P - np.outer(K, H @ P)
    dx, dy = (moved - x)[f : f + 2]
    assert min(abs(dx), abs(dy)) > 1e-3
    A = np.eye(n)
    A[f, f + 2], A[f + 1, f + 2] = -dy, dx
    belief.know((y,), ((r,),), (f + column,), ((1.0,),))
    np.testing.assert_allclose(np.array(belief.state)[:n], moved, atol=1e-12)
    np.testing.assert_allclose(np.array(belief.covariance)[:n, :n], A @ P @ A.T, atol=1e-12)
