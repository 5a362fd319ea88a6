"""Every sensor's noise is what its scenario says: chi-square tests on residuals against closed forms."""

import math
from typing import Any, cast

import numpy as np
import pytest
import rooms
from present import present
from scipy.stats import binom, chi2, kstest

from locfuse.fusion.data import Array, ArrayStream, Ragged
from locfuse.sample_logs import scenario as load
from locfuse.sample_logs.robot import SimulatedRobot
from locfuse.sample_logs.scenario import (
    CompassSpec,
    GpsSpec,
    Landmark,
    LrfSpec,
    Motor,
    Room,
    Scenario,
    SonarSpec,
    StartSpec,
    WheelsSpec,
)
from locfuse.sample_logs.sensors import (
    GroundTruth,
    Magnetometer,
    Ranger,
    SatelliteReceiver,
    SimulatedEncoders,
    SimulatedLaser,
    beam_pattern,
    stated_start,
)
from locfuse.sample_logs.simulate import Simulation, in_memory
from locfuse.sample_logs.table import streams
from locfuse.sample_logs.world import World

HIGH = Landmark(bottom=1.0)  # a landmark above the laser's plane
EMPTY = Room(plates=())


def agrees(normalised: Array) -> bool:
    """Whether residuals over sigma are standard normal by their mean and their squares (two-sided, 1 in 5000)."""
    n = normalised.size
    centred = abs(normalised.mean()) < 4 / math.sqrt(n)
    return bool(centred and chi2.ppf(1e-4, n) < (normalised**2).sum() < chi2.ppf(1 - 1e-4, n))


def white(normalised: Array) -> bool:
    """Whether neighbours along either axis of (n, m) residuals are uncorrelated."""
    pairs = [(normalised[1:], normalised[:-1]), (normalised[:, 1:], normalised[:, :-1])]
    return all(abs((a * b).mean()) < 4 / math.sqrt(a.size) for a, b in pairs if a.size)


def standing(scenario: Scenario, pose: tuple[float, float, float]) -> SimulatedRobot:
    robot = SimulatedRobot(scenario, pose, streams(1))
    for _ in range(5):
        robot.drive((0.0, 0.0))
    return robot


def ranges(lrf: LrfSpec, pose: tuple[float, float, float], scans: int) -> Array:
    scenario = Scenario(lrf=lrf, room=EMPTY, landmark=HIGH)
    laser = SimulatedLaser(lrf, World(scenario), standing(scenario, pose), np.random.default_rng(7))
    return np.array([laser.read(0.01)["ranges"] for _ in range(scans)], float)


def test_laser_ranges_err_by_their_sigma_about_the_rectangle() -> None:
    lrf = LrfSpec(sigma_angle_deg=0.0, lost=0.0, x=0.2, y=-0.1, yaw_deg=10.0)
    measured = ranges(lrf, (3.0, 2.0, 0.5), 100)
    heading = 0.5 + math.radians(10)
    x = 3.0 + 0.2 * math.cos(0.5) + 0.1 * math.sin(0.5)
    y = 2.0 + 0.2 * math.sin(0.5) - 0.1 * math.cos(0.5)
    true = rooms.scan(rooms.box(0, 0, 8, 6), np.array([x, y, heading]), np.radians(np.arange(181) - 90.0))
    residual = (measured - true) / 0.03
    assert agrees(residual)
    assert white(residual)


def test_laser_rays_err_by_their_sigma_in_angle() -> None:
    """On the wall x = 8, seen 60 degrees off, a range without noise gives the ray's true angle."""
    lrf = LrfSpec(sigma_range=0.0, lost=0.0, x=0.0)
    measured = ranges(lrf, (5.0, 0.5, math.radians(60)), 200)
    wall = measured[:, 20:60]  # rays at -10 to +30 degrees in the map
    nominal = np.radians(60 + np.arange(20, 60) - 90.0)
    upper = nominal > math.radians(5)  # away from the normal, where the range says little
    true = np.arccos(3.0 / wall[:, upper])
    residual = (true - nominal[upper]) / math.radians(0.25)
    assert agrees(residual)


