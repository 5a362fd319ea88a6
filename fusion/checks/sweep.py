"""Sweep check: whether the laser measures its beams in the order given by its driver.

Deskewing with `time_increment` and the wheels corrects a scan for the robot's turn. With the wrong order of beams
it doubles the error, and a wall seen in a turn has another direction than the same wall a second later. This
happens if a driver reverses the ranges but leaves time_increment positive.
"""

from __future__ import annotations

import math
from typing import cast

import numpy as np
from msgspec.structs import replace

from locfuse.fusion.chi_square import MAD_OF_NORMAL
from locfuse.fusion.data import Array, Drive, Measurements, Stream
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.lrf import Lrf, LrfSettings
from locfuse.fusion.wheels.motion import Wheels

from .finding import Finding
from .laser import MAX_WALL_TURN_RAD, seen_twice

MIN_RATE_RADPS = 0.3  # rad/s between the turn rates of two scans: equal smear shows nothing
MIN_PAIRS = 60  # walls seen at such different turn rates
MAX_MISFIT_RATIO = 0.65  # of the misfit in the other order over the one as configured
RATE_STEP_S = 0.1  # s over which the turn rate is taken
ORDERS = {"forward": "backward", "backward": "forward"}


def of_sweep(stream: Stream, drive: Drive, robot: Robot, t: Array) -> list[Finding]:
    """Return a finding if walls seen while turning fit clearly better in the reverse order of the beams.

    `t` (n,) [s] are the times of the measured scans on the wheels' clock.
    """
    settings, m = cast("LrfSettings", robot.settings("lrf")), drive.measurements["lrf"]
    increment = np.asarray(stream.columns("time_increment")["time_increment"])
    if not settings.deskew or not len(t) or not increment.any():
        return []
    settings = replace(settings, time_offset=settings.time_offset + float(np.median(t - m.t)))
    other = ORDERS[settings.sweep]
    now = _misfit(stream, drive, settings)
    then = None if now is None else _misfit(stream, drive, replace(settings, sweep=other))
    if now is None or then is None or then > MAX_MISFIT_RATIO * now:
        return []
    first = "last" if other == "backward" else "first"
    words = (
        f"the directions of walls seen in turns are wrong by {math.degrees(now):.1f}°, but by "
        f"{math.degrees(then):.1f}° if each scan begins with its {first} beam: it sweeps {other}"
    )
    return [Finding("lrf", "sweep", words, (f"lrf.sweep={other}",), True)]


def _misfit(stream: Stream, drive: Drive, settings: LrfSettings) -> float | None:
    """Return the median difference [rad] of wall directions seen at different turn rates; None for few walls.

    The effect of a slightly wrong clock, proportional to the difference of the rates, is subtracted.
    """
    m: Measurements = Lrf().measure(stream, settings, drive.wheels, drive.epoch_ns)
    walls = seen_twice(m, m.t, drive, np.array([settings.x, settings.y]))
    rate = _rate(drive.wheels, walls.t) - _rate(drive.wheels, walls.since)
    off = walls.turn - walls.by_wheels
    use = (np.abs(rate) > MIN_RATE_RADPS) & (np.abs(off) < MAX_WALL_TURN_RAD)
    for _ in range(3):
        if use.sum() < MIN_PAIRS:
            return None
        late = float(rate[use] @ off[use]) / float(rate[use] @ rate[use])
        rest = np.abs(off - late * rate)
        misfit = float(np.median(rest[use]))
        use &= rest < 3.0 / MAD_OF_NORMAL * misfit
    return misfit


def _rate(wheels: Wheels, t: Array) -> Array:
    """Return the wheels' turn rates [rad/s] at t (k,) [s]."""
    begin, end = (np.clip(t + s, wheels.t[0], wheels.t[-1]) for s in (-0.5 * RATE_STEP_S, 0.5 * RATE_STEP_S))
    return (wheels.heading(end) - wheels.heading(begin)) / RATE_STEP_S
