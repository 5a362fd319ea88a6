"""Which map line is it, and what does it say? Pairs by matrices, association by its rule, rows by differences."""

import math
from collections import Counter
from typing import Any

import line_scene
import numpy as np
import pytest
from rows import over_states, written
from textbook import numeric_jacobian

from locfuse.fusion import se2
from locfuse.fusion.data import Array
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.map.line_map import LineMap
from locfuse.fusion.map.scan import Scan

ANGLE, OFFSET = math.radians(25.0), 1.0  # rad, m: pairs further apart are not looked at
COMMON = 0.05  # m of one map line that two measured lines may both claim
RIVAL, ZONE = 6.0, 60.0  # 95 % of chi-square with 2 degrees; squared distance within which nothing is new
OVERLAP, LONGEST = 0.3, 0.5  # share of a segment, of so many m at most
GATES = [13.8, math.inf]
FREE = pytest.mark.parametrize("free", [(), (2,), (0, 1), (1, 2), (0, 1, 2)])


def setting(
    seed: int, states: bool, free: tuple[int, ...] = (), gate: float = ZONE, parts: int = 0
) -> tuple[line_scene.Sighted, LineMap, JointBelief, Array]:
    """A scan that was associated in a random scene, by a laser at a known mount or not; what its lines share."""
    scan, lines, belief = line_scene.scene(seed, states)
    mount_states = line_scene.mounted_states(belief, free) if free else None
    shared = np.random.default_rng(seed).normal(0.0, 0.01, (len(scan.z), 2, parts))
    return line_scene.sighted(scan.rows, lines, belief, gate, states, mount_states, shared), lines, belief, shared


# --- candidate pairs


def by_mount(free: tuple[int, ...], psi: float) -> Array:
    """By how much the (r, psi) that is predicted depends on the free states of the mount as it is."""
    sits = line_scene.MOUNT + np.where(np.isin(range(3), free), line_scene.MOVED, 0.0)
    c, s = math.cos(psi), math.sin(psi)
    whole = np.array([[-c, -s, sits[0] * s - sits[1] * c], [0.0, 0.0, -1.0]])
    return np.asarray(whole[:, list(free)])


def by_matrices(
    found: line_scene.Sighted, lines: LineMap, belief: JointBelief, limit: float, free: tuple[int, ...] = ()
) -> dict[tuple[int, int], dict[str, Any]]:
    """Every pair with H written out over the whole state, and R: maths of the field, no short cut."""
    state, P = belief.state, belief.covariance
    (x, y, theta), n = belief.pose(), len(state)
    scan, pairs = Scan(found.in_base()), {}
    angle, far = ANGLE + 6.0 * math.sqrt(P[2, 2]), OFFSET + 6.0 * math.sqrt(P[0, 0] + P[1, 1])
    for j in range(len(lines)):
        at = int(lines.column[j])
        rho, beta = lines.value[j] if at < 0 else state[at : at + 2]
        c, s, (dx, dy) = math.cos(beta), math.sin(beta), (x, y) - lines.anchor[j]
        r, psi, u = rho - dx * c - dy * s, beta - theta, dx * s - dy * c
        for i, (own, noise) in enumerate(zip(scan.z, scan.R, strict=True)):
            forward = abs(se2.wrap(own[1] - psi)) <= 0.5 * math.pi
            flip = np.diag((1.0 if forward else -1.0, 1.0))
            turn = se2.wrap(own[1] - psi - (0.0 if forward else math.pi))
            e = np.array([flip[0, 0] * own[0] - r, turn])
            H, R, line = np.zeros((2, n)), flip @ noise @ flip, np.array([[1.0, u], [0.0, 1.0]])
            H[0, :2], H[1, 2] = (-c, -s), -1.0
            if at >= 0:
                H[:, at : at + 2] = line
            else:
                R = R + line @ lines.P[j] @ line.T
            if free:
                H[:, n - len(free) :] = by_mount(free, psi + turn)
            S = H @ P @ H.T + R
            d2 = float(e @ np.linalg.solve(S, e))
            near = abs(turn) < angle and abs(e[0]) < far
            if near and d2 <= limit and r > -3.0 * math.sqrt(S[0, 0]):
                ends = dy * c - dx * s + (scan.ends[i] if forward else -scan.ends[i][::-1])
                common = min(ends[1], lines.hi[j]) - max(ends[0], lines.lo[j])
                score = d2 + math.log(np.linalg.det(S))
                pairs[i, j] = {"y": e, "R": R, "S": S, "d2": d2, "score": score, "ends": [*ends, common]}
    return pairs


