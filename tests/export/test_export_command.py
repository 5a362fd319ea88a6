"""`locfuse export ros`: real logs as files that YAML readers and `init --ekf` take; bad files untouched."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from bags import data_folder, real_log, real_logs
from commands import locfuse
from ros_drive import parameters

SAMPLE = "rounded_rectangle"
BAD: dict[str, tuple[bytes, str]] = {
    "anchor": (b"amcl:\n  ros__parameters:\n    sigma_hit: &a 0.2\n    z_hit: *a\n", "sigma_hit has an anchor"),
    "tab": (b"amcl:\n\tros__parameters: {}\n", "line 2 begins with a tab"),
    "unknown": (b"amcl:\n  ros__parameters:\n    alpha1: 0.2\n    sigma_hitt: 1\n", "amcl has no key sigma_hitt"),
    "binary": (b"\x89PNG\r\n\x1a\n\x00\xff", "not a YAML text"),
    "another": (b"ekf:\n  ros__parameters:\n    odom0: odom\n", "has no section of amcl"),
}


@pytest.mark.parametrize("kind", BAD)
def test_a_file_that_cannot_be_changed_is_said_in_one_line_and_stays(kind: str, tmp_path: Path) -> None:
    data, words = BAD[kind]
    file = tmp_path / "nav2.yaml"
    file.write_bytes(data)
    done = locfuse("export", "ros", SAMPLE, "--to", "amcl", "--as-set", "--into", file)
    assert done.exit_code == 1
    assert words in done.stderr
    assert done.stderr.count("\n") == 1
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
        done = locfuse("export", "ros", SAMPLE, "--to", "amcl", "--as-set", "--into", place)
        assert done.exit_code in {1, 2}, done.stdout
        assert words in done.stderr
        assert done.stderr.count("\n") == 1
    assert file.read_text() == "amcl:\n  ros__parameters:\n    alpha1: 0.2\n"


def test_a_file_that_is_its_own_output_stays_the_link_it_is(tmp_path: Path) -> None:
    assert locfuse("export", "ros", SAMPLE, "--to", "amcl", "--as-set", "-o", tmp_path / "real").exit_code == 0
    link = tmp_path / "nav2.yaml"
    link.symlink_to("real")
    words = ("--to", "amcl", "--as-set", "--into", link, "-o", link, "--overwrite")
    assert locfuse("export", "ros", "disturbed", *words).exit_code == 0
    assert link.is_symlink()
    assert "9108 beams" in (tmp_path / "real").read_text()


def test_a_result_is_exported_with_the_fixes_that_were_tried(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    assert (
        locfuse("compare", "disturbed", "-o", folder, "-q", "--sensors", "compass", "--no-advice").exit_code == 0
    )
    (folder / "fixes.toml").write_text("[compass]\nsigma_deg = 11\n[wheels]\nnoise = 0.001\n")
    done = locfuse("export", "ros", folder, "--to", "fusioncore", "--to", "diff_drive")
    assert done.exit_code == 0, done.stderr
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
    done = locfuse("export", "ros", real_log("warthog/warthog.mcap"), *words, "--to", "diff_drive", "-q")
    assert done.exit_code == 0, done.stderr
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


LOGS = real_logs(".mcap", ".bag", ".db3")


@pytest.mark.parametrize("name", LOGS or [pytest.param("", marks=pytest.mark.skip("LOCFUSE_DATA is not set"))])
def test_every_real_log_is_exported_and_read_again_or_refused_in_one_line(name: str, tmp_path: Path) -> None:
    log, out = data_folder() / name, tmp_path / "ekf.yaml"
    sets = [word for setting in SETS.get(name, ()) for word in ("--set", setting)]
    done = locfuse("export", "ros", log, *sets, "--as-set", "--to", "ekf", "-o", out, "-q")
    if name in REFUSED or (name.startswith("bags/") and name not in MOVES):
        assert (done.exit_code, done.stderr.count("\n"), out.exists()) == (1, 1, False), done.stderr
        assert REFUSED.get(name, "nothing says how the robot moved") in done.stderr
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
