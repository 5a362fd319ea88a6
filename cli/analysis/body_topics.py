"""Topics with the motion of the robot's body, used if wheel counters or wheel sizes are missing.

Order of preference: an odometry, an odometry in /tf, measured speeds, a laser's scans, poses of another program. A
laser checks the candidates (`motion_evidence`) and is preferred to a Twist. Commands, and poses that are not the
robot's, come last: with them every figure is void.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from locfuse.formats.logs.log import Log
from locfuse.fusion.data import LocfuseError
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.magnetic import IMU
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.truth import FIX, looks_like_truth
from locfuse.fusion.wheels.odometry import ODOMETRY, PLANAR, POSE, SCANS, SPEED, STEERED, TRANSFORM, commanded
from locfuse.fusion.wheels.read import WHEEL_READS
from locfuse.fusion.wheels.steered import GAIN_HINT, MOTOR, SERVO

from .adapted_topics import not_read
from .motion_evidence import MAX_PERIOD_S, MotionEvidence, MotionSensors
from .mounts import is_base, is_fixed, is_odometry, is_room
from .topics import WHY_ONLY, Choice, Note, checked, filled, of_sensor, one

TWISTS = tuple(kind for kind in SPEED if kind not in (*POSE, *PLANAR))
POSES = tuple(kind for kind in (*POSE, *PLANAR) if kind not in (ODOMETRY, TRANSFORM))
# words in the names of topics
NAMES_MORE_SENSORS = re.compile(
    "filter|ekf|ukf|fused|visual|vio|camera|icp|slam|map|amcl|lidar|zed|vins|loam|lio|rtabmap|realsense|t265"
    "|combined|global|rf2o|kiss|laser|scan|mavros"
)
NAMES_FILTER = re.compile("filter|ekf|ukf|fused|combined|global")  # odometries with a fused IMU or GPS
NAMES_RECEIVER = re.compile("fix_vel|gps|gnss|navsat|ublox|novatel|septentrio")  # speeds east and north
NAMES_GPS = re.compile("gps|gnss|navsat")  # the odometry of navsat_transform has no heading
ONLY_CORRECT = (FIX, IMU)  # message types that cannot give the motion, only correct it
NAMES_RAW = re.compile("unfiltered|raw|wheel|encoder|_enc")
ADAPTED_SUFFIX = ":odometry"  # of topics converted to Odometry
NOTHING_ELSE = "nothing else says how the robot moved"
WHY_NEAREST = "the odometry nearest to the wheels"
NEAR_BASE = ("cmd_vel", "ackermann_cmd")  # topics that a base's driver reads
NAMES_UPSTREAM = re.compile("teleop|joy|key|nav|raw|smooth|mux|input|plan|auto|unstamped")
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
REQUESTED = (
    "{topic} holds poses that were asked for, by its name, and nothing in this log measured how the robot moved"
)
IN_CAMERA = (
    "{topic} holds poses in the frame {frame}: of something that a camera sees. Nothing in this log says how the "
    "robot moved"
)
UNSTEERED = "{motor} says how fast the motor turns, and no topic says how the car was steered"
CAMERA_FRAMES = re.compile("camera|optical|marker|aruco|tag")  # a pose in such a frame is not the robot's


class Body(NamedTuple):
    """A topic that gives the motion of the robot's body, with the reason for its choice."""

    topic: str
    why: str
    note: str = ""  # shown to the user
    fixes: tuple[str, ...] = ()  # settings that choose the same topic
    beside: tuple[str, ...] = ()  # topics of a car's steering, read with its motor
    is_fault: bool = False  # not the robot's motion, for the reason in `note`
    unjudged: bool = False  # another motion disagrees and no sensor can judge them

    @property
    def topics(self) -> tuple[str, ...]:
        """The motion's topic, and that of a car's steering if there is one."""
        return (self.topic, *self.beside)