def test_rays_are_lost_as_often_as_asked_and_beyond_the_reach_they_are_infinite() -> None:
    measured = ranges(LrfSpec(lost=0.02), (3.0, 2.0, 0.5), 100)
    lost = int(np.isinf(measured).sum())
    assert binom.ppf(1e-4, measured.size, 0.02) < lost < binom.ppf(1 - 1e-4, measured.size, 0.02)
    measured = ranges(LrfSpec(range_max=4.0, lost=0.0), (3.0, 2.0, 0.5), 20)
    assert np.isinf(measured).any()
    assert measured[np.isfinite(measured)].max() <= 4.0


def field(compass: CompassSpec, theta: float, n: int) -> Array:
    scenario = Scenario(compass=compass)
    robot = standing(scenario, (2.0, 2.0, theta))
    sensor = Magnetometer(compass, World(scenario), robot, np.random.default_rng(8))
    readings = [sensor.read(0.05) for _ in range(n)]
    return np.array([(r["magnetic_field.x"], r["magnetic_field.y"]) for r in readings])


def test_both_axes_of_the_compass_err_by_their_sigma() -> None:
    compass = CompassSpec(resolution_deg=0.0, hard_iron=(0.0, 0.0), soft_iron=(1.0, 1.0, 0.0))
    measured = field(compass, 0.8, 3000)
    north = math.radians(65.0) - 0.8
    residual = (measured - 20e-6 * np.array([math.cos(north), math.sin(north)])) / (20e-6 * math.radians(0.5))
    assert agrees(residual)
    assert white(residual)
    heading = math.radians(65.0) - np.arctan2(measured[:, 1], measured[:, 0])
    assert agrees((heading - 0.8) / math.radians(0.5))


def test_iron_on_the_robot_moves_and_bends_the_circle_of_the_field() -> None:
    compass = CompassSpec(resolution_deg=0.0, noise_deg=0.0, hard_iron=(3e-6, -2e-6), soft_iron=(1.2, 0.9, 0.1))
    for theta in np.linspace(-3, 3, 7):
        north = math.radians(65.0) - theta
        x, y = 20e-6 * math.cos(north), 20e-6 * math.sin(north)
        expected = (1.2 * x + 0.1 * y + 3e-6, 0.1 * x + 0.9 * y - 2e-6)
        np.testing.assert_allclose(field(compass, float(theta), 1)[0], expected, atol=1e-12)


def test_a_compass_axis_counts_in_steps_of_its_resolution() -> None:
    step = 20e-6 * math.radians(0.1)
    counts = field(CompassSpec(resolution_deg=0.1), 0.8, 200) / step
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
    assert len(np.unique(np.round(counts))) > 10


def rolled_and_moved(robot: SimulatedRobot) -> tuple[Array, Array]:
    """Return per tick what each wheel rolled by its encoder and what it moved over ground, (n, 2) m."""
    twist = robot.trail.steps().reshape(-1, 4, 3).sum(axis=1)
    moved = np.stack((twist[:, 0] - 0.3 * twist[:, 2], twist[:, 0] + 0.3 * twist[:, 2]), axis=-1)
    counts = np.array([tick.counts for tick in robot.ticks])
    return np.diff(counts, axis=0) * robot.wheels[0].rad_per_count * 0.05, moved


