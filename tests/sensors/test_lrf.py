"""The laser: Jacobians by finite differences, frames, deskewing, and what must not be matched."""

from __future__ import annotations

import math

import numpy as np
import pytest
from lock_step import simulated
from msgspec.structs import replace
from said import over_states, written
from sighted import equation_of, sighted
from textbook import numeric_jacobian, wrap
from worlds import ROOM, World

from locfuse.fusion.checks.examine import blind
from locfuse.fusion.data import MapLine
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.lines.extract import Lines
from locfuse.fusion.lines.scans import Gathered
from locfuse.fusion.map.line_map import LineMap
from locfuse.fusion.map.scan import Scan
from locfuse.fusion.map.tracker import LineTracker
from locfuse.fusion.measure import measure

UPPER = (0.01, 0.001, 0.0005, 0.02, -0.0004, 0.001)
# pose, line (rho, beta about its anchor), anchor: ordinary, C near 0, robot near pi, far from the origin
PLACES = [
    ((1.0, 2.0, 0.3), (0.02, 0.4), (4.0, 3.0)),
    ((4.0, 3.1, -3.0), (0.05, 1.6), (4.0, 3.0)),
    ((0.5, -0.2, math.pi - 1e-7), (-0.1, -math.pi + 1e-7), (-3.0, 0.1)),
    ((100.0, -50.0, 2.0), (0.3, 2.9), (97.0, -49.0)),
    ((2.0, 2.0, 0.0), (0.0, 0.0), (2.0 + 1e-9, 5.0)),
]


def predicted(x: np.ndarray, anchor: tuple[float, float]) -> np.ndarray:
    """(r, psi) of a line (rho, beta) from a pose, written out: state x = (pose, rho, beta)."""
    n = np.array([math.cos(x[4]), math.sin(x[4])])
    return np.array([x[3] - (x[:2] - np.array(anchor)) @ n, x[4] - x[2]])


@pytest.mark.parametrize(("pose", "line", "anchor"), PLACES)
def test_line_jacobians_equal_finite_differences(
    pose: tuple[float, float, float], line: tuple[float, ...], anchor: tuple[float, float]
) -> None:
    belief = JointBelief(pose, UPPER, [])
    column = belief.augment(np.array(line), np.zeros((2, 3)), np.diag([0.01, 0.001]))
    lines = LineMap()
    lines.append(np.array(anchor), np.array(line), np.zeros((2, 2)), column, (-5.0, 5.0), 0)
    x = np.array([*pose, *line])
    h = predicted(x, anchor)
    z = h + np.array([0.003, 0.002])
    scan = Scan.of(z[None], np.diag([1e-3, 1e-4])[None], np.array([[-100.0, 100.0]]))
    found = sighted(scan.rows, lines, belief, math.inf, True)
    equation, seen = equation_of(found, belief), written(found)
    H = over_states(equation.columns, equation.H, belief.n)
    np.testing.assert_allclose(H, numeric_jacobian(lambda v: predicted(v, anchor), x), atol=1e-7)
    np.testing.assert_allclose(seen.y, [[0.003, 0.002]], atol=1e-9)
    S = H @ belief.covariance @ H.T + scan.R[0]
    np.testing.assert_allclose(seen.sigma[0], np.sqrt(np.diag(S)), rtol=1e-9)
    assert seen.nis[0] == pytest.approx(seen.y[0] @ np.linalg.solve(S, seen.y[0]), rel=1e-9)


def test_a_line_and_its_flipped_twin_give_the_same_innovation() -> None:
    """(r, psi) and (-r, psi + pi) are one line: nothing may jump when the robot crosses a wall's extension."""
    lines = LineMap()
    lines.append(np.array([3.0, 0.0]), np.array([0.0, 0.0]), np.zeros((2, 2)), -1, (0.0, 4.0), 0)
    belief = JointBelief((3.005, -1.0, 0.1), (1e-4, 0, 0, 1e-4, 0, 1e-4))  # just beyond the wall's own line
    R = np.array([[1e-3, 2e-4], [2e-4, 1e-3]])
    for z, cross in (((-0.004, -0.1), 1.0), ((0.004, -0.1 + math.pi), -1.0)):
        noise = R * np.array([[1, cross], [cross, 1]])
        ends = np.array([[1.0, 4.0]]) if cross > 0 else np.array([[-4.0, -1.0]])
        rows = Scan.of(np.array([z]), noise[None], ends).rows
        (pair,) = sighted(rows, lines, belief, math.inf, False).pair_list
        np.testing.assert_allclose(pair.y, [0.001, 0.0], atol=1e-9)
        np.testing.assert_allclose(pair.S - R, np.diag([1e-4, 1e-4]), atol=1e-9)
        assert (pair.lo, pair.hi) == pytest.approx((0.0, 3.0))


