"""Facts about the robot in its log: robot description, wheel counters, radius and track, mounts of sensors.

Radius and track are measured by an odometry topic, the truth, or scan matching.
"""

from __future__ import annotations

import math
from contextlib import suppress
from typing import Any, NamedTuple, cast

import msgspec
import numpy as np
from msgspec import field

from locfuse.cli.analysis.choose import may_be_truth
from locfuse.cli.analysis.load import Loaded
from locfuse.cli.analysis.mounts import is_base, mount_of, moved_by
from locfuse.cli.analysis.topics import Choice, Note, filled, types
from locfuse.cli.analysis.wheel_topics import are_wheels, counters_of, missing_of
from locfuse.formats.logs.log import Log
from locfuse.formats.robot.transforms import StaticTransforms, WheelGeometry, wheel_geometry
from locfuse.fusion.checks.finding import Finding
from locfuse.fusion.data import BY_SCANS, ODOMETRY as WHEELS, LocfuseError, Ragged, Stream, Truth
from locfuse.fusion.robot import Robot, WheelSettings
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.streams import MergedStream, merged
from locfuse.fusion.truth import looks_like_truth
from locfuse.fusion.wheels.calibrate import Geometry, geometry_by_motion, geometry_by_odometry
from locfuse.fusion.wheels.calibrate_tricycle import TricycleCalibration, calibrate_tricycle, nominal, of_truth
from locfuse.fusion.wheels.odometry import BODY_READS, ODOMETRY
from locfuse.fusion.wheels.read import JOINTS, USUAL_TICKS, joint_names
from locfuse.fusion.wheels.steered import is_tricycle, read_encoders

from .topics import TopicFacts

MAX_STEERED_MISFIT = 0.02  # largest rms / distance of a good fit
MIN_MOVEMENT = 0.05  # least movement of a wheel joint in the log, in its unit


class Steered(NamedTuple):
    """Geometry and steering of a tricycle, calibrated by truth."""

    found: TricycleCalibration
    known: WheelSettings  # as configured, else as assumed for the fit


class RobotFacts(msgspec.Struct, frozen=True):
    """Facts about the robot that its log shows and robot.toml may lack."""

    described: WheelGeometry | None = None  # from /robot_description
    counters: tuple[str, ...] = ()  # topics with wheel turns: used ones, else those of unknown geometry
    fitted: Geometry | None = None  # from an odometry topic of the same wheels
    odometry: str = ""  # the odometry topic, or BY_SCANS
    ticks: float | None = None  # ticks per revolution that are usual for the message type
    joints: tuple[str, str] | None = None  # wheel joints (left, right): by name, or the only ones that turn
    steered: Steered | None = None  # of a tricycle, by truth
    unsteered: str = ""  # why the truth does not show that


class Overview(msgspec.Struct):
    """The result of inspecting a log: topics, roles, mounts, clocks, findings."""

    log: Log
    tables: dict[str, Any]  # merged settings, without mounts from the log
    choice: Choice
    facts: list[TopicFacts]
    transforms: StaticTransforms
    mounts: dict[str, Any]  # tables of sensors, with mounts by these transforms
    robot: Robot  # with mounts where the log could be measured
    loaded: Loaded | None = None
    robot_facts: RobotFacts = field(default_factory=RobotFacts)
    findings: list[Finding] = []

    def frames_of(self, role: str) -> list[str]:
        """Return the frames of a role's topics; "" for a topic without frame."""
        known = {f.topic: f.frame_id for f in self.facts}
        return [known[topic] for topic in self.choice.of(role) if topic in known]

    @property
    def motion_faults(self) -> tuple[Note, ...]:
        """Reasons why the motion topic is not the robot's motion, such as commands; () if it is."""
        return () if self.loaded is None else self.loaded.motion_faults

    @property
    def severe(self) -> bool:
        """Whether a finding would make an estimate wrong, or bytes are lost."""
        return any(f.severe for f in self.findings)


