"""Wheel geometry from a robot description (URDF): wheel joints, radius and track width."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from locfuse.formats.caps import MAX_JOINTS, MAX_TEXT
from locfuse.fusion.se2 import rotation_3d

from .transforms import StaticTransforms, Transform, ancestors

TURNS = ("continuous", "revolute")


class WheelGeometry(NamedTuple):
    """The geometry of the two driven wheels."""

    left: str  # joint names
    right: str
    radius: float | None  # m, of the wheel's cylinder or sphere
    track: float  # m, distance between both joints


def wheel_geometry(text: str) -> WheelGeometry | None:
    """Return the geometry of the left and right wheel; None unless the URDF text has exactly one of each.

    A text with a DTD also gives None, since its entities could fill the memory.
    """
    if len(text) > MAX_TEXT or "<!DOCTYPE" in text or "<!ENTITY" in text:
        return None
    try:
        robot = ET.fromstring(text)
    except ET.ParseError:
        return None
    joints = {j.get("name", ""): j for j in robot.iter("joint") if j.get("type")}
    if len(joints) > MAX_JOINTS:
        return None
    wheels = [n for n, j in joints.items() if j.get("type") in TURNS and "wheel" in n.lower()]
    left = [n for n in wheels if "left" in n.lower() or n.lower().startswith("l")]
    right = [n for n in wheels if "right" in n.lower() or n.lower().startswith("r")]
    if len(left) != 1 or len(right) != 1:
        return None
    connected = [joint for joint in robot.iter("joint") if _link(joint, "child")]
    edges = []
    for joint in connected:
        T, origin = np.eye(4), joint.find("origin")
        if origin is not None:
            T[:3, :3] = rotation_3d(*map(math.degrees, _numbers(origin.get("rpy"))))
            T[:3, 3] = _numbers(origin.get("xyz"))
        edges.append(Transform(_link(joint, "parent"), _link(joint, "child"), T))
    tree = StaticTransforms(tuple(edges))
    in_root = [ancestors(tree, _link(joints[name], "child")) for name in (left[0], right[0])]
    if not all(in_root):
        return None
    y_left, y_right = (float(above[-1][1][1, 3]) for above in in_root)
    track = abs(y_left - y_right)
    if not 0.01 < track < 10.0:
        return None
    return WheelGeometry(left[0], right[0], _radius(robot, joints[left[0]]), track)


def _link(joint: ET.Element, end: str) -> str:
    """Return the name of the "parent" or "child" link of a joint; "" if it has none."""
    found = joint.find(end)
    return "" if found is None else found.get("link", "")


def _numbers(text: str | None) -> Sequence[float]:
    try:
        values = [float(word) for word in (text or "0 0 0").split()]
    except ValueError:
        return (0.0, 0.0, 0.0)
    return values if len(values) == 3 and all(map(math.isfinite, values)) else (0.0, 0.0, 0.0)


def _radius(robot: ET.Element, joint: ET.Element) -> float | None:
    """Return the radius [m] of a joint's wheel from its collision or visual shape; None without one."""
    link = next((ln for ln in robot.iter("link") if ln.get("name") == _link(joint, "child")), None)
    if link is None:
        return None
    for part in ("collision", "visual"):
        for shape in ("cylinder", "sphere"):
            for found in link.iterfind(f"{part}/geometry/{shape}"):
                try:
                    radius = float(found.get("radius", ""))
                except ValueError:
                    continue
                if 0.005 < radius < 2.0:
                    return radius
    return None