def choose_body(log: Log, robot: Robot, choice: Choice, scans: bool, stand_in: bool) -> Body | None:
    """Choose the topic that gives the motion of the robot's body; None if there is none.

    `scans`: judge motions by laser scans, and match the scans if no motion is usable. `stand_in`: without laser
    scans and measured motion, use a substitute such as estimated poses or commands. Raises LocfuseError if several
    fit.
    """
    laser = of_sensor(log, robot, "lrf", (SCANS,)) if scans else None
    if laser is None:
        body = _best_agreeing(log, robot, choice, [*_measured(log, robot, choice, speeds=True)])
        return body or (_stand_in(log, robot, choice) if stand_in else None)
    evidence = MotionEvidence(log, robot, laser, choice.read)
    for same in _measured(log, robot, choice, speeds=False):
        if (body := _only_motion(log, same, evidence)) is not None:
            return _with_notes(body, evidence)
    lacks = "no wheels and no odometry" if stand_in else "no wheels of known size and no odometry"
    for asked in (False, True):
        evidence.look_at([t for t in _twists(log, robot, choice, asked) if _is_twist(log, t)])
    body = Body(laser, f"{lacks}: its scans are matched with each other", motor_words(log, robot))
    return _with_notes(body, evidence)


def _best_agreeing(log: Log, robot: Robot, choice: Choice, kinds: Sequence[Sequence[Body]]) -> Body | None:
    """Return the first motion, best kind first, that agrees with the other sensors; None if none agrees."""
    sensors = MotionSensors(log, robot, [body.topics for same in kinds for body in same], choice.read)
    for same in kinds:
        if (body := _only_motion(log, same, sensors)) is not None:
            if words := sensors.unjudged(body.topics):
                words = f"{body.topic} is used: {words}"
                note = ". ".join(filter(None, (body.note, words)))
                body = body._replace(note=note, fixes=(f"wheels.topic={body.topic}",), unjudged=True)
            return _with_notes(body, sensors)
    return None


def _with_notes(body: Body, evidence: MotionEvidence | MotionSensors) -> Body:
    """Return the chosen motion with notes: its agreement with other sensors, and the rejected motions."""
    why = ": ".join(filter(None, (body.why, share := evidence.why(body.topics))))
    if not evidence.note:
        return body._replace(why=why)
    words = f"{body.topic} is used: {evidence.note}"
    if share and isinstance(evidence, MotionSensors):
        words = f"{words}; {share}"
    return body._replace(why=evidence.agrees, note=words, fixes=(f"wheels.topic={body.topic}",))


def _only_motion(log: Log, same: Sequence[Body], evidence: MotionEvidence | MotionSensors) -> Body | None:
    """Return the only motion of a kind that agrees with the other sensors; None if none agrees."""
    kept = evidence.keep([body.topics for body in same])
    agreeing = {body.topic: body for body in same if body.topics in kept}
    topic = one(log, "wheels", None, [*agreeing], WHEEL_READS)
    return None if topic is None else agreeing[topic]


def _measured(log: Log, robot: Robot, choice: Choice, speeds: bool) -> Iterator[Sequence[Body]]:
    """Yield the measured motions by kind, best first, estimates in a map frame last; twists only if `speeds`."""
    odometry = _free_topics(log, robot, choice, (ODOMETRY,))
    few = {t: words for t in odometry if (words := _too_few(log, t))}
    odometry = [t for t in odometry if t not in few]
    choice.notes += [Note("wheels", f"{words}: not used") for words in few.values()]
    estimated = [t for t in odometry if is_room(log.stream(t).frame_id)]
    rolled = [t for t in odometry if t not in estimated]
    ranks = [[t for t in rolled if _odometry_rank(t) == rank] for rank in range(4)]
    for same in filter(None, ranks):
        others = [t for t in odometry if t not in same]
        yield [_odometry_body(t, WHY_NEAREST if others else WHY_ONLY, others) for t in same]
    if not rolled:
        yield [_odometry_body(t, "the only odometry in /tf", estimated) for t in moving_frames(log, is_odometry)]
        poses = [t for t in _free_topics(log, robot, choice, POSES) if is_odometry(log.stream(t).frame_id)]
        yield [_odometry_body(t, "poses in the frame of an odometry", estimated) for t in poses]
    measured = _twists(log, robot, choice, asked=False)
    twists = [t for t in measured if _is_twist(log, t)]
    yield [_odometry_body(t, WHY_ONLY, estimated) for t in measured if t not in twists]
    if found := motor_of(log, robot):
        yield [Body(found[0], f"its motor's speed, steered as {found[1]} says", beside=tuple(found[1:]))]
    if speeds:
        yield [_odometry_body(t, WHY_ONLY, estimated) for t in twists]
    yield [Body(t, NOTHING_ELSE, ESTIMATED.format(topic=t)) for t in estimated]


