"""Agreement of motion topics with other sensors (laser, else gyro, compass or GPS); faults of the chosen motion.

With a laser a measured motion is kept if about as many scan points agree as by scan matching (limits of this test:
`fusion.wheels.scan_agreement`). If scans cannot distinguish motions, all are kept and the topic's type decides.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from functools import cached_property
from itertools import islice
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

import numpy as np
from msgspec.structs import replace

from locfuse.formats.logs.log import Log
from locfuse.fusion.checks.examine import too_short
from locfuse.fusion.data import Drive, LocfuseError, Measurements
from locfuse.fusion.lines.points import SCANS_PER_BLOCK, understood
from locfuse.fusion.lines.scans import Laser, equal_scans
from locfuse.fusion.robot import Robot, WheelSettings
from locfuse.fusion.sensors.lrf import Lrf, laser_of
from locfuse.fusion.sensors.magnetic import FIELD, IMU
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.streams import merged, recorded_apart
from locfuse.fusion.truth import FIX, looks_like_truth
from locfuse.fusion.wheels.motion import Wheels, distances_explained, turns_explained
from locfuse.fusion.wheels.motion_by_scans import MatchedScans, match_scans
from locfuse.fusion.wheels.odometry import SPEED, commanded
from locfuse.fusion.wheels.read import WheelReading, read_wheels

from .mounts import mount_tables, transforms_of
from .topics import Choice, Note, filled, of_sensor, of_type

if TYPE_CHECKING:
    from locfuse.fusion.wheels.scan_agreement import ScanPairs

MAX_SPEEDS = 2  # topics of commanded or measured speeds that are scored beside scan matching
MOUNT_KEYS = ("x", "y", "yaw_deg", "flipped")  # of a laser on the base
# shares of scan points that agree
UNITS = {"cm": 0.01, "mm": 0.001}  # of distances, m
SURE_SHARE = 0.9  # a motion with a larger share is accepted without scan matching
WORSE_SHARE = 0.10  # largest loss of a motion against scan matching
BELOW_STILL_SHARE = 0.05  # largest loss of a motion against standing still
BETTER_SHARE = 0.015  # least gain of scan matching over wheels of known size for a note ...
MAX_MISFIT_SIGMAS = 2.0  # ... that also needs turns of the wheels that differ by more than their noise
UNDERSTOOD_BLOCKS = 12  # blocks of scans that show which beams see the robot itself
TELLING_SHARE = 0.03  # least gain of scan matching over standing still; with less the scans judge no motion
ALIKE_SHARE = 0.10  # least difference between two motions of one kind; with less none is preferred

# --- without a laser
JUDGING_TYPES = {"gyro": (IMU,), "compass": (IMU, FIELD), "gps": (FIX,)}  # sensor -> message types that judge
MIN_EXPLAINED_SHARE = 0.5  # least share that the best topic explains of a sensor; with less the sensor is not used
LESS_EXPLAINED_SHARE = 0.3  # largest loss of a motion against the best one
MIN_OTHER_WAY_M = 1.0  # least distance travelled by another motion, to be compared

Topics = tuple[str, ...]
Read = dict[Topics, WheelReading]  # motions read during the choice, by their topics


def motion_of(log: Log, robot: Robot, topics: Topics, read: Read) -> WheelReading | None:
    """Return the motion of topics; None if they cannot be read (reported where the topics are used)."""
    if topics not in read:
        with suppress(LocfuseError):
            read[topics] = read_wheels(merged([log.stream(t, robot.order) for t in topics]), robot.wheels)
    return read.get(topics)


_matched_scans: WeakKeyDictionary[Log, dict[tuple[object, ...], MatchedScans]] = WeakKeyDictionary()


def path_of(log: Log, topic: str, order: str, laser: Laser) -> MatchedScans:
    """Return the motion by scan matching; scans are matched once per mount and range scale of the laser.

    Raises LocfuseError if they cannot be matched.
    """
    known, how = _matched_scans.setdefault(log, {}), (topic, order, *laser.mount.tolist(), *laser[1:-1])
    if how not in known:
        known[how] = match_scans(log.stream(topic, order), laser)
    return known[how]


class MotionEvidence:
    """Judges motion topics by the scans of one laser topic; scans are read when the first motion is judged."""

    agrees = "it agrees with the scans"

    def __init__(self, log: Log, robot: Robot, laser: str, read: Read) -> None:
        self._log, self._robot, self._topic, self._read = log, robot, laser, read
        self._pairs: ScanPairs | None = None
        self._by_scans = False  # scan matching gives the motion
        self._shares: dict[Topics, float] = {}
        self._rejected: dict[Topics, str] = {}  # with the reason

    def keep(self, candidates: Sequence[Topics]) -> list[Topics]:
        """Return the motions that agree with the scans about as well as the best, or that cannot be judged."""
        read = {topics: self._motion(topics) for topics in candidates}
        known = {topics: motion for topics, motion in read.items() if motion is not None}
        if not known or self._judging([*known.values()]) is None:
            return [*candidates]
        left = [topics for topics, motion in known.items() if self._agrees(topics, motion)]
        best = max((self._shares[t] for t in left), default=0.0)
        left = [t for t in left if self._shares[t] > best - ALIKE_SHARE]
        return [topics for topics in candidates if topics not in known or topics in left]

    def look_at(self, speeds: Sequence[str]) -> None:
        """Compare topics of speeds with the scans, only for the notes: scan matching is preferred to them."""
        self._by_scans = True
        for topic in speeds[:MAX_SPEEDS]:
            motion = self._motion((topic,))
            if motion and not motion.wheels.stands and (pairs := self._judging([motion])) is not None:
                self._rejected[topic,] = f"by {topic}, speeds, {pairs.of(motion):.0%}"

    def behind(self, topics: Topics, motion: WheelReading) -> str:
        """Return a note if scan matching fits the laser clearly better than the chosen motion, else ""."""
        motion = self._on_laser_clock(topics, motion)
        if (pairs := self._judging([motion])) is None:
            return ""
        share = pairs.of(motion)
        better = self._matched >= max(share + BETTER_SHARE, pairs.still + TELLING_SHARE)
        if not better or pairs.misfit(motion) < MAX_MISFIT_SIGMAS:
            return ""
        return (
            f"by {' and '.join(topics)} {share:.1%} of a scan's points lie within 10 cm of the scan a second "
            f"before, by matching the scans {self._matched:.1%}: scan matching may be the better motion. Try "
            f"--set wheels.topic={self._topic}, or let `locfuse calibrate` find radius and track"
        )

    def why(self, topics: Topics) -> str:
        """Return the share of scan points that agree with a chosen motion, in words; "" if it was not compared."""
        share = self._shares.get(topics)
        return "" if share is None else f"{share:.0%} of a scan's points agree with it"

    @property
    def note(self) -> str:
        """Return a sentence on the motions that do not agree with the scans; "" if all agree."""
        if self._pairs is None or not self._rejected:
            return ""
        return (
            f"{'; '.join(self._rejected.values())} of a scan's points lie within 10 cm of the scan a second "
            f"before ({self._matched:.0%} by matching the scans, {self._pairs.still:.0%} if the robot stood)"
        )

    def _motion(self, topics: Topics) -> WheelReading | None:
        motion = motion_of(self._log, self._robot, topics, self._read)
        return None if motion is None else self._on_laser_clock(topics, motion)

    def _on_laser_clock(self, topics: Topics, motion: WheelReading) -> WheelReading:
        """Return a motion on the laser's clock, if that is another one by recording times."""
        own, laser = (self._log.stream(topic, self._robot.order) for topic in (topics[0], self._topic))
        apart = recorded_apart(own, laser) or 0.0
        return motion._replace(epoch_ns=motion.epoch_ns + round(apart * 1e9))

    def _agrees(self, topics: Topics, motion: WheelReading) -> bool:
        assert self._pairs is not None
        share = self._shares[topics] = self._pairs.of(motion)
        stands = motion.wheels.stands
        if (share >= SURE_SHARE and not stands) or self._matched < self._pairs.still + TELLING_SHARE:
            return True
        if stands or share < max(self._matched - WORSE_SHARE, self._pairs.still - BELOW_STILL_SHARE):
            does = "does not move: by it" if stands else "is not how the robot moved: by it"
            unit = "" if stands else self._unit(motion, share)
            self._rejected[topics] = f"{' and '.join(topics)}{unit} {does} {share:.0%}"
            return False
        return True

    def _unit(self, motion: WheelReading, share: float) -> str:
        """Return in words how the scans agree with a motion: in cm or mm, or its numbers exchanged; else ""."""
        assert self._pairs is not None
        wheels, least = motion.wheels, max(self._matched - WORSE_SHARE, share + TELLING_SHARE)
        ways = {
            f", in {unit} as it seems (--set wheels.scale={metres:g}),": wheels.twist * [metres, metres, 1.0]
            for unit, metres in UNITS.items()
        }
        ways[", whose forward speed and turning rate look exchanged,"] = wheels.twist[:, ::-1]
        for words, twist in ways.items():
            other = motion._replace(wheels=Wheels.from_twists(wheels.t, twist, wheels.track, wheels.noise))
            if self._pairs.of(other) > least:
                return words
        return ""

    @cached_property
    def _matched(self) -> float:
        """The share of scan points that agree if the motion is by scan matching: the largest possible share."""
        assert self._pairs is not None
        if not self._by_scans:
            return self._pairs.matched()
        path = path_of(self._log, self._topic, self._robot.order, self._pairs.laser)
        return self._pairs.of_path(path.reading(WheelSettings(), 0.0))

    def _judging(self, motions: Sequence[WheelReading]) -> ScanPairs | None:
        """Return the scan pairs, chosen by the first `motions` and then kept; None if they cannot judge."""
        if self._pairs is None:
            from locfuse.fusion.wheels.scan_agreement import scan_pairs

            with suppress(LocfuseError):  # scans that cannot be read are reported where they are measured
                stream = self._log.stream(self._topic, self._robot.order)
                self._pairs = scan_pairs(stream, self._laser(), motions)
        return self._pairs if self._pairs is not None and self._pairs.judge else None

    def _laser(self) -> Laser:
        """Return the laser with its mount as configured, else by /tf_static."""
        stream, settings = self._log.stream(self._topic), self._robot.settings("lrf")
        placed: Mapping[str, Any] = {}
        with suppress(LocfuseError):  # frames in a loop and far mounts are reported where they are used
            frames = transforms_of(self._log, [stream.frame_id])
            placed = mount_tables(frames, {"lrf": [stream]}, {}).get("lrf", {})
        unset = {key: placed[key] for key in MOUNT_KEYS if key in placed and not getattr(settings, key)}
        laser = laser_of(replace(settings, **unset))
        blocks = stream.blocks(*Lrf.reads[stream.msgtype], rows=SCANS_PER_BLOCK)
        first = islice((columns for _, columns in blocks), UNDERSTOOD_BLOCKS)
        return understood(laser, (scans for columns in first for _, scans in equal_scans(columns)))