@pytest.mark.parametrize("pose", [p for p, _, _ in PLACES])
def test_a_new_line_enters_with_the_covariance_of_its_making(pose: tuple[float, float, float]) -> None:
    belief = JointBelief(pose, UPPER, [])
    before = belief.covariance.copy()
    model = LineTracker("grow", 0.9999)
    z, C, ends = np.array([[2.0, 0.7]]), np.array([[[1e-3, 2e-4], [2e-4, 5e-4]]]), np.array([[-0.5, 1.5]])
    model._add(Scan.of(z, C, ends), 0, belief)
    anchor = model.map.anchor[0]

    def line(v: np.ndarray) -> np.ndarray:
        beta = v[4] + v[2]
        n = np.array([math.cos(beta), math.sin(beta)])
        return np.array([v[3] + (v[:2] - anchor) @ n, beta])

    G = numeric_jacobian(line, np.array([*pose, 2.0, 0.7]))
    full = np.block([[before, np.zeros((3, 2))], [np.zeros((2, 3)), C[0]]])
    np.testing.assert_allclose(belief.covariance[3:, 3:], G @ full @ G.T, atol=1e-8)
    np.testing.assert_allclose(belief.covariance[3:, :3], G[:, :3] @ before, atol=1e-8)


def test_map_lines_are_reported_about_the_origin() -> None:
    belief = JointBelief((0.0, 0.0, 0.0), (0.0,) * 6)
    lines = LineMap()
    P = np.array([[1e-4, 2e-5], [2e-5, 1e-5]])
    lines.append(np.array([3.0, 4.0]), np.array([0.1, 0.5]), P, -1, (-1.0, 2.0), 0)
    line: MapLine = lines.lines(belief)[0]
    n, tangent = np.array([math.cos(0.5), math.sin(0.5)]), np.array([-math.sin(0.5), math.cos(0.5)])
    assert line.rho == pytest.approx(0.1 + n @ [3.0, 4.0])
    assert line.ends == pytest.approx((tangent @ [3.0, 4.0] - 1.0, tangent @ [3.0, 4.0] + 2.0))
    G = numeric_jacobian(
        lambda v: np.array([v[0] + np.array([math.cos(v[1]), math.sin(v[1])]) @ [3.0, 4.0], v[1]]),
        np.array([0.1, 0.5]),
    )
    np.testing.assert_allclose(line.P, G @ P @ G.T, atol=1e-9)


# two walls 0.2 m apart, seen one after the other through a doorway in a cross wall
PARALLEL = (
    *ROOM,
    (2.0, 0.0, 2.0, 2.4),
    (2.0, 3.6, 2.0, 6.0),
    (3.0, 2.0, 7.5, 2.0),
    (3.2, 1.8, 7.3, 1.8),
    (3.0, 4.4, 7.5, 4.4),
    (3.0, 4.6, 7.5, 4.6),
)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("mode", ["grow", "refine", "first-scan"])
def test_past_parallel_walls_and_through_a_doorway_no_line_is_matched_wrongly(mode: str, seed: int) -> None:
    """Drive from (0.6, 3) through the doorway at x = 2 between double walls; every match is checked in truth."""
    world = World(
        seconds=18.0,
        turning=0.0,
        start=(0.6, 3.0, 0.0),
        walls=PARALLEL,
        seed=seed,
        settings={"lrf": {"map": mode}},
        mount=(0.0, 0.0, 0.0),
    )
    robot = world.robot()
    drive = measure(world.streams(), robot)
    found = fuse(drive, robot, ["lrf"])
    audit, lrf = found.audits["lrf"], drive.measurements["lrf"]
    lines = {line.id: line for line in (*found.first_map, *found.final_map)}
    truth = world.pose(lrf.t)
    reading = np.searchsorted(lrf.first, audit.row, side="right") - 1
    wrong = 0
    kept = [k for k in np.flatnonzero(audit.verdict == 0) if int(audit.landmark[k]) in lines]
    assert len(kept) > 0.9 * (audit.verdict == 0).sum()  # the others' lines were joined with another or dropped
    for k in kept:
        line, (r, psi), pose = lines[int(audit.landmark[k])], lrf.z[audit.row[k]], truth[reading[k]]
        middle = lrf.extra["ends"][audit.row[k]].mean()
        a = psi + pose[2]
        x = pose[0] + r * math.cos(a) - middle * math.sin(a)
        y = pose[1] + r * math.sin(a) + middle * math.cos(a)
        # where the segment truly is, against the wall it was matched with: half the walls' distance is wrong
        wrong += abs(x * math.cos(line.beta) + y * math.sin(line.beta) - line.rho) > 0.1
    assert (audit.verdict == 0).sum() > 200
    assert wrong == 0
    assert (evaluate(found, drive).figures["position_max_m"] or math.inf) < 0.15


