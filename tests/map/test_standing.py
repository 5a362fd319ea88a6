"""A robot at rest: what every scan repeats is learnt once, and no wall is known better than its floor."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from commands import ok
from hostile import Put, write
from present import present
from worlds import World, instants

from locfuse.fusion.data import VERDICTS, Array, Drive
from locfuse.fusion.fuse import Filter, fuse
from locfuse.fusion.map.scan import SAME_D2, SAME_LENGTH, Scan, Standing
from locfuse.fusion.robot import Robot

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


def rested(seconds: float, sigma: float = 0.004) -> tuple[Drive, Robot]:
    """A precise laser on a robot that never moves, off by a start of 2 degrees."""
    world = World(
        seconds=seconds,
        speed=0.0,
        turning=0.0,
        sigma_range=sigma,
        settings={"compass": {"offset_deg": math.degrees(0.7)}, "lrf": {"walls": "flat"}},
    )
    return world.measured()


def test_most_of_the_scans_of_a_minute_at_rest_are_repeated_and_no_wall_is_known_below_its_floor() -> None:
    drive, robot = rested(60.0)
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
