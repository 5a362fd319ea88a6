"""ROS nodes for which `locfuse export ros` writes parameters: their known keys, and their section in a file.

Sources of the keys: robot_localization (state_estimation_nodes), nav2 (configuring-amcl), ros2_controllers
(parameters of diff_drive_controller), FusionCore (docs/configuration.md).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib.resources import files

import msgspec

from locfuse.formats.text import visible
from locfuse.fusion.data import LocfuseError

from . import robot_localization as ekf
from .ros_yaml import NodeSection, RosFile

OF_EVERY_NODE = ("use_sim_time", r"qos_overrides\..+", "<<")


class RosNode(msgspec.Struct, frozen=True):
    """One kind of node."""

    name: str  # of the package or plugin
    usual: str  # default name of the node
    distinctive: str  # pattern of keys that occur only in sections of this kind of node
    example: str  # example of distinctive keys, for errors
    known: tuple[str, ...]  # patterns of all keys of the node
    plugin: str = ""  # type of the controller in the controller manager


EKF = RosNode(
    "robot_localization",
    "ekf_filter_node",
    ekf.INPUT.pattern,
    "odom0, imu0",
    (
        *(*ekf.USED, *ekf.IDLE, *ekf.UNUSED, ekf.INPUT.pattern),
        *(rf"({ekf.INPUT.pattern})_{key}" for key in ekf.KNOWN_OF_INPUT),
    ),
)
TABLE = (files(__package__) / "ros_nodes.toml").read_bytes()
NODES = {"ekf": EKF, **msgspec.toml.decode(TABLE, type=dict[str, RosNode])}


def sections_of(file: RosFile, target: str) -> list[NodeSection]:
    """Return the sections of a file that belong to a kind of node (a key of NODES)."""
    return [s for s in file.sections if any(re.fullmatch(NODES[target].distinctive, key) for key in s.at)]


def section_of(file: RosFile, target: str, name: str | None = None) -> NodeSection:
    """Return the only section of a kind of node in a file; `name` selects one of several nodes.

    Raises LocfuseError for no section or several, another controller type, or unknown keys.
    """
    node, types = NODES[target], dict(_types(file))
    found = sections_of(file, target)
    if name is not None:
        found = [s for s in found if name in {s.name, s.name.rpartition("/")[2]}]
    if not found:
        named = f" named {name}" if name else ""
        others = f"; its controllers: {', '.join(f'{n} ({t})' for n, t in types.items())}" if types else ""
        example = f"({node.example}){others if node.plugin else ''}"
        raise LocfuseError(f"{file.path} has no section of {node.name}{named} {example}")
    if len(found) > 1:
        names = ", ".join(visible(s.name) for s in found)
        words = f"several sections of {node.name} ({names}): choose one with --node NAME"
        raise LocfuseError(f"{file.path} has {words}")
    section = found[0]
    kind = str(section.values.get("type") or types.get(section.name.rpartition("/")[2], ""))
    if node.plugin and kind and node.plugin not in kind:
        raise LocfuseError(f"{file.path}: {visible(section.name)} is a {visible(kind)}, not a {node.plugin}")
    patterns = (*node.known, *OF_EVERY_NODE)
    for key in section.at:
        if not any(re.fullmatch(pattern, key) for pattern in patterns):
            words = f"{node.name} has no key {visible(key[:60])}: correct it or take it out"
            raise LocfuseError(f"{file.path}: {visible(section.name)}: {words}")
    return section


def _types(file: RosFile) -> Iterator[tuple[str, str]]:
    """Yield (name, type) of every controller that the file's controller managers declare."""
    for section in file.sections:
        for key, value in section.values.items():
            if key.endswith(".type") and isinstance(value, str):
                yield visible(key.removesuffix(".type")), visible(value)
