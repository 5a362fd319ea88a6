"""A log with a laser and nothing else: the motion comes from its scans, and P says where they say nothing."""

import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import real_log, write
from commands import locfuse, ok, reported
from laser_room import PERIOD, ROOM, circle, ranges_of, scan_stream, scans_of
from msgspec.structs import replace
from present import present
from ring_drive import box
from wheel_bags import stamps

import locfuse as locfuse_api
from locfuse.fusion import se2
from locfuse.fusion.data import Array, ArrayStream, LocfuseError, Stream
from locfuse.fusion.lines.scans import Laser
from locfuse.fusion.robot import WheelSettings
from locfuse.fusion.sensors.lrf import LrfSettings, laser_of
from locfuse.fusion.wheels.motion import Wheels
from locfuse.fusion.wheels.motion_by_scans import (
    DECAY_S,
    USUAL_VARIANCES,
    ThinnedScans,
    Velocity,
    constrained,
    initial_velocity,
    match_scans,
    read_scans,
)
from locfuse.fusion.wheels.read import WheelReading, read_wheels

CORRIDOR = np.array([(-90.0, -1.0, 90.0, -1.0), (-90.0, 1.0, 90.0, 1.0)])


def stream_of(t: Array, poses: Array, segments: Array) -> ArrayStream:
    rng = np.random.default_rng(3)
    return scan_stream(stamps(t), np.stack([ranges_of(pose, segments, rng) for pose in poses]))


def moved(t: Array, poses: Array, segments: Array, **lrf: Any) -> WheelReading:
    found = match_scans(stream_of(t, poses, segments), laser_of(LrfSettings(**lrf)))
    return found.reading(WheelSettings(), 0.0)


@cache
def in_the_room() -> WheelReading:
    return moved(*circle(), ROOM)


def test_sweeps_whose_lengths_are_nonsense_leave_times_in_order() -> None:
    t, truth = circle(4.0)
    stream = stream_of(t, truth, ROOM)
    lies = np.where(np.arange(len(t)) % 7 == 3, np.nan, np.where(np.arange(len(t)) % 5 == 2, 1.0, 1e-4))
    data = {**stream.data, "time_increment": lies}
    found = match_scans(replace(stream, data=data), laser_of(LrfSettings())).reading(WheelSettings(), 0.0)
    assert (np.diff(found.wheels.t) > 0.0).all()
    assert np.isfinite(found.wheels.pose).all()


def test_a_circle_in_a_room_is_found_by_the_scans_alone() -> None:
    _, truth = circle()
    pose = in_the_room().wheels.pose
    assert np.hypot(*(pose - truth)[:, :2].T).max() < 0.08  # m, of 10 m
    assert np.degrees(np.abs(pose - truth)[:, 2].max()) < 1.5


@pytest.mark.parametrize("rate", [10.0, 40.0])
def test_a_scanner_of_any_rate_follows_a_robot_that_speeds_up_and_brakes(rate: float) -> None:
    """To and fro at up to 1.5 m/s and 3 m/s^2, turning: 40 scans a second move less than a match errs."""
    t = np.arange(0.0, 5.0, 1.0 / rate)
    truth = np.stack((0.75 * (1.0 - np.cos(2.0 * t)), 0.0 * t, 0.3 * np.sin(1.5 * t)), axis=-1)
    pose = moved(t, truth, ROOM).wheels.pose
    assert np.hypot(*(pose - truth)[:, :2].T).max() < 0.05  # m, of 5 m
    assert np.degrees(np.abs(pose - truth)[:, 2].max()) < 1.0


def test_its_covariance_covers_the_error() -> None:
    t, truth = circle()
    wheels = in_the_room().wheels
    after = np.arange(5, len(t))
    start = np.zeros(len(after), dtype=int)
    motions = [wheels.between(t[[0]], t[[k]]) for k in after.tolist()]
    error = np.concatenate([m.u for m in motions]) - se2.between(truth[start], truth[after])
    nees = [float(e @ np.linalg.solve(m.Q[0], e)) / 3.0 for e, m in zip(error, motions, strict=True)]
    assert np.mean(nees) < 1.5


def test_where_the_laser_sits_is_taken_into_account() -> None:
    """The base turns on the spot while a laser half a metre ahead of it swings."""
    t = np.arange(0.0, 8.0, PERIOD)
    base = np.stack((0 * t, 0 * t, 0.3 * t), axis=-1)
    laser = se2.compose(base, np.broadcast_to(np.array([0.5, 0.0, 0.7]), base.shape))
    pose = moved(t, laser, ROOM, x=0.5, yaw_deg=np.degrees(0.7)).wheels.pose
    np.testing.assert_allclose(pose[-1], base[-1], atol=0.04)