class MotionSensors:
    """Judges motion topics by the first sensor whose measurements at least one of the topics explains."""

    agrees = "it agrees best with the other sensors"

    def __init__(self, log: Log, robot: Robot, motions: Sequence[Topics], read: Read) -> None:
        self._log, self._robot, self._read = log, robot, read
        self._motions = list(dict.fromkeys(motions))
        self._rejected: dict[Topics, float] = {}  # with the share that each explains

    def keep(self, candidates: Sequence[Topics]) -> list[Topics]:
        """Return the motions that explain the sensor about as well as the best, or that cannot be judged."""
        _, shares = self._sensor
        best = max(shares.values(), default=0.0)
        known = {topics: shares.get(topics, best) for topics in candidates}
        least = max(best - LESS_EXPLAINED_SHARE, max(known.values(), default=0.0) - ALIKE_SHARE)
        self._rejected |= {topics: share for topics, share in known.items() if share < least}
        return [topics for topics, share in known.items() if share >= least]

    def why(self, topics: Topics) -> str:
        """Return the share of the sensor's measurements that a motion explains, in words; "" without a sensor."""
        name, shares = self._sensor
        return f"it explains {shares[topics]:.0%} of {name}" if topics in shares else ""

    @property
    def note(self) -> str:
        """Return a sentence on the rejected motions: the shares that they explain; "" if none is rejected."""
        parts = [f"{' and '.join(topics)} explains {share:.0%}" for topics, share in self._rejected.items()]
        return f"{'; '.join(parts)} of {self._sensor[0]}" if parts else ""

    def unjudged(self, topics: Topics) -> str:
        """Return a note if another motion disagrees and no sensor can judge the two; else ""."""
        own = self._readable.get(topics)
        if self._sensor[0] or own is None:
            return ""
        for other, motion in self._readable.items():
            t = motion.wheels.t + (motion.epoch_ns - own.epoch_ns) * 1e-9
            shares = (
                turns_explained(own.wheels, t, motion.wheels.pose[:, 2]),
                distances_explained(own.wheels, t, motion.wheels.pose[:, :2], MIN_OTHER_WAY_M),
            )
            if (share := min((s for s in shares if s is not None), default=1.0)) < MIN_EXPLAINED_SHARE:
                whose = " and ".join(other)
                return f"it explains {share:.0%} of the motion by {whose}; nothing shows which is right"
        return ""

    @cached_property
    def _readable(self) -> dict[Topics, WheelReading]:
        """Readable motions by their topics; {} if the log has only one candidate."""
        several = self._motions if len(self._motions) > 1 else ()
        read = {t: motion_of(self._log, self._robot, t, self._read) for t in several}
        return {topics: motion for topics, motion in read.items() if motion is not None}

    @cached_property
    def _sensor(self) -> tuple[str, dict[Topics, float]]:
        """The first sensor of which a motion explains at least MIN_EXPLAINED_SHARE, and what each motion explains.

        Such as ("the turning of /imu", {("/odom",): 0.98}); ("", {}) without such a sensor.
        """
        for name, kinds in JUDGING_TYPES.items() if len(self._readable) > 1 else ():
            if (topic := of_sensor(self._log, self._robot, name, kinds)) is None:
                continue
            found = {topics: self._explained(name, topic, motion) for topics, motion in self._readable.items()}
            shares = {topics: share for topics, share in found.items() if share is not None}
            if max(shares.values(), default=0.0) >= MIN_EXPLAINED_SHARE:
                what = "the way between the fixes" if name == "gps" else "the turning"
                return f"{what} of {topic}", shares
        return "", {}

    def _explained(self, name: str, topic: str, motion: WheelReading) -> float | None:
        """Return the share of a sensor's measurements that a motion explains; None if they cannot judge it."""
        m = seen(self._log, self._robot, name, topic, motion)
        if m is None or len(m.t) < 2:
            return None
        if name == "gps":
            return distances_explained(motion.wheels, m.t, m.z)
        found = REGISTRY[name].heading(m)
        return None if found is None else turns_explained(motion.wheels, *found)


