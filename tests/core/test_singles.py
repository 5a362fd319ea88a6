"""Single readings of an instant, each against a textbook filter whose derivatives are differences."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from core_tables import FRAME, GATE, REFUSED, N, believed, table
from textbook import Array, TextbookEkf, move, numeric_jacobian, wrap

from locfuse.fusion.core import coast, echoes, fixes, poses, sightings, singles, turns, twists
from locfuse.fusion.core.bearings import RAY

FREE = 7  # the first column of what a sensor owns
Predicted = Callable[[Array], Array]


def desk(own: int = 9) -> Any:
    """Room for an instant without a scan, left full of another one's numbers."""
    m, columns = own, singles.WIDE * own
    return table(
        H=np.full((m, columns), 7.0), R=np.full((m, m), 7.0), y=np.full(m, 7.0), at=np.full(columns, 7),
        V=np.full((m + 4, N), 7.0), located=np.empty(9), place=np.empty(3), ray=np.empty(RAY), chain=np.empty(6),
        own_at=np.full((own, singles.WIDE), 7), own_H=np.full((own, singles.WIDE), 7.0), own_y=np.full(own, 7.0),
        own_R=np.full((own, 3), 7.0), own_states=np.full(own, 7), follows=np.full(own, 7), S=np.empty((3, 3)),
        e=np.empty(3), noise=np.empty(6), triangle=np.empty(6), apart=np.empty(poses.SEEN_FROM),
        chord=np.empty(twists.CHORD), tie=np.empty(4), fix=np.empty(fixes.FIX), echo=np.empty(echoes.ECHO),
        by=np.empty(3), singles=0,
    )  # fmt: skip


def in_map(x: Array, frame: int) -> Array:
    return x[:3] if frame < 0 else move(x[frame : frame + 3], x[:3])


def correct(b: Any, d: Any, accepted_heading: int = -1) -> None:
    h = table(taken=accepted_heading)
    assert coast.correct_by(b, table(), 0, 0, h, False, table(free=0), table(joint=False), d) > 0.0


def assert_told(told: Array, y: Array, S: Array, gate: float, landmark: float = -1.0) -> None:
    nis = float(y @ np.linalg.solve(S, y))
    expected = [0.0 if nis <= gate else REFUSED, landmark, nis, gate, *y, *np.sqrt(np.diag(S))]
    np.testing.assert_allclose(told, expected, rtol=1e-6, atol=1e-9)


def assert_compares(
    b: Any, d: Any, told: Array, h: Predicted, z: Array, R: Array, turns_at: tuple[int, ...] = (), **of: Any
) -> None:
    """What was told, and what is corrected, is the textbook's with the derivative of h by differences."""
    before, P = b.x.copy(), b.P.copy()
    y = z - h(before)
    for i in turns_at:
        y[i] = wrap(float(y[i]))
    H, book = numeric_jacobian(h, before), TextbookEkf(before, P)
    assert_told(told, y, H @ P @ H.T + R, of.get("gate", GATE), of.get("landmark", -1.0))
    assert d.singles == len(z)
    correct(b, d)
    book.correct(y, H, R)
    expected = book.P
    if b.frame >= 0:  # its place moved: a turn of the map now moves it otherwise
        A, moved = np.eye(N), (book.x - before)[FRAME : FRAME + 2]
        A[FRAME, FRAME + 2], A[FRAME + 1, FRAME + 2] = -moved[1], moved[0]
        expected = A @ expected @ A.T
    np.testing.assert_allclose(b.x, book.x, atol=1e-7)
    np.testing.assert_allclose(b.P, expected, atol=1e-7)


# --- satellites


def turned(angle: float) -> Array:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s], [s, c]])


