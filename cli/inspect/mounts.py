"""Where the sensors of a log sit, who says so, and where that is nobody, or two who contradict each other."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from locfuse.cli.choose.mounts import BASE_FRAMES, mount_of
from locfuse.fusion.doctor.finding import Oddity
from locfuse.fusion.sensors.registry import REGISTRY

if TYPE_CHECKING:
    from .overview import Look

MOUNT_KEYS = ("x", "y", "roll_deg", "pitch_deg", "yaw_deg", "flipped", "mounts")


def extrinsics(seen: Look) -> dict[str, dict[str, Any]]:
    """Return where each sensor sits, and who says so."""
    found: dict[str, dict[str, Any]] = {}
    for name in seen.choice.topics:
        if name not in REGISTRY:
            continue
        settings = seen.robot.settings(name)
        values = {k: getattr(settings, k) for k in MOUNT_KEYS if hasattr(settings, k)}
        if values:
            found[name] = {**values, "by": _mount_by(seen, name, values)}
    return found


def _mount_by(seen: Look, name: str, keys: Mapping[str, Any]) -> str:
    """Return who says where a sensor sits: the settings, its frame, /tf_static, or nobody."""
    if any(key in seen.tables.get(name, {}) for key in keys):
        return "settings"
    facts = {f.topic: f for f in seen.facts}
    frames = [facts[t].frame_id for t in seen.choice.of(name) if t in facts]
    if frames and all(frame in BASE_FRAMES for frame in frames):
        return f"its frame {frames[0]}"
    known = [frame for frame in frames if mount_of(seen.transforms, frame) is not None]
    return "/tf_static" if known and len(known) == len(frames) else "nobody"


def unplaced(seen: Look) -> list[Oddity]:
    """Say of the sensors whose place matters that nobody says where they sit."""
    found = []
    for name, mount in extrinsics(seen).items():
        if mount["by"] == "nobody" and REGISTRY[name].placed:
            keys = f"{name}.mounts" if "mounts" in mount else f"{name}.x, {name}.y, {name}.yaw_deg"
            words = f"nothing says where it sits on the robot: the base's origin is assumed (set {keys})"
            found.append(Oddity("mount", name, words))
    return found


def conflicts(seen: Look) -> list[Oddity]:
    """Name the frames that are said to be in two places: those that matter one by one, the others together."""
    facts = {f.topic: f for f in seen.facts}
    frames = {facts[t].frame_id: role for role in seen.choice.topics for t in seen.choice.of(role) if t in facts}
    found, others = [], []
    for words in seen.transforms.conflicts:
        frame = words.partition(":")[0]
        role = frames.get(frame, "")
        mount = extrinsics(seen).get(role, {})
        if not role:
            others.append(frame)
        elif mount.get("by") == "/tf_static":  # whether it is wrong the walls tell, see doctor_laser
            keys = [k for k in ("x", "y", "yaw_deg") if isinstance(mount.get(k), float)]
            wrong = any(o.stream == role and o.code == "yaw" for o in seen.oddities)
            cures = () if wrong else tuple(f"{role}.{k}={mount[k]:.4g}" for k in keys)
            found.append(Oddity("tf_static", role, words, cures))
    if others:
        listed = ", ".join(others[:3]) + (" ..." if len(others) > 3 else "")
        words = f"{len(others)} frames are said to be in two places ({listed}); no sensor used here sits there"
        found.append(Oddity("tf_static", "/tf_static", words))
    return found
