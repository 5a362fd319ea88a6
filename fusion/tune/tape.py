"""One run of the filter as a tape: acceptance, matches and linearisation are fixed, only the noise changes.

Played with other noise, the events of the run are a linear Kalman filter on the deviations from it, and its
innovations have a likelihood (Schweppe 1965). New map lines start without knowledge, so that what they were made
from needs no other treatment than what is measured later. Many sets of noise are played at once along a
leading axis: NumPy's call overhead is most of the cost (27 filters take three times as long as one).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import msgspec
import numpy as np
from msgspec import field
from msgspec.structs import replace

from locfuse.fusion.data import Array, Drive, Ints, Measurements
from locfuse.fusion.ekf.equations import eq10_12
from locfuse.fusion.ekf.events import (
    Added,
    Changed,
    Corrected,
    Dropped,
    Event,
    Events,
    FrameTurned,
    Loosened,
    Moved,
)
from locfuse.fusion.fuse import fuse
from locfuse.fusion.mount import exact
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY

UNKNOWN_VARIANCE = 100.0  # variance of a new map line [m^2, rad^2]: nothing is known


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
    """Return the part (d, d) of an innovation's R that grows with the sensor's sigma^2: all but floor and rest."""
    part: Array = m.scale**2 * m.R_unit[row]
    rest = m.extra.get("rest")
    if rest is not None:
        part = part - rest[row] * np.eye(len(part))
    if not (np.diagonal(R) >= 0.999 * np.diagonal(part)).all():
        return R  # a model that weighs by less than R: all of it is its sigma's
    if len(R) == 2 and R[0, 1] * m.covariances(slice(row, row + 1))[0, 0, 1] < 0.0:
        part = part * np.array(((1.0, -1.0), (-1.0, 1.0)))  # the line was read as (-r, psi + pi)
    return part


class Noise(NamedTuple):
    """B sets of noise, as factors on the recorded variances."""

    wheels: Array  # (B,)
    sensors: Array  # (B, number of sensors)
    drifts: Mapping[str, Array]  # block -> (B,)
    turns: Array | None = None  # (B,) on the wheels' noise while turning, instead of `wheels`


class Played(NamedTuple):
    """The likelihood of c corrections under B sets of noise."""

    scores: Array  # (B, c) log likelihood [nats]
    instant: Ints  # (c,)
    numbers: Ints  # (c,) measured numbers that were scored


def play(tape: Tape, noise: Noise, bend: float = 0.0, until: float = math.inf) -> Played:
    """Play the tape under B sets of noise up to the time `until` [s].

    Where `noise.turns` is given it holds for motions whose path bends by more than `bend` [1/m].
    """
    head = Head(tape, noise, bend)
    end = int(np.searchsorted(tape.t, until))
    scores, instants, numbers = [np.zeros((len(noise.wheels), 0))], [], []
    for instant, op in tape.ops:
        if isinstance(op, Moved):
            if instant >= end:
                break
            head.move(instant, op)
        elif isinstance(op, See):
            scores.append(head.see(op)[:, None])
            instants.append(instant)
            numbers.append(int((op.sensor >= 0).sum()))
        elif isinstance(op, Loosened):
            head.P[:, op.columns, op.columns] += op.variance
        elif isinstance(op, FrameTurned):
            head.turn_frame(op)
        elif isinstance(op, Added):
            head.add(op)
        elif isinstance(op, Dropped):
            head.m = np.delete(head.m, op.columns, axis=1)
            head.P = np.delete(np.delete(head.P, op.columns, axis=1), op.columns, axis=2)
        elif isinstance(op, Changed):
            head.change(op)
    return Played(np.concatenate(scores, axis=1), np.array(instants, np.int64), np.array(numbers, np.int64))


class Head:
    """B Kalman filters on the deviation from the recorded run."""

    def __init__(self, tape: Tape, noise: Noise, bend: float) -> None:
        B = len(noise.wheels)
        self.tape, self.noise, self.bend = tape, noise, bend
        self.scale = np.concatenate((np.sqrt(noise.sensors), np.ones((B, 1))), axis=1)  # the last: no sensor
        self.P = np.tile(tape.P0, (B, 1, 1))
        self.m = np.zeros((B, len(tape.P0)))

    def move(self, instant: int, op: Moved) -> None:
        """Predict: eq. 5-7, where A = I + the lever terms of eq. 7 acts on the deviation."""
        P, m = self.P, self.m
        a, b = op.start[1] - op.end[1], op.end[0] - op.start[0]
        m[:, 0] += a * m[:, 2]
        m[:, 1] += b * m[:, 2]
        row = P[:, 2, :].copy()
        P[:, 0, :] += a * row
        P[:, 1, :] += b * row
        column = P[:, :, 2].copy()
        P[:, :, 0] += a * column
        P[:, :, 1] += b * column
        if op.coupling is not None and self.tape.wheels is not None:
            w = self.tape.wheels
            m[:, :3] += m[:, w] @ op.coupling.T
            P[:, :3, :] += op.coupling @ P[:, w, :]
            P[:, :, :3] += P[:, :, w] @ op.coupling.T
        turns = self.noise.turns
        factor = turns if turns is not None and bends(op, self.bend) else self.noise.wheels
        P[:, :3, :3] += factor[:, None, None] * op.Q
        dt = float(self.tape.t[instant] - self.tape.t[max(instant - 1, 0)])
        for name, (columns, drift) in self.tape.drifts.items():
            P[:, columns, columns] += np.outer(self.noise.drifts.get(name, np.ones(len(P))), drift * dt)

    def see(self, op: See) -> Array:
        """Correct (eq. 10-12); return the log likelihood of what sensors measured, (B,)."""
        P, m, seen = self.P, self.m, op.event
        scale = self.scale[:, op.sensor]
        PH = P[:, :, seen.columns] @ seen.H.T
        S = seen.H @ PH[:, seen.columns, :] + scale[:, :, None] * scale[:, None, :] * op.R_sigma + op.R_rest
        V, w, L = eq10_12(PH, S, seen.y - m[:, seen.columns] @ seen.H.T)
        P -= V.transpose(0, 2, 1) @ V
        m += (w[:, None, :] @ V)[:, 0, :] - seen.step
        terms = -0.5 * w**2 - np.log(np.diagonal(L, axis1=1, axis2=2)) - 0.5 * math.log(2.0 * math.pi)
        score: Array = terms[:, op.sensor >= 0].sum(axis=1)
        return score

    def turn_frame(self, op: FrameTurned) -> None:
        """Let the place of the map frame follow its direction, by a recorded correction."""
        P, m, turn = self.P, self.m, op.first + 2
        for column, by in ((op.first, -op.dy), (op.first + 1, op.dx)):
            m[:, column] += by * m[:, turn]
            P[:, column, :] += by * P[:, turn, :]
        for column, by in ((op.first, -op.dy), (op.first + 1, op.dx)):
            P[:, :, column] += by * P[:, :, turn]

    def add(self, op: Added) -> None:
        """Append the map frame as a copy of the pose; other new states are unknown."""
        n, k = op.before, op.states
        T = np.eye(n + k, n)
        if op.frame:
            T[n:, :3] = np.eye(3)
        self.P, self.m = T @ self.P @ T.T, self.m @ T.T
        if not op.frame:
            self.P[:, range(n, n + k), range(n, n + k)] = UNKNOWN_VARIANCE

    def change(self, op: Changed) -> None:
        """Replace some states by linear functions of all states."""
        P = self.P
        self.m[:, op.rows] = self.m @ op.by.T
        P[:, op.rows, :] = op.by @ P
        P[:, :, op.rows] = P @ op.by.T
        P[:, op.rows[:, None], op.rows] += op.noise


def bends(op: Moved, bend: float) -> bool:
    """Return whether a motion's path bends by more than `bend` [1/m]: also on the spot, not at rest."""
    return abs(op.turned) > bend * op.driven
