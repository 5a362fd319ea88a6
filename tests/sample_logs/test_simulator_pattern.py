"""The simulator's drives for consistency: a fixed error per beam, a round room, a vague start."""

from __future__ import annotations

import math
from typing import cast

import numpy as np
import pytest
from scipy.stats import chi2, kstest

from locfuse.fusion.data import Array, ArrayStream, LocfuseError, Ragged, UsageError
from locfuse.sample_logs import load
from locfuse.sample_logs.camera import Painter
from locfuse.sample_logs.equipment import beam_pattern, stated_start
from locfuse.sample_logs.messages import streams
from locfuse.sample_logs.record import in_memory
from locfuse.sample_logs.robot import Robot
from locfuse.sample_logs.scenario import Camera, Landmark, Lrf, Room, Scenario, Start
from locfuse.sample_logs.sensors import Laser
from locfuse.sample_logs.simulate import Simulation
from locfuse.sample_logs.world import Plan, Scene, clearance, rings
from locfuse.sample_logs.world import cast as cast_rays

HIGH = Landmark(bottom=1.0)  # a landmark above the laser's plane
ROUND = Room(size=(8.0, 8.0), radius=4.0, plates=())
CENTRE = np.array([4.0, 4.0])
SHORT = (  # a drive of 6 s
    "camera.enabled=false",
    'path={kind="legs", legs=[{forward=1.0}]}',
    "control.wait=0.3",
)


def drive(*sets: str) -> dict[str, ArrayStream]:
    return in_memory(load.load("rounded_rectangle", (*SHORT, *sets)), 5)[0]


def ranges(streams_by_topic: dict[str, ArrayStream]) -> Array:
    """Return the ranges of all scans (n, beams) [m]."""
    matrix = cast(Ragged, streams_by_topic["/scan"].data["ranges"]).matrix()
    assert matrix is not None
    return matrix.astype(float)


def to_round_wall(origin: Array, angle: Array) -> Array:
    """Return how far each ray goes in the round room, (n,) m: the larger root of |p + s d - c|^2 = r^2."""
    p = origin - CENTRE
    b = np.cos(angle) * p[:, 0] + np.sin(angle) * p[:, 1]
    return np.asarray(-b + np.sqrt(b * b + 4.0**2 - (p * p).sum(axis=1)))


def test_a_pattern_is_one_error_per_beam_for_the_whole_drive() -> None:
    plain, with_pattern = ranges(drive()), ranges(drive("lrf.pattern=0.006"))
    seen = np.isfinite(plain)
    assert np.array_equal(seen, np.isfinite(with_pattern))
    error = np.where(seen, with_pattern, 0.0) - np.where(seen, plain, 0.0)
    expected = beam_pattern(Lrf(pattern=0.006), streams(5))
    assert np.abs(error - np.where(seen, expected, 0.0)).max() < 2e-6  # ranges are 32-bit floats


@pytest.mark.parametrize(
    ("sets", "changed"),
    [(("lrf.pattern=0.006",), {"/scan"}), (("start.sigma_xy=0.5", "start.sigma_theta_deg=20"), set[str]())],
)
def test_nothing_else_of_the_drive_changes(sets: tuple[str, ...], changed: set[str]) -> None:
    plain, now = drive(), drive(*sets)
    for topic in plain.keys() - changed:
        for name, column in plain[topic].data.items():
            a, b = (c.values if isinstance(c, Ragged) else c for c in (column, now[topic].data[name]))
            assert np.array_equal(np.asarray(a), np.asarray(b)), (topic, name)


def test_patterns_have_their_sigma_and_beams_know_nothing_of_each_other() -> None:
    drawn = np.array([beam_pattern(Lrf(pattern=0.006, beams=181), streams(s)) for s in range(40)]) / 0.006
    n = drawn.size
    assert chi2.ppf(1e-4, n) < (drawn**2).sum() < chi2.ppf(1 - 1e-4, n)
    assert kstest(drawn.ravel(), "norm").pvalue > 1e-4
    for a, b in ((drawn[:, 1:], drawn[:, :-1]), (drawn[1:], drawn[:-1])):  # neighbour beams, neighbour seeds
        assert abs((a * b).mean()) < 4 / math.sqrt(a.size)


def test_without_a_pattern_nothing_is_added() -> None:
    assert not beam_pattern(Lrf(), streams(1)).any()
    assert ranges(drive()).tobytes() == ranges(drive("lrf.pattern=0")).tobytes()


