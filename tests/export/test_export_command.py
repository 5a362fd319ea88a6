"""`locfuse export ros`: real logs as files that YAML readers and `init --ekf` take; bad files untouched."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from bags import T0, S, Said, cdr, data_folder, header, real_log, real_logs, write
from commands import locfuse, ok, refused
from pose_streams import reckoned
from ruamel.yaml import YAML
from scipy.ndimage import distance_transform_edt
from wheel_bags import placed, turned

from locfuse import load
from locfuse.fusion.data import Array

SAMPLE = "rounded_rectangle"
BAD: dict[str, tuple[bytes, str]] = {
    "anchor": (b"amcl:\n  ros__parameters:\n    sigma_hit: &a 0.2\n    z_hit: *a\n", "sigma_hit has an anchor"),
    "binary": (b"\x89PNG\r\n\x1a\n\x00\xff", "not a YAML text"),
}


# --- a drive as a ROS 2 robot records it: odometry, an IMU, a localiser's pose, and the truth; all noise is white

RATE_HZ = 20
NOISE_M, TRACK_M = 4e-4, 0.3  # variance of a wheel per metre; an odometry's track in locfuse
SIGMA_YAW, SIGMA_RATE, SIGMA_POSE = 0.02, 0.004, 0.03  # rad, rad/s, m
ODOMETRY, IMU = "nav_msgs/msg/Odometry", "sensor_msgs/msg/Imu"
POSE, STAMPED = "geometry_msgs/msg/PoseWithCovarianceStamped", "geometry_msgs/msg/PoseStamped"


def parameters(text: str, node: str) -> dict[str, Any]:
    """The parameters of one node of an exported file."""
    yaml = YAML(typ="safe", pure=True)
    yaml.version = (1, 1)  # as libyaml reads it for ROS
    found: dict[str, Any] = yaml.load(text)[node]["ros__parameters"]
    return found


def speeds(t: Array) -> Array:
    """Forward speed and turning rate (n, 2): at rest for two seconds, then a winding path."""
    begun = np.clip(t - 2.0, 0.0, 1.0)[:, None]
    return begun * np.column_stack((0.4 + 0.1 * np.sin(0.3 * t), 0.5 * np.sin(0.25 * (t - 2.0))))


def drive(path: Path, seconds: float = 60.0, seed: int = 3) -> Path:
    """Write the drive to an .mcap file."""
    rng = np.random.default_rng(seed)
    dt, n = 1.0 / RATE_HZ, int(seconds * RATE_HZ)
    t: Array = np.arange(n, dtype=np.float64) * np.float64(dt)
    true = speeds(t + np.float64(0.5 * dt))  # over each period
    grown = (
        NOISE_M * 2.0 * np.abs(true[:, 0]) * dt
    )  # both wheels; rolled by half the track more or less they are alike
    noise = np.column_stack((np.sqrt(0.25 * grown), np.sqrt(grown) / TRACK_M)) / dt
    told = true + noise * rng.standard_normal((n, 2))
    poses, odometry = reckoned(true * dt), placed(reckoned(told * dt))
    true_poses = placed(poses)
    said: list[Said] = []
    for i in range(n):
        stamp = T0 + i * S // RATE_HZ + S // RATE_HZ
        v, w = told[i]
        body = {"pose": odometry[i + 1], "covariance": np.zeros(36)}
        twist = {"twist": {"linear": {"x": v}, "angular": {"z": w}}, "covariance": np.zeros(36)}
        message = cdr(ODOMETRY, header=header(stamp, "odom"), child_frame_id="base_link", pose=body, twist=twist)
        said.append(Said("/odom", ODOMETRY, message, stamp, i))
        yaw = poses[i + 1, 2] + SIGMA_YAW * rng.standard_normal()
        rate = speeds(t[i : i + 1] + np.float64(dt))[0, 1] + SIGMA_RATE * rng.standard_normal()
        imu = cdr(
            IMU,
            header=header(stamp, "base_link"),
            orientation=turned(yaw),
            orientation_covariance=np.diag([1e-4, 1e-4, SIGMA_YAW**2]).ravel(),
            angular_velocity={"z": rate},
            angular_velocity_covariance=np.diag([1e-5, 1e-5, SIGMA_RATE**2]).ravel(),
            linear_acceleration={"z": 9.81},
        )
        said.append(Said("/imu", IMU, imu, stamp, i))
        truth = cdr(STAMPED, header=header(stamp, "map"), pose=true_poses[i + 1])
        said.append(Said("/ground_truth/pose", STAMPED, truth, stamp, i))
        if i % 10 == 0:
            x, y, theta = poses[i + 1] + rng.standard_normal(3) * (SIGMA_POSE, SIGMA_POSE, SIGMA_YAW)
            covariance = np.diag([SIGMA_POSE**2, SIGMA_POSE**2, 0, 0, 0, SIGMA_YAW**2]).ravel()
            given = {"pose": placed(np.array([[x, y, theta]]))[0], "covariance": covariance}
            said.append(Said("/amcl_pose", POSE, cdr(POSE, header=header(stamp, "map"), pose=given), stamp, i))
    return write(path, said)


@pytest.mark.parametrize("kind", BAD)
def test_a_file_that_cannot_be_changed_is_said_in_one_line_and_stays(kind: str, tmp_path: Path) -> None:
    data, words = BAD[kind]
    file = tmp_path / "nav2.yaml"
    file.write_bytes(data)
    assert words in refused("export", "ros", SAMPLE, "--to", "amcl", "--as-set", "--into", file)
    assert file.read_bytes() == data
    assert [path.name for path in tmp_path.iterdir()] == ["nav2.yaml"]


def test_a_read_only_file_a_folder_and_a_missing_one_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "nav2.yaml"
    file.write_text("amcl:\n  ros__parameters:\n    alpha1: 0.2\n")
    file.chmod(0o444)
    for place, words in (
        (file, "is read-only"),
        (tmp_path, "is a directory"),
        (tmp_path / "no", "cannot be read"),
    ):
        assert words in refused("export", "ros", SAMPLE, "--to", "amcl", "--as-set", "--into", place, code=None)
    assert file.read_text() == "amcl:\n  ros__parameters:\n    alpha1: 0.2\n"


def test_a_file_that_is_its_own_output_stays_the_link_it_is(tmp_path: Path) -> None:
    ok("export", "ros", SAMPLE, "--to", "amcl", "--as-set", "-o", tmp_path / "real")
    (tmp_path / "real").chmod(0o640)
    link = tmp_path / "nav2.yaml"
    link.symlink_to("real")
    words = ("--to", "amcl", "--as-set", "--into", link, "-o", link, "--overwrite")
    ok("export", "ros", "disturbed", *words)
    assert link.is_symlink()
    assert (tmp_path / "real").stat().st_mode & 0o777 == 0o640
    assert "9108 beams" in (tmp_path / "real").read_text()


def test_a_result_is_exported_with_the_fixes_that_were_tried(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    ok("compare", "disturbed", "-o", folder, "-q", "--sensors", "compass", "--no-advice")
    (folder / "fixes.toml").write_text("[compass]\nsigma_deg = 11\n[wheels]\nnoise = 0.001\n")
    done = ok("export", "ros", folder, "--to", "fusioncore", "--to", "diff_drive")
    found = parameters(done.stdout, "fusioncore")
    assert found["magnetometer.noise_rad"] == pytest.approx(0.19199, rel=1e-3)
    assert "magnetometer.noise_rad: 0.192  # found: rad; compass.sigma_deg by fixes.toml" in done.stdout
    lines = [line for line in done.stdout.splitlines()[3:] if line.strip()]
    assert [line for line in lines if " # " not in f" {line}"] == []


def test_a_result_whose_log_is_not_there_says_so(tmp_path: Path) -> None:
    (tmp_path / "report.json").write_text('{"repeat": "locfuse compare gone.mcap", "changed_settings": {}}')
    done = locfuse("export", "ros", tmp_path, "--to", "ekf")
    assert done.exit_code != 0
    assert "gone.mcap" in done.stderr
    assert done.stderr.count("\n") == 1


def test_on_the_warthog_the_wheels_stand_wider_apart_than_its_data_sheet_says() -> None:
    sets = ("wheels.radius=0.30", "wheels.track=1.14", "truth.topic=/icp_pose")
    words = [word for setting in sets for word in ("--set", setting)]
    done = ok("export", "ros", real_log("warthog/warthog.mcap"), *words, "--to", "diff_drive", "-q")
    found = parameters(done.stdout, "diff_drive_controller")
    assert found["wheel_separation"] == 1.14
    assert 1.56 < found["wheel_separation_multiplier"] < 1.63
    radii = [found[f"{side}_wheel_radius_multiplier"] * 0.30 for side in ("left", "right")]
    assert 0.5 * sum(radii) == pytest.approx(0.286, rel=0.02)


SETS = {  # without which a log does not run
    "brenner/brenner.mcap": ("wheels.radius=0.0199962", "wheels.track=0.173"),
    "warthog/warthog.mcap": ("wheels.radius=0.30", "wheels.track=1.14"),
    "mrclam/mrclam.mcap": ("wheels.topic=/odom",),
    "uwb/labyrinth_uwb.mcap": ("wheels.radius=1", "wheels.track=0.157"),
}
REFUSED = {  # logs that no settings make run; all others in `bags` say nothing of how the robot moved
    "strangers/marker_in_camera.bag": "of something that a camera sees",
    "strangers/setpoints.bag": "poses that were asked for",
    "strangers/sideways.bag": "it moves sideways",
    "bags/rosbag2parquet/array_msgs_0.mcap": "wheels.radius and wheels.track must be known",
    "bags/rosbag2parquet/base_msgs_0.mcap": "/one_shot/twist has 1 usable readings of 1; two are the least",
}
MOVES = {"bags/evo/nav2_turtlebot.mcap", "bags/rosbags-rs/test_bag_mcap.mcap"}
TWINS = {"strangers/controller_twist.bag", "strangers/pimouse.bag", "aces/aces.mcap", "turtlebot4/tb4_mcap.mcap"}
# of each kind that takes seconds one: scans alone, an odometry with a laser, a building, a turtlebot
LOGS = [name for name in real_logs(".mcap", ".bag", ".db3") if name not in TWINS]


@pytest.mark.parametrize("name", LOGS or [pytest.param("", marks=pytest.mark.skip("LOCFUSE_DATA is not set"))])
def test_every_real_log_is_exported_and_read_again_or_refused_in_one_line(name: str, tmp_path: Path) -> None:
    log, out = data_folder() / name, tmp_path / "ekf.yaml"
    sets = [word for setting in SETS.get(name, ()) for word in ("--set", setting)]
    done = locfuse("export", "ros", log, *sets, "--as-set", "--to", "ekf", "-o", out, "-q")
    if name in REFUSED or (name.startswith("bags/") and name not in MOVES):
        assert (done.exit_code, done.stderr.count("\n"), out.exists()) == (1, 1, False), done.stderr
        assert REFUSED.get(name, "the robot's motion is unknown") in done.stderr
        return
    assert done.exit_code in {0, 3}, done.stderr
    found = parameters(out.read_text(), "ekf_filter_node")
    assert len(found["process_noise_covariance"]) == 225
    again = locfuse("init", log, "--ekf", out, *sets, "-o", tmp_path / "robot.toml", "-q")
    assert again.exit_code in {0, 3}, again.stderr
    _same_topics(found, (tmp_path / "robot.toml").read_text(), again.stderr + again.stdout)


def _same_topics(found: dict[str, Any], robot: str, said: str) -> None:
    """Every input's topic is in robot.toml, but for the odometry that a driver is to make of other wheels."""
    for name, topic in found.items():
        if name in {"odom0", "imu0", "pose0", "twist0"}:
            assert f'topic = "{topic}"' in robot or f"{name}: this log has no topic {topic}" in said