def seen(log: Log, robot: Robot, name: str, topic: str, motion: WheelReading) -> Measurements | None:
    """Return a sensor's measurements on a topic; None if it cannot be read (reported where the sensor is used)."""
    with suppress(LocfuseError):
        stream = log.stream(topic, robot.order)
        return REGISTRY[name].measure(stream, robot.settings(name), motion.wheels, motion.epoch_ns)
    return None


# --- The chosen motion may not be the robot's: commands, poses of other bodies, jumps, a constant pose. Such a log
# is fused, so that the files can be inspected, but every figure is void (not valid; exit code 3).

STANDS = "the robot does not move in this log, so no sensor can be judged"
MAX_PERIOD_S = 5.0  # longest time between readings of the motion: in more a robot may turn unseen
MIN_WAY_M = 1.0  # path length by another topic that counts as motion
MIN_FIX_SPREAD_M = 15.0  # fixes of a standing receiver drift by some metres


def unjudged(drive: Drive) -> str:
    """Return why a drive judges no sensor (the robot stands, or the drive is short), else ""."""
    return STANDS if drive.wheels.stands else too_short(drive)


def find_motion_faults(log: Log, robot: Robot, choice: Choice, motion: WheelReading) -> tuple[Note, ...]:
    """Return the reasons why the chosen motion is not the robot's; () without one."""
    found = [note for note in choice.notes if note.is_fault]
    topics = " and ".join(choice.of("wheels"))
    if motion.doubt:
        found.append(Note("wheels", f"{topics}: {motion.doubt}", (), is_fault=True))
    t = motion.wheels.t
    if float(period := np.median(np.diff(t))) > MAX_PERIOD_S:
        words = f"{topics}: {len(t)} readings in {t[-1] - t[0]:.1f} s, one each {period:.1f} s"
        why = "the way in between is unknown. Record at least one each second"
        found.append(Note("wheels", f"{words}: {why}", (), is_fault=True))
    return (*found, *_standing(log, robot, choice, motion))


