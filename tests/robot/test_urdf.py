"""Wheel geometry out of a robot description, held to geometry worked out by SciPy's rotations."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from locfuse.formats.caps import MAX_TEXT
from locfuse.formats.robot.urdf import wheel_geometry

LEFT = '<joint name="left_wheel" type="continuous"><parent link="base"/><child link="lw"/>{}</joint>'
RIGHT = '<joint name="right_wheel" type="continuous"><parent link="base"/><child link="rw"/>{}</joint>'
AT = '<origin xyz="0 {} 0" rpy="0 0 0"/>'
WHEEL = '<link name="lw"><{}><geometry>{}</geometry></{}></link>'


def robot(*parts: str, left: str = AT.format(0.2), right: str = AT.format(-0.1)) -> str:
    return f"<robot>{LEFT.format(left)}{RIGHT.format(right)}{''.join(parts)}</robot>"


def test_the_track_is_the_distance_of_the_two_joints_and_the_names_are_theirs() -> None:
    found = wheel_geometry(robot())
    assert found is not None
    assert (found.left, found.right, found.radius) == ("left_wheel", "right_wheel", None)
    assert found.track == pytest.approx(0.3)


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
    found = wheel_geometry(robot(WHEEL.format(part, shape, part)))
    assert found is not None
    assert found.radius == radius


def test_the_collision_shape_is_believed_before_the_one_that_is_drawn() -> None:
    drawn, solid = ('<cylinder radius="0.3"/>', '<sphere radius="0.2"/>')
    link = WHEEL.format("visual", drawn, "visual").replace("</link>", "")
    link += f"<collision><geometry>{solid}</geometry></collision></link>"
    found = wheel_geometry(robot(link))
    assert found is not None
    assert found.radius == 0.2


@pytest.mark.parametrize("origin", ["", '<origin xyz="a b c"/>', '<origin xyz="0 nan 0"/>', '<origin xyz="1 2"/>'])
def test_an_origin_that_says_no_place_is_the_parents(origin: str) -> None:
    found = wheel_geometry(robot(left=origin))
    assert found is not None
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
    found = wheel_geometry(robot(loop))
    assert found is not None
    assert found.track == pytest.approx(0.3)  # both wheels hang below the loop


@pytest.mark.parametrize(("left", "right"), [("l_wheel", "r_wheel"), ("wheel_left_joint", "wheel_right_joint")])
def test_wheels_are_known_by_their_side(left: str, right: str) -> None:
    found = wheel_geometry(robot().replace("left_wheel", left).replace("right_wheel", right))
    assert found is not None
    assert (found.left, found.right) == (left, right)
