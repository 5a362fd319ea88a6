"""Estimated settings of a robot with their sources: from a result, or from a log calibrated and tuned now."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any, TypeVar

import msgspec
from msgspec.structs import replace

from locfuse.cli.advice.report import FIXES_FILE
from locfuse.cli.analysis.grouping import result_file
from locfuse.cli.analysis.load import Loaded, with_settings
from locfuse.cli.analysis.robot_tables import flat
from locfuse.cli.analysis.settings import LogOptions, Progress
from locfuse.cli.session.calibrate import Calibration, calibrate_logs
from locfuse.cli.session.session import opened
from locfuse.cli.session.tune import Tuning, tune_logs
from locfuse.formats.inputs import MAX_REPORT, MAX_ROBOT_TOML, read_small
from locfuse.formats.robot.robot_toml import as_set, parse
from locfuse.formats.robot.ros_yaml import FOUND, KEPT, SET, Origin, Setting, Value
from locfuse.fusion.data import Estimates, LocfuseError
from locfuse.fusion.fuse import fuse
from locfuse.fusion.robot import Robot, WheelSettings
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.statistics import SIGMAS_95
from locfuse.fusion.wheels.velocity_noise import VelocityNoise, velocity_noise

MAX_FIRST = 4  # largest number of repetitions of a command, each after setting fixes
F = TypeVar("F", Calibration, Tuning)


class FoundRobot(msgspec.Struct, frozen=True, dict=True):
    """A log under the estimated settings, with the source of each setting."""

    loaded: Loaded
    nominal: WheelSettings  # as configured, before calibration
    calibration: Calibration | None
    sources: Mapping[str, str]  # "wheels.noise" -> source of its value in words
    notes: tuple[str, ...]

    @property
    def robot(self) -> Robot:
        """The estimated settings."""
        return self.loaded.robot

    @cached_property
    def velocity(self) -> VelocityNoise:
        """The wheel noise, converted to noise of velocities."""
        return velocity_noise(self.loaded.drive.wheels)

    @cached_property
    def estimates(self) -> Estimates:
        """The estimate of the drive with all sensors."""
        return fuse(self.loaded.drive, self.robot, list(self.loaded.drive.measurements))

    def topic(self, role: str) -> tuple[str, str]:
        """Return (topic, message type) of a role; "" for what the log lacks."""
        name = self.loaded.choice.topics.get(role, "")
        topics = self.loaded.log.topics
        return name, topics[name].msgtype if name in topics else ""

    def has(self, sensor: str) -> bool:
        """Return whether the log has measurements of a sensor."""
        return sensor in self.loaded.drive.measurements

    def why(self, key: str) -> str:
        """Return in words where the value of the setting `key` ("table.key") comes from."""
        return self.sources.get(key, f"{key} is the default of locfuse")

    def origin(self, key: str) -> Origin:
        """Return whether a setting's value was estimated (FOUND), configured (SET), or is a default (KEPT)."""
        words = self.sources.get(key)
        if words is None:
            return KEPT
        return FOUND if "locfuse" in words else SET

    def setting(self, key: str, value: Value, words: str, source: str, places: tuple[int, ...] = ()) -> Setting:
        """Return a parameter with the source of the setting "table.key"; `words` are unit and meaning."""
        words = f"{words}; {self.why(source)}"
        return Setting(key, value, words, self.origin(source), places=places)

    def topic_setting(self, key: str, role: str, msgtype: str) -> Setting:
        """Return the ROS parameter for a role's topic; a comment if its messages are not of type `msgtype`."""
        topic, kind = self.topic(role)
        if kind == msgtype:
            return Setting(key, topic, f"{topic} in the log", KEPT)
        words = f"{topic} is {kind or 'no topic of ROS'}, not {msgtype}: name your own"
        return Setting(key, None, words, KEPT)

    def unmapped(self, program: str, mapped: Collection[str], reasons: Mapping[str, str]) -> Iterator[Setting]:
        """Yield a comment for each sensor of the log that has no parameters in this program."""
        for sensor in self.loaded.drive.measurements:
            topic, kind = self.topic(sensor)
            unread = f"{topic} is {kind}, which {program} does not read" if kind else f"{program} does not read it"
            if sensor not in mapped:
                yield Setting(sensor, None, reasons.get(sensor, unread))


def positive(there: Mapping[str, Any], key: str) -> float | None:
    """Return the file's present value of `key` if it is a positive float, else None."""
    value = there.get(key)
    return value if isinstance(value, float) and value > 0.0 else None


