"""Topics of each role, and the rules to choose one: by name, by type, or the only candidate."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import msgspec

from locfuse.formats.logs.adapters import PRESENTED, presented_name
from locfuse.formats.logs.log import Log
from locfuse.formats.text import did_you_mean
from locfuse.fusion.data import LocfuseError
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.wheels.read import WheelReading

WHY_NAMED = "named in the settings"
WHY_ONLY = "the only topic of its type"


class Note(NamedTuple):
    """A note for the user on the choice of a topic."""

    role: str
    words: str
    fixes: tuple[str, ...] = ()  # settings with the same effect
    is_fault: bool = False  # all figures of this log are void
    first: bool = False  # shown before all figures


class Choice(msgspec.Struct):
    """Chosen topics by role ("wheels", a sensor, "truth"), and the reasons for missing ones."""

    topics: dict[str, str] = {}  # first topic of each role
    more: dict[str, tuple[str, ...]] = {}  # further topics of a role
    why: dict[str, str] = {}  # role -> reason for the choice of its topic
    absent: dict[str, str] = {}
    fixes: dict[str, tuple[str, ...]] = {}  # absent role -> settings that may help
    foreign: set[str] = set()  # sensors without any topic in the log
    notes: list[Note] = []
    unused_wheels: tuple[str, ...] = ()  # topics of wheel counters whose scale is unknown
    lacks: str = ""  # unknown settings of the unused wheels, in words
    read: dict[tuple[str, ...], WheelReading] = {}  # motions read during the choice

    def of(self, role: str) -> tuple[str, ...]:
        """Return all topics of a role."""
        return (self.topics[role], *self.more.get(role, ())) if role in self.topics else ()

    def take(self, role: str, topics: Sequence[str], why: str) -> None:
        """Assign topics to a role, with the reason."""
        self.topics[role], self.why[role] = topics[0], why
        if len(topics) > 1:
            self.more[role] = tuple(topics[1:])

    def leave(self, role: str, why: str, fixes: Sequence[str] = ()) -> None:
        """Record why a role has no topic; `fixes` are settings that may give it one."""
        self.absent[role], self.fixes[role] = why, tuple(fixes)


def of_type(log: Log, reads: Iterable[str]) -> list[str]:
    """Return the readable topics of these message types."""
    return [t for t, info in sorted(log.topics.items()) if info.msgtype in reads and info.problem is None]


def filled(log: Log, *msgtypes: str) -> list[str]:
    """Return the readable topics of these message types that have messages."""
    return [t for t in of_type(log, msgtypes) if log.topics[t].count]


def one(log: Log, role: str, named: str | None, candidates: list[str], reads: Iterable[str]) -> str | None:
    """Return the named topic, else the only candidate, else None. Raises LocfuseError for several candidates."""
    if named is not None:
        return checked(log, role, named, reads)
    with_messages = [t for t in candidates if log.topics[t].count != 0]
    if len(with_messages) > 1:
        raise several_fit(log, role, with_messages)
    fit = with_messages or candidates
    return fit[0] if fit else None


def likeliest(topics: Sequence[str], unlikely: Iterable[str], beside: str = "") -> str:
    """Return the topic that is most likely the wanted one; of equally likely ones, the first.

    Preferred are topics of the same robot as the topic `beside` ("robot1" of "/robot1/scan"); without `beside`,
    topics without a robot's name. Among these, topics whose names contain no word of `unlikely` are preferred.
    """
    words, robot = tuple(unlikely), _robot(beside)
    return min(topics, key=lambda t: (_robot(t) != robot, any(word in t.lower() for word in words)))


def of_sensor(log: Log, robot: Robot, sensor: str, kinds: Iterable[str]) -> str | None:
    """Return a sensor's topic of these message types: as configured, else the likeliest; None without one."""
    found, named = filled(log, *kinds), robot.settings(sensor).topic
    return named if named in found else likeliest(found, REGISTRY[sensor].unlikely or ()) if found else None


def _robot(topic: str) -> str:
    """Return the first part of a topic's name, often the robot's name: "robot1" of "/robot1/scan"."""
    return topic.lstrip("/").partition("/")[0] if topic.count("/") > 1 else ""


def of_other_robot(topic: str, beside: str) -> bool:
    """Return whether a topic's robot has the name of that of `beside` but for its number: robot2 beside robot1."""
    robot, other = _robot(beside), _robot(topic)
    return robot != other and re.sub(r"\d+", "#", robot) == re.sub(r"\d+", "#", other)


def several_fit(log: Log, role: str, topics: Sequence[str]) -> LocfuseError:
    """Return the exception for a role (such as "wheels") with several possible topics; its fix names the first."""
    fix = f"{role}.topic={topics[0]}"
    return LocfuseError(
        f"{log.name} has {len(topics)} topics that fit: {', '.join(topics)}.",
        role=role,
        fixes=(fix,),
        hint=f"Choose one with --set {fix}",
    )


def checked(log: Log, role: str, topic: str, reads: Iterable[str]) -> str:
    """Return a configured topic. Raises LocfuseError if it is missing, of another type, or unreadable."""
    info = log.find(topic)
    if info is None:
        have = ", ".join(sorted(log.topics)[:12]) or "no topics"
        near = did_you_mean(topic, of_type(log, reads))  # only topics of a fitting type are suggested
        it = f"{near} It" if near else "it"
        raise LocfuseError(f"{log.name} has no topic {topic}; {it} has {have}.", role=role)
    other = presented_name(topic, info.msgtype)
    if other is not None and PRESENTED[info.msgtype].msgtype in reads:
        return checked(log, role, other, reads)
    if info.msgtype not in reads:
        raise LocfuseError(f"{topic} is {info.msgtype}; accepted: {types(reads)}", role=role)
    if info.problem is not None:
        raise LocfuseError(f"{topic} cannot be read: {info.problem}", role=role)
    return topic


def types(reads: Iterable[str]) -> str:
    """Return message types as text; Foxglove types only if there are no others."""
    kinds = list(reads)
    *others, last = (t.replace("/msg/", "/") for t in [k for k in kinds if "foxglove" not in k] or kinds)
    return f"{', '.join(others)} or {last}" if others else last
