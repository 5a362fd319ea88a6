"""Cars: a motor controller, commands of speed and steering, and which of several commands counts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from wheel_bags import custom

import locfuse
from locfuse.fusion.data import LocfuseError

SPEED, RATE = 0.4, 0.2  # m/s, rad/s: a circle of 2 m radius
T = np.arange(0.0, 5.01, 0.1)
CIRCLE = np.stack((2.0 * np.sin(RATE * T), 2.0 * (1.0 - np.cos(RATE * T)), RATE * T), axis=-1)  # closed form
VESC_KIND = "vesc_msgs/msg/VescStateStamped"
VESC_TEXT = (
    f"std_msgs/Header header\nvesc_msgs/VescState state\n{'=' * 80}\nMSG: vesc_msgs/VescState\nfloat64 speed\n"
)
ERPM, WHEELBASE, GAIN, OFFSET = 4614.0, 0.33, -1.2135, 0.5304  # of an F1TENTH car
CAR = {"wheels.erpm_per_mps": ERPM, "wheels.wheelbase": WHEELBASE}
ACKERMANN = "ackermann_msgs/msg/AckermannDrive"
ACKERMANN_TEXT = "".join(
    f"float32 {name}\n" for name in ("steering_angle", "steering_angle_velocity", "speed", "acceleration", "jerk")
)


def final(logs: Sequence[Path], sets: Mapping[str, Any]) -> tuple[NDArray[np.float64], str]:
    """Where the run of a log in several files ends, and its notes."""
    done = locfuse.load(list(logs), sets=sets).run("odometry", advice=False)
    return done.filtered.pose[-1], " ".join(done.notes)


def motor(path: Path) -> Path:
    """A motor controller that measures the speed of the circle."""
    return custom(
        path / "vesc.mcap", "/sensors/core", VESC_KIND, VESC_TEXT, T, [{"state": {"speed": ERPM * SPEED}}] * len(T)
    )


def commands(path: Path, topic: str, speed: float, angle: float = math.atan(RATE * WHEELBASE / SPEED)) -> Path:
    rows = [{"steering_angle": angle, "speed": speed}] * len(T)
    return custom(path / f"{topic.strip('/')}.mcap", topic, ACKERMANN, ACKERMANN_TEXT, T, rows)


def test_a_motor_and_the_steering_beside_it_are_a_motion(tmp_path: Path) -> None:
    """The speed is the measured one; commands say where to, at half the speed that came out."""
    logs = motor(tmp_path), commands(tmp_path, "/drive", SPEED / 2)
    pose, notes = final(logs, CAR)
    assert pose == pytest.approx(CIRCLE[-1], abs=1e-5)
    assert "erpm" not in notes
    _, notes = final(logs, {"wheels.wheelbase": WHEELBASE})
    assert "--set wheels.erpm_per_mps=<erpm> (speed_to_erpm_gain of vesc.yaml)" in notes


def test_the_position_of_a_servo_says_how_a_car_was_steered(tmp_path: Path) -> None:
    rows = [{"data": GAIN * math.atan(RATE * WHEELBASE / SPEED) + OFFSET}] * len(T)
    name = "/commands/servo/position"
    servo = custom(tmp_path / "servo.mcap", name, "std_msgs/msg/Float64", "float64 data\n", T, rows)
    logs = motor(tmp_path), servo
    pose, _ = final(logs, {**CAR, "wheels.servo_gain": GAIN, "wheels.servo_offset": OFFSET})
    assert pose == pytest.approx(CIRCLE[-1], abs=1e-5)
    with pytest.raises(LocfuseError, match=r'sets={"wheels\.servo_gain": <gain>'):
        final(logs, CAR)


def test_a_motor_without_steering_is_refused_in_words(tmp_path: Path) -> None:
    with pytest.raises(LocfuseError, match="no topic says how the car was steered"):
        final([motor(tmp_path)], {**CAR, "wheels.topic": "/sensors/core"})


@pytest.mark.parametrize(("used", "other"), [("/ackermann_cmd", "/drive"), ("/drive", "/teleop")])
def test_of_several_commands_the_one_that_the_base_obeys_is_taken_and_said(
    used: str, other: str, tmp_path: Path
) -> None:
    logs = commands(tmp_path, used, SPEED), commands(tmp_path, other, 2 * SPEED, 0.0)
    pose, notes = final(logs, {"wheels.wheelbase": WHEELBASE})
    assert pose == pytest.approx(CIRCLE[-1], abs=1e-5)
    assert f"of several commands ({other} beside it) the base obeys it" in notes


def test_commands_of_two_robots_are_not_guessed_at(tmp_path: Path) -> None:
    logs = [
        custom(
            tmp_path / f"{n}.mcap", f"/robot{n}/cmd_vel", ACKERMANN, ACKERMANN_TEXT, T, [{"speed": SPEED}] * len(T)
        )
        for n in (1, 2)
    ]
    with pytest.raises(LocfuseError, match="2 topics that fit: /robot1/cmd_vel, /robot2/cmd_vel"):
        final(logs, {"wheels.wheelbase": WHEELBASE})