# --- aMCL's parameters: a likelihood field made by hand prefers the exported sigma_hit; steps are as noisy

CELL_M = 0.05
WALLS = [  # of the sample log's room, m
    *((0, 0, 8, 0), (8, 0, 8, 6), (8, 6, 0, 6), (0, 6, 0, 0)),
    *((3, 0, 3, 1), (5, 6, 5, 5.4), (8, 3, 7, 3), (0, 5.2, 0.8, 5.2)),
]


@pytest.fixture(scope="module")
def amcl() -> dict[str, Any]:
    done = ok("export", "ros", "rounded_rectangle", "--to", "amcl", "--as-set", "-q")
    return parameters(done.stdout, "amcl")


def field() -> Array:
    """Distance [m] of every cell from the nearest cell with a wall, as AMCL makes it from a map of 5 cm cells."""
    cells = np.zeros((140, 180), bool)  # from (-0.5, -0.5) m
    for x1, y1, x2, y2 in WALLS:
        t = np.linspace(0.0, 1.0, 2000)
        column = ((x1 + t * (x2 - x1) + 0.5) / CELL_M).astype(int)
        row = ((y1 + t * (y2 - y1) + 0.5) / CELL_M).astype(int)
        cells[row, column] = True
    return np.asarray(CELL_M * distance_transform_edt(~cells))


