"""Extreme settings: a start that is exact, nearly exact or unknown, no floors, a robot that never moves."""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec.structs import replace
from worlds import World

from locfuse.fusion.data import VERDICTS, Array, Drive
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.fuse import Filter
from locfuse.fusion.instants import due_readings, steps_of
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.measure import measure
from locfuse.fusion.robot import Robot, StartSettings
from locfuse.fusion.whole_drive.smooth import fuse_and_smooth

SIGMAS = [  # degrees, m
    (0.0, 0.0),
    (1e-9, 0.0),
    (0.0, 1e-9),
    (1e-9, 1e-9),
    (1e-9, 1000.0),
    (0.0, 1000.0),
    (5.0, 1000.0),
    (180.0, 0.3),
    (180.0, 1000.0),
]
ROUNDING = 1e-12


def correlation(P: Array) -> Array:
    """Scale a covariance to a unit diagonal: its smallest eigenvalue is then free of units."""
    assert (np.diagonal(P) >= 0.0).all()
    scale = np.sqrt(np.diagonal(P))
    scale = np.where(scale > 0.0, scale, 1.0)
    return np.asarray(P / np.outer(scale, scale))


def positive_throughout(drive: Drive, robot: Robot, sensors: list[str]) -> Filter:
    """Run the filter; its state and the pose in the map have a positive covariance at every instant."""
    run = Filter(robot, sensors)
    steps = steps_of(drive)
    for k, due in enumerate(due_readings(drive, sensors)):
        run.advance(k, steps, due, drive.measurements)
        belief = run.belief
        for P in (belief.covariance, run._in_map.matrix()):
            assert np.isfinite(P).all()
            assert np.linalg.eigvalsh(correlation(P))[0] > -ROUNDING
    return run


@pytest.fixture(scope="module")
def driven() -> tuple[Drive, Robot]:
    world = World(seconds=3.0, settings={"compass": {"offset_deg": math.degrees(0.7)}})
    robot = world.robot()
    return measure(world.streams(), robot), robot


@pytest.mark.parametrize("sensors", [["lrf"], ["compass", "lrf"]], ids="+".join)
@pytest.mark.parametrize(("degrees", "metres"), SIGMAS)
def test_any_start_gives_a_positive_covariance_and_the_same_shape(
    driven: tuple[Drive, Robot], degrees: float, metres: float, sensors: list[str]
) -> None:
    drive, robot = driven
    start = StartSettings(x=1.5, y=1.5, sigma_theta_deg=degrees, sigma_xy=metres)
    robot = replace(robot, start=start)
    positive_throughout(drive, robot, sensors)
    for run in fuse_and_smooth(drive, robot, sensors):
        shape = evaluate(run, drive, align="se2").figures["position_rmse_m"]
        assert shape is not None
        assert shape < 0.004
        assert (run.triangles[:, [0, 3, 5]] >= 0.0).all()
        assert run.triangles[-1, 0] >= 0.9 * metres**2


@pytest.mark.parametrize("seconds", [2.0, 30.0])
@pytest.mark.parametrize("mode", ["first-scan", "consider", "refine", "grow"])
def test_walls_without_floors_and_wheels_that_never_turn_keep_the_covariance_positive(
    mode: str, seconds: float
) -> None:
    """Nothing then stops a wall from being known exactly but the number of scans that count."""
    settings = {"floor_range": 0.0, "floor_angle_deg": 0.0, "walls": "flat", "map": mode}
    world = World(seconds=seconds, speed=0.0, turning=0.0, settings={"lrf": settings})
    robot = replace(world.robot(), start=StartSettings(x=1.5, y=1.5, sigma_theta_deg=2.0, sigma_xy=0.1))
    drive = measure(world.streams(), robot)
    run = positive_throughout(drive, robot, ["lrf"])
    np.testing.assert_allclose(run.pose(), (1.5, 1.5, 0.0), atol=1e-3)
    assert run._in_map.matrix()[2, 2] > 0.999 * np.radians(2.0) ** 2


def test_a_drive_without_floors_is_as_good_as_with_them() -> None:
    world = World(seconds=6.0, settings={"lrf": {"floor_range": 0.0, "floor_angle_deg": 0.0, "walls": "flat"}})
    robot = world.robot()
    drive = measure(world.streams(), robot)
    positive_throughout(drive, robot, ["lrf"])
    for run in fuse_and_smooth(drive, robot, ["lrf"]):
        assert (evaluate(run, drive).figures["position_rmse_m"] or 1.0) < 0.01


def test_a_covariance_beyond_the_square_of_a_float_refuses_the_reading() -> None:
    """Its products are infinite and its NIS is no number: the gate refuses, and nothing is raised."""
    belief = JointBelief((0.0, 0.0, 0.0), (1e200, 1e200, 0.0, 1e200, 0.0, 1.0))
    H, R = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)), ((1.0, 0.0), (0.0, 1.0))
    assert VERDICTS[belief.compare(0, (1.0, 1.0), H, R, 9.0).verdict] == "gate"
