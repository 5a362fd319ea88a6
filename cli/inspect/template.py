"""The draft of robot.toml by `init`: settings found by `inspect_log`, and figures of known robots, with comments.

Lines with known values are active; the others have a comment on how to find the value. A robot that many people
own is recognised by message types, topic names or frames in the log.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from typing import Any, NamedTuple, cast

import msgspec
from msgspec.structs import replace

from locfuse import robots
from locfuse.cli.analysis.choose import best_of
from locfuse.cli.analysis.load import Parts
from locfuse.cli.analysis.mounts import is_base
from locfuse.cli.analysis.robot_tables import attached, flat, make_robot, table_types
from locfuse.cli.analysis.settings import LogOptions, Progress, set_words
from locfuse.cli.analysis.topics import filled, of_type
from locfuse.cli.analysis.wheel_topics import steers
from locfuse.formats.logs.log import Log
from locfuse.formats.robot import robot_toml
from locfuse.formats.robot.robot_toml import TomlLine, TomlSection
from locfuse.fusion.checks.finding import Finding
from locfuse.fusion.checks.laser import OPEN_SCALE
from locfuse.fusion.data import LocfuseError
from locfuse.fusion.sensor import Ask
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.wheels.odometry import BODY_READS, SCANS, STEERED
from locfuse.fusion.wheels.read import JOINTS, NUMBERS, TICKS, counts_ticks
from locfuse.fusion.wheels.steered import MOTOR, SERVO

from .inspect_log import inspect_log
from .robot_facts import Overview, placed_by

Known = dict[str, tuple[Any, str]]  # "table.key" -> (value, source)
TOP_KEYS = ("order", "preset")
STEERED_KEYS = ("radius", "ticks_per_revolution", "servo_gain", "wheelbase", "noise")  # of a tricycle's encoders
MOUNT_KEYS = ("x", "y", "yaw_deg")  # written even if zero
MOUNT_DECIMALS = 6

# instructions for settings that no log contains; Sensor.asks has those of the sensors
HOW_TO_MEASURE = {
    "wheels": {
        "radius": Ask("m: not in this log. Roll a wheel ten turns along a ruler: way / (10 * 2 pi)", needed=True),
        "track": Ask(
            "m: not in this log. From tyre middle to middle; `locfuse calibrate` refines it", needed=True
        ),
        "wheelbase": Ask("m: not in this log. Between the front and the rear axle", needed=True),
        "erpm_per_mps": Ask(
            "electrical revolutions per minute of the motor at 1 m/s: speed_to_erpm_gain of vesc.yaml", blank=True
        ),
        "servo_gain": Ask(
            "of a servo's position: steering_angle_to_servo_gain of vesc.yaml; of a tricycle: ticks of the "
            "steering per radian",
            needed=True,
        ),
        "ticks_per_revolution": Ask("not in this log. Turn a wheel ten times by hand: ticks / 10", needed=True),
        "noise": Ask("m: variance per metre that a wheel rolls; `locfuse calibrate` finds it"),
    },
    "start": dict.fromkeys(
        ("x", "y", "theta_deg"),
        Ask("m, degrees: pose at the first wheel reading, or when `at` says; left out: 0, 0, 0"),
    ),
    "truth": {
        **dict.fromkeys(
            ("x", "y"), Ask("m: the point of the robot that was tracked, forward and left of the axle's middle")
        ),
        "sigma": Ask("m: how exact the truth is itself"),
        "sigma_theta_deg": Ask("degrees: how exact its heading is"),
    },
}
# Settings whose default is written as a guess, since no log contains them.
GUESSED_DEFAULTS = {
    "wheels": {
        "mirrored": "guess: both counters rise while the robot drives forward",
        "steering": "guess: radians of the front wheels (rate: rad/s of the body, heading: rad)",
    }
}
ODOMETRY_SCALES = ("wheels.scale", "wheels.turn_scale")
MAX_ROUNDS = 4  # rounds of inspection: a fix may make other findings visible
# codes of findings with a measured value as fix
MEASURED_CODES = {"lag", "noise", "range scale", "track", "yaw"}
GUESS = "guess: "
GUESSED_CODES = {"choice", "unusable", "truth?"}  # codes of findings with the first candidate as fix


class Draft(NamedTuple):
    """Draft of robot.toml, and the keys that still need a value."""

    overview: Overview  # with all active fixes
    sections: list[TomlSection]
    missing: list[str]  # required keys without a value, of the wheels or a sensor
    guesses: list[str]  # "key=value: why" of choices that the log leaves open
    robot: str = ""  # the known robot whose values are used, in words


def draft(log: Parts, how: LogOptions, progress: Progress, imported: Mapping[str, Mapping[str, Any]]) -> Draft:
    """Inspect a log, apply its fixes until nothing changes, return the draft; `imported`: tables by file name."""
    words = [word for tables in imported.values() for word in set_words(tables)]
    typed, how = how, replace(how, sets=(*words, *how.sets))
    overview = inspect_log(log, how, progress)
    given = _given(overview, typed, imported)
    fixes: Known = {}
    robot, shown = "", _fixes(filter(_may_apply, overview.findings))

    def inspected() -> Overview:
        sets = (robot_toml.as_set(key, value) for key, (value, _) in fixes.items())
        return inspect_log(log, replace(how, sets=(*how.sets, *sets)), progress)

    if (known_robot := recognise_robot(overview)) is not None:
        model, sign = known_robot
        fixes = open_figures(model, overview, {*given, *shown, *found(overview)})
        robot = f"this robot is a {model} ({sign})" if fixes else ""
        overview = inspected() if fixes else overview
    of_robot = {*fixes}
    for _ in range(MAX_ROUNDS):
        chosen = (f for f in overview.findings if _may_apply(f, {*fixes} - of_robot))
        new = {key: fix for key, fix in _fixes(chosen).items() if key not in given}
        if overview.choice.unused_wheels:  # once their size is set, they replace the odometry, which these correct
            new = {key: fix for key, fix in new.items() if key not in ODOMETRY_SCALES}
        if new.items() <= fixes.items():
            break
        fixes |= new
        overview = inspected()
    known = {**found(overview), **fixes, **given}
    suggested = {key: fix for key, fix in _fixes(overview.findings).items() if key not in fixes}
    facts = Facts(overview, known, suggested)
    missing: list[str] = []
    sections = [TomlSection(name, tuple(lines(facts, name, missing))) for name in ("", *table_types())]
    guessed = {key: (value, why) for key, (value, why) in fixes.items() if why.startswith(GUESS)}
    guesses = [f"{key}={value} ({why.removeprefix(GUESS)})" for key, (value, why) in guessed.items()]
    return Draft(overview, sections, missing, guesses, robot)


def _given(overview: Overview, how: LogOptions, imported: Mapping[str, Mapping[str, Any]]) -> Known:
    """Return the given settings with their source: attachment, --robot, another program's file, --set."""
    layers: list[tuple[str, Mapping[str, Any]]] = [("the log's own robot.toml", attached(overview.log) or {})]
    layers += [(file.name, robot_toml.parse(file.read_bytes(), file.name)) for file in how.robots]
    layers += [*imported.items(), ("--set", robot_toml.apply_sets(how.sets))]
    merged = flat(overview.tables)
    return {key: (merged[key], f"by {who}") for who, tables in layers for key in flat(tables)}


