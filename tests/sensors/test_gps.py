"""GPS: metres against published geodesic lengths, and a frame that is found without a guess."""

import math
import re
from typing import Any

import numpy as np
import pytest
from pose_streams import odometry_stream, reckoned, slipping

from locfuse.cli.analysis.robot_tables import make_robot
from locfuse.fusion import se2
from locfuse.fusion.data import Array, ArrayStream, Column, Drive, Estimates, LocfuseError, Measurements
from locfuse.fusion.fuse import Filter, fuse
from locfuse.fusion.geodesy import east_north, on_map
from locfuse.fusion.measure import measure
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.gps import Gps, GpsSettings
from locfuse.fusion.wheels.motion import Wheels
from locfuse.sample_logs.sensors import radii

T0 = 1_700_000_000_000_000_000
ORIGIN = (52.38, 9.72)
SIGMA = 0.8


START = (12.0, -7.0, 0.3)


def described_by(gps: dict[str, Any], noise: float = 4e-4, start: tuple[float, float, float] = START) -> Robot:
    where = {"x": start[0], "y": start[1], "theta_deg": math.degrees(start[2])}
    return make_robot({"wheels": {"track": 0.5, "noise": noise}, "start": where, "gps": gps})


def drive_of(
    seed: int,
    gps: dict[str, Any] | None = None,
    east_deg: float = 70.0,
    length: float = 300.0,
    start: tuple[float, float, float] = START,
    antenna: tuple[float, float] = (0.0, 0.0),
    noise: float = 4e-4,
    columns: dict[str, Any] | None = None,
) -> tuple[Drive, Robot, Array]:
    """A wide loop with drifting wheels, a fix a second, and the true poses at the fixes."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, length / 1.0, 0.1)
    turning = 0.06 * np.sin(t / 17.0) + 0.025
    steps = np.column_stack((np.full(len(t) - 1, 0.1), 0.1 * turning[1:]))
    pose = reckoned(steps, start)
    at = np.arange(3, len(t), 10)
    fixes = fixes_of(t[at], pose[at], east_deg, antenna, rng, columns or {})
    described = described_by({"x": antenna[0], "y": antenna[1], **(gps or {})}, noise, start)
    stamps = T0 + np.rint(t * 1e9).astype(np.int64)
    wheels = odometry_stream(stamps, reckoned(slipping(steps, 0.5, noise, rng)))  # as robot.toml says
    drive = measure({"wheels": wheels, "gps": fixes}, described)
    return drive, described, pose[at]


def fixes_of(
    t: Array,
    pose: Array,
    east_deg: float,
    antenna: tuple[float, float],
    rng: np.random.Generator,
    columns: dict[str, Any],
) -> ArrayStream:
    """Latitude and longitude by the local radii of the ellipsoid: another way than the product's."""
    seen = se2.transform(pose, np.broadcast_to(antenna, (len(t), 2)))
    x, y = (column + SIGMA * rng.normal(size=len(t)) for column in seen.T)
    e = math.radians(east_deg)
    meridian, parallel = radii(ORIGIN[0])
    n = len(t)
    data: dict[str, Column] = {
        "status.status": np.zeros(n, np.int8),
        "latitude": ORIGIN[0] + np.degrees((-math.sin(e) * x + math.cos(e) * y) / meridian),
        "longitude": ORIGIN[1] + np.degrees((math.cos(e) * x + math.sin(e) * y) / parallel),
        "position_covariance": np.tile(np.diag([SIGMA**2, SIGMA**2, 4.0]).ravel(), (n, 1)),
        "position_covariance_type": np.full(n, 2, np.uint8),
    }
    stamps = T0 + np.rint(t * 1e9).astype(np.int64)
    return ArrayStream("/fix", "sensor_msgs/msg/NavSatFix", stamps, {**data, **columns})


def found_east(e: Estimates) -> tuple[float, float]:
    said, sigma = (float(v) for v in re.findall(r"-?\d+\.\d", e.notes[0]))
    return said, sigma


def errors(drive: Drive, e: Estimates, truth: Array) -> Array:
    found = e.pose[drive.instant["gps"], :2]
    apart: Array = np.hypot(*(found - truth[:, :2]).T)
    return apart


