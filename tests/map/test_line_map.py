"""Lines in the map: where their frame puts them, how sure, and what happens when one leaves."""

import json
import math
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import ok
from hostile import Put, write
from line_scene import covariance
from present import present
from rows import step
from textbook import move, numeric_jacobian
from worlds import World, instants

from locfuse.fusion.data import VERDICTS, Array, MapLine
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.fuse import Filter, fuse
from locfuse.fusion.map import line_map
from locfuse.fusion.map.line_map import LineMap, about_middle, merge_doubles, prune
from locfuse.fusion.map.scan import SAME_D2, SAME_LENGTH, Scan, Standing


def in_the_map(v: Array, anchor: Array) -> Array:
    """(rho, beta) about the origin of a line (rho about its anchor, beta) in a local frame that lies at v[2:]."""
    beta, at = v[1] + v[4], move(v[2:], np.array([*anchor, 0.0]))[:2]
    return np.array([v[0] + at[0] * math.cos(beta) + at[1] * math.sin(beta), beta])


def three_lines(belief: JointBelief | None, rng: np.random.Generator) -> LineMap:
    lines = LineMap()
    for _ in range(3):
        value, P = rng.normal(0.0, (0.1, 1.0)), covariance(rng)
        column = -1 if belief is None else belief.augment(value, rng.normal(size=(2, 3)), P)
        lines.append(rng.normal(0.0, 3.0, 2), value, P, column, (-0.7, 1.9), 0)
    lines.hits[:] = 5, 6, 7
    return lines