def _fixes(findings: Iterable[Finding]) -> Known:
    """Return {key: (value, reason)} of the valid fixes.

    If wheel geometry was found, other fixes for wheels are left out, since they are for an odometry topic.
    """
    found = list(findings)
    replaced = any(f.code == "geometry" and f.fixes for f in found)
    kept = (f for f in found if not replaced or f.role != "wheels" or f.code == "geometry")
    valid: Known = {}
    for f in kept:
        why = f"{GUESS if f.code in GUESSED_CODES else 'as this log shows: '}{f.sentence}"
        why = (f.source or f.message) if f.code == "geometry" else why
        for fix in f.fixes:
            with suppress(LocfuseError):  # a placeholder, which is no value
                tables = robot_toml.apply_sets([fix])
                make_robot(tables)
                valid |= {key: (value, why) for key, value in flat(tables).items()}
    return valid


def _may_apply(f: Finding, known: Collection[str] = ()) -> bool:
    """Return whether `init` may apply the fix of a finding without asking the user.

    It may if the finding is severe, if the value is measured, or if it chooses a topic. It may also change `known`
    keys, set by an earlier round: a new clock offset of the truth changes the start pose.
    """
    again = {*_fixes((f,))} <= {*known}
    return f.code != OPEN_SCALE and (f.severe or again or f.code in {*MEASURED_CODES, "choice"})