@pytest.mark.parametrize(
    ("here", "there", "metres"),
    [
        # lengths of one degree on WGS 84 as tables print them (arc; the chord is shorter by 1.4 m)
        ((-0.5, 0.0), (0.5, 0.0), 110_574.0),
        ((44.5, 0.0), (45.5, 0.0), 111_132.0),
        ((89.0, 0.0), (90.0, 0.0), 111_694.0),
        ((0.0, 10.0), (0.0, 11.0), 111_320.0),
        ((45.0, -3.0), (45.0, -2.0), 78_847.0),
        ((60.0, 179.5), (60.0, -179.5), 55_800.0),
    ],
)
def test_a_degree_has_its_length(here: tuple[float, float], there: tuple[float, float], metres: float) -> None:
    found = east_north(np.array([there[0]]), np.array([there[1]]), here)[0]
    assert np.hypot(*found) == pytest.approx(metres, rel=2e-4)


@pytest.mark.parametrize("east_deg", [-170.0, -90.0, -30.0, 0.0, 45.0, 120.0, 180.0])
def test_any_direction_of_east_is_found_without_a_guess(east_deg: float) -> None:
    drive, described, truth = drive_of(3, east_deg=east_deg, noise=2e-5)
    e = fuse(drive, described, ("gps",))
    said, sigma = found_east(e)
    assert sigma < 5.0
    assert abs((said - east_deg + 180.0) % 360.0 - 180.0) < 3.0 * sigma
    assert e.audits["gps"].verdict.tolist().count(0) > 0.98 * len(truth)


def test_the_direction_of_east_is_as_uncertain_as_said_and_the_drift_is_bounded() -> None:
    squares, gained = [], []
    for seed in range(12):
        drive, described, truth = drive_of(seed, east_deg=33.0, length=250.0, noise=2e-5)
        e = fuse(drive, described, ("gps",))
        said, sigma = found_east(e)
        squares.append(((said - 33.0) / sigma) ** 2)
        drifted = fuse(drive, described, ())
        gained.append(errors(drive, e, truth)[-50:].mean() / errors(drive, drifted, truth)[-50:].mean())
    assert np.mean(squares) < 2.2  # chi-square over 12 drives: above once in a hundred
    assert np.median(gained) < 0.9


def test_a_given_frame_needs_no_state_and_gives_metres_on_the_map() -> None:
    known = {"origin": list(ORIGIN), "east_deg": 70.0}
    found, sizes = [], []
    for seed in range(4):
        drive, described, truth = drive_of(seed, known)
        assert Filter(described, ("gps",)).models["gps"].blocks() == []
        e = fuse(drive, described, ("gps",))
        error = e.pose[drive.instant["gps"], :2] - truth[:, :2]
        P = e.P[drive.instant["gps"], :2, :2]
        found.append(float(np.einsum("ni,nij,nj->n", error, np.linalg.inv(P), error)[20:].mean() / 2))
        sizes.append(float(np.hypot(*error.T)[20:].mean()))
        assert e.notes == ()
    assert np.mean(sizes) < 0.5
    assert 0.6 < np.mean(found) < 1.5


def test_the_antenna_may_sit_anywhere_on_the_robot() -> None:
    known = {"origin": list(ORIGIN), "east_deg": 70.0}
    drive, described, truth = drive_of(6, known, antenna=(2.0, -1.5))
    right = errors(drive, fuse(drive, described, ("gps",)), truth)[20:].mean()
    wrong = errors(drive, fuse(drive, described_by(known), ("gps",)), truth)[20:].mean()
    assert right < 0.5
    assert wrong > 1.5


def test_no_fix_nan_and_zero_are_left_out_and_counted() -> None:
    drive, *_ = drive_of(8)
    n = len(drive.measurements["gps"].t)
    status = np.zeros(n, np.int8)
    status[:5] = -1
    full, *_ = drive_of(8, columns={"status.status": status})
    assert full.dropped["gps"] == {"no_fix": 5}
    assert len(full.measurements["gps"].t) == n - 5
    nowhere, *_ = drive_of(8, columns={"latitude": np.zeros(n), "longitude": np.zeros(n)})
    assert "no fix" in nowhere.absent["gps"]
    nan, *_ = drive_of(8, columns={"latitude": np.full(n, np.nan)})
    assert "not finite" in nan.absent["gps"]