def find_robot_facts(overview: Overview) -> RobotFacts:
    """Return the wheel geometry that the log shows: by description, odometry, truth or scan matching."""
    log, robot, loaded = overview.log, overview.robot, overview.loaded
    described = _described(log)
    counters = _counters(log, robot, overview.choice)
    if not counters:
        return RobotFacts(described)
    kind, both = log.topics[counters[0]].msgtype, merged([log.stream(t) for t in counters])
    ticks = USUAL_TICKS.get(kind)
    if is_tricycle(both):
        steered, why = None, ""
        if loaded is not None and overview.choice.unused_wheels:
            steered, why = _steered(both, loaded)
        return RobotFacts(described, counters, ticks=ticks, steered=steered, unsteered=why)
    joints, settings = _joints(log, counters[0], robot) if kind == JOINTS else None, robot.wheels
    if joints is not None:
        settings = msgspec.structs.replace(settings, left=joints[0], right=joints[1])
    fitted, source = None, ""
    odometry = [t for t in filled(log, ODOMETRY) if not looks_like_truth(t)]
    if odometry:
        source = odometry[0]
        fitted = geometry_by_odometry(both, log.stream(source), settings)
    elif loaded is not None and loaded.drive.wheels.matched is not None and loaded.reading is not None:
        source = BY_SCANS
        with suppress(LocfuseError):  # reported where the counters are used
            fitted = geometry_by_motion(both, loaded.reading, settings)
    return RobotFacts(described, counters, fitted, source, ticks, joints)


def _steered(both: Stream, loaded: Loaded) -> tuple[Steered | None, str]:
    """Return a tricycle calibrated by truth; or None, and why: the truth, or exchanged topics or axes."""
    truth = loaded.drive.truth
    if truth is None or not isinstance(both, MergedStream):
        return None, ""
    if truth.theta is None:
        return None, "the truth has no headings, which a fit to it needs"
    if fitted := _fitted(both, loaded, truth):
        return fitted, ""
    turned, exchanged = MergedStream(both.parts[::-1]), msgspec.structs.replace(truth, xy=truth.xy[:, ::-1])
    if _fitted(turned, loaded, truth):
        return None, f"{both.parts[1].topic} holds the traction and {both.parts[0].topic} the steering"
    if _fitted(both, loaded, exchanged):
        return None, "x and y of the truth are exchanged"
    return None, "no size and steering fit the truth"


def _fitted(both: MergedStream, loaded: Loaded, truth: Truth) -> Steered | None:
    """Return a tricycle calibrated by truth; None if the fit is bad."""
    with suppress(LocfuseError):  # reported where the encoders are used
        shift = (int(both.parts[0].t_ns[0]) - loaded.drive.epoch_ns) * 1e-9 + loaded.robot.wheels.time_offset
        known = nominal(both, loaded.robot.wheels, of_truth(truth), shift)
        found = calibrate_tricycle(read_encoders(both, known), known, of_truth(truth), shift)
        if found.rms < MAX_STEERED_MISFIT * float(loaded.drive.wheels.driven(loaded.drive.wheels.t[-1])):
            return Steered(found, known)
    return None


def wheel_size(overview: Overview) -> list[Finding]:
    """Return a finding on missing wheel settings, with the values that the log shows as fixes."""
    log, robot, found, topics = overview.log, overview.robot, overview.robot_facts, overview.robot_facts.counters
    if not topics:
        return []
    missing = missing_of(log, robot, topics)
    values, source = geometry(robot, found)
    known = {key: f"{value:.5g}" for key, value in values.items()}
    if found.ticks is not None:
        known["ticks_per_revolution"] = f"{found.ticks:g}"
    words = [key.replace("_", " ") for key in missing]
    fixes = [f"wheels.{key}={known[key]}" for key in missing if key in known]
    if (steered := found.steered) is not None:
        fixes += [f"wheels.{key}={known[key]}" for key in ("servo_offset", "max_speed")]
        fixes += [f"truth.{key}={figure.value:.3f}" for key, figure in steered.found.mount.items()]
    if fixes and found.fitted is not None and found.fitted.mirrored != robot.wheels.mirrored:
        fixes.append(f"wheels.mirrored={found.fitted.mirrored}")
    named = robot.wheels.left is not None and robot.wheels.right is not None
    if found.joints is not None and not named and not are_wheels(log, topics[0], robot):
        words.append("the joints of the wheels")
        fixes += [f"wheels.left={found.joints[0]}", f"wheels.right={found.joints[1]}"]
    other = overview.choice.of("wheels") not in ((), topics)  # a note names what is missing
    if not words or (other and not fixes):
        return []
    counts = "count" if len(topics) > 1 else "counts"
    message = f"{' and '.join(topics)} {counts} wheel turns, but these are unknown: {', '.join(words)}"
    severe = not other or found.steered is not None
    return [Finding("wheels", "geometry", message, tuple(fixes), severe, source if fixes else "")]


