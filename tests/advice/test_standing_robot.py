"""A robot that stands still for a whole log: nothing can be judged, and that is said instead of figures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import Said, cdr, header
from commands import locfuse
from rooms import ARENA, scan
from wheel_bags import log_of, odometry, stamps

import locfuse as product
from locfuse.fusion.data import UsageError

SCAN, IMU = "sensor_msgs/msg/LaserScan", "sensor_msgs/msg/Imu"
T = np.arange(0.0, 6.01, 0.1)
ANGLES = np.radians(np.arange(-180.0, 180.0, 1.0))
SAID = "the robot does not move in this log, so no sensor can be judged"


def standing(path: Path) -> Path:
    """A robot in the middle of a room whose odometry is zero to the bit, with a laser and an IMU."""
    rng = np.random.default_rng(4)
    ranges = scan(ARENA, np.array([1.0, 1.0, 0.0]), ANGLES)
    said: list[Said] = []
    for ns in stamps(T):
        values = ranges + 0.01 * rng.normal(size=len(ANGLES))
        beams: dict[str, Any] = {
            "angle_min": ANGLES[0],
            "angle_increment": ANGLES[1] - ANGLES[0],
            "range_max": 10.0,
        }
        said.append(Said("/scan", SCAN, cdr(SCAN, header=header(ns, "laser"), ranges=values, **beams), ns))
        turn = 0.001 * rng.normal()
        sensed: dict[str, Any] = {
            "orientation": {"z": np.sin(turn / 2), "w": np.cos(turn / 2)},
            "angular_velocity": {"x": 0.0, "y": 0.0, "z": 0.002 * rng.normal()},
            "linear_acceleration": {"z": 9.81},
        }
        said.append(Said("/imu", IMU, cdr(IMU, header=header(ns, "imu"), **sensed), ns))
    return log_of(path, odometry(T, np.zeros((len(T), 3))), said)


def test_compare_and_info_say_that_it_does_not_move_and_offer_no_fix(tmp_path: Path) -> None:
    log = standing(tmp_path / "x.mcap")
    done = locfuse("compare", log, "-o", tmp_path / "out", "--write", "json")
    assert done.exit_code == 0, done.stderr
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["headline"] == f"T{SAID[1:]}."
    assert not report["findings"]
    assert report["reference"] is None
    assert {v["verdict"] for v in report["verdicts"].values()} <= {"no effect seen", "no verdict"}
    assert SAID in " ".join(locfuse("info", log).stdout.split())


def test_its_whole_drive_is_no_reference(tmp_path: Path) -> None:
    log = product.load(standing(tmp_path / "x.mcap"))
    with pytest.raises(UsageError, match="does not move"):
        log.compare(reference=True)
