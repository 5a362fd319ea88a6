"""Wheel topics: counters of wheel angles, ticks or speeds, else a topic with the body's motion."""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from typing import cast

from locfuse.formats.logs.log import Log
from locfuse.fusion.data import LocfuseError
from locfuse.fusion.robot import Robot
from locfuse.fusion.wheels.odometry import SCANS
from locfuse.fusion.wheels.read import (
    ARRAYS,
    JOINTS,
    NUMBERS,
    SPEEDS,
    TICKS,
    WHEEL_READS,
    counts_ticks,
    joint_names,
)
from locfuse.fusion.wheels.steered import MOTOR, STEERING_WORD

from .body_topics import choose_body, nothing_moves, with_steering
from .topics import WHY_NAMED, WHY_ONLY, Choice, Note, checked, filled, several_fit

OTHER_SIDE = {"left": "right", "l": "r", "lwheel": "rwheel", "lw": "rw"}
# words in topic names
COUNTER_NAME = re.compile("tick|enc|wheel|count|angle")
COMMAND_NAME = re.compile("cmd|command|speed|vel|power|pwm|current|effort|target|setpoint|rpm")


def choose_wheels(log: Log, robot: Robot, choice: Choice) -> None:
    """Choose the wheels' topic or topics. Raises LocfuseError if none or several fit."""
    if named := _named(log, robot):
        choice.take("wheels", named, WHY_NAMED)
        return
    counters, kind = counters_of(log, robot)
    missing = [key.replace("_", " ") for key in missing_of(log, robot, counters)]
    unknown = " and ".join([*filter(None, (", ".join(missing[:-1]),)), *missing[-1:]])
    if counters and not unknown:
        choice.take("wheels", counters, kind)
        return
    wheeled = bool(counters) and are_wheels(log, counters[0], robot)
    described = any(t.rpartition("/")[2] == "robot_description" and log.topics[t].count for t in log.topics)
    asked = wheeled and (described or robot.wheels.radius is not None or robot.wheels.track is not None)
    body = choose_body(log, robot, choice, scans=not asked, stand_in=not wheeled)
    if body is None:
        if not counters:
            raise nothing_moves(log)
        choice.take("wheels", counters, kind)
        return
    choice.take("wheels", body.topics, body.why)
    if body.note:
        choice.notes.append(Note("wheels", body.note, body.fixes, body.is_fault, body.unjudged))
    if counters:
        _say_unused(log, choice, counters, unknown if wheeled else "")


def _say_unused(log: Log, choice: Choice, counters: Sequence[str], lacks: str) -> None:
    """Note why wheel counters are not used; `lacks`: their missing settings, "" if no joint is named wheel."""
    used = choice.topics["wheels"]
    if not lacks:
        words = f"{used} is used, since no joint of {counters[0]} is named like a wheel"
        words = f"{words}; wheels.left and wheels.right name them"
    else:
        words = f"{used} is used, since {_of_wheels(counters, lacks)}"
        if log.topics[used].msgtype == SCANS or (steers(counters) and choice.of("truth")):
            choice.unused_wheels, choice.lacks = tuple(counters), lacks  # scans or truth may calibrate them
    choice.notes.append(Note("wheels", words))


def unused_words(choice: Choice) -> str:
    """Return a sentence on unused wheel counters and their missing settings; "" if there are none."""
    if not choice.unused_wheels:
        return ""
    words = _of_wheels(choice.unused_wheels, choice.lacks)
    return f"{words[0].upper()}{words[1:]}"


def _of_wheels(counters: Sequence[str], lacks: str) -> str:
    verb = "are" if " and " in lacks else "is"
    return f"wheel angles are in {' and '.join(counters)} but {lacks} {verb} unknown"


def _named(log: Log, robot: Robot) -> list[str]:
    """Return the configured topics: of left and right wheel, or of the motion (and its steering); else []."""
    sides = {side: getattr(robot.wheels, f"{side}_topic") for side in ("left", "right")}
    lacking = [side for side, topic in sides.items() if topic is None]
    if len(lacking) == 1:
        hint = f"name the other with --set wheels.{lacking[0]}_topic=<topic>"
        raise LocfuseError("one wheel has its topic;", role="wheels", hint=hint)
    if not lacking:
        return [checked(log, "wheels", topic, NUMBERS) for topic in sides.values()]
    if robot.wheels.topic is None:
        return []
    topic = checked(log, "wheels", robot.wheels.topic, WHEEL_READS)
    kind = log.topics[topic].msgtype
    if kind in MOTOR:
        return with_steering(log, robot, topic)
    if kind not in NUMBERS:
        return [topic]
    if steering := steering_ticks(log, robot, topic):
        return [topic, steering]
    fix = f"wheels.left_topic={topic}"
    words = f"{topic} holds one number, which is one wheel."
    hint = f"Name both with --set {fix} --set wheels.right_topic=<topic>"
    raise LocfuseError(words, role="wheels", fixes=(fix,), hint=hint)


