"""Somebody else's poses and speeds, in the map, in a frame of their own, or drifting: consistent by truth."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trap_logs
from commands import locfuse, refused, reported
from msgspec.structs import replace
from numpy.typing import NDArray
from pose_streams import odometry_stream, pose_columns, pose_stream, reckoned, slipping
from rows import one_by_one, said
from textbook import move, numeric_jacobian, wrap

from locfuse.cli.analysis.robot_tables import make_robot
from locfuse.fusion import se2
from locfuse.fusion.data import Array, ArrayStream, Column, Drive, Measurements
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.measure import measure
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.pose import PoseSettings, plane_covariance
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.sensors.twist import Twist, TwistModel, TwistSettings, chord_length
from locfuse.sample_logs.table import RawMessage

# --- a robot that drives round in a wide loop by noisy wheels, with its true poses: for sensors that see no walls

T0 = 1_700_000_000_000_000_000
TRACK, NOISE = 0.5, 4e-4  # m, m
PERIOD = 0.1  # s
START = (2.0, -1.0, 0.4)
TABLES: dict[str, Any] = {
    "wheels": {"track": TRACK, "noise": NOISE},
    "start": {"x": START[0], "y": START[1], "theta_deg": math.degrees(START[2])},
}


def path(seconds: float = 80.0, speed: float = 0.5) -> tuple[Array, Array]:
    """Times (n,) and true poses (n, 3): forward all the time, turning left more than right."""
    t = np.arange(0.0, seconds, PERIOD)
    turn = (0.10 + 0.25 * np.sin(t[:-1] / 7.0)) * PERIOD
    return t, reckoned(np.column_stack((speed * PERIOD * np.sinc(0.5 * turn / np.pi), turn)), START)


def ns(t: Array) -> NDArray[np.int64]:
    """Stamps (n,) of times t (n,) [s]."""
    return T0 + np.rint(t * 1e9).astype(np.int64)


def wheels(t: Array, pose: Array, rng: np.random.Generator) -> ArrayStream:
    """Odometry whose wheels roll with the noise that TABLES tell, from (0, 0, 0)."""
    turn = np.diff(pose[:, 2])
    way = np.hypot(*np.diff(pose[:, :2], axis=0).T) / np.sinc(0.5 * turn / np.pi)
    way, turn = slipping(np.column_stack((way, turn)), TRACK, NOISE, rng).T
    return odometry_stream(ns(t), reckoned(np.column_stack((way * np.sinc(0.5 * turn / np.pi), turn))))


SIGMA, SIGMA_THETA = 0.04, math.radians(1.5)
FRAME = np.array([4.0, -3.0, 2.0])  # where a frame of its own lies in the map
WITH_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"


def posed(t: Array, pose: Array, rng: np.random.Generator, told: bool = True) -> ArrayStream:
    """Poses (n, 3) with white noise, and the covariance of that noise; zeros where nothing is told."""
    noisy = pose + rng.normal(size=pose.shape) * (SIGMA, SIGMA, SIGMA_THETA)
    P = np.diag([SIGMA**2, SIGMA**2, 0.0, 0.0, 0.0, SIGMA_THETA**2]) * told
    data = pose_columns(noisy, "pose.pose") | {"pose.covariance": np.tile(P.reshape(36), (len(t), 1))}
    return ArrayStream("/slam/pose", WITH_COVARIANCE, ns(t), data)


def drifting(t: Array, pose: Array, rng: np.random.Generator) -> ArrayStream:
    """A visual odometry: the true motions with the noise per way that `sigma_drift` tells by default."""
    u = se2.between(pose[:-1], pose[1:])
    way = np.hypot(u[:, 0], u[:, 1]) + 0.15 * np.abs(u[:, 2])
    u += rng.normal(size=u.shape) * np.sqrt(way)[:, None] * (0.02, 0.02, math.radians(1.0))
    at = [np.zeros(3)]
    for one in u:
        at.append(se2.compose(at[-1], one))
    found = odometry_stream(ns(t), np.array(at))
    return replace(found, topic="/vo/odom", data={**found.data, "pose.covariance": np.zeros((len(t), 36))})


def measured(seed: int, kind: str, tables: dict[str, Any] | None = None) -> tuple[Drive, Robot]:
    """A drive of two minutes with one more source: five times a second."""
    rng = np.random.default_rng(seed)
    t, pose = path()
    some = slice(3, None, 2)
    inside = se2.between(np.broadcast_to(FRAME, pose.shape), pose)
    streams = {"wheels": wheels(t, pose, rng), "truth": pose_stream("/ground_truth", ns(t[::5]), pose[::5])}
    if kind == "map":
        streams["pose"] = posed(t[some], pose[some], rng)
    elif kind == "own":
        streams["pose"] = posed(t[some], inside[some], rng)
    elif kind == "drift":
        streams["pose"] = drifting(t[some], pose[some], rng)
    else:
        streams["twist"] = speeds(t, pose, rng)
    table = {} if kind in {"drift", "twist"} else {"frame": kind}
    robot = make_robot({**TABLES, "pose": table, **(tables or {})})
    return measure(streams, robot), robot


def speeds(t: Array, pose: Array, rng: np.random.Generator) -> ArrayStream:
    """True speeds with the noise that [twist] tells by default, less its scale's."""
    forward = np.hypot(*np.gradient(pose[:, :2], t, axis=0).T) + 0.05 * rng.normal(size=len(t))
    turning = np.gradient(pose[:, 2], t) + math.radians(2.0) * rng.normal(size=len(t))
    data: dict[str, Column] = {"twist.linear.x": forward, "twist.angular.z": turning}
    return ArrayStream("/flow/twist", "geometry_msgs/msg/TwistStamped", ns(t), data)


