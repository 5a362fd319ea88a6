"""Loading: from the words of the command line to a measured drive (log, robot, topics, streams, Drive)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from copy import deepcopy
from functools import cached_property
from typing import Any, cast

import msgspec
import numpy as np
from msgspec.structs import replace

from locfuse import sample_logs
from locfuse.formats.container.file_bytes import Place, Url, place
from locfuse.formats.logs.log import Log, open_log
from locfuse.formats.robot import robot_toml
from locfuse.formats.text import did_you_mean, visible
from locfuse.fusion import se2
from locfuse.fusion.checks.examine import holes, longest_part, of_holes
from locfuse.fusion.checks.finding import Finding
from locfuse.fusion.checks.laser_ranges import of_angles
from locfuse.fusion.checks.start import START_SIGMAS, start_pose
from locfuse.fusion.data import FAULT, Array, Drive, Event, LocfuseError, Measurements, Stream, UsageError
from locfuse.fusion.measure import begun, led_back, measure, windowed
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.lrf import laser_of
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.streams import merged, outside, parts_of, seconds
from locfuse.fusion.truth import NO_TRUTH, TRUTH_READS
from locfuse.fusion.wheels.odometry import SCANS
from locfuse.fusion.wheels.read import WHEEL_READS, WheelReading, read_wheels

from . import robot_tables
from .choose import choose
from .motion_evidence import STANDS, find_motion_faults, path_of
from .mounts import (
    level_compass,
    mount_tables,
    odometry_mount,
    on_moving_parts,
    optics_tables,
    shared_turns,
    transforms_of,
)
from .robot_tables import flat, make_robot
from .settings import LogOptions, Progress, silent
from .topics import Choice, Note

# scan-to-scan matching cannot observe the laser's mount
EXACT_LASER = {"lrf": {"sigma_x": 0.0, "sigma_y": 0.0, "sigma_yaw_deg": 0.0}}
SAME_SCANS = (
    "wheels: the motion and the laser are of the same scans, which count twice: with the laser the covariance is "
    "too small where the scans share an error"
)
MAX_LISTED = 1000  # entries of a folder compared with a mistyped name
Parts = Sequence[str | Place]  # parts of one log: words of the user, or places


class Loaded(msgspec.Struct, frozen=True, dict=True):
    """A measured log, with its settings and their sources."""

    log: Log
    robot: Robot
    choice: Choice
    drive: Drive
    tables: Mapping[str, Any] = {}  # merged settings, without mounts from /tf_static
    sources: Mapping[str, str] = {}  # key -> its source: "lrf.x" -> "--set"
    given: Mapping[str, Any] | None = None  # settings from the user; None: no key can be computed for the result
    how: LogOptions = LogOptions()
    reading: WheelReading | None = None  # the motion of the whole log; None: read it again
    motion_faults: tuple[Note, ...] = ()  # why the motion is not the robot's; with any, all figures are void

    def stream(self, role: str) -> Stream:
        """Return the raw readings of a role ("wheels", a sensor, "truth") from all its topics."""
        return merged([self.log.stream(topic, self.robot.order) for topic in self.choice.of(role)])

    @cached_property
    def labels(self) -> tuple[Event, ...]:
        """Fault labels in the log, read at first use."""
        return tuple(fault_labels(self.log, self.drive, self.robot.order))

    @property
    def window(self) -> tuple[float | None, float | None]:
        """Begin and end of the used part of the drive [s]; None: no bound."""
        return self.how.begin, self.how.end


def find_log(words: Parts) -> list[Place]:
    """Return the places of a log's parts; a file takes precedence over a sample log's name."""
    return [_find(str(word)) for word in words]


def _find(word: str) -> Place:
    path = place(word)
    if isinstance(path, Url) or path.exists():
        return path
    samples = sample_logs.names()
    if word in samples:
        return sample_logs.path(word)
    known = list(samples)
    with suppress(OSError):
        known += map(str, itertools.islice(path.parent.iterdir(), MAX_LISTED))
    near = did_you_mean(word, known)
    raise UsageError(f"no such log: {word}{f'; {near}' if near else '.'} Sample logs: {', '.join(samples)}")


def load(
    log: Parts,
    how: LogOptions,
    progress: Progress = silent,
    only: Collection[str] | None = None,
    aside: Collection[str] = (),
) -> Loaded:
    """Open a log, choose its topics, and measure `only` these sensors (None: all), without the roles `aside`.

    Raises LocfuseError if a step fails.
    """
    places = find_log(log)
    progress("opening")
    # the settings first: a file that changes during the run then gets another key next time
    given = robot_tables.given_tables(how)
    opened = open_log(places)
    tables, sources = robot_tables.merged_tables(opened, how)
    choice = choose(opened, make_robot(tables), robot_tables.named_by_hand(how.sets))
    found = measured(opened, tables, choice, progress, only, aside)
    return _in_window(replace(found, sources=sources, given=given, how=how))


def _in_window(loaded: Loaded) -> Loaded:
    """Return the log with its drive cut to the window of --from and --to."""
    if loaded.window == (None, None):
        return loaded
    drive, robot = windowed(loaded.drive, loaded.robot, *loaded.window)
    return replace(loaded, drive=drive, robot=robot)


def unbroken(loaded: Loaded) -> tuple[Loaded, list[Finding]]:
    """Return the log cut to its longest part without a hole, and a finding on holes; [] if it has no hole."""
    if not (found := holes(loaded.drive)):
        return loaded, []
    begin, end = longest_part(loaded.drive, found)
    how, ours = loaded.how, loaded.window == (None, None)
    part = replace(how, begin=begin or how.begin, end=end or how.end, beside_hole=ours)
    return _in_window(replace(loaded, how=part)), of_holes(loaded.drive, found)


def measured(
    log: Log,
    tables: Mapping[str, Any],
    choice: Choice,
    progress: Progress = silent,
    only: Collection[str] | None = None,
    aside: Collection[str] = (),
    known: Mapping[str, Measurements] | None = None,
    before: Loaded | None = None,
) -> Loaded:
    """Measure the chosen topics of a log with the settings `tables`, except the roles in `aside`.

    `known` measurements are used again: settings of their sensors and of the wheels must be unchanged. `before` is
    the same log under other settings; its readings and matched scans are used again if possible.
    """
    for sensor in REGISTRY:
        if only is not None and sensor not in only:
            choice.topics.pop(sensor, None)
        is_lacking = tables["preset"] == "paper" and sensor not in robot_tables.PAPER_SENSORS
        if is_lacking and choice.topics.pop(sensor, ""):
            choice.absent[sensor] = "the paper has no equation for it (--preset paper)"
    if both := set(choice.of("truth")) & set(choice.of("wheels")):
        words = f"{min(both)} is also the robot's motion (wheels), so it cannot judge it"
        hint = f"(name another topic for truth or for wheels, or judge without it: --set {NO_TRUTH})"
        raise LocfuseError(words, role="truth", fixes=(NO_TRUTH,), hint=hint)
    progress("reading")
    streams = _streams(log, choice, str(tables.get("order", "auto")))
    _refuse_lost_wheels(log, choice, streams)
    sensed = {s: parts_of(streams[s]) for s in REGISTRY if s in streams}
    if by_scans := "wheels" in streams and streams["wheels"].msgtype == SCANS:
        sensed.setdefault("lrf", parts_of(streams["wheels"]))  # scan matching needs the mount too
    frames = [part.frame_id for s in sensed for part in sensed[s]]
    transforms = transforms_of(log, frames)
    placed = EXACT_LASER if by_scans else {}
    own = odometry_mount(log, choice.of("wheels"), transforms)
    mounts = robot_toml.merge(
        placed, mount_tables(transforms, sensed, tables), optics_tables(log, sensed, tables), own
    )
    settings = robot_toml.merge(mounts, shared_turns(tables, sensed), tables)
    robot = robot_tables.with_point_maps(make_robot(settings))
    moving = on_moving_parts(transforms, sensed, tables)
    if by_scans and "lrf" in moving:
        raise LocfuseError(moving["lrf"], role="lrf")
    wanted = {role: s for role, s in streams.items() if role not in aside and role not in moving}
    wanted = level_compass(log, wanted, robot, transforms)
    if by_scans:  # the robot's motion by its laser alone, if no wheels were recorded
        progress("matching scans")
        matched = path_of(log, choice.of("wheels")[0], robot.order, laser_of(robot.settings("lrf")))
        motion = matched.reading(robot.wheels, robot.settings("lrf").time_offset)
    elif before is not None and before.reading is not None:
        motion = before.reading.with_noise(robot.wheels.noise)
    elif not own and (read := choice.read.get(choice.of("wheels"))) is not None:
        motion = read
    else:
        progress("measuring the wheels")
        motion = read_wheels(wanted["wheels"], robot.wheels)
    choice.read.clear()
    shown = None if before is None else before.drive.measurements
    drive = measure(wanted, robot, {**choice.absent, **moving}, progress, known, motion, shown)
    robot, drive = led_back(*begun(robot, drive), _first_scan(streams, robot, drive))
    _refuse_other_clock(log, drive)
    preset = (robot_tables.PAPER_NOTE,) if robot.preset == "paper" else ()
    chosen = (f"{note.role}: {note.words}" for note in choice.notes if note.role in streams and not note.is_fault)
    notes = (
        *preset,
        *chosen,
        *_clock_notes(streams),
        *start_notes(robot, drive),
        *((f"wheels: {STANDS}",) if drive.wheels.stands else ()),
        *(finding.line for finding in (of_angles(streams["lrf"]) if "lrf" in streams else ())),
        *((SAME_SCANS,) if by_scans and "lrf" in drive.measurements else ()),
        *drive.notes,
    )
    drive = replace(drive, notes=notes, fixes={**choice.fixes, **drive.fixes})
    faults = find_motion_faults(log, robot, choice, motion)
    return Loaded(log, robot, choice, drive, tables, reading=motion, motion_faults=faults)


def _first_scan(streams: Mapping[str, Any], robot: Robot, drive: Drive) -> float | None:
    """Return the time [s] of the drive's first scan if [start] has at = "scan" (pose at this scan), else None."""
    roles = [role for role in ("lrf", "wheels") if role in streams and streams[role].msgtype == SCANS]
    if robot.start.at != "scan" or not roles:
        return None
    if (m := drive.measurements.get("lrf")) is not None and len(m.t):
        return float(m.t[0])
    t = (streams[roles[0]].t_ns - drive.epoch_ns) * 1e-9 + robot.settings("lrf").time_offset
    inside = t[(t >= 0.0) & (t <= drive.t[-1])]
    return float(inside.min()) if len(inside) else None