@FREE
@pytest.mark.parametrize("states", [False, True])
@pytest.mark.parametrize("gate", [13.8, math.inf])
def test_pairs_are_those_that_matrices_give(gate: float, states: bool, free: tuple[int, ...]) -> None:
    """Within the gate, or within the squared distance at which nothing is new."""
    count = flipped = 0
    for seed in range(20):
        found, lines, belief, _ = setting(seed, states, free, gate)
        expected = by_matrices(found, lines, belief, max(gate, ZONE), free)
        assert [(p.line, p.which) for p in found.pair_list] == sorted(expected)
        for pair in found.pair_list:
            known = expected[pair.line, pair.which]
            np.testing.assert_allclose(pair.y, known["y"], atol=1e-11)
            np.testing.assert_allclose(pair.R, known["R"], rtol=1e-9, atol=1e-11)
            np.testing.assert_allclose(pair.S, known["S"], rtol=1e-9, atol=1e-11)
            np.testing.assert_allclose((pair.lo, pair.hi, pair.overlap), known["ends"], atol=1e-11)
            assert pair.d2 == pytest.approx(known["d2"], rel=1e-7, abs=1e-9)
            assert pair.score == pytest.approx(known["score"], rel=1e-7, abs=1e-7)
            flipped += line_scene.side_of(pair, found.in_base()[pair.line]) < 0.0
        count += len(found.pair_list)
    assert count > 60
    assert flipped > 6


def test_ends_lie_along_the_map_line_and_overlap_where_the_segments_do() -> None:
    lines = LineMap()
    lines.append(np.array([2.0, 1.0]), np.zeros(2), np.eye(2) * 1e-4, -1, (-1.0, 1.0), 0)  # x = 2, y from 0 to 2
    R = np.array([np.eye(2) * 1e-4])

    def pairs(
        pose: tuple[float, float, float], z: tuple[float, float], ends: tuple[float, float]
    ) -> list[line_scene.Pair]:
        rows = Scan.of(np.array([z]), R, np.array([ends])).rows
        return line_scene.sighted(rows, lines, JointBelief(pose, line_scene.UPPER), math.inf, False).pair_list

    (pair,) = pairs((0.0, 0.5, 0.0), (2.0, 0.0), (-1.5, 1.0))  # y from -1 to 1.5
    assert (pair.lo, pair.hi, pair.overlap) == pytest.approx((-2.0, 0.5, 1.5))
    # beyond by less than is known of the pose, so that the line lies behind it: y from -0.3 to 2
    (pair,) = pairs((2.1, 0.5, 0.0), (0.1, math.pi), (-1.5, 0.8))
    assert pair.y == pytest.approx((0.0, 0.0))
    assert (pair.lo, pair.hi, pair.overlap) == pytest.approx((-1.3, 1.0, 2.0))
    assert pairs((4.0, 0.5, math.pi), (2.0, 0.0), (-1.5, 1.0)) == []  # sees the other face


@pytest.mark.parametrize("pose", [(math.nan, 0.0, 0.0), (0.0, 0.0, math.inf), (1e200, 0.0, 0.0), (0.0, 0.0, 1e30)])
def test_a_pose_that_is_none_has_no_pairs(pose: tuple[float, float, float]) -> None:
    scan, lines, _ = line_scene.scene(1, states=False)
    assert line_scene.sighted(scan.rows, lines, JointBelief(pose, line_scene.UPPER), ZONE, False).pair_list == []


# --- association