def figures(drive: Drive, robot: Robot, sensors: tuple[str, ...]) -> dict[str, Any]:
    return dict(evaluate(fuse(drive, robot, sensors), drive).figures)


DRIVES = 5


@pytest.mark.parametrize(
    ("kind", "left", "anees"),
    [("map", 0.15, (0.8, 1.3)), ("own", 0.5, (0.6, 1.5)), ("drift", 0.9, (0.6, 1.6)), ("twist", 0.9, (0.5, 1.5))],
)
def test_it_improves_the_wheels_and_is_consistent(kind: str, left: float, anees: tuple[float, float]) -> None:
    """Where the errors of a drive hang together (all but "map"), the mean of a few drives scatters more."""
    sensor = "twist" if kind == "twist" else "pose"
    drives = [measured(seed, kind) for seed in range(DRIVES)]
    found = [figures(*drive, (sensor,)) for drive in drives]
    alone = [figures(*drive, ()) for drive in drives]
    rmse, before = (math.sqrt(np.mean([f["position_rmse_m"] ** 2 for f in fs])) for fs in (found, alone))
    assert rmse < left * before
    assert anees[0] < np.mean([f["anees"] for f in found]) < anees[1]


R_POSE = np.array([[0.2, 0.05, 0.02], [0.05, 0.3, -0.04], [0.02, -0.04, 0.1]])


def seen_by(a: Array, b: Array) -> Array:
    """Pose b in the axes of pose a, by complex numbers."""
    d = complex(*(b - a)[:2]) * complex(math.cos(a[2]), -math.sin(a[2]))
    return np.array([d.real, d.imag, b[2] - a[2]])


