"""Import of an ekf.yaml of robot_localization as tables of robot.toml, with notes on keys without a counterpart.

The inputs of the file are odom0, twist0, pose0, imu0 ..., each with 15 switches: x, y, z, roll, pitch, yaw, their
six speeds, and three accelerations (robot_localization, state_estimation_nodes). The first odometry becomes
[wheels], the motion model of locfuse; every other input becomes a sensor.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

from locfuse.formats.inputs import MAX_ROBOT_TOML, read_small
from locfuse.formats.text import did_you_mean, visible
from locfuse.fusion.data import LocfuseError

from .ros_yaml import by_yaml

X, Y, YAW, SPEED, TURN, ACCELERATION = 0, 1, 5, 6, 11, 12  # indices of the switches
SWITCH_COUNT = 15
INPUT = re.compile(r"(odom|twist|pose|imu)(\d+)")
INPUT_KEY = re.compile(r"((?:odom|twist|pose|imu)\d+)_(.+)")
KEYS = tomllib.loads((files(__package__) / "robot_localization.toml").read_text(encoding="utf-8"))
USED, IDLE, UNUSED, IDLE_OF_INPUT = (KEYS[name] for name in ("used", "idle", "unused", "idle_of_input"))
USED_OF_INPUT = ("config", "differential", "relative")
REJECTING = ("", "pose_", "twist_", "linear_acceleration_")
UNUSED_OF_INPUT = (*(f"{part}rejection_threshold" for part in REJECTING), "pose_use_child_frame")
KNOWN_OF_INPUT = (*USED_OF_INPUT, *IDLE_OF_INPUT, *UNUSED_OF_INPUT)


class Translated(NamedTuple):
    """The tables of robot.toml translated from an ekf.yaml, and notes."""

    tables: dict[str, dict[str, Any]]
    notes: tuple[str, ...]  # one line per key or input without a counterpart


def read(path: Path, topics: Sequence[str]) -> Translated:
    """Translate an ekf.yaml for a log with these topics. Raises LocfuseError for another file.

    A topic of the file matches one of the log with and without its leading slash; if none does, with any namespace
    before it.
    """
    parameters, notes = _parameters(path)
    named = {name: parameters[name] for name in sorted(parameters) if INPUT.fullmatch(name)}
    inputs = {name: topic for name, topic in named.items() if isinstance(topic, str) and topic}
    if not inputs:
        raise LocfuseError(f"{path} names no input (odom0, twist0, pose0, imu0): is it of robot_localization?")
    notes += _notes_on_keys(parameters)
    tables: dict[str, dict[str, Any]] = _start(path, parameters)
    for name, topic in inputs.items():
        on = parameters.get(f"{name}_config")
        if not isinstance(on, list) or [type(s) for s in on] != [bool] * SWITCH_COUNT:
            raise LocfuseError(f"{path}: {name}_config is not {SWITCH_COUNT} times true or false")
        bare = topic.strip("/")
        near = [t for t in topics if t.strip("/") == bare] or [t for t in topics if t.endswith(f"/{bare}")]
        if len(near) != 1:
            notes.append(f"{name}: this log has no topic {visible(topic)}")
        elif name.startswith("imu"):
            notes += _assign_imu(name, near[0], on, tables)
        else:
            drifts = parameters.get(f"{name}_differential") is True
            notes += _assign(name, near[0], on, drifts, tables)
    return Translated(tables, tuple(notes))


def _parameters(path: Path) -> tuple[dict[str, Any], list[str]]:
    """Return the parameters of the first filter node in a file ({} without one), and a note on its other nodes."""
    found = by_yaml(path, "load", read_small(path, MAX_ROBOT_TOML))
    (name, parameters), *more = _nodes(found, "", 0) or [("", {})]
    others = [visible(other) for other, _ in more]
    return parameters, [f"{', '.join(others)}: only {visible(name)} is read"] if others else []


def _nodes(value: Any, name: str, depth: int) -> list[tuple[str, dict[str, Any]]]:
    """Return (node name, parameters) of each node with inputs."""
    if not isinstance(value, Mapping) or depth > 4:
        return []
    if any(INPUT.fullmatch(str(key)) for key in value):
        return [(name or "the node", {str(key): part for key, part in value.items()})]
    parts = ((str(key) if key != "ros__parameters" else name, part) for key, part in value.items())
    return [node for key, part in parts for node in _nodes(part, key, depth + 1)]


def _assign(name: str, topic: str, on: list[bool], drifts: bool, tables: dict[str, dict[str, Any]]) -> list[str]:
    """Set the topic of an input with the switches `on` in the table of robot.toml: wheels, pose or twist.

    `drifts`: whether the file uses only differences of its poses. Returns notes on what fits into no table, and on
    what the user must check.
    """
    posed, moves = on[X] or on[Y] or on[YAW], on[SPEED] or on[TURN]
    of_wheels = (name.startswith("odom") and (posed or moves)) or (name.startswith("twist") and moves)
    if of_wheels and "wheels" not in tables:
        tables["wheels"] = {"topic": topic}
        return []
    table = "pose" if posed else "twist" if moves else ""
    if not table:
        return [f"{name}: of its switches none is of the plane"]
    if table in tables:
        return [f"{name}: [{table}] reads one topic, {tables[table]['topic']}"]
    tables[table] = {"topic": topic}
    if table == "pose" and not on[YAW]:
        tables["pose"] |= {"frame": "map", "heading": False}
        return [f"{name}: without yaw its frame must be the map (pose.frame); if it is not, leave it out"]
    if table == "pose":
        tables["pose"]["frame"] = "drift" if drifts else "own"
    return []


def _assign_imu(name: str, topic: str, on: list[bool], tables: dict[str, dict[str, Any]]) -> list[str]:
    """Set an IMU's topic in the tables compass (if its yaw is used) and gyro (if its yaw rate is used).

    Returns notes on tables that have a topic already, and on accelerations, which are not used.
    """
    notes = []
    for table, switch in (("compass", YAW), ("gyro", TURN)):
        if on[switch] and table not in tables:
            tables[table] = {"topic": topic}
        elif on[switch]:
            notes.append(f"{name}: [{table}] reads one topic, {tables[table]['topic']}")
    if any(on[ACCELERATION:]):
        notes.append(f"{name}: accelerations are not used")
    return notes


def _start(path: Path, parameters: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    state = parameters.get("initial_state")
    if state is None:
        return {}
    numeric = isinstance(state, list) and all(type(v) in {int, float} and math.isfinite(v) for v in state)
    if not numeric or len(state) != SWITCH_COUNT:
        raise LocfuseError(f"{path}: initial_state is not {SWITCH_COUNT} numbers")
    if not any(state[place] for place in (X, Y, YAW)):
        return {}
    return {"start": {"x": float(state[X]), "y": float(state[Y]), "theta_deg": math.degrees(state[YAW])}}


def _notes_on_keys(parameters: Mapping[str, Any]) -> list[str]:
    """Return notes on unknown keys, and on keys without a counterpart in robot.toml."""
    notes = []
    if parameters.get("two_d_mode") is False:
        notes.append("two_d_mode: false: only the plane is estimated here")
    for key in parameters:
        of_input = INPUT_KEY.fullmatch(key)
        if of_input is None and (key in USED or key in IDLE or INPUT.fullmatch(key)):
            continue
        if key in UNUSED:
            notes.append(f"{key}: {UNUSED[key]}")
        elif of_input is not None and of_input[2] in UNUSED_OF_INPUT:
            notes.append(f"{key}: gates are confidences here (the key gate of the sensor's table)")
        elif of_input is None or of_input[2] not in KNOWN_OF_INPUT:
            known = [f"{of_input[1]}_{k}" for k in KNOWN_OF_INPUT] if of_input else [*USED, *IDLE, *UNUSED]
            notes.append(f"{visible(key[:60])}: unknown key; {did_you_mean(key, known) or 'nothing is like it'}")
    return notes
