"""An IMU is bolted to the robot once: what turns its gyro turns its compass."""

from __future__ import annotations

from pathlib import Path

from trap_logs import COMPASS, Drive
from traps_sensors import ROLLED, imu

import locfuse as api


def written(folder: Path) -> Path:
    drive = Drive()
    imu(drive, ROLLED, orientation=True)
    drive.drop(COMPASS)
    del drive.tables["compass"]
    return drive.record(folder / "imu.mcap")


def test_roll_and_pitch_given_for_one_hold_for_the_other(tmp_path: Path) -> None:
    log = written(tmp_path)
    for given, other in (("gyro", "compass"), ("compass", "gyro")):
        robot = api.load(log, sets={f"{given}.roll_deg": 90.0}).robot
        assert robot.settings(other).roll_deg == 90.0
    robot = api.load(log, sets={"gyro.roll_deg": 90.0, "compass.roll_deg": 5.0}).robot
    assert (robot.settings("gyro").roll_deg, robot.settings("compass").roll_deg) == (90.0, 5.0)


def test_sensors_of_other_frames_keep_their_own(tmp_path: Path) -> None:
    drive = Drive()
    imu(drive, ROLLED, orientation=False)
    log = drive.record(tmp_path / "apart.mcap")
    robot = api.load(log, sets={"gyro.roll_deg": 90.0}).robot
    assert robot.settings("compass").roll_deg == 0.0