def test_two_walls_that_explain_a_line_equally_well_are_ambiguous() -> None:
    lines = LineMap()
    for offset in (3.0, 3.2):
        lines.append(np.array([offset, 0.0]), np.array([0.0, 0.0]), np.diag([1e-5, 1e-6]), -1, (-2.0, 2.0), 0)
    lost = JointBelief((0.0, 0.0, 0.0), (0.04, 0.0, 0.0, 0.04, 0.0, 1e-4))  # 0.2 m: cannot tell
    sure = JointBelief((0.0, 0.0, 0.0), (1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4))
    scan = Scan.of(np.array([[3.1, 0.0]]), np.diag([1e-4, 1e-5])[None], np.array([[-1.0, 1.0]]))
    found = sighted(scan.rows, lines, lost, 13.8, False)
    assert found.ambiguous == [True]
    assert found.pair_of == [-1]
    near = Scan.of(np.array([[3.005, 0.0]]), scan.R, scan.ends)
    found = sighted(near.rows, lines, sure, 13.8, False)
    assert found.pair_list[found.pair_of[0]].which == 0


def test_a_wall_is_not_matched_from_its_other_face() -> None:
    lines = LineMap()
    lines.append(np.array([3.0, 0.0]), np.array([0.0, 0.0]), np.zeros((2, 2)), -1, (-2.0, 2.0), 0)
    beyond = JointBelief((5.0, 0.0, 0.0), (1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4))
    scan = Scan.of(np.array([[2.0, math.pi]]), np.diag([1e-4, 1e-5])[None], np.array([[-1.0, 1.0]]))
    assert sighted(scan.rows, lines, beyond, 13.8, False).pair_of == [-1]


def test_the_mount_moves_lines_into_the_base_frame() -> None:
    """A laser yawed, shifted or upside-down sees the same walls from the base."""
    base = World(sigma_range=0.0, mount=(0.0, 0.0, 0.0), beams=361, seconds=2.0)
    turned = replace(base, mount=(0.2, -0.1, 0.4))
    poses = []
    for world in (base, turned):
        robot = world.robot()
        drive = measure(world.streams(), robot)
        lrf = drive.measurements["lrf"]
        z = lrf.z[lrf.first[5] : lrf.first[6]]
        poses.append({(round(float(r), 1), round(float(p), 1)) for r, p in z})
    assert len(poses[0] & poses[1]) >= 3


