"""Topics with the body's motion, for robots without wheels of known geometry.

Candidates are ordered by what they hold: an odometry, an odometry that only /tf has, measured speeds, the scans of
a laser, poses that another program estimated. With a laser they are judged by it (`motion_evidence`); a Twist
never comes before scans. Last come commands and poses that are not the robot's, which spoil every figure.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

from locfuse.fusion.data import LocfuseError
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.level import IMU
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.truth import FIX, looks_like_truth
from locfuse.fusion.wheels.odometry import ODOMETRY, PLANAR, POSE, SCANS, SPEED, STEERED, TRANSFORM, commanded
from locfuse.fusion.wheels.read import WHEEL_READS
from locfuse.fusion.wheels.steered import GAIN_HINT, MOTOR, SERVO

from .adapted_topics import not_read
from .motion_evidence import Evidence, MotionSensors
from .mounts import is_base, is_fixed, is_odometry, is_room
from .topics import ONLY, Choice, checked, filled, of_sensor, one

if TYPE_CHECKING:
    from locfuse.formats.logs.log import Log

TWISTS = tuple(kind for kind in SPEED if kind not in (*POSE, *PLANAR))
POSES = tuple(kind for kind in (*POSE, *PLANAR) if kind not in (ODOMETRY, TRANSFORM))
# words in the names of topics
MADE_OF_MORE = re.compile(
    "filter|ekf|ukf|fused|visual|vio|camera|icp|slam|map|amcl|lidar|zed|vins|loam|lio|rtabmap|realsense|t265"
    "|combined|global|rf2o|kiss|laser|scan|mavros"
)
OF_FILTERS = re.compile("filter|ekf|ukf|fused|combined|global")  # of these: IMU and fixes are in the estimate
BY_FIXES = re.compile("fix_vel|gps|gnss|navsat|ublox|novatel|septentrio")  # speeds north and east
MADE_OF_FIXES = re.compile("gps|gnss|navsat")  # navsat_transform's has no heading
ONLY_CORRECT = (FIX, IMU)  # types that make no motion by themselves
RAW = re.compile("unfiltered|raw|wheel|encoder|_enc")
ADAPTED_SUFFIX = ":odometry"  # of topics of another type that were made into an Odometry
NOTHING_ELSE = "nothing else says how the robot moved"
NEAREST = "the odometry nearest to the wheels"
OBEYED = ("cmd_vel", "ackermann_cmd")  # what drivers of bases listen to: the end of a chain of commands
PASSED_ON = re.compile("teleop|joy|key|nav|raw|smooth|mux|input|plan|auto|unstamped")
OF_COMMANDS = "; of several commands ({others} beside it) the base obeys it, by its name"
ESTIMATED = (
    "{topic} holds poses that another program estimated. They are taken, since nothing else in this log says how "
    "the robot moved; sensors that they were made of count twice"
)
ONLY_COMMANDED = (
    "{topic} holds commanded speeds, and nothing in this log measured how the robot moved. Use them only if it "
    "did what was commanded (a command lasts until the next one, a second at most; wheels.noise=0.004 is usual)"
)
HOLDS_MORE = (
    "{topic} already holds other sensors (IMU, GPS), by its name: beside it they count twice. Record the odometry "
    "of the wheels alone, too"
)
WISHED = (
    "{topic} holds poses that were asked for, by its name, and nothing in this log measured how the robot moved"
)
IN_CAMERA = (
    "{topic} holds poses in the frame {frame}: of something that a camera sees. Nothing in this log says how the "
    "robot moved"
)
CAMERA_FRAMES = re.compile("camera|optical|marker|aruco|tag")  # frames whose poses are no robot's


class Body(NamedTuple):
    """The topic of the body's motion."""

    topic: str
    why: str
    note: str = ""  # what a user has to know of it
    fixes: tuple[str, ...] = ()  # settings that choose the same
    beside: tuple[str, ...] = ()  # a car's steering, beside its motor
    is_fault: bool = False  # it is not the robot's motion: the note says why
    unjudged: bool = False  # another motion disagrees, and nothing judges them: the note says so

    @property
    def topics(self) -> tuple[str, ...]:
        """All its topics."""
        return (self.topic, *self.beside)


