"""One run of the filter as a tape: acceptance, matches and linearisation are fixed, only the noise changes.

Played with other noise (tune.replay), the events of the run are a linear Kalman filter on the deviations from it,
and its innovations have a likelihood (Schweppe 1965). New map lines start without knowledge, so that what they
were made from does not have to be told apart from what is measured later.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import numpy as np
from msgspec import field
from msgspec.structs import replace

from locfuse.fusion.data import Array, Drive, Ints, Measurements
from locfuse.fusion.ekf.events import Corrected, Event, Events, Moved
from locfuse.fusion.fuse import fuse
from locfuse.fusion.mount import exact
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY


class See(NamedTuple):
    """A correction by measurements with R = R_sigma + R_rest, of which R_sigma grows with the sensor's sigma^2."""

    event: Corrected
    R_sigma: Array  # (m, m) for the recorded sigma
    R_rest: Array  # (m, m)
    sensor: Ints  # (m,) index of the sensor; -1 is none's (two lines are one wall) and is not scored


class Tape(msgspec.Struct):
    """The recorded run."""

    sensors: tuple[str, ...]
    P0: Array  # (n, n)
    t: Array  # (instants,) s
    ops: list[tuple[int, Event | See]] = field(default_factory=list)  # instant, what happened there
    drifts: dict[str, tuple[Ints, Array]] = field(default_factory=dict)  # block -> columns, variance per s
    wheels: slice | None = None  # columns of the wheel parameters


def record(drive: Drive, robot: Robot, sensors: Sequence[str]) -> Tape:
    """Run the filter with these sensors and return its tape.

    Mounts are taken as configured: where one is a state it turns the R of lines, and what of R is sigma's is lost.
    """
    robot = replace(robot, sensors={name: exact(settings) for name, settings in robot.sensors.items()})
    events, names = Events(backward=False), tuple(s for s in REGISTRY if s in sensors)
    fuse(drive, robot, sensors, events=events)
    assert events.start is not None
    tape = Tape(names, events.start.P, drive.t, drifts=events.drifts, wheels=events.wheels)
    instant = -1
    for event in events.list:
        instant += isinstance(event, Moved)
        op = see(event, drive, names) if isinstance(event, Corrected) else event
        tape.ops.append((max(instant, 0), op))
    return tape


def see(event: Corrected, drive: Drive, names: Sequence[str]) -> See:
    """Return which part of a correction's R grows with the sigma of which sensor."""
    R_sigma, sensor, k = np.zeros_like(event.R), np.full(len(event.y), -1), 0
    for name, row, numbers in event.sources:
        at = slice(k, k + numbers)
        if row >= 0:
            sensor[at] = names.index(name)
            R_sigma[at, at] = _of_sigma(event.R[at, at], drive.measurements[name], row)
        k = at.stop
    return See(event, R_sigma, event.R - R_sigma, sensor)


def _of_sigma(R: Array, m: Measurements, row: int) -> Array:
    """Return the part (d, d) of an innovation's R that grows with the sensor's sigma^2."""
    part = of_sigma(m, row)
    if not (np.diagonal(R) >= 0.999 * np.diagonal(part)).all():
        return R  # a model that weighs by less than R: all of it is its sigma's
    if len(R) == 2 and R[0, 1] * m.covariances(slice(row, row + 1))[0, 0, 1] < 0.0:
        part = part * np.array(((1.0, -1.0), (-1.0, 1.0)))  # the line was read as (-r, psi + pi)
    return part


def of_sigma(m: Measurements, row: int) -> Array:
    """Return the part (d, d) of a measurement's R that grows with the sensor's sigma^2: all but floor and rest."""
    R: Array = m.scale**2 * m.R_unit[row]
    rest = m.extra.get("rest")
    return R if rest is None else R - rest[row] * np.eye(len(R))
