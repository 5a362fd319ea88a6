"""Inspection of a log for `info` and `init`: topics, roles, mounts, missing settings, findings and fixes.

An error becomes a finding and the inspection continues, since this is for logs that cannot be fused yet.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

from msgspec.structs import replace

from locfuse.cli.analysis.body_topics import NoWheelsError
from locfuse.cli.analysis.choose import TF, choose_each
from locfuse.cli.analysis.examined import examined
from locfuse.cli.analysis.load import Loaded, Parts, find_log, measured, unbroken
from locfuse.cli.analysis.maps import GRID
from locfuse.cli.analysis.motion_evidence import STANDS
from locfuse.cli.analysis.mounts import mount_tables, shared_turns, transforms_of
from locfuse.cli.analysis.robot_tables import make_robot, merged_tables, named_by_hand
from locfuse.cli.analysis.settings import LogOptions, Progress, silent
from locfuse.cli.analysis.topics import Choice, filled, of_type
from locfuse.formats.logs.log import Log, open_log
from locfuse.formats.report.findings import options
from locfuse.formats.robot import robot_toml
from locfuse.formats.robot.transforms import StaticTransforms
from locfuse.fusion.checks.examine import BLIND, MIXED, too_short
from locfuse.fusion.checks.finding import Finding, of_error
from locfuse.fusion.checks.laser_ranges import driver
from locfuse.fusion.checks.pictures import of_pictures
from locfuse.fusion.checks.raw_data import PUBLISHERS
from locfuse.fusion.checks.start import START
from locfuse.fusion.checks.tracked_point import POINT
from locfuse.fusion.checks.truth import FEW, of_few
from locfuse.fusion.data import LocfuseError, Stream
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY

from .robot_facts import Overview, conflicts, find_robot_facts, possible_truth, unplaced, wheel_size
from .topics import derived_facts, of_publishers, of_stamps, topic_facts

UNCHECKED = "{files}: no checksums: a corrupted value would go unnoticed"


def inspect_log(words: Parts, how: LogOptions, progress: Progress = silent) -> Overview:
    """Inspect a log. Raises LocfuseError only if it cannot be opened, or robot.toml cannot be read."""
    progress("opening")
    log = open_log(find_log(words))
    tables, _ = merged_tables(log, how)
    robot = make_robot(tables)
    progress("topics")
    facts = topic_facts(log, robot.order)
    found: list[Finding] = []
    choice = _choose(log, robot, named_by_hand(how.sets), found)
    facts += derived_facts(log, robot.order)
    overview = Overview(log, tables, choice, facts, *_placed(log, tables, choice, found))
    overview.robot_facts = find_robot_facts(overview)
    names = ", ".join(log.unchecked[:3]) + (" ..." if len(log.unchecked) > 3 else "")
    overview.findings = [
        *(Finding("file", "lost", line, severe=True) for line in log.losses.lines()),
        *([Finding("file", "unchecked", UNCHECKED.format(files=names))] if log.unchecked else ()),
        *found,
        *wheel_size(overview),
        *possible_truth(overview),
        *of_stamps(facts, choice, overview.robot),
        *of_publishers(log, choice),
        *_of_messages(
            "lrf", choice.of("lrf"), lambda stream, _: driver(stream, log.recorded(stream.topic)), overview
        ),
        *_of_messages("camera", pictures_of(log, choice), of_pictures, overview),
        *_maps(overview),
    ]
    _measure(overview, progress)
    if choice.unused_wheels and overview.loaded is not None:
        overview.robot_facts = find_robot_facts(overview)
        # found with another motion than the wheels that the fixes choose
        gone = {"geometry", *((POINT, START) if overview.robot_facts.steered else ())}
        overview.findings = [*(f for f in overview.findings if f.code not in gone), *wheel_size(overview)]
    overview.findings += [*unplaced(overview), *conflicts(overview)]
    return overview


def _choose(log: Log, robot: Robot, insisted: set[str], found: list[Finding]) -> Choice:
    """Choose the topics of each role; an error for one role becomes a finding."""
    choice = Choice()
    for role, e in choose_each(log, robot, insisted, choice):
        if role == TF:  # the frames form a loop
            topic, _, words = str(e).partition(": ")
            found.append(Finding(topic, "tf", words))
            continue
        finding = of_error(e, role, "choice")  # severe: `run` and `compare` fail too
        if isinstance(e, NoWheelsError):
            finding = replace(finding, message=finding.brief, hint="")  # info lists the topics
        choice.leave(role, finding.sentence, finding.fixes)
        found.append(finding)
    found += [Finding(note.role, "choice", note.words, note.fixes) for note in choice.notes if not note.is_fault]
    return choice


def _placed(
    log: Log, tables: dict[str, Any], choice: Choice, found: list[Finding]
) -> tuple[StaticTransforms, dict[str, Any], Robot]:
    """Return the log's static transforms, the sensor mounts by these transforms, and the robot with these mounts.

    Settings in `tables` override the mounts.
    """
    streams: dict[str, list[Stream]] = {}
    for name in REGISTRY:
        for topic in choice.of(name):
            with suppress(LocfuseError):  # an unreadable topic has its own finding
                stream = log.stream(topic)
                streams.setdefault(name, []).append(stream)
    transforms = StaticTransforms()
    try:
        transforms = transforms_of(log, [part.frame_id for parts in streams.values() for part in parts])
    except LocfuseError as e:
        found.append(Finding("/tf_static", "tf_static", str(e)))
    mounts, turns = mount_tables(transforms, streams, tables), shared_turns(tables, streams)
    return transforms, mounts, make_robot(robot_toml.merge(mounts, turns, tables))


def _measure(overview: Overview, progress: Progress) -> None:
    """Measure all sensors that need little time, and add the findings of the checks."""
    if "wheels" not in overview.choice.topics:
        return
    try:
        costly = [name for name, sensor in REGISTRY.items() if sensor.costly]
        loaded = measured(overview.log, overview.tables, overview.choice, progress, aside=costly)
    except LocfuseError as e:
        role = e.role if e.role in {"wheels", "truth", *REGISTRY} else "log"
        if role == "wheels":  # other clocks cannot be compared with the wheels' clock
            overview.findings = [f for f in overview.findings if f.code != "other clock"]
        if not any(f.role == role and f.severe for f in overview.findings):
            overview.findings.append(of_error(e, role, "unusable"))
        return
    progress("looking for findings")
    overview.loaded, overview.robot = loaded, loaded.robot
    overview.findings += [Finding(n.role, "motion", n.words, n.fixes, severe=True) for n in loaded.motion_faults]
    if loaded.drive.wheels.stands:
        overview.findings.append(Finding("wheels", "standing", STANDS))
    part, holes = unbroken(loaded)
    short = too_short(loaded.drive)
    overview.findings += [*holes, *([Finding("log", "short", short)] if short else [])]
    found, known = examined(part), {f.role for f in overview.findings if f.severe}
    if loaded.motion_faults or short:  # such a drive cannot show faults of sensors
        found = [f for f in found if f.code in {"repaired", "refused", "gap", BLIND, *MIXED}]
    if loaded.drive.dropped.get("wheels", {}).get("other_joints"):  # an arm, say, publishes on the same topic
        overview.findings = [f for f in overview.findings if (f.role, f.code) != ("wheels", PUBLISHERS)]
    by_channels = {f.role for f in overview.findings if f.code == PUBLISHERS}
    found = [f for f in found if f.code != PUBLISHERS or f.role not in by_channels]
    overview.findings += [f for f in found if f.code != FEW and (f.code != START or not part.how.begin)]
    overview.findings += of_few(loaded.drive) if "truth" not in known else []
    overview.findings += _unusable(overview, loaded)


def _unusable(overview: Overview, loaded: Loaded) -> list[Finding]:
    """Return a finding for each sensor that has a topic but cannot be used, unless it has a severe finding."""
    known = {f.role for f in overview.findings if f.severe}
    found = []
    for name, why in loaded.drive.absent.items():
        if name in overview.choice.topics and name not in known:
            fixes = loaded.drive.fixes.get(name, ())
            words = why.removesuffix(options(fixes)).rstrip()
            found.append(Finding(name, "unusable", words, fixes, bool(fixes), hint=why[len(words) :].lstrip()))
    return found


def _maps(overview: Overview) -> list[Finding]:
    """Return a finding on occupancy grids in the log, in which the laser can be localised."""
    robot, topics = overview.robot, [t for t in filled(overview.log, GRID) if "costmap" not in t.lower()]
    topics.sort(key=lambda t: t != "/map")
    if not topics or not overview.choice.of("lrf") or robot.settings("lrf").map_topic is not None or robot.lines:
        return []
    words = (
        f"{' and '.join(topics)} {'holds a map' if len(topics) == 1 else 'hold maps'}, in which the laser can be "
        "localised; one that was made of these scans says nothing new"
    )
    return [Finding("lrf", "map", words, (f"lrf.map_topic={topics[0]}",))]


def pictures_of(log: Log, choice: Choice) -> tuple[str, ...]:
    """Return the topics of pictures with messages: those of the camera role, or all if it has none."""
    found = choice.of("camera") or tuple(of_type(log, REGISTRY["camera"].reads))
    return tuple(topic for topic in found if log.topics[topic].count)


def _of_messages(
    role: str, topics: Sequence[str], examine: Callable[[Any, Any], list[Finding]], overview: Overview
) -> list[Finding]:
    """Return the findings on the raw messages of a role, [] unless it has exactly one topic."""
    if len(topics) != 1:
        return []
    try:
        robot = overview.robot
        return examine(overview.log.stream(topics[0], robot.order), robot.settings(role))
    except LocfuseError as e:
        return [of_error(e, role, "unusable")]
