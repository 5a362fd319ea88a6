"""A robot at rest: what every scan repeats is learnt once, and no wall is known better than its floor."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from worlds import World

from locfuse.fusion.data import VERDICTS, Array, Drive
from locfuse.fusion.fuse import Filter, fuse
from locfuse.fusion.instants import due_readings, steps_of
from locfuse.fusion.linemap.scan import Scan
from locfuse.fusion.linemap.standing import Standing
from locfuse.fusion.measure import measure
from locfuse.fusion.robot import Robot
from locfuse.fusion.smooth import fuse_and_smooth

R = np.diag([1e-4, 4e-4])
WALLS = np.array([[2.0, 0.1], [1.5, 1.7], [3.0, -2.0]])
ENDS = np.array([[-1.0, 1.0], [-0.5, 2.0], [-2.0, 0.3]])
REPEATED = VERDICTS.index("repeated")


def scan(z: Array = WALLS, ends: Array = ENDS) -> Scan:
    return Scan(z, np.tile(R, (len(z), 1, 1)), ends)


def noisy(rng: np.random.Generator) -> Scan:
    return scan(WALLS + rng.normal(size=WALLS.shape) * np.sqrt(np.diagonal(R)))


def test_of_many_scans_at_rest_few_count_and_each_is_the_mean_since_the_one_before() -> None:
    rng, standing = np.random.default_rng(1), Standing()
    scans = [noisy(rng) for _ in range(64)]
    taken = [standing.take(s) for s in scans]
    used = [k for k, s in enumerate(taken, 1) if s is not None]
    assert used == [1, 2, 4, 8, 16, 32, 64]
    assert taken[0] is scans[0]
    last = taken[-1]
    assert last is not None
    np.testing.assert_allclose(last.z, np.mean([s.z for s in scans[32:]], axis=0), atol=1e-12)
    np.testing.assert_array_equal(last.R, scans[-1].R)


@pytest.mark.parametrize(("motion", "counts"), [((0.01, 0.0, 0.0), True), ((4e-4, 0.0, 1e-3), False)])
def test_a_robot_that_drives_learns_from_every_scan_and_a_tick_of_an_encoder_is_no_drive(
    motion: Sequence[float], counts: bool
) -> None:
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
    assert abs(math.remainder(found.z[0, 1] + math.pi - 0.01, 2 * math.pi)) < 1e-12


def rested(seconds: float, sigma: float = 0.004) -> tuple[Drive, Robot]:
    """A precise laser on a robot that never moves, off by a start of 2 degrees."""
    world = World(
        seconds=seconds,
        speed=0.0,
        turning=0.0,
        sigma_range=sigma,
        settings={"compass": {"offset_deg": math.degrees(0.7)}, "lrf": {"walls": "flat"}},
    )
    robot = world.robot()
    return measure(world.streams(), robot), robot


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
    robot = world.robot()
    drive = measure(world.streams(), robot)
    run = Filter(robot, ["lrf"])
    floor = np.diagonal(drive.measurements["lrf"].floor)
    for k, (step, due) in enumerate(zip(steps_of(drive), due_readings(drive, ["lrf"]), strict=True)):
        run.advance(k, step, due, drive.measurements)
        lines = run.models["lrf"].map  # type: ignore[attr-defined]
        spread = np.diagonal(lines.covariances(run.belief), axis1=1, axis2=2)
        assert (spread >= (1.0 - 1e-9) * floor).all()


def test_a_robot_at_rest_is_held_where_it_is_and_smoothing_agrees() -> None:
    drive, robot = rested(20.0, 0.02)
    filtered, smoothed = fuse_and_smooth(drive, robot, ["compass", "lrf"])
    np.testing.assert_allclose(filtered.pose, np.broadcast_to(filtered.pose[0], filtered.pose.shape), atol=0.01)
    np.testing.assert_allclose(smoothed.pose, np.broadcast_to(smoothed.pose[0], smoothed.pose.shape), atol=0.01)
