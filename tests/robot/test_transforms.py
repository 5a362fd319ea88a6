"""Mounts from /tf_static: chains in either direction, conflicts, upside-down and yawed sensors."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import T0, Said, cdr, real_log, write
from present import present
from scipy.spatial.transform import Rotation

from locfuse.cli.analysis.mounts import refuse_far
from locfuse.formats.inputs import MAX_TEXT
from locfuse.formats.logs.log import open_log
from locfuse.formats.robot.transforms import (
    FIELDS,
    FrameMount,
    StaticTransforms,
    planar_mount,
    roll_pitch_yaw,
    static_transforms,
    wheel_geometry,
)
from locfuse.fusion.data import LocfuseError, Ragged

BASES = ("base_link", "base_footprint", "base")
KIND = "tf2_msgs/msg/TFMessage"


def edge(
    parent: str, child: str, xyz: tuple[float, float, float] = (0, 0, 0), rpy: Any = (0, 0, 0)
) -> dict[str, Any]:
    qx, qy, qz, qw = Rotation.from_euler("xyz", rpy).as_quat()
    return {
        "header": {"frame_id": parent},
        "child_frame_id": child,
        "transform": {
            "translation": dict(zip("xyz", xyz, strict=True)),
            "rotation": {"x": qx, "y": qy, "z": qz, "w": qw},
        },
    }


def published(tmp_path: Path, *messages: list[dict[str, Any]], topic: str = "/tf_static") -> StaticTransforms:
    """What a log says in which each message came from its own publisher."""
    said = [Said(topic, KIND, cdr(KIND, transforms=m), T0 + i) for i, m in enumerate(messages)]
    return open_log([write(tmp_path / "tf.mcap", said)]).static_transforms()


def mount(transforms: StaticTransforms, frame: str) -> FrameMount:
    return present(planar_mount(transforms, BASES, frame))


def test_a_chain_composes_like_scipy(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    rpys = rng.uniform(-1, 1, (3, 3))
    shifts = rng.uniform(-1, 1, (3, 3))
    names = ["base_link", "plate", "mast", "laser"]
    edges = [edge(names[i], names[i + 1], tuple(shifts[i]), rpys[i]) for i in range(3)]
    m = mount(published(tmp_path, edges), "laser")
    rotation, at = Rotation.identity(), np.zeros(3)
    for rpy, shift in zip(rpys, shifts, strict=True):
        at = at + rotation.apply(shift)
        rotation *= Rotation.from_euler("xyz", rpy)
    np.testing.assert_allclose([m.x, m.y, m.z], at, atol=1e-12)
    forward = rotation.apply([1, 0, 0])
    assert m.yaw == pytest.approx(math.atan2(forward[1], forward[0]))
    np.testing.assert_allclose([m.roll, m.pitch, m.yaw], rotation.as_euler("xyz"), atol=1e-12)


def test_edges_are_walked_against_their_direction_too(tmp_path: Path) -> None:
    """A tree rooted in base_footprint: base_link is its child, the laser hangs on base_link."""
    transforms = published(
        tmp_path,
        [
            edge("base_footprint", "base_link", (0, 0, 0.1)),
            edge("laser", "base_link", (0.2, 0, 0), (0, 0, math.pi / 2)),
        ],
    )
    m = mount(transforms, "laser")
    np.testing.assert_allclose([m.x, m.y, m.z], [0, 0.2, 0], atol=1e-12)
    assert m.yaw == pytest.approx(-math.pi / 2)
    assert m.base == "base_link"


@pytest.mark.parametrize(
    ("rpy", "yaw", "flipped"),
    [
        ((0, 0, 0), 0, False),
        ((0, 0, math.pi / 2), math.pi / 2, False),
        ((math.pi, 0, 0), 0, True),
        ((0, math.pi, 0), math.pi, True),
        ((math.pi, 0, 0.7), 0.7, True),
        ((math.pi / 2, 0, 0), 0, False),
        ((-math.pi / 2 - 1e-6, 0, 0), 0, False),
    ],
)
def test_upside_down_and_yawed_sensors(tmp_path: Path, rpy: Any, yaw: float, flipped: bool) -> None:
    m = mount(published(tmp_path, [edge("base_link", "laser", rpy=rpy)]), "laser")
    assert math.cos(m.yaw - yaw) == pytest.approx(1)
    assert m.flipped is flipped


def test_several_publishers_and_their_conflicts_are_told_and_the_last_one_counts(tmp_path: Path) -> None:
    transforms = published(
        tmp_path,
        [edge("base_link", "laser", (0.1, 0, 0)), edge("base_link", "imu", (0, 0.1, 0))],
        [edge("base_link", "laser", (0.2, 0, 0))],
        [edge("base_link", "imu", (0, 0.1, 0))],
    )
    assert mount(transforms, "laser").x == pytest.approx(0.2)
    assert len(transforms.conflicts) == 1
    assert "laser: (0.100, 0.000, 0.000) m" in transforms.conflicts[0].line


def test_a_quaternion_of_zeros_turns_nothing_and_one_of_nan_is_ignored(tmp_path: Path) -> None:
    zeros, nan = (edge("base_link", name, (0.1, 0.2, 0)) for name in ("laser", "imu"))
    zeros["transform"]["rotation"] = dict.fromkeys("xyzw", 0.0)
    nan["transform"]["rotation"]["w"] = math.nan
    transforms = published(tmp_path, [zeros, nan])
    assert mount(transforms, "laser") == FrameMount("base_link", "laser", 0.1, 0.2, 0, 0, 0, 0, False)
    assert planar_mount(transforms, BASES, "imu") is None
    assert transforms.conflicts == (
        ("laser", "its quaternion in /tf_static is zeros: read as no rotation"),
        ("imu", "a transform without a usable rotation is ignored"),
    )


def test_a_leading_slash_or_a_namespace_does_not_matter_and_the_base_is_mounted_at_zero(tmp_path: Path) -> None:
    transforms = published(tmp_path, [edge("/base_link", "/laser", (0.3, 0, 0))])
    assert mount(transforms, "laser").x == mount(transforms, "/laser").x == pytest.approx(0.3)
    assert mount(published(tmp_path, [edge("base_link", "laser")], topic="/robot1/tf_static"), "laser").x == 0
    assert mount(StaticTransforms(), "base_link") == FrameMount("base_link", "base_link", 0, 0, 0, 0, 0, 0, False)


def test_a_loop_in_the_tree_ends_and_an_unconnected_frame_has_no_mount(tmp_path: Path) -> None:
    transforms = published(tmp_path, [edge("a", "b"), edge("b", "c"), edge("c", "a")])
    assert planar_mount(transforms, BASES, "b") is None
    assert planar_mount(published(tmp_path, [edge("map", "laser")]), BASES, "laser") is None
    empty = open_log([write(tmp_path / "none.mcap", [])]).static_transforms()
    assert planar_mount(empty, BASES, "laser") is None


@pytest.mark.parametrize("pitch", [math.pi / 2, -math.pi / 2])
def test_angles_of_a_sensor_that_looks_straight_up_or_down(pitch: float) -> None:
    R = Rotation.from_euler("xyz", [0.3, pitch, 0.5]).as_matrix()
    again = Rotation.from_euler("xyz", roll_pitch_yaw(R)).as_matrix()
    np.testing.assert_allclose(again, R, atol=1e-7)


def test_two_real_publishers_contradict_on_21_frames_but_not_on_the_laser() -> None:
    log = open_log([real_log("turtlebot4")])
    transforms = log.static_transforms()
    m = mount(transforms, log.stream("/scan").frame_id)
    assert m.yaw == pytest.approx(math.pi / 2, abs=1e-6)
    assert not m.flipped
    assert len(transforms.conflicts) == 21
    assert not any(conflict.frame.startswith("rplidar") for conflict in transforms.conflicts)
    assert mount(transforms, "left_wheel").y == pytest.approx(0.116, abs=0.001)


@pytest.mark.parametrize(
    ("field", "values"),
    [
        ("transforms.child_frame_id", ("a", "b")),
        ("transforms.child_frame_id", ()),
        ("transforms.transform.translation.x", (1.0, 2.0)),
        ("transforms.transform.rotation.w", ()),
    ],
)
def test_a_definition_that_holds_several_values_for_each_transform_is_refused_by_name(
    field: str, values: tuple[Any, ...]
) -> None:
    columns: dict[str, Any] = {
        FIELDS[0]: [("base_link",)],
        FIELDS[1]: [("laser",)],
        **{name: Ragged(np.ones(1), np.array([0, 1])) for name in FIELDS[2:]},
    }
    (key,) = (name for name in FIELDS if name.startswith(field))
    strings = isinstance(columns[key], list)
    columns[key] = [values] if strings else Ragged(np.array(values, float), np.array([0, len(values)]))
    with pytest.raises(LocfuseError, match=f"{field} has {len(values)} values for 1 transforms"):
        static_transforms([columns])


# --- wheel geometry out of a robot description, held to geometry worked out by SciPy's rotations


LEFT = '<joint name="left_wheel" type="continuous"><parent link="base"/><child link="lw"/>{}</joint>'
RIGHT = '<joint name="right_wheel" type="continuous"><parent link="base"/><child link="rw"/>{}</joint>'
AT = '<origin xyz="0 {} 0" rpy="0 0 0"/>'
WHEEL = '<link name="lw"><{}><geometry>{}</geometry></{}></link>'


def robot(*parts: str, left: str = AT.format(0.2), right: str = AT.format(-0.1)) -> str:
    return f"<robot>{LEFT.format(left)}{RIGHT.format(right)}{''.join(parts)}</robot>"


@pytest.mark.parametrize("rpy", [(0.3, -0.2, 1.1), (math.pi / 2, 0.0, 0.0), (0.0, math.pi / 2, 0.5)])
def test_joints_above_a_wheel_turn_and_move_it(rpy: tuple[float, float, float]) -> None:
    xyz = (0.1, 0.7, -0.2)
    mount = (
        f'<joint name="mount" type="fixed"><parent link="root"/><child link="arm"/>'
        f'<origin xyz="{xyz[0]} {xyz[1]} {xyz[2]}" rpy="{rpy[0]} {rpy[1]} {rpy[2]}"/></joint>'
    )
    left = LEFT.replace('"base"', '"arm"').format('<origin xyz="0.05 0.4 0.3"/>')
    found = wheel_geometry(f"<robot>{mount}{left}{RIGHT.format(AT.format(-0.1))}</robot>")
    place = Rotation.from_euler("xyz", rpy).apply([0.05, 0.4, 0.3]) + np.array(xyz)  # fixed axes, as URDF has it
    assert found is not None
    assert found.track == pytest.approx(abs(place[1] + 0.1), abs=1e-12)


@pytest.mark.parametrize(
    ("part", "shape", "radius"),
    [
        ("collision", '<cylinder radius="0.05" length="0.02"/>', 0.05),
        ("visual", '<sphere radius="0.1"/>', 0.1),
        ("collision", '<box size="1 1 1"/>', None),
        ("collision", '<cylinder radius="${r}"/>', None),
        ("collision", '<cylinder length="1"/>', None),
        ("collision", '<cylinder radius="nan"/>', None),
        ("visual", '<cylinder radius="1e9"/>', None),
        ("visual", '<cylinder radius="0.001"/><cylinder radius="0.2"/>', 0.2),
    ],
)
def test_the_radius_is_that_of_the_wheel_which_hangs_on_the_joint(part: str, shape: str, radius: Any) -> None:
    found = present(wheel_geometry(robot(WHEEL.format(part, shape, part))))
    assert found.radius == radius


def test_the_collision_shape_is_believed_before_the_one_that_is_drawn() -> None:
    drawn, solid = ('<cylinder radius="0.3"/>', '<sphere radius="0.2"/>')
    link = WHEEL.format("visual", drawn, "visual").replace("</link>", "")
    link += f"<collision><geometry>{solid}</geometry></collision></link>"
    found = present(wheel_geometry(robot(link)))
    assert found.radius == 0.2


@pytest.mark.parametrize("origin", ["", '<origin xyz="a b c"/>', '<origin xyz="0 nan 0"/>', '<origin xyz="1 2"/>'])
def test_an_origin_that_says_no_place_is_the_parents(origin: str) -> None:
    found = present(wheel_geometry(robot(left=origin)))
    assert found.track == pytest.approx(0.1)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "<robot>",
        "no xml",
        "<robot/>",
        '<!DOCTYPE robot [<!ENTITY a "b">]>' + robot(),
        robot() + " " * MAX_TEXT,
        robot(LEFT.replace("left_wheel", "left_wheel_2").format("")),  # which of the two?
        robot().replace('"right_wheel"', '"caster_wheel"'),
        robot().replace("continuous", "fixed"),
        robot(left=AT.format(-0.1)),  # both at one place
        robot(left=AT.format(99.0)),
        "<robot>\x00</robot>",
    ],
    ids=range(12),
)
def test_what_tells_no_geometry_is_none(text: str) -> None:
    assert wheel_geometry(text) is None


def test_a_robot_that_hangs_on_itself_is_walked_once() -> None:
    loop = (
        '<joint name="a" type="fixed"><parent link="x"/><child link="base"/><origin xyz="0 1 0"/></joint>'
        '<joint name="b" type="fixed"><parent link="base"/><child link="x"/><origin xyz="0 2 0"/></joint>'
    )
    found = present(wheel_geometry(robot(loop)))
    assert found.track == pytest.approx(0.3)  # both wheels hang below the loop


@pytest.mark.parametrize(("left", "right"), [("l_wheel", "r_wheel"), ("wheel_left_joint", "wheel_right_joint")])
def test_wheels_are_known_by_their_side(left: str, right: str) -> None:
    found = present(wheel_geometry(robot().replace("left_wheel", left).replace("right_wheel", right)))
    assert (found.left, found.right) == (left, right)


def test_a_mount_in_mm_is_refused_with_its_metres_unless_its_place_is_set() -> None:
    mounts = {"lrf": {"x": -30.0, "y": 0.0, "yaw_deg": 90.0}, "compass": {"x": 0.2}}
    with pytest.raises(LocfuseError, match=r"x = -30 m and y = 0 m .* in mm.*--set lrf.x=-0.03 --set lrf.y=0"):
        refuse_far(mounts, {})
    refuse_far(mounts, {"lrf": {"x": -0.03}})