def assert_placed(line: MapLine, v: Array, anchor: Array, joint: Array) -> None:
    """A line of values v (rho, beta, frame) and their covariance (5, 5), where its frame puts it."""
    rho, beta = in_the_map(v, anchor)
    assert (line.rho, math.cos(line.beta - beta)) == pytest.approx((rho, 1.0))
    J = numeric_jacobian(lambda x: in_the_map(x, anchor), v)
    np.testing.assert_allclose(line.P, J[:, :2] @ joint[:2, :2] @ J[:, :2].T, atol=1e-7)
    if line.P_free is not None:
        np.testing.assert_allclose(line.P_free, J @ joint @ J.T, atol=1e-7)
    foot = anchor + v[0] * np.array([math.cos(v[1]), math.sin(v[1])])
    n = np.array([math.cos(line.beta), math.sin(line.beta)])
    for end, along in zip(line.ends, (-0.7, 1.9), strict=True):
        local = foot + along * np.array([-math.sin(v[1]), math.cos(v[1])])
        in_map = line.rho * n + end * np.array([-n[1], n[0]])
        np.testing.assert_allclose(in_map, move(v[2:], np.array([*local, 0.0]))[:2], atol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_lines_of_a_frozen_map_are_placed_as_finite_differences_say(seed: int) -> None:
    rng = np.random.default_rng(seed)
    lines, frame = three_lines(None, rng), rng.normal(0.0, 2.0, 3)
    root = 0.1 * rng.normal(size=(3, 3))
    joint = np.zeros((5, 5))
    joint[2:, 2:] = root @ root.T
    for j, line in enumerate(lines.lines_in_map(frame, joint[2:, 2:])):
        joint[:2, :2] = lines.P[j]
        assert (line.id, line.hits) == (j, 5 + j)
        assert line.P_free is not None
        assert_placed(line, np.concatenate((lines.value[j], frame)), lines.anchor[j], joint)
    still = JointBelief((0.0, 0.0, 0.0), (0.0,) * 6)
    for j, line in enumerate(lines.lines(still)):
        assert_placed(line, np.append(lines.value[j], np.zeros(3)), lines.anchor[j], np.pad(lines.P[j], (0, 3)))


@pytest.mark.parametrize("seed", range(4))
def test_lines_of_a_growing_map_know_what_they_have_to_do_with_their_frame(seed: int) -> None:
    rng = np.random.default_rng(seed)
    belief = JointBelief((1.0, -2.0, 0.7), (0.09, 0.01, 0.004, 0.05, -0.003, 0.02))
    belief.begin_frame()
    belief.predict(step((0.3, 0.02, 0.25), (1e-3, 0.0, 0.0, 2e-3, 1e-4, 4e-3)), 0)
    lines = three_lines(belief, rng)
    root, first = 0.05 * rng.normal(size=(belief.n, belief.n)), belief.frame
    assert belief.framed
    belief.covariance[:] += root @ root.T  # everything has to do with everything
    assert lines.column.tolist() == [6, 8, 10]
    for j, line in enumerate(lines.lines(belief)):
        at = np.array([*(lines.column[j] + np.arange(2)), *(first + np.arange(3))])
        np.testing.assert_array_equal(lines.covariances(belief)[j], belief.covariance[np.ix_(at[:2], at[:2])])
        assert_placed(line, belief.state[at].copy(), lines.anchor[j], belief.covariance[np.ix_(at, at)])


@pytest.mark.parametrize("seed", range(4))
def test_the_middle_of_a_line_is_where_its_place_and_angle_are_independent(seed: int) -> None:
    (line, *_) = three_lines(None, np.random.default_rng(seed)).lines_in_map(np.array([1.0, 2.0, 0.3]), np.eye(3))
    middle, half, P = about_middle(line)
    n = np.array([math.cos(line.beta), math.sin(line.beta)])
    ends = [line.rho * n + end * np.array([-n[1], n[0]]) for end in line.ends]
    np.testing.assert_allclose(middle, (ends[0] + ends[1]) / 2.0, atol=1e-12)
    assert half == pytest.approx(1.3)

    def about(v: Array) -> Array:
        """The distance of the line (rho, beta) from the middle, and its direction."""
        return np.array([v[0] - middle[0] * math.cos(v[1]) - middle[1] * math.sin(v[1]), v[1]])

    J = numeric_jacobian(about, np.array([line.rho, line.beta]))
    np.testing.assert_allclose(P, J @ line.P @ J.T, atol=1e-7)


def test_a_dropped_line_takes_its_states_with_it_and_the_others_move_up() -> None:
    belief = JointBelief((0.0, 0.0, 0.0), (0.01, 0.0, 0.0, 0.01, 0.0, 0.01))
    lines = three_lines(belief, np.random.default_rng(1))
    values = lines.values(belief).copy()
    freed = lines.drop(np.array([1]))
    assert freed.tolist() == [5, 6]
    belief.remove(freed)
    assert lines.column.tolist() == [3, 5]
    np.testing.assert_array_equal(lines.values(belief), values[[0, 2]])
    assert lines.append(np.zeros(2), values[0], np.eye(2), 7, (0.0, 1.0), 4) == 3  # an id that was never used


def test_no_line_is_known_better_than_its_floor() -> None:
    belief = JointBelief((0.0, 0.0, 0.0), (0.01, 0.0, 0.0, 0.01, 0.0, 0.01))
    lines = three_lines(belief, np.random.default_rng(1))
    belief.covariance[range(3, 9), range(3, 9)] = 1e-4, 9e-4, 4e-4, 1e-6, 9e-4, 1e-4
    lines.raise_variances(belief, np.array([4e-4, 2e-4]))
    np.testing.assert_allclose(np.diag(belief.covariance)[3:], [4e-4, 9e-4, 4e-4, 2e-4, 9e-4, 2e-4])


# --- keeping the map small: doubles become one as a filter would join them, chance lines leave, a loop closes

EVEN = np.zeros(2)


def a_map(*walls: tuple[float, float, float, float], hits: int = 10) -> tuple[LineMap, JointBelief]:
    """A belief at the origin and walls (x, y of the anchor, beta, sigma), each 2 m long and known on its own."""
    belief = JointBelief((0.0, 0.0, 0.0), (0.01, 0.0, 0.0, 0.01, 0.0, 0.001), [])
    lines = LineMap()
    for x, y, beta, sigma in walls:
        P = np.diag([sigma**2, (0.3 * sigma) ** 2])
        value = np.array([0.0, beta])
        column = belief.augment(value, np.zeros((2, 3)), P)
        lines.append(np.array([x, y]), value, P, column, (-1.0, 1.0), 1)
    lines.hits[:] = hits
    lines.seen[:] = 100
    return lines, belief


def test_two_pieces_of_one_wall_become_their_weighted_mean() -> None:
    """About one anchor the measurement "equal" is linear: information adds up (inverse variances)."""
    lines, belief = a_map((3.0, 0.0, 0.0, 0.02), (3.0, 0.0, 0.0, 0.04))
    belief.state[lines.column[1]] = 0.03
    merge_doubles(lines, belief, 100, EVEN)
    assert len(lines) == 1
    assert belief.n == 5
    a, b, flat = 0.02**2, 0.04**2, line_map.FLAT_SIGMAS[0] ** 2
    assert belief.state[3] == pytest.approx(0.03 * a / (a + b + flat))
    assert belief.covariance[3, 3] == pytest.approx(a - a * a / (a + b + flat))
    assert lines.hits[0] == 20


def test_a_wall_that_was_seen_in_two_stretches_reaches_over_both() -> None:
    lines, belief = a_map((3.0, 0.0, 0.0, 0.02), (3.0, 2.1, 0.0, 0.02))
    merge_doubles(lines, belief, 100, EVEN)
    assert len(lines) == 1
    assert (lines.lo[0], lines.hi[0]) == pytest.approx((-1.0, 3.1))


@pytest.mark.parametrize(
    ("second", "why"),
    [
        ((3.2, 0.0, 0.0, 0.02), "ten standard deviations away"),
        ((3.0, 0.0, math.pi, 0.02), "the other face of a thin wall"),
        ((3.0, 4.0, 0.0, 0.02), "a gap of two metres: a door"),
        ((3.3, 0.0, 0.0, 1.0), "further than any double, however vague"),
    ],
)
def test_two_walls_stay_two(second: tuple[float, float, float, float], why: str) -> None:
    lines, belief = a_map((3.0, 0.0, 0.0, 0.005), second)
    before = belief.covariance.copy()
    merge_doubles(lines, belief, 100, EVEN)
    assert len(lines) == 2, why
    np.testing.assert_array_equal(belief.covariance, before)


def test_uneven_walls_are_held_to_each_other_less_tightly() -> None:
    left = {}
    for name, uneven in (("flat", EVEN), ("uneven", np.array([0.01**2, 0.008**2]))):
        lines, belief = a_map((3.0, 0.0, 0.0, 0.02), (3.01, 0.0, 0.0, 0.02))
        merge_doubles(lines, belief, 100, uneven)
        assert len(lines) == 1
        left[name] = float(belief.covariance[3, 3])
    assert left["uneven"] > left["flat"]


def test_a_merge_closes_a_loop_the_pose_follows_the_wall_it_knows_again() -> None:
    """A new wall was laid down from a pose that drifted; that it is an old one moves the pose back."""
    lines, belief = a_map((3.0, 0.0, 0.0, 0.002))
    value, noise = np.array([0.08, 0.0]), np.diag([1e-6, 1e-6])  # the pose is 0.08 m too far ahead
    column = belief.augment(value, np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), noise)
    lines.append(np.array([3.0, 0.0]), value, noise, column, (-1.0, 1.0), 90)
    lines.seen[1] = 100
    merge_doubles(lines, belief, 100, EVEN)
    assert len(lines) == 1
    assert belief.x == pytest.approx(-0.08, abs=0.001)
    assert math.sqrt(belief.covariance[0, 0]) < 0.007  # it was 0.1