def ends() -> Array:
    """Where beams end [m], each seen from the true pose at its own instant."""
    log = load("rounded_rectangle").log
    truth, scans = log.stream("/ground_truth/pose"), log.stream("/scan")
    pose = cast("dict[str, Array]", truth.columns("pose.position.x", "pose.position.y"))
    turn = cast("dict[str, Array]", truth.columns("pose.orientation.z", "pose.orientation.w"))
    yaw = np.unwrap(2.0 * np.arctan2(turn["pose.orientation.z"], turn["pose.orientation.w"]))
    fields = ("ranges", "angle_min", "angle_increment", "time_increment")
    columns: dict[str, Any] = scans.columns(*fields)
    found = []
    for i in range(0, len(scans.t_ns), 10):
        r = np.asarray(columns["ranges"][i], float)
        beam = np.arange(len(r))
        t = scans.t_ns[i] + beam * columns["time_increment"][i] * 1e9
        x, y = (np.interp(t, truth.t_ns, column) for column in pose.values())
        theta = np.interp(t, truth.t_ns, yaw)
        angle = theta + columns["angle_min"][i] + beam * columns["angle_increment"][i]
        good = np.isfinite(r) & (r > 0.05) & (beam % 6 == 0)
        at = np.column_stack(
            (x + 0.2 * np.cos(theta) + r * np.cos(angle), y + 0.2 * np.sin(theta) + r * np.sin(angle))
        )
        found.append(at[good])
    return np.concatenate(found)


