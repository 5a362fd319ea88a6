"""The agreement of a log's motions with its other sensors: with the laser, else with gyro, compass or GPS.

With a laser a measured motion is kept where about as many points agree as by matching the scans with each other.
What it does not see is said in `fusion.wheels.scan_agreement`; where the scans tell nothing, every motion is kept
and the kinds of the topics decide.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, NamedTuple
from weakref import WeakKeyDictionary

from msgspec.structs import replace

from locfuse.fusion.data import LocfuseError, Measurements
from locfuse.fusion.robot import Robot, WheelSettings
from locfuse.fusion.sensors.level import FIELD, IMU
from locfuse.fusion.sensors.lrf import laser_of
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.streams import merged
from locfuse.fusion.truth import FIX
from locfuse.fusion.wheels.motion import turns_explained, ways_explained
from locfuse.fusion.wheels.read import WheelReading, read_wheels

from .mounts import mount_tables, transforms_of
from .topics import of_sensor

if TYPE_CHECKING:
    from locfuse.formats.logs.log import Log
    from locfuse.fusion.lines.scans import Laser
    from locfuse.fusion.wheels.motion_by_scans import MatchedScans
    from locfuse.fusion.wheels.scan_agreement import ScanPairs

MAX_SPEEDS = 2  # topics of commanded or measured speeds that are looked at beside scans
PLACE = ("x", "y", "yaw_deg", "flipped")  # of a laser on the base
SURE_SHARE = 0.9  # s from which on no matching can be so much better
WORSE_SHARE = 0.10  # s by which a motion may be worse than the matching of the scans
BELOW_STILL_SHARE = 0.05  # s by which a motion may be worse than standing
BETTER_SHARE = 0.015  # s by which matching must be better than wheels of known size, to be said ...
MAX_MISFIT_SIGMAS = 2.0  # and the turns of these wheels further from it than their noise explains
TELLING_SHARE = 0.03  # s by which matching must be better than standing: else the scans tell nothing
ALIKE_SHARE = 0.10  # s by which two motions of one kind must differ: else neither is chosen

# --- without a laser
TURNING = {"gyro": (IMU,), "compass": (IMU, FIELD)}
MIN_EXPLAINED_SHARE = 0.5  # of what a sensor saw must be explained by one motion: else the sensor judges none
LESS_EXPLAINED_SHARE = 0.3  # by which a motion may explain less than the best one
MIN_OTHER_WAY_M = 1.0  # m by another motion: less tells nothing

Topics = tuple[str, ...]
Read = dict[Topics, WheelReading]  # motions that were read while one was chosen, by their topics


def motion_of(log: Log, robot: Robot, topics: Sequence[str], read: Read) -> WheelReading | None:
    """Return the motion of topics; None if they cannot be read, which is reported where they are used."""
    if tuple(topics) not in read:
        with suppress(LocfuseError):
            streams = [log.stream(topic, robot.order) for topic in topics]
            read[tuple(topics)] = read_wheels(merged(streams), robot.wheels)
    return read.get(tuple(topics))


_paths: WeakKeyDictionary[Log, dict[tuple[object, ...], MatchedScans]] = WeakKeyDictionary()


def path_of(log: Log, topic: str, order: str, laser: Laser) -> MatchedScans:
    """Return the motion by the scans of a log, matched once for each place and scale of the laser.

    Raises LocfuseError if they cannot be matched.
    """
    from locfuse.fusion.wheels.motion_by_scans import match_scans  # SciPy comes with it

    known, how = _paths.setdefault(log, {}), (topic, order, *laser.mount.tolist(), *laser[1:-1])
    if how not in known:
        known[how] = match_scans(log.stream(topic, order), laser)
    return known[how]


class Evidence:
    """Judges motions by the scans of one topic, which are read for the first motion."""

    agrees = "it agrees with the scans"

    def __init__(self, log: Log, robot: Robot, laser: str, read: Read) -> None:
        self._log, self._robot, self._topic, self._read = log, robot, laser, read
        self._pairs: ScanPairs | None = None
        self._by_scans = False  # whether no other motion agrees
        self._shares: dict[Topics, float] = {}
        self._gone: dict[Topics, str] = {}

    def keep(self, candidates: Sequence[Sequence[str]]) -> list[bool]:
        """Return the motions that agree with the scans; of several that differ much, only the best."""
        known = {}
        for topics in map(tuple, candidates):
            if (motion := motion_of(self._log, self._robot, topics, self._read)) is not None:
                known[topics] = motion
        if not known:
            return [True] * len(candidates)
        if self._pairs is None:
            self._look([*known.values()])
        if self._pairs is None or not self._pairs.judge:
            return [True] * len(candidates)
        kept = [self._stays(topics, motion) for topics, motion in known.items()]
        left = [topics for topics, stays in zip(known, kept, strict=True) if stays]
        best = max((self._shares[t] for t in left), default=0.0)
        left = [t for t in left if self._shares[t] > best - ALIKE_SHARE]
        return [tuple(topics) not in known or tuple(topics) in left for topics in candidates]

    def look_at(self, speeds: Sequence[str]) -> None:
        """Score topics of speeds for the notes only: scan matching is preferred to them."""
        self._by_scans = True
        for topic in speeds[:MAX_SPEEDS]:
            motion = motion_of(self._log, self._robot, [topic], self._read)
            if motion is None or motion.wheels.stands:
                continue
            if self._pairs is None:
                self._look([motion])
            if self._pairs is not None and self._pairs.judge:
                self._gone[topic,] = f"by {topic}, speeds, {self._pairs.of(motion):.0%}"

    def behind(self, topics: Sequence[str], motion: WheelReading) -> str:
        """Return a note if scan matching fits the laser clearly better than the chosen motion, else ""."""
        self._look([motion])
        if self._pairs is None or not self._pairs.judge:
            return ""
        share = self._pairs.of(motion)
        better = self._matched >= max(share + BETTER_SHARE, self._still + TELLING_SHARE)
        if not better or self._pairs.misfit(motion) < MAX_MISFIT_SIGMAS:
            return ""
        return (
            f"by {' and '.join(topics)} {share:.1%} of a scan's points lie within 10 cm of the scan a second "
            f"before, by matching the scans {self._matched:.1%}: scan matching may be the better motion. Try "
            f"--set wheels.topic={self._topic}, or let `locfuse calibrate` find radius and track"
        )

    def why(self, topics: Sequence[str]) -> str:
        """Return the score of a kept motion against the scans, in words; "" if it was not compared."""
        share = self._shares.get(tuple(topics))
        return "" if share is None else f"{share:.0%} of a scan's points agree with it"

    @property
    def note(self) -> str:
        """Return the motions that do not agree with the scans, with numbers; "" if all agree."""
        if not self._gone:
            return ""
        return (
            f"{'; '.join(self._gone.values())} of a scan's points lie within 10 cm of the scan a second before "
            f"({self._matched:.0%} by matching the scans, {self._still:.0%} if the robot stood)"
        )

    def _stays(self, topics: Topics, motion: WheelReading) -> bool:
        assert self._pairs is not None
        share = self._shares[topics] = self._pairs.of(motion)
        stands = motion.wheels.stands
        if share >= SURE_SHARE and not stands:
            return True
        if self._matched < self._still + TELLING_SHARE:
            return True
        if stands or share < max(self._matched - WORSE_SHARE, self._still - BELOW_STILL_SHARE):
            does = "does not move: by it" if stands else "is not how the robot moved: by it"
            self._gone[topics] = f"{' and '.join(topics)} {does} {share:.0%}"
            return False
        return True

    @cached_property
    def _matched(self) -> float:
        """The share s of scan points that agree under scan matching, the best that a motion can reach."""
        assert self._pairs is not None
        if not self._by_scans:
            return self._pairs.matched()
        path = path_of(self._log, self._topic, self._robot.order, self._pairs.laser)
        return self._pairs.of_path(path.reading(WheelSettings(), 0.0))

    @cached_property
    def _still(self) -> float:
        assert self._pairs is not None
        return self._pairs.still

    def _look(self, motions: Sequence[WheelReading]) -> None:
        from locfuse.fusion.wheels.scan_agreement import scan_pairs  # SciPy comes with it

        with suppress(LocfuseError):  # scans that cannot be read are reported where they are measured
            stream = self._log.stream(self._topic, self._robot.order)
            self._pairs = scan_pairs(stream, self._laser(), motions)

    def _laser(self) -> Laser:
        """Return the laser's mount as configured, else by /tf_static."""
        stream, settings = self._log.stream(self._topic), self._robot.settings("lrf")
        placed: Mapping[str, Any] = {}
        with suppress(LocfuseError):  # frames in a loop are reported where they are used
            placed = mount_tables(transforms_of(self._log, [stream.frame_id]), {"lrf": [stream]}).get("lrf", {})
        unset = {key: placed[key] for key in PLACE if key in placed and not getattr(settings, key)}
        return laser_of(replace(settings, **unset))