@pytest.mark.parametrize("key", ["lrf.pattern", "start.sigma_xy", "start.sigma_theta_deg"])
def test_a_negative_sigma_is_refused_by_name(key: str) -> None:
    with pytest.raises(UsageError, match=key):
        load.load("rounded_rectangle", (f"{key}=-1",))


def test_ranges_in_a_round_room_equal_the_closed_form() -> None:
    lrf = Lrf(sigma_range=0.0, sigma_angle_deg=0.0, lost=0.0, x=0.2, y=-0.1, yaw_deg=10.0)
    scenario = Scenario(lrf=lrf, room=ROUND, landmark=HIGH)
    robot = Robot(scenario, (2.5, 3.0, 0.5), streams(1))
    for _ in range(3):
        robot.drive((3.0, 4.0))  # every ray leaves from a place of its own
    laser = Laser(lrf, Scene(scenario), robot, np.random.default_rng(7))
    measured = laser.read(0.01)["ranges"]
    pose = robot.trail.pose(0.01 + laser.times)
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    origin = pose[:, :2] + np.stack((0.2 * c + 0.1 * s, 0.2 * s - 0.1 * c), axis=-1)
    angle = pose[:, 2] + np.radians(10.0 + np.arange(181) - 90.0)
    assert np.abs(measured - to_round_wall(origin, angle)).max() < 1e-6


def test_a_round_wall_is_seen_from_inside_only_and_hides_nothing_before_it() -> None:
    plan = Plan(np.zeros((0, 4)), np.array([[6.0, 4.0, 0.5]]), rings(ROUND))
    origin = np.array([[4.0, 4.0], [4.0, 4.0], [9.0, 4.0]])
    assert cast_rays(plan, origin, np.array([0.0, np.pi, np.pi])) == pytest.approx([1.5, 4.0, 2.5])
    empty = Plan(np.zeros((0, 4)), np.zeros((0, 3)), rings(ROUND))
    assert np.isinf(cast_rays(empty, np.array([[9.0, 4.0]]), np.array([np.pi]))).all()


def test_clearance_in_a_round_room_is_the_distance_to_the_circle() -> None:
    points = np.array([[4.0, 4.0], [6.0, 4.0], [4.0, 7.9], [8.5, 4.0]])
    assert clearance(Scene(Scenario(room=ROUND, landmark=HIGH)).plan(0.25), points) == pytest.approx(
        [4.0, 2.0, 0.1, -0.5]
    )


def test_the_camera_sees_the_round_wall_where_it_is() -> None:
    painter = Painter(Camera(), Scene(Scenario(room=ROUND, landmark=Landmark(x=4.0, y=7.8, radius=0.01))))
    eye = np.array([5.0, 3.0, 0.9, 0.7])
    hits = painter.trace(eye, 0.0)
    wall = hits.surface == 2
    assert wall.mean() > 0.1
    angle = np.arctan2(hits.dy[wall], hits.dx[wall]).astype(float)
    expected = to_round_wall(np.broadcast_to(eye[:2], (len(angle), 2)), angle)
    assert np.abs(hits.way[wall] - expected).max() < 1e-4
    inward = hits.nx[wall] * hits.dx[wall] + hits.ny[wall] * hits.dy[wall]
    assert (inward < 0).all()  # the wall's normal turns against the ray
    assert np.abs(np.hypot(hits.nx[wall], hits.ny[wall]) - 1.0).max() < 1e-5


def test_the_round_room_can_be_driven() -> None:
    streams_by_topic = in_memory(load.load("round_room", ("camera.enabled=false", "path.laps=0.2")), 3)[0]
    seen = ranges(streams_by_topic)
    assert seen[np.isfinite(seen)].max() < 8.2


def test_a_robot_too_near_to_the_round_wall_hits_it() -> None:
    with pytest.raises(LocfuseError, match="the robot hits something"):
        in_memory(load.load("round_room", (*SHORT, "path.x=7.0", "path.y=4.0")), 1)


def test_the_stated_start_errs_by_its_sigmas_and_says_them() -> None:
    scenario = Scenario(start=Start(sigma_xy=0.1, sigma_theta_deg=5.0))
    true = (1.5, 1.5, 0.3)
    off = np.array([stated_start(scenario, true, streams(s)) for s in range(400)]) - true
    normalised = off / (0.1, 0.1, math.radians(5.0))
    n = normalised.size
    assert chi2.ppf(1e-4, n) < (normalised**2).sum() < chi2.ppf(1 - 1e-4, n)
    table = Simulation(scenario, 5).robot_tables["start"]
    assert (table["sigma_xy"], table["sigma_theta_deg"]) == (0.1, 5.0)