def geometry(robot: Robot, found: RobotFacts) -> tuple[dict[str, float], str]:
    """Return ({"radius": m, "track": m, ...}, source in words) as the log shows; ({}, "") if it shows none."""
    if found.described is not None and found.described.radius is not None:
        values = {"radius": found.described.radius, "track": found.described.track}
        return values, "/robot_description has these"
    if (steered := found.steered) is not None:
        values = {key: figure.value for key, figure in steered.found.wheels.items()}
        values |= {key: getattr(steered.known, key) for key in ("ticks_per_revolution", "max_speed")}
        left = f"these leave {steered.found.rms:.2f} m (rms) of its path"
        return values, f"fitted to the truth, {left}{steered.found.left_out}"
    if found.fitted is None:
        return {}, ""
    ticks = robot.wheels.ticks_per_revolution or found.ticks
    scale = ticks / (2.0 * np.pi) if ticks and not robot.wheels.ticks_per_revolution else 1.0
    values = {"radius": found.fitted.radius * scale}
    if found.fitted.track is not None:
        values["track"] = found.fitted.track
    if found.odometry == BY_SCANS:
        rows = zip(values.items(), found.fitted.sigmas, strict=False)
        parts = [f"{key} {value:.4g} m (1 sigma {sigma:.1g})" for (key, value), sigma in rows]
        return values, f"matching the scans of this drive gives {' and '.join(parts)}"
    return values, f"{found.odometry} was made with these"


def _counters(log: Log, robot: Robot, choice: Choice) -> tuple[str, ...]:
    """Return the topics with wheel counters, used or not; () without any."""
    topics = choice.of("wheels")
    if topics and log.topics[topics[0]].msgtype not in BODY_READS:
        return topics
    taken = {t for role in choice.topics for t in choice.of(role)}
    with suppress(LocfuseError):  # several candidates: reported by the choice
        found, _ = counters_of(log, robot)
        return () if taken & {*found} else tuple(found)
    return ()


def _joints(log: Log, topic: str, robot: Robot) -> tuple[str, str] | None:
    """Return the names of left and right wheel joint: by name, else the only two that turn; None without two."""
    columns = log.stream(topic).columns("name", "position")
    names = cast("list[tuple[str, ...]]", columns["name"])
    with suppress(LocfuseError):
        return joint_names(names, topic, robot.wheels)
    positions, at = cast("Ragged", columns["position"]), dict[str, list[float]]()
    for i, row in enumerate(names):
        for joint, value in zip(row, positions[i].tolist(), strict=False):
            if math.isfinite(value):
                at.setdefault(joint, []).append(value)
    turning = [joint for joint, values in at.items() if np.abs(np.diff(values)).sum() > MIN_MOVEMENT]
    fixed = {robot.wheels.left, robot.wheels.right}
    if len(turning) != 2 or (fixed - {None} and not fixed & set(turning)):
        return None
    a, b = turning
    words = {j: set(j.lower().replace("-", "_").split("_")) for j in turning}
    return (b, a) if words[a] & {"r", "right", "rw"} or words[b] & {"l", "left", "lw"} else (a, b)


def _described(log: Log) -> WheelGeometry | None:
    """Return the wheel geometry in the log's robot description; None without one."""
    for topic in filled(log, "std_msgs/msg/String"):
        if topic.rpartition("/")[2] == "robot_description":
            with suppress(LocfuseError):
                for text in cast("list[str]", log.stream(topic).columns("data")["data"])[:1]:
                    return wheel_geometry(text)
    return None


def possible_truth(overview: Overview) -> list[Finding]:
    """Return a finding on pose topics that may be ground truth; the user decides."""
    poses = may_be_truth(overview.log, overview.robot, overview.choice)
    if not poses:
        return []
    words = f"none is named; if {' or '.join(poses)} is a reference (not an estimate), say so"
    return [Finding("truth", "truth?", words, (f"truth.topic={poses[0]}",))]


MOUNT_KEYS = ("x", "y", "roll_deg", "pitch_deg", "yaw_deg", "flipped", "mounts")