def choose_body(log: Log, robot: Robot, choice: Choice, scans: bool, stand_in: bool) -> Body | None:
    """Return the topic of the body's motion, None if there is none. Raises LocfuseError for several.

    `scans`: whether scans will do; `stand_in`: whether estimated poses and commands will.
    """
    laser = of_sensor(log, robot, "lrf", (SCANS,)) if scans else None
    if laser is None:
        body = _best_agreeing(log, robot, choice, [*_measured(log, robot, choice, speeds=True)])
        return body or (_stand_in(log, robot, choice) if stand_in else None)
    evidence = Evidence(log, robot, laser, choice.read)
    for same in _measured(log, robot, choice, speeds=False):
        if (body := _one_of(log, same, evidence)) is not None:
            return _judged(body, evidence)
    lacks = "no wheels and no odometry" if stand_in else "no wheels of known size and no odometry"
    for asked in (False, True):
        evidence.look_at([t for t in _twists(log, robot, choice, asked) if _is_twist(log, t)])
    body = Body(laser, f"{lacks}: its scans are matched with each other", motor_words(log, robot))
    return _judged(body, evidence)


def _best_agreeing(log: Log, robot: Robot, choice: Choice, kinds: Sequence[Sequence[Body]]) -> Body | None:
    """Return the motion of the best kind that no other sensor contradicts; None if there is no such motion."""
    sensors = MotionSensors(log, robot, [body.topics for same in kinds for body in same], choice.read)
    for same in kinds:
        if (body := _one_of(log, same, sensors)) is not None:
            if words := sensors.unjudged(body.topics):
                words = f"{body.topic} is used: {words}"
                note = ". ".join(filter(None, (body.note, words)))
                body = body._replace(note=note, fixes=(f"wheels.topic={body.topic}",), unjudged=True)
            return _judged(body, sensors)
    return None


def _judged(body: Body, evidence: Evidence | MotionSensors) -> Body:
    """Return a motion with notes on its agreement with other sensors, and on the motions left out."""
    why = ": ".join(filter(None, (body.why, share := evidence.why(body.topics))))
    if not evidence.note:
        return body._replace(why=why)
    words = f"{body.topic} is used: {evidence.note}"
    if share and isinstance(evidence, MotionSensors):
        words = f"{words}; {share}"
    return body._replace(why=evidence.agrees, note=words, fixes=(f"wheels.topic={body.topic}",))


def _one_of(log: Log, same: Sequence[Body], evidence: Evidence | MotionSensors | None) -> Body | None:
    """Return the motion, of several of one kind, that agrees with the other sensors; None if there is none."""
    if evidence is not None:
        same = [body for body, kept in zip(same, evidence.keep([b.topics for b in same]), strict=True) if kept]
    topic = one(log, "wheels", None, [body.topic for body in same], WHEEL_READS)
    return next((body for body in same if body.topic == topic), None)


def _measured(log: Log, robot: Robot, choice: Choice, speeds: bool) -> Iterator[Sequence[Body]]:
    """Yield measured motions kind by kind, the best kind first; twists only if `speeds` are enough.

    An odometry that says where the robot is in the room is somebody's estimate: what was measured comes before it.
    """
    odometry = _filled(log, robot, choice, (ODOMETRY,))
    estimated = [t for t in odometry if is_room(log.stream(t).frame_id)]
    rolled = [t for t in odometry if t not in estimated]
    ranks = [[t for t in rolled if _made(t) == rank] for rank in range(4)]
    for same in filter(None, ranks):
        others = [t for t in odometry if t not in same]
        yield [_beside(t, NEAREST if others else ONLY, others) for t in same]
    if not rolled:
        yield [_beside(t, "the only odometry in /tf", estimated) for t in moving_frames(log, is_odometry)]
        poses = [t for t in _filled(log, robot, choice, POSES) if is_odometry(log.stream(t).frame_id)]
        yield [_beside(t, "poses in the frame of an odometry", estimated) for t in poses]
    measured = _twists(log, robot, choice, asked=False)
    twists = [t for t in measured if _is_twist(log, t)]
    yield [_beside(t, ONLY, estimated) for t in measured if t not in twists]
    if found := motor_of(log, robot):
        yield [Body(found[0], f"its motor's speed, steered as {found[1]} says", beside=tuple(found[1:]))]
    if speeds:
        yield [_beside(t, ONLY, estimated) for t in twists]
    yield [Body(t, NOTHING_ELSE, ESTIMATED.format(topic=t)) for t in estimated]


