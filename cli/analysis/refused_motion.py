"""Motion topics that are not the robot's motion: commands, poses of other bodies, jumps, a constant pose.

Such a log is fused, so that the files can be inspected, but every figure is void (exit code 3).
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np

from locfuse.fusion.checks.examine import too_short
from locfuse.fusion.data import Drive, LocfuseError, Measurements
from locfuse.fusion.robot import Robot, WheelSettings
from locfuse.fusion.truth import FIX, looks_like_truth
from locfuse.fusion.wheels.odometry import SPEED, commanded
from locfuse.fusion.wheels.read import WheelReading, read_wheels

from .motion_evidence import seen
from .topics import Choice, Note, filled, of_type

if TYPE_CHECKING:
    from locfuse.formats.logs.log import Log

STANDS = "the robot does not move in this log, so no sensor can be judged"
MAX_PERIOD_S = 5.0  # of the motion's readings: in more a robot may turn round
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
        if (moved := _moved(log, topic)) > MIN_WAY_M:
            words = f"{own} never moves, but {topic} moves {moved:.1f} m"
            yield Note("wheels", words, (f"wheels.topic={topic}",), is_fault=True)
            return
    for topic in of_type(log, (FIX,)):
        if (spread := _spread(seen(log, robot, "gps", topic, motion))) > MIN_FIX_SPREAD_M:
            words = f"{own} never moves, but the fixes of {topic} lie up to {spread:.0f} m apart"
            yield Note("wheels", words, is_fault=True)
            return


def _moved(log: Log, topic: str) -> float:
    """Return the path length [m] by a topic; 0 if it cannot be read."""
    with suppress(LocfuseError):
        wheels = read_wheels(log.stream(topic), WheelSettings()).wheels
        return float(np.hypot(*np.diff(wheels.pose[:, :2], axis=0).T).sum())
    return 0.0


def _spread(fixes: Measurements | None) -> float:
    """Return the larger extent [m] of the fixes, east or north, between their 5 % and 95 % quantiles."""
    if fixes is None:
        return 0.0
    return float(np.ptp(np.percentile(fixes.z, (5.0, 95.0), axis=0), axis=0).max())
