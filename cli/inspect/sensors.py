"""Findings about the raw messages of single sensors, whether or not the log can be measured."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from locfuse.cli.analysis.maps import GRID
from locfuse.cli.analysis.topics import Choice, of_type
from locfuse.fusion.checks.finding import Finding, of_error
from locfuse.fusion.checks.laser_driver import driver
from locfuse.fusion.data import LocfuseError
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY

if TYPE_CHECKING:
    from locfuse.formats.logs.log import Log


def raw_findings(log: Log, robot: Robot, choice: Choice) -> list[Finding]:
    """Return how a laser's driver writes its scans, and what is wrong with a camera's pictures."""
    return [
        *_said("lrf", choice.of("lrf"), _scans, log, robot),
        *_said("camera", pictures_of(log, choice), _pictures, log, robot),
        *_maps(log, robot, choice),
    ]


def _maps(log: Log, robot: Robot, choice: Choice) -> list[Finding]:
    """Offer the maps that a log holds to its laser; the user knows whether they were made of the same scans."""
    topics = [t for t in of_type(log, (GRID,)) if log.topics[t].count and not _costs(t)]
    topics.sort(key=lambda t: t != "/map")
    if not topics or not choice.of("lrf") or robot.settings("lrf").map_topic is not None or robot.lines:
        return []
    words = (
        f"{' and '.join(topics)} {'holds a map' if len(topics) == 1 else 'hold maps'}, in which the laser can be "
        "localised; one that was made of these scans says nothing new"
    )
    return [Finding("lrf", "map", words, (f"lrf.map_topic={topics[0]}",))]


def _costs(topic: str) -> bool:
    """Return whether a grid is a costmap by its name, which has no walls."""
    return "costmap" in topic.lower()


def pictures_of(log: Log, choice: Choice) -> tuple[str, ...]:
    """Return the topics of pictures: the camera's, else all."""
    found = choice.of("camera") or tuple(of_type(log, REGISTRY["camera"].reads))
    return tuple(topic for topic in found if log.topics[topic].count)


def _said(
    role: str, topics: Sequence[str], examine: Callable[[Any, Any], list[Finding]], log: Log, robot: Robot
) -> list[Finding]:
    """Examine the raw messages of a role that has exactly one topic."""
    if len(topics) != 1:
        return []
    try:
        return examine(log.stream(topics[0], robot.order), robot.settings(role))
    except LocfuseError as e:
        return [of_error(e, role, "unusable")]


def _scans(stream: Any, _: Any) -> list[Finding]:
    return driver(stream)


def _pictures(stream: Any, settings: Any) -> list[Finding]:
    from locfuse.fusion.checks.pictures import of_pictures

    return of_pictures(stream, settings)
