"""Descriptions of a robot built to take memory or minutes."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from commands import locfuse
from hostile import write

from locfuse.formats.caps import MAX_DOTS, MAX_JOINTS, MAX_KEYS, MAX_ROBOT_TOML, MAX_TRANSFORMS
from locfuse.formats.robot import line_map
from locfuse.formats.robot.robot_toml import apply_sets, parse
from locfuse.formats.robot.transforms import FIELDS, StaticTransforms, Transform, planar_mount, static_transforms
from locfuse.formats.robot.urdf import wheel_geometry
from locfuse.fusion.data import LocfuseError, Ragged, UsageError


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (".".join(["a"] * 400) + " = 1", "tables in tables: 17 deep, more than the cap of 16"),
        (".".join(["a"] * (MAX_DOTS + 2)) + " = 1", "too many dots in a line: 501, more than the cap of 500"),
        (".".join(["a"] * 60_000) + " = 1", "too many dots"),
        ("#" * (MAX_ROBOT_TOML + 1), "more than the cap of 131 072"),
        ("[wheels]\nradius = " + "9" * 5000, "not valid TOML"),
        ("[wheels]\nradius = 0x" + "f" * 9000, "an integer of more than 4300 digits"),
        ("a = [" + "1," * (MAX_KEYS + 1) + "]", "too many keys"),
        ("a = " + "[" * 5000 + "]" * 5000, "nested too deeply"),
    ],
)
def test_a_robot_toml_beyond_a_cap_is_refused_in_one_line(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(LocfuseError, match=words):
        parse(text, "robot.toml")
    done = locfuse("info", write(tmp_path / "f.mcap", robot=text.encode(), seconds=0.5))
    assert done.exit_code == 1
    assert words in done.stderr
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize(
    "text", ["wheels.radius=" + "9" * 5000, "a." * 2000 + "b=1", "wheels.radius=0x" + "f" * 9000]
)
def test_a_set_beyond_a_cap_is_refused_in_one_line(tmp_path: Path, text: str) -> None:
    done = locfuse("info", write(tmp_path / "f.mcap", seconds=0.5), "--set", text)
    assert done.exit_code == 2
    assert len(done.stderr.splitlines()) == 1
    assert len(done.stderr) < 6000


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("wheels.noise=2000", "must be a number <= 1000.0, in metres"),
        ("wheels.noise=9223372036854775807", "it is in metres, and may be 1e+08 at most"),
        ("start.x=-1e9", "start.x = -1000000000.0: it is in metres, and may be 1e+08 at most"),
        (
            "sonar.mounts.front=[1e9, 0, 0]",
            "sonar.mounts = 1000000000.0: it is in metres, and may be 1e+08 at most",
        ),
        ("compass.sigma_deg=1e-300", "no number of a robot but 0 is smaller than 1e-30"),
        ("wheels.noise=-1", "must be a number >= 0.0, in metres"),
        ("start.sigma_theta_deg=1e17", "start.sigma_theta_deg = 1e+17: must be a number <= 3600.0, in degrees"),
        ("wheels.time_offset=9223372036854775807", "is wheels.time_offset right? It is in seconds"),
    ],
)
def test_a_set_beyond_what_can_be_computed_with_is_refused_in_one_line(
    tmp_path: Path, text: str, words: str
) -> None:
    done = locfuse("run", write(tmp_path / "f.mcap", seconds=0.5), "-o", tmp_path / "out", "--set", text)
    assert done.exit_code in {1, 2}
    assert words in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_ordinary_settings_pass() -> None:
    assert apply_sets(["lrf.topic=/scan", "wheels.radius=0.03"]) == {
        "lrf": {"topic": "/scan"},
        "wheels": {"radius": 0.03},
    }
    with pytest.raises(UsageError):
        apply_sets(["wheels.radius=1e30"])


def chain(n: int) -> str:
    joints = "".join(
        f'<joint name="j{i}" type="fixed"><origin xyz="0 0 0.001"/><parent link="l{i}"/>'
        f'<child link="l{i + 1}"/></joint>'
        for i in range(n)
    )
    wheels = "".join(
        f'<joint name="{side}_wheel" type="continuous"><origin xyz="0 {y} 0"/><parent link="l{n}"/>'
        f'<child link="{side}"/></joint>'
        for side, y in (("left", 0.1), ("right", -0.1))
    )
    return f"<robot>{joints}{wheels}</robot>"


def test_a_description_of_thousands_of_joints_in_a_row_is_followed_to_its_end() -> None:
    begin = time.process_time()
    found = wheel_geometry(chain(MAX_JOINTS - 2))
    assert found is not None
    assert found.track == pytest.approx(0.2)
    assert time.process_time() - begin < 20.0  # of CPU; a quarter as many took minutes


def test_a_description_beyond_the_cap_of_joints_tells_nothing() -> None:
    assert wheel_geometry(chain(MAX_JOINTS)) is None


def test_a_chain_of_thousands_of_frames_is_followed() -> None:
    T = np.eye(4)
    T[0, 3] = 0.001
    edges = tuple(Transform(f"f{i}", f"f{i + 1}", T) for i in range(5000))
    mount = planar_mount(StaticTransforms(edges[::-1]), ("f0",), "f5000")
    assert mount is not None
    assert mount.x == pytest.approx(5.0)


def test_more_frames_than_the_cap_are_refused() -> None:
    n = MAX_TRANSFORMS + 1
    first = np.array([0, n])
    columns = {name: Ragged(np.ones(n), first) for name in FIELDS}
    names = [tuple(f"f{i}" for i in range(n))]
    with pytest.raises(LocfuseError, match="/tf_static: too many frames: 10 001, more than the cap of 10 000"):
        static_transforms([{**columns, FIELDS[0]: [("base",) * n], FIELDS[1]: names}])


def test_a_line_map_with_a_line_break_in_a_key_is_refused_in_one_line() -> None:
    with pytest.raises(LocfuseError, match="is not a line map") as refused:
        line_map.decode('{"format": "locfuse line map", "versi\\non": 1, "lines": []}', "walls.json")
    assert "\n" not in str(refused.value)