@pytest.mark.parametrize("drifts", [0.0, 1.0])
def test_a_source_s_motion_is_compared_with_that_from_the_kept_pose(drifts: float) -> None:
    z = np.array([[2.0, 1.0, -0.7], [2.5, 1.4, -0.2]])
    floor, settings = np.diag([1e-3, 1e-3, 2e-3]), PoseSettings(frame="own", sigma_drift=0.2, sigma_drift_deg=15.0)
    extra = {"drifts": np.full(2, drifts)}
    m = Measurements(np.arange(2.0), np.arange(3), z, np.stack((R_POSE, R_POSE)) - floor, 1.0, floor, extra)
    model: Any = REGISTRY["pose"].model(settings)
    belief = JointBelief((0.4, -0.3, 0.8), (0.01, 0.001, 0.0, 0.02, 0.0, 0.03), model.blocks())
    assert model.innovations(m, 0, belief) == []
    model.learn(m, 0, belief)
    kept, u = belief.state[3:6].copy(), seen_by(*z)
    turn = 0.8 - z[0, 2]  # of the source's frame in that of the robot
    T = np.array([[math.cos(turn), -math.sin(turn), 0.0], [math.sin(turn), math.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    own = 0.0 if drifts else np.diagonal(T @ R_POSE @ T.T)
    np.testing.assert_allclose(np.diagonal(belief.covariance)[3:6], np.diagonal(belief.covariance)[:3] + own)
    belief.transform(np.arange(3), move(kept, u + np.array([0.2, -0.1, 0.05])), np.eye(3))
    (seen,) = model.innovations(m, 1, belief)

    x = np.concatenate((belief.state[:3], kept))
    np.testing.assert_allclose(seen.y, u - seen_by(kept, x[:3]), atol=1e-12)
    H = numeric_jacobian(lambda v: seen_by(v[3:], v[:3]), x)
    _, by_states, R = said(seen, belief)
    np.testing.assert_allclose(by_states, H, atol=1e-8)
    way = math.hypot(u[0], u[1]) + 0.15 * abs(u[2])
    along, around = 0.2**2 * way + 1e-3, math.radians(15.0) ** 2 * way + 2e-3
    back = np.array([[math.cos(0.7), -math.sin(0.7), 0.0], [math.sin(0.7), math.cos(0.7), 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(R, np.diag((along, along, around)) if drifts else back @ R_POSE @ back.T)

    def next_kept(v: Array) -> Array:
        return np.concatenate((v[:3], v[:3] if drifts else move(v[3:], u)))

    J, P = numeric_jacobian(next_kept, x), belief.covariance.copy()
    model.learn(m, 1, belief)
    np.testing.assert_allclose(belief.state, next_kept(x), atol=1e-12)
    np.testing.assert_allclose(belief.covariance, J @ P @ J.T, atol=1e-8)


@pytest.mark.parametrize("theta", [math.nan, math.inf])
def test_a_heading_that_is_no_number_accepts_no_pose(theta: float) -> None:
    m = Measurements(np.zeros(1), np.arange(2), np.ones((1, 3)), R_POSE[None], 1.0, np.zeros((3, 3)))
    belief = JointBelief((0.0, 0.0, theta), (1.0, 0.0, 0.0, 1.0, 0.0, 1.0))
    (seen,) = one_by_one(REGISTRY["pose"].model(PoseSettings(frame="map")).innovations(m, 0, belief))
    assert math.isnan(seen.nis)
    assert seen.verdict != 0


def column(*diagonals: tuple[float, float, float]) -> Array:
    P = np.zeros((len(diagonals), 6, 6))
    for k, (x, y, turn) in enumerate(diagonals):
        P[k, (0, 1, 5), (0, 1, 5)] = x, y, turn
    return P.reshape(-1, 36)


def test_a_covariance_that_says_nothing_is_replaced_and_a_huge_one_is_cut() -> None:
    own = np.broadcast_to(np.array([0.01, 0.01, 0.001]), (4, 3))
    said = column((0.0, 0.0, 0.0), (0.04, 0.09, 0.01), (math.nan, 1.0, 1.0), (1e9, 0.01, 1e9))
    P, told = plane_covariance(said, np.arange(4), "message", own)
    assert told.tolist() == [False, True, False, True]
    np.testing.assert_allclose(P[0], np.diag(own[0]))
    np.testing.assert_allclose(P[1], np.diag([0.04, 0.09, 0.01]))
    np.testing.assert_allclose(P[3], np.diag([1e6, 0.01, 1e6]))
    assert not plane_covariance(said, np.arange(4), "sigma", own)[1].any()


SLAM = "/slam/pose"


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log with the poses of a SLAM: the truth in another frame, with centimetres of noise."""
    drive, rng = trap_logs.Drive(), np.random.default_rng(4)
    poses = []
    for m in drive.on(trap_logs.TRUTH)[::5]:
        z, w = m.fields["pose.orientation.z"], m.fields["pose.orientation.w"]
        at = np.array([m.fields["pose.position.x"], m.fields["pose.position.y"], 2.0 * math.atan2(z, w)])
        x, y, theta = se2.between(FRAME, at) + rng.normal(size=3) * (0.01, 0.01, 0.005)
        values = {"position.x": x, "position.y": y}
        values |= {"orientation.z": math.sin(0.5 * theta), "orientation.w": math.cos(0.5 * theta)}
        fields = {f"pose.pose.{name}": value for name, value in values.items()}
        fields["pose.covariance"] = column((1e-4, 1e-4, 2.5e-5))[0]
        poses.append(RawMessage(SLAM, WITH_COVARIANCE, m.log_ns, m.stamp_ns, "slam_map", fields))
    drive.add(poses)
    return drive.record(tmp_path_factory.mktemp("pose") / "slam.mcap")


def test_wishes_and_commands_are_no_estimates(tmp_path: Path) -> None:
    """What a person clicked or asked for was measured by nobody."""
    drive = trap_logs.Drive()
    at = drive.on(trap_logs.TRUTH)[0]
    pose = {"pose.position.x": 1.0, "pose.position.y": 1.0, "pose.orientation.w": 1.0}
    speed = {"twist.linear.x": 0.1, "twist.angular.z": 0.0}
    when, kinds = (at.log_ns, at.stamp_ns), "geometry_msgs/msg/"
    goal = RawMessage("/goal_pose", f"{kinds}PoseStamped", *when, "map", pose)
    drive.add([goal, RawMessage("/cmd_vel", f"{kinds}TwistStamped", *when, "base_link", speed)])
    told = locfuse("info", drive.record(tmp_path / "wishes.mcap")).stdout
    assert "if you name it" not in told


def test_compare_uses_it_where_it_is_named(log: Path) -> None:
    words = ("--set", f"pose.topic={SLAM}", "--sensors", "pose", "--sensors", "odometry")
    rows = reported("compare", log, "--no-advice", *words).rows
    assert rows["pose"]["sensors"]["pose"]["rejected"] == 0
    assert rows["pose"]["position_rmse_m"] < rows["odometry"]["position_rmse_m"]


def test_a_frame_that_is_not_the_map_is_named(log: Path, tmp_path: Path) -> None:
    sets = ("--set", f"pose.topic={SLAM}", "--set", "pose.frame=map")
    done = locfuse("run", log, "-v", *sets, "--sensors", "pose", "-o", tmp_path / "out")
    assert "pose.frame=own" in done.stderr + done.stdout


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((f"pose.topic={trap_logs.TRUTH}",), f"{trap_logs.TRUTH} is read as truth already: it would judge itself"),
        (("pose.topic=/scan",), "/scan is sensor_msgs/msg/LaserScan; accepted: nav_msgs/Odometry"),
        ((f"pose.topic={SLAM}", "pose.sigma=0"), "sigma = 0.0: no sensor is exact"),
    ],
)
def test_what_cannot_be_is_one_line(log: Path, words: tuple[str, ...], said: str) -> None:
    assert said in refused("run", log, *(w for word in words for w in ("--set", word)), code=None)


def test_a_source_that_never_changes_is_refused() -> None:
    t, pose = path(20.0)
    rng = np.random.default_rng(0)
    robot = make_robot(TABLES)
    stuck = posed(t, np.zeros_like(pose), rng)
    still = {name: np.zeros_like(np.asarray(c)) for name, c in stuck.data.items()}
    still["pose.pose.orientation.w"] = np.ones(len(t))
    streams = {"wheels": wheels(t, pose, rng), "pose": ArrayStream(SLAM, WITH_COVARIANCE, ns(t), still)}
    assert "says the same pose in all 200 messages" in measure(streams, robot).absent["pose"]


KEPT = np.array([0.4, -0.3, 0.8])
SETTINGS = TwistSettings(sigma_scale=0.1)


def kept(pose: np.ndarray) -> tuple[TwistModel, JointBelief]:
    """A source whose first reading came at KEPT, and a robot that is at `pose` now."""
    model = Twist().model(SETTINGS)
    assert isinstance(model, TwistModel)
    x, y, theta = KEPT.tolist()
    belief = JointBelief((x, y, theta), (0.01, 0.001, 0.0, 0.02, 0.0, 0.03), model.blocks())
    model.learn(summed(0.0), 0, belief)
    belief.transform(np.arange(3), pose, np.eye(3))
    return model, belief


def summed(turn: float, piece: float = 0.0) -> Measurements:
    """Two readings: 0.6 m and a turn [rad] between them."""
    columns = {"piece": [0.0, piece], "forward_variance": [0.1, 0.14], "turn_variance": [0.2, 0.23]}
    z, floor = np.array([[3.0, 1.0], [3.6, 1.0 + turn]]), np.diag([1e-3, 2e-3])
    extra = {name: np.array(column) for name, column in columns.items()}
    return Measurements(np.arange(2.0), np.arange(3), z, np.zeros((2, 2, 2)), 1.0, floor, extra)


@pytest.mark.parametrize("turn", [0.0, 0.5, -0.5 + math.tau])
def test_way_and_turn_are_compared_with_the_chord_of_an_arc(turn: float) -> None:
    bent = wrap(turn)
    pose = move(KEPT, np.array([0.55 * math.cos(0.5 * bent), 0.55 * math.sin(0.5 * bent), bent + 0.03]))
    model, belief = kept(pose)
    (seen,) = model.innovations(summed(turn), 1, belief)

    def h(x: np.ndarray) -> np.ndarray:
        away, toward = x[:2] - x[3:5], x[2] - x[5]
        middle = x[5] + 0.5 * toward
        return np.array([away @ [math.cos(middle), math.sin(middle)], toward])

    x = np.concatenate((pose, KEPT))
    arc = 0.6 * (math.sin(0.5 * turn) / (0.5 * turn) if turn else 1.0)
    expected = np.array([arc, bent]) - h(x)
    np.testing.assert_allclose(seen.y, [expected[0], wrap(expected[1])], atol=1e-12)
    columns, H, noise = said(seen, belief)
    np.testing.assert_allclose(H, numeric_jacobian(h, x), atol=1e-8)
    R = np.diag((0.04 + 0.01 * 0.36 + 1e-3, 0.03 + 0.01 * turn**2 + 2e-3))
    np.testing.assert_allclose(noise, R, atol=1e-12)
    assert columns == (3, 4, 5)
    assert all(math.isnan(chord_length(1.0, no_number)) for no_number in (math.nan, math.inf, -math.inf))


def test_the_first_reading_and_one_after_a_gap_only_begin() -> None:
    model, belief = kept(KEPT)
    assert model.innovations(summed(0.1, piece=1.0), 1, belief) == []
    fresh = Twist().model(SETTINGS)
    assert fresh.innovations(summed(0.1), 1, belief) == []
