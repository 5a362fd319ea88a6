"""Which map line is it? Held against the rule written out pair by pair, in both forms of the core."""

from __future__ import annotations

import math

import numpy as np
import pytest
from line_scene import scene, seated
from textbook import numeric_jacobian

from locfuse.fusion.core.room import Room
from locfuse.fusion.data import Array
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.ekf.rows import stacked, together
from locfuse.fusion.linemap.association import Association, Codes, SeenLines, associate
from locfuse.fusion.linemap.line_map import LineMap
from locfuse.fusion.linemap.pairing import Pair
from locfuse.fusion.linemap.scan import Scan
from locfuse.fusion.sensor import Equation, Innovation

COMMON = 0.05  # m of one map line that two measured lines may both claim
AMBIGUOUS, ZONE = 6.0, 60.0  # 95 % of chi-square with 2 degrees; squared distance within which nothing is new
OVERLAP, LONGEST = 0.3, 0.5  # share of a segment, of so many m at most
CODES = Codes(3, 2, 4)
GATES = [13.8, math.inf]


def by_rule(found: Association, gate: float) -> tuple[list[Pair | None], list[bool], list[bool]]:
    """The rule in words: of pairs that pass, the best, unless another explains the line as well."""
    k = len(found.scan.z)
    length = found.scan.ends[:, 1] - found.scan.ends[:, 0]
    match: list[Pair | None] = [None] * k
    ambiguous, near = [False] * k, [False] * k
    for i in range(k):
        own = sorted((p for p in found.pairs if p.line == i), key=lambda p: p.score)
        near[i] = any(p.overlap > 0.0 and p.d2 <= ZONE for p in own)
        passing = [p for p in own if p.d2 <= gate and p.overlap > OVERLAP * min(length[i], LONGEST)]
        if passing:
            match[i] = passing[0]
            ambiguous[i] = any(p.score - passing[0].score < AMBIGUOUS for p in passing[1:])
    claimed: list[Pair] = []
    for p in sorted((p for p in match if p is not None), key=lambda p: p.score):
        same = [q for q in claimed if q.which == p.which]
        if any(min(p.hi, q.hi) - max(p.lo, q.lo) > COMMON for q in same):
            ambiguous[p.line] = True
        else:
            claimed.append(p)
    return [None if a else p for p, a in zip(match, ambiguous, strict=True)], ambiguous, near


@pytest.mark.parametrize("gate", GATES)
@pytest.mark.parametrize("states", [False, True])
def test_matches_are_those_of_the_rule(states: bool, gate: float, monkeypatch: pytest.MonkeyPatch) -> None:
    matched = doubtful = 0
    for seed in range(60):
        scan, lines, belief = scene(seed, states)
        found = associate(scan, lines, belief, gate)
        match, ambiguous, near = by_rule(found, gate)
        assert [None if p < 0 else found.pairs[p] for p in found.match] == match
        assert (found.ambiguous, found.near) == (ambiguous, near)
        assert found.new() == [i for i, p in enumerate(match) if p is None and not near[i]]
        length = scan.ends[:, 1] - scan.ends[:, 0]
        share = length[[p is not None for p in match]].sum() / length.sum()
        assert found.share() == pytest.approx(share, abs=1e-12)
        with monkeypatch.context() as patch:
            patch.setattr("locfuse.fusion.core.room._here", lambda source: Room.of(source, None))
            other = associate(scan, lines, belief, gate)
        assert list(other.fate) == list(found.fate)
        matched, doubtful = matched + sum(p >= 0 for p in found.match), doubtful + sum(ambiguous)
    assert matched > 20
    assert doubtful > 10


