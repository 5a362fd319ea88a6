"""Findings on sensor mounts: their sources, sensors without a mount, and contradicting transforms."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from locfuse.cli.analysis.mounts import is_base, mount_of, moved_by
from locfuse.fusion.checks.finding import Finding
from locfuse.fusion.sensors.registry import REGISTRY

if TYPE_CHECKING:
    from .robot_facts import Overview

MOUNT_KEYS = ("x", "y", "roll_deg", "pitch_deg", "yaw_deg", "flipped", "mounts")


def extrinsics(overview: Overview) -> dict[str, dict[str, Any]]:
    """Return each sensor's mount settings, with their source under "by"."""
    found: dict[str, dict[str, Any]] = {}
    for name in overview.choice.topics:
        if name not in REGISTRY:
            continue
        settings = overview.robot.settings(name)
        values = {k: getattr(settings, k) for k in MOUNT_KEYS if hasattr(settings, k)}
        if "mounts" in values and "x" in values:  # "mounts" of several sensors, or x, y ... of a single sensor
            several = len(overview.choice.of(name)) > 1
            values = {k: v for k, v in values.items() if (k == "mounts") == several}
        if values:
            found[name] = {**values, "by": _mount_by(overview, name, values)}
    return found


def _mount_by(overview: Overview, name: str, keys: Mapping[str, Any]) -> str:
    """Return the source of a sensor's mount: "settings", "its frame ...", "/tf_static", "/tf" or "nobody"."""
    if any(key in overview.tables.get(name, {}) for key in keys):
        return "settings"
    frames = overview.frames_of(name)
    if frames and all(is_base(frame) for frame in frames):
        return f"its frame {frames[0]}"
    known = [frame for frame in frames if mount_of(overview.transforms, frame) is not None]
    return placed_by(overview, known[0]) if known and len(known) == len(frames) else "nobody"


def placed_by(overview: Overview, frame: str) -> str:
    """Return the source of a frame's mount: "/tf_static", else "/tf" (constant transforms)."""
    return "/tf_static" if mount_of(overview.log.static_transforms(), frame) is not None else "/tf"


def unplaced(overview: Overview) -> list[Finding]:
    """Return a finding for each sensor that needs a mount and has none."""
    found = []
    for name, mount in extrinsics(overview).items():
        moves = any(moved_by(overview.transforms, frame) for frame in overview.frames_of(name))
        if mount["by"] == "nobody" and REGISTRY[name].placed and not moves:
            keys = f"{name}.mounts" if "mounts" in mount else f"{name}.x, {name}.y, {name}.yaw_deg"
            words = f"its mount on the robot is unknown: the base's origin is assumed (set {keys})"
            found.append(Finding(name, "mount", words))
    return found


def conflicts(overview: Overview) -> list[Finding]:
    """Return a finding for each used frame with two different transforms, and one for all such unused frames."""
    roles = {frame: role for role in overview.choice.topics for frame in overview.frames_of(role)}
    mounts = extrinsics(overview)
    found, others = [], []
    for conflict in overview.transforms.conflicts:
        role = roles.get(conflict.frame, "")
        mount = mounts.get(role, {})
        if not role:
            others.append(conflict.frame)
        elif mount.get("by") in {"/tf_static", "/tf"}:  # fusion.checks.laser tests it by the walls
            keys = [k for k in ("x", "y", "yaw_deg") if isinstance(mount.get(k), float)]
            wrong = any(o.role == role and o.code == "yaw" for o in overview.findings)
            fixes = () if wrong else tuple(f"{role}.{k}={mount[k]:.4g}" for k in keys)
            found.append(Finding(role, "tf_static", conflict.line, fixes))
    if others:
        listed = ", ".join(others[:3]) + (" ..." if len(others) > 3 else "")
        words = f"{len(others)} frames have two different transforms ({listed}); no used sensor depends on them"
        found.append(Finding("/tf_static", "tf_static", words))
    return found