class MotionSensor(NamedTuple):
    """A sensor that measures motion, and the share of its measured motion that each candidate explains."""

    name: str  # "the turning of /imu"
    shares: dict[Topics, float]  # by the topics of a motion


class MotionSensors:
    """Judges the motions of a log by the first sensor whose measurements one of them explains."""

    agrees = "it agrees best with the other sensors"

    def __init__(self, log: Log, robot: Robot, motions: Sequence[Sequence[str]], read: Read) -> None:
        self._log, self._robot, self._read = log, robot, read
        self._motions = {tuple(topics): None for topics in motions}
        self._gone: dict[Topics, None] = {}

    def keep(self, candidates: Sequence[Sequence[str]]) -> list[bool]:
        """Return the motions that explain the sensor; of several that differ much, only the best."""
        if self._found is None:
            return [True] * len(candidates)
        shares, best = self._found.shares, max(self._found.shares.values())
        kept = [shares.get(tuple(topics), best) for topics in candidates]
        least = max(best - LESS_EXPLAINED_SHARE, max(kept, default=0.0) - ALIKE_SHARE)
        self._gone |= {tuple(t): None for t, share in zip(candidates, kept, strict=True) if share < least}
        return [share >= least for share in kept]

    def why(self, topics: Sequence[str]) -> str:
        """Return the share of the sensor that a motion explains, in words; "" if no sensor judged it."""
        share = None if self._found is None else self._found.shares.get(tuple(topics))
        return "" if share is None or self._found is None else f"it explains {share:.0%} of {self._found.name}"

    @property
    def note(self) -> str:
        """Return the motions that explain less, with numbers; "" if none was left out."""
        if self._found is None or not self._gone:
            return ""
        parts = [f"{' and '.join(topics)} explains {self._found.shares[topics]:.0%}" for topics in self._gone]
        return f"{'; '.join(parts)} of {self._found.name}"

    def unjudged(self, topics: Sequence[str]) -> str:
        """Return a note on a motion that disagrees with the chosen one, if no sensor can judge them; else ""."""
        own = self._known.get(tuple(topics))
        if self._found is not None or own is None:
            return ""
        for other, motion in self._known.items():
            t = motion.wheels.t + (motion.epoch_ns - own.epoch_ns) * 1e-9
            shares = (
                turns_explained(own.wheels, t, motion.wheels.pose[:, 2]),
                ways_explained(own.wheels, t, motion.wheels.pose[:, :2], MIN_OTHER_WAY_M),
            )
            if (share := min((s for s in shares if s is not None), default=1.0)) < MIN_EXPLAINED_SHARE:
                return (
                    f"it explains {share:.0%} of the motion by {' and '.join(other)}; nothing shows which is right"
                )
        return ""

    @cached_property
    def _known(self) -> dict[Topics, WheelReading]:
        """All readable motions, if there are several."""
        read = {
            t: motion_of(self._log, self._robot, t, self._read) for t in self._motions if len(self._motions) > 1
        }
        return {topics: motion for topics, motion in read.items() if motion is not None}

    @cached_property
    def _found(self) -> MotionSensor | None:
        """The first sensor of which a motion explains enough; None without one."""
        for name, explained in self._sensors() if len(self._known) > 1 else ():
            found = {topics: explained(motion) for topics, motion in self._known.items()}
            shares = {topics: share for topics, share in found.items() if share is not None}
            if max(shares.values(), default=0.0) >= MIN_EXPLAINED_SHARE:
                return MotionSensor(name, shares)
        return None

    def _sensors(self) -> Iterator[tuple[str, Callable[[WheelReading], float | None]]]:
        """Yield the sensors that can judge motions: their name in words, and the share that a motion explains."""
        for name, kinds in TURNING.items():
            if (topic := of_sensor(self._log, self._robot, name, kinds)) is not None:
                yield f"the turning of {topic}", partial(self._turning, name, topic)
        if (topic := of_sensor(self._log, self._robot, "gps", (FIX,))) is not None:
            yield f"the way between the fixes of {topic}", partial(self._way, topic)

    def _turning(self, name: str, topic: str, motion: WheelReading) -> float | None:
        m = seen(self._log, self._robot, name, topic, motion)
        found = REGISTRY[name].heading(m) if m is not None and len(m.t) > 1 else None
        return None if found is None else turns_explained(motion.wheels, *found)

    def _way(self, topic: str, motion: WheelReading) -> float | None:
        m = seen(self._log, self._robot, "gps", topic, motion)
        return ways_explained(motion.wheels, m.t, m.z) if m is not None and len(m.t) > 1 else None


def seen(log: Log, robot: Robot, name: str, topic: str, motion: WheelReading) -> Measurements | None:
    """Return a sensor's measurements on a topic; None if it cannot be read (reported where it is used)."""
    with suppress(LocfuseError):
        stream = log.stream(topic, robot.order)
        return REGISTRY[name].measure(stream, robot.settings(name), motion.wheels, motion.epoch_ns)
    return None