def test_a_likelihood_field_prefers_the_exported_sigma_to_half_and_to_twice_of_it(amcl: dict[str, Any]) -> None:
    points, distance = ends(), field()
    column, row = ((points + 0.5) / CELL_M).astype(int).T
    d = distance[row.clip(0, 139), column.clip(0, 179)]

    def likelihood(sigma: float) -> float:
        hit = amcl["z_hit"] * np.exp(-0.5 * (d / sigma) ** 2) / (np.sqrt(2.0 * np.pi) * sigma)
        return float(np.log(hit + amcl["z_rand"] / amcl["laser_max_range"]).mean())

    best = likelihood(amcl["sigma_hit"])
    assert best > likelihood(0.5 * amcl["sigma_hit"]) + 0.05
    assert best > likelihood(2.0 * amcl["sigma_hit"]) + 0.05


def test_a_step_is_as_noisy_in_amcl_as_wheels_of_the_log_make_it(amcl: dict[str, Any]) -> None:
    """Drawn by hand: wheels of variance 4e-4 m per metre, 0.6 m apart, over one step of AMCL."""
    rng = np.random.default_rng(0)
    k, track, n = 4e-4, 0.6, 200_000
    d, a = amcl["update_min_d"], amcl["update_min_a"]
    straight = d + np.sqrt(k * d) * rng.standard_normal((n, 2))
    rolled = 0.5 * a * track
    spot = np.array([-rolled, rolled]) + np.sqrt(k * rolled) * rng.standard_normal((n, 2))
    turn, way = (straight[:, 1] - straight[:, 0]) / track, straight.mean(axis=1)
    assert 2.0 * amcl["alpha2"] * d**2 == pytest.approx(turn.var(), rel=0.03)
    assert amcl["alpha3"] * d**2 == pytest.approx(way.var(), rel=0.03)
    turn, way = (spot[:, 1] - spot[:, 0]) / track, spot.mean(axis=1)
    assert amcl["alpha1"] * a**2 == pytest.approx(turn.var(), rel=0.03)
    assert amcl["alpha4"] * a**2 == pytest.approx(way.var(), rel=0.03)


def test_values_go_into_the_users_file_and_nothing_else_changes(tmp_path: Path) -> None:
    file = tmp_path / "nav2.yaml"
    text = (
        "amcl:\n  ros__parameters:\n    alpha1: 0.2   # turning\n    update_min_d: 0.5\n    sigma_hit: 0.2\n"
        "    z_hit: 0.5\nbt_navigator:\n  ros__parameters:\n    alpha1: 7\n"
    )
    file.write_text(text.replace("    alpha1: 7\n", "    x: 7\n"))
    done = ok("export", "ros", "rounded_rectangle", "--to", "amcl", "--as-set", "--into", file)
    now = file.read_text().splitlines()
    assert [line.partition(":")[0] for line in now] == [
        line.partition(":")[0] for line in text.replace("alpha1: 7", "x: 7").splitlines()
    ]
    assert now[2].endswith("   # turning")
    assert now[3] == "    update_min_d: 0.5"
    assert f"+{now[4]}" in done.stdout.splitlines()
    assert "z_rand: 0.0" in done.stdout
    assert "not in the file, add it by hand" in done.stdout