def test_lines_that_were_hardly_seen_again_leave_with_their_states() -> None:
    lines, belief = a_map((3.0, 0.0, 0.0, 0.02), (0.0, 3.0, math.pi / 2, 0.02), (-3.0, 0.0, math.pi, 0.02))
    lines.hits[1] = line_map.MIN_HITS - 1
    kept = belief.state[[0, 1, 2, 3, 4, 7, 8]].copy()
    prune(lines, belief, 1 + line_map.TRIAL_SCANS)
    assert len(lines) == 3
    prune(lines, belief, 2 + line_map.TRIAL_SCANS)
    assert lines.ids.tolist() == [0, 2]
    np.testing.assert_array_equal(belief.state, kept)
    assert lines.column.tolist() == [3, 5]


# --- a robot that stands sees the same walls again

R = np.diag([1e-4, 4e-4])
WALLS = np.array([[2.0, 0.1], [1.5, 1.7], [3.0, -2.0]])
ENDS = np.array([[-1.0, 1.0], [-0.5, 2.0], [-2.0, 0.3]])
REPEATED = VERDICTS.index("repeated")


def scan(z: Array = WALLS, ends: Array = ENDS) -> Array:
    return Scan.of(z, np.tile(R, (len(z), 1, 1)), ends).rows


def noisy(rng: np.random.Generator) -> Array:
    return scan(WALLS + rng.normal(size=WALLS.shape) * np.sqrt(np.diagonal(R)))