def test_along_a_corridor_p_says_that_nobody_knows_how_far_it_went() -> None:
    """Boxes show its speed at first; then it drives on where nothing but two walls is in sight."""
    boxes = np.array(box(-1.0, 0.5, 0.2, 1.0) + box(1.2, -1.0, 2.0, -0.6))
    t = np.arange(0.0, 24.0, PERIOD)
    truth = np.stack((0.8 * t - 5.0, 0 * t, 0 * t), axis=-1)
    wheels = moved(t, truth, np.concatenate((CORRIDOR, boxes))).wheels
    inside = t > 19.0
    assert wheels.matched is not None
    along, across = (np.sqrt(wheels.matched[inside[1:], i, i].mean()) for i in (0, 1))
    assert along > 4.0 * across
    end = wheels.between(t[[0]], t[[-1]])
    assert abs(wheels.pose[-1, 0] - 0.8 * t[-1]) < 3.0 * np.sqrt(end.Q[0, 0, 0])
    assert np.abs(wheels.pose[:, 1]).max() < 0.1


def test_a_velocity_goes_on_where_nothing_corrects_it_and_its_error_adds_up() -> None:
    """Against the closed form of an exponentially correlated speed: 2 sigma^2 tau T for T many tau."""
    known, dt, total = Velocity(np.array([0.4, 0.0, 0.0]), np.diag(USUAL_VARIANCES)), 0.1, 0.0
    after = known.after(1.0)
    assert after.v[0] == pytest.approx(0.4 * np.exp(-1.0 / DECAY_S[0]))
    for _ in range(1000):
        before = known.after(dt)
        known = before.corrected(dt, np.zeros(3), np.zeros((3, 3)))
        total += known.spread(before, dt)[0, 0]
    assert total == pytest.approx(2.0 * USUAL_VARIANCES[0] * DECAY_S[0] * 100.0, rel=0.01)


def test_a_velocity_that_every_pair_measures_errs_independently() -> None:
    before = initial_velocity().after(0.1)
    H = np.diag([1e6, 1e6, 1e6])
    now = before.corrected(0.1, np.array([0.05, 0.0, 0.01]), H)
    np.testing.assert_allclose(now.v * 0.1, [0.05, 0.0, 0.01], atol=1e-4)
    np.testing.assert_allclose(now.spread(before, 0.1), np.linalg.inv(H), rtol=0.02, atol=1e-12)


def test_information_along_parallel_walls_is_none_and_that_across_stays() -> None:
    H = np.array([[[3.0, 0.0, 1.0], [0.0, 5000.0, 200.0], [1.0, 200.0, 900.0]]])
    kept = constrained(H)[0]
    np.testing.assert_allclose(kept[0], 0.0, atol=0.5)  # by the direction's own lean
    assert kept[1, 1] == pytest.approx(5000.0, rel=1e-3)
    full = np.array([np.diag([4000.0, 5000.0, 900.0])])
    np.testing.assert_array_equal(constrained(full), full)


def test_the_covariance_of_matches_adds_up_as_a_textbook_adds_it() -> None:
    """First-order propagation step by step, with derivatives by finite differences."""
    rng = np.random.default_rng(0)
    twist = np.column_stack((rng.uniform(0.05, 0.2, 6), rng.normal(0, 0.02, 6), rng.normal(0, 0.2, 6)))
    roots = 0.02 * rng.normal(size=(6, 3, 3))
    P = roots @ roots.transpose(0, 2, 1)
    wheels = Wheels.from_matches(np.arange(7.0), twist, P, 0.3, 4e-4)
    total, eps = np.zeros((3, 3)), 1e-6
    for k in range(6):
        rest = se2.between(wheels.pose[k + 1], wheels.pose[6])
        J = np.empty((3, 3))
        for i in range(3):
            step = twist[k].copy()
            step[i] += eps
            there = se2.compose(se2.compose(wheels.pose[k], se2.exp(step)), rest)
            J[:, i] = (there - wheels.pose[6]) / eps
        total += J @ P[k] @ J.T
    # a twist's noise is taken at the middle of its step: right to second order of the turn
    Q = wheels.between(np.zeros(1), np.array([6.0])).Q[0]
    assert np.linalg.norm(Q - total) < 0.01 * np.linalg.norm(total)


def test_noise_scales_the_covariance() -> None:
    t, truth = circle(6.0)
    found = match_scans(stream_of(t, truth, ROOM), laser_of(LrfSettings()))
    once, four = (present(found.reading(WheelSettings(noise=n), 0.0).wheels.matched) for n in (4e-4, 16e-4))
    np.testing.assert_allclose(four, 4.0 * once)


