"""Input of the loop at each instant of a drive: the motion that leads there and the readings that are due.

Readings become plain Python values a block of instants at a time: an hour's are never all in memory as objects.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from locfuse.fusion.kernels.arrays import view
from locfuse.fusion.kernels.ekf import Steps
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.wheels.motion import Wheels

from .data import Array, Drive, Ints, Motions

BLOCK_INSTANTS = 256
Due = tuple[str, int]  # sensor, reading


def steps_of(drive: Drive) -> Steps:
    """Return the motions of a whole drive: step k leads to instant k."""
    return _steps(drive.motions, np.diff(drive.t, prepend=drive.t[:1]))


def step_between(wheels: Wheels, t_from: float, t_to: float, parameters: bool = False) -> Steps:
    """Return the one motion from t_from to t_to [s], as step 0."""
    motions = wheels.between(np.array([t_from]), np.array([t_to]), parameters)
    return _steps(motions, np.array([t_to - t_from]))


def _steps(motions: Motions, dt: Array) -> Steps:
    n = len(dt)
    Q, J = motions.Q.reshape(n, 9), motions.J.reshape(n, 3 * motions.J.shape[2])
    return Steps(view(motions.u), view(Q), view(dt), view(J))


def due_readings(drive: Drive, sensors: Sequence[str]) -> Iterator[list[Due]]:
    """Yield for every instant the readings (sensor, i) that belong to it, in registry order."""
    owners, n = {s: drive.instant[s] for s in REGISTRY if s in sensors}, len(drive.t)
    for a in range(0, n, BLOCK_INSTANTS):
        yield from _due(owners, a, min(a + BLOCK_INSTANTS, n))


def _due(owners: Mapping[str, Ints], begin: int, end: int) -> list[list[Due]]:
    """Return the readings of the instants begin:end, sensor by sensor."""
    due: list[list[Due]] = [[] for _ in range(end - begin)]
    for sensor, instant in owners.items():
        first, last = np.searchsorted(instant, (begin, end)).tolist()
        for i, k in enumerate((instant[first:last] - begin).tolist(), first):
            due[k].append((sensor, i))
    return due
