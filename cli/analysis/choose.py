"""Choice of topics: one for the wheels, one for each sensor, one for the truth.

Truth is never guessed by type: /odom and /amcl_pose are estimates, and an estimate must not judge another.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import suppress
from functools import partial
from typing import Any

from locfuse.formats.logs.log import Log
from locfuse.fusion.data import LocfuseError
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensor import Sensor
from locfuse.fusion.sensors.registry import REGISTRY, unmet
from locfuse.fusion.truth import FIX, KNOWN_TRUTH, TRUTH_READS, looks_like_truth, read_truth
from locfuse.fusion.wheels.motion import path_alike
from locfuse.fusion.wheels.odometry import ODOMETRY, SCANS, commanded

from .adapted_topics import not_read, offer_presented, offer_tags
from .body_topics import by_fixes, of_camera
from .motion_evidence import motion_of
from .topics import (
    WHY_NAMED,
    WHY_ONLY,
    Choice,
    Note,
    checked,
    filled,
    likeliest,
    of_other_robot,
    of_type,
    one,
    several_fit,
    types,
)
from .wheel_topics import choose_wheels

TF = "/tf"  # a role of `choose_each`: frames that are topics of landmarks
# words in the names of topics
ESTIMATE_WORDS = ("odom", "amcl", "slam", "ekf", "filter", "goal", "initial", "estimate", "fused", "map")
LEFT_OUT = "none"  # truth.topic: the log's truth is left out


def choose(log: Log, robot: Robot, insisted: Collection[str] = ()) -> Choice:
    """Choose topics. Raises LocfuseError if several fit, none gives the motion, or a named one does not fit."""
    choice = Choice()
    for role, problem in choose_each(log, robot, insisted, choice):
        if role != TF:  # a loop of frames in /tf is reported where they are used
            raise problem
    for name, why in unmet(choice.topics).items():
        del choice.topics[name]
        choice.absent[name] = why
    return choice


def choose_each(
    log: Log, robot: Robot, insisted: Collection[str], choice: Choice
) -> Iterator[tuple[str, LocfuseError]]:
    """Choose the topics of each role, and yield (role, error) for each role whose choice fails.

    A robot.toml serves many logs, so the log may lack topics of sensors or truth that robot.toml names, but not
    topics that --set names. `insisted`: tables with a topic from --set.
    """
    offer_presented(log)
    steps: dict[str, Callable[[], None]] = {
        TF: partial(offer_tags, log, robot),
        "truth": partial(choose_truth, log, robot, "truth" in insisted, choice),
        "wheels": partial(choose_wheels, log, robot, choice),
        **{s: partial(choose_sensor, log, robot, s, s in insisted, choice) for s in REGISTRY},
    }
    for role, step in steps.items():
        try:
            step()
        except LocfuseError as problem:
            yield role, problem


def choose_sensor(log: Log, robot: Robot, name: str, insisted: bool, choice: Choice) -> None:
    """Choose the topics of one sensor, or note why it has none."""
    sensor, settings = REGISTRY[name], robot.settings(name)
    named = _names(settings)
    gone = [t for t in named if log.find(t) is None]
    if gone and getattr(settings, "file", None) == gone[0]:
        raise LocfuseError(f"no such file: {gone[0]} (.csv and .tum are read)", role=name)
    if gone and not insisted:
        choice.absent[name] = f"{log.name} has no topic {gone[0]}, which robot.toml names"
        return
    candidates = _candidates(log, name, choice)
    if sensor.asked_only and not named:
        _offer(log, name, candidates, choice)
        return
    unset = sensor.missing(settings) if candidates or named else None
    if unset:
        choice.absent[name] = unset
        return
    if named:
        _refuse_twice(named, sensor, choice)
        choice.take(name, [checked(log, name, topic, sensor.reads) for topic in named], WHY_NAMED)
    elif not candidates:
        other = not_read(log, name)
        if other:
            choice.absent[name] = other
        elif not sensor.extra:  # only the paper's sensors are expected in a log
            choice.absent[name] = f"no topic of type {types(sensor.reads)} in {log.name}"
        if not other and not hasattr(settings, "file"):  # a sensor that reads a file needs no topic
            choice.foreign.add(name)
        return
    else:
        _by_type(log, name, candidates, choice)
    _leave_empty(log, name, choice)


def _leave_empty(log: Log, name: str, choice: Choice) -> None:
    """Remove a sensor's topics if none of them has a message."""
    if name in choice.topics and all(log.topics[t].count == 0 for t in choice.of(name)):
        choice.absent[name] = f"{choice.topics.pop(name)} holds no messages"