def _refuse_other_clock(log: Log, drive: Drive) -> None:
    """Raise LocfuseError if no row of a truth file lies in the time of the drive."""
    truth = drive.truth
    if truth is None or not log.is_file(truth.topic) or ((truth.t >= 0.0) & (truth.t <= drive.t[-1])).any():
        return
    raise outside(truth.t, drive.t, "truth", truth.time_offset)


def _refuse_lost_wheels(log: Log, choice: Choice, streams: Mapping[str, Any]) -> None:
    """Raise LocfuseError if no message of the wheels can be read because the file is damaged."""
    promised = sum(log.topics[topic].count for topic in choice.of("wheels"))
    if "wheels" not in streams or not promised or len(streams["wheels"].t_ns):
        return
    why = log.losses.lines() or [f"{n} {reason}" for reason, n in streams["wheels"].dropped.items()]
    if why:
        topics = " and ".join(choice.of("wheels"))
        raise LocfuseError(f"wheels: none of {promised} messages on {topics} can be read: {why[0]}")


def with_settings(loaded: Loaded, words: Sequence[str], progress: Progress = silent) -> Loaded:
    """Return the log under other settings; only sensors whose settings changed are measured again.

    Raises UsageError for settings that need a new `load`: topics, order, preset.
    """
    sets = robot_tables.set_tables(words)
    reading = [key for key in flat(sets) if key in {"order", "preset"} or key.endswith((".topic", ".topics"))]
    if reading:
        raise UsageError(f"{reading[0]} decides what is read of the log: give it when the log is loaded (--set)")
    if loaded.robot.lines:
        raise UsageError("this session was given a map: change the settings first, then with_map(FILE)")
    tables = robot_toml.layered(loaded.tables, sets)
    same = {table for table in tables if _measured_by(tables, table) == _measured_by(loaded.tables, table)}
    by_scans = loaded.drive.wheels.matched is not None
    moving = ("wheels", "lrf") if by_scans else ("wheels",)  # tables that the motion depends on
    wheels = all(table in same or table not in tables for table in moving)
    unchanged = {s: m for s, m in loaded.drive.measurements.items() if wheels and (s in same or s not in tables)}
    if make_robot(tables).wheels.noise != loaded.robot.wheels.noise:  # deskewed scans depend on this noise
        unchanged = {s: m for s, m in unchanged.items() if "shared" not in m.extra}
    if "gyro" in tables and "gyro" not in same:
        unchanged.pop("compass", None)  # the IMU's mount levels the magnetic field
    given = None if loaded.given is None else robot_tables.with_files(robot_toml.layered(loaded.given, sets))
    choice = deepcopy(loaded.choice)
    before = loaded if wheels else replace(loaded, reading=None)
    found = measured(loaded.log, tables, choice, progress, known=unchanged, before=before)
    sources = {**loaded.sources, **dict.fromkeys(flat(sets), "--set")}
    how = replace(loaded.how, sets=(*loaded.how.sets, *words))
    return _in_window(replace(found, sources=sources, given=given, how=how))


