"""robot.toml: merged key by key, checked against typed settings, one line for whatever is wrong."""

import time
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import refused
from hostile import write
from hypothesis import given, strategies as st
from present import present

from locfuse.cli.analysis.robot_tables import make_robot
from locfuse.formats.inputs import MAX_DOTS, MAX_JOINTS, MAX_KEYS, MAX_ROBOT_TOML, MAX_TRANSFORMS
from locfuse.formats.robot import robot_toml
from locfuse.formats.robot.robot_toml import apply_sets, dump, layered, merge, parse, updated
from locfuse.formats.robot.transforms import (
    FIELDS,
    StaticTransforms,
    Transform,
    planar_mount,
    static_transforms,
    wheel_geometry,
)
from locfuse.fusion.data import LocfuseError, Ragged, UsageError


def test_tables_become_settings_and_top_level_values_too() -> None:
    robot = make_robot(parse('order = "stamp"\n[wheels]\nradius = 0.033\ntrack = 1\n', "robot.toml"))
    assert (robot.order, robot.wheels.radius, robot.wheels.track) == ("stamp", 0.033, 1.0)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[wheels]\ntrak = 0.2", "unknown key wheels.trak; did you mean track?"),
        ("[compass]\nzzz = 0.2", "unknown key compass.zzz; known: topic"),
        ("[wheel]\nradius = 1", "unknown table or key wheel; did you mean wheels?"),
        ("wheels = 3", "wheels = 3: wheels is a table"),
        ('[wheels]\nradius = "big"', "wheels.radius = 'big': must be a number, in metres"),
        ("[wheels]\nticks_per_revolution = [1]", r"wheels.ticks_per_revolution = \[1\]: must be a"),
        ('[gps]\norigin = [1, "x"]', r"gps.origin.1\] = 'x': must be a number"),
        ('[lrf]\nmap = "shrink"', "lrf.map = 'shrink': choose from "),
        ('order = "sideways"', "order = 'sideways'; choose from auto, stamp, recorded"),
    ],
)
def test_what_is_wrong_is_said_with_its_key_and_the_nearest_known_one(text: str, says: str) -> None:
    with pytest.raises(LocfuseError, match=says) as raised:
        make_robot(parse(text, "robot.toml"))
    assert "\n" not in str(raised.value)
    assert raised.value.exit_code == 1


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"[wheels\nradius = 1", "r.toml: not valid TOML: .*line 1"),
        (b"[wheels]\nradius = \xff", r"r.toml: not UTF-8 text \(byte 18\)"),
        (b"[wheels]\nradius = nan", "r.toml: wheels.radius = nan: a finite number is needed"),
        (b"[wheels]\nlimits = [1.0, -inf]", "r.toml: wheels.limits.1 = -inf: a finite number"),
        (
            b"[wheels]\nradius = 1e308",
            r"r.toml: wheels.radius = 1e\+308: no number of a robot is larger than 1e\+20",
        ),
        (b"a = " + b"[" * 5000, "r.toml: not valid TOML"),
        (b"a = 1\na = 2", "r.toml: not valid TOML"),
        # built to take memory or minutes
        (b".".join([b"a"] * 400) + b" = 1", "tables in tables: 17 deep, more than the cap of 16"),
        (b".".join([b"a"] * (MAX_DOTS + 2)) + b" = 1", "too many dots in a line: 501, more than the cap of 500"),
        (b".".join([b"a"] * 60_000) + b" = 1", "too many dots"),
        (b"#" * (MAX_ROBOT_TOML + 1), "more than the cap of 131 072"),
        (b"[wheels]\nradius = " + b"9" * 5000, "not valid TOML"),
        (b"[wheels]\nradius = 0x" + b"f" * 9000, "an integer of more than 4300 digits"),
        (b"a = [" + b"1," * (MAX_KEYS + 1) + b"]", "too many keys"),
        (b"a = " + b"[" * 5000 + b"]" * 5000, "nested too deeply"),
    ],
)
def test_a_file_that_cannot_be_read_names_itself_in_one_line(data: bytes, says: str) -> None:
    with pytest.raises(LocfuseError, match=says) as raised:
        parse(data, "r.toml")
    assert "\n" not in str(raised.value)