def gather(
    log: Sequence[str], given: LogOptions, known: bool, wheels_only: bool, progress: Progress
) -> FoundRobot:
    """Return the estimated settings of a log's robot, or the settings of a folder of results.

    A log is calibrated and tuned, unless its settings are `known`. With `wheels_only` it is not tuned if
    calibration gives the wheels' noise.
    """
    words, how, by_result = _of_result(log, given)
    loaded = opened(words, how, progress).loaded
    if loaded.motion_faults:
        words = f"{loaded.motion_faults[0].words}: nothing is exported from it"
        raise LocfuseError(f"{loaded.log.name}: {words}", role="wheels")
    by_settings = {key: f"{key} by {source}" for key, source in loaded.sources.items()}
    sources = {**(by_result or by_settings), **_by_files(given)}
    nominal = loaded.robot.wheels
    if known or by_result:
        return FoundRobot(loaded, nominal, None, sources, ())
    work = _Work()

    def under(sets: Sequence[str]) -> Loaded:
        return with_settings(loaded, sets, progress) if sets else loaded

    calibration = work.by("calibrate", lambda sets: calibrate_logs([under(sets)], progress))
    if calibration is not None:
        sources |= _calibrated(calibration)
        nominal = calibration.settings

    def tuned(sets: Sequence[str]) -> Tuning:
        paths, again = list(loaded.log.paths), replace(how, sets=(*how.sets, *sets))
        return tune_logs([paths], [], tuple(REGISTRY), False, again, progress)

    enough = wheels_only and "wheels.noise" in sources and "calibrate" in sources["wheels.noise"]
    tuning = None if enough else work.by("tune", tuned)
    if tuning is not None and not tuning.refused:
        shown = [r for r in tuning.tuned.rows if r.identifiable]  # others are not seen in the log
        sources |= {r.key: f"{r.key} {r.after:.4g} ± {r.after * r.error:.2g}, locfuse tune" for r in shown}
    sources |= work.sources
    return FoundRobot(under(work.sets), nominal, calibration, sources, tuple(work.notes))


class _Work:
    """Runs commands in sequence, each with the settings found so far; stores settings, sources and notes."""

    def __init__(self) -> None:
        self.sets: list[str] = []
        self.sources: dict[str, str] = {}  # sources of fixes that had to be set before a command could run
        self.notes: list[str] = []

    def by(self, command: str, find: Callable[[Sequence[str]], F]) -> F | None:
        """Run a command with the settings found so far; return its result, or None if it fails.

        If the error message names fixes, they are added to the settings, and the command runs again.
        """
        for _ in range(MAX_FIRST + 1):
            try:
                found = find(self.sets)
            except LocfuseError as problem:
                first = [fix for fix in problem.fixes if fix not in self.sets]
                self.notes.append(f"locfuse {command}: {problem}")
                self.sets += first
                self.sources |= {fix.partition("=")[0]: f"{fix}, locfuse info --check" for fix in first}
                if not first:
                    return None
            else:
                self.sets += [as_set(key, value) for key, value in flat(found.tables()).items()]
                self.notes += (f"locfuse {command}: {note}" for note in found.notes)
                return found
        return None


def _calibrated(found: Calibration) -> dict[str, str]:
    """Return the source of each calibrated setting in words, with its standard deviation."""
    words = {
        f.key: f"{f.key} {f.figure.value:.4g} ± {(f.figure.high - f.figure.low) / (2 * SIGMAS_95):.2g}, "
        "locfuse calibrate"
        for f in found.fitted()
    }
    iron = {} if found.iron is None else dict.fromkeys(("hard_iron", "soft_iron"), "locfuse calibrate")
    return words | {f"compass.{key}": f"{key}, {by}" for key, by in iron.items()}


def _by_files(how: LogOptions) -> dict[str, str]:
    """Return the source of each setting in robot.toml files in words, with the command that wrote it."""
    words: dict[str, str] = {}
    for file in how.robots:
        text = read_small(file, MAX_ROBOT_TOML).decode("utf-8", "replace")
        names = (name for name in ("tune", "calibrate", "compare") if f"locfuse {name}" in text)
        by = next((f" (locfuse {name})" for name in names), "")
        words |= {key: f"{key} by {file.name}{by}" for key in flat(parse(text, str(file)))}
    return words


def _of_result(log: Sequence[str], how: LogOptions) -> tuple[Sequence[str], LogOptions, dict[str, str]]:
    """Return the log of a folder of results, with options and sources of settings; a log is returned unchanged."""
    report = result_file(log[0]) if len(log) == 1 else None
    if report is None:
        return log, how, {}
    folder = report.parent
    try:
        found = msgspec.json.decode(read_small(report, MAX_REPORT))
        words = shlex.split(found["repeat"])[2:]
        changed = {key: str(of["from"]) for key, of in found["changed_settings"].items()}
    except (msgspec.DecodeError, UnicodeDecodeError, ValueError, KeyError, TypeError, AttributeError):
        raise LocfuseError(f"{report} does not say which log it is of; export the log itself") from None
    names = words[: next((i for i, word in enumerate(words) if word.startswith("-")), len(words))]
    places = [str(folder / name) if (folder / name).exists() else name for name in names]
    fixes = folder / FIXES_FILE
    robots = [file for file in (folder / "robot.toml", fixes) if file.is_file()] + list(how.robots)
    used = replace(how, robots=tuple(robots))
    sources = {key: f"{key} by {source} (compared)" for key, source in changed.items()}
    if fixes.is_file():
        tables = parse(read_small(fixes, MAX_ROBOT_TOML), str(fixes))
        sources |= {key: f"{key} by {FIXES_FILE}, which locfuse compare tried" for key in flat(tables)}
    return places, used, sources
