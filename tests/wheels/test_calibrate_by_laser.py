"""Wheels and laser mount from wheels and laser alone: drawn motions whose truth is known, and the simulator."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from commands import locfuse, ok, refused
from wheel_bags import GEOMETRY, angles, joint_states, log_of

from locfuse.fusion import se2
from locfuse.fusion.data import Array, LocfuseError
from locfuse.fusion.wheels.calibrate_by_scans import NAMES, LaserCalibration, ScanMotions, calibrate, first_guess
from locfuse.fusion.wheels.calibrate_by_scans import Intervals as Pieces
from locfuse.fusion.wheels.motion import Wheels

TRACK, K, DT = 0.5, 4e-4, 0.05
MOUNT = np.array([0.18, -0.07, math.radians(70.0)])
MATCH = np.array([0.003, 0.003, math.radians(0.15)])  # noise of one match
WRONG = (0.04, -0.03, 0.08)  # of the left radius, the right one, the track: what the wheels are computed with
LATE = 0.12  # s that the laser's stamps are late


def drive(seed: int, turns: bool = True, straight: bool = True, seconds: float = 90.0) -> ScanMotions:
    """A drive that speeds up, slows down and turns both ways, as wrong wheels and a late laser tell it."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, DT)
    speed = (0.35 + 0.15 * np.sin(t / 1.7)) * straight
    rate = (0.5 * np.sin(t / 3.1) + 0.3 * np.sin(t / 1.3)) * turns
    ds, turn = speed[:-1] * DT, rate[:-1] * DT
    pose = Wheels.from_twists(t, np.stack((ds, 0.0 * ds, turn), axis=-1), TRACK, K).pose
    sides = np.stack((ds - 0.5 * TRACK * turn, ds + 0.5 * TRACK * turn), axis=-1)
    sides += np.sqrt(K * np.abs(sides)) * rng.normal(size=sides.shape)
    left, right = (np.append(0.0, np.cumsum(side)) for side in (sides / (1.0 + np.array(WRONG[:2]))).T)
    wheels = Wheels.from_wheels(t, left, right, TRACK / (1.0 + WRONG[2]), K)
    seen = se2.compose(pose[::4], np.broadcast_to(MOUNT, pose[::4].shape))
    steps = se2.between(seen[:-1], seen[1:]) + MATCH * rng.normal(size=(len(seen) - 1, 3))
    P = np.broadcast_to(np.diag(MATCH**2), (len(steps), 3, 3))
    return ScanMotions(wheels, Wheels.from_matches(t[::4] + LATE, se2.log(steps), P, TRACK, K), 0.0)


def true() -> Array:
    left, right, track = WRONG
    return np.array([0.5 * (left + right), right - left, track, *MOUNT, -LATE])


def test_all_parameters_are_found_and_their_sigmas_are_right() -> None:
    """Six drives: no parameter further off than three sigma, and none whose sigma is idle talk."""
    found = [calibrate([drive(seed)]) for seed in range(6)]
    z = np.array([(one.parameters - true()) / one.sigmas for one in found])
    assert np.isfinite(z).all()
    assert np.abs(z).max() < 3.0
    sigmas = np.mean([one.sigmas for one in found], axis=0)
    assert (sigmas < (0.01, 0.01, 0.02, 0.03, 0.03, 0.02, 0.03)).all()
    assert found[0].noise == pytest.approx(K, rel=0.5)


def test_the_closed_form_alone_comes_near_from_nothing() -> None:
    """The mount is turned by 70 degrees and the laser is late: no guess is asked for."""
    p = first_guess([Pieces.of(drive(0))])
    assert np.abs(p - true())[[0, 2, 3, 4, 5]] == pytest.approx(0.0, abs=0.06)
    assert p[6] == pytest.approx(-LATE, abs=0.06)


def test_several_drives_tell_more_than_one() -> None:
    one, three = calibrate([drive(0)]), calibrate([drive(seed) for seed in range(3)])
    assert three.intervals > 2.5 * one.intervals
    assert (three.sigmas <= one.sigmas).all()