def test_what_comes_later_wins_key_by_key() -> None:
    log = parse("[wheels]\nradius = 1.0\ntrack = 2.0\n", "attachment")
    file = parse('[wheels]\ntrack = 3.0\n[lrf]\ntopic = "/a"\n', "file")
    assert merge(log, file, apply_sets(["lrf.topic=/b"])) == {
        "wheels": {"radius": 1.0, "track": 3.0},
        "lrf": {"topic": "/b"},
    }
    assert log == {"wheels": {"radius": 1.0, "track": 2.0}}


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("lrf.topic=/scan", "/scan"),
        ("lrf.topic=scan", "scan"),
        ('lrf.topic="/scan"', "/scan"),
        ("lrf.topic=3", 3),
        ("lrf.topic=0.5", 0.5),
        ("lrf.topic=-.5", -0.5),
        ("lrf.topic=.5.csv", ".5.csv"),
        ("lrf.topic=true", True),
        ("lrf.topic=[1, 2]", [1, 2]),
        ("lrf.topic=a=b", "a=b"),
        ("lrf.topic=", ""),
        ("lrf.topic = /scan ", "/scan"),
        ("lrf.topic=1\nx=2", "1\nx=2"),
    ],
)
def test_a_set_is_a_toml_value_or_else_plain_text(text: str, value: Any) -> None:
    assert apply_sets([text]) == {"lrf": {"topic": value}}


@pytest.mark.parametrize("text", ["lrf.topic", "=3", "lrf.=3", ".x=1", "lrf.gate=nan", "wheels.radius=1e30"])
def test_a_set_that_cannot_be_understood_is_a_usage_error(text: str) -> None:
    with pytest.raises(UsageError, match="--set"):
        apply_sets([text])


def test_sets_that_contradict_each_other_are_a_usage_error() -> None:
    with pytest.raises(UsageError, match="wheels was set to a value"):
        apply_sets(["wheels=3", "wheels.radius=1"])


NUMBERS = st.floats(-1e20, 1e20).filter(lambda v: v == 0.0 or abs(v) > 1e-30)
KEYS = st.text(min_size=1, max_size=8)
VALUES = st.one_of(
    NUMBERS, st.integers(-(2**63), 2**63 - 1), st.booleans(), st.text(), st.lists(NUMBERS, max_size=3)
)


@given(st.dictionaries(KEYS, st.one_of(VALUES, st.dictionaries(KEYS, VALUES, max_size=4)), max_size=4))
def test_what_is_dumped_reads_back_the_same_to_the_last_bit(tables: dict[str, Any]) -> None:
    text = dump(tables)
    assert parse(text, "again") == tables
    assert dump(tables) == text


def test_a_dump_leaves_out_keys_without_a_value_and_refuses_what_it_could_not_read_back() -> None:
    text = dump({"order": "auto", "wheels": {"radius": 0.1, "track": None}})
    assert tomllib.loads(text) == {"order": "auto", "wheels": {"radius": 0.1}}
    with pytest.raises(LocfuseError, match=r"wheels\.radius = nan"):
        dump({"wheels": {"radius": float("nan")}})


def test_a_sigma_of_zero_is_said_of_the_mount_beside_it_and_of_no_other() -> None:
    log = {"lrf": {"x": 0.2, "sigma_x": 0.0, "yaw_deg": 0.0, "sigma_yaw_deg": 0.0, "y": 0.1, "sigma_y": 0.03}}
    moved = layered(log, {"lrf": {"x": 0.23, "y": 0.0, "yaw_deg": 0.0}})["lrf"]
    assert "sigma_x" not in moved  # the place where the log has it is exact; this one is another
    assert moved["sigma_yaw_deg"] == 0.0  # the same place
    assert moved["sigma_y"] == 0.03  # says how well people measure, not that one value is exact
    assert layered(log, {"lrf": {"x": 0.23, "sigma_x": 0.0}})["lrf"]["sigma_x"] == 0.0
    assert layered({"lrf": {"sigma_x": 0.0}}, {"lrf": {"x": 0.1}})["lrf"] == {"x": 0.1}
    assert layered(log, {}, {"lrf": {"topic": "/scan"}})["lrf"] == {**log["lrf"], "topic": "/scan"}


# --- new values in a robot.toml that people have written: what they wrote stays


