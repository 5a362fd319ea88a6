"""Robots that come with locfuse: every figure has a source, and `init` takes them where a log leaves them open."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from bags import T0, Said, cdr, header, real_log, write
from commands import locfuse, ok
from wheel_bags import CREATE, CREATE_TEXT, TURTLE, TURTLE_TEXT, angles, custom, joint_states, log_of

from locfuse import robots
from locfuse.cli.analysis.robot_tables import make_robot
from locfuse.cli.inspect.template import SIGNS_OF_ROBOTS


@pytest.mark.parametrize("name", robots.names())
def test_every_figure_is_a_setting_and_names_its_source(name: str) -> None:
    figures = robots.figures(name)
    assert {"wheels.radius", "wheels.track"} <= figures.keys()
    tables: dict[str, dict[str, object]] = {}
    for key, figure in figures.items():
        table, _, setting = key.partition(".")
        tables.setdefault(table, {})[setting] = figure.value
        assert len(figure.words) > 10, key
    assert 0.01 < make_robot(tables).wheels.radius < 0.2 < 5 * make_robot(tables).wheels.track  # type: ignore[operator]


def test_every_robot_has_its_signs_and_every_sign_its_robot() -> None:
    assert sorted(SIGNS_OF_ROBOTS) == robots.names()


def ticks(folder: Path, msgtype: str, text: str, fields: tuple[str, str], turns: float) -> Path:
    t, angle = angles()
    counts = np.round(angle * turns / (2 * np.pi)).astype(int).tolist()
    return custom(
        folder / "log.mcap", "/ticks", msgtype, text, t, [dict(zip(fields, row, strict=True)) for row in counts]
    )


def test_ticks_of_a_create_get_its_wheels(tmp_path: Path) -> None:
    log = ticks(tmp_path, CREATE, CREATE_TEXT, ("ticks_left", "ticks_right"), 508.8)
    done = ok("init", log)
    wheels = tomllib.loads(done.stdout)["wheels"]
    assert (wheels["radius"], wheels["track"], wheels["ticks_per_revolution"]) == (0.03575, 0.233, 508.8)
    assert "robots/create3.toml" in done.stdout
    assert "this robot is a create3 (messages of irobot_create_msgs)" in done.stderr
    (tmp_path / "robot.toml").write_text(done.stdout)
    words = ("--robot", tmp_path / "robot.toml", "--write", "tum", "-o", tmp_path / "out")
    assert locfuse("run", log, "--sensors", "odometry", *words).exit_code == 0


def test_what_somebody_says_stays_and_the_rest_is_taken(tmp_path: Path) -> None:
    log = ticks(tmp_path, TURTLE, TURTLE_TEXT, ("left_encoder", "right_encoder"), 4096.0)
    wheels = tomllib.loads(locfuse("init", log, "--set", "wheels.track=0.2").stdout)["wheels"]
    assert (wheels["radius"], wheels["track"]) == (0.033, 0.2)


def test_four_wheels_of_a_husky_are_two_sides(tmp_path: Path) -> None:
    t, angle = angles()
    names = [f"{end}_{side}_wheel_joint" for end in ("front", "rear") for side in ("left", "right")]
    said = [
        Said(
            "/a200_0123/joint_states",
            "sensor_msgs/msg/JointState",
            cdr(
                "sensor_msgs/msg/JointState", header=header(T0 + round(s * 1e9)), name=names, position=[*row, *row]
            ),
            T0 + round(s * 1e9),
        )
        for s, row in zip(t.tolist(), angle.tolist(), strict=True)
    ]
    done = locfuse("init", write(tmp_path / "husky.mcap", said))
    wheels = tomllib.loads(done.stdout)["wheels"]
    assert (wheels["left"], wheels["track"]) == ("rear_left_wheel_joint", 1.040625)
    assert "topics named a200" in done.stderr


def test_a_robot_that_nobody_knows_gets_no_figures(tmp_path: Path) -> None:
    done = locfuse("init", log_of(tmp_path / "own.mcap", joint_states(*angles())))
    assert "radius" not in tomllib.loads(done.stdout)["wheels"]
    assert "robots/" not in done.stdout
    assert "this robot is" not in done.stderr


def test_an_odometry_needs_no_wheels_and_a_mount_that_the_log_tells_stays() -> None:
    done = locfuse("init", real_log("turtlebot4/tb4_mcap.mcap"))
    assert "robots/" not in done.stdout
    assert "radius" not in tomllib.loads(done.stdout).get("wheels", {})