@pytest.mark.parametrize("free", [(), (2,), (0, 1, 2)])
@pytest.mark.parametrize("parts", [0, 3])
@pytest.mark.parametrize("states", [False, True])
def test_a_scan_as_one_equation_is_its_lines_one_by_one(
    states: bool, parts: int, free: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    several = 0
    for seed in range(40):
        scan, lines, belief = scene(seed, states)
        if free:
            scan = seated(scan, belief, free)
        shared = np.random.default_rng(seed).normal(0.0, 0.01, (len(scan.z), 2, parts)) if parts else None
        found = associate(scan, lines, belief, 60.0)
        seen = SeenLines(found, 7, lines.ids, 60.0, CODES, states, shared)
        rows = [s for s in seen if s.verdict == 0]
        assert (len(rows), seen.numbers, len(seen)) == (seen.accepted, 2 * seen.accepted, len(scan.z))
        table = seen.table()
        assert [s.row for s in seen] == list(range(7, 7 + len(scan.z)))
        assert [s.verdict for s in seen] == table.verdict.tolist()
        np.testing.assert_array_equal([s.y for s in seen], table.y)
        for s, p in zip(rows, (p for p in found.match if p >= 0), strict=True):
            assert_is(s, found.pairs[p], int(lines.ids[found.pairs[p].which]))
        if not rows:
            continue
        several += len(rows) > 1
        n = belief.n
        assert_equal(over_states(together([seen]), n), over_states(stacked(rows), n))
        one = Innovation(0, 0, -1, 0.0, 1.0, (0.1,), (1.0,), ((0.0, 0.0, 1.0),), ((0.5,),))
        assert_equal(over_states(together([seen, one]), n), over_states(stacked([*rows, one]), n))
        assert_equal(over_states(together([one, seen]), n), over_states(stacked([one, *rows]), n))
        with monkeypatch.context() as patch:
            patch.setattr("locfuse.fusion.core.room._here", lambda source: Room.of(source, None))
            other = SeenLines(associate(scan, lines, belief, 60.0), 7, lines.ids, 60.0, CODES, states, shared)
            for a, b in zip(seen.equation(), other.equation(), strict=True):
                assert a.tobytes() == b.tobytes()
    assert several > 3


def assert_is(s: Innovation, pair: Pair, landmark: int) -> None:
    assert (s.landmark, s.nis, s.y) == (landmark, pair.d2, pair.y)
    np.testing.assert_allclose(np.square(s.sigma), (pair.S[0], pair.S[2]), rtol=1e-12)
    assert (s.R[0][0], s.R[0][1], s.R[1][1]) == pair.R


def over_states(one: Equation, n: int) -> tuple[Array, Array, Array]:
    """An equation with its derivatives by the whole state."""
    out = np.zeros((len(one.y), n))
    for column, derivative in zip(one.columns.tolist(), one.H.T, strict=True):
        out[:, column] += derivative
    return one.y, out, one.R


def assert_equal(a: tuple[Array, ...], b: tuple[Array, ...]) -> None:
    for one, other in zip(a, b, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-14)


def test_what_lines_share_turns_with_a_line_that_is_read_from_its_other_side() -> None:
    """(-r, psi + pi) is the line (r, psi): a longer range moves it the other way."""
    flipped = 0
    for seed in range(60):
        scan, lines, belief = scene(seed, True)
        shared = np.random.default_rng(seed).normal(0.0, 0.01, (len(scan.z), 2, 2))
        found = associate(scan, lines, belief, 60.0)
        for s in SeenLines(found, 0, lines.ids, 60.0, CODES, True, shared):
            if s.verdict:
                assert not s.shared
                continue
            pair = found.pairs[found.match[s.row]]
            side = 1.0 if math.cos(pair.psi - scan.z[s.row, 1]) > 0.0 else -1.0
            flipped += side < 0.0
            np.testing.assert_array_equal(s.shared, shared[s.row] * [[side], [1.0]])
    assert flipped > 3


@pytest.mark.parametrize("compiled", [True, False])
def test_lines_that_were_matched_reach_as_far_as_they_were_seen(
    compiled: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not compiled:
        monkeypatch.setattr("locfuse.fusion.core.room._here", lambda source: Room.of(source, None))
    matched = 0
    for seed in range(20):
        scan, lines, belief = scene(seed, False)
        found = associate(scan, lines, belief, 60.0)
        low, high, hits = lines.lo.copy(), lines.hi.copy(), lines.hits.copy()
        found.extend(lines, 9)
        for pair in found.matched():
            j = pair.which
            low[j], high[j], hits[j] = min(low[j], pair.lo), max(high[j], pair.hi), hits[j] + 1
            assert lines.seen[j] == 9
        for a, b in ((lines.lo, low), (lines.hi, high), (lines.hits, hits)):
            np.testing.assert_array_equal(a, b)
        matched += len(found.matched())
    assert matched > 5


def test_a_scan_of_nothing_matches_nothing() -> None:
    _, lines, belief = scene(0, True)
    found = associate(Scan(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 2))), lines, belief, 13.8)
    assert (found.match, found.new(), found.share()) == ([], [], 1.0)
    seen = SeenLines(found, 0, lines.ids, 13.8, CODES, True, None)
    assert (len(seen), seen.accepted, list(seen)) == (0, 0, [])


MOUNT = np.array([0.2, -0.3, 0.0])  # of `seated`, m


def measured_less_predicted(z: Array, value: Array, away: Array, theta: float, moved: Array, side: float) -> Array:
    """(r, psi) of a line z at the base, were the laser's mount moved, less those of a map line from a pose."""
    psi = z[1] + moved[2]
    at_laser = z[0] - MOUNT[0] * math.cos(z[1]) - MOUNT[1] * math.sin(z[1])
    x, y = MOUNT[:2] + moved[:2]
    r, (rho, beta) = at_laser + x * math.cos(psi) + y * math.sin(psi), value
    return np.array([side * r - rho + away[0] * math.cos(beta) + away[1] * math.sin(beta), psi - beta + theta])