def _beside(topic: str, why: str, others: Sequence[str]) -> Body:
    """Return the chosen odometry with a note: on other odometries, or that it uses more than the wheels."""
    if not others:
        return Body(topic, why, HOLDS_MORE.format(topic=topic) if _of_filter(topic) else "")
    looks = "looks" if len(others) == 1 else "look"
    words = f"{topic} is used: {' and '.join(others)} {looks} made of more than the wheels"
    return Body(topic, why, words, (f"wheels.topic={topic}",))


def _is_twist(log: Log, topic: str) -> bool:
    return log.topics[topic].msgtype.startswith("geometry_msgs/")


def _stand_in(log: Log, robot: Robot, choice: Choice) -> Body | None:
    """Return a substitute for a measured motion: poses, else commands, else a steering angle, else no motion."""
    poses = _filled(log, robot, choice, POSES)
    of_robot = [t for t in poses if not (of_camera(log, t) or commanded(t, log.topics[t].msgtype))]
    if not of_robot:
        of_robot = moving_frames(log, is_fixed)
    if (
        body := _one_of(log, [Body(t, NOTHING_ELSE, ESTIMATED.format(topic=t)) for t in of_robot], None)
    ) is not None:
        return body
    best, others = nearest_to_base(_twists(log, robot, choice, asked=True))
    obeyed = _best_agreeing(log, robot, choice, [[Body(t, NOTHING_ELSE) for t in best]])
    if obeyed is not None:
        topic = obeyed.topic
        beside = OF_COMMANDS.format(others=" and ".join(others), topic=topic) if others else ""
        words = [ONLY_COMMANDED.format(topic=topic) + beside, motor_words(log, robot), obeyed.note]
        fixes = (f"wheels.topic={topic}",)
        return Body(topic, NOTHING_ELSE, ". ".join(filter(None, words)), fixes, is_fault=_is_twist(log, topic))
    steered = _filled(log, robot, choice, tuple(STEERED))  # lacks the wheelbase, which its reader asks for
    if (angle := one(log, "wheels", None, steered, WHEEL_READS)) is not None:
        return Body(angle, NOTHING_ELSE, motor_words(log, robot))
    for topic in poses:
        why = IN_CAMERA if of_camera(log, topic) else WISHED
        note = why.format(topic=topic, frame=log.stream(topic).frame_id)
        return Body(topic, NOTHING_ELSE, note, is_fault=True)
    return None


