"""An ekf.yaml of robot_localization: which table each input becomes, and what is said of the rest."""

from pathlib import Path

import pytest

from locfuse.formats.robot.robot_localization import read
from locfuse.fusion.data import LocfuseError

TOPICS = ("/odom", "/vo/odom", "/imu/data", "/amcl_pose", "/robot/gps/odometry", "/scan")


def switches(*on: int) -> str:
    return f"[{', '.join(str(i in on).lower() for i in range(15))}]"


def written(folder: Path, body: str) -> Path:
    path = folder / "ekf.yaml"
    path.write_text(body)
    return path


USUAL = f"""
ekf_filter_node:
    ros__parameters:
        frequency: 30.0
        two_d_mode: true
        world_frame: odom
        odom0: odom
        odom0_config: {switches(6, 7, 11)}
        odom1: /vo/odom
        odom1_config: {switches(0, 1, 5)}
        odom1_differential: true
        imu0: imu/data
        imu0_config: {switches(5, 11, 12)}
        pose0: /amcl_pose
        pose0_config: {switches(0, 1, 5)}
        odom0_pose_rejection_threshold: 5.0
        process_noise_covariance: [0.05]
        initial_state: [1.0, -2.0, 0, 0, 0, 1.5707963267948966, 0, 0, 0, 0, 0, 0, 0, 0, 0]
        odom0_confg: 1
"""


def test_every_input_finds_its_table_and_the_rest_is_said(tmp_path: Path) -> None:
    found = read(written(tmp_path, USUAL), TOPICS)
    assert found.tables == {
        "start": {"x": 1.0, "y": -2.0, "theta_deg": pytest.approx(90.0)},
        "wheels": {"topic": "/odom"},
        "pose": {"topic": "/vo/odom", "frame": "drift"},
        "compass": {"topic": "/imu/data"},
        "gyro": {"topic": "/imu/data"},
    }
    said = "\n".join(found.notes)
    for words in (
        "pose0: [pose] reads one topic, /vo/odom",
        "imu0: accelerations are not used",
        "odom0_pose_rejection_threshold: gates are confidences",
        "process_noise_covariance: noise grows with the way: wheels.noise",
        "odom0_confg: unknown key; did you mean odom0_config?",
    ):
        assert words in said
    assert "frequency" not in said


ODOM = f"odom0: /odom\nodom0_config: {switches(6)}\n"
NODE = "{}:\n  ros__parameters:\n    odom0: /odom\n    odom0_config: " + switches(6) + "\n"
FILES: dict[str, tuple[str, dict[str, dict[str, object]], str]] = {
    "of ROS 1, without a node, a namespace before a topic": (
        f"odom0: gps/odometry\nodom0_config: {switches(0, 1)}\nodom1: /odom\nodom1_config: {switches(6, 11)}\n",
        {"wheels": {"topic": "/robot/gps/odometry"}, "twist": {"topic": "/odom"}},
        "",
    ),
    "a topic that the log lacks": (
        ODOM.replace("/odom\n", "/wheel_odom\n") + ODOM.replace("odom0", "odom1"),
        {"wheels": {"topic": "/odom"}},
        "odom0: this log has no topic /wheel_odom",
    ),
    "points without yaw need the map": (
        f"{ODOM}pose0: /amcl_pose\npose0_config: {switches(0, 1)}\n",
        {"wheels": {"topic": "/odom"}, "pose": {"topic": "/amcl_pose", "frame": "map", "heading": False}},
        "pose0: without yaw",
    ),
    "of two filters the first": (
        NODE.format("ekf_odom") + NODE.format("ekf_map"),
        {"wheels": {"topic": "/odom"}},
        "ekf_map: only ekf_odom is read",
    ),
}


@pytest.mark.parametrize("what", FILES)
def test_a_file_becomes_tables_and_a_note(what: str, tmp_path: Path) -> None:
    body, tables, note = FILES[what]
    found = read(written(tmp_path, body), TOPICS)
    assert found.tables == tables
    assert note in "\n".join(found.notes)


@pytest.mark.parametrize(
    ("body", "says"),
    [
        ("a: [1,", "is no YAML"),
        ("amcl:\n  ros__parameters:\n    alpha1: 0.2\n", "names no input"),
        ("", "names no input"),
        ("odom0: /odom\nodom0_config: [true, false]\n", "odom0_config is not 15 times true or false"),
        (f"odom0: 7\nodom0_config: {switches(6)}\n", "names no input"),
        (f"odom0: /odom\nodom0_config: {switches(6)}\ninitial_state: [.nan]\n", "initial_state is not 15 numbers"),
        ("a: &a [*a]\nodom0: /odom\n", "odom0_config is not 15 times"),
        ("x: !!python/object/apply:os.system [ls]\n", "is no YAML"),
    ],
)
def test_what_is_no_ekf_yaml_is_one_line(body: str, says: str, tmp_path: Path) -> None:
    with pytest.raises(LocfuseError) as error:
        read(written(tmp_path, body), TOPICS)
    assert says in str(error.value)
    assert "\n" not in str(error.value)