def _offer(log: Log, name: str, candidates: Sequence[str], choice: Choice) -> None:
    """Record that a sensor is used only if configured, with the setting for its first candidate topic."""
    beside = choice.topics.get("wheels", "")
    others = (
        lambda t: commanded(t, log.topics[t].msgtype),
        lambda t: of_other_robot(t, beside),
        looks_like_truth,
        by_fixes,
        lambda t: log.topics[t].count < 2,
    )
    candidates = [t for t in candidates if not any(is_one(t) for is_one in others)]
    if candidates:
        fixes = (f"{name}.topic={candidates[0]}",)
        why = REGISTRY[name].asked_only
        words = f"{' or '.join(candidates)} is used only if you name it: {why}. To use it: --set {fixes[0]}"
        choice.leave(name, words, fixes)


def _refuse_twice(named: Collection[str], sensor: Sensor, choice: Choice) -> None:
    """Raise LocfuseError if a topic named for a sensor is already read as wheels or truth."""
    reasons = {"wheels": "what counts twice makes the filter overconfident", "truth": "it would judge itself"}
    for role, why in reasons.items() if sensor.asked_only else ():
        for topic in choice.of(role):
            if topic in named:
                raise LocfuseError(f"{topic} is read as {role} already: {why}", role=sensor.name)


def _names(settings: Any) -> tuple[str, ...]:
    """Return the topics that a sensor's table in robot.toml names."""
    several = tuple(getattr(settings, "topics", None) or ())
    fields = getattr(settings, "fields", None) or filter(None, [getattr(settings, "field", None)])
    suffix = "".join(f"{mark}{field}" for mark, field in zip(":,", fields, strict=False))
    topic = settings.topic if settings.topic is not None else getattr(settings, "file", None)
    return several or ((f"{topic}{suffix}",) if topic is not None else ())


def _candidates(log: Log, name: str, choice: Choice) -> list[str]:
    """Return topics of a sensor's message types that wheels and truth do not use; with messages if possible."""
    sensor = REGISTRY[name]
    # scans may be both motion and laser
    wheels = [t for t in choice.of("wheels") if log.topics[t].msgtype != SCANS]
    taken = {*choice.of("truth"), *wheels}
    found = [t for t in of_type(log, sensor.reads) if t not in taken]
    # a topic of plain numbers must have one of these words in its name; None: any name
    words = {t: sensor.named.get(log.topics[t].msgtype) for t in found}
    found = [t for t in found if (w := words[t]) is None or any(word in t.lower() for word in w)]
    found = [t for t in found if log.topics[t].count != 0] or found
    if len(found) > 1 and type(sensor).carries is not Sensor.carries:  # `carries` reads the topics
        found = [t for t in found if sensor.carries(log.stream(t))] or [likeliest(found, sensor.unlikely or ())]
    return best_of(log, sensor, found)


def best_of(log: Log, sensor: Sensor, topics: list[str]) -> list[str]:
    """Return the topics without those of the sensor's second-best message types; all if none would remain."""
    return [t for t in topics if log.topics[t].msgtype not in sensor.second_best] or topics