def extrinsics(overview: Overview) -> dict[str, dict[str, Any]]:
    """Return each sensor's mount settings, with their source under "by".

    That is "settings", "its frame base_link", "/tf_static", "/tf" (constant transforms), or "nobody".
    """
    found: dict[str, dict[str, Any]] = {}
    for name in overview.choice.topics:
        if name not in REGISTRY:
            continue
        settings = overview.robot.settings(name)
        values = {k: getattr(settings, k) for k in MOUNT_KEYS if hasattr(settings, k)}
        if "mounts" in values and "x" in values:  # "mounts" of several sensors, or x, y ... of a single sensor
            several = len(overview.choice.of(name)) > 1
            values = {k: v for k, v in values.items() if (k == "mounts") == several}
        frames = overview.frames_of(name)
        if any(key in overview.tables.get(name, {}) for key in values):
            by = "settings"
        elif frames and all(map(is_base, frames)):
            by = f"its frame {frames[0]}"
        else:
            known = frames and all(mount_of(overview.transforms, frame) is not None for frame in frames)
            by = placed_by(overview, frames[0]) if known else "nobody"
        found |= {name: {**values, "by": by}} if values else {}
    return found


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
    """Return a finding for each used frame with a faulty or second transform, and one for all unused ones."""
    roles = {frame: role for role in overview.choice.topics for frame in overview.frames_of(role)}
    mounts = extrinsics(overview)
    found, others = [], []
    for conflict in overview.transforms.conflicts:
        role = roles.get(conflict.frame, "")
        mount = mounts.get(role, {})
        if not role:
            others.append(conflict.frame)
        elif (by := mount.get("by", "settings")) != "settings":  # fusion.checks.laser tests it by the walls
            keys = [k for k in ("x", "y", "yaw_deg") if isinstance(mount.get(k), float)]
            wrong = by == "nobody" or any(o.role == role and o.code == "yaw" for o in overview.findings)
            fixes = () if wrong else tuple(f"{role}.{k}={mount[k]:.4g}" for k in keys)
            found.append(Finding(role, "tf_static", conflict.line, fixes))
    if others:
        listed = ", ".join(others[:3]) + (" ..." if len(others) > 3 else "")
        words = (
            f"{len(others)} frames have a faulty or second transform ({listed}); no used sensor depends on them"
        )
        found.append(Finding("/tf_static", "tf_static", words))
    return found


# --- the overview as plain values, for `locfuse info --json` (keys: docs/bags.md)


def listed(log: Log) -> dict[str, dict[str, Any]]:
    """Return type, message count and mean rate [Hz] of each topic, without reading messages."""
    span = log.time_span_ns
    seconds = (span[1] - span[0]) * 1e-9 if span else 0.0
    return {
        name: {
            "type": topic.msgtype,
            "messages": topic.count,
            "rate_hz": (topic.count - 1) / seconds if topic.count > 1 and seconds > 0.0 else None,
        }
        for name, topic in log.topics.items()
    }


def values(overview: Overview) -> dict[str, Any]:
    """Return the result of an inspection as plain values."""
    span = overview.log.time_span_ns
    return {
        "name": overview.log.name,
        "files": [p.name for p in overview.log.paths],
        "bytes": overview.log.identity.size,
        "duration_s": (span[1] - span[0]) * 1e-9 if span else None,
        "start_ns": span[0] if span else None,
        "messages": overview.log.message_count,
        "checksums": not overview.log.unchecked,
        "topics": {f.topic: f.values() for f in overview.facts},
        "roles": {
            role: {"topics": list(overview.choice.of(role)), "why": overview.choice.why.get(role)}
            for role in overview.choice.topics
        },
        "absent": absent(overview),
        "extrinsics": extrinsics(overview),
        "configurations": configurations(overview),
        "findings": [
            {"role": f.role, "code": f.code, "message": f.sentence, "fixes": list(f.fixes)}
            | {"source": f.source or None, "severe": f.severe}
            for f in overview.findings
        ],
        "severe": overview.severe,
    }


def absent(overview: Overview) -> dict[str, str]:
    """Return by role or sensor why it has no topic or cannot be used."""
    foreign = {name: f"no topic of type {types(REGISTRY[name].reads)}" for name in sorted(overview.choice.foreign)}
    measured = overview.loaded.drive.absent if overview.loaded is not None else {}
    return {**foreign, **overview.choice.absent, **measured}


def configurations(overview: Overview) -> dict[str, str | None]:
    """Return the reason why a configuration cannot run (None if it can), for odometry, each sensor and "all"."""
    missing, base = absent(overview), wheels_missing(overview)
    known = [name for name in REGISTRY if name in missing or name in overview.choice.topics]
    ready = {name: missing.get(name) or base for name in known}
    together = None if any(why is None for why in ready.values()) else base or "no sensor beside the wheels"
    by_scans = overview.loaded is not None and overview.loaded.drive.wheels.matched is not None
    return {BY_SCANS if by_scans else WHEELS: base, **ready, "all": together}


def wheels_missing(overview: Overview) -> str | None:
    """Return why the robot's motion cannot be estimated from this log; None if it can be estimated."""
    if overview.loaded is not None:
        return None
    unready = (f.sentence for f in overview.findings if f.severe and f.role in {"wheels", "log"})
    return next(unready, None) or absent(overview).get("wheels", "the log cannot be measured")
