"""Which topic feeds the wheels, each sensor, and the truth: by type if it is the only one, else by name.

Truth is never guessed by type: /odom and /amcl_pose are estimates, and an estimate must not judge another.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from ..fusion.data import LocfuseError
from ..fusion.robot import Robot
from ..fusion.sensors.registry import REGISTRY
from ..fusion.truth import TRUTH_READS, looks_like_truth
from ..fusion.wheels import WHEEL_READS

if TYPE_CHECKING:
    from ..formats.log import Log


@dataclass
class Choice:
    """Topics by role ("wheels", a sensor, "truth"), and why a sensor has none."""

    topics: dict[str, str] = field(default_factory=dict)
    absent: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def choose(log: Log, robot: Robot, insisted: Collection[str] = ()) -> Choice:
    """Choose topics. Raises LocfuseError where several fit, none gives the wheels, or a named one is unfit.

    A robot.toml serves many logs, so a sensor or truth topic that it names may be missing; one named by --set
    (`insisted`) may not.
    """
    choice = Choice()
    truth = _truth(log, robot, "truth" in insisted)
    if truth:
        choice.topics["truth"] = truth
    choice.topics["wheels"] = _wheels(log, robot, truth, choice)
    taken = set(choice.topics.values())
    for name, sensor in REGISTRY.items():
        named = robot.settings(name).topic
        if named is not None and named not in log.topics and name not in insisted:
            choice.absent[name] = f"{log.name} has no topic {named}, which robot.toml names"
            continue
        candidates = [t for t in _of_type(log, sensor.reads) if t not in taken]
        candidates = [t for t in candidates if _named_well(t, log.topics[t].msgtype, getattr(sensor, "named", {}))]
        unset = getattr(sensor, "missing", lambda settings: None)(robot.settings(name)) if candidates else None
        topic = None if unset else _one(log, name, named, candidates, sensor.reads)
        if unset:
            choice.absent[name] = unset
        elif topic is None:
            choice.absent[name] = f"no topic of type {_types(sensor.reads)} in {log.name}"
        elif log.topics[topic].count == 0:
            choice.absent[name] = f"{topic} holds no messages"
        else:
            choice.topics[name] = topic
    return choice


def _named_well(topic: str, msgtype: str, named: Mapping[str, tuple[str, ...]]) -> bool:
    """Return whether a bare number's topic says what the number is; other types need no such word."""
    return msgtype not in named or any(word in topic.lower() for word in named[msgtype])


def _of_type(log: Log, reads: Iterable[str]) -> list[str]:
    return [t for t, info in sorted(log.topics.items()) if info.msgtype in reads and info.problem is None]


def _one(log: Log, role: str, named: str | None, candidates: list[str], reads: Iterable[str]) -> str | None:
    """Return the named topic if it fits, else the only candidate with messages, else None."""
    if named is not None:
        return _named(log, role, named, reads)
    filled = [t for t in candidates if log.topics[t].count != 0]
    if len(filled) > 1:
        raise LocfuseError(
            f"{role}: {log.name} has {len(filled)} topics that fit: {', '.join(filled)}. "
            f"Choose one with --set {role}.topic={filled[0]}"
        )
    fit = filled or candidates
    return fit[0] if fit else None


def _named(log: Log, role: str, topic: str, reads: Iterable[str]) -> str:
    info = log.topics.get(topic)
    if info is None:
        have = ", ".join(sorted(log.topics)[:12]) or "no topics"
        raise LocfuseError(f"{role}: {log.name} has no topic {topic}; it has {have}. See: locfuse info {log.name}")
    if info.msgtype not in reads:
        raise LocfuseError(f"{role}: {topic} is {info.msgtype}; accepted: {_types(reads)}")
    if info.problem is not None:
        raise LocfuseError(f"{role}: {topic} cannot be read: {info.problem}")
    return topic


def _truth(log: Log, robot: Robot, insisted: bool) -> str | None:
    if robot.truth.topic is not None and robot.truth.topic not in log.topics and not insisted:
        return None
    candidates = [t for t in _of_type(log, TRUTH_READS) if looks_like_truth(t)]
    return _one(log, "truth", robot.truth.topic, candidates, TRUTH_READS)


def _wheels(log: Log, robot: Robot, truth: str | None, choice: Choice) -> str:
    """Return the wheels' topic: joint angles where the geometry is known, else another odometry."""
    fit = [t for t in _of_type(log, WHEEL_READS) if t != truth]
    joints = [t for t in fit if log.topics[t].msgtype != "nav_msgs/msg/Odometry"]
    odometry = [t for t in fit if t not in joints and log.topics[t].count != 0 and not looks_like_truth(t)]
    known = robot.wheels.radius is not None and robot.wheels.track is not None
    if robot.wheels.topic is None and joints and odometry and not known:
        topic = _one(log, "wheels", None, odometry, WHEEL_READS)
        choice.notes.append(
            f"wheels: {topic} is used, since {joints[0]} gives wheel angles and no wheels.radius and "
            "wheels.track are set"
        )
    else:
        topic = _one(log, "wheels", robot.wheels.topic, joints or odometry, WHEEL_READS)
    if topic is None:
        raise LocfuseError(
            f"wheels: {log.name} has no topic of type {_types(WHEEL_READS)}, so nothing says how the robot "
            f"moved. It has {', '.join(sorted(log.topics)[:12]) or 'no topics'}"
        )
    return topic


def _types(reads: Iterable[str]) -> str:
    return " or ".join(t.replace("/msg/", "/") for t in reads)