def _too_few(log: Log, topic: str) -> str:
    """Return in words that a topic has one message, as if latched, or one in more than MAX_PERIOD_S; else ""."""
    count, (begin, end) = log.topics[topic].count, log.time_span_ns or (0, 0)
    if count > max(1.0, (end - begin) * 1e-9 / MAX_PERIOD_S):
        return ""
    t_ns = log.stream(topic).t_ns
    few = len(t_ns) < 2 or float(np.median(np.diff(t_ns))) > MAX_PERIOD_S * 1e9
    return f"{topic} has too few messages to give the motion ({count})" if few else ""


def _odometry_body(topic: str, why: str, others: Sequence[str]) -> Body:
    """Return an odometry as the motion, with a note on unused odometries or on an IMU or GPS fused in it."""
    if not others:
        name = topic.lower()
        holds_more = _odometry_rank(topic) > 1 and (NAMES_FILTER.search(name) or NAMES_GPS.search(name))
        return Body(topic, why, HOLDS_MORE.format(topic=topic) if holds_more else "")
    looks = "looks" if len(others) == 1 else "look"
    words = f"{topic} is used: {' and '.join(others)} {looks} made of more than the wheels"
    return Body(topic, why, words, (f"wheels.topic={topic}",))


def _is_twist(log: Log, topic: str) -> bool:
    return log.topics[topic].msgtype.startswith("geometry_msgs/")


def _stand_in(log: Log, robot: Robot, choice: Choice) -> Body | None:
    """Return a substitute if no motion was measured: estimated poses, commands, a steering angle, other poses."""
    poses = _free_topics(log, robot, choice, POSES)
    of_robot = [t for t in poses if not (of_camera(log, t) or commanded(t, log.topics[t].msgtype))]
    frames = of_robot or moving_frames(log, is_fixed)
    if (estimated := one(log, "wheels", None, frames, WHEEL_READS)) is not None:
        return Body(estimated, NOTHING_ELSE, ESTIMATED.format(topic=estimated))
    commands = _twists(log, robot, choice, asked=True)
    best = [t for t in commands if _steps_to_base(t) == min(map(_steps_to_base, commands))]
    others = [t for t in commands if t not in best]
    obeyed = _best_agreeing(log, robot, choice, [[Body(t, NOTHING_ELSE) for t in best]])
    if obeyed is not None:
        topic = obeyed.topic
        beside = OF_COMMANDS.format(others=" and ".join(others), topic=topic) if others else ""
        words = [ONLY_COMMANDED.format(topic=topic) + beside, motor_words(log, robot), obeyed.note]
        fixes = (f"wheels.topic={topic}",)
        return Body(topic, NOTHING_ELSE, ". ".join(filter(None, words)), fixes, is_fault=_is_twist(log, topic))
    steered = _free_topics(log, robot, choice, tuple(STEERED))  # without a wheelbase its reader asks for it
    if (angle := one(log, "wheels", None, steered, WHEEL_READS)) is not None:
        return Body(angle, NOTHING_ELSE, motor_words(log, robot))
    for topic in poses:
        why = IN_CAMERA if of_camera(log, topic) else REQUESTED
        note = why.format(topic=topic, frame=log.stream(topic).frame_id)
        return Body(topic, NOTHING_ELSE, note, is_fault=True)
    return None


def _steps_to_base(topic: str) -> int:
    """Return how far a topic of commands is from the base's driver, by its name: 0 the driver reads it, 1, 2."""
    if topic.rpartition("/")[2].lower() in NEAR_BASE:
        return 0
    return 2 if NAMES_UPSTREAM.search(topic.lower()) else 1


def _free_topics(log: Log, robot: Robot, choice: Choice, kinds: Sequence[str]) -> list[str]:
    """Return filled topics of these types that no other role reads, and no sensor's settings if others remain."""
    taken = {topic for role in choice.topics for topic in choice.of(role)}
    free = [t for t in filled(log, *kinds) if t not in taken and not looks_like_truth(t)]
    found = [t for t in free if ":" not in t or t.endswith(ADAPTED_SUFFIX)]  # no frames of /tf, no single fields
    asked = {robot.settings(name).topic for name, sensor in REGISTRY.items() if sensor.asked_only}
    return [t for t in found if t not in asked] or found


def _odometry_rank(topic: str) -> int:
    """Return an odometry's rank by its name: 0 raw, 1 unknown, 2 more sensors than wheels, 3 with GPS."""
    name = topic.lower()
    if NAMES_RAW.search(name):
        return 0
    if NAMES_GPS.search(name):
        return 3
    return 2 if NAMES_MORE_SENSORS.search(name) else 1