def test_a_second_export_changes_nothing_and_does_not_write(tmp_path: Path) -> None:
    file = tmp_path / "nav2.yaml"
    file.write_text("amcl:\n  ros__parameters:\n    alpha1: 0.2\n    sigma_hit: 0.2  # found: m: of another log\n")
    words = ("export", "ros", "rounded_rectangle", "--to", "amcl", "--as-set", "--into", file)
    assert locfuse(*words).stdout.splitlines()[-1] == f"{file}: written"
    text, inode = file.read_text(), file.stat().st_ino
    assert "of another log" not in text
    assert locfuse(*words).stdout.splitlines()[-1] == f"{file}: nothing to change"
    assert (file.read_text(), file.stat().st_ino) == (text, inode)


# --- an exported ekf.yaml in an emulation of robot_localization, written from its documents

KEPT = [0, 1, 5, 6, 7, 11, 12, 13]  # of the 15 states
YAW = 2


class Emulated:
    """The filter."""

    def __init__(self, parameters: dict[str, Any]) -> None:
        Q = np.array(parameters["process_noise_covariance"], float).reshape(15, 15)
        self.Q = Q[np.ix_(KEPT, KEPT)]
        self.x, self.P, self.t = np.zeros(8), 1e-9 * np.eye(8), 0.0
        self.nis: dict[str, list[float]] = {}
        self.refused = 0

    def predict(self, t: float) -> None:
        dt, self.t = t - self.t, t
        if dt <= 0.0:
            return
        yaw, vx, vy, w, ax, ay = self.x[2:]
        c, s = np.cos(yaw), np.sin(yaw)
        along, aside = vx * dt + 0.5 * ax * dt**2, vy * dt + 0.5 * ay * dt**2
        F = np.eye(8)
        F[0, 2:] = -s * along - c * aside, c * dt, -s * dt, 0.0, 0.5 * c * dt**2, -0.5 * s * dt**2
        F[1, 2:] = c * along - s * aside, s * dt, c * dt, 0.0, 0.5 * s * dt**2, 0.5 * c * dt**2
        F[2, 5] = F[3, 6] = F[4, 7] = dt
        F[2, 2] = F[3, 3] = 1.0
        moved = (c * along - s * aside, s * along + c * aside, w * dt, ax * dt, ay * dt, 0.0, 0.0, 0.0)
        self.x = self.x + np.array(moved)
        self.P = F @ self.P @ F.T + dt * self.Q

    def update(self, name: str, places: list[int], z: list[float], variances: list[float], limit: float) -> None:
        H = np.eye(8)[places]
        y = np.array(z) - self.x[places]
        y = np.where(np.array(places) == YAW, (y + np.pi) % (2 * np.pi) - np.pi, y)
        S = H @ self.P @ H.T + np.diag(np.maximum(variances, 1e-9))
        square = float(y @ np.linalg.solve(S, y))
        if square >= limit**2:
            self.refused += 1
            return
        if self.t > 5.0:
            self.nis.setdefault(name, []).append(square / len(places))
        K = self.P @ H.T @ np.linalg.inv(S)
        self.x, A = self.x + K @ y, np.eye(8) - K @ H
        self.P = A @ self.P @ A.T + K @ np.diag(np.maximum(variances, 1e-9)) @ K.T


def covariances(text: str) -> dict[str, float]:
    """What the driver's messages must say: "vx 0.004 (m/s)^2" in the comments."""
    found = re.findall(r"(vx|vyaw|yaw|angular_velocity, z) (\S+) (?:\(?rad|\(?m)", text)
    return {name: float(value) for name, value in found}


