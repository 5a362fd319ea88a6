"""Configurations (sets of sensors) to run: those of --sensors, else the paper's five, or every subset."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence

import msgspec
import numpy as np
from msgspec.structs import replace

from locfuse.formats.text import did_you_mean
from locfuse.fusion.data import BASES, LASER, Drive, Estimates, LocfuseError, UsageError
from locfuse.fusion.fuse import configuration_name, fuse
from locfuse.fusion.judge.credit import subsets
from locfuse.fusion.measure import thinned
from locfuse.fusion.robot import Preset, Robot
from locfuse.fusion.sensors.registry import REGISTRY, needed

from .errors import has_scipy
from .settings import Asked

RATE_PATTERN = re.compile(r"(\d+(?:\.\d+)?)\s*hz", re.IGNORECASE)
NOT_SMOOTHED = "not smoothed: the numbers of its map or of robot.toml span too many powers of ten"
MAX_SUBSET_SENSORS = 6  # sensors: 64 subsets
Sensors = str | Iterable[str]  # of one configuration


class Configuration(msgspec.Struct, frozen=True):
    """A set of sensors in registry order, perhaps some at a lower rate than in the log."""

    name: str
    sensors: tuple[str, ...]
    rates: Mapping[str, float] = {}  # Hz

    def drive(self, drive: Drive) -> Drive:
        """Return the drive with this configuration's readings: fewer for sensors at a lower rate."""
        return thinned(drive, self.rates) if self.rates else drive

    def is_smoothed(self, asked: Asked, robot: Robot) -> bool:
        """Return whether the smoothed path is shown.

        `asked.smooth` decides; odometry alone is never smoothed. If `asked.smooth` is None, the path is shown with
        a laser, with all sensors at the rates of the log, without jitter, and if smoothing is possible.
        """
        if asked.smooth is not None:
            return asked.smooth and bool(self.sensors)
        if asked.jitter or self.rates or LASER not in self.sensors:
            return False
        from locfuse.fusion.whole_drive.smooth import why_not_smoothed

        return has_scipy() and why_not_smoothed(robot, self.sensors) is None

    def fuse(
        self, drive: Drive, robot: Robot, smooth: bool = False, filtered: Estimates | None = None
    ) -> tuple[Estimates, ...]:
        """Run the filter, and with `smooth` the smoother. Returns (filtered,) or (filtered, smoothed).

        The smoother may use `filtered`, the same run of the filter with its audits, in place of another one.
        Raises UsageError if the filter to be smoothed does not use the optimal gain.
        """
        found: tuple[Estimates, ...]
        if smooth:
            from locfuse.fusion.whole_drive.smooth import fuse_and_smooth

            found = filtered, whole = fuse_and_smooth(self.drive(drive), robot, self.sensors, self.name, filtered)
            if not np.isfinite(whole.pose).all():
                found = (replace(filtered, notes=(*filtered.notes, NOT_SMOOTHED)),)
        else:
            found = (fuser(robot.preset)(self.drive(drive), robot, self.sensors, self.name),)
        return tuple(replace(e, rates=self.rates) for e in found) if self.rates else found


def fuser(preset: Preset) -> Callable[..., Estimates]:
    """Return the function that runs the filter of a preset; its arguments are those of `fusion.fuse.fuse`."""
    if preset == "paper":
        from locfuse.fusion.paper.filter import fuse_as_printed

        return fuse_as_printed
    return fuse


