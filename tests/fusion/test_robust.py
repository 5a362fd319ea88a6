"""Outliers kept with a larger R instead of being refused."""

from __future__ import annotations

import math

import numpy as np
import pytest
from worlds import World

from locfuse.fusion.data import VERDICTS, ArrayStream
from locfuse.fusion.ekf.robust import inflated
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.measure import measure
from locfuse.fusion.sensor import Innovation

GATE = VERDICTS.index("gate")


def innovation(y: float, hph: float, r: float, threshold: float) -> Innovation:
    S = hph + r
    verdict = 0 if y * y / S <= threshold else GATE
    return Innovation(0, verdict, -1, y * y / S, threshold, (y,), (math.sqrt(S),), ((0, 0, 1),), ((r,),))


def test_an_outlier_is_put_exactly_on_its_gate_and_keeps_its_prediction() -> None:
    seen = inflated(innovation(1.0, 0.01, 0.01, 9.0))
    assert seen.verdict == 0
    assert seen.R[0][0] == pytest.approx(1.0 / 9.0 - 0.01)  # y^2 / (H P H' + R) = 9
    assert seen.nis == 9.0
    good = innovation(0.1, 0.01, 0.01, 9.0)
    assert inflated(good) is good


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
