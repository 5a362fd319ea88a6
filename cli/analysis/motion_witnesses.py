"""Without a laser: which of several odometries agrees best with the gyro, the GPS fixes or the compass?"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import cached_property, partial
from typing import TYPE_CHECKING, NamedTuple

from locfuse.fusion.data import LocfuseError, Measurements
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.wheels.motion import turns_explained, ways_explained
from locfuse.fusion.wheels.read import WheelReading

from .motion_evidence import Read, motion_of
from .topics import of_sensor

if TYPE_CHECKING:
    from locfuse.formats.logs.log import Log

FIX = "sensor_msgs/msg/NavSatFix"
TURNING = {"gyro": ("sensor_msgs/msg/Imu",), "compass": ("sensor_msgs/msg/Imu", "sensor_msgs/msg/MagneticField")}
Topics = tuple[str, ...]
TELLING_SHARE = 0.5  # of what a sensor saw must be explained by one motion: else the sensor judges none
WORSE_SHARE = 0.3  # by which a motion may explain less than the best one
MIN_OTHER_WAY_M = 1.0  # m by another motion: less tells nothing
ALIKE_SHARE = 0.1  # by which two motions of one kind must differ: else neither is chosen


class Witness(NamedTuple):
    """A sensor that measures the robot's motion, and the share of it that each motion explains."""

    name: str  # "the turning of /imu"
    shares: dict[Topics, float]  # by the topics of a motion


class Witnesses:
    """Judges all motions of a log by the first sensor that one of them explains."""

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
        least = max(best - WORSE_SHARE, max(kept, default=0.0) - ALIKE_SHARE)
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
        """Return another motion that disagrees with the chosen one, if no sensor judges them; else ""."""
        own = self._known.get(tuple(topics))
        if self._found is not None or own is None:
            return ""
        for other, motion in self._known.items():
            t = motion.wheels.t + (motion.epoch_ns - own.epoch_ns) * 1e-9
            shares = (
                turns_explained(own.wheels, t, motion.wheels.pose[:, 2]),
                ways_explained(own.wheels, t, motion.wheels.pose[:, :2], MIN_OTHER_WAY_M),
            )
            if (share := min((s for s in shares if s is not None), default=1.0)) < TELLING_SHARE:
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
    def _found(self) -> Witness | None:
        """The first sensor of which a motion explains enough; None without one."""
        for name, explained in self._sensors() if len(self._known) > 1 else ():
            found = {topics: explained(motion) for topics, motion in self._known.items()}
            shares = {topics: share for topics, share in found.items() if share is not None}
            if max(shares.values(), default=0.0) >= TELLING_SHARE:
                return Witness(name, shares)
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
    """Return what a sensor measures on a topic; None if it cannot be read, which is reported at its use."""
    with suppress(LocfuseError):
        stream = log.stream(topic, robot.order)
        return REGISTRY[name].measure(stream, robot.settings(name), motion.wheels, motion.epoch_ns)
    return None