def parse(sensors: Sensors, drive: Drive) -> Configuration:
    """Return the configuration of one --sensors: "all", "odometry", "compass,lrf", or a list of sensors.

    Raises UsageError for an unknown word, LocfuseError for a sensor that this log lacks.
    """
    words = sensors if isinstance(sensors, str) else ",".join(sensors)
    present = tuple(s for s in REGISTRY if s in drive.measurements)
    names = list(dict.fromkeys(w.strip() for w in words.replace("+", ",").split(",") if w.strip()))
    if names == ["all"]:
        return plain(present, drive)
    if len(names) == 1 and names[0] in BASES:
        return plain((), drive)
    refuse_beside_others(words, names)
    rates: dict[str, float] = {}
    written: dict[str, str] = {}
    for name in names:
        sensor, at, rate = name.partition("@")
        if sensor not in REGISTRY:
            raise unknown_sensor(sensor)
        if sensor not in present:
            why = drive.absent.get(sensor, "no topic of its type in this log")
            raise LocfuseError(f"--sensors {name}: {why}", fixes=drive.fixes.get(sensor, ()))
        written[sensor] = name
        if at:
            found = RATE_PATTERN.fullmatch(rate.strip())
            rates[sensor] = float(found[1]) if found else 0.0
            if rates[sensor] <= 0.0:
                raise UsageError(f"--sensors {name}: a lower rate reads like lrf@2Hz")
    used = tuple(s for s in REGISTRY if s in written)
    lacking = [(s, other, why) for s in used for other, why in REGISTRY[s].needs.items() if other not in written]
    for sensor, other, why in lacking:
        enough = ",".join((other, *written.values()))
        raise UsageError(f"--sensors {words}: {sensor} is {why}; write --sensors {enough}")
    if not rates:
        return plain(used, drive)
    return Configuration("+".join(written[s] for s in used), used, rates)


def configuration_words(sensors: Sensors | Iterable[Sensors] | None) -> tuple[str, ...]:
    """Return configurations as the words of --sensors, one word for each; () for None."""
    words = () if sensors is None else (sensors,) if isinstance(sensors, str) else sensors
    return tuple(word if isinstance(word, str) else ",".join(word) for word in words)


ALIASES = {  # a sensor's other names -> its name in --sensors
    "laser": "lrf",
    "lidar": "lrf",
    "scan": "lrf",
    "imu": "gyro or compass",
    "magnetometer": "compass",
    "gnss": "gps",
    "uwb": "ranges",
    "tags": "landmarks",
    "wheels": "odometry",
}


def unknown_sensor(name: str) -> UsageError:
    """Return the error for an unknown sensor, with the most similar name."""
    known = ("odometry", *REGISTRY, "all")
    near = f"did you mean {ALIASES[name.lower()]}?" if name.lower() in ALIASES else did_you_mean(name, known)
    choose = f"choose from {', '.join(known)}"
    return UsageError(f"--sensors: unknown sensor {name!r}; {f'{near} Or ' if near else ''}{choose}")


def refuse_beside_others(words: str, names: Sequence[str]) -> None:
    """Raise UsageError if `all` or `odometry` is combined with other sensor names."""
    meaning = {"all": "every sensor of the log", "odometry": "the wheels and no sensor"}
    for word, what in meaning.items():
        others = [name for name in names if name != word]
        if word in names and others:
            fix = ",".join(name for name in others if name not in meaning) or others[0]
            alone = f"{word} stands alone, it means {what}"
            raise UsageError(f"--sensors {words}: {alone}; write --sensors {word} or --sensors {fix}")


def plain(sensors: tuple[str, ...], drive: Drive) -> Configuration:
    """Return a configuration with all sensors at the rates of the log."""
    return Configuration(configuration_name(sensors, drive), sensors)


def for_comparison(words: Sequence[str], drive: Drive, every: bool = False) -> list[Configuration]:
    """Return the configurations that `compare` runs: those in `words`, or the usual ones.

    The usual ones are odometry, each sensor alone, and all sensors together. With `every`, all other sets of
    sensors are added.
    """
    present = tuple(s for s in REGISTRY if s in drive.measurements)
    named = [parse(w, drive) for w in words]
    if every:
        if len(present) > MAX_SUBSET_SENSORS:
            n = len(present)
            raise UsageError(f"--all-subsets: {n} sensors have {2**n} subsets; leave it out")
        named = [plain(s, drive) for s in subsets(present)] + named
    if not named:
        alone = [tuple(s for s in present if s in (name, *needed(name))) for name in present]
        together = [present] if len(present) > 1 else []
        named = [plain(s, drive) for s in [(), *alone, *together]]
    return list({c.name: c for c in named}.values())
