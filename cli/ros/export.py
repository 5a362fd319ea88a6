"""Parameters of ROS nodes for a log or a result, as a new file or as changes of an existing file."""

from __future__ import annotations

import difflib
import os
import stat
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from locfuse.formats.robot.ros_nodes import NODES, section_of, sections_of
from locfuse.formats.robot.ros_yaml import RosFile, Setting, changed, in_yaml, parsed, render
from locfuse.formats.text import visible
from locfuse.formats.whole_files import whole_file
from locfuse.fusion.data import LocfuseError

from . import amcl, diff_drive, ekf, fusioncore
from .found import FoundRobot

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
