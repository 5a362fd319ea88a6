"""Candidate pairs are those that written-out matrices give, and the core's two forms give the same."""

from __future__ import annotations

import math

import numpy as np
import pytest
from line_scene import UPPER, covariance, scene, seated

from locfuse.fusion import se2
from locfuse.fusion.core import pairs as interpreted
from locfuse.fusion.core.form import form
from locfuse.fusion.core.room import Room
from locfuse.fusion.data import Array
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.linemap.line_map import LineMap
from locfuse.fusion.linemap.pairing import MAX_PAIR_ANGLE_RAD, MAX_PAIR_OFFSET_M, Pair, candidate_pairs
from locfuse.fusion.linemap.scan import Scan


def by_matrices(
    scan: Scan, lines: LineMap, belief: JointBelief, limit: float
) -> dict[tuple[int, int], dict[str, Array]]:
    """Every pair with H written out over the whole state, and R: maths of the field, no short cut."""
    state, P = belief.state, belief.covariance
    (x, y, theta), n = belief.pose(), len(state)
    found = {}
    for j in range(len(lines)):
        at = int(lines.column[j])
        rho, beta = lines.value[j] if at < 0 else state[at : at + 2]
        c, s, (dx, dy) = math.cos(beta), math.sin(beta), (x, y) - lines.anchor[j]
        r, psi, u = rho - dx * c - dy * s, beta - theta, dx * s - dy * c
        for i, (own, noise) in enumerate(zip(scan.z, scan.R, strict=True)):
            forward = abs(se2.wrap(own[1] - psi)) <= 0.5 * math.pi
            flip = np.diag((1.0 if forward else -1.0, 1.0))
            turn = se2.wrap(own[1] - psi - (0.0 if forward else math.pi))
            offset = flip[0, 0] * own[0] - r
            H = np.zeros((2, n))
            H[0, :2], H[1, 2] = (-c, -s), -1.0
            R = flip @ noise @ flip
            line = np.array([[1.0, u], [0.0, 1.0]])
            if at >= 0:
                H[:, at : at + 2] = line
            else:
                R = R + line @ lines.P[j] @ line.T
            S_flat = R
            if scan.seat is not None:
                H[:, list(scan.seat.columns)] = scan.seat.derivative(np.array([psi + turn]))[0]
            S = H @ P @ H.T + S_flat
            e = np.array([offset, turn])
            d2 = float(e @ np.linalg.solve(S, e))
            angle, far = (
                MAX_PAIR_ANGLE_RAD + 6.0 * math.sqrt(P[2, 2]),
                MAX_PAIR_OFFSET_M + 6.0 * math.sqrt(P[0, 0] + P[1, 1]),
            )
            near = abs(turn) < angle and abs(offset) < far
            if near and d2 <= limit and r > -3.0 * math.sqrt(S[0, 0]):
                tangent = np.array([-s, c])
                ends = tangent @ (dx, dy) + (scan.ends[i] if forward else -scan.ends[i][::-1])
                common = min(ends[1], lines.hi[j]) - max(ends[0], lines.lo[j])
                found[i, j] = {"y": e, "R": R, "S": S, "d2": np.array(d2), "score": d2 + np.log(np.linalg.det(S))}
                found[i, j]["ends"] = np.array([*ends, common])
    return found


def in_both_forms(scan: Scan, lines: LineMap, belief: JointBelief, limit: float) -> list[Pair]:
    found = candidate_pairs(scan, lines, belief, limit, Room.of(interpreted, None)).pairs()
    if form().functions is not None:
        assert candidate_pairs(scan, lines, belief, limit).pairs() == found
    return found


@pytest.mark.parametrize("free", [(), (2,), (0, 1), (1, 2), (0, 1, 2)])
@pytest.mark.parametrize("states", [False, True])
@pytest.mark.parametrize("limit", [60.0, math.inf])
def test_pairs_are_those_that_matrices_give(states: bool, limit: float, free: tuple[int, ...]) -> None:
    count = flipped = 0
    for seed in range(30):
        scan, lines, belief = scene(seed, states)
        if free:
            scan = seated(scan, belief, free)
        found = in_both_forms(scan, lines, belief, limit)
        expected = by_matrices(scan, lines, belief, limit)
        assert [(p.line, p.which) for p in found] == sorted(expected)
        for pair in found:
            known = expected[pair.line, pair.which]
            np.testing.assert_allclose(pair.y, known["y"], atol=1e-11)
            for name in ("R", "S"):
                np.testing.assert_allclose(
                    getattr(pair, name), known[name][[0, 0, 1], [0, 1, 1]], rtol=1e-9, atol=1e-11
                )
            np.testing.assert_allclose((pair.lo, pair.hi, pair.overlap), known["ends"], atol=1e-11)
            assert pair.d2 == pytest.approx(known["d2"], rel=1e-7, abs=1e-9)
            assert pair.score == pytest.approx(known["score"], rel=1e-7, abs=1e-7)
            flipped += np.sign(pair.R[1]) != np.sign(scan.R[pair.line, 0, 1])
        count += len(found)
    assert count > 60
    assert flipped > 6