class Facts(NamedTuple):
    """Settings for the lines of robot.toml: active ones, and suggestions."""

    overview: Overview
    known: Known  # active lines
    suggested: Known  # fixes that only the robot's owner can judge


def found(overview: Overview) -> Known:
    """Return the settings that the log shows: topics, joints, mounts."""
    known: Known = {}
    for role in ("wheels", "truth", *REGISTRY):
        known |= _topics(overview, role)
    # no wheels.topic: then unused wheels are chosen as soon as their size is set, and a topic that is not the
    # robot's motion is not confirmed as its motion
    if overview.choice.unused_wheels or overview.motion_faults:
        known.pop("wheels.topic", None)
    wheels = overview.choice.unused_wheels or overview.choice.of("wheels")
    if wheels and overview.log.topics[wheels[0]].msgtype == JOINTS and overview.robot_facts.joints is not None:
        why = "guess: the wheels' joints, by their names or because only they turn"
        joints = zip(("left", "right"), overview.robot_facts.joints, strict=True)
        known |= {f"wheels.{side}": (joint, why) for side, joint in joints}
    return known | _mounts(overview)


def _topics(overview: Overview, role: str) -> Known:
    topics, why = overview.choice.of(role), overview.choice.why.get(role, "")
    if not topics and role in REGISTRY:  # a sensor without a required setting may have a topic
        sensor, settings = REGISTRY[role], overview.robot.settings(role)
        fit = best_of(overview.log, sensor, filled(overview.log, *sensor.reads))
        unset = role in overview.choice.absent and len(fit) == 1 and sensor.missing(settings) is not None
        topics, why = (tuple(fit), "the only topic of its type") if unset else ((), "")
    if not topics:
        return {}
    words = f"{overview.log.topics[topics[0]].msgtype.replace('/msg/', '/')}: {why}"
    if len(topics) == 1:
        return {f"{role}.topic": (topics[0], words)}
    if role == "wheels" and overview.log.topics[topics[0]].msgtype in MOTOR:
        steered = "how the car was steered"
        return {"wheels.topic": (topics[0], words), "wheels.steering_topic": (topics[1], steered)}
    if role == "wheels":
        return {"wheels.left_topic": (topics[0], words), "wheels.right_topic": (topics[1], words)}
    return {f"{role}.topics": (list(topics), words)}


def _mounts(overview: Overview) -> Known:
    """Return the sensors' mounts by transforms; zeros of roll, pitch and the like are left out."""
    known: Known = {}
    for name, table in overview.mounts.items():
        if not overview.choice.of(name):  # no topic
            continue
        frame = overview.frames_of(name)[0]
        by = f"by {placed_by(overview, frame)}: where {{}} on the base"
        words = f"its frame {frame} is the base" if is_base(frame) else by.format(f"{frame} sits")
        for key, raw in table.items():
            value = _rounded(raw)
            if value or key in MOUNT_KEYS:
                known[f"{name}.{key}"] = value, by.format("each of them sits") if key == "mounts" else words
    return known


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return round(value, MOUNT_DECIMALS) + 0.0
    if isinstance(value, dict):
        return {key: _rounded(v) for key, v in value.items()}
    return [_rounded(v) for v in value] if isinstance(value, list) else value


