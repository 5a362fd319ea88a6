"""Whole drives whose map has a frame of its own: what [start] must not change, and what may turn the map."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace
from rows import matrix_in_map
from worlds import World, instants

from locfuse.fusion.data import Array, Drive, Estimates, Measurements
from locfuse.fusion.ekf.map_frame import InMap
from locfuse.fusion.fuse import Filter, fuse
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.robot import Robot, StartSettings
from locfuse.fusion.whole_drive.smooth import fuse_and_smooth

KNOWN = {"compass": {"offset_deg": math.degrees(0.7)}}
TRUE = (1.5, 1.5, 0.0)


def drive_of(settings: Mapping[str, Any] | None = None, seconds: float = 12.0) -> tuple[Drive, Robot]:
    return World(seconds=seconds, settings=dict(settings or {})).measured()


def begun(robot: Robot, sigma_deg: float, off_deg: float = 0.0, sigma_xy: float = 0.3) -> Robot:
    """The robot with a start that is off by some degrees, and known to this."""
    x, y, _ = TRUE
    start = StartSettings(x=x, y=y, theta_deg=off_deg, sigma_xy=sigma_xy, sigma_theta_deg=sigma_deg)
    return replace(robot, start=start)


def run_of(drive: Drive, robot: Robot, sensors: list[str]) -> Filter:
    run = Filter(robot, sensors)
    assert len(list(instants(run, drive, *sensors))) == len(drive.t)
    return run


@pytest.mark.parametrize("mode", ["first-scan", "refine", "grow"])
def test_the_way_within_the_frame_does_not_depend_on_the_start_bit_for_bit(mode: str) -> None:
    drive, robot = drive_of({"lrf": {"map": mode}}, 6.0)
    runs = [
        run_of(drive, begun(robot, sigma, off), ["lrf"]) for sigma, off in ((2.0, 0.0), (5.0, 40.0), (20.0, -9.0))
    ]
    one, *others = [run.belief for run in runs]
    for other in others:
        assert other.pose() == one.pose()
        np.testing.assert_array_equal(other.matrix(), one.matrix())
    assert runs[0].pose() != runs[1].pose()


def aligned(run: Estimates, drive: Drive) -> float:
    return float(evaluate(run, drive, align="se2").figures["position_rmse_m"] or math.nan)


def test_no_scan_says_where_north_is() -> None:
    """No wall's direction is ever known better than the heading was at the first scan, whatever the laser sees."""
    drive, robot = drive_of()
    robot = begun(robot, 2.0)
    found = fuse(drive, robot, ["lrf"])
    first = drive.instant["lrf"][0]
    heading = math.sqrt(found.triangles[first, 5])
    assert heading > math.radians(2.0)
    for line in found.final_map:
        assert math.sqrt(line.P_map[1, 1]) > 0.999 * heading
        assert math.sqrt(line.P[1, 1]) < 0.3 * heading
    assert (np.sqrt(found.triangles[first:, 5]) > 0.999 * heading).all()


def late(m: Measurements, after: float) -> Measurements:
    return m.take(np.flatnonzero(m.t > after))


def test_a_compass_that_begins_late_turns_the_map_and_bends_nothing() -> None:
    drive, robot = drive_of(KNOWN)
    compass = late(drive.measurements["compass"], 6.0)
    drive = replace(
        drive,
        measurements={**drive.measurements, "compass": compass},
        instant={**drive.instant, "compass": np.searchsorted(drive.t, compass.t)},
    )
    robot = begun(robot, 20.0, 25.0, 0.05)
    alone = fuse(drive, robot, ["lrf"])
    filtered, smoothed = fuse_and_smooth(drive, robot, ["compass", "lrf"])
    assert drive.truth is not None
    for run in (filtered, smoothed):
        judged = evaluate(run, drive)
        assert judged.heading is not None
        assert abs(judged.heading[-1]) < 4.0 * judged.sigma[-1, 2] < math.radians(3.0)
    assert (evaluate(smoothed, drive).figures["anees"] or math.inf) < 2.5
    assert abs(evaluate(alone, drive).deviation[-1]).max() > 0.3
    assert aligned(smoothed, drive) < 1.3 * aligned(alone, drive)
    turned = shape(filtered)[filtered.t > 8.0] - shape(alone)[alone.t > 8.0]
    assert np.abs(turned[:, :2]).max() < 0.01


def shape(run: Estimates) -> Array:
    """Return the poses as seen from the last one, (n, 3)."""
    from locfuse.fusion.se2 import between

    return between(np.broadcast_to(run.pose[-1], run.pose.shape), run.pose)


def test_a_frame_begins_only_with_a_map_of_ones_own() -> None:
    """Neither wheels nor compass alone, nor a laser that only listens, have one."""
    drive, robot = drive_of(KNOWN, 3.0)
    robot = begun(robot, 5.0)
    every = np.ones(len(drive.measurements["lrf"].t), bool)
    listening = Filter(robot, ["compass"], {"lrf": every})
    assert len(list(instants(listening, drive, "compass", "lrf"))) == len(drive.t)
    for run in (run_of(drive, robot, []), run_of(drive, robot, ["compass"]), listening):
        assert not run.belief.framed
    assert run_of(drive, robot, ["lrf"]).belief.framed


def test_a_map_that_is_lost_begins_anew_in_a_frame_of_its_own() -> None:
    drive, robot = drive_of(seconds=6.0)
    robot = begun(robot, 2.0)
    run, lrf = Filter(robot, ["lrf"]), drive.measurements["lrf"]
    belief: Any = None
    for k in instants(run, drive, "lrf"):
        if k == len(drive.t) // 2:  # forget every wall
            belief = run.belief
            lines = run.models["lrf"].map  # type: ignore[attr-defined]
            belief.remove(lines.drop(np.arange(len(lines))))
            before, spread = InMap(belief).pose(), matrix_in_map(belief)
    assert len(lrf.t) > 10
    assert belief.frame_pose()[:2] != TRUE[:2]
    assert math.hypot(belief.frame_pose()[0] - before[0], belief.frame_pose()[1] - before[1]) < 0.1
    assert np.trace(matrix_in_map(belief)[:2, :2]) > np.trace(spread[:2, :2])
    error = np.array(run.pose()) - World(seconds=6.0).pose(drive.t[-1:])[0]
    np.testing.assert_allclose(error / np.sqrt(np.diagonal(matrix_in_map(belief))), 0.0, atol=4.0)