def test_of_many_scans_at_rest_few_count_and_each_is_the_mean_since_the_one_before() -> None:
    rng, standing = np.random.default_rng(1), Standing()
    scans = [noisy(rng) for _ in range(64)]
    taken = [standing.take(s) for s in scans]
    used = [k for k, s in enumerate(taken, 1) if s is not None]
    assert used == [1, 2, 4, 8, 16, 32, 64]
    assert taken[0] is scans[0]
    last = present(taken[-1])
    np.testing.assert_allclose(last[:, :2], np.mean([s[:, :2] for s in scans[32:]], axis=0), atol=1e-12)
    np.testing.assert_array_equal(last[:, 2:], scans[-1][:, 2:])


@pytest.mark.parametrize(("motion", "counts"), [((0.01, 0.0, 0.0), True), ((4e-4, 0.0, 1e-3), False)])
def test_every_scan_of_a_drive_counts_and_a_tick_is_no_drive(motion: Sequence[float], counts: bool) -> None:
    standing, rng = Standing(), np.random.default_rng(2)
    taken = []
    for k in range(40):
        standing.rolled([u * (1.0 if counts or k % 2 else -1.0) for u in motion])
        taken.append(standing.take(noisy(rng)))
    assert sum(s is not None for s in taken) == (40 if counts else 6)


def test_a_scan_that_shows_something_else_is_used_at_once() -> None:
    """Somebody stands before the laser, or lifts the robot while its wheels stand still."""
    standing, rng = Standing(), np.random.default_rng(3)
    for _ in range(20):
        standing.take(noisy(rng))
    assert standing.take(noisy(rng)) is None
    other = scan(WALLS + np.array([0.3, 0.5]))
    assert standing.take(other) is other
    assert standing.take(noisy(rng)) is None


def test_an_angle_beyond_half_a_turn_is_averaged_across_it() -> None:
    standing = Standing()
    for psi in (math.pi - 0.01, -math.pi + 0.01):
        found = standing.take(scan(np.array([[2.0, psi]]), ENDS[:1]))
    assert found is not None
    assert abs(math.remainder(found[0, 1] + math.pi - 0.01, 2 * math.pi)) < 1e-12


LIKE = np.diag([1e-4, 4e-4])


def some_lines(rng: np.random.Generator, n: int) -> Scan:
    """Lines close to one another, of which some are alike."""
    z = np.column_stack((rng.uniform(1.0, 1.3, n), rng.choice([3.1, -3.1, 0.4], n) + rng.normal(0.0, 0.1, n)))
    middle, half = rng.normal(0.0, 0.5, n), rng.uniform(0.2, 1.5, n)
    root = rng.normal(0.0, 0.03, (n, 2, 2))
    return Scan.of(z, root @ root.transpose(0, 2, 1) + LIKE, np.column_stack((middle - half, middle + half)))


def repeats(scan: Scan, k: int, first: Scan, j: int) -> float:
    """The squared distance of line k from line j, infinite where they have too little in common."""
    off = np.array([scan.z[k, 0] - first.z[j, 0], math.remainder(scan.z[k, 1] - first.z[j, 1], math.tau)])
    common = min(scan.ends[k, 1], first.ends[j, 1]) - max(scan.ends[k, 0], first.ends[j, 0])
    if common <= SAME_LENGTH * max(np.ptp(scan.ends[k]), np.ptp(first.ends[j])):
        return math.inf
    return float(off @ np.linalg.solve(2.0 * scan.R[k], off))