def test_scans_of_nothing_of_one_stamp_or_unmatched_are_one_line() -> None:
    t, truth = circle(4.0)
    with pytest.raises(LocfuseError, match="no scan of /scan sees enough"):
        moved(t, truth, np.array([(90.0, 0.0, 91.0, 0.0)]))
    t, truth = circle(1.0)
    with pytest.raises(LocfuseError, match="the 5 scans of /scan have one stamp"):
        moved(np.zeros_like(t), truth, ROOM)
    with pytest.raises(LocfuseError, match="has to be matched first"):
        read_wheels(stream_of(*circle(1.0), ROOM), WheelSettings())


def test_two_scans_of_one_stamp_are_one_instant() -> None:
    t, truth = circle()
    way = moved(np.insert(t, 20, t[20]), np.insert(truth, 20, truth[20], axis=0), ROOM).wheels
    np.testing.assert_array_equal(way.t, in_the_room().wheels.t)
    np.testing.assert_allclose(way.pose[-1], in_the_room().wheels.pose[-1], atol=0.02)


# ---- as a user meets it ----


def laser_bag(path: Path) -> Path:
    return write(path, scans_of(*circle(8.0)))


def test_info_init_and_compare_take_a_log_with_a_laser_and_nothing_else(tmp_path: Path) -> None:
    log = laser_bag(tmp_path / "laser.mcap")
    info = locfuse("info", log, "--json")
    known = json.loads(info.stdout)
    assert known["roles"]["wheels"]["topics"] == ["/scan"]
    assert "matched with each other" in known["roles"]["wheels"]["why"]
    assert known["roles"]["lrf"]["topics"] == ["/scan"]
    robot = tmp_path / "robot.toml"
    written = ok("init", log)
    robot.write_text(written.stdout)
    done = ok("compare", log, "-v", "--no-advice", "--robot", robot, "-o", tmp_path / "out", "--write", "json,tum")
    assert "the motion is matched from scan to scan of /scan" in done.stderr
    _, truth = circle(8.0)
    for name in ("scan matching", "lrf"):
        end = np.loadtxt(tmp_path / "out" / f"{name}.tum")[-1, 1:3]
        assert np.hypot(*(end - truth[-1, :2])) < 0.05


def test_one_sensor_alone_moves_as_in_a_comparison(tmp_path: Path) -> None:
    """`run` leaves the laser out as a sensor: where it sits counts all the same."""
    log = laser_bag(tmp_path / "laser.mcap")
    mount = ("--set", "lrf.x=0.3")
    recording = ("--rerun-save", tmp_path / "x.rrd")
    ok("run", log, "--no-advice", "--sensors", "odometry", "-o", tmp_path / "one", *mount, *recording)
    ok("compare", log, "--no-advice", "-o", tmp_path / "all", "--write", "tum", *mount)
    assert (tmp_path / "x.rrd").stat().st_size > 10_000
    a, b = (np.loadtxt(f)[-1] for f in (tmp_path / "one/trajectory.tum", tmp_path / "all/scan matching.tum"))
    np.testing.assert_allclose(a, b, atol=1e-9)


def test_another_clock_of_the_laser_moves_all_sensors_with_it(tmp_path: Path) -> None:
    """The drive begins at the first scan: what was measured before must not keep the old beginning."""
    session = locfuse_api.load(laser_bag(tmp_path / "laser.mcap"))
    later = session.with_settings(["lrf.time_offset=0.5", "lrf.x=0.1"])
    assert later.drive.epoch_ns - session.drive.epoch_ns == 500_000_000
    np.testing.assert_allclose(later.drive.measurements["lrf"].t, session.drive.measurements["lrf"].t, atol=1e-6)


def test_a_real_log_of_a_laser_alone_is_used() -> None:
    words = ("--sensors", "lrf", "--no-advice", "--no-smooth")
    lrf = reported("compare", real_log("strangers/laser_only"), *words).rows["lrf"]
    assert lrf["sensors"]["lrf"]["accepted"] > 500


@pytest.mark.parametrize("words", ["start.x=1", "wheels.noise=0.002", "lrf.time_offset=0.1", "lrf.x=0.2"])
def test_scans_are_matched_again_only_where_the_laser_moves(
    words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The motion under other settings is that of a log that was loaded with them, to the bit."""
    log = laser_bag(tmp_path / "laser.mcap")
    session = locfuse_api.load(log)
    anew = locfuse_api.load(log, sets=[words])
    matched: list[Laser] = []

    def counted(stream: Stream, laser: Laser, wheels: Wheels) -> ThinnedScans:
        matched.append(laser)
        return read_scans(stream, laser, wheels)

    monkeypatch.setattr("locfuse.fusion.wheels.motion_by_scans.read_scans", counted)
    again = session.with_settings([words])
    assert len(matched) == (words == "lrf.x=0.2")
    np.testing.assert_array_equal(again.drive.motions.u, anew.drive.motions.u)
    np.testing.assert_array_equal(again.drive.motions.Q, anew.drive.motions.Q)
    assert again.drive.epoch_ns == anew.drive.epoch_ns