def lines(facts: Facts, table: str, missing: list[str]) -> Iterator[TomlLine]:
    """Yield the lines of one table ("": top-level keys); add required keys without a value to `missing`."""
    if not table:
        yield from (TomlLine(key, *facts.known[key]) for key in TOP_KEYS if key in facts.known)
        return
    choice = facts.overview.choice
    unsure = {key: suggestion for key, suggestion in facts.suggested.items() if key.startswith(f"{table}.")}
    for fix in choice.fixes.get(table, ()):  # a topic for a sensor with several candidates
        key, _, value = fix.partition("=")
        unsure |= {key: (value, choice.absent.get(table, ""))} if key == f"{table}.topic" else {}
    shown = table in {"wheels", "start"} or any(key.startswith(f"{table}.") for key in facts.known)
    defaults = {f.name: f.default for f in msgspec.structs.fields(table_types()[table])}
    for key, default in defaults.items():
        path = f"{table}.{key}"
        if path in facts.known:
            yield TomlLine(key, *facts.known[path])
        elif shown and path not in unsure and _has_effect(facts, table, key):
            yield from _unknown(table, key, default, missing)
        if path in unsure:
            asked = _instruction(table, key)
            missing += [path] if choice.unused_wheels and asked and asked.needed else []
            yield TomlLine(key, *unsure[path], holds=False)


def _unknown(table: str, key: str, default: Any, missing: list[str]) -> Iterator[TomlLine]:
    guessed = (REGISTRY[table].guesses if table in REGISTRY else GUESSED_DEFAULTS.get(table, {})).get(key)
    asked = _instruction(table, key)
    if guessed is not None:
        yield TomlLine(key, default, guessed)
    elif asked is not None:
        blank = asked.blank or asked.needed or default in (None, msgspec.NODEFAULT)
        yield TomlLine(key, None if blank else default, asked.words, holds=False)
        if asked.needed:
            missing.append(f"{table}.{key}")


def _has_effect(facts: Facts, table: str, key: str) -> bool:
    """Return whether a key has an effect with the message type of the chosen topic."""
    overview, choice = facts.overview, facts.overview.choice
    topics = (choice.unused_wheels if table == "wheels" else ()) or choice.of(table)
    kind, *others = [overview.log.topics[topic].msgtype for topic in topics] or [""]
    if table in REGISTRY and key in MOUNT_KEYS:
        return not any(f"{table}.{k}" in facts.known for k in (*MOUNT_KEYS, "mounts"))
    if table in REGISTRY:
        return REGISTRY[table].concerns(key, kind)
    if table != "wheels":
        return True
    if steers(topics):
        return key in STEERED_KEYS
    counts = bool(kind) and kind not in (*BODY_READS, *MOTOR)  # an odometry needs no wheel size
    applies = {
        **dict.fromkeys(("radius", "track", "mirrored"), counts),
        "ticks_per_revolution": counts and counts_ticks(kind),
        "wheelbase": kind in MOTOR or (kind in STEERED and overview.robot.wheels.steering == "angle"),
        "erpm_per_mps": bool(filled(overview.log, *MOTOR)),
        "servo_gain": others[:1] == [SERVO],
        "steering": kind in STEERED,
    }
    return applies.get(key, True)


def _instruction(table: str, key: str) -> Ask | None:
    """Return the instruction how to find the value of a key; None if the key has none."""
    return (REGISTRY[table].asks if table in REGISTRY else HOW_TO_MEASURE.get(table, {})).get(key)


