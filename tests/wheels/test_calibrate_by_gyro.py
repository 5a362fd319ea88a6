"""Track, ratio and noise of the wheels by a gyro alone, against a robot made in closed form."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from bags import real_log
from commands import locfuse, ok, reported

from locfuse.fusion.data import Array, LocfuseError
from locfuse.fusion.wheels.calibrate_by_gyro import calibrate_by_gyro
from locfuse.fusion.wheels.motion import Wheels

TRACK, RATIO, DELAY, BIAS = 0.42, 1.03, 0.3, 0.002
WHITE = 1e-4


def drive(noise: float, seed: int = 0, track: float = 0.3) -> tuple[Wheels, Array, Array]:
    """Wheels told by another track, which slip by `noise` per metre, and a late gyro of the true turns."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 300.0, 0.05)
    speed = 0.5 + 0.2 * np.sin(0.13 * t)
    rate = 0.5 * np.sin(0.31 * t) + 0.3 * np.sin(0.05 * t)
    true = np.stack((speed - 0.5 * TRACK * rate, speed + 0.5 * TRACK * rate), axis=-1)[1:] * 0.05
    share = np.array([2.0 / (1.0 + RATIO), 2.0 * RATIO / (1.0 + RATIO)])
    counted = true / share + rng.normal(0.0, 1.0, true.shape) * np.sqrt(noise * np.abs(true))
    left, right = (np.append(0.0, np.cumsum(side)) for side in counted.T)
    turned = np.append(0.0, np.cumsum((true[:, 1] - true[:, 0]) / TRACK))
    own = turned + BIAS * t + np.append(0.0, np.cumsum(rng.normal(0.0, WHITE * math.sqrt(0.05), len(t) - 1)))
    return Wheels.from_wheels(t, left, right, track, 4e-4), t - DELAY, own


def test_track_and_ratio_are_found_within_what_is_claimed_and_the_noise_at_every_scale() -> None:
    noise = 2e-4
    found = calibrate_by_gyro([drive(noise, seed, 0.36) for seed in (1, 2)], 0.0, WHITE)
    ratio = (2.0 + found.parameters[1]) / (2.0 - found.parameters[1])
    track = 0.36 * (1.0 + found.parameters[2])
    assert found.slides == 0.0
    assert ratio == pytest.approx(RATIO, abs=4.0 * found.sigmas[1])
    assert track == pytest.approx(TRACK, abs=4.0 * 0.3 * found.sigmas[2])
    assert max(found.sigmas[1:]) < 0.01
    assert math.isnan(found.sigmas[0])  # a gyro knows no lengths
    assert found.delay == pytest.approx(DELAY, abs=0.05)
    assert list(found.noise.values())[2:] == pytest.approx([noise] * 3, rel=0.5)


def test_what_both_sides_of_a_skidding_robot_slide_together_is_in_the_noise() -> None:
    """Both wheels slide alike, anything up to twice the mean in 10 s: its error is as claimed, of 20 drives."""
    ratios = []
    for seed in range(20):
        wheels, t, own = drive(1e-6, seed)
        rng = np.random.default_rng(1000 + seed)
        slides = 0.5 * (TRACK - wheels.track)
        turned = np.interp(np.arange(0.0, 300.1, 10.0), t + DELAY, own - BIAS * t)
        slid = float((rng.uniform(-1.0, 1.0, 30) * slides * np.abs(np.diff(turned))).sum())
        found = calibrate_by_gyro([(wheels, t, own)], 0.0, WHITE)
        assert found.slides == pytest.approx(slides, rel=0.1)
        claimed = 0.25 * found.k.value * float(np.abs(wheels.rolled).sum())  # variance of the mean of both wheels
        ratios.append(slid**2 / claimed)
    assert 0.25 < np.mean(ratios) < 2.0  # half: the two wheels of the model slide independently


def test_a_drive_that_hardly_turns_and_one_that_turns_otherwise_are_refused() -> None:
    wheels, t, own = drive(1e-4)
    with pytest.raises(LocfuseError, match="at least 180 degrees"):
        calibrate_by_gyro([(wheels, t, 0.001 * own)], 0.0, WHITE)
    with pytest.raises(LocfuseError, match="of the gyro's turning: is its axis up"):
        calibrate_by_gyro([(wheels, t, -own)], 0.0, WHITE)


def test_a_robot_that_skids_gets_its_track_and_ratio_without_truth(tmp_path: Path) -> None:
    log = real_log("warthog/warthog.mcap")
    sheet = ("--set", "wheels.radius=0.30", "--set", "wheels.track=1.14")
    late = locfuse("calibrate", log, *sheet)
    assert "Set it first: --set gyro.time_offset=0.176" in late.stderr
    told = (*sheet, "--set", "gyro.time_offset=0.176")
    found = ok("calibrate", log, *told, "-o", tmp_path / "robot.toml", "--json")
    values = json.loads(found.stdout)["gyro"]
    assert 1.78 < values["track"]["value"] < 1.92
    assert values["time_offset_s"] == pytest.approx(0.0, abs=0.04)
    truth = ("--set", "truth.topic=/icp_pose", "--align", "origin", "--no-advice")
    words = ("--robot", tmp_path / "robot.toml", "--set", "wheels.radius=0.30", "--sensors", "odometry")
    assert reported("run", log, *words, *truth).rows["odometry"]["position_rmse_m"] < 1.0
    placed = ("--set", "start.theta_deg=-73.1", "--set", "truth.time_offset=-0.07", "--set", "truth.sigma=0.0023")
    odometry = reported("run", log, *words, *truth[:2], *placed, "--no-advice").rows["odometry"]
    assert 0.5 < odometry["anees"] < 2.0