def test_ends_lie_along_the_map_line_and_overlap_where_the_segments_do() -> None:
    lines = LineMap()
    lines.append(np.array([2.0, 1.0]), np.zeros(2), np.eye(2) * 1e-4, -1, (-1.0, 1.0), 0)  # x = 2, y from 0 to 2
    belief = JointBelief((0.0, 0.5, 0.0), UPPER)
    scan = Scan(np.array([[2.0, 0.0]]), np.array([np.eye(2) * 1e-4]), np.array([[-1.5, 1.0]]))  # y from -1 to 1.5
    (pair,) = in_both_forms(scan, lines, belief, 60.0)
    assert (pair.lo, pair.hi, pair.overlap) == pytest.approx((-2.0, 0.5, 1.5))
    beyond = JointBelief(
        (2.1, 0.5, 0.0), UPPER
    )  # by less than is known of the pose, so that the line lies behind it
    scan_of_it = Scan(np.array([[0.1, math.pi]]), scan.R, np.array([[-1.5, 0.8]]))  # y from -0.3 to 2
    (pair,) = in_both_forms(scan_of_it, lines, beyond, 60.0)
    assert pair.y == pytest.approx((0.0, 0.0))
    assert (pair.lo, pair.hi, pair.overlap) == pytest.approx((-1.3, 1.0, 2.0))
    behind = JointBelief((4.0, 0.5, math.pi), UPPER)  # sees the other face
    assert in_both_forms(scan, lines, behind, math.inf) == []


@pytest.mark.parametrize("pose", [(math.nan, 0.0, 0.0), (0.0, 0.0, math.inf), (1e200, 0.0, 0.0), (0.0, 0.0, 1e30)])
def test_a_pose_that_is_none_has_no_pairs(pose: tuple[float, float, float]) -> None:
    scan, lines, _ = scene(1, states=False)
    assert in_both_forms(scan, lines, JointBelief(pose, UPPER), 60.0) == []


@pytest.mark.parametrize(("lines", "walls"), [(0, 5), (3, 0), (40, 2000)])
def test_maps_of_none_and_of_two_thousand_lines_give_the_same_in_both_forms(lines: int, walls: int) -> None:
    rng = np.random.default_rng(0)
    known = LineMap()
    for _ in range(min(walls, 50)):
        known.append(
            rng.normal(size=2) * 3.0, np.array([0.0, rng.uniform(-3, 3)]), covariance(rng), -1, (-1.0, 1.0), 0
        )
    many = np.resize(np.arange(len(known)), walls)
    for name in ("ids", "anchor", "lo", "hi", "hits", "column", "value", "P", "seen", "born"):
        setattr(known, name, getattr(known, name)[many])
    z = np.stack((rng.uniform(0.0, 4.0, lines), rng.uniform(-3.0, 3.0, lines)), axis=-1)
    scan = Scan(z, np.tile(np.eye(2) * 1e-3, (lines, 1, 1)), np.tile((-1.0, 1.0), (lines, 1)))
    found = in_both_forms(scan, known, JointBelief((0.0, 0.0, 0.0), UPPER), 60.0)
    assert bool(found) == (lines * walls > 100)


@pytest.mark.parametrize("mount", [(0.2, 0.0, 0.3), (0.0, -0.1, 0.0), (0.0, 0.0, 2.0)])
@pytest.mark.parametrize("free", [(0,), (1,), (2,), (0, 2), (1, 2), (0, 1, 2)])
def test_a_line_depends_on_where_the_laser_sits_as_finite_differences_say(
    mount: tuple[float, float, float], free: tuple[int, ...]
) -> None:
    """A line at r, psi from the laser is at r + x cos + y sin of its direction from the base."""
    r, psi, step = 2.0, 0.9, 1e-6

    def from_base(place: Array) -> float:
        turned = psi + place[2]
        return float(r + place[0] * math.cos(turned) + place[1] * math.sin(turned))

    given = [mount[0], mount[1], *map(float, free)]
    for a, state in enumerate(free):
        d = step * np.eye(3)[state]
        slope = (from_base(np.array(mount) + d) - from_base(np.array(mount) - d)) / (2.0 * step)
        at = psi + mount[2]
        assert interpreted.lever(given, a, math.cos(at), math.sin(at)) == pytest.approx(-slope, abs=1e-8)