def readings(session: Any) -> Iterator[tuple[float, str, list[float]]]:
    """Raw readings in order: time, topic, what the filter can take of them."""
    found: list[tuple[float, str, list[float]]] = []
    begin = None
    for topic, fields in (
        ("/odom", ("twist.twist.linear.x", "twist.twist.angular.z")),
        ("/imu", ("orientation.z", "orientation.w", "angular_velocity.z")),
        (
            "/amcl_pose",
            ("pose.pose.position.x", "pose.pose.position.y", "pose.pose.orientation.z", "pose.pose.orientation.w"),
        ),
    ):
        stream = session.log.stream(topic)
        begin = stream.t_ns[0] if begin is None else begin
        columns = np.column_stack([np.asarray(c, float) for c in stream.columns(*fields).values()])
        times = ((stream.t_ns - begin) * 1e-9).tolist()
        found.extend(zip(times, [topic] * len(times), columns.tolist(), strict=True))
    yield from sorted(found, key=lambda one: one[0])


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return drive(tmp_path_factory.mktemp("drive") / "drive.mcap")


@pytest.fixture(scope="module")
def exported(log: Path) -> str:
    sets = ("--set", "pose.topic=/amcl_pose", "--set", "pose.frame=map")
    done = ok("export", "ros", log, *sets, "--to", "ekf", "--to", "diff_drive", "-q")
    return done.stdout


def test_every_sensor_is_as_far_off_as_the_exported_file_says(log: Path, exported: str) -> None:
    found, told = parameters(exported, "ekf_filter_node"), covariances(exported)
    emulated = Emulated(found)
    limits = {key: value for key, value in found.items() if key.endswith("rejection_threshold")}
    for t, topic, values in readings(load(log)):
        emulated.predict(t)
        if topic == "/odom":
            assert [found["odom0_config"][place] for place in (6, 11)] == [True, True]
            emulated.update(topic, [3, 5], values, [told["vx"], told["vyaw"]], np.inf)
        elif topic == "/imu":
            yaw = 2.0 * np.arctan2(values[0], values[1])
            assert found["imu0_differential"] is False  # of the map, as the pose is
            emulated.update("yaw", [YAW], [yaw], [told["yaw"]], limits["imu0_pose_rejection_threshold"])
            emulated.update("rate", [5], values[2:], [told["angular_velocity, z"]], np.inf)
        else:
            heading = 2.0 * np.arctan2(values[2], values[3])
            R = [SIGMA_POSE**2, SIGMA_POSE**2, SIGMA_YAW**2]
            emulated.update(topic, [0, 1, 2], [*values[:2], heading], R, limits["pose0_rejection_threshold"])
    means = {name: float(np.mean(values)) for name, values in emulated.nis.items()}
    assert set(means) == {"/odom", "yaw", "rate", "/amcl_pose"}
    assert all(0.8 < mean < 1.25 for mean in means.values()), means
    assert emulated.refused <= 3  # of 2500


@pytest.mark.parametrize("log", ["rounded_rectangle", "rounded_triangle"])
def test_by_the_wheels_alone_it_is_as_uncertain_as_our_filter_and_its_twists_are_as_expected(log: str) -> None:
    """Their noise is slip, which no reading of the odometry shows."""
    done = locfuse("export", "ros", log, "--to", "ekf", "--as-set", "-q")
    told, emulated, session = (
        covariances(done.stdout),
        Emulated(parameters(done.stdout, "ekf_filter_node")),
        load(log),
    )
    wheels = session.drive.wheels
    speeds = wheels.twist[:, [0, 2]] / np.diff(wheels.t)[:, None]
    for t, twist in zip(wheels.t[1:], speeds, strict=True):
        emulated.predict(float(t))
        emulated.update("twist", [3, 5], twist.tolist(), [told["vx"], told["vyaw"]], np.inf)
    ours = session.run("odometry", advice=False).filtered.P[-1]
    assert np.sqrt(np.diag(emulated.P)[:3]) == pytest.approx(np.sqrt(np.diag(ours)), rel=0.05)
    assert 0.8 < np.mean(emulated.nis["twist"]) < 1.25


def test_fusioncore_names_every_sensor_that_it_has_no_parameters_for(log: Path) -> None:
    sets = ("--set", "pose.topic=/amcl_pose", "--set", "pose.frame=map")
    done = ok("export", "ros", log, *sets, "--to", "fusioncore", "--as-set", "-q")
    comments = [line.split(":")[0].strip("# ") for line in done.stdout.splitlines() if "cannot be mapped" in line]
    assert comments == ["compass", "pose"]
    assert "gyro_noise" in done.stdout
