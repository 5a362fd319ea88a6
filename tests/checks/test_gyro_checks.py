"""What a gyro's rates say of its bias, noise, range and stuck values, held to drives whose answer is known."""

import math
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace
from present import present
from small_drive import drive, path, robot

from locfuse.fusion.checks.finding import Least
from locfuse.fusion.checks.gyro import of_gyro, of_rest_noise, of_saturation
from locfuse.fusion.checks.turning import and_truth, turnings
from locfuse.fusion.data import Array, ArrayStream, Drive
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.compass import Compass, CompassSettings
from locfuse.fusion.sensors.gyro import Gyro, GyroSettings

RATE = 20.0  # Hz


def rates() -> tuple[Array, Array]:
    """Times (n,) [s] and turning rates (n,) [rad/s] of the robot."""
    t, pose = path(1.0)
    at = np.arange(0.0, t[-1] - 0.2, 1.0 / RATE)
    return at, (np.interp(at + 0.1, t, pose[:, 2]) - np.interp(at, t, pose[:, 2])) / 0.1


def stream_of(t: Array, rate: Array) -> ArrayStream:
    """The rates as bare numbers on a topic."""
    return ArrayStream("/yaw_rate", "std_msgs/msg/Float64", np.round(t * 1e9).astype(np.int64), {"data": rate})


def measured(rate: Array, **settings: Any) -> tuple[Drive, Robot, ArrayStream]:
    """A drive with these rates of a gyro, its robot, and the stream of the gyro."""
    one, t = replace(drive(5, robot()), epoch_ns=0), rates()[0]
    stream, own = stream_of(t, rate), GyroSettings(**settings)
    m = Gyro().measure(stream, own, one.wheels, 0)
    return replace(one, measurements={"gyro": m}), replace(robot(), sensors={"gyro": own}), stream


def test_a_truth_that_does_not_turn_shows_no_scale() -> None:
    one, settings, _ = measured(rates()[1])
    truth = present(one.truth)
    still = replace(one, truth=replace(truth, theta=np.zeros(len(truth.t))))
    assert "gyro scale" not in {f.code for f in of_gyro(still, settings, turnings(still))}


@pytest.mark.parametrize("moves", [False, True])
def test_a_bias_that_moves_is_found_and_a_constant_one_is_not(moves: bool) -> None:
    t, rate = rates()
    rate += 1e-3 * np.random.default_rng(1).normal(size=len(t))
    wrong = rate + math.radians(1.0) + (math.radians(3.0) * (t > 25.0) if moves else 0.0)
    one, settings, _ = measured(wrong)
    found = of_gyro(one, settings, and_truth(one, turnings(one)))
    assert [f.code for f in found] == (["gyro bias"] if moves else [])
    fits = and_truth(one, turnings(one))
    tried = [f.fixes for f in of_gyro(one, settings, fits, Least(0.005, 2.0))]
    key, _, value = tried[0][0].partition("=")
    assert key == ("gyro.bias_drift_deg" if moves else "gyro.bias_deg")
    assert moves or float(value) == pytest.approx(1.0, abs=0.02)
    if moves:
        assert "its bias moves by 3 degrees/s" in found[0].message
        assert 0.1 < float(found[0].fixes[0].removeprefix("gyro.bias_drift_deg=")) < 1.0


def test_scans_without_lines_in_a_turn_are_no_moving_bias() -> None:
    """As when people hide the walls: the laser's heading then stands still while the robot turns."""
    one, settings, _ = measured(rates()[1] + 1e-3 * np.random.default_rng(1).normal(size=len(rates()[0])))
    m = drive(5, robot(), ("lrf",)).measurements["lrf"]
    seen = np.repeat((m.t < 14.2) | (m.t > 15.2), np.diff(m.first))
    first = np.concatenate(([0], np.cumsum(seen)))[m.first]
    ends = {"ends": m.extra["ends"][seen]}
    hidden = replace(m, first=first, z=m.z[seen], R_unit=m.R_unit[seen], extra=ends)
    one = replace(one, truth=None, measurements={**one.measurements, "lrf": hidden})
    assert {"lrf", "gyro"} <= set(turnings(one))
    assert of_gyro(one, settings, turnings(one)) == []


@pytest.mark.parametrize("stands", [False, True])
@pytest.mark.parametrize("given", [-0.3, 0.3])
def test_a_bias_that_is_set_wrong_is_named_at_standstill_or_by_headings(stands: bool, given: float) -> None:
    t, rate = rates()
    noise = 1e-3 * np.random.default_rng(1).normal(size=len(t))
    one, settings, _ = measured((not stands) * rate + noise + math.radians(0.3), bias_deg=given)
    if stands:
        wheels = one.wheels.rerolled(0.0 * one.wheels.rolled, one.wheels.track)
        m = Gyro().measure(stream_of(t, noise + math.radians(0.3)), GyroSettings(bias_deg=given), wheels, 0)
        one = replace(one, wheels=wheels, truth=None, measurements={"gyro": m})
    found = of_gyro(one, settings, and_truth(one, turnings(one)))
    assert [float(f.fixes[0].removeprefix("gyro.bias_deg=")) for f in found] == (
        [] if given > 0.0 else [pytest.approx(0.3, abs=0.02)]
    )
    assert all(("at standstill" in f.message) == stands for f in found)


@pytest.mark.parametrize("largest", [0.2, 10.0])
def test_rates_beyond_the_range_are_named(largest: float) -> None:
    _, rate = rates()
    noisy = rate + 0.002 * np.random.default_rng(1).normal(size=len(rate))
    one, settings, stream = measured(np.clip(noisy, -largest, largest))
    found = of_saturation(one, settings, {"gyro": stream})
    assert len(found) == (largest < 1.0)
    assert all("are 0.2 rad/s, the largest, while the wheels turn faster" in f.message for f in found)


@pytest.mark.parametrize("sigma", [0.0005, 0.1])
def test_noise_at_standstill_is_found(sigma: float) -> None:
    t, _ = rates()
    one, settings, _ = measured(np.random.default_rng(1).normal(size=len(t)) * sigma)
    stands = replace(one, wheels=one.wheels.rerolled(0.0 * one.wheels.rolled, one.wheels.track))
    found = of_rest_noise(stands, settings)
    expected = math.degrees(sigma) / math.sqrt(RATE)
    found_deg = [float(f.fixes[0].removeprefix("gyro.sigma_deg=")) for f in found]
    assert found_deg == ([pytest.approx(expected, rel=0.25)] if expected > 0.15 else [])
    assert of_rest_noise(one, settings) == []  # the wheels roll all the time


@pytest.mark.parametrize("begin", [5.0, 20.0])
def test_rates_and_headings_that_are_stuck_in_turns_are_left_out(begin: float) -> None:
    t, rate = rates()
    one = drive(5, robot())
    held = (t >= begin) & (t < begin + 12.0)
    rate += 1e-4 * np.random.default_rng(1).normal(size=len(t))
    m = Gyro().measure(stream_of(t, np.where(held, rate[held][0], rate)), GyroSettings(), one.wheels, 0)
    assert m.dropped == {"stuck": int(held.sum())}
    heading = one.wheels.heading(t) + 1e-3 * np.random.default_rng(2).normal(size=len(t))
    compass = stream_of(t, np.where(held, heading[held][0], heading))
    said = Compass().measure(compass, CompassSettings(), one.wheels, 0)
    assert said.dropped == {"stuck": int(held.sum())}
    assert Compass().measure(stream_of(t, heading), CompassSettings(), one.wheels, 0).dropped == {}
