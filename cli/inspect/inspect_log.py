"""Everything `info` and `init` know of a log: topics, roles, mounts, what is missing, oddities and their cures.

Whatever is wrong becomes an oddity and the rest is looked at all the same: this is for logs that do not run yet.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from locfuse.cli.choose.choose import choose_sensor, choose_truth
from locfuse.cli.choose.mounts import mount_tables
from locfuse.cli.choose.topics import Choice
from locfuse.cli.choose.wheel_topics import choose_wheels
from locfuse.cli.pipeline.load import Loaded, make_robot, measured, merged_tables, named_by_hand
from locfuse.formats.log.log import Log, open_log
from locfuse.formats.robot import robot_toml
from locfuse.formats.robot.transforms import StaticTransforms
from locfuse.fusion.data import LocfuseError
from locfuse.fusion.doctor.examine import examine
from locfuse.fusion.doctor.finding import Oddity, settings_in
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.streams import joined

from . import robot_facts
from .clocks import of_stamps
from .mounts import conflicts, unplaced
from .sensors import raw_oddities
from .topics import topic_facts

if TYPE_CHECKING:
    from locfuse.cli.pipeline.settings import LogOptions
from .overview import Look

COSTLY = ("camera",)  # decoding every picture takes longer than all the rest
PHANTOMS = {"yaw", "range scale"}  # what walls that are none would say


def look(paths: Sequence[Path], how: LogOptions, progress: Callable[[str], None] = lambda role: None) -> Look:
    """Look at a log. Raises LocfuseError only where it cannot be opened, or robot.toml cannot be read."""
    progress("opening")
    log = open_log(paths)
    tables = merged_tables(log, how)
    robot = make_robot(tables)
    progress("topics")
    facts = topic_facts(log, robot.order)
    found: list[Oddity] = []
    choice = _choose(log, robot, named_by_hand(how.sets), found)
    transforms = _transforms(log, found)
    seen = Look(log, tables, choice, facts, transforms, _placed(log, tables, choice, transforms))
    seen.hints = robot_facts.hints(log, robot, choice)
    seen.oddities = [
        *_of_files(log),
        *found,
        *robot_facts.oddities(log, robot, choice, seen.hints),
        *of_stamps(facts, choice, robot),
    ]
    seen.oddities += raw_oddities(log, robot, choice)
    _measure(seen, progress)
    seen.oddities += [*unplaced(seen), *conflicts(seen)]
    return seen


def _choose(log: Log, robot: Robot, insisted: set[str], found: list[Oddity]) -> Choice:
    """Choose every role by itself: what cannot be chosen becomes an oddity."""
    choice = Choice()
    steps: dict[str, Callable[[], None]] = {
        "truth": partial(choose_truth, log, robot, "truth" in insisted, choice),
        "wheels": partial(choose_wheels, log, robot, choice),
        **{s: partial(choose_sensor, log, robot, s, s in insisted, choice) for s in REGISTRY},
    }
    for role, step in steps.items():
        try:
            step()
        except LocfuseError as e:
            words = str(e).removeprefix(f"{role}: ").partition(". It has ")[0]  # info lists the topics
            choice.absent[role] = words
            found.append(Oddity("choice", role, words, settings_in(words), True))  # run and compare refuse too
    found += [Oddity("choice", "wheels", note.removeprefix("wheels: ")) for note in choice.notes]
    return choice


def _transforms(log: Log, found: list[Oddity]) -> StaticTransforms:
    try:
        transforms = log.static_transforms()
    except LocfuseError as e:
        found.append(Oddity("tf_static", "/tf_static", str(e)))
        return StaticTransforms()
    return transforms


def _placed(log: Log, tables: dict[str, Any], choice: Choice, transforms: StaticTransforms) -> Robot:
    """Return the robot with the mounts of /tf_static, which are known before anything can be measured."""
    streams = {}
    for name in REGISTRY:
        with suppress(LocfuseError):  # a topic that cannot be read says so elsewhere
            if topics := choice.of(name):
                streams[name] = [log.stream(topic) for topic in topics]
    return make_robot(robot_toml.merge(mount_tables(transforms, streams), tables))


def _of_files(log: Log) -> list[Oddity]:
    """What the files themselves lost, and whether they could tell."""
    found = [Oddity("lost", "file", line, spoils=True) for line in log.losses.lines()]
    if log.unchecked:
        names = ", ".join(log.unchecked[:3]) + (" ..." if len(log.unchecked) > 3 else "")
        found.append(
            Oddity("unchecked", "file", f"{names}: no checksums, so that a changed value cannot be detected")
        )
    return found


def _measure(seen: Look, progress: Callable[[str], None]) -> None:
    """Measure what can be, and let the doctor look at it."""
    if "wheels" not in seen.choice.topics:
        return
    try:
        loaded = measured(seen.log, seen.tables, seen.choice, progress, aside=COSTLY)
    except LocfuseError as e:
        seen.oddities += _not_measured(seen, str(e))
        return
    progress("looking for oddities")
    seen.loaded, seen.robot = loaded, loaded.robot
    streams = {
        role: joined([seen.log.stream(topic, loaded.robot.order) for topic in seen.choice.of(role)])
        for role in seen.choice.topics
    }
    phantoms = PHANTOMS if any(o.code == "range_max" and o.spoils for o in seen.oddities) else set()
    found = examine(replace(loaded.drive, notes=loaded.repairs), loaded.robot, streams)
    seen.oddities += [o for o in found if o.stream != "lrf" or o.code not in phantoms]
    seen.oddities += _unusable(seen, loaded)


def _not_measured(seen: Look, words: str) -> list[Oddity]:
    """Say why nothing could be measured, where that is not told yet."""
    role, _, rest = words.partition(": ")
    if role not in {"wheels", "truth", *REGISTRY}:
        role, rest = "log", words
    told = any(o.stream == role and o.spoils for o in seen.oddities)
    return [] if told else [Oddity("unusable", role, rest, settings_in(words), True)]


def _unusable(seen: Look, loaded: Loaded) -> list[Oddity]:
    """Sensors that the log has but that say nothing useful, where nothing else told why."""
    told = {o.stream for o in seen.oddities if o.spoils}
    return [
        Oddity("unusable", name, why.removeprefix(f"{name}: "), settings_in(why), bool(settings_in(why)))
        for name, why in loaded.drive.absent.items()
        if name in seen.choice.topics and name not in told
    ]