@pytest.mark.parametrize("frame", [-1, FRAME])
@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("given", [True, False])
def test_a_fix_corrects_pose_map_frame_and_the_tie_to_the_earth(given: bool, known: bool, frame: int) -> None:
    rng = np.random.default_rng(7)
    b, d, at, lever, start = believed(1, frame), desk(), FREE, np.array([0.3, -0.2]), np.array([0.7, 0.4])
    tie = np.array([0.6, 1.0, 0.2, -0.1]) if known else np.array([0.8, -0.5, 0.2, -0.1])
    b.x[at : at + 4] = tie
    R = np.array([[0.2, 0.05], [0.05, 0.3]])

    def h(x: Array) -> Array:
        pose, now = in_map(x, frame), tie if given else x[at : at + 4]
        away = pose[:2] + turned(pose[2]) @ lever - start
        a, e = (math.cos(now[0]), math.sin(now[0])) if known else (now[0], now[1])
        return np.asarray(np.array([[a, e], [-e, a]]) @ away + now[2:])

    z = h(b.x) + rng.normal(0.0, 0.2, 2)
    f = table(
        z=z[None], R=np.array([[0.2, 0.05, 0.3]]), told=singles_told(2), lever_x=0.3, lever_y=-0.2, from_x=0.7,
        from_y=0.4, tie=tie, at=-1 if given else at, known=known, gate=GATE, refused=REFUSED,
    )  # fmt: skip
    assert fixes.locate_fix(b, f, 0, d) > 0.0
    assert_compares(b, d, f.told[0], h, z, R)


def singles_told(numbers: int, rows: int = 1) -> Array:
    return np.full((rows, 4 + 2 * numbers), np.nan)


# --- a gyro


@pytest.mark.parametrize("estimated", [True, False])
def test_a_turn_corrects_heading_kept_heading_and_bias(estimated: bool) -> None:
    b, d = believed(2), desk()
    bias = 0.03
    b.x[FREE], b.x[FREE + 1] = b.x[2] - 0.4, bias

    def h(x: Array) -> Array:
        return np.array([x[2] - x[FREE] + (x[FREE + 1] if estimated else bias) * 0.5])

    z = np.array([0.31])
    g = table(
        t=np.array([1.0, 1.5]), z=np.array([2.0, 2.31]), piece=np.zeros(2), told=singles_told(1, 2), walk=0.02,
        by_scale=0.1, bias=bias, at_bias=FREE + 1 if estimated else -1, at_before=FREE, rest_begin=math.inf,
        rest_end=-math.inf, gate=GATE, refused=REFUSED, repeated=6.0, last=0,
    )  # fmt: skip
    assert turns.turned(b, g, 1, d) > 0.0
    before, P = b.x.copy(), b.P.copy()
    assert_compares(b, d, g.told[1], h, z, np.array([[0.01 + 0.031**2]]))
    turns.begin_turn(b, g, 1)
    assert g.last == 1
    clone = np.eye(N)
    clone[FREE] = clone[2]
    book = TextbookEkf(before, P)
    book.correct(z - h(before), numeric_jacobian(h, before), np.array([[0.01 + 0.031**2]]))
    np.testing.assert_allclose(b.x, clone @ book.x, atol=1e-7)
    np.testing.assert_allclose(b.P, clone @ book.P @ clone.T, atol=1e-7)


def test_a_turn_after_a_gap_and_one_within_the_rest_that_gave_the_bias_correct_nothing() -> None:
    b, d = believed(3), desk()
    g = table(
        t=np.arange(4.0), z=np.arange(4.0), piece=np.array([0.0, 1.0, 1.0, 1.0]), told=singles_told(1, 4),
        rest_begin=1.0, rest_end=2.0, gate=GATE, repeated=6.0, refused=REFUSED, last=0, walk=0.1, by_scale=0.0,
        bias=0.0, at_bias=-1, at_before=FREE,
    )  # fmt: skip
    assert turns.turned(b, g, 1, d) > 0.0
    assert np.isnan(g.told[1]).all()
    g.last = 1
    assert turns.turned(b, g, 2, d) > 0.0
    assert (g.told[2, 0], g.told[2, 3]) == (6.0, GATE)
    assert np.isnan(g.told[2, [2, 4, 5]]).all()
    g.last = 2
    assert turns.turned(b, g, 3, d) > 0.0  # ends beyond the rest
    assert np.isfinite(g.told[3]).all()


# --- poses and speeds of somebody else