def by_rule(found: line_scene.Sighted, gate: float) -> tuple[list[line_scene.Pair | None], list[bool], list[bool]]:
    """The rule in words: of pairs that pass, the best, unless another explains the line as well."""
    length = np.ptp(Scan(found.in_base()).ends, axis=1)
    match: list[line_scene.Pair | None] = [None] * len(length)
    ambiguous, near = [False] * len(length), [False] * len(length)
    for i in range(len(length)):
        own = sorted((p for p in found.pair_list if p.line == i), key=lambda p: p.score)
        near[i] = any(p.overlap > 0.0 and p.d2 <= ZONE for p in own)
        passing = [p for p in own if p.d2 <= gate and p.overlap > OVERLAP * min(length[i], LONGEST)]
        if passing:
            match[i] = passing[0]
            ambiguous[i] = any(p.score - passing[0].score < RIVAL for p in passing[1:])
    claimed: list[line_scene.Pair] = []
    for p in sorted((p for p in match if p is not None), key=lambda p: p.score):
        same = [q for q in claimed if q.which == p.which]
        if any(min(p.hi, q.hi) - max(p.lo, q.lo) > COMMON for q in same):
            ambiguous[p.line] = True
        else:
            claimed.append(p)
    return [None if a else p for p, a in zip(match, ambiguous, strict=True)], ambiguous, near


@pytest.mark.parametrize("gate", GATES)
@pytest.mark.parametrize("states", [False, True])
def test_matches_are_those_of_the_rule(states: bool, gate: float) -> None:
    matched = doubtful = 0
    for seed in range(60):
        found, *_ = setting(seed, states, gate=gate)
        match, ambiguous, near = by_rule(found, gate)
        where = [None if p is None else (p.line, p.which) for p in match]
        pairs = found.pair_list
        assert [None if p < 0 else (pairs[p].line, pairs[p].which) for p in found.pair_of] == where
        assert (found.ambiguous, found.is_near) == (ambiguous, near)
        assert found.new() == [i for i, p in enumerate(match) if p is None and not near[i]]
        length, hit = np.ptp(Scan(found.in_base()).ends, axis=1), [p is not None for p in match]
        assert found.share() == pytest.approx(length[hit].sum() / length.sum(), abs=1e-12)
        assert found.matches() == found.accepted == sum(hit)
        matched, doubtful = matched + sum(hit), doubtful + sum(ambiguous)
    assert matched > 20
    assert doubtful > 10


def two_lines(offset: float, turn: float, sigma: tuple[float, float], others: int = 1) -> line_scene.Sighted:
    """A wall 2 m ahead seen off by so much, with such errors, from a pose that is known; and lines of no wall."""
    lines, belief = LineMap(), JointBelief((0.0, 0.0, 0.0), (1e-18, 0.0, 0.0, 1e-18, 0.0, 1e-18))
    lines.append(np.array([2.0, 0.0]), np.zeros(2), 1e-18 * np.eye(2), -1, (-1.0, 1.0), 0)
    z = np.array([[2.0 + offset, turn], *[[1.0, 1.5]] * others])
    R = np.tile(np.diag(np.square(sigma)), (len(z), 1, 1))
    return line_scene.sighted(Scan.of(z, R, np.tile((-1.0, 1.0), (len(z), 1))).rows, lines, belief, 13.8, False)


@pytest.mark.parametrize(
    ("offset", "turn_deg", "sigma_deg", "sigma", "believed"),
    [
        (0.01 * math.sqrt(4.9), 0.0, 1.0, 0.01, True),  # squared distance
        (0.01 * math.sqrt(5.1), 0.0, 1.0, 0.01, False),
        (0.0, 2.9, 2.0, 0.1, True),
        (0.0, -3.1, 2.0, 0.1, False),
        (0.145, 0.0, 1.0, 0.1, True),
        (-0.155, 0.0, 1.0, 0.1, False),
    ],
)
def test_a_lone_line_is_believed_where_it_fits_nearly_perfectly(
    offset: float, turn_deg: float, sigma_deg: float, sigma: float, believed: bool
) -> None:
    """Within the squared distance 5, three degrees and 15 cm; a scan of one line has no others that failed."""
    errors = sigma, math.radians(sigma_deg)
    for others in (1, 0):
        found = two_lines(offset, math.radians(turn_deg), errors, others)
        assert found.pair_of[0] == 0
        found.refuse_alone()
        assert (found.pair_of[0] == 0) is (believed or not others)


