"""What the loop meets at each instant of a drive: the motion that leads there and the readings that are due.

Columns become plain Python values here, a block of instants at a time: the loop touches no NumPy scalar, and an
hour's values are never all in memory as objects.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.wheels.motion import Wheels

from .data import Array, Drive, Ints, Motions
from .progress import say_done

BLOCK = 256  # instants
TRIANGLE = [0, 1, 2, 4, 5, 8]  # of a flat 3 x 3: xx, xy, xt, yy, yt, tt
Due = tuple[str, int]  # sensor, reading


class Step(NamedTuple):
    """Wheel motion from the instant before, as `predict` takes it."""

    u: Sequence[float]  # relative pose (x, y, theta)
    Q: Sequence[float]  # its covariance's triangle
    dt: float  # s
    J: Array | None  # (3, p) its derivative by the wheel parameters


class Instants:
    """The motions and the readings of a whole drive, instant by instant; it says how much of its time is done.

    Whoever goes on by many instants at once leaves out what lies between.
    """

    def __init__(self, drive: Drive, sensors: Sequence[str]) -> None:
        self._drive, self._dt = drive, np.diff(drive.t, prepend=drive.t[:1])
        self._owners = {s: drive.instant[s] for s in REGISTRY if s in sensors}
        self._begin = self._said = -BLOCK  # of the block at hand, and of the one whose begin was said
        self._steps: list[Step] = []
        self._due: list[list[Due]] = []

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self._dt)

    def at(self, k: int) -> tuple[Step, list[Due]]:
        """Return the motion that leads to instant k, and the readings (sensor, i) that belong to it."""
        if not 0 <= k - self._begin < BLOCK:
            self._begin = k - k % BLOCK
            at = slice(self._begin, min(self._begin + BLOCK, len(self)))
            self._steps = list(_block(self._drive.motions, self._dt, at))
            self._due = _due(self._owners, at.start, at.stop)
        return self._steps[k - self._begin], self._due[k - self._begin]

    def reached(self, k: int) -> None:
        """Say now and then that the instants before k are done."""
        if k - self._said >= BLOCK:
            self._said, t = k, self._drive.t
            say_done(float(t[k] / t[-1]) if k else 0.0)


def steps_of(drive: Drive) -> Iterator[Step]:
    """Yield the motions of a whole drive, and say meanwhile how much of its time is done."""
    instants = Instants(drive, ())
    for k in range(len(instants)):
        instants.reached(k)
        yield instants.at(k)[0]
    say_done(None)


def _block(motions: Motions, dt: Array, at: slice) -> Iterator[Step]:
    u, Q = motions.u[at].tolist(), motions.Q[at].reshape(-1, 9)[:, TRIANGLE].tolist()
    J = list(motions.J[at]) if motions.J.shape[2] else [None] * len(u)
    yield from map(Step, u, Q, dt[at].tolist(), J)


def step_between(wheels: Wheels, t_from: float, t_to: float, parameters: bool = False) -> Step:
    """Return the one motion from t_from to t_to [s]."""
    motions = wheels.between(np.array([t_from]), np.array([t_to]), parameters)
    return next(_block(motions, np.array([t_to - t_from]), slice(None)))


def due_readings(drive: Drive, sensors: Sequence[str]) -> Iterator[list[Due]]:
    """Yield for every instant the readings (sensor, i) that belong to it, in registry order."""
    owners, n = {s: drive.instant[s] for s in REGISTRY if s in sensors}, len(drive.t)
    for a in range(0, n, BLOCK):
        yield from _due(owners, a, min(a + BLOCK, n))


def _due(owners: Mapping[str, Ints], begin: int, end: int) -> list[list[Due]]:
    """Return the readings of the instants begin:end, sensor by sensor."""
    due: list[list[Due]] = [[] for _ in range(end - begin)]
    for sensor, instant in owners.items():
        first, last = np.searchsorted(instant, (begin, end)).tolist()
        for i, k in enumerate((instant[first:last] - begin).tolist(), first):
            due[k].append((sensor, i))
    return due