def _measured_by(tables: Mapping[str, Any], table: str) -> Any:
    """Return the keys of a settings table that affect measurements (not gates, states, wheel noise)."""
    keys = tables.get(table, {})
    if not isinstance(keys, Mapping):
        return keys
    only_fused = getattr(robot_tables.table_types().get(table), "only_fused", ())
    return {key: value for key, value in keys.items() if key not in only_fused}


def _streams(log: Log, choice: Choice, order: str) -> dict[str, Any]:
    """Return the stream of every role; small columns of all topics are read in one pass over the log."""
    wants: dict[str, tuple[str, ...]] = {}
    for role in choice.topics:
        for topic in choice.of(role):
            fields = common_fields(role, log.topics[topic].msgtype)
            wants[topic] = tuple(dict.fromkeys((*wants.get(topic, ()), *fields)))
    streams = log.streams(wants, order=order)
    return {role: merged([streams[topic] for topic in choice.of(role)]) for role in choice.topics}


def common_fields(role: str, msgtype: str) -> tuple[str, ...]:
    """Return the message fields of a role, to be read with all other topics; () for a role read in blocks."""
    reads = {"wheels": WHEEL_READS, "truth": TRUTH_READS}
    if role in reads:
        return reads[role][msgtype]
    return () if REGISTRY[role].in_blocks else REGISTRY[role].reads[msgtype]


