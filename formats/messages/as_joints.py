"""JointStates out of a DynamicJointState (ros2_control): joints that name the interfaces of each value."""

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


def as_joints(columns: Mapping[str, Column], fields: tuple[str, ...], frame_id: str) -> dict[str, Column]:
    """Return fields of JointStates made of k messages; `columns` are OF_DYNAMIC. What is not said is NaN."""
    names = cast("list[tuple[str, ...]]", columns["joint_names"])
    made: dict[str, Column] = {"name": names}
    first = np.concatenate(([0], np.cumsum([len(row) for row in names], dtype=np.int64)))
    for field in (f for f in fields if f != "name"):
        made[field] = Ragged(_interface(columns, names, field), first)
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
