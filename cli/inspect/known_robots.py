"""Known robot models that `init` recognises, with values of settings that no log contains.

A value of a known robot is used only if neither the log nor the user gives one.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from contextlib import suppress
from typing import Any, cast

from locfuse import robots
from locfuse.cli.analysis.topics import of_type
from locfuse.formats.logs.log import Log
from locfuse.fusion.data import LocfuseError
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.wheels.odometry import BODY_READS, SCANS
from locfuse.fusion.wheels.read import JOINTS, NUMBERS, TICKS, counts_ticks

from .robot_facts import Overview

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


def recognise(overview: Overview) -> tuple[str, str] | None:
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
