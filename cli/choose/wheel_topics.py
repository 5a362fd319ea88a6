"""Which topics feed the wheels: angles, ticks or speeds of the wheels, else the body's motion as somebody says it.

The body's motion is taken from, in this order: an odometry topic, an odometry that only /tf has, a measured twist,
the scans of a laser.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, cast

from locfuse.fusion.data import LocfuseError
from locfuse.fusion.robot import Robot
from locfuse.fusion.truth import looks_like_truth
from locfuse.fusion.wheels.odometry import ODOMETRY, POSE, SCANS, SPEED, STEERED
from locfuse.fusion.wheels.read import WHEEL_READS, counts_ticks
from locfuse.fusion.wheels.sources import JOINTS, NUMBERS, SPEEDS, TICKS, joint_names

from .mounts import BASE_FRAMES
from .topics import NAMED, ONLY, Choice, checked, of_type, one, several_fit, types

if TYPE_CHECKING:
    from locfuse.formats.log.log import Log

OTHER_SIDE = {"left": "right", "l": "r", "lwheel": "rwheel", "lw": "rw"}
COUNTER_WORDS = ("tick", "enc", "wheel", "count", "angle")  # what a wheel's own topic is called ...
COMMAND_WORDS = (
    "cmd",
    "command",
    "speed",
    "vel",
    "power",
    "pwm",
    "current",
    "effort",
    "target",
    "setpoint",
    "rpm",
)
COMMANDED = ("cmd", "command", "target", "setpoint", "teleop", "joy")  # what the body was asked to do
TWISTS = tuple(kind for kind in (*SPEED, *STEERED) if kind not in POSE)
ODOMETRY_FRAMES = ("odom", "odometry")  # last word of the frame in which an odometry says its pose


def choose_wheels(log: Log, robot: Robot, choice: Choice) -> None:
    """Take the wheels' topic, or topics. Raises LocfuseError where none fits, or several do."""
    settings = robot.wheels
    if settings.left_topic is not None or settings.right_topic is not None:
        choice.take("wheels", _named_pair(log, robot), NAMED)
        return
    if settings.topic is not None:
        topic = checked(log, "wheels", settings.topic, WHEEL_READS)
        if log.topics[topic].msgtype in NUMBERS:
            fix = f"wheels.left_topic={topic}"
            raise LocfuseError(
                f"{topic} holds one number, which is one wheel.",
                role="wheels",
                fixes=(fix,),
                hint=f"Name both with --set {fix} --set wheels.right_topic=<topic>",
            )
        choice.take("wheels", [topic], NAMED)
        return
    counters, kind = _counters(log, robot)
    unknown = _unknown(log, robot, counters)
    if counters and not unknown:
        choice.take("wheels", counters, kind)
        return
    bodies, why = _bodies(log, choice)
    topic_or_none = one(log, "wheels", None, bodies, WHEEL_READS)
    if topic_or_none is None and not counters:
        topic_or_none, why = _scans(log, robot), "no wheels and no odometry: its scans are matched with each other"
    if topic_or_none is None:
        if not counters:
            raise _nothing(log)
        choice.take("wheels", counters, kind)
        return
    choice.take("wheels", [topic_or_none], why)
    if counters:
        choice.notes.append(
            f"{topic_or_none} is used, since {' and '.join(counters)} gives wheel angles and no {unknown} "
            f"{'are' if ' and ' in unknown else 'is'} set"
        )


def _bodies(log: Log, choice: Choice) -> tuple[list[str], str]:
    """Return topics that say how the body moved, those of the best kind, and why."""
    taken = {topic for role in choice.topics for topic in choice.of(role)}

    def filled(kinds: Sequence[str]) -> list[str]:
        return [
            t
            for t in of_type(log, kinds)
            if log.topics[t].count and t not in taken and ":" not in t and not looks_like_truth(t)
        ]

    if odometry := filled((ODOMETRY,)):
        return odometry, ONLY
    if pairs := odometry_frames(log):
        return pairs, "the only odometry in /tf"
    return [t for t in filled(TWISTS) if not commanded(t)], ONLY


def _scans(log: Log, robot: Robot) -> str | None:
    """Return the laser whose scans say how the robot moved: the sensor's own where named, else the only one."""
    named = robot.settings("lrf").topic
    filled = [t for t in of_type(log, (SCANS,)) if log.topics[t].count]
    return named if named in filled else one(log, "wheels", None, filled, WHEEL_READS)


def odometry_frames(log: Log) -> list[str]:
    """Return the pairs of frames in /tf that are an odometry, as topics: a base that moves in a frame odom."""
    found: dict[str, bool] = {}
    for topic in log.transform_topics:
        for (parent, child), edge in log.frames(topic).items():
            if edge.moves and _last_word(parent) in ODOMETRY_FRAMES:
                found[f"{topic}:{parent}:{child}"] = _last_word(child) in BASE_FRAMES
    based = [name for name, base in found.items() if base]
    names = based or list(found)
    return [name for name in names if log.find(name) is not None]