def seen_from(a: Array, b: Array) -> Array:
    return np.append(turned(-a[2]) @ (b[:2] - a[:2]), b[2] - a[2])


R_POSE = np.array([[0.2, 0.05, 0.02], [0.05, 0.3, -0.04], [0.02, -0.04, 0.1]])
WAY, TURN_BY_WAY, ARM, LEAST, LEAST_TURN = 0.03, 0.07, 0.15, 1e-3, 2e-3


def pose_table(z: Array, drifts: int = 0, in_map: bool = False) -> Any:
    rows = len(z)
    return table(
        z=z, R=np.tile(R_POSE[np.triu_indices(3)], (rows, 1)), drifts=[drifts] * rows, told=singles_told(3, rows),
        in_map=in_map, at_kept=FREE, by_way=WAY, turn_by_way=TURN_BY_WAY, arm=ARM, floor=LEAST,
        turn_floor=LEAST_TURN, gate=GATE, refused=REFUSED, last=0,
    )  # fmt: skip


@pytest.mark.parametrize("frame", [-1, FRAME])
@pytest.mark.parametrize("turns_round", [0.0, math.tau])
def test_a_pose_in_the_map_corrects_pose_and_map_frame(turns_round: float, frame: int) -> None:
    b, d = believed(11, frame), desk()
    z = in_map(b.x, frame) + np.array([0.3, -0.2, 0.1])
    p = pose_table(np.array([np.zeros(3), z + np.array([0.0, 0.0, turns_round])]), in_map=True)
    assert poses.posed(b, p, 1, d) > 0.0
    before, P = b.x.copy(), b.P.copy()
    assert_compares(b, d, p.told[1], lambda x: in_map(x, frame), z, R_POSE, (2,))
    b.x, b.P = before, P
    poses.begin_pose(b, p, 1, d)
    assert p.last == 0  # nothing is kept
    np.testing.assert_array_equal(b.x, before)


@pytest.mark.parametrize("drifts", [0, 1])
@pytest.mark.parametrize("others", [0, 1])
def test_the_motion_of_a_source_corrects_pose_and_kept_pose_which_then_moves_on(others: int, drifts: int) -> None:
    b, d = believed(12 + drifts), desk()
    kept = np.array([0.4, -0.3, 0.8])
    b.x[FREE : FREE + 3] = kept
    z = np.array([[2.0, 1.0, -0.7], [2.5, 1.4, -0.2]])
    u = seen_from(z[0], z[1])
    b.x[:3] = move(kept, u + np.array([0.2, -0.1, 0.05]))

    def h(x: Array) -> Array:
        return seen_from(x[FREE : FREE + 3], x[:3])

    way = math.hypot(*u[:2]) + ARM * abs(u[2])
    T = np.eye(3)
    T[:2, :2] = turned(-z[0, 2])
    R = (
        np.diag((WAY * way + LEAST, WAY * way + LEAST, TURN_BY_WAY * way + LEAST_TURN))
        if drifts
        else T @ R_POSE @ T.T
    )
    p = pose_table(z, drifts)
    if others:  # another reading waits before it
        singles.state_of(d, 0, 0, 2, 1.0)
        singles.say(d, 0, 0.0, 1e12, 0.0, 0)
        singles.wait(d, 1, 1)
    assert poses.posed(b, p, 1, d) > 0.0
    before, P = b.x.copy(), b.P.copy()
    H = numeric_jacobian(h, before)
    assert_told(p.told[1], u - h(before), H @ P @ H.T + R, GATE)
    assert d.singles == 3 + others
    correct(b, d)
    book = TextbookEkf(before, P)
    book.correct(u - h(before), H, R)
    np.testing.assert_allclose(b.x, book.x, atol=1e-7)
    np.testing.assert_allclose(b.P, book.P, atol=1e-7)
    poses.begin_pose(b, p, 1, d)
    assert p.last == 1

    def next_kept(x: Array) -> Array:
        moved = x.copy()
        moved[FREE : FREE + 3] = x[:3] if drifts else move(x[FREE : FREE + 3], u)
        return moved

    J = numeric_jacobian(next_kept, book.x)
    np.testing.assert_allclose(b.x, next_kept(book.x), atol=1e-7)
    np.testing.assert_allclose(b.P, J @ book.P @ J.T, atol=1e-7)


