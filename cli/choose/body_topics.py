"""Which topics say how the body moved, where no wheels with known geometry do.

In this order: an odometry topic, an odometry that only /tf has, a measured twist. Where a log has none of these,
nor wheels that count, what stands in is taken and said: the scans of a laser, else poses that another program
estimated, else speeds that were only commanded.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

from locfuse.fusion.data import LocfuseError
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.truth import looks_like_truth
from locfuse.fusion.wheels.odometry import ODOMETRY, PLANAR, POSE, SCANS, SPEED, STEERED, TRANSFORM, commanded
from locfuse.fusion.wheels.read import WHEEL_READS
from locfuse.fusion.wheels.sources import JOINTS, TICKS

from .mounts import BASE_FRAMES
from .topics import ONLY, Choice, of_type, one, types

if TYPE_CHECKING:
    from locfuse.formats.log.log import Log

TWISTS = tuple(kind for kind in SPEED if kind not in (*POSE, *PLANAR))
POSES = tuple(kind for kind in (*POSE, *PLANAR) if kind not in (ODOMETRY, TRANSFORM))
ODOMETRY_FRAMES = ("odom", "odometry")  # last word of the frame in which an odometry says its pose
FIXED_FRAMES = (
    *ODOMETRY_FRAMES,
    "map",
    "world",
    "earth",
)  # ... and of those in which another program says where it is
MADE_OF_MORE = (
    "filter",
    "ekf",
    "ukf",
    "fused",
    "visual",
    "vio",
    "camera",
    "icp",
    "slam",
    "map",
    "amcl",
    "gps",
    "lidar",
)
ASKED_FOR = ("goal", "initial", "waypoint")  # poses that are wishes or guesses of a person
ESTIMATED = (
    "{topic} holds poses that another program estimated. They are taken, since nothing else in this log says how "
    "the robot moved; sensors that they were made of count twice"
)
ONLY_COMMANDED = (
    "{topic} holds commanded speeds. They are taken, since nothing in this log measured how the robot moved; a "
    "command lasts until the next one, a second at most, and wheels.noise=0.004 is usual for such a motion"
)


class Body(NamedTuple):
    """The topic that says how the body moved."""

    topic: str
    why: str
    note: str = ""  # what a user has to know of it


def choose_body(log: Log, robot: Robot, choice: Choice, stand_in: bool = True) -> Body | None:
    """Return the topic that says how the body moved, None where no topic does. Raises LocfuseError for several.

    `stand_in`: whether scans, poses that were estimated, and speeds that were commanded will do.
    """
    topics, why = _measured(log, robot, choice)
    topic = one(log, "wheels", None, topics, WHEEL_READS)
    if topic is not None:
        return Body(topic, why)
    return _stand_in(log, robot, choice) if stand_in else None


def _stand_in(log: Log, robot: Robot, choice: Choice) -> Body | None:
    """Return what stands in for a measured motion: scans, else poses, else commands, else a steering angle."""
    if (scans := _scans(log, robot)) is not None:
        return Body(scans, "no wheels and no odometry: its scans are matched with each other")
    for topics, note in (
        (_poses(log, robot, choice), ESTIMATED),
        (_twists(log, robot, choice, asked=True), ONLY_COMMANDED),
        (_filled(log, robot, choice, tuple(STEERED)), ""),  # lacks the wheelbase, which its reader asks for
    ):
        if (topic := one(log, "wheels", None, topics, WHEEL_READS)) is not None:
            return Body(topic, "nothing else says how the robot moved", note.format(topic=topic))
    return None


def _measured(log: Log, robot: Robot, choice: Choice) -> tuple[list[str], str]:
    """Return topics that measured how the body moved, those of the best kind, the likeliest first, and why."""
    if odometry := _filled(log, robot, choice, (ODOMETRY,)):
        return sorted(odometry, key=_made_of_more), ONLY
    if pairs := odometry_frames(log):
        return pairs, "the only odometry in /tf"
    return _twists(log, robot, choice, asked=False), ONLY


def _filled(log: Log, robot: Robot, choice: Choice, kinds: Sequence[str]) -> list[str]:
    """Return recorded topics of these types that hold messages and that nobody else reads.

    A topic that the settings give to a sensor of its own (`[pose] topic`) is left to it where there are others.
    """
    taken = {topic for role in choice.topics for topic in choice.of(role)}
    found = [
        t
        for t in of_type(log, kinds)
        if log.topics[t].count and t not in taken and ":" not in t and not looks_like_truth(t)
    ]
    asked = {robot.settings(name).topic for name, sensor in REGISTRY.items() if sensor.asked_only}
    return [t for t in found if t not in asked] or found


def _made_of_more(topic: str) -> bool:
    """Return whether an odometry's name says that it was made of more than the wheels."""
    return any(word in topic.lower() for word in MADE_OF_MORE)


def _twists(log: Log, robot: Robot, choice: Choice, asked: bool) -> list[str]:
    """Return topics of speeds that can be read: commanded ones (`asked`), or those that were measured."""
    kinds = (*TWISTS, *STEERED) if robot.wheels.wheelbase else TWISTS
    return [t for t in _filled(log, robot, choice, kinds) if commanded(t) == asked]


def _poses(log: Log, robot: Robot, choice: Choice) -> list[str]:
    """Return poses of the robot that another program estimated: topics, else frames of /tf."""
    topics = [t for t in _filled(log, robot, choice, POSES) if not asked_for(t)]
    return topics or moving_frames(log, FIXED_FRAMES)


def asked_for(topic: str) -> bool:
    """Return whether a topic's name says that its poses are wishes or guesses of a person."""
    return any(word in topic.lower() for word in ASKED_FOR)


def _scans(log: Log, robot: Robot) -> str | None:
    """Return the laser whose scans say how the robot moved: the sensor's own where named, else the only one."""
    named = robot.settings("lrf").topic
    filled = [t for t in of_type(log, (SCANS,)) if log.topics[t].count]
    return named if named in filled else one(log, "wheels", None, filled, WHEEL_READS)


def odometry_frames(log: Log) -> list[str]:
    """Return the pairs of frames in /tf that are an odometry, as topics: a base that moves in a frame odom."""
    return moving_frames(log, ODOMETRY_FRAMES)


def moving_frames(log: Log, parents: Sequence[str]) -> list[str]:
    """Return pairs of frames in /tf, as topics, that move in one of these; only a base's where there is one."""
    found: dict[str, bool] = {}
    for topic in log.transform_topics:
        for (parent, child), edge in log.frames(topic).items():
            if edge.moves and _last_word(parent) in parents and _last_word(child) not in FIXED_FRAMES:
                found[f"{topic}:{parent}:{child}"] = _last_word(child) in BASE_FRAMES
    based = [name for name, base in found.items() if base]
    names = based or list(found)
    return [name for name in names if log.find(name) is not None]


def _last_word(frame: str) -> str:
    return frame.rpartition("/")[2].lower()


class NoWheelsError(LocfuseError):
    """No topic gives the wheels' motion; the hint lists the topics that there are."""


def nothing_moves(log: Log) -> NoWheelsError:
    """Return the error that says what is read, and which topics this log has."""
    kinds = (JOINTS, *TICKS, ODOMETRY)
    have = ", ".join(sorted(log.topics)[:12]) or "no topics"
    return NoWheelsError(
        f"{log.name} has no topic of type {types(kinds)}, no odometry in /tf, nor two std_msgs numbers named left "
        "and right, no laser, no poses and no speeds, so nothing says how the robot moved.",
        role="wheels",
        hint=f"It has {have}",
    )