def _twists(log: Log, robot: Robot, choice: Choice, asked: bool) -> list[str]:
    """Return topics of speeds, commanded (`asked`) or measured; none in a fixed frame, none of a GPS receiver."""
    steers = robot.wheels.wheelbase or robot.wheels.steering != "angle"
    kinds = (*TWISTS, *STEERED) if steers else TWISTS
    found = [t for t in _free_topics(log, robot, choice, kinds) if commanded(t, log.topics[t].msgtype) == asked]
    return [t for t in found if asked or not (is_fixed(log.stream(t).frame_id) or by_fixes(t))]


def by_fixes(topic: str) -> bool:
    """Return whether a topic's name shows that a GPS receiver measured its velocity (east and north)."""
    return NAMES_RECEIVER.search(topic.lower()) is not None


def of_camera(log: Log, topic: str) -> bool:
    """Return whether poses are in the frame of a camera or a marker: these are not the robot's poses."""
    return CAMERA_FRAMES.search(log.stream(topic).frame_id.lower()) is not None


def moving_frames(log: Log, fixed: Callable[[str], bool]) -> list[str]:
    """Return /tf pairs (fixed frame, moving frame) as topics; if base frames move, only pairs with these."""
    pairs = ((topic, edge) for topic in log.transform_topics for edge in log.frames(topic).values())
    found = [(topic, e) for topic, e in pairs if e.moves and fixed(e.parent) and not is_fixed(e.child)]
    based = [(topic, e) for topic, e in found if is_base(e.child)]
    names = (f"{topic}:{e.parent}:{e.child}" for topic, e in based or found)
    return [name for name in names if log.find(name) is not None]


class NoWheelsError(LocfuseError):
    """No topic of the log gives the robot's motion; the hint lists the topics."""


def nothing_moves(log: Log) -> NoWheelsError:
    """Return the error for a log in which no topic gives the robot's motion."""
    have = ", ".join(sorted(log.topics)[:12]) or "no topics"
    words = (
        f"the robot's motion is unknown: {log.name} has no wheels, no odometry (nor one in /tf), no laser, no "
        "poses and no speeds"
    )
    others = [other for role in ("wheels", "lrf") if (other := not_read(log, role))]
    others += filter(None, (_too_few(log, topic) for topic in filled(log, ODOMETRY)))
    beside = filled(log, *ONLY_CORRECT)
    corrects = f"; {' and '.join(beside)} can only correct a motion (a fix has no heading, an IMU no speed)"
    message = ". ".join([f"{words}{corrects if beside else ''}", *others]) + "."
    return NoWheelsError(message, role="wheels", hint=f"It has {have}")


# ---- a car's motor controller: topics of motor and steering, and missing settings ----


def steering_of(log: Log, robot: Robot) -> str | None:
    """Return a car's steering: as configured, a servo with `servo_gain`, an AckermannDrive, any servo, or None."""
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
    """Return the topics of a car's motor and of its steering. Raises LocfuseError without steering."""
    steering = steering_of(log, robot)
    if steering is None:
        words = f"{UNSTEERED.format(motor=motor)} (an AckermannDrive, or a servo's position)."
        hint = "Name it with --set wheels.steering_topic=<topic>, or the odometry that was made of both"
        raise LocfuseError(words, role="wheels", hint=hint)
    return [motor, steering]


def motor_of(log: Log, robot: Robot) -> Sequence[str]:
    """Return the topics of a car's motor and steering if the settings convert them to metres; () otherwise."""
    found, settings = filled(log, *MOTOR), robot.wheels
    known = settings.erpm_per_mps and settings.wheelbase and steering_of(log, robot) is not None
    return with_steering(log, robot, found[0]) if len(found) == 1 and known else ()


def motor_words(log: Log, robot: Robot) -> str:
    """Return the settings that a car's motor topic needs to give the motion; "" if none is missing."""
    found = filled(log, *MOTOR)
    if not found or motor_of(log, robot):
        return ""
    if steering_of(log, robot) is None:
        return UNSTEERED.format(motor=found[0])
    return (
        f"{found[0]} holds what its motor did: --set wheels.topic={found[0]} --set wheels.erpm_per_mps=<erpm> "
        f"({GAIN_HINT}) --set wheels.wheelbase=<metres> uses it"
    )