def nearest_to_base(topics: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return, of several commands, those nearest to the base by their names, and the others."""

    def rank(topic: str) -> int:
        name = topic.rpartition("/")[2].lower()
        return 0 if name in OBEYED else 2 if PASSED_ON.search(topic.lower()) else 1

    least = min(map(rank, topics), default=0)
    best = [t for t in topics if rank(t) == least]
    return best, [t for t in topics if t not in best]


def _filled(log: Log, robot: Robot, choice: Choice, kinds: Sequence[str]) -> list[str]:
    """Return recorded topics of these types with messages that no other role reads.

    A topic that the settings give to a sensor of its own (`[pose] topic`) is left to it where there are others.
    """
    taken = {topic for role in choice.topics for topic in choice.of(role)}
    found = [
        t
        for t in filled(log, *kinds)
        if t not in taken
        and (":" not in t or t.endswith(ADAPTED_SUFFIX))  # not frames of /tf, nor a field
        and not looks_like_truth(t)
    ]
    asked = {robot.settings(name).topic for name, sensor in REGISTRY.items() if sensor.asked_only}
    return [t for t in found if t not in asked] or found


def _of_filter(topic: str) -> bool:
    """Return whether an odometry's name shows that other sensors are in it."""
    name = topic.lower()
    return _made(topic) > 1 and bool(OF_FILTERS.search(name) or MADE_OF_FIXES.search(name))


def _made(topic: str) -> int:
    """Return an odometry's rank by its name: 0 raw, 1 unknown, 2 of more than wheels, 3 of satellite fixes."""
    name = topic.lower()
    if RAW.search(name):
        return 0
    if MADE_OF_FIXES.search(name):
        return 3
    return 2 if MADE_OF_MORE.search(name) else 1


def _twists(log: Log, robot: Robot, choice: Choice, asked: bool) -> list[str]:
    """Return readable topics of speeds: commanded ones (`asked`), or measured ones.

    Speeds in a frame that does not turn with the robot (odom, map), or of a receiver, are not those ahead.
    """
    steers = robot.wheels.wheelbase or robot.wheels.steering != "angle"
    kinds = (*TWISTS, *STEERED) if steers else TWISTS
    found = [t for t in _filled(log, robot, choice, kinds) if commanded(t, log.topics[t].msgtype) == asked]
    return [t for t in found if asked or not (is_fixed(log.stream(t).frame_id) or by_fixes(t))]


def by_fixes(topic: str) -> bool:
    """Return whether a topic's name shows that a satellite receiver measured its speeds (east and north)."""
    return BY_FIXES.search(topic.lower()) is not None


def of_camera(log: Log, topic: str) -> bool:
    """Return whether poses are in the frame of a camera or a marker: they are not the robot's."""
    return CAMERA_FRAMES.search(log.stream(topic).frame_id.lower()) is not None


def moving_frames(log: Log, fixed: Callable[[str], bool]) -> list[str]:
    """Return pairs of frames in /tf that move relative to a fixed frame, as topics; preferably those of a base."""
    found: dict[str, bool] = {}
    for topic in log.transform_topics:
        for (parent, child), edge in log.frames(topic).items():
            if edge.moves and fixed(parent) and not is_fixed(child):
                found[f"{topic}:{parent}:{child}"] = is_base(child)
    based = [name for name, base in found.items() if base]
    names = based or list(found)
    return [name for name in names if log.find(name) is not None]


class NoWheelsError(LocfuseError):
    """No topic gives the wheels' motion; the hint lists the available topics."""


def nothing_moves(log: Log) -> NoWheelsError:
    """Return the error with the missing motion and the topics of this log."""
    have = ", ".join(sorted(log.topics)[:12]) or "no topics"
    words = (
        f"the robot's motion is unknown: {log.name} has no wheels, no odometry (nor one in /tf), no laser, no "
        "poses and no speeds"
    )
    others = [other for role in ("wheels", "lrf") if (other := not_read(log, role))]
    beside = filled(log, *ONLY_CORRECT)
    corrects = f"; {' and '.join(beside)} can only correct a motion (a fix has no heading, an IMU no speed)"
    return NoWheelsError(
        ". ".join([f"{words}{corrects if beside else ''}", *others]) + ".",
        role="wheels",
        hint=f"It has {have}",
    )


# ---- a car's motor controller: its topic, that of the steering, and what they lack ----


def steering_of(log: Log, robot: Robot) -> str | None:
    """Return the topic of a car's steering: as configured, else an Ackermann command, else a servo."""
    named = robot.wheels.steering_topic
    if named is not None:
        return checked(log, "wheels", named, (*STEERED, SERVO))
    commands = filled(log, *STEERED)
    servos = [t for t in filled(log, SERVO) if "servo" in t.lower()]
    if robot.wheels.servo_gain and servos:
        return servos[0]
    obeyed = [t for t in commands if t.rpartition("/")[2] == "ackermann_cmd"]
    return next(iter([*obeyed, *commands, *servos]), None)


def with_steering(log: Log, robot: Robot, motor: str) -> list[str]:
    """Return the topics of a motor and of its steering. Raises LocfuseError without steering."""
    steering = steering_of(log, robot)
    if steering is None:
        raise LocfuseError(
            f"{motor} says how fast the motor turns, and no topic says how the car was steered "
            "(an AckermannDrive, or a servo's position).",
            role="wheels",
            hint="Name it with --set wheels.steering_topic=<topic>, or the odometry that was made of both",
        )
    return [motor, steering]


def motor_of(log: Log, robot: Robot) -> Sequence[str]:
    """Return the topics of a motor and of its steering, if the settings convert them to metres; else none."""
    found, settings = filled(log, *MOTOR), robot.wheels
    known = settings.erpm_per_mps and settings.wheelbase and steering_of(log, robot) is not None
    return with_steering(log, robot, found[0]) if len(found) == 1 and known else ()


def motor_words(log: Log, robot: Robot) -> str:
    """Return the settings needed to use a motor controller's data as motion; "" without a controller."""
    found = filled(log, *MOTOR)
    if not found or motor_of(log, robot):
        return ""
    if steering_of(log, robot) is None:
        return f"{found[0]} says how fast the motor turns, and no topic says how the car was steered"
    return (
        f"{found[0]} holds what its motor did: --set wheels.topic={found[0]} --set wheels.erpm_per_mps=<erpm> "
        f"({GAIN_HINT}) --set wheels.wheelbase=<metres> uses it"
    )