@pytest.mark.parametrize("speeds", [(6.0, 6.0), (-6.0, 6.0), (3.0, 9.0), (-4.0, -4.0)])
def test_the_ground_adds_k_per_metre_to_each_wheel_whatever_the_sampling(speeds: tuple[float, float]) -> None:
    robot = SimulatedRobot(Scenario(), (0.0, 0.0, 0.0), streams(11))
    for _ in range(2000):
        robot.drive(speeds)
    rolled, moved = rolled_and_moved(robot)
    for ticks in (5, 25, 100):
        way, ground = (part.reshape(-1, ticks, 2).sum(axis=1) for part in (rolled, moved))
        residual = (ground - way) / np.sqrt(4e-4 * np.abs(way) + 2 * (0.05 * math.pi / 1000) ** 2 / 12)
        assert agrees(residual)
        assert abs((residual[:, 0] * residual[:, 1]).mean()) < 4 / math.sqrt(len(residual))


def test_straight_runs_drift_as_the_closed_form_of_the_delta_experiment_says() -> None:
    """Open loop, D = 1 m: var(yaw) = 2 k D / L^2, var(across) = 2 k D^3 / (3 L^2), against dead reckoning."""
    yaw, across, way = [], [], []
    for seed in range(80):
        robot = SimulatedRobot(Scenario(motor=Motor(load=0.0, acceleration=100.0)), (0.0, 0.0, 0.0), streams(seed))
        for _ in range(84):
            robot.drive((12.0, 12.0))
        rolled, _ = rolled_and_moved(robot)
        turns = (rolled[:, 1] - rolled[:, 0]) / 0.6
        heading = np.cumsum(turns) - turns / 2
        x, y, theta = robot.trail.knots()[-1]
        yaw.append(theta - turns.sum())
        across.append(y - (rolled.mean(axis=1) * np.sin(heading)).sum())
        way.append(x)
    D = float(np.mean(way))
    assert pytest.approx(1.0, abs=0.03) == D
    assert agrees(np.array(yaw) / math.sqrt(2 * 4e-4 * D / 0.36))
    assert agrees(np.array(across) / math.sqrt(2 * 4e-4 * D**3 / (3 * 0.36)))


def test_without_ground_noise_the_robot_moves_as_its_wheels_roll() -> None:
    scenario = Scenario(wheels=WheelsSpec(noise=0.0, radius_error=(0.01, -0.01), track_error=0.02))
    robot = SimulatedRobot(scenario, (0.0, 0.0, 0.0), streams(1))
    before = [wheel.angle for wheel in robot.wheels]
    for _ in range(100):
        robot.drive((5.0, 7.0))
    left, right = (wheel.angle - angle for wheel, angle in zip(robot.wheels, before, strict=True))
    turned = (0.0495 * right - 0.0505 * left) / 0.612
    assert robot.trail.knots()[-1, 2] == pytest.approx(turned, abs=1e-12)


def test_truth_has_no_noise_and_encoders_only_their_counts() -> None:
    scenario = Scenario()
    robot = SimulatedRobot(scenario, (1.0, 2.0, 0.3), streams(5))
    for _ in range(100):
        robot.drive((5.0, 7.0))
    truth: dict[str, Any] = GroundTruth(scenario.truth, robot, streams(1)("truth")).read(1.234)
    expected = robot.trail.pose(np.array([1.234]))[0]
    assert truth["pose.position.x"] == pytest.approx(expected[0], abs=1e-12)
    heading = 2 * math.atan2(truth["pose.orientation.z"], truth["pose.orientation.w"])
    assert heading == pytest.approx(expected[2], abs=1e-12)
    turned = SimulatedEncoders(scenario, robot).read(2.0)["position"]
    true = np.array([w.angle for w in robot.wheels])
    assert np.abs(turned - true).max() <= 2 * math.pi / 2000


