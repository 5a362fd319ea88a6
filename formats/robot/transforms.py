"""The robot's geometry in its log: sensor mounts from /tf_static, wheels from the robot description (URDF).

Transforms are chained to the base frame. `T_parent_child` maps coordinates in the child frame to coordinates in
the parent frame (REP-105 trees).
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple, TypeVar

import msgspec
import numpy as np

from locfuse.formats.inputs import MAX_JOINTS, MAX_TEXT, MAX_TRANSFORMS, refuse_above
from locfuse.fusion.data import Array, Column, Ints, LocfuseError, Ragged
from locfuse.fusion.se2 import rotation_3d

# fields of TFMessage | Foxglove's FrameTransforms | its FrameTransform (a single one)
FIELDS = (
    "transforms.header.frame_id|transforms.parent_frame_id|parent_frame_id",
    "transforms.child_frame_id|child_frame_id",
    *(
        f"transforms.transform.{part}|transforms.{part}|{part}"
        for part in (*(f"translation.{axis}" for axis in "xyz"), *(f"rotation.{axis}" for axis in "xyzw"))
    ),
)
MAX_FLIPPED_COSINE = -0.5  # largest vertical component of an upside-down sensor's z axis
SAME_M = 1e-6  # smaller differences are rounding errors, not a conflict
SAME_RAD = 1e-6
MIN_QUATERNION = 1e-6  # norm; below it, a quaternion is no rotation


class Transform(msgspec.Struct, frozen=True):
    """Transform from a child frame to its parent frame."""

    parent: str
    child: str
    T_parent_child: Array  # (4, 4)


class Conflict(NamedTuple):
    """A problem of a frame: contradicting transforms, or an invalid rotation."""

    frame: str
    message: str

    @property
    def line(self) -> str:
        """The problem as a sentence with the frame's name."""
        return f"{self.frame}: {self.message}"


class StaticTransforms(msgspec.Struct, frozen=True):
    """Fixed transforms of all publishers; for each child frame the last one counts (as in tf2)."""

    edges: tuple[Transform, ...] = ()
    conflicts: tuple[Conflict, ...] = ()
    bases: tuple[str, ...] = ()  # additional names of the robot's base frame
    # first transforms of frames that move on the robot; a sensor on such a frame has no fixed mount
    moving: tuple[Transform, ...] = ()


class FrameMount(msgspec.Struct, frozen=True):
    """Pose of a sensor on the base: metres, radians, base frame (x forward, y left, z up)."""

    base: str  # base frame
    frame: str
    x: float
    y: float
    z: float
    yaw: float  # direction of the sensor's x axis seen from above
    roll: float
    pitch: float
    flipped: bool  # mounted upside-down: its z axis points down


def static_transforms(columns: Iterable[Mapping[str, Column]]) -> StaticTransforms:
    """Collect the transforms of TFMessage columns (FIELDS); one mapping per topic, rows in recording order."""
    edges: dict[str, Transform] = {}
    conflicts: dict[Conflict, None] = {}  # an ordered set
    for topic in columns:
        for parent, child, numbers in _entries(as_lists(topic)):
            values = np.array([numbers])
            if not values[0, 3:].any() and np.isfinite(values).all():
                conflicts[Conflict(child, "its quaternion in /tf_static is zeros: read as no rotation")] = None
                values[0, 6] = 1.0
            elif not (np.isfinite(values).all() and np.linalg.norm(values[0, 3:]) > MIN_QUATERNION):
                conflicts[Conflict(child, "a transform without a usable rotation is ignored")] = None
                continue
            transform = Transform(parent, child, matrices_of(values)[0])
            before = edges.get(child, transform)
            off = np.abs(before.T_parent_child - transform.T_parent_child)
            if before.parent != parent or off[:3, 3].max() > SAME_M or off[:3, :3].max() > SAME_RAD:
                places = f"{_place(before)} and {_place(transform)} contradict; the last one counts"
                conflicts[Conflict(child, places)] = None
            edges[child] = transform
            refuse_above("/tf_static: too many frames", len(edges), MAX_TRANSFORMS)
    return StaticTransforms(tuple(edges.values()), tuple(conflicts))


def as_lists(columns: Mapping[str, Column]) -> dict[str, Column]:
    """Return transform columns in which every message has a list, also messages with a single transform.

    Raises LocfuseError if the numbers of values and of transforms in a message differ.
    """
    lists = {name: _listed(column) for name, column in columns.items()}
    transforms = _lengths(lists[FIELDS[0]])
    for name in FIELDS[1:]:
        values = _lengths(lists[name])
        if (values != transforms).any():
            row, field = int(np.argmax(values != transforms)), name.partition("|")[0]
            words = f"{values[row]} values for {transforms[row]} transforms; it takes one for each"
            raise LocfuseError(f"{field} has {words}")
    return lists


def _lengths(column: Column) -> Ints:
    return column.lengths if isinstance(column, Ragged) else np.array([len(values) for values in column], np.int64)


def _listed(column: Column) -> Column:
    if isinstance(column, np.ndarray):
        return Ragged(column, np.arange(len(column) + 1))
    if isinstance(column, list):
        return [(value,) if isinstance(value, str) else value for value in column]
    return column


def _entries(topic: Mapping[str, Column]) -> Iterable[tuple[str, str, list[float]]]:
    parents, children = (column for name in FIELDS[:2] if isinstance(column := topic[name], list))
    numbers = [column for column in (topic[name] for name in FIELDS[2:]) if isinstance(column, Ragged)]
    for row, (names, kids) in enumerate(zip(parents, children, strict=True)):
        values = np.stack([column[row] for column in numbers], axis=1).tolist() if names else []
        for parent, child, value in zip(names, kids, values, strict=True):
            yield parent.lstrip("/"), child.lstrip("/"), value