def _last_word(frame: str) -> str:
    return frame.rpartition("/")[2].lower()


def commanded(topic: str) -> bool:
    """Return whether a topic's name says that its speeds were asked for, not measured."""
    return any(word in topic.lower() for word in COMMANDED)


def _unknown(log: Log, robot: Robot, counters: Sequence[str]) -> str:
    """Return which settings are missing before these counters become metres, in words; "" for none."""
    settings = robot.wheels
    missing = [key for key in ("radius", "track") if getattr(settings, key) is None]
    if counters and counts_ticks(log.topics[counters[0]].msgtype) and settings.ticks_per_revolution is None:
        missing.append("ticks_per_revolution")
    return " and ".join(f"wheels.{key}" for key in missing)


def _named_pair(log: Log, robot: Robot) -> list[str]:
    """Return the topics that the settings name, left first."""
    pair = []
    for side in ("left", "right"):
        topic = getattr(robot.wheels, f"{side}_topic")
        if topic is None:
            raise LocfuseError(
                "one wheel has its topic;",
                role="wheels",
                hint=f"name the other with --set wheels.{side}_topic=<topic>",
            )
        pair.append(checked(log, "wheels", topic, NUMBERS))
    return pair


def _counters(log: Log, robot: Robot) -> tuple[list[str], str]:
    """Return what counts wheel turns, best kind first, and why; nothing where nothing does."""
    joints, ticks, speeds = (
        [t for t in of_type(log, kind) if log.topics[t].count != 0] for kind in ((JOINTS,), TICKS, SPEEDS)
    )
    pairs = pair_topics(log)
    if len(joints) + len(ticks) + len(speeds) + len(pairs) > 1:
        joints = [t for t in joints if _has_wheels(log, t, robot)]
    for found in (joints, ticks, [] if pairs else speeds):
        if len(found) > 1:
            raise several_fit(log, "wheels", found)
        if found:
            return found, ONLY
    if len(pairs) > 1:
        listed = "; ".join(f"{left} and {right}" for left, right in pairs)
        fixes = (f"wheels.left_topic={pairs[0][0]}", f"wheels.right_topic={pairs[0][1]}")
        raise LocfuseError(
            f"{log.name} has {len(pairs)} pairs of topics that fit: {listed}.",
            role="wheels",
            fixes=fixes,
            hint=f"Choose one with --set {fixes[0]} --set {fixes[1]}",
        )
    return (list(pairs[0]), "the only pair of numbers named left and right") if pairs else ([], "")


def _has_wheels(log: Log, topic: str, robot: Robot) -> bool:
    """Return whether joints on a topic are named like wheels: an arm's joints share the type."""
    names = cast("list[tuple[str, ...]]", log.stream(topic).columns("name")["name"])
    try:
        joint_names(names, topic, robot.wheels)
    except LocfuseError:
        return False
    return True


def pair_topics(log: Log) -> list[tuple[str, str]]:
    """Return pairs of topics with a number each, named alike but for left and right, that read like wheels."""
    numbers = [t for t in of_type(log, NUMBERS) if log.topics[t].count != 0]
    found = []
    for topic in numbers:
        partner = other_side(topic)
        low = topic.lower()
        if (
            partner in numbers
            and any(w in low for w in COUNTER_WORDS)
            and not any(w in low for w in COMMAND_WORDS)
        ):
            found.append((topic, partner))
    return found


def other_side(topic: str) -> str | None:
    """Return the right wheel's topic for the left one's: /left_ticks -> /right_ticks, /lwheel -> /rwheel."""
    words = re.split(r"([/_])", topic)
    for i, word in enumerate(words):
        if word.lower() in OTHER_SIDE:
            return "".join([*words[:i], OTHER_SIDE[word.lower()], *words[i + 1 :]])
    return None


class NoWheelsError(LocfuseError):
    """No topic gives the wheels' motion; the hint lists the topics that there are."""


def _nothing(log: Log) -> NoWheelsError:
    """Return the error that says what is read, and what of this log could stand in."""
    kinds = (JOINTS, *TICKS, ODOMETRY)
    have = ", ".join(sorted(log.topics)[:12]) or "no topics"
    asked = [t for t in of_type(log, TWISTS) if log.topics[t].count]
    poses = [t for t in of_type(log, POSE) if log.topics[t].count]
    stand_in = [f"{t} holds {_what(t, asked)}: --set wheels.topic={t} takes it" for t in (asked + poses)[:1]]
    return NoWheelsError(
        f"{log.name} has no topic of type {types(kinds)}, no odometry in /tf, nor two std_msgs numbers named left "
        "and right, and no laser, so nothing says how the robot moved.",
        role="wheels",
        hint=". ".join((f"It has {have}", *stand_in)),
    )


def _what(topic: str, asked: Sequence[str]) -> str:
    return "the commanded motion" if topic in asked else "poses, whose increments can stand in"