def test_a_sonar_errs_by_its_sigma_about_the_nearest_echo_or_says_infinity() -> None:
    scenario = Scenario(room=EMPTY, landmark=HIGH)
    sonar = SonarSpec(name="front", x=0.25, yaw_deg=0.0)
    robot = standing(scenario, (5.0, 3.0, math.radians(6)))  # the wall's normal lies within the cone
    ranger = Ranger(sonar, World(scenario), robot, np.random.default_rng(9))
    measured = np.array([ranger.read(0.05)["range"] for _ in range(3000)])
    residual = (measured - (3.0 - 0.25 * math.cos(math.radians(6)))) / 0.02
    assert agrees(residual)
    scenario = Scenario(room=EMPTY, landmark=HIGH)
    ranger = Ranger(
        SonarSpec(name="front", x=0.2),
        World(scenario),
        standing(scenario, (2.0, 3.0, 0.0)),
        np.random.default_rng(9),
    )
    assert ranger.read(0.05)["range"] == math.inf


def test_gps_errs_by_its_sigma_in_metres_on_the_ellipsoid() -> None:
    """Back from degrees with the series for the length of a degree (Snyder 1987), not with our radii."""
    gps = GpsSpec(enabled=True, sigma=1.5, east_deg=30.0)
    scenario = Scenario(gps=gps)
    receiver = SatelliteReceiver(gps, standing(scenario, (2.0, 3.0, 0.0)), np.random.default_rng(10))
    fixes = [receiver.read(0.05) for _ in range(3000)]
    phi = math.radians(gps.latitude)
    degree_north = 111132.92 - 559.82 * math.cos(2 * phi) + 1.175 * math.cos(4 * phi)
    degree_east = 111412.84 * math.cos(phi) - 93.5 * math.cos(3 * phi) + 0.118 * math.cos(5 * phi)
    north = np.array([f["latitude"] - gps.latitude for f in fixes]) * degree_north
    east = np.array([f["longitude"] - gps.longitude for f in fixes]) * degree_east
    c, s = math.cos(math.radians(30)), math.sin(math.radians(30))
    residual = np.stack((c * east - s * north - 2.0, s * east + c * north - 3.0), axis=-1) / 1.5
    assert agrees(residual)


# --- for consistency: a fixed error per beam, a vague start

SHORT = (  # a drive of 6 s
    "camera.enabled=false",
    'path={kind="legs", legs=[{forward=1.0}]}',
    "control.wait=0.3",
)


def drive(*sets: str) -> dict[str, ArrayStream]:
    return in_memory(load.load("rounded_rectangle", (*SHORT, *sets)), 5)[0]


def ranges_of(streams_by_topic: dict[str, ArrayStream]) -> Array:
    """Return the ranges of all scans (n, beams) [m]."""
    matrix = present(cast(Ragged, streams_by_topic["/scan"].data["ranges"]).matrix())
    return matrix.astype(float)


def test_a_pattern_is_one_error_per_beam_for_the_whole_drive() -> None:
    plain, with_pattern = ranges_of(drive()), ranges_of(drive("lrf.pattern=0.006"))
    seen = np.isfinite(plain)
    assert np.array_equal(seen, np.isfinite(with_pattern))
    error = np.where(seen, with_pattern, 0.0) - np.where(seen, plain, 0.0)
    expected = beam_pattern(LrfSpec(pattern=0.006), streams(5))
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
    drawn = np.array([beam_pattern(LrfSpec(pattern=0.006, beams=181), streams(s)) for s in range(40)]) / 0.006
    assert agrees(drawn)
    assert kstest(drawn.ravel(), "norm").pvalue > 1e-4
    assert white(drawn)  # neighbour beams, neighbour seeds


def test_the_stated_start_errs_by_its_sigmas_and_says_them() -> None:
    scenario = Scenario(start=StartSpec(sigma_xy=0.1, sigma_theta_deg=5.0))
    true = (1.5, 1.5, 0.3)
    off = np.array([stated_start(scenario, true, streams(s)) for s in range(400)]) - true
    assert agrees(off / (0.1, 0.1, math.radians(5.0)))
    table = Simulation(scenario, 5).robot_tables["start"]
    assert (table["sigma_xy"], table["sigma_theta_deg"]) == (0.1, 5.0)
