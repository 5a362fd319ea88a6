"""`locfuse init`: the file loads, holds what the log shows, and running with it is never worse than without."""

import math
import tomllib
from pathlib import Path
from typing import Any

import pytest
from bags import T0, Said, cdr, header, real_log, real_logs, write
from commands import Done, locfuse, ok, refused, report_in
from rewrite_log import rewritten
from wheel_bags import GEOMETRY, RADIUS, TRACK, angles, joint_states, log_of, pose_of

from locfuse import sample_logs

URDF = f"""<robot name="r"><link name="base_link"/>
<link name="l"><collision><geometry><cylinder radius="{RADIUS}" length="0.02"/></geometry></collision></link>
<link name="r"/>
<joint name="left_wheel" type="continuous"><parent link="base_link"/><child link="l"/><origin xyz="0 {TRACK / 2} 0"/></joint>
<joint name="right_wheel" type="continuous"><parent link="base_link"/><child link="r"/><origin xyz="0 -{TRACK / 2} 0"/></joint>
</robot>"""  # noqa: E501


def init(log: Any, out: Path, *words: str) -> Done:
    """Run init, write its output where a shell would, and hold what every outcome has in common."""
    done = locfuse("init", log, *words)
    assert done.exit_code in {0, 3}, done.stderr
    assert all(c.isprintable() or c == "\n" for c in done.stdout)
    out.write_text(done.stdout)
    return done


def turned(pose: Any) -> list[float]:
    """x, y and the direction of a heading: it may be wrapped."""
    x, y, theta = pose
    return [float(x), float(y), math.cos(theta), math.sin(theta)]


def final(log: Any, folder: Path, *words: Any) -> tuple[list[float], dict[str, Any]]:
    """Run and return the last pose and run.json."""
    done = locfuse("run", log, "--no-advice", "--no-smooth", "-o", folder, *words)
    assert done.exit_code in {0, 3}, done.stderr
    last = (folder / "trajectory.csv").read_text().splitlines()[-1].split(",")
    return [float(v) for v in last[1:4]], report_in(folder)


@pytest.mark.parametrize("name", sample_logs.names())
def test_a_sample_log_runs_with_it_to_the_same_bytes(name: str, tmp_path: Path) -> None:
    done = init(name, tmp_path / "robot.toml")
    assert locfuse("init", name).stdout == done.stdout
    assert "next: locfuse tune" in done.stderr
    assert "by the log's own robot.toml" in done.stdout
    how = ("--to", "20", "--no-advice", "--no-smooth", "--write", "tum")
    for folder, words in (("without", ()), ("with", ("--robot", tmp_path / "robot.toml"))):
        ok("run", name, *how, "-o", tmp_path / folder, *words)
    without, same = ((tmp_path / f / "trajectory.tum").read_bytes() for f in ("without", "with"))
    assert same == without


def test_geometry_comes_from_the_robot_description(tmp_path: Path) -> None:
    t, angle = angles()
    said = [Said("/robot_description", "std_msgs/msg/String", cdr("std_msgs/msg/String", data=URDF), T0)]
    log = log_of(tmp_path / "x.mcap", said, joint_states(t, angle))
    assert locfuse("run", log, "-o", tmp_path / "out").exit_code == 1
    init(log, tmp_path / "robot.toml")
    wheels = tomllib.loads((tmp_path / "robot.toml").read_text())["wheels"]
    assert {k: wheels[k] for k in ("radius", "track", "left", "right")} == {
        "radius": RADIUS,
        "track": TRACK,
        "left": "left_wheel",
        "right": "right_wheel",
    }
    pose, _ = final(log, tmp_path / "out", "--robot", tmp_path / "robot.toml")
    assert turned(pose) == pytest.approx(turned(pose_of(angle)), abs=1e-6)


def test_what_no_log_tells_is_a_line_behind_a_hash_that_says_what_to_measure(tmp_path: Path) -> None:
    t, angle = angles()
    log = log_of(tmp_path / "x.mcap", joint_states(t, angle))
    done = init(log, tmp_path / "robot.toml")
    assert "fill in wheels.radius, wheels.track" in done.stderr
    assert "locfuse init LOG > robot.toml" in refused("run", log, "-o", tmp_path / "none")
    (tmp_path / "blank.toml").write_text(done.stdout.replace("# radius =", "radius ="))
    assert "not valid TOML" in refused("run", log, "-o", tmp_path / "none", "--robot", tmp_path / "blank.toml")
    text = done.stdout.replace("# radius =", f"radius = {RADIUS}").replace("# track =", f"track = {TRACK}")
    assert text.count(f"radius = {RADIUS}") == text.count(f"track = {TRACK}") == 1
    (tmp_path / "filled.toml").write_text(text)
    pose, _ = final(log, tmp_path / "out", "--robot", tmp_path / "filled.toml")
    assert turned(pose) == pytest.approx(turned(pose_of(angle)), abs=1e-6)