def test_what_became_of_a_line_is_accepted_ambiguous_unmatched_or_new() -> None:
    """A line that pairs with nothing near is new; what is near a known line and no match of it is unmatched."""
    counts: Counter[int] = Counter()
    for seed in range(80):
        found, lines, *_ = setting(seed, False, gate=13.8)
        table, pairs = written(found, 7), found.pair_list
        for i, verdict in enumerate(table.verdict.tolist()):
            match, best, near = found.pair_of[i], found.best_of[i], found.is_near[i]
            if match >= 0:
                expected = 0
            elif not near:
                expected = line_scene.NEW
            else:
                expected = line_scene.AMBIGUOUS if best >= 0 and found.ambiguous[i] else line_scene.UNMATCHED
            assert verdict == expected
            assert table.threshold[i] == 13.8
            if match >= 0 or (best >= 0 and near):
                pair = pairs[best]
                assert (table.landmark[i], table.nis[i]) == (lines.ids[pair.which], pair.d2)
                np.testing.assert_array_equal(table.y[i], pair.y)
                np.testing.assert_allclose(table.sigma[i], np.sqrt(np.diag(pair.S)), rtol=1e-12)
            else:
                assert table.landmark[i] == -1
                assert np.isnan([table.nis[i], *table.y[i], *table.sigma[i]]).all()
            counts[verdict] += 1
        found.row = 7
        assert found.rows_used() == (7 + np.flatnonzero(table.verdict == 0)).tolist()
    assert min(counts[verdict] for verdict in (0, line_scene.AMBIGUOUS, line_scene.UNMATCHED, line_scene.NEW)) > 5


# --- rows of the equation


def measured_less_predicted(z: Array, sits: Array, value: Array, away: Array, x: Array, side: float) -> Array:
    """(r, psi) of a line z at the base, were the laser's mount moved by x[3:], less those of a map line."""
    psi = z[1] + x[5]
    at_laser = z[0] - sits[0] * math.cos(z[1]) - sits[1] * math.sin(z[1])
    mx, my = sits[:2] + x[3:5]
    r, (rho, beta) = at_laser + mx * math.cos(psi) + my * math.sin(psi), value
    return np.array([side * r - rho + away[0] * math.cos(beta) + away[1] * math.sin(beta), psi - beta + x[2]])


@FREE
@pytest.mark.parametrize("states", [False, True])
def test_derivatives_of_a_scan_are_finite_differences(states: bool, free: tuple[int, ...]) -> None:
    """What is measured moves with the laser's mount, what is predicted with the pose and the lines."""
    sides = []
    sits = line_scene.MOUNT + np.where(np.isin(range(3), free), line_scene.MOVED, 0.0)
    for seed in range(40):
        found, lines, belief, _ = setting(seed, states, free)
        mounted, rows = list(range(belief.n - len(free), belief.n)), found.in_base()
        equation = line_scene.equation_of(found, belief)
        H = over_states(equation.columns, equation.H, belief.n)
        for k, pair in enumerate(found.matched()):
            j, z, x = pair.which, rows[pair.line], belief.state.copy()
            own = [int(lines.column[j]), int(lines.column[j]) + 1] if states else []
            side, columns = line_scene.side_of(pair, z), [0, 1, 2, *own, *mounted]

            def y(v: Array) -> Array:
                now, moved = x.copy(), np.zeros(6)  # noqa: B023
                now[columns] = v  # noqa: B023
                moved[:3], moved[[3 + i for i in free]] = now[:3], (now - x)[mounted]  # noqa: B023
                value, away = now[own] if states else lines.value[j], now[:2] - lines.anchor[j]  # noqa: B023
                return measured_less_predicted(z, sits, value, away, moved, side)  # noqa: B023

            expected = np.zeros((2, belief.n))
            expected[:, columns] = -numeric_jacobian(y, x[columns])
            at = slice(2 * k, 2 * k + 2)
            np.testing.assert_allclose(H[at], expected, atol=1e-7)
            seen = y(x[columns])
            np.testing.assert_allclose(equation.y[at], [seen[0], pair.y[1]], atol=1e-9)
            assert abs(math.sin(0.5 * (seen[1] - pair.y[1] - (side < 0.0) * math.pi))) < 1e-9
            np.testing.assert_allclose(H[at] @ belief.covariance @ H[at].T + pair.R, pair.S, rtol=1e-7, atol=1e-9)
            sides.append(side)
    assert len(sides) > 20
    assert -1.0 in sides


