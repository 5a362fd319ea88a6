"""Which way round a camera's columns turn, and where column 0 looks, by the wheels and a known start."""

from __future__ import annotations

import math

import numpy as np
import pytest
from lock_step import simulated
from msgspec.structs import replace

from locfuse.fusion import se2
from locfuse.fusion.checks.pictures import of_handedness
from locfuse.fusion.data import Drive, Measurements, Truth
from locfuse.fusion.robot import Robot
from locfuse.fusion.se2 import wrap_all
from locfuse.fusion.wheels.motion import Wheels

LANDMARK = (1.0, 2.5)


@pytest.fixture(scope="module")
def healthy() -> tuple[Drive, Robot]:
    """A lap with bearings from the truth, 2 Hz, 0.5 degrees of noise."""
    drive, robot = simulated(5, sets=("camera.enabled=false",), robot_sets=("camera.landmark=[1.0,2.5]",))
    truth = drive.truth
    assert isinstance(truth, Truth)
    assert truth.theta is not None
    t, xy, theta = truth.t[::5], truth.xy[::5], truth.theta[::5]
    z = np.arctan2(LANDMARK[1] - xy[:, 1], LANDMARK[0] - xy[:, 0]) - theta
    z = wrap_all(z + np.radians(0.5) * np.random.default_rng(1).normal(size=len(z)))
    n = len(z)
    seen = Measurements(t, np.arange(n + 1), z[:, None], np.ones((n, 1, 1)), math.radians(0.5), np.zeros((1, 1)))
    return replace(drive, measurements={"camera": seen}), robot


def mirrored(drive: Drive, zero_deg: float) -> Drive:
    """The same as a camera sees it whose columns turn the other way round, and whose column 0 looks elsewhere."""
    m = drive.measurements["camera"]
    z = wrap_all(math.radians(zero_deg) - m.z)
    return replace(drive, measurements={"camera": replace(m, z=z)})


def test_a_camera_that_is_as_configured_is_left_alone(healthy: tuple[Drive, Robot]) -> None:
    assert of_handedness(*healthy) == []


def test_a_mirrored_camera_is_named_with_its_handedness(healthy: tuple[Drive, Robot]) -> None:
    drive, robot = healthy
    (found,) = of_handedness(mirrored(drive, 0.0), robot)
    assert found.severe
    assert found.fixes == ("camera.clockwise=true",)


@pytest.mark.parametrize("zero_deg", [90.0, -150.0])
def test_a_known_start_gives_the_zero_of_a_mirrored_camera(healthy: tuple[Drive, Robot], zero_deg: float) -> None:
    """z = zero - column, configured as z = column: with both fixes the bearings are right again."""
    drive, robot = healthy
    (found,) = of_handedness(mirrored(drive, zero_deg), robot)
    assert found.fixes[0] == "camera.clockwise=true"
    assert float(found.fixes[1].partition("=")[2]) == pytest.approx(zero_deg, abs=3.0)
    (blind,) = of_handedness(mirrored(drive, zero_deg), replace(robot, start_given=False))
    assert blind.fixes == ("camera.clockwise=true",)


def test_only_the_first_metres_give_the_zero_where_the_robot_keeps_near_its_start(
    healthy: tuple[Drive, Robot],
) -> None:
    """Fifty small circles by wheels that turn 0.5 percent too far: in the end their heading is 90 degrees off."""
    drive, robot = healthy
    t = np.arange(0.0, 785.0, 0.1)
    turn, radius = 0.4 * t, 0.25
    wheels = Wheels.from_twists(t, np.diff([radius * turn, 0.0 * t, 1.005 * turn], axis=1).T, 0.4, 4e-4)
    pose = se2.compose(
        np.array(robot.start.pose),
        np.stack([radius * np.sin(turn), radius * (1.0 - np.cos(turn)), turn], axis=-1),
    )[::5]
    z = np.arctan2(LANDMARK[1] - pose[:, 1], LANDMARK[0] - pose[:, 0]) - pose[:, 2]
    n = len(z)
    seen = Measurements(
        t[::5], np.arange(n + 1), wrap_all(z)[:, None], np.ones((n, 1, 1)), math.radians(0.5), np.zeros((1, 1))
    )
    circles = replace(drive, wheels=wheels, measurements={"camera": seen})
    (found,) = of_handedness(mirrored(circles, 25.0), robot)
    assert float(found.fixes[1].partition("=")[2]) == pytest.approx(25.0, abs=3.0)


def test_a_robot_that_hardly_turns_tells_nothing(healthy: tuple[Drive, Robot]) -> None:
    drive, robot = healthy
    few = drive.measurements["camera"].take(np.arange(8))
    assert of_handedness(mirrored(replace(drive, measurements={"camera": few}), 0.0), robot) == []