def test_a_moving_robots_scan_is_deskewed_to_its_middle() -> None:
    """Beams taken while the robot turns, cast from each beam's own pose, give the walls of a standing robot."""
    from worlds import cast, stream

    world = World(turning=1.0, speed=0.4, start=(4.0, 3.0, 0.0), walls=ROOM, seconds=4.0, wheel_noise=0.0)
    angles = np.linspace(-math.pi / 2, math.pi / 2, 181)
    dt = 0.1 / 181
    t = np.arange(1.0, 3.0, 0.2)
    ranges = []
    lx, ly, yaw = world.mount
    for start in t:
        row = []
        for k, angle in enumerate(angles):
            x, y, a = world.pose(np.array([start + k * dt]))[0]
            c, s = math.cos(a), math.sin(a)
            origin = np.array([x + c * lx - s * ly, y + s * lx + c * ly])
            row.append(cast(origin, np.array([a + yaw + angle]), np.array(ROOM, float))[0])
        ranges.append(row)
    from locfuse.fusion.data import Ragged

    n = len(t)
    data = {
        "angle_min": np.full(n, angles[0]),
        "angle_increment": np.full(n, angles[1] - angles[0]),
        "time_increment": np.full(n, dt),
        "range_min": np.full(n, 0.04),
        "range_max": np.full(n, 80.0),
        "ranges": Ragged(np.array(ranges).ravel(), np.arange(n + 1) * 181),
    }
    streams = {**world.streams(), "lrf": stream("/scan", "sensor_msgs/msg/LaserScan", t, data)}
    errors = {}
    for deskew in (True, False):
        robot = replace(world, settings={"lrf": {"deskew": deskew, "sigma_range": 0.005}}).robot()
        lrf = measure(streams, robot).measurements["lrf"]
        worst = []
        for i in range(n):
            x, y, a = world.pose(lrf.t[i : i + 1])[0]
            for _, psi in lrf.z[lrf.first[i] : lrf.first[i + 1]]:
                beta = psi + a
                normal = round(beta / (math.pi / 2)) * math.pi / 2
                worst.append(abs(wrap(beta - normal)))
        errors[deskew] = max(worst)
    assert errors[True] < math.radians(0.1)
    assert errors[False] > math.radians(1.0)


def test_lines_of_scans_that_lie_in_the_file_in_any_order_come_in_the_order_of_the_scans() -> None:
    counts = np.array([2, 0, 3, 1])
    first = np.concatenate(([0], np.cumsum(counts)))
    line = np.arange(6.0)
    z, R_unit = np.stack((line, -line), axis=-1), line[:, None, None] * np.eye(2)
    shuffled, straight = Gathered(), Gathered()
    for gathered, blocks in ((shuffled, ([2, 0], [3, 1])), (straight, ([0, 1, 2], [3]))):
        for at in blocks:
            rows = np.concatenate([np.arange(first[i], first[i + 1]) for i in at])
            begin = np.concatenate(([0], np.cumsum(counts[at])))
            span = np.zeros((len(rows), 2), int)
            sweep = np.zeros((len(rows), 2, 12), np.float32) + rows[:, None, None]
            curved = np.ones(len(at), int)
            whole = Lines(begin, z[rows], R_unit[rows], z[rows] + 1.0, rows, line[rows], span, sweep, curved)
            gathered.add(np.array(at), whole)
    for found in (shuffled.in_order(4), straight.in_order(4)):
        for column, expected in zip(found[:4], (first, z, R_unit, z + 1.0), strict=True):
            np.testing.assert_array_equal(column, expected)


def test_a_log_without_scans_has_no_lines() -> None:
    first, z, R_unit, ends, sweep = Gathered().in_order(0)
    assert sweep.shape == (0, 2, 0)
    assert first.tolist() == [0]
    assert (z.shape, R_unit.shape, ends.shape) == ((0, 2), (0, 2, 2), (0, 2))


def test_scans_that_were_not_deskewed_share_nothing_beside_those_that_were() -> None:
    gathered, one = Gathered(), np.ones(1, int)
    for i, parts in enumerate((0, 12, 0)):
        z, shared = np.full((1, 2), float(i)), np.full((1, 2, parts), 0.5)
        span = np.zeros((1, 2), int)
        lines = Lines(np.array([0, 1]), z, np.eye(2)[None], z, one, np.ones(1), span, shared, one)
        gathered.add(np.array([i]), lines)
    np.testing.assert_array_equal(
        gathered.in_order(3)[-1], np.array([0.0, 0.5, 0.0])[:, None, None] * np.ones((3, 2, 12))
    )


def test_a_round_room_leaves_the_pose_to_the_wheels_and_says_why() -> None:
    drive, robot = simulated(3, "round_room", ("path.laps=0.3",))
    (note,) = drive.measurements["lrf"].notes
    assert "curved walls" in note
    dead, why = blind("lrf", drive.measurements["lrf"])
    assert "no line in" in dead.message
    assert why.message == note
    np.testing.assert_allclose(fuse(drive, robot, ("lrf",)).pose, fuse(drive, robot, ()).pose, atol=1e-9)