@pytest.mark.parametrize("seed", range(40))
def test_a_line_repeats_the_one_that_is_nearest_where_each_is_the_others(seed: int) -> None:
    rng = np.random.default_rng(seed)
    first = some_lines(rng, 6)
    noise = rng.normal(size=(6, 2)) * 0.02
    scan = Scan.of(first.z + noise, first.R, first.ends) if seed % 2 else some_lines(rng, 5)
    standing = Standing()
    for _ in range(2):
        standing.take(first.rows)
    d2 = np.array([[repeats(scan, k, first, j) for j in range(6)] for k in range(len(scan.z))])
    expected = np.full(len(d2), -1)
    for k, row in enumerate(d2):
        best = int(row.argmin())
        if row[best] < SAME_D2 and d2[:, best].argmin() == k:
            expected[k] = best
    np.testing.assert_array_equal(standing._same(scan.rows), expected)


def test_most_of_the_scans_of_a_minute_at_rest_are_repeated_and_no_wall_is_known_below_its_floor() -> None:
    settings: dict[str, dict[str, Any]] = {"compass": {"offset_deg": math.degrees(0.7)}, "lrf": {"walls": "flat"}}
    drive, robot = World(seconds=60.0, speed=0.0, turning=0.0, sigma_range=0.004, settings=settings).measured()
    run = fuse(drive, robot, ["lrf"])
    verdicts = run.audits["lrf"].verdict
    assert (verdicts == REPEATED).mean() > 0.95
    floor = drive.measurements["lrf"].floor
    for line in run.final_map:
        middle = 0.5 * (line.ends[0] + line.ends[1])
        about = np.array([[1.0, -middle], [0.0, 1.0]]) @ line.P @ np.array([[1.0, 0.0], [-middle, 1.0]])
        assert about[1, 1] >= 0.999 * floor[1, 1]
        assert about[0, 0] >= 0.9 * floor[0, 0]


@pytest.mark.parametrize("mode", ["refine", "grow"])
def test_no_wall_is_ever_known_below_its_floor_while_driving(mode: str) -> None:
    world = World(seconds=15.0, sigma_range=0.004, settings={"lrf": {"walls": "flat", "map": mode}})
    drive, robot = world.measured()
    run = Filter(robot, ["lrf"])
    floor = np.diagonal(drive.measurements["lrf"].floor)
    for _ in instants(run, drive, "lrf"):
        lines = run.models["lrf"].map  # type: ignore[attr-defined]
        spread = np.diagonal(lines.covariances(run.belief), axis1=1, axis2=2)
        assert (spread >= (1.0 - 1e-9) * floor).all()


# --- two scans at one instant, as coarse stamps give: no traceback, and no line by another scan's verdict

COARSE_NS = 200_000_000  # twice the laser's period


def coarsely_stamped(put: Put) -> Put:
    if put.topic != "/scan":
        return put
    data = bytearray(put.data)
    seconds, nanoseconds = struct.unpack_from("<iI", data, 4)
    struct.pack_into("<iI", data, 4, seconds, nanoseconds // COARSE_NS * COARSE_NS)
    return put._replace(data=bytes(data))


def test_pairs_of_scans_are_fused_and_the_error_stays_that_of_single_ones(tmp_path: Path) -> None:
    rmse = {}
    for name, change in (("single", lambda put: put), ("pairs", coarsely_stamped)):
        log = write(tmp_path / f"{name}.mcap", change, seconds=40.0)
        ok("run", log, "-o", tmp_path / name, "--sensors", "lrf", "--no-smooth", "--no-advice", "--write", "json")
        report = json.loads((tmp_path / name / "run.json").read_bytes())
        (found,) = report["configurations"].values()
        rmse[name] = found["position_rmse_m"]
    assert rmse["pairs"] < 3.0 * rmse["single"] + 0.02