def steering_ticks(log: Log, robot: Robot, traction: str) -> str | None:
    """Return the topic with a tricycle's steering ticks: the configured one, else by its name."""
    named = robot.wheels.steering_topic
    if named is not None:
        return checked(log, "wheels", named, NUMBERS)
    found = [t for t in filled(log, *NUMBERS) if STEERING_WORD in t.lower()]
    return found[0] if len(found) == 1 and found[0] != traction else None


def missing_of(log: Log, robot: Robot, counters: Sequence[str]) -> list[str]:
    """Return the keys of [wheels] that are missing to convert these counters to metres."""
    needed = ["radius", *(("servo_gain", "wheelbase") if steers(counters) else ("track",))]
    if counters and counts_ticks(log.topics[counters[0]].msgtype):
        needed.append("ticks_per_revolution")
    return [key for key in needed if getattr(robot.wheels, key) is None]


def steers(counters: Sequence[str]) -> bool:
    """Return whether the second topic has a tricycle's steering ticks."""
    return len(counters) > 1 and STEERING_WORD in counters[1].lower()


def counters_of(log: Log, robot: Robot) -> tuple[list[str], str]:
    """Return the topics with wheel counters, best kind first, and the reason; [] without any."""
    single = filled(log, *NUMBERS)
    numbers = [t for t in single if _counts_by_name(t)]
    rolls = [t for t in numbers if any(word in t.lower() for word in ("traction", "drive"))]
    steering = steering_ticks(log, robot, rolls[0]) if len(rolls) == 1 else None
    tricycle = [] if steering is None else [rolls[0], steering]
    of_tricycle = "the ticks of a steered wheel and of its steering"
    if tricycle and not missing_of(log, robot, tricycle):
        return tricycle, of_tricycle
    joints, ticks, speeds = (filled(log, *kinds) for kinds in ((JOINTS,), TICKS, SPEEDS))
    arrays = [t for t in filled(log, *ARRAYS) if _counts_by_name(t)]
    pairs = [(left, right) for left in numbers if (right := other_side(left)) in single]
    if len(joints) + len(ticks) + len(speeds) + len(pairs) > 1:
        joints = [t for t in joints if are_wheels(log, t, robot)]
    for found in (joints, ticks, [] if pairs or arrays else speeds, [] if pairs else arrays):
        if len(found) > 1:
            raise several_fit(log, "wheels", found)
        if found:
            return found, WHY_ONLY
    if len(pairs) > 1:
        listed = "; ".join(f"{left} and {right}" for left, right in pairs)
        fixes = (f"wheels.left_topic={pairs[0][0]}", f"wheels.right_topic={pairs[0][1]}")
        words, hint = f"{len(pairs)} pairs of topics that fit", f"Choose one with --set {' --set '.join(fixes)}"
        raise LocfuseError(f"{log.name} has {words}: {listed}.", role="wheels", fixes=fixes, hint=hint)
    if pairs:
        return list(pairs[0]), "the only pair of numbers named left and right"
    return tricycle, of_tricycle if tricycle else ""


def are_wheels(log: Log, topic: str, robot: Robot) -> bool:
    """Return whether a topic of counters has wheel joints (an arm's joints have the same type)."""
    if log.topics[topic].msgtype != JOINTS:
        return True
    names = cast("list[tuple[str, ...]]", log.stream(topic).columns("name")["name"])
    with suppress(LocfuseError):
        joint_names(names, topic, robot.wheels)
        return True
    return False


def _counts_by_name(topic: str) -> bool:
    return bool(COUNTER_NAME.search(topic.lower())) and not COMMAND_NAME.search(topic.lower())


def other_side(topic: str) -> str:
    """Return the right wheel's topic of a left one: /left_ticks -> /right_ticks, /lwheel -> /rwheel; else ""."""
    words = re.split(r"([/_])", topic)
    for i, word in enumerate(words):
        if word.lower() in OTHER_SIDE:
            return "".join([*words[:i], OTHER_SIDE[word.lower()], *words[i + 1 :]])
    return ""