def _clock_notes(streams: Mapping[str, Any]) -> list[str]:
    """Return notes on streams whose times are not the header stamps, or are unusual."""
    notes: dict[str, None] = {}  # an ordered set: topics of one role may have equal notes
    for role, stream in streams.items():
        for part in parts_of(stream):
            words = [] if part.clock.as_stamped else [part.clock.words]
            notes |= dict.fromkeys(f"{role}: {word}" for word in (*words, *part.clock.notes))
    return list(notes)


def start_error(robot: Robot, drive: Drive) -> float | None:
    """Return the distance [m] between truth and wheels at the truth's start; None if that is unknown.

    The wheels' position is taken at the truth's first stamp, which may be later than the start. If [start] is set,
    None is also returned for a distance within START_SIGMAS, and if the robot moved before that stamp.
    """
    truth = drive.truth
    if truth is not None and robot.start_given:
        found = start_pose(truth, drive)
        if found is None or found.t > drive.wheels.t[0]:
            return None
        away = math.hypot(*(found.pose[:2] - robot.start.pose[:2]))
        return away if away > START_SIGMAS * found.place_sigma(robot, truth) else None
    places = _first_places(robot, drive)
    return None if places is None else math.hypot(*(places[0] - places[1]))


def _first_places(robot: Robot, drive: Drive) -> tuple[Array, Array] | None:
    """Return the truth's first position and the wheels' at that time, (2,) m each; None if [start] is set."""
    truth = drive.truth
    if truth is None or robot.start_given or not len(truth.t):
        return None
    pose = se2.compose(np.array(robot.start.pose), drive.wheels.at(truth.t[:1])[2])
    return truth.xy[0], (pose[:, :2] + se2.rotated(pose[:, 2], np.array([truth.point])))[0]


