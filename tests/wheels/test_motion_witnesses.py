"""Which motion is taken in a log without a laser: the one that explains what gyro, compass or fixes saw."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from bags import Said
from commands import locfuse, ok
from wheel_bags import chosen, log_of, messages, odometry, turned, twists

from locfuse.cli.analysis.load import load
from locfuse.cli.analysis.settings import LogOptions
from locfuse.fusion.data import Array, LocfuseError
from locfuse.fusion.wheels.motion import Wheels, distances_explained, turns_explained

T = np.arange(0.0, 40.0, 0.1)
TURN = 1.5 * np.sin(0.3 * T)  # rad; 1 m/s along it
STEP = np.stack((np.cos(TURN), np.sin(TURN)), axis=-1) * 0.1
TRUTH = np.column_stack((np.cumsum(STEP, axis=0), TURN))
OTHER = np.column_stack((0.3 * T, 0.0 * T, 0.9 * np.cos(0.8 * T) - 0.9))  # of another robot
METRES_PER_DEGREE = 111_320.0


def imu(turn: Array = TURN, late_s: float = 0.0) -> list[Said]:
    rows = (
        {"angular_velocity": {"z": rate}, "orientation": turned(heading)}
        for rate, heading in zip(np.gradient(turn, T).tolist(), turn.tolist(), strict=True)
    )
    return messages("/imu", "sensor_msgs/msg/Imu", T + late_s, rows, "imu")


def fixes(places: Array) -> list[Said]:
    rows = (
        {"latitude": y / METRES_PER_DEGREE, "longitude": x / METRES_PER_DEGREE}
        for x, y, _ in places[::10].tolist()
    )
    return messages("/fix", "sensor_msgs/msg/NavSatFix", T[::10], rows, "gps")


def speeds(topic: str, turn: Array, frame: str | None = "base_link") -> list[Said]:
    return twists(T, topic, 1.0, np.gradient(turn, T), frame)


# ---- the shares ----


def wheels_of(poses: Array) -> Wheels:
    from locfuse.fusion import se2

    return Wheels.from_twists(T, se2.log(se2.between(poses[:-1], poses[1:])), 0.3, 0.0)


def test_a_motion_explains_its_own_turns_and_ways_and_a_standing_one_none() -> None:
    true, still = wheels_of(TRUTH), wheels_of(np.zeros_like(TRUTH))
    assert turns_explained(true, T, TURN) == pytest.approx(1.0, abs=1e-9)
    assert turns_explained(true, T + 0.5, TURN) == pytest.approx(1.0, abs=0.01)  # a late clock
    assert turns_explained(true, T, -TURN) == pytest.approx(1.0, abs=1e-9)  # an axis that points down
    assert distances_explained(true, T, TRUTH[:, :2]) == pytest.approx(1.0, abs=1e-9)
    assert turns_explained(still, T, TURN) == 0.0
    assert distances_explained(still, T, TRUTH[:, :2]) == 0.0


def test_half_of_every_turn_explains_three_quarters_and_a_sensor_at_rest_nothing() -> None:
    half = wheels_of(np.column_stack((TRUTH[:, :2], 0.5 * TURN)))
    assert turns_explained(half, T, TURN) == pytest.approx(0.75, abs=0.01)
    true = wheels_of(TRUTH)
    assert turns_explained(true, T, 0.01 * TURN) is None
    assert distances_explained(true, T, 0.1 * TRUTH[:, :2]) is None


# ---- which topic is taken ----


def test_of_two_odometries_of_one_kind_the_gyro_chooses_and_without_it_the_user_must(tmp_path: Path) -> None:
    both = odometry(T, OTHER, "/odom1"), odometry(T, TRUTH, "/odom2")
    choice = chosen(tmp_path, *both, imu())
    assert choice.of("wheels") == ("/odom2",)
    (note,) = choice.notes
    assert note.words.startswith("/odom2 is used: /odom1 explains ")
    assert "of the turning of /imu; it explains 100% of the turning of /imu" in note.words
    assert note.fixes == ("wheels.topic=/odom2",)
    with pytest.raises(LocfuseError, match="2 topics that fit: /odom1, /odom2"):
        chosen(tmp_path, *both)


def test_measured_speeds_come_before_an_odometry_that_does_not_turn_as_the_gyro_does(tmp_path: Path) -> None:
    choice = chosen(tmp_path, odometry(T, OTHER), speeds("/base_speed", TURN), imu(late_s=0.4))
    assert choice.of("wheels") == ("/base_speed",)
    assert "/odom explains" in choice.notes[0].words
    assert chosen(tmp_path, odometry(T, TRUTH), speeds("/base_speed", OTHER[:, 2]), imu()).of("wheels") == (
        "/odom",
    )


@pytest.mark.parametrize("half", [False, True], ids=["it never moves", "it ends half-way"])
def test_an_odometry_that_does_not_go_as_far_as_the_fixes_gives_way(half: bool, tmp_path: Path) -> None:
    straight = np.column_stack((1.0 * T, 0.0 * T, 0.0 * T))
    bad = odometry(T[:150], straight[:150]) if half else odometry(T, np.zeros_like(TRUTH))
    choice = chosen(tmp_path, bad, speeds("/base_speed", 0.0 * T), fixes(straight))
    assert choice.of("wheels") == ("/base_speed",)
    assert "of the way between the fixes of /fix" in choice.notes[0].words


def test_where_nothing_judges_two_motions_the_better_kind_is_taken_and_said_to_be_unjudged(tmp_path: Path) -> None:
    choice = chosen(tmp_path, odometry(T, TRUTH), speeds("/base_speed", OTHER[:, 2]))
    assert choice.of("wheels") == ("/odom",)
    assert "of the motion by /base_speed; nothing shows which is right" in choice.notes[0].words
    assert chosen(tmp_path, odometry(T, TRUTH), speeds("/base_speed", TURN)).notes == []


@pytest.mark.parametrize(
    ("said", "words"),
    [
        ([odometry(T, OTHER), speeds("/speed", TURN)], "/odom is used: it explains 0% of the motion by /speed"),
        ([odometry(T[:200], TRUTH[:200]), imu()], "The motion by /odom covers 19.9 s of the 39.9 s of this log. "),
        ([odometry(T, 0.0 * TRUTH), speeds("/cmd_vel", TURN)], "The robot does not move in this log"),
    ],
    ids=["two disagree", "it ends half-way", "all that was measured stands"],
)
def test_what_makes_the_figures_doubtful_comes_before_them(
    said: list[list[Said]], words: str, tmp_path: Path
) -> None:
    log = log_of(tmp_path / "x.mcap", *said)
    done = ok("compare", log, "--no-advice", "-o", tmp_path / "out")
    assert done.stdout.startswith(words)
    assert ("next:" in locfuse("init", log).stderr) == ("not move" not in words)


def test_a_command_is_taken_only_where_nothing_was_measured(tmp_path: Path) -> None:
    command = speeds("/cmd_vel", TURN, None)
    assert chosen(tmp_path, odometry(T, OTHER), command, imu()).of("wheels") == ("/odom",)
    alone = chosen(tmp_path, command, imu())
    assert alone.of("wheels") == ("/cmd_vel",)
    assert alone.notes[0].is_fault


def test_of_two_commands_that_are_named_alike_the_one_that_the_gyro_follows_is_taken(tmp_path: Path) -> None:
    said = speeds("/a/cmd_vel", OTHER[:, 2], None), speeds("/b/cmd_vel", TURN, None)
    choice = chosen(tmp_path, *said, imu())
    assert choice.of("wheels") == ("/b/cmd_vel",)
    assert "/a/cmd_vel explains" in choice.notes[0].words


def test_a_gyro_that_no_motion_explains_judges_nothing(tmp_path: Path) -> None:
    noise = np.cumsum(np.random.default_rng(3).normal(0.0, 0.4, len(T)))
    choice = chosen(tmp_path, odometry(T, TRUTH), speeds("/base_speed", TURN), imu(noise))
    assert choice.of("wheels") == ("/odom",)


def test_what_was_read_to_choose_is_not_read_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from locfuse.cli.analysis import load as loading

    log = log_of(tmp_path / "x.mcap", odometry(T, OTHER, "/odom1"), odometry(T, TRUTH, "/odom2"), imu())
    monkeypatch.setattr(loading, "read_wheels", lambda *_: pytest.fail("the wheels are read twice"))
    assert load([log], LogOptions()).choice.of("wheels") == ("/odom2",)


def test_an_odometry_that_holds_other_sensors_by_its_name_says_so(tmp_path: Path) -> None:
    (note,) = chosen(tmp_path, odometry(T, TRUTH, "/odometry/filtered"), imu()).notes
    assert note.words.startswith("/odometry/filtered already holds other sensors (IMU, GPS), by its name")
    assert chosen(tmp_path, odometry(T, TRUTH, "/odometry/wheel"), imu()).notes == []
