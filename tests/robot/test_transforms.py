"""Mounts from /tf_static: chains in either direction, conflicts, upside-down and yawed sensors."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import T0, Said, cdr, real_log, write
from scipy.spatial.transform import Rotation

from locfuse.formats.logs.log import open_log
from locfuse.formats.robot.transforms import (
    FIELDS,
    Mount,
    StaticTransforms,
    planar_mount,
    roll_pitch_yaw,
    static_transforms,
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


def mount(transforms: StaticTransforms, frame: str) -> Mount:
    found = planar_mount(transforms, BASES, frame)
    assert found is not None
    return found


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


def test_a_transform_without_a_rotation_is_ignored_and_told(tmp_path: Path) -> None:
    broken = edge("base_link", "laser")
    broken["transform"]["rotation"] = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 0.0}
    transforms = published(tmp_path, [broken])
    assert planar_mount(transforms, BASES, "laser") is None
    assert transforms.conflicts == (("laser", "a transform without a usable rotation is ignored"),)


def test_frames_with_a_leading_slash_are_the_same_frames(tmp_path: Path) -> None:
    transforms = published(tmp_path, [edge("/base_link", "/laser", (0.3, 0, 0))])
    assert mount(transforms, "laser").x == mount(transforms, "/laser").x == pytest.approx(0.3)


def test_a_namespaced_robot(tmp_path: Path) -> None:
    assert mount(published(tmp_path, [edge("base_link", "laser")], topic="/robot1/tf_static"), "laser").x == 0


def test_a_loop_in_the_tree_ends(tmp_path: Path) -> None:
    transforms = published(tmp_path, [edge("a", "b"), edge("b", "c"), edge("c", "a")])
    assert planar_mount(transforms, BASES, "b") is None


def test_an_unconnected_frame_and_a_log_without_tf_have_no_mount(tmp_path: Path) -> None:
    assert planar_mount(published(tmp_path, [edge("map", "laser")]), BASES, "laser") is None
    empty = open_log([write(tmp_path / "none.mcap", [])]).static_transforms()
    assert planar_mount(empty, BASES, "laser") is None


def test_the_base_frame_itself_is_mounted_at_zero() -> None:
    assert mount(StaticTransforms(), "base_link") == Mount("base_link", "base_link", 0, 0, 0, 0, 0, 0, False)


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
    [("transforms.child_frame_id", ("a", "b")), ("transforms.child_frame_id", ()),
     ("transforms.transform.translation.x", (1.0, 2.0)), ("transforms.transform.rotation.w", ())],
)  # fmt: skip
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