def test_mounts_come_from_tf_static_and_lines_below_a_hash_leave_no_table(tmp_path: Path) -> None:
    t, angle = angles()
    rotation = {"z": 0.5**0.5, "w": 0.5**0.5}
    edge = {
        "header": header(T0, "base_link"),
        "child_frame_id": "laser",
        "transform": {"translation": {"x": 0.25, "y": -0.0625}, "rotation": rotation},
    }
    tf = cdr("tf2_msgs/msg/TFMessage", transforms=[edge])
    scan = cdr("sensor_msgs/msg/LaserScan", header=header(T0 + 10**9, "laser"), range_max=30.0, ranges=[1.0] * 90)
    said = [
        Said("/tf_static", "tf2_msgs/msg/TFMessage", tf, T0),
        Said("/scan", "sensor_msgs/msg/LaserScan", scan, T0 + 10**9),
    ]
    done = init(log_of(tmp_path / "x.mcap", said, joint_states(t, angle)), tmp_path / "robot.toml", *GEOMETRY)
    robot = tomllib.loads(done.stdout)
    assert {k: robot["lrf"][k] for k in ("x", "y", "yaw_deg")} == {"x": 0.25, "y": -0.0625, "yaw_deg": 90.0}
    assert "by /tf_static: where laser sits" in done.stdout
    assert "# [start]" in done.stdout
    assert "start" not in robot


def test_a_place_that_nobody_knows_is_blank_and_not_zero(tmp_path: Path) -> None:
    scan = cdr("sensor_msgs/msg/LaserScan", header=header(T0 + 10**9, "laser"), range_max=30.0, ranges=[1.0] * 90)
    said = [Said("/scan", "sensor_msgs/msg/LaserScan", scan, T0 + 10**9)]
    done = init(log_of(tmp_path / "x.mcap", said, joint_states(*angles())), tmp_path / "robot.toml", *GEOMETRY)
    lrf = done.stdout.partition("[lrf]")[2].splitlines()
    assert {"# x =", "# y =", "# yaw_deg ="} <= set(lrf)


def test_where_several_topics_fit_the_first_is_a_guess_and_the_others_are_named(tmp_path: Path) -> None:
    odometry = "nav_msgs/msg/Odometry"
    said = [
        Said(
            topic,
            odometry,
            cdr(odometry, header=header(ns, "odom"), pose={"pose": {"orientation": {"w": 1.0}}}),
            ns,
        )
        for topic in ("/odom", "/odom2")
        for ns in range(T0, T0 + 10**10, 10**8)
    ]
    log = log_of(tmp_path / "x.mcap", said)
    assert locfuse("run", log, "-o", tmp_path / "out").exit_code == 1
    done = init(log, tmp_path / "robot.toml")
    assert tomllib.loads(done.stdout)["wheels"]["topic"] == "/odom"
    words = " ".join(done.stdout.replace("\n#", " ").split())
    assert "guess:" in words
    assert "/odom2" in words
    final(log, tmp_path / "out", "--robot", tmp_path / "robot.toml")


def test_a_camera_lacks_its_landmark_and_runs_once_it_has_it(tmp_path: Path) -> None:
    log = rewritten(tmp_path / "x.mcap", robot="", keep=lambda topic, t: t < 30.0)
    words = ("--set", "wheels.radius=0.05", "--set", "wheels.track=0.6")
    done = init(log, tmp_path / "robot.toml", *words)
    assert "fill in camera.landmark" in done.stderr
    robot = tomllib.loads(done.stdout)
    assert robot["camera"]["topic"] == "/omni/image/compressed"
    assert robot["lrf"]["x"] == 0.2  # by /tf_static
    assert {"x", "y", "theta_deg"} <= robot["start"].keys()  # by the truth
    _, before = final(log, tmp_path / "out", *words)
    _, after = final(log, tmp_path / "out", "--robot", tmp_path / "robot.toml")
    assert rmse(after) < 0.1 * rmse(before)
    text = done.stdout.replace("# landmark =", "landmark = [7.9, 5.5]")
    (tmp_path / "robot.toml").write_text(text)
    _, report = final(log, tmp_path / "out", "--robot", tmp_path / "robot.toml", "--sensors", "camera")
    assert report["configurations"]["camera"]["sensors"]["camera"]["accepted"] > 25


def test_what_a_user_said_stays_and_what_the_log_shows_beside_it_is_behind_a_hash(tmp_path: Path) -> None:
    log = rewritten(tmp_path / "x.mcap", robot="", keep=lambda topic, t: t < 10.0)
    sets = ("wheels.radius=0.05", "wheels.track=0.6", "start.x=7.25")
    done = init(log, tmp_path / "robot.toml", *(word for s in sets for word in ("--set", s)))
    assert tomllib.loads(done.stdout)["start"]["x"] == 7.25
    assert "\n# x = 1.5" in done.stdout