def test_a_pose_far_off_is_refused_and_one_without_a_finite_variance_is_not_compared() -> None:
    b, d = believed(5), desk()
    p = pose_table(np.array([b.x[:3] + 9.0, b.x[:3]]), in_map=True)
    p.R[1] = math.inf
    for row in range(2):
        with np.errstate(invalid="ignore"):  # inf - inf
            assert poses.posed(b, p, row, d) > 0.0
        assert (p.told[row, 0], d.singles) == (REFUSED, 0)
    assert np.isfinite(p.told[0]).all()
    assert math.isnan(p.told[1, 2])


@pytest.mark.parametrize("turn", [0.0, 0.5, -0.5 + math.tau])
def test_way_and_turn_of_a_source_are_the_chord_of_an_arc(turn: float) -> None:
    b, d = believed(14), desk()
    kept = np.array([0.4, -0.3, 0.8])
    bent = wrap(turn)
    chord = 0.6 * (math.sin(0.5 * turn) / (0.5 * turn) if turn else 1.0)
    b.x[FREE : FREE + 3] = kept
    b.x[:3] = move(kept, np.array([0.55 * math.cos(0.5 * bent), 0.55 * math.sin(0.5 * bent), bent + 0.03]))
    variance = np.array([[0.1, 0.2], [0.14, 0.23]])
    w = table(
        z=np.array([[3.0, 1.0], [3.6, 1.0 + turn]]), variance=variance, piece=np.zeros(2),
        told=singles_told(2, 2), at_kept=FREE, by_scale=0.01, floor=LEAST, turn_floor=LEAST_TURN, gate=GATE,
        refused=REFUSED, last=0,
    )  # fmt: skip

    def h(x: Array) -> Array:
        q = seen_from(x[FREE : FREE + 3], x[:3])
        return np.array([q[0] * math.cos(0.5 * q[2]) + q[1] * math.sin(0.5 * q[2]), q[2]])

    R = np.diag((0.04 + 0.01 * 0.36 + LEAST, 0.03 + 0.01 * turn**2 + LEAST_TURN))
    assert twists.driven(b, w, 1, d) > 0.0
    assert_compares(b, d, w.told[1], h, np.array([chord, bent]), R, (1,))
    before, P = b.x.copy(), b.P.copy()
    twists.begin_way(b, w, 1)
    assert w.last == 1
    clone = np.eye(N)
    clone[FREE : FREE + 3] = clone[:3]
    np.testing.assert_allclose(b.x, clone @ before, atol=1e-12)
    np.testing.assert_allclose(b.P, clone @ P @ clone.T, atol=1e-12)


def test_a_way_after_a_gap_is_not_compared() -> None:
    b, d, told = believed(3), desk(), singles_told(2, 2)
    w = table(z=np.ones((2, 2)), piece=np.array([0.0, 1.0]), told=told, last=0)
    assert twists.driven(b, w, 1, d) > 0.0
    assert np.isnan(told).all()
    assert d.singles == 0


@pytest.mark.parametrize("turn", [math.nan, math.inf])
def test_a_turn_that_is_no_number_gives_no_chord(turn: float) -> None:
    assert math.isnan(twists.straight(1.0, turn))
    assert twists.straight(1.5, 0.0) == 1.5


# --- landmarks

MOUNTS = ((0.2, -0.1, 0.3), (-0.15, 0.05, 2.0))  # of two cameras


def sighted(z: Array, made: bool, offset: bool, depth: bool, **of: Any) -> Any:
    rows = len(z)
    return table(**{
        "first": [0, rows], "z": z, "R": np.tile([0.01, 0.002, 0.03], (rows, 1)), "numbers": z.shape[1],
        "which": list(range(rows)), "ids": [6, 9], "places": np.array([[4.0, 3.0], [-2.0, 3.5]]),
        "columns": [FREE, FREE + 2] if made else [-1, -1], "made": made, "mounts": np.array(MOUNTS[:rows]),
        "offset": 0.04, "depth": 0.25, "at_offset": FREE + 4 if offset else -1,
        "at_depth": FREE + 5 if depth else -1, "sigma_bearing": 0.02, "sigma_range": 0.1, "most": 100.0,
        "told": singles_told(z.shape[1], rows), "joint": np.zeros((1, 2)), "placed": np.full((rows, 3), np.nan),
        "gate": GATE, "refused": REFUSED, **of,
    })  # fmt: skip


