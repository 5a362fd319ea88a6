"""Parameters of ROS nodes for a log or a result, as a new file or as changes of an existing file.

A node is known by its keys, and by its section in a file. Sources of the keys: robot_localization
(state_estimation_nodes), nav2 (configuring-amcl), ros2_controllers (parameters of diff_drive_controller),
FusionCore (docs/configuration.md).
"""

from __future__ import annotations

import difflib
import os
import re
import stat
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import msgspec

from locfuse.formats.robot import robot_localization
from locfuse.formats.robot.ros_yaml import NodeSection, RosFile, Setting, changed, in_yaml, parsed, render
from locfuse.formats.text import visible
from locfuse.formats.whole_files import whole_file
from locfuse.fusion.data import LocfuseError

from . import amcl, diff_drive, ekf, fusioncore
from .found import FoundRobot

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
    robot_localization.INPUT.pattern,
    "odom0, imu0",
    (
        *robot_localization.USED,
        *robot_localization.IDLE,
        *robot_localization.UNUSED,
        robot_localization.INPUT.pattern,
        *(rf"({robot_localization.INPUT.pattern})_{key}" for key in robot_localization.KNOWN_OF_INPUT),
    ),
)
NODES = {
    "ekf": EKF,
    **msgspec.toml.decode((files(__package__) / "ros_nodes.toml").read_bytes(), type=dict[str, RosNode]),
}


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


Mapped = Callable[[FoundRobot, Mapping[str, Any]], list[Setting]]
TARGETS: dict[str, Mapped] = {
    "diff_drive": diff_drive.settings,
    "ekf": ekf.settings,
    "amcl": amcl.settings,
    "fusioncore": fusioncore.settings,
}


class Made(msgspec.Struct, frozen=True):
    """The text of a parameter file, with the changes and their reasons."""

    text: str
    diff: tuple[str, ...] = ()  # unified diff from the existing file
    reasons: tuple[str, ...] = ()  # reason of each change, and values that have no place in the file


def fresh(found: FoundRobot, targets: Sequence[str]) -> Made:
    """Return a new parameter file for these nodes."""
    nodes = [(NODES[target].usual, NODES[target].name, TARGETS[target](found, {})) for target in targets]
    head = f"made by locfuse export ros from {found.loaded.log.name}\n"
    words = "found: measured on this log, or by a file that tune, calibrate or compare wrote"
    return Made(render(f"{head}{words}; carried over: as it was set", nodes))


def targets_in(file: RosFile, targets: Sequence[str], node: str | None, any_of: bool) -> tuple[str, ...]:
    """Return the targets whose parameters are written into a parameter file.

    With `any_of`, targets that the file lacks are left out, unless it lacks all of them. Raises LocfuseError for a
    target without section, with several sections, or with a section of another node.
    """
    if any_of:
        targets = [target for target in targets if sections_of(file, target)] or targets
    for target in targets:
        section_of(file, target, node)
    return tuple(targets)


def edited(found: FoundRobot, targets: Sequence[str], before: RosFile, node: str | None) -> Made:
    """Return a file with the values of these targets replaced by estimated ones."""
    now, reasons = before, list[str]()
    for target in targets:
        section = section_of(now, target, node)
        settings = TARGETS[target](found, section.values)
        text, absent = changed(now, section, settings)
        for s in settings:
            if s.value is None:
                reasons.append(s.note)
            elif s.replaces:
                long = isinstance(s.value, list) and len(s.value) > 6
                what = s.key if long else f"{s.key}: {in_yaml(s.value)}"
                missing = "not in the file, add it by hand; " if s in absent else ""
                reasons.append(f"{what}  # {missing}{s.label}{s.words}")
        now = parsed(now.path, text)
    old, new, name = before.text.splitlines(), now.text.splitlines(), str(before.path)
    lines = difflib.unified_diff(old, new, name, name, lineterm="")
    return Made(now.text, tuple(map(visible, lines)), tuple(reasons))


def refuse_read_only(path: Path) -> None:
    """Raise LocfuseError if a file is read-only (replacing it by renaming would succeed)."""
    if not stat.S_IMODE(path.stat().st_mode) & 0o222 or not os.access(path, os.W_OK):
        raise LocfuseError(f"{path} is read-only: write elsewhere with -o, or allow it: chmod u+w {path}")


def write(path: Path, text: str) -> None:
    """Replace the text of a file and keep its mode; a link is followed."""
    refuse_read_only(path)
    place = path.resolve()
    mode = stat.S_IMODE(place.stat().st_mode)
    with whole_file(place) as temporary:
        temporary.write_bytes(text.encode("utf-8"))
        temporary.chmod(mode)
