"""Every other sensor of a drive in the graph: its own model compares its readings with the key poses.

A reading between two keys is seen from the key before, by the wheels. Nothing here knows what a sensor is: its
model says y, H and R, as it does in the filter.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import VERDICTS, Array, Drive, Ints
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensor import Matrix, Model, PoseRows
from locfuse.fusion.sensors.registry import REGISTRY

from .odometry import Odometry, by_lever
from .solve import SYSTEMATIC, Rows

READINGS_PER_KEY = 4  # of one sensor; each stands for its share of all
WIDTH = 3.0  # sigmas at which a reading loses weight (Cauchy)
REFUSED = VERDICTS.index("disturbed")


class Seen(NamedTuple):
    """One reading, seen from a key."""

    sensor: str
    reading: int
    key: int
    u: Array  # (3,) the pose at the reading, seen from the key
    C: Array  # (3, 3) its covariance
    share: float  # how many readings it stands for


class At:
    """What a model may ask of a belief: a pose and states that are what they are."""

    def __init__(self, columns: dict[str, tuple[int, int]], states: Array) -> None:
        self._columns, self._states = columns, states
        self.x = self.y = self.theta = 0.0

    def block(self, name: str) -> tuple[int, Array]:
        """Return (first state, values) of a block."""
        first, n = self._columns[name]
        return first, self._states[first : first + n]

    def spread(self, H: PoseRows, columns: tuple[int, ...] = (), H_block: Matrix = ()) -> Matrix:
        """Return no uncertainty, (d, d)."""
        return tuple((0.0,) * len(H) for _ in H)

    def observed(
        self, H: PoseRows, columns: tuple[int, ...] = (), H_block: Matrix = ()
    ) -> tuple[Matrix, PoseRows, tuple[int, ...], Matrix]:
        """Return no uncertainty, and the derivatives as they are."""
        return self.spread(H), H, columns, H_block


class Others:
    """The readings of sensors other than the laser, and their states (a compass's offset)."""

    def __init__(self, drive: Drive, robot: Robot, sensors: Sequence[str], odometry: Odometry, keys: Ints) -> None:
        self._drive = drive
        self._models: dict[str, Model] = {}
        for s in sensors:
            if not REGISTRY[s].needs:
                model = REGISTRY[s].model(robot.settings(s))
                if not (model.local or model.joint):
                    self._models[s] = model
        self._columns: dict[str, tuple[int, int]] = {}
        values, information = [np.zeros(0)], [np.zeros(0)]
        for model in self._models.values():
            for block in model.blocks():
                self._columns[block.name] = (sum(len(v) for v in values), len(block.x))
                values.append(np.asarray(block.x, np.float64))
                information.append(1.0 / np.maximum(np.diagonal(block.P), 1e-12))
        self.start, self._prior = np.concatenate(values), np.concatenate(information)
        self.values = self.start.copy()
        self.states = len(self.values)
        self._seen = [seen for s in self._models for seen in _chosen(s, drive, odometry, keys)]

    @property
    def sensors(self) -> tuple[str, ...]:
        """Those that say something."""
        return tuple(dict.fromkeys(seen.sensor for seen in self._seen))

    def move(self, step: Array) -> None:
        """Add a step to the states."""
        self.values = self.values + step

    def rows(self, x: Array) -> list[Rows]:
        """Return the readings' share of the normal equations at key poses x (n, 3)."""
        at, n = At(self._columns, self.values), 3 * len(x) + len(SYSTEMATIC)
        blocks: dict[int, list[tuple[Array, Array, Array]]] = {}
        for seen in self._seen:
            pose = se2.compose(x[seen.key], seen.u)
            at.x, at.y, at.theta = pose.tolist()
            found = self._models[seen.sensor].innovations(self._drive.measurements[seen.sensor], seen.reading, at)
            for one in found[:1]:
                if one.verdict == REFUSED or not one.H:
                    continue
                lever = pose[:2] - x[seen.key, :2]
                H = np.array(one.H)
                H[:, 2] += H[:, 1] * lever[0] - H[:, 0] * lever[1]
                J = np.hstack((H, np.reshape(np.array(one.H_block, np.float64), (len(H), -1))))
                turned = se2.rotation(pose[2] - seen.u[2]) @ seen.C @ se2.rotation(pose[2] - seen.u[2]).T
                R = np.array(one.R) + np.array(one.H) @ turned @ np.array(one.H).T
                W, y = np.linalg.inv(R), np.array(one.y)
                W *= seen.share / (1.0 + float(y @ W @ y) / (WIDTH**2 * len(y)))
                columns: Any = np.concatenate((3 * seen.key + np.arange(3), n + np.array(one.columns, np.int64)))
                blocks.setdefault(J.shape[1], []).append((columns, J.T @ W @ J, J.T @ W @ y))
        rows = [Rows(*(np.array(part) for part in zip(*block, strict=True))) for block in blocks.values()]
        if self.states:
            H = np.diag(self._prior)[None]
            rows.append(
                Rows((n + np.arange(self.states))[None], H, (self._prior * (self.start - self.values))[None])
            )
        return rows


def _chosen(sensor: str, drive: Drive, odometry: Odometry, keys: Ints) -> list[Seen]:
    """Return a few readings behind each key, evenly spread, each for its share of all."""
    instants = drive.instant[sensor]
    key = np.searchsorted(keys, instants, side="right") - 1
    found = []
    for k in np.unique(key[key >= 0]).tolist():
        rows = np.flatnonzero(key == k)
        some = rows[np.unique(np.linspace(0, len(rows) - 1, min(len(rows), READINGS_PER_KEY)).round().astype(int))]
        at = instants[some]
        u, C = odometry.between(np.full(len(at), keys[k]), at)
        C = by_lever(C, -u[:, 1], u[:, 0])
        share = len(rows) / len(some)
        found += [Seen(sensor, int(r), k, u[n], C[n], share) for n, r in enumerate(some.tolist())]
    return found