def range_and_bearing(x: Array, g: Any, row: int, frame: int, seen: float) -> Array:
    """Written from the textbook; `seen` is the bearing that was measured."""
    pose = x[:3] if g.made else in_map(x, frame)
    place = x[g.columns[row] : g.columns[row] + 2] if g.made else g.places[row]
    lever_x, lever_y, yaw = g.mounts[row]
    detector = pose[:2] + turned(pose[2]) @ [lever_x, lever_y]
    away = place - detector
    angle = math.atan2(away[1], away[0]) - pose[2] - yaw
    offset = x[g.at_offset] if g.at_offset >= 0 else g.offset
    depth = x[g.at_depth] if g.at_depth >= 0 else g.depth
    share = 1.0 - depth * (1.0 - math.cos(seen))
    return np.array([angle, share * math.hypot(*away) + offset])[: g.numbers]


@pytest.mark.parametrize("frame", [-1, FRAME])
@pytest.mark.parametrize("made", [True, False])
@pytest.mark.parametrize(("offset", "depth"), [(True, True), (False, True), (False, False)])
def test_a_detection_corrects_pose_place_offset_and_depth(
    offset: bool, depth: bool, made: bool, frame: int
) -> None:
    b, d = believed(5, frame), desk()
    b.x[FREE : FREE + 6] = [4.0, 3.0, -2.0, 3.5, 0.03, 0.2]
    b.P *= 1e-2  # so that the spread of second order is small, and yet counts
    g = sighted(np.zeros((1, 2)), made, offset, depth)
    seen = float(range_and_bearing(b.x, g, 0, frame, 0.0)[0]) + 0.02
    z = np.array([seen, range_and_bearing(b.x, g, 0, frame, seen)[1] + 0.1])
    g.z[0] = z

    def h(x: Array) -> Array:
        return range_and_bearing(x, g, 0, frame, seen)

    H = numeric_jacobian(h, b.x)[0]
    by_place = np.array(H)  # of the position alone: by the heading and by the landmark the bearing is exact
    if made or frame < 0:
        by_place[2:] = 0.0
    else:
        by_place[:] = by_position(b.x, g, frame)
    bend = float(by_place @ b.P @ by_place)
    assert bend > 1e-5
    assert sightings.detect(b, g, 0, False, d) > 0.0
    R = np.array([[0.01 + bend**2, 0.002], [0.002, 0.03]])
    assert_compares(b, d, g.told[0], h, z, R, (0,), landmark=6.0)


def by_position(x: Array, g: Any, frame: int) -> Array:
    """The derivative of the bearing by the place in the map, its heading held, through local pose and frame."""

    def held(y: Array) -> Array:
        pose, now = in_map(x, frame), in_map(y, frame)
        away = g.places[0] - now[:2] - turned(pose[2]) @ g.mounts[0, :2]
        return np.array([math.atan2(away[1], away[0])])

    return np.asarray(numeric_jacobian(held, x)[0])


def test_where_a_detection_puts_its_landmark_is_kept_with_its_sigma() -> None:
    b, d = believed(6), desk()
    b.P *= 1e-3
    g = sighted(np.array([[0.4, 2.0]]), False, False, False, most=1.0)
    assert sightings.detect(b, g, 0, False, d) > 0.0
    distance = (2.0 - 0.04) / (1.0 - 0.25 * (1.0 - math.cos(0.4)))
    angle = b.x[2] + 0.3 + 0.4
    place = b.x[:2] + turned(b.x[2]) @ [0.2, -0.1] + distance * np.array([math.cos(angle), math.sin(angle)])
    own = math.sqrt(max(b.P[0, 0], b.P[1, 1]) + 0.1**2 + (0.02 * distance) ** 2)
    np.testing.assert_allclose(g.placed[0], [*place, own])
    g = sighted(np.array([[0.4, 2.0]]), False, False, False, most=0.9 * math.sqrt(max(b.P[0, 0], b.P[1, 1])))
    assert sightings.detect(b, g, 0, False, desk()) > 0.0
    assert np.isnan(g.placed).all()


