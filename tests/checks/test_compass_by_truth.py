"""What the truth's headings say of a compass: iron without a full turn, an offset that moves, its sense."""

import math
import re

import numpy as np
import pytest
from msgspec.structs import replace
from present import present
from rows import readings
from small_drive import drive, path, robot

from locfuse.fusion.checks.compass import of_iron, of_moving_offset
from locfuse.fusion.checks.turning import of_turning
from locfuse.fusion.data import Array, ArrayStream, Drive, Estimates
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.compass import CompassSettings

HARD, SOFT = np.array([8.0, -5.0]), np.array([[1.3, 0.1], [0.1, 0.8]])


def headings(laps: float = 0.5) -> tuple[Array, Array]:
    """Times (n,) [s] and true headings (n,) [rad]; in half a lap the robot turns by 180 degrees."""
    t, pose = path(1.0)
    at = np.arange(1.0, laps * t[-1] - 0.5, 0.1)
    return at, np.interp(at, t, pose[:, 2])


def field(hard: Array, soft: Array) -> ArrayStream:
    """The field of a magnetometer on the robot: a circle of 20 units, moved and bent by iron."""
    t, theta = headings()
    north = math.pi / 2.0 - theta + 0.01 * np.random.default_rng(1).normal(size=len(t))
    m = 20.0 * np.stack((np.cos(north), np.sin(north)), axis=-1) @ soft.T + hard
    columns = {f"magnetic_field.{axis}": c for axis, c in zip("xyz", (*m.T, np.full(len(t), -40.0)), strict=True)}
    return ArrayStream("/mag", "sensor_msgs/msg/MagneticField", np.round(t * 1e9).astype(np.int64), columns)


def beside(compass: CompassSettings, truth: bool = True) -> tuple[Drive, Robot]:
    return replace(drive(5, robot(), truth=truth), epoch_ns=0), replace(robot(), sensors={"compass": compass})


@pytest.mark.parametrize("hard", [0.0 * HARD, HARD])
@pytest.mark.parametrize("soft", [np.eye(2), SOFT])
def test_iron_is_found_by_the_truth_without_a_full_turn(hard: Array, soft: Array) -> None:
    one, settings = beside(CompassSettings())
    found = of_iron(one, settings, {"compass": field(hard, soft)})
    told = dict(fix.split("=") for f in found for fix in f.fixes)
    assert ("compass.hard_iron" in told, "compass.soft_iron" in told) == (bool(hard.any()), soft is SOFT)
    if hard.any():
        assert np.fromstring(told["compass.hard_iron"].strip("[]"), sep=",") == pytest.approx(hard, abs=0.3)
    if soft is SOFT:  # the inverse of a symmetric matrix, of determinant 1
        shape = np.linalg.inv(soft) * math.sqrt(float(np.linalg.det(soft)))
        found_shape = np.fromstring(told["compass.soft_iron"].strip("[]"), sep=",")
        assert found_shape == pytest.approx(shape.ravel(), abs=0.03)
    blind, _ = beside(CompassSettings(), truth=False)
    assert of_iron(blind, settings, {"compass": field(hard, soft)}) == []


@pytest.mark.parametrize(
    ("moved", "words"),
    [(0.0, ""), (20.0, "by the truth its offset moves by 20° (1 sigma 0."), (-20.0, "its offset moves by 20°")],
)
def test_an_offset_that_steps_is_found_by_the_truth_or_the_laser(moved: float, words: str) -> None:
    (t, theta), (one, settings) = headings(1.0), beside(CompassSettings())
    z = theta + math.radians(30.0) + math.radians(moved) * (t > 27.0)
    z += math.radians(1.0) * np.random.default_rng(1).normal(size=len(t))
    seen = replace(one, measurements={"compass": readings(t, z[:, None], 0.02)})
    found = of_moving_offset(seen, settings)
    assert [words in f.message for f in found] == [True] * bool(moved)
    if moved:
        assert "most of it near 2" in found[0].message
        assert 2.0 < float(found[0].fixes[0].removeprefix("compass.offset_drift_deg=")) < 10.0
    blind, pose = replace(seen, truth=None), np.stack((t, t, theta), axis=-1)
    assert of_moving_offset(blind, settings) == []
    by_laser = of_moving_offset(blind, settings, Estimates("lrf", ("lrf",), t, pose, np.zeros((len(t), 6)), {}))
    assert [f.fixes for f in by_laser] == [f.fixes for f in found]
    assert all("by the laser's path its offset moves by 20°" in f.message for f in by_laser)
    drifting = replace(settings, sensors={"compass": CompassSettings(offset_drift_deg=1.0)})
    assert of_moving_offset(seen, drifting) == []


def test_a_part_of_the_drive_with_a_step_in_it_has_no_offset() -> None:
    """Half of its readings contradict the other half, so none of them may be left: its offset is not 0."""
    one, settings = beside(CompassSettings())
    t = np.arange(0.0, 60.0, 0.05)
    theta = 0.03 * np.sin(t) + math.pi * (t // 14.0 % 2.0)
    z = theta + math.radians(100.0) + math.radians(10.0) * (t > 33.7)
    z += 1e-3 * np.random.default_rng(1).normal(size=len(t))
    along = replace(present(one.truth), t=t, xy=np.zeros((len(t), 2)), theta=theta)
    seen = replace(one, truth=along, measurements={"compass": readings(t, z[:, None], 0.02)})
    (found,) = of_moving_offset(seen, settings)
    assert re.search(r"its offset moves by (9|10|11)°", found.message)


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_the_truth_shows_the_sense_of_a_compass_that_the_wheels_do_not_explain(sense: float) -> None:
    (t, theta), (one, settings) = headings(), beside(CompassSettings())
    streams = {"wheels": ArrayStream("/odom", "nav_msgs/msg/Odometry", np.zeros(0, np.int64), {})}
    streams["compass"] = ArrayStream("/heading", "std_msgs/msg/Float64", np.zeros(0, np.int64), {})
    seen = replace(one, measurements={"compass": readings(t, sense * theta[:, None], 0.02)})
    found = of_turning(seen, settings, {}, streams)
    assert [f.role for f in found] == ["compass"] * (sense < 0.0)
    assert all(f.message.startswith("it turns the other way round than the truth") for f in found)
