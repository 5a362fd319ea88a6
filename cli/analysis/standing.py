"""An odometry that stands still although the robot drives: other topics of the log say so."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, cast

import numpy as np

from locfuse.fusion.data import Array, LocfuseError
from locfuse.fusion.geodesy import east_north
from locfuse.fusion.robot import WheelSettings
from locfuse.fusion.truth import looks_like_truth
from locfuse.fusion.wheels.motion import Wheels
from locfuse.fusion.wheels.odometry import SPEED, commanded
from locfuse.fusion.wheels.read import read_wheels

from .topics import Choice, of_type

if TYPE_CHECKING:
    from locfuse.formats.logs.log import Log

STANDS = "the robot does not move in this log, so no sensor can be judged"
MIN_WAY_M = 1.0  # m by another topic: more is one
MIN_FIX_SPREAD_M = 15.0  # m: a standing receiver's fixes wander by some metres
FIX = "sensor_msgs/msg/NavSatFix"


def refuse_standing(log: Log, choice: Choice, wheels: Wheels) -> None:
    """Raise LocfuseError where the wheels' topic never moves while another topic does."""
    if not wheels.stands:
        return
    own = " and ".join(choice.of("wheels"))
    taken = set(choice.of("wheels"))
    for topic in of_type(log, SPEED):
        if (
            topic in taken
            or commanded(topic, log.topics[topic].msgtype)
            or looks_like_truth(topic)
            or not log.topics[topic].count
        ):
            continue
        if (moved := _moved(log, topic)) > MIN_WAY_M:
            fix = f"wheels.topic={topic}"
            words = f"{own} never moves, but {topic} moves {moved:.1f} m."
            raise LocfuseError(words, role="wheels", fixes=(fix,), hint=f"Use that: --set {fix}")
    for topic in of_type(log, (FIX,)):
        if (spread := _spread(log, topic)) > MIN_FIX_SPREAD_M:
            words = f"{own} never moves, but the fixes of {topic} lie up to {spread:.0f} m apart."
            raise LocfuseError(words, role="wheels", hint="Name a topic that moves: --set wheels.topic=<topic>")


def standing_notes(wheels: Wheels) -> tuple[str, ...]:
    """Say that the robot does not move."""
    return (f"wheels: {STANDS}",) if wheels.stands else ()


def _moved(log: Log, topic: str) -> float:
    """Return how far a topic says that the body moved [m], 0 where it cannot be read."""
    with suppress(LocfuseError):
        return way(read_wheels(log.stream(topic), WheelSettings()).wheels)
    return 0.0


def way(wheels: Wheels) -> float:
    """Return how far the body moved in all [m]."""
    return float(np.hypot(*np.diff(wheels.pose[:, :2], axis=0).T).sum())


def _spread(log: Log, topic: str) -> float:
    """Return the greatest extent of a receiver's fixes along east or north [m], outliers left out."""
    columns = cast("dict[str, Array]", log.stream(topic).columns("latitude", "longitude"))
    where = np.stack([columns["latitude"], columns["longitude"]], axis=-1)
    where = where[np.isfinite(where).all(axis=1)]
    if len(where) < 2:
        return 0.0
    xy = east_north(where[:, 0], where[:, 1], (float(where[0, 0]), float(where[0, 1])))
    return float(np.ptp(np.percentile(xy, (5.0, 95.0), axis=0), axis=0).max())