def matrices_of(values: Array) -> Array:
    """Return matrices (n, 4, 4) of transforms (n, 7).

    Columns: position x, y, z [m]; quaternion x, y, z, w of any length above zero.
    """
    x, y, z, w = (values[:, 3:] / np.linalg.norm(values[:, 3:], axis=1, keepdims=True)).T
    T = np.zeros((len(values), 4, 4))
    T[:, 0, :3] = np.stack((1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)), axis=-1)
    T[:, 1, :3] = np.stack((2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)), axis=-1)
    T[:, 2, :3] = np.stack((2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)), axis=-1)
    T[:, :3, 3] = values[:, :3]
    T[:, 3, 3] = 1.0
    return T


def quaternions_of(R: Array) -> Array:
    """Return unit quaternions (n, 4) x, y, z, w of rotation matrices (n, 3, 3) (Shepperd 1978)."""
    trace = R[:, 0, 0] + R[:, 1, 1] + R[:, 2, 2]
    squares = np.stack((*(1.0 + 2.0 * R[:, i, i] - trace for i in range(3)), 1.0 + trace), axis=-1)
    products = np.empty((len(R), 4, 4))  # 4 q_i q_j
    products[:, range(4), range(4)] = squares
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        products[:, i, j] = products[:, j, i] = R[:, i, j] + R[:, j, i]
        products[:, k, 3] = products[:, 3, k] = R[:, j, i] - R[:, i, j]
    rows = products[np.arange(len(R)), np.argmax(squares, axis=1)]  # dividing by the largest is most exact
    found: Array = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    return found


def _place(edge: Transform) -> str:
    x, y, z = edge.T_parent_child[:3, 3]
    roll, pitch, yaw = roll_pitch_yaw(edge.T_parent_child[:3, :3])
    degrees = ", ".join(f"{math.degrees(angle):.1f}" for angle in (roll, pitch, yaw))
    return f"({x:.3f}, {y:.3f}, {z:.3f}) m rpy ({degrees}) deg in {edge.parent}"


def roll_pitch_yaw(R: Array) -> tuple[float, float, float]:
    """Return roll, pitch, yaw of a rotation matrix (3, 3) = Rz(yaw) Ry(pitch) Rx(roll), as in URDF."""
    pitch = math.asin(min(max(-R[2, 0], -1.0), 1.0)) + 0.0  # + 0.0 avoids a negative zero
    if abs(R[2, 0]) > 1 - 1e-9:  # vertical x axis: only yaw -+ roll is defined, so roll is set to 0
        return 0.0, pitch, math.atan2(-R[0, 1], R[1, 1])
    return math.atan2(R[2, 1], R[2, 2]), pitch, math.atan2(R[1, 0], R[0, 0])


def planar_mount(transforms: StaticTransforms, base_frames: Sequence[str], frame: str) -> FrameMount | None:
    """Return the pose of `frame` in the first of `base_frames` that is connected to it; None if none is."""
    wanted = frame.lstrip("/")
    at = neighbours((edge.parent, edge.child, edge.T_parent_child) for edge in transforms.edges)
    for base in base_frames:
        if (path := path_between(at, base, wanted)) is not None:
            T = np.eye(4)
            for edge, backward in path:
                T = T @ (inverse_of(edge) if backward else edge)
            roll, pitch, yaw = roll_pitch_yaw(T[:3, :3])
            x, y, z = (float(value) for value in T[:3, 3])
            return FrameMount(base, wanted, x, y, z, yaw, roll, pitch, flipped=bool(T[2, 2] < MAX_FLIPPED_COSINE))
    return None


def ancestors(transforms: StaticTransforms, frame: str) -> list[tuple[str, Array]]:
    """Return (ancestor, pose (4, 4) of the frame in this ancestor) for all ancestors of a frame, nearest first."""
    above = {edge.child: edge for edge in transforms.edges}
    found: list[tuple[str, Array]] = []
    T = np.eye(4)
    while frame in above and len(found) < len(above):  # the second condition ends a loop of frames
        edge = above[frame]
        T, frame = edge.T_parent_child @ T, edge.parent
        found.append((frame, T))
    return found


Edge = TypeVar("Edge")
Neighbours = Mapping[str, Sequence[tuple[str, Edge, bool]]]  # frame -> (neighbour, edge, whether inverted)


def neighbours(edges: Iterable[tuple[str, str, Edge]]) -> Neighbours[Edge]:
    """Return frame -> [(neighbour, edge, whether inverted)] from edges (parent, child, edge)."""
    at: dict[str, list[tuple[str, Edge, bool]]] = {}
    for parent, child, edge in edges:
        at.setdefault(parent, []).append((child, edge, False))
        at.setdefault(child, []).append((parent, edge, True))
    return at


def path_between(at: Neighbours[Edge], start: str, goal: str) -> list[tuple[Edge, bool]] | None:
    """Return the shortest path between two frames, as (edge, whether inverted); None without one."""
    paths: dict[str, list[tuple[Edge, bool]]] = {start: []}
    waiting = deque([start])
    while waiting and goal not in paths:
        here = waiting.popleft()
        for there, edge, backward in at.get(here, ()):
            if there not in paths:
                paths[there] = [*paths[here], (edge, backward)]
                waiting.append(there)
    return paths.get(goal)


def inverse_of(T: Array) -> Array:
    """Return the inverses of rigid transforms T (..., 4, 4)."""
    inverse = np.zeros_like(T)
    turned = np.swapaxes(T[..., :3, :3], -1, -2)
    inverse[..., :3, :3] = turned
    inverse[..., :3, 3] = -(turned @ T[..., :3, 3:])[..., 0]
    inverse[..., 3, 3] = 1.0
    return inverse


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
