"""Starts and faults that a truth shows: held to drives whose poses are known exactly."""

import math

import numpy as np
import pytest
from msgspec.structs import replace
from present import present
from rows import readings
from small_drive import START, drive, robot

from locfuse.fusion import se2
from locfuse.fusion.checks.start import start_by_path
from locfuse.fusion.checks.tracked_point import Swing, of_yaw
from locfuse.fusion.checks.truth import COPY, MOVED, of_truth, unusable
from locfuse.fusion.data import Array, Truth
from locfuse.fusion.wheels.motion import Wheels

ONCE = 7  # one of so many readings of the truth is kept: about 1.4 Hz


def noisy(truth: Truth, sigma: float, sigma_deg: float) -> Truth:
    """Few readings of a truth, as of AMCL, with white noise [m, deg]."""
    rng, some = np.random.default_rng(4), np.arange(0, len(truth.t), ONCE)
    theta = present(truth.theta)[some] + rng.normal(0.0, math.radians(sigma_deg), len(some))
    return replace(truth, t=truth.t[some], xy=truth.xy[some] + rng.normal(0.0, sigma, (len(some), 2)), theta=theta)


def from_start(truth: Truth, poses: Array, start: Array) -> Array:
    """Exact poses (n, 3), moved rigidly as those of a run that begins at `start`."""
    back = se2.compose(np.broadcast_to(se2.inverse(np.array(START)), poses.shape), poses)
    return se2.compose(np.broadcast_to(start, poses.shape), back)


@pytest.mark.parametrize("exact", [False, True])
def test_the_laser_s_whole_path_shows_the_start_where_first_readings_are_noisy(exact: bool) -> None:
    healthy = drive(18, robot(), laps=2.0)
    truth = present(healthy.truth)
    poses = np.column_stack((truth.xy, present(truth.theta)))[::ONCE]
    x, y, theta = START[0] + 0.3, START[1] - 0.2, START[2] + math.radians(4.0)
    elsewhere = replace(robot(), start=replace(robot().start, x=x, y=y, theta_deg=math.degrees(theta)))
    seen = noisy(truth, *((0.0, 0.0) if exact else (0.03, 1.15)))
    if exact:  # a run that drifts by 0.5 m shows the start worse than an exact truth does
        poses[:, 0] += 0.5 * np.linspace(0.0, 1.0, len(poses)) ** 2
    run = from_start(seen, poses, np.array([x, y, theta]))
    found = start_by_path(seen, run, np.zeros((len(run), 3, 3)), healthy, elsewhere)
    assert (found is None) == exact
    if found is not None:
        x, y, degrees = (float(fix.partition("=")[2]) for fix in found.fixes)
        assert (x, y) == pytest.approx(START[:2], abs=0.02)
        assert degrees == pytest.approx(math.degrees(START[2]), abs=0.4)
        larger = np.column_stack((1.1 * run[:, :2], run[:, 2]))  # a laser whose ranges are long shows no start
        assert start_by_path(seen, larger, np.zeros((len(run), 3, 3)), healthy, elsewhere) is None


@pytest.mark.parametrize(
    ("size_deg", "away_m", "how"), [(45.0, 2.0, "turns by 4"), (8.0, 0.0, ""), (0.0, 0.5, "moves"), (0.0, 0.1, "")]
)
def test_a_truth_whose_frame_moves_once_while_the_wheels_and_the_laser_agree(
    size_deg: float, away_m: float, how: str
) -> None:
    """AMCL that was started at a wrong pose and found its place at 20 s, within 2 s.

    The wheels of this drive slip by up to 10 degrees and 7 cm in 6 s, so 8 degrees are not named.
    """
    healthy = drive(18, robot(), laps=2.0)
    truth = present(healthy.truth)
    wrong = 1.0 / (1.0 + np.exp(2.0 * (truth.t - 20.0)))
    theta = present(truth.theta) + math.radians(size_deg) * wrong
    moved = replace(truth, theta=theta, xy=truth.xy + np.outer(wrong, away_m * np.array((0.8, -0.6))))
    found = of_truth(replace(healthy, truth=moved), robot())
    assert (MOVED in {f.code for f in found}) == bool(how)
    if how:
        (one,) = (f for f in found if f.code == MOVED)
        assert f"its frame {how}" in one.message
        begin, end, *_ = (int(word) for word in one.message.split() if word.isdigit())
        assert begin < 20 < end <= begin + 8
        assert "start" not in {f.code for f in found}


def test_a_marker_off_the_axle_moves_no_frame_where_the_robot_turns_on_the_spot() -> None:
    """There and back, with one turn on the spot between: the marker then moves aside by 0.3 m."""
    t = np.arange(0.0, 45.0, 0.05)
    spins, rng = (t[1:] > 20.0) & (t[1:] < 25.0), np.random.default_rng(3)
    step = np.column_stack((0.015 * ~spins, 0.0 * spins, math.radians(1.8) * spins))
    pose = se2.chain(step)
    slipping = step + rng.normal(0.0, 1e-3, step.shape) * np.array([1.0, 0.0, 1.0])
    wheels = Wheels.from_twists(t, slipping, 0.3, 4e-4)
    marker = pose[:, :2] + se2.rotated(pose[:, 2], np.tile([0.1, 0.03], (len(t), 1)))
    seen = {"compass": readings(t, pose[:, 2:], 0.01)}
    truth = replace(present(drive(18, robot()).truth), t=t, xy=marker, theta=pose[:, 2])
    one = replace(drive(18, robot()), wheels=wheels, measurements=seen, truth=truth)
    assert MOVED not in {f.code for f in of_truth(one, robot())}
    shifted = replace(truth, xy=marker + np.outer(np.clip(0.5 * (t - 33.0), 0.0, 1.0), [0.3, 0.4]))
    assert MOVED in {f.code for f in of_truth(replace(one, truth=shifted), robot())}


def test_a_truth_that_is_made_of_the_wheels_judges_nothing() -> None:
    healthy = drive(18, robot(), laps=2.0)
    truth, wheels = present(healthy.truth), healthy.wheels
    assert unusable(healthy) is None
    pose = wheels.at(np.clip(truth.t, wheels.t[0], wheels.t[-1]))[2]
    moved = se2.compose(np.broadcast_to([3.0, -1.0, 0.7], pose.shape), pose)
    xy = moved[:, :2] + np.random.default_rng(2).normal(0.0, 5e-4, truth.xy.shape)
    copied = replace(truth, topic="/odometry/filtered", xy=xy, theta=moved[:, 2])
    assert present(unusable(replace(healthy, truth=copied))).code == COPY
    assert unusable(replace(healthy, truth=replace(copied, topic="/ground_truth"))) is None  # of a simulator


def test_a_truth_that_stays_on_the_spot_shows_no_yaw_of_its_body() -> None:
    """The wheels of a robot that turns on the spot slip by centimetres, in any direction."""
    sigma = np.full(4, 1e-3)
    assert of_yaw(Swing(np.array([0.0, 0.0, 0.7, 0.7]), sigma), robot()) != []
    assert of_yaw(Swing(np.array([0.0, 0.0, 0.01, 0.01]), sigma), robot()) == []
