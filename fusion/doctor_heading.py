"""A heading that comes as a bare number: in which unit, and which way round does it grow?"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import cast

import msgspec
import numpy as np

from locfuse.fusion.sensors.compass import from_number

from .data import Array, Drive, Stream
from .doctor_turning import explain
from .oddity import Oddity
from .robot import Robot

MOST_RADIANS = 4.0 * math.pi  # a heading beyond two turns is in degrees


def of_convention(drive: Drive, robot: Robot, streams: Mapping[str, Stream]) -> list[Oddity]:
    """Return the convention under which a heading that could not be read turns as the wheels do."""
    stream = streams.get("compass")
    if stream is None or "compass" in drive.measurements or not stream.msgtype.startswith("std_msgs/"):
        return []
    columns = {"data": np.asarray(cast("Array", stream.columns("data")["data"]), dtype=np.float64)}
    largest = np.nanmax(np.abs(np.where(np.isfinite(columns["data"]), columns["data"], 0.0)), initial=0.0)
    unit = "deg" if largest > MOST_RADIANS else "rad"
    settings = msgspec.structs.replace(robot.settings("compass"), convention=f"enu_{unit}")
    heading, _ = from_number(columns, settings, stream.topic)
    good = np.isfinite(heading)
    t = (stream.t_ns - drive.epoch_ns) * 1e-9 + settings.time_offset
    turning = explain(t[good], np.unwrap(heading[good]), drive.wheels, np.zeros(int(good.sum())))
    if turning is None:
        return []
    clockwise = turning.a < 0.0 < turning.b
    sense = "clockwise (0 is north)" if clockwise else "counter-clockwise (0 is east)"
    whole = "degrees" if unit == "deg" else "radians"
    words = f"{stream.topic} reaches {largest:.0f}, so it is in {whole}, and by the wheels it grows {sense}"
    cure = f"compass.convention={'compass' if clockwise else 'enu'}_{unit}"
    return [Oddity("convention", "compass", words, (cure,), True)]