@pytest.mark.parametrize("parts", [0, 3])
@pytest.mark.parametrize("states", [False, True])
def test_errors_that_lines_share_stand_between_them_in_R_and_nowhere_else(states: bool, parts: int) -> None:
    """A line that is read as (-r, psi + pi) shares a longer range the other way; a frozen map takes no shares."""
    several = flipped = 0
    for seed in range(60):
        found, _, belief, shared = setting(seed, states, parts=parts)
        matched, rows = found.matched(), found.in_base()
        assert (found.accepted, found.numbers) == (len(matched), 2 * len(matched))
        sides = np.array([[line_scene.side_of(p, rows[p.line]), 1.0] for p in matched]).reshape(-1, 2, 1)
        G = (shared[[p.line for p in matched]] * sides).reshape(found.numbers, parts)
        expected = G @ G.T if states else np.zeros((found.numbers, found.numbers))
        for k, pair in enumerate(matched):
            expected[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = pair.R
        R = line_scene.equation_of(found, belief).R
        np.testing.assert_allclose(R, expected, atol=1e-14)
        several, flipped = several + (len(matched) > 1), flipped + int((sides[:, 0] < 0.0).sum())
    assert several > 3
    assert flipped > 3


def test_a_scan_that_slipped_as_a_whole_is_likelier_than_its_lines_one_by_one() -> None:
    """Two lines turned alike by one slip: the joint distance is that of one error, not of two."""
    lines, fits = LineMap(), []
    for beta in (0.0, 0.5 * math.pi):
        anchor = 2.0 * np.array([math.cos(beta), math.sin(beta)])
        lines.append(anchor, np.array([0.0, beta]), np.zeros((2, 2)), 3 + 2 * len(lines), (-1.0, 1.0), 0)
    z = np.array([[2.0, 0.1], [2.0, 0.1 + 0.5 * math.pi]])
    rows = Scan.of(z, np.tile(np.diag([2.0, 0.02]), (2, 1, 1)), np.tile((-1.0, 1.0), (2, 1))).rows
    for alike in (0.1, 0.0):
        belief = JointBelief((0.0, 0.0, 0.0), (1e-6, 0.0, 0.0, 1e-6, 0.0, 1e-6), [])
        for value in lines.value:
            belief.augment(value, np.zeros((2, 3)), 1e-6 * np.eye(2))
        shared = np.tile([[0.0], [alike]], (2, 1, 1))
        found = line_scene.sighted(rows, lines, belief, math.inf, True, shared=shared)
        equation = line_scene.equation_of(found, belief)
        S = belief.spread(equation.H, equation.columns[3:].tolist()) + equation.R
        fits.append(belief.fit_of(0, 4))
        assert fits[-1] == pytest.approx(float(equation.y @ np.linalg.solve(S, equation.y)))
        belief.correct()
        assert belief.fit(4) == pytest.approx(fits[-1])
    assert fits[0] < 0.75 * fits[1]


# --- what the map learns


def test_lines_that_were_matched_reach_as_far_as_they_were_seen() -> None:
    matched = 0
    for seed in range(20):
        found, lines, *_ = setting(seed, False)
        low, high, hits = lines.lo.copy(), lines.hi.copy(), lines.hits.copy()
        found.extend(9)
        for pair in found.matched():
            j = pair.which
            low[j], high[j], hits[j] = min(low[j], pair.lo), max(high[j], pair.hi), hits[j] + 1
            assert lines.seen[j] == 9
        for a, b in ((lines.lo, low), (lines.hi, high), (lines.hits, hits)):
            np.testing.assert_array_equal(a, b)
        matched += len(found.matched())
    assert matched > 5


def test_lines_that_were_seen_bend_by_what_they_lack_of_their_unevenness() -> None:
    """Up to the most that a scan may add; a line of which two pieces were seen bends once."""
    bent = 0
    for seed in range(40):
        found, lines, belief, _ = setting(seed, True)
        uneven, most = np.array([3e-3, 2e-2]), np.array([2e-3, 5e-3])
        before, expected = np.diag(belief.covariance).copy(), np.diag(belief.covariance).copy()
        for c in {int(lines.column[pair.which]) for pair in found.matched()}:
            expected[c : c + 2] += np.clip(uneven - before[c : c + 2], 0.0, most)
        found.extend(9)
        lines.raise_variances(belief, uneven, most, np.flatnonzero(lines.seen == 9))
        np.testing.assert_allclose(np.diag(belief.covariance), expected, rtol=1e-14)
        bent += int((expected != before).sum())
    assert bent > 20