@pytest.mark.parametrize(
    ("turns", "straight", "undetermined"),
    [(False, True, {"track", "x", "y"}), (True, False, {"scale", "difference", "track", "yaw"})],
)
def test_what_a_drive_does_not_tell_is_said(turns: bool, straight: bool, undetermined: set[str]) -> None:
    """Straight on nothing says where the laser sits; on the spot nothing says how far a wheel rolls."""
    found = calibrate([drive(0, turns, straight)])
    assert undetermined <= set(found.undetermined()) | _vague(found)


def _vague(found: LaserCalibration) -> set[str]:
    """Names whose sigma is larger than ten times what a drive with both leaves."""
    both = calibrate([drive(0)]).sigmas
    return {name for name, s, b in zip(NAMES, found.sigmas, both, strict=True) if s > 10.0 * b}


def test_slips_and_wrong_matches_are_left_out() -> None:
    motion = drive(1)
    twist = motion.laser.twist.copy()
    twist[50] += (0.5, 0.3, 0.6)
    assert motion.laser.matched is not None
    wrong = Wheels.from_matches(motion.laser.t, twist, motion.laser.matched, TRACK, K)
    found = calibrate([motion._replace(laser=wrong)])
    assert found.outliers >= 1
    assert np.abs((found.parameters - true()) / found.sigmas).max() < 3.0


def test_wheels_in_another_unit_and_a_short_drive_are_refused_in_words() -> None:
    motion = drive(0)
    far = Wheels.from_twists(motion.wheels.t, motion.wheels.twist * (57.3, 57.3, 1.0), TRACK, K)
    with pytest.raises(LocfuseError, match=r"goes 0\.0\d+ times as far as by the wheels"):
        calibrate([motion._replace(wheels=far)])
    with pytest.raises(LocfuseError, match="at least 12"):
        calibrate([drive(0, seconds=4.0)])


LEGS = (
    "{turn_deg=80, speed=0.25}, {forward=2.0, speed=0.4}, {turn_deg=-120, speed=0.3}, {forward=1.5},"
    "{turn_deg=-170, speed=0.3}, {forward=2.5, speed=0.5}, {turn_deg=200, speed=0.3}, {forward=1.5}"
)


def test_the_command_finds_wheels_and_mount_of_a_simulated_robot(tmp_path: Path) -> None:
    """Configured 4 cm too long wheels, 8 % too narrow, and a laser at the middle: without truth all is found."""
    log, robot = tmp_path / "x.mcap", tmp_path / "robot.toml"
    path = f'path={{kind="legs", x=3.2, y=2.4, theta_deg=60.0, legs=[{LEGS}]}}'
    sets = (path, "control.estimator=truth", "compass.enabled=false", "camera.enabled=false", "lrf.rate=5")
    words = [word for one in sets for word in ("--set", one)]
    assert locfuse("simulate", "rounded_rectangle", *words, "--seed", "1", "-o", log).exit_code == 0
    wrong = ("wheels.radius=0.052", "wheels.track=0.55", "lrf.x=0", "truth.topic=none")
    words = [word for one in wrong for word in ("--set", one)]
    done = ok("calibrate", log, *words, "-o", robot, "--json")
    found = json.loads(done.stdout)["laser"]
    for key, value in {"radius": 0.05, "ratio": 1.0, "track": 0.6, "x": 0.2, "y": 0.0, "yaw_deg": 0.0}.items():
        sigma = (found[key]["high"] - found[key]["low"]) / (2.0 * 1.96)
        assert abs(found[key]["value"] - value) < 3.0 * sigma, key
    assert (found["x"]["high"] - found["x"]["low"]) < 0.1
    text = robot.read_text()
    assert "track = " in text
    assert "x = 0.1" in text or "x = 0.2" in text
    assert "the laser's metre is taken for the right one" in done.stderr


def test_a_log_without_a_laser_says_what_is_missing(tmp_path: Path) -> None:
    log = log_of(tmp_path / "x.mcap", joint_states(*angles(5.0)))
    assert "no wheels and laser together in x" in refused("calibrate", log, *GEOMETRY)