def test_a_topic_with_an_evil_name_cannot_leave_its_line(tmp_path: Path) -> None:
    t, angle = angles()
    evil = '/a\n[wheels]\nradius = 9 \x1b[31m"\x7f'
    log = write(tmp_path / "x.mcap", [m._replace(topic=evil) for m in joint_states(t, angle)])
    done = init(log, tmp_path / "robot.toml", *GEOMETRY)
    wheels = tomllib.loads(done.stdout)["wheels"]
    assert wheels["topic"] == evil
    assert wheels["radius"] == RADIUS
    final(log, tmp_path / "out", "--robot", tmp_path / "robot.toml")


def test_a_damaged_log_is_looked_at_all_the_same_and_the_loss_is_counted(tmp_path: Path) -> None:
    t, angle = angles()
    whole = log_of(tmp_path / "x.mcap", joint_states(t, angle)).read_bytes()
    (tmp_path / "x.mcap").write_bytes(whole[: len(whole) // 2])
    done = init(tmp_path / "x.mcap", tmp_path / "robot.toml", *GEOMETRY)
    assert done.exit_code == 3
    assert "lost:" in done.stderr
    assert "lost:" in locfuse("init", tmp_path / "x.mcap", "-q").stderr
    assert tomllib.loads(done.stdout)["wheels"]["topic"] == "/joint_states"


def test_a_log_that_cannot_run_still_gives_a_file_that_loads(tmp_path: Path) -> None:
    said = [Said("/chatter", "std_msgs/msg/String", cdr("std_msgs/msg/String", data="hello"), T0)]
    done = init(write(tmp_path / "x.mcap", said), tmp_path / "robot.toml")
    assert "this log cannot run: the robot's motion is unknown: x has no wheels" in done.stderr
    assert tomllib.loads(done.stdout) == {}


@pytest.mark.parametrize("name", [n for n in real_logs() if n.startswith("bags")] or ["none"])
def test_every_real_log_gives_a_file_that_loads_and_stops_no_run(name: str, tmp_path: Path) -> None:
    log = real_log(name)
    init(log, tmp_path / "robot.toml")
    words = ("run", log, "-o", tmp_path / "out", "--overwrite", "-q")
    codes = [locfuse(*words, *more).exit_code for more in ((), ("--robot", tmp_path / "robot.toml"))]
    assert codes[0] == codes[1]


BRENNER = ("--set", "wheels.radius=0.0199962", "--set", "wheels.track=0.155")


def test_a_real_log_with_truth_is_much_better_with_it(tmp_path: Path) -> None:
    """Start, clock lag and the laser's metre are found (on the Freiburg corridor: 3.6 m become 0.17 m)."""
    log = real_log("brenner/brenner.mcap")
    init(log, tmp_path / "robot.toml", *BRENNER)
    _, without = final(log, tmp_path / "out", *BRENNER)
    _, after = final(log, tmp_path / "out", "--robot", tmp_path / "robot.toml")
    assert rmse(after) < 0.1 * rmse(without)


def test_the_turtlebots_laser_stands_turned_by_90_degrees_and_late(tmp_path: Path) -> None:
    log = real_log("turtlebot4")
    robot = tomllib.loads(init(log, tmp_path / "robot.toml").stdout)
    assert robot["lrf"]["yaw_deg"] == pytest.approx(90.0, abs=0.1)
    assert robot["lrf"]["time_offset"] == pytest.approx(-0.18, abs=0.03)
    assert robot["lrf"]["sweep"] == "backward"
    _, without = final(log, tmp_path / "out")
    _, after = final(log, tmp_path / "out", "--robot", tmp_path / "robot.toml")
    before, now = (r["configurations"]["lrf"]["sensors"]["lrf"] for r in (without, after))
    # of two lines that one uneven wall became none is taken: that contradicts nothing, and how many do is chance
    contradicting = [sum(s["verdicts"].get(v, 0) for v in ("unmatched", "lost")) for s in (before, now)]
    assert contradicting[1] < 0.75 * contradicting[0]
    assert abs(now["nis"] - 1.0) < 0.25 * abs(before["nis"] - 1.0)
    assert not any("slip" in words for words in after["configurations"]["lrf"]["notes"])


def rmse(report: dict[str, Any]) -> float:
    """Return the position error, also one that is void because the truth starts elsewhere."""
    configuration = next(iter(report["configurations"].values()))
    found = configuration["void"]["figures"] if configuration.get("void") else configuration
    return float(found["position_rmse_m"])