def _standing(log: Log, robot: Robot, choice: Choice, motion: WheelReading) -> Iterator[Note]:
    """Yield a note if the chosen motion is constant while another topic moves."""
    if not motion.wheels.stands:
        return
    own = " and ".join(choice.of("wheels"))
    for topic in filled(log, *SPEED):
        kind = log.topics[topic].msgtype
        if topic in choice.of("wheels") or commanded(topic, kind) or looks_like_truth(topic):
            continue
        other = motion_of(log, robot, (topic,), {})
        moved = 0.0 if other is None else float(np.hypot(*np.diff(other.wheels.pose[:, :2], axis=0).T).sum())
        if moved > MIN_WAY_M:
            words = f"{own} never moves, but {topic} moves {moved:.1f} m"
            yield Note("wheels", words, (f"wheels.topic={topic}",), is_fault=True)
            return
    for topic in of_type(log, (FIX,)):
        fixes = seen(log, robot, "gps", topic, motion)
        between = (0.0, 0.0) if fixes is None else np.percentile(fixes.z, (5.0, 95.0), axis=0)
        if (spread := float(np.max(np.ptp(between, axis=0)))) > MIN_FIX_SPREAD_M:
            words = f"{own} never moves, but the fixes of {topic} lie up to {spread:.0f} m apart"
            yield Note("wheels", words, is_fault=True)
            return
