"""Outliers kept with a larger R instead of being refused."""

from __future__ import annotations

import math

import numpy as np
import pytest
from told import Told
from worlds import World

from locfuse.fusion.data import VERDICTS, ArrayStream
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.fuse import fuse, inflate
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.measure import measure

GATE = VERDICTS.index("gate")
HEADING = ((0.0, 0.0, 1.0),)


@pytest.mark.parametrize("before", [0, 2])  # numbers of another reading, which stand above it in the equation
def test_an_outlier_is_put_exactly_on_its_gate_and_keeps_its_prediction(before: int) -> None:
    belief, other = JointBelief((0.0,) * 3, (0.0, 0.0, 0.0, 0.0, 0.0, 0.01)), np.ones((before, 3))
    if before:
        belief.compare(0, (0.0,) * before, other, np.eye(before), 9.0)
    seen = Told((1.0,), HEADING, ((0.01,),)).judged(belief, 9.0)
    assert seen.verdict == GATE
    inflate(seen, belief)
    assert seen.verdict == 0
    assert belief.equation([seen]).R[0, 0] == pytest.approx(1.0 / 9.0 - 0.01)  # y^2 / (H P H' + R) = 9
    assert (seen.nis, seen.y) == (9.0, (1.0,))
    assert seen.sigma[0] == pytest.approx(1.0 / 3.0)


def test_a_reading_within_its_gate_stays_as_it_is() -> None:
    belief = JointBelief((0.0,) * 3, (0.0, 0.0, 0.0, 0.0, 0.0, 0.01))
    seen = Told((0.1,), HEADING, ((0.01,),)).judged(belief, 9.0)
    before = seen.verdict, seen.nis, seen.sigma
    inflate(seen, belief)
    assert (seen.verdict, seen.nis, seen.sigma) == before
    assert belief.equation([seen]).R[0, 0] == 0.01


def test_heavy_tails_hurt_less_when_outliers_are_inflated() -> None:
    """A compass that is wrong by up to 40 degrees in a fifth of its readings, told that it is good to one."""
    errors = {}
    for outliers in ("reject", "inflate"):
        world = World(
            settings={"compass": {"outliers": outliers, "offset_deg": math.degrees(0.7)}}, wheel_noise=4e-3, seed=5
        )
        streams, robot = world.streams(), world.robot()
        rng = np.random.default_rng(3)
        data = dict(streams["compass"].data)
        turn = np.where(rng.random(len(data["magnetic_field.x"])) < 0.2, np.radians(rng.uniform(-40, 40)), 0.0)
        x, y = data["magnetic_field.x"], data["magnetic_field.y"]
        data["magnetic_field.x"] = np.cos(turn) * x - np.sin(turn) * y
        data["magnetic_field.y"] = np.sin(turn) * x + np.cos(turn) * y
        stream = ArrayStream("/compass", "sensor_msgs/msg/MagneticField", streams["compass"].t_ns, data)
        drive = measure({**streams, "compass": stream}, robot)
        found = evaluate(fuse(drive, robot, ["compass"]), drive)
        odometry = evaluate(fuse(drive, robot, []), drive)
        errors[outliers] = found.figures["heading_rmse_deg"]
        assert (errors[outliers] or math.inf) < 0.5 * (odometry.figures["heading_rmse_deg"] or 0.0)
        assert (found.sensors["compass"].rejected == 0) == (outliers == "inflate")