def test_a_receiver_that_says_nothing_of_its_accuracy_is_given_sigma() -> None:
    drive, *_ = drive_of(9, {"sigma": 2.5})
    assert drive.measurements["gps"].R[0, 0, 0] == pytest.approx(SIGMA**2)
    n = len(drive.measurements["gps"].t)
    unknown, *_ = drive_of(9, {"sigma": 2.5}, columns={"position_covariance_type": np.zeros(n, np.uint8)})
    np.testing.assert_allclose(unknown.measurements["gps"].R[3], 2.5**2 * np.eye(2))


# --- what a fix is, and how good it claims to be

STILL = Wheels.from_wheels(np.array([0.0, 100.0]), np.zeros(2), np.zeros(2), 0.5, 1e-4)


def measured(columns: dict[str, Any], n: int = 4, wheels: Wheels = STILL, **settings: Any) -> Measurements:
    given: dict[str, Any] = {
        "status.status": np.zeros(n, np.int8),
        "latitude": np.full(n, ORIGIN[0]),
        "longitude": np.full(n, ORIGIN[1]),
        "position_covariance": np.zeros((n, 9)),
        "position_covariance_type": np.full(n, 2, np.uint8),
        **columns,
    }
    stream = ArrayStream("/fix", "sensor_msgs/msg/NavSatFix", T0 + np.arange(n) * 10**9, given)
    return Gps().measure(stream, GpsSettings(**settings), wheels, T0)


def test_the_covariance_of_a_fix_is_the_receivers_where_it_is_one() -> None:
    """Row-wise (3, 3) of east, north, up. Told to half a millimetre, not finite or not positive it is none."""
    own = np.array([[4.0, 1.0, 0.5], [1.2, 9.0, 0.7], [0.5, 0.7, 20.0]])
    rows = np.tile(own.ravel(), (6, 1))
    rows[1, 0], rows[2, 4] = 0.0005**2, 0.0005**2
    rows[3, 1] = math.nan
    rows[4, [1, 3]] = 7.0  # more than two sigmas allow
    rows[5] = np.diag([0.002**2, 0.003**2, 1.0]).ravel()
    R = measured({"position_covariance": rows}, 6, sigma=2.5).R
    np.testing.assert_allclose(R[0], [[4.0, 1.1], [1.1, 9.0]])
    np.testing.assert_allclose(R[1:5], np.tile(2.5**2 * np.eye(2), (4, 1, 1)))
    np.testing.assert_allclose(R[5], np.diag([0.002**2, 0.003**2]))


def test_a_receiver_that_repeats_its_fix_while_the_robot_drives_is_not_believed() -> None:
    north = ORIGIN[0] + np.arange(20) / 111_000.0  # a metre a second
    held = np.where((np.arange(20) > 5) & (np.arange(20) < 15), north[5], north)
    way = np.array([0.0, 100.0])
    rolling = Wheels.from_wheels(way, way, way, 0.5, 1e-4)
    for wheels, latitude, unused in (
        (rolling, held, {"repeat": 9}),
        (rolling, north, {}),
        (rolling, np.floor(north * 3e4) / 3e4, {}),  # in steps of 4 m
        (STILL, held, {}),
    ):
        assert measured({"latitude": latitude}, 20, wheels).dropped == unused


@pytest.mark.parametrize(
    ("place", "words"),
    [
        (ORIGIN[::-1], "exchanged"),
        (tuple(np.radians(ORIGIN)), "in radians"),
        ((10.0, 10.0), "km from gps.origin."),
    ],
)
def test_fixes_far_from_the_origin_of_the_map_are_refused(place: tuple[float, float], words: str) -> None:
    on_map(np.array([ORIGIN]) + 0.5, ORIGIN, "gps")
    with pytest.raises(LocfuseError, match=words):
        on_map(np.array([place]), ORIGIN, "gps")
