"""JointStates out of DynamicJointState (ros2_control), Foxglove's JointStates, Feedback (Jackal)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

import numpy as np

from locfuse.fusion.data import Array, Column, Ints, Ragged

JOINTS = "sensor_msgs/msg/JointState"
DYNAMIC = "control_msgs/msg/DynamicJointState"
INTERFACES, VALUES = "interface_values.interface_names", "interface_values.values"
OF_DYNAMIC = ("joint_names", INTERFACES, VALUES, f"{VALUES}.length")
SAID = ("position", "velocity", "effort")  # interfaces that a JointState has too
FOXGLOVE_JOINTS = ("foxglove.JointStates", "foxglove_msgs/msg/JointStates")
OF_FOXGLOVE_JOINTS = ("joints.name", *(f"joints.{name}" for name in SAID))
# The Jackal's two motors: left before right, angle [rad] and rate [rad/s] of the wheel.
FEEDBACK = ("jackal_msgs/msg/Feedback", "clearpath_platform_msgs/msg/Feedback")
OF_FEEDBACK = ("drivers.measured_travel", "drivers.measured_velocity")
DRIVERS = ("left_wheel", "right_wheel")


def as_joints(columns: Mapping[str, Column], fields: tuple[str, ...], frame_id: str) -> dict[str, Column]:
    """Return fields of JointStates made of k messages; `columns` are OF_DYNAMIC. What is not said is NaN."""
    names = cast("list[tuple[str, ...]]", columns["joint_names"])
    made: dict[str, Column] = {"name": names}
    first = np.concatenate(([0], np.cumsum([len(row) for row in names], dtype=np.int64)))
    for field in (f for f in fields if f != "name"):
        made[field] = Ragged(_interface(columns, names, field), first)
    return {name: made[name] for name in fields}


def joints_of_foxglove(columns: Mapping[str, Column], fields: tuple[str, ...], frame_id: str) -> dict[str, Column]:
    """Return fields of JointStates made of k of Foxglove's; `columns` are OF_FOXGLOVE_JOINTS."""
    return {name: columns[f"joints.{name}"] for name in fields}


def joints_of_feedback(columns: Mapping[str, Column], fields: tuple[str, ...], frame_id: str) -> dict[str, Column]:
    """Return fields of JointStates made of k Feedbacks of two motors; `columns` are OF_FEEDBACK."""
    travel, rate = (cast("Ragged", columns[name]) for name in OF_FEEDBACK)
    made: dict[str, Column] = {"position": travel, "velocity": rate}
    made["name"] = [DRIVERS if n == len(DRIVERS) else ("",) * n for n in travel.lengths.tolist()]
    return {name: made[name] for name in fields}


def _interface(columns: Mapping[str, Column], names: list[tuple[str, ...]], field: str) -> Array:
    """Return one interface of every joint of every message, end to end; messages alike share the search."""
    interfaces = cast("list[tuple[str, ...]]", columns[INTERFACES])
    values, lengths = cast("Ragged", columns[VALUES]), cast("Ragged", columns[f"{VALUES}.length"])
    places: dict[tuple[object, ...], Ints] = {}
    out = []
    for i, row in enumerate(names):
        key = (row, interfaces[i], lengths[i].tobytes())
        if key not in places:
            places[key] = _places(len(row), interfaces[i], lengths[i], field)
        at, said = places[key], np.append(values[i].astype(np.float64), np.nan)
        out.append(said[at])
    return np.concatenate([np.empty(0), *out])


def _places(joints: int, interfaces: tuple[str, ...], lengths: Ints, field: str) -> Ints:
    """Return where each joint's value of an interface stands among all values of a message, -1: nowhere."""
    at = np.full(joints, -1)
    if len(interfaces) != lengths.sum() or len(lengths) != joints:
        return at
    begin = np.cumsum(lengths) - lengths
    for j, (first, n) in enumerate(zip(begin.tolist(), lengths.tolist(), strict=True)):
        own = interfaces[first : first + n]
        if field in own:
            at[j] = first + own.index(field)
    return at