def start_notes(robot: Robot, drive: Drive) -> list[str]:
    """Return a note if truth and wheels start at different places and [start] is not set."""
    places = _first_places(robot, drive)
    if places is None or (away := math.hypot(*(places[0] - places[1]))) < 0.05:
        return []
    (x, y), (own_x, own_y) = places
    return [
        f"truth starts {away:.2f} m away from the robot's start ({own_x:z.2f}, {own_y:z.2f}), "
        f"at ({x:.2f}, {y:.2f}): set [start], or judge the shape only with --align origin"
    ]


# ---- fault labels: texts on /faults, which `locfuse simulate` writes ----

FAULTS, FAULTS_TYPE = "/faults", "std_msgs/msg/String"
MAX_LABEL_CHARACTERS = 120
LABEL_KEYS = ("event", "start", "end", "kind", "sensor")


def fault_labels(log: Log, drive: Drive, order: str) -> list[Event]:
    """Return the labelled faults of a log, clipped to the drive; [] without the topic /faults."""
    info = log.topics.get(FAULTS)
    if info is None or info.msgtype != FAULTS_TYPE:
        return []
    stream, end = log.stream(FAULTS, order=order), float(drive.t[-1])
    times, texts = seconds(stream.t_ns, drive.epoch_ns).tolist(), cast("list[str]", stream.columns("data")["data"])
    begun: dict[str, float] = {}
    found: list[Event] = []
    for at, text in zip(times, texts, strict=True):
        event, words = _parse_label(str(text))
        if event == "begin":
            begun[words] = at
        else:
            start = begun.pop(words, 0.0 if event == "end" else at)
            found.append(Event(max(start, 0.0), min(at, end), FAULT, words))
    # a fault without an end label lasts to the end of the drive
    found += [Event(max(at, 0.0), end, FAULT, words) for words, at in begun.items()]
    return sorted(e for e in found if e.start <= end and e.end >= 0.0)


def _parse_label(text: str) -> tuple[str, str]:
    """Return (event, words) of a label; the event is "begin", "end" or "" (neither)."""
    try:
        table = msgspec.json.decode(text, type=dict[str, Any])
    except msgspec.DecodeError:
        return "", visible(text[:MAX_LABEL_CHARACTERS])
    kind, sensor = table.get("kind", "fault"), table.get("sensor", "")
    values = {k: v for k, v in table.items() if k not in LABEL_KEYS}
    more = [f"{key} {value}" for key, value in values.items() if isinstance(value, int | float | str)]
    words = " ".join(str(part) for part in (sensor, kind, f"({', '.join(more)})" if more else "") if part)
    return str(table.get("event", "")), visible(words[:MAX_LABEL_CHARACTERS])