@pytest.mark.parametrize("free", [(), (2,), (0, 1), (1, 2), (0, 1, 2)])
@pytest.mark.parametrize("states", [False, True])
def test_the_derivatives_of_a_scan_are_finite_differences_by_pose_lines_and_mount(
    states: bool, free: tuple[int, ...]
) -> None:
    """What is measured moves with the laser's mount, what is predicted with the pose and the lines."""
    sides = []
    for seed in range(40):
        scan, lines, belief = scene(seed, states)
        scan = seated(scan, belief, free) if free else scan
        mounted = [] if scan.seat is None else list(scan.seat.columns)
        found = associate(scan, lines, belief, 60.0)
        equation = SeenLines(found, 0, lines.ids, 60.0, CODES, states, None).equation()
        H = over_states(equation, belief.n)[1]
        for k, pair in enumerate(found.matched()):
            j, z, x = pair.which, scan.z[pair.line], belief.state.copy()
            own = [int(lines.column[j]), int(lines.column[j]) + 1] if states else []
            side, columns = math.copysign(1.0, math.cos(pair.psi - z[1])), [0, 1, 2, *own, *mounted]

            def y(v: Array) -> Array:
                now, moved = x.copy(), np.zeros(3)  # noqa: B023
                now[columns] = v  # noqa: B023
                moved[list(free)] = (now - x)[mounted]  # noqa: B023
                value, away = now[own] if states else lines.value[j], now[:2] - lines.anchor[j]  # noqa: B023
                return measured_less_predicted(z, value, away, float(now[2]), moved, side)  # noqa: B023

            expected = np.zeros((2, belief.n))
            expected[:, columns] = -numeric_jacobian(y, x[columns])
            np.testing.assert_allclose(H[2 * k : 2 * k + 2], expected, atol=1e-7)
            sides.append(side)
    assert len(sides) > 20
    assert -1.0 in sides


def two_lines(offset: float, turn: float, sigma: tuple[float, float], others: int = 1) -> Association:
    """A wall 2 m ahead seen off by so much, with such errors, from a pose that is known; and lines of no wall."""
    lines, belief = LineMap(), JointBelief((0.0, 0.0, 0.0), (1e-18, 0.0, 0.0, 1e-18, 0.0, 1e-18))
    lines.append(np.array([2.0, 0.0]), np.zeros(2), 1e-18 * np.eye(2), -1, (-1.0, 1.0), 0)
    z = np.array([[2.0 + offset, turn], *[[1.0, 1.5]] * others])
    R = np.tile(np.diag(np.square(sigma)), (len(z), 1, 1))
    return associate(Scan(z, R, np.tile((-1.0, 1.0), (len(z), 1))), lines, belief, 13.8)


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
        assert found.match[0] == 0
        found.refuse_alone()
        assert (found.match[0] == 0) is (believed or not others)


def test_lines_that_were_seen_bend_by_what_they_lack_of_their_unevenness() -> None:
    """Up to the most that a scan may add; a line of which two pieces were seen bends once."""
    for seed in range(40):
        scan, lines, belief = scene(seed, True)
        found = associate(scan, lines, belief, 60.0)
        uneven, most = np.array([3e-3, 2e-2]), np.array([2e-3, 5e-3])
        at, missing = found.bends(belief.arrays[1], uneven, most)
        seen = list(dict.fromkeys(int(lines.column[pair.which]) for pair in found.matched()))
        assert at.tolist() == [c + i for c in seen for i in (0, 1)]
        variance = np.diag(belief.covariance)[at]
        wanted = np.clip(np.tile(uneven, len(seen)) - variance, 0.0, np.tile(most, len(seen)))
        np.testing.assert_allclose(missing, wanted, atol=1e-15)


def test_what_became_of_a_line_is_accepted_ambiguous_unmatched_or_new() -> None:
    """A line that pairs with nothing near is new; what is near a known line and no match of it is unmatched."""
    counts = dict.fromkeys((0, *CODES), 0)
    for seed in range(80):
        scan, lines, belief = scene(seed, False)
        found = associate(scan, lines, belief, 13.8)
        table = SeenLines(found, 0, lines.ids, 13.8, CODES, False, None).table()
        for i, verdict in enumerate(table.verdict.tolist()):
            match, best, near = found.match[i], found.best[i], found.near[i]
            if match >= 0:
                expected = 0
            elif not near:
                expected = CODES.new
            else:
                expected = CODES.ambiguous if best >= 0 and found.ambiguous[i] else CODES.unmatched
            assert verdict == expected
            named = match >= 0 or (best >= 0 and near)
            assert table.landmark[i] == (lines.ids[found.pairs[best].which] if named else -1)
            counts[verdict] += 1
    assert min(counts.values()) > 5