MINE = """# Anna's robot
order = "stamp"

[wheels]  # new tyres
radius = 0.05  # by ruler, "worn" # twice
# track = 0.6  # not yet measured
left = 'a # b'

# [compass]
# sigma_deg = 3.0

[lrf]
topic = "/scan"
"""


def test_values_change_and_what_is_behind_a_hash_comes_into_effect_where_it_stands() -> None:
    text = updated(MINE, {"wheels": {"radius": 0.0498}}, "x")
    assert text == MINE.replace("0.05 ", "0.0498 ")
    text = updated(MINE, {"wheels": {"track": 0.61}}, "x")
    assert "\ntrack = 0.61  # not yet measured\n" in text
    text = updated(MINE, {"compass": {"sigma_deg": 1.5}}, "x")
    assert "\n[compass]\nsigma_deg = 1.5\n\n[lrf]" in text


def test_new_keys_and_tables_are_added_and_say_who_did() -> None:
    changes = {"wheels": {"noise": 1e-4}, "gps": {"origin": [48.1, 11.5]}, "preset": "paper", "order": "auto"}
    text = updated(MINE, changes, "locfuse tune")
    assert tomllib.loads(text) == robot_toml.merge(tomllib.loads(MINE), changes)
    assert "noise = 0.0001  # locfuse tune\n" in text
    assert text.index("left = ") < text.index("noise = ") < text.index("# [compass]")
    assert text.rstrip().endswith("[gps]\norigin = [48.1, 11.5]  # locfuse tune")


def test_a_value_that_holds_a_hash_is_replaced_whole_and_an_empty_file_is_filled() -> None:
    assert tomllib.loads(updated(MINE, {"wheels": {"left": "c"}}, "x"))["wheels"]["left"] == "c"
    assert tomllib.loads(updated("", {"lrf": {"x": 0.2}}, "x")) == {"lrf": {"x": 0.2}}


@pytest.mark.parametrize(
    "text", ["wheels.radius = 0.05\n", "[wheels]\nradius = [\n 1,\n 2]\n", "wheels = {radius = 1}\n"]
)
def test_what_cannot_be_changed_line_by_line_is_refused_not_broken(text: str) -> None:
    with pytest.raises(LocfuseError, match=r"line by line|not valid TOML"):
        updated(text, {"wheels": {"radius": 0.04}}, "x")


# --- descriptions of a robot built to take memory or minutes


@pytest.mark.parametrize(
    "text", ["wheels.radius=" + "9" * 5000, "a." * 2000 + "b=1", "wheels.radius=0x" + "f" * 9000]
)
def test_a_set_beyond_a_cap_is_refused_in_one_line(tmp_path: Path, text: str) -> None:
    refusal = refused("info", write(tmp_path / "f.mcap", seconds=0.5), "--set", text, code=2)
    assert len(refusal) < 6000


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
def test_a_set_beyond_what_can_be_computed_is_refused_in_one_line(tmp_path: Path, text: str, words: str) -> None:
    log = write(tmp_path / "f.mcap", seconds=0.5)
    assert words in refused("run", log, "-o", tmp_path / "out", "--set", text, code=None)


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


def test_a_description_is_followed_up_to_the_cap_of_joints() -> None:
    begin = time.process_time()
    found = present(wheel_geometry(chain(MAX_JOINTS - 2)))
    assert found.track == pytest.approx(0.2)
    assert time.process_time() - begin < 20.0  # of CPU; a quarter as many took minutes
    assert wheel_geometry(chain(MAX_JOINTS)) is None


def test_thousands_of_frames_are_followed_and_more_than_the_cap_refused() -> None:
    T = np.eye(4)
    T[0, 3] = 0.001
    edges = tuple(Transform(f"f{i}", f"f{i + 1}", T) for i in range(5000))
    mount = present(planar_mount(StaticTransforms(edges[::-1]), ("f0",), "f5000"))
    assert mount.x == pytest.approx(5.0)
    n = MAX_TRANSFORMS + 1
    first = np.array([0, n])
    columns = {name: Ragged(np.ones(n), first) for name in FIELDS}
    names = [tuple(f"f{i}" for i in range(n))]
    with pytest.raises(LocfuseError, match="/tf_static: too many frames: 10 001, more than the cap of 10 000"):
        static_transforms([{**columns, FIELDS[0]: [("base",) * n], FIELDS[1]: names}])