# Name -> signs, of which one is enough: a package of message types, a word in a topic's name, a set of frames.
SIGNS_OF_ROBOTS: dict[str, tuple[str | frozenset[str], ...]] = {
    "turtlebot4": ("turtlebot4_msgs", frozenset({"rplidar_link", "shell_link"})),
    "create3": ("irobot_create_msgs",),
    "turtlebot2": ("kobuki_msgs", "kobuki"),
    "turtlebot3_waffle": (frozenset({"base_scan", "caster_back_left_link"}),),
    "turtlebot3_burger": (frozenset({"base_scan", "caster_back_link"}), "turtlebot3_msgs"),
    "duckiebot": ("duckietown_msgs",),
    "jackal": ("jackal_msgs", "jackal", "j100"),
    "husky": ("husky_msgs", "husky", "a200"),
    "pioneer3dx": ("rosaria", "p2os", "p3dx"),
    "mbot": ("mbot_interfaces", "mbot"),
}
UNSURE_NOTES = {"turtlebot3_msgs": "; if it is a Waffle: wheels.track=0.287 and lrf.x=-0.064"}
COUNTER_KEYS = ("radius", "track", "ticks_per_revolution")  # an odometry needs none of them


def recognise_robot(overview: Overview) -> tuple[str, str] | None:
    """Return the first known robot model with message types, topic names or frames in the log, and this sign."""
    packages = {topic.msgtype.partition("/")[0] for topic in overview.log.topics.values()}
    words = {word for topic in overview.log.topics for word in re.split(r"[/_]", topic.lower())}
    frames = {edge.child for edge in overview.transforms.edges}
    for name, signs in SIGNS_OF_ROBOTS.items():
        for sign in signs:
            if isinstance(sign, frozenset):
                if sign <= frames:
                    return name, f"frames {' and '.join(sorted(sign))}"
            elif sign in packages:
                return name, f"messages of {sign}{UNSURE_NOTES.get(sign, '')}"
            elif sign in words:
                return name, f"topics named {sign}"
    return None


def open_figures(model: str, overview: Overview, given: Collection[str]) -> dict[str, tuple[Any, str]]:
    """Return {key: (value, source in words)} of a known robot for needed settings that are not `given`."""
    found: dict[str, tuple[Any, str]] = {}
    for key, figure in robots.figures(model).items():
        table, _, name = key.partition(".")
        if key not in given and _needed(overview, table, name, figure.value, given):
            found[key] = figure.value, f"by robots/{model}.toml, {figure.words}"
    return found


def _needed(overview: Overview, table: str, name: str, value: object, given: Collection[str]) -> bool:
    if table in REGISTRY:  # a mount is used completely or not at all
        return bool(overview.choice.of(table)) and f"{table}.x" not in given
    kind = _wheels_kind(overview)
    if name in {"left", "right"}:
        return kind == JOINTS and _has_joint(overview.log, value)
    if name == "ticks_per_revolution":
        return counts_ticks(kind) if kind else False
    return bool(kind) or name not in COUNTER_KEYS


def _wheels_kind(overview: Overview) -> str:
    """Return the message type of the wheel counters; "" for an odometry, or without counters."""
    topics = overview.choice.of("wheels")
    kind = overview.log.topics[topics[0]].msgtype if topics else SCANS
    if kind != SCANS:  # scan matching is also used if the size of the wheels is unknown
        return "" if kind in BODY_READS else kind
    kinds = (overview.log.topics[t].msgtype for t in of_type(overview.log, (JOINTS, *TICKS, *NUMBERS)))
    return next(kinds, "")


def _has_joint(log: Log, name: object) -> bool:
    for topic in of_type(log, (JOINTS,)):
        with suppress(LocfuseError):  # an unreadable topic has its own finding
            rows = cast("list[tuple[str, ...]]", log.stream(topic).columns("name")["name"])
            if any(name in row for row in set(rows)):
                return True
    return False