@pytest.mark.parametrize("numbers", [1, 2])
def test_several_detections_correct_together_and_how_they_fit_as_a_whole_is_noted(numbers: int) -> None:
    b, d = believed(8, FRAME), desk()
    b.P *= 1e-4
    g = sighted(np.zeros((2, numbers)), False, False, False)
    exact = np.array([range_and_bearing(b.x, g, row, FRAME, 0.0) for row in range(2)])
    seen = exact[:, 0] + [0.02, -0.03]
    for row in range(2):
        g.z[row] = range_and_bearing(b.x, g, row, FRAME, seen[row])
        g.z[row, 0] = seen[row]
    z = g.z.ravel().copy()

    def h(x: Array) -> Array:
        return np.concatenate([range_and_bearing(x, g, row, FRAME, seen[row]) for row in range(2)])

    y, H = z - h(b.x), numeric_jacobian(h, b.x)
    own = np.array([[0.01, 0.002], [0.002, 0.03]])[:numbers, :numbers]
    R = np.kron(np.eye(2), own)
    book = TextbookEkf(b.x, b.P)
    fit = float(y @ np.linalg.solve(H @ b.P @ H.T + R, y))
    assert sightings.detect(b, g, 0, True, d) > 0.0
    np.testing.assert_allclose(g.joint[0], [fit, 2 * numbers], rtol=1e-4)
    correct(b, d)
    book.correct(y, H, R)
    np.testing.assert_allclose(b.x, book.x, atol=1e-6)


def test_a_landmark_that_is_no_state_yet_is_left_to_the_loop() -> None:
    g = sighted(np.zeros((2, 2)), True, False, False)
    assert not sightings.unknown(g, 0)
    g.columns[1] = -1
    assert sightings.unknown(g, 0)
    g.made = False
    assert not sightings.unknown(g, 0)


def test_a_detector_on_its_landmark_says_nothing() -> None:
    b, d = believed(9), desk()
    g = sighted(np.array([[0.4, 2.0]]), False, False, False, mounts=np.zeros((1, 3)))
    g.places[0] = b.x[:2]
    assert sightings.detect(b, g, 0, False, d) > 0.0
    assert np.isnan(g.told).all()
    assert d.singles == 0


# --- a sonar; which wall answers is held against rays in tests/sensors/test_sonar.py


@pytest.mark.parametrize("states", [True, False])
def test_an_echo_corrects_pose_and_wall(states: bool) -> None:
    b, d = believed(10), desk()
    b.x[:3], b.x[FREE : FREE + 2] = [1.0, 0.5, 0.1], [0.02, 0.15]
    b.P *= 1e-2
    own = np.array([[2e-3, 5e-4], [5e-4, 1e-3]])
    fixed = np.zeros(13)
    fixed[:7] = [0.02, 0.15, 4.0, 0.2, 2e-3, 5e-4, 1e-3]
    w = table(
        places=1, states=states, columns=[FREE], fixed=fixed, width=13, anchors=np.array([[4.0, 0.2]]), low=[-1.0],
        high=[1.0], ids=[5],
    )  # fmt: skip

    def distance(x: Array, wall: Array) -> float:
        sonar = x[:2] + turned(x[2]) @ [0.2, 0.05]
        return float(wall[0] - np.array([math.cos(wall[1]), math.sin(wall[1])]) @ (sonar - [4.0, 0.2]))

    def h(x: Array) -> Array:
        return np.array([distance(x, x[FREE : FREE + 2] if states else np.array([0.02, 0.15]))])

    by_wall = numeric_jacobian(lambda wall: np.array([distance(b.x, wall)]), np.array([0.02, 0.15]))
    R = np.array([[4e-4 + (0.0 if states else float(by_wall[0] @ own @ by_wall[0]))]])
    z = h(b.x) + 0.03
    e = table(
        first=[0, 1], z=z, r=[4e-4], cones=np.array([[0.2, 0.05, 0.0, 0.2]]), widen=0.05, told=singles_told(1),
        gate=GATE, refused=REFUSED, unmatched=4.0,
    )  # fmt: skip
    assert echoes.hear(b, w, e, 0, d) > 0.0
    # further off than this, something before the wall is the likelier one to have answered (a share of 1/4)
    odds = 3.0 * h(b.x)[0] / (math.sqrt(2.0 * math.pi) * e.told[0, 5])
    gate = min(GATE, 2.0 * math.log(odds))
    assert_compares(b, d, e.told[0], h, z, R, gate=gate, landmark=5.0)


