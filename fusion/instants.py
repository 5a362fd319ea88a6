"""What the loop meets at each instant of a drive: the motion that leads there and the readings that are due.

Columns become plain Python values here, a block of instants at a time: the loop touches no NumPy scalar, and an
hour's values are never all in memory as objects.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.wheels.motion import Wheels

from .data import Array, Drive, Motions
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


def steps_of(drive: Drive) -> Iterator[Step]:
    """Yield the motions of a whole drive, and say meanwhile how much of its time is done."""
    dt = np.diff(drive.t, prepend=drive.t[:1])
    for a in range(0, len(dt), BLOCK):
        say_done(float(drive.t[a] / drive.t[-1]) if a else 0.0)
        yield from _block(drive.motions, dt, slice(a, a + BLOCK))
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
    n = len(drive.t)
    owners = {s: drive.instant[s] for s in REGISTRY if s in sensors}
    for a in range(0, n, BLOCK):
        due: list[list[Due]] = [[] for _ in range(min(BLOCK, n - a))]
        for sensor, instant in owners.items():
            first, last = np.searchsorted(instant, (a, a + BLOCK)).tolist()
            for i, k in enumerate((instant[first:last] - a).tolist(), first):
                due[k].append((sensor, i))
        yield from due