def _by_type(log: Log, name: str, candidates: list[str], choice: Choice) -> None:
    """Choose a sensor's topics among `candidates` of its message types.

    Rules, the first that applies: the only candidate; for an extra sensor, a topic that another sensor reads; all,
    if the sensor may have several; the likeliest, if the sensor has a list of unlikely names. Otherwise an extra
    sensor gets no topic, and LocfuseError is raised for any other sensor.
    """
    sensor, kinds = REGISTRY[name], {log.topics[t].msgtype for t in candidates}
    several = sensor.several
    if sensor.several_frames and len(candidates) > 1 and len(kinds) == 1:  # equal sensors, mounted apart
        several = several or len({log.stream(t).frame_id for t in candidates} - {""}) == len(candidates)
    if len(candidates) == 1:
        same = filled(log, log.topics[candidates[0]].msgtype)
        choice.take(name, candidates, WHY_ONLY if len(same) < 2 else "the only one of its type that fits")
    elif sensor.extra and (shared := [t for t in candidates if t in choice.topics.values()]):
        choice.take(name, shared[:1], "another sensor reads it too")
    elif several:
        choice.take(name, candidates, f"all {len(candidates)} topics of its type")
    elif sensor.unlikely is not None:
        best = likeliest(candidates, sensor.unlikely, choice.topics.get("wheels", ""))
        choice.take(name, [best], "the likeliest of several")
        words = f"{log.name} has {len(candidates)} topics that fit: {', '.join(candidates)}; {best} is used"
        choice.notes.append(Note(name, words, (f"{name}.topic={best}",)))
    elif not sensor.extra:
        raise several_fit(log, name, candidates)
    else:  # an extra sensor: no guess, and no error that would stop the other sensors
        why = several_fit(log, name, candidates)
        choice.leave(name, why.sentence, why.fixes)


def choose_truth(log: Log, robot: Robot, insisted: bool, choice: Choice) -> None:
    """Choose the ground truth's topic: the configured one, else by its name or type."""
    named = robot.truth.topic
    if named == LEFT_OUT:
        return
    if named is not None and log.find(named) is None and not insisted:
        return
    known = [t for t in of_type(log, TRUTH_READS) if log.topics[t].msgtype in KNOWN_TRUTH]
    candidates = [t for t in of_type(log, TRUTH_READS) if looks_like_truth(t) or t in known]
    if named is None and len(candidates) > 1:
        candidates = by_motion(log, robot, candidates, choice)
    topic = one(log, "truth", named, candidates, TRUTH_READS)
    if topic is not None:
        why = "by its type" if topic in known else "by its name"
        choice.take("truth", [topic], WHY_NAMED if named else why)


def may_be_truth(log: Log, robot: Robot, choice: Choice) -> list[str]:
    """Return the pose topics that may be ground truth, the likeliest first; [] if a truth is named or chosen."""
    if "truth" in {*choice.topics, *choice.absent}:
        return []
    found = filled(log, *(kind for kind in TRUTH_READS if kind not in {ODOMETRY, FIX}))
    poses = [t for t in found if not any(word in t.lower() for word in ESTIMATE_WORDS)]
    poses = [t for t in poses if not (commanded(t, log.topics[t].msgtype) or of_camera(log, t))]
    return by_motion(log, robot, poses, choice) if len(poses) > 1 else poses


def by_motion(log: Log, robot: Robot, topics: Sequence[str], choice: Choice) -> list[str]:
    """Return topics of poses with those first whose paths have the shape of the robot's motion, if it is known."""
    chosen = choice if choice.of("wheels") else Choice(read=choice.read)
    with suppress(LocfuseError):  # reported where the wheels are chosen
        if chosen is not choice:
            choose_wheels(log, robot, chosen)
    wheels = chosen.of("wheels")
    if not wheels or (motion := motion_of(log, robot, wheels, choice.read)) is None:
        return [*topics]
    alike = dict.fromkeys(topics, 0.0)
    for topic in topics:
        with suppress(LocfuseError):  # reported if it is chosen
            truth, _ = read_truth(log.stream(topic, robot.order), robot.truth, motion.epoch_ns)
            alike[topic] = path_alike(motion.wheels, truth.t, truth.xy) or 0.0
    return sorted(topics, key=lambda topic: -alike[topic])