@pytest.mark.parametrize(("half", "same"), [(math.inf, math.pi), (7.0, math.pi), (-1.0, 0.0)])
def test_a_cone_is_no_wider_than_all_around_and_no_narrower_than_a_ray(half: float, same: float) -> None:
    w = table(
        places=2, states=False, fixed=[0.0, 0.4, *[0.0] * 11, 0.0, 3.5, *[0.0] * 11], width=13, low=[-1.0, -2.0],
        anchors=np.array([[2.0, 1.0], [-1.5, -0.5]]), high=[1.0, 2.0],
    )  # fmt: skip
    found = [np.zeros(echoes.ECHO) for _ in range(2)]
    at = 0.1, 0.2, 0.3, 0.0, 0.0, 0.1
    walls = [echoes.answering([], w, *at, h, 0.02, 0.03, out) for h, out in zip((half, same), found, strict=True)]
    assert walls[0] == walls[1]
    np.testing.assert_array_equal(found[0], found[1])


@pytest.mark.parametrize("seed", range(60))
def test_a_wall_that_is_not_square_to_the_cone_is_as_far_as_its_nearest_point_within(seed: int) -> None:
    rng = np.random.default_rng(seed)
    distance, foot, off, half = rng.uniform(0.3, 3.0), rng.uniform(-3.0, 3.0), rng.uniform(-1.4, 1.4), 0.4
    low, high = np.sort(rng.uniform(-4.0, 4.0, 2))
    # the sonar looks along x; the wall's normal is turned by `off`, and `foot` is where it comes from the sonar
    along = np.linspace(low, high, 100_001)
    n, t = np.array([math.cos(off), math.sin(off)]), np.array([-math.sin(off), math.cos(off)])
    points = distance * n + (along - foot)[:, None] * t
    heard = np.abs(np.arctan2(points[:, 1], points[:, 0])) <= half
    if abs(off) <= half and low <= foot <= high:
        return  # it is square to the cone
    w = table(low=[low], high=[high])
    found = echoes.slanted(w, 0, distance, foot, off, half)
    if heard.any():
        assert found == pytest.approx(np.hypot(*points[heard].T).min(), rel=1e-3)
    else:
        assert found > 1e6


@pytest.mark.parametrize(("distance", "sigma"), [(2.0, 0.03), (0.5, 0.1), (0.12, 0.1), (0.08, 0.1), (1e-3, 0.1)])
def test_an_echo_is_refused_from_where_clutter_is_as_likely(distance: float, sigma: float) -> None:
    def of_the_wall(d2: float) -> float:
        return 0.75 * math.exp(-0.5 * d2) / (math.sqrt(2.0 * math.pi) * sigma)

    clutter, d2 = 0.25 / distance, echoes.likelier(distance, sigma)
    if of_the_wall(0.0) < clutter:
        assert d2 == 0.0
    else:
        assert of_the_wall(d2) == pytest.approx(clutter)


def two_walls(beta: float, nearer: float) -> Any:
    """A wall three metres ahead, and the end of another of direction `beta` that much `nearer` on the same ray."""
    return table(
        places=2, states=False, fixed=[*[0.0] * 14, beta, *[0.0] * 11], width=13, low=[-1.0, -1.0],
        high=[1.0, 0.0], anchors=np.array([[3.0, 0.0], [3.0 - nearer, 0.0]]),
    )  # fmt: skip


@pytest.mark.parametrize(("sigmas", "answers"), [(3.1, False), (2.9, True), (0.0, True), (-2.0, True)])
def test_what_stands_three_sigmas_nearer_answers_first(sigmas: float, answers: bool) -> None:
    out, sigma = np.zeros(echoes.ECHO), 0.1
    w = two_walls(0.6, sigmas * sigma)
    found = echoes.answering([], w, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.2, 0.0, sigma, out)
    assert found == (0 if answers else -1)


@pytest.mark.parametrize("beta", [math.nan, math.inf, -math.inf])
def test_a_wall_without_a_direction_neither_answers_nor_hides_another(beta: float) -> None:
    out = np.zeros(echoes.ECHO)
    w = two_walls(beta, 1.0)
    assert echoes.answering([], w, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.2, 0.0, 0.1, out) == 0


@pytest.mark.parametrize(("aside", "answers"), [(1.04, True), (1.06, False), (-2.04, True), (-2.06, False)])
def test_a_wall_may_go_on_five_centimetres_beyond_what_was_seen_of_it(aside: float, answers: bool) -> None:
    w = table(
        places=1,
        states=False,
        fixed=np.zeros(13),
        width=13,
        anchors=np.array([[3.0, 0.0]]),
        low=[-2.0],
        high=[1.0],
    )
    out = np.zeros(echoes.ECHO)
    found = echoes.answering([], w, 0.0, aside, 0.0, 0.0, 0.0, 0.0, 0.2, 0.0, 0.01, out)
    assert found == (0 if answers else -1)
    assert not answers or out[0] == pytest.approx(3.0)


def test_an_echo_that_no_wall_explains_is_unmatched_and_no_echo_is_nothing() -> None:
    b, d = believed(10), desk()
    w = table(places=0)
    e = table(
        first=[0, 1, 1], z=[1.0], r=[1e-3], cones=np.array([[0.0, 0.0, 0.0, 0.2]]), widen=0.0,
        told=singles_told(1), gate=GATE, refused=REFUSED, unmatched=4.0,
    )  # fmt: skip
    assert echoes.hear(b, w, e, 0, d) > 0.0  # there is no map
    assert np.isnan(e.told).all()
    w = table(
        places=1, states=False, fixed=np.zeros(13), width=13, anchors=np.array([b.x[:2] - [3.0, 0.0]]), low=[-1.0],
        high=[1.0],
    )  # fmt: skip
    assert echoes.hear(b, w, e, 1, d) > 0.0  # nothing was heard
    assert np.isnan(e.told).all()
    assert echoes.hear(b, w, e, 0, d) > 0.0  # the wall lies behind
    assert (e.told[0, 0], e.told[0, 3]) == (4.0, GATE)
    assert d.singles == 0


# --- how one is judged


def test_beyond_the_gate_and_not_a_number_correct_nothing_and_no_variance_fails() -> None:
    b, d = believed(11), desk()
    b.P = 1e-4 * np.eye(N)
    for y, r, verdict in ((0.99, 0.02, 0.0), (1.01, 0.02, REFUSED), (math.nan, 0.02, REFUSED)):
        told, d.singles = singles_told(1), 0
        singles.state_of(d, 0, 0, 2, 1.0)
        singles.say(d, 0, y * math.sqrt(GATE * (1e-4 + r)), r, 0.0, 0)
        assert singles.weigh(b, d, 1, 1, told, 0) > 0.0
        singles.settle(d, 1, 1, told, 0, 3.0, GATE, REFUSED)
        assert (told[0, 0], told[0, 1], d.singles) == (verdict, 3.0, int(verdict == 0.0))
    d.singles = 0
    singles.say(d, 0, 0.1, -1.0, 0.0, 0)
    assert not singles.weigh(b, d, 1, 1, singles_told(1), 0) > 0.0
    told = singles_told(1)
    singles.say(d, 0, 0.1, math.nan, 0.0, 0)
    assert singles.weigh(b, d, 1, 1, told, 0) > 0.0
    assert math.isnan(told[0, 2])
