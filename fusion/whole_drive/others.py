"""Sensors other than the laser in the pose graph: their models compare readings with the key poses.

Wheel odometry gives the pose at a reading relative to the key pose before it. Every sensor is handled alike: its
model gives y, H and R, as in the filter.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Audit, Drive, Ints, RowVerdict, evenly
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.kernels.sight import SightLines
from locfuse.fusion.robot import Robot
from locfuse.fusion.scan_matching.solve import SYSTEMATIC_SIGMAS, Summands
from locfuse.fusion.sensor import Model
from locfuse.fusion.sensors.registry import REGISTRY

from .odometry import Odometry, add_lever_arm

READINGS_PER_KEY = 4  # used readings of one sensor per key; their weight does not replace the unused readings
WIDTH_SIGMAS = 3.0  # sigmas at which a reading loses weight (Cauchy)


class SeenReading(NamedTuple):
    """One sensor reading, with the pose of the base relative to the key pose before it."""

    sensor: str
    reading: int
    key: int
    u: Array  # (3,) pose at the reading in the frame of the key pose
    C: Array  # (3, 3) covariance of u


class Others:
    """Readings of the sensors other than the laser, and the states of their models (a compass's offset)."""

    def __init__(
        self,
        drive: Drive,
        robot: Robot,
        sensors: Sequence[str],
        odometry: Odometry,
        keys: Ints,
        audits: Mapping[str, Audit] | None = None,
    ) -> None:
        """Choose readings near the key poses; readings that the filter's `audits` rejected are not used."""
        self._drive = drive
        self._models: dict[str, Model] = {}
        for s in sensors:
            if not REGISTRY[s].needs:
                model = REGISTRY[s].model(robot.settings(s))
                if not (model.local or model.joint):
                    self._models[s] = model
        blocks = [block for model in self._models.values() for block in model.blocks()]
        self._belief = JointBelief.still(blocks)
        self.start = self._belief.state[3:].copy()
        self._prior = np.concatenate([np.zeros(0), *(1.0 / np.maximum(np.diagonal(b.P), 1e-12) for b in blocks)])
        self.values = self.start.copy()
        self.states = len(self.values)
        used = {s: _used(drive.instant[s], (audits or {}).get(s)) for s in self._models}
        self._seen = [seen for s, rows in used.items() for seen in _chosen(s, drive, odometry, keys, rows)]

    @property
    def sensors(self) -> tuple[str, ...]:
        """Return the names of the sensors that have readings."""
        return tuple(dict.fromkeys(seen.sensor for seen in self._seen))

    def move(self, step: Array) -> None:
        """Add a step (states,) to the sensor states."""
        self.values = self.values + step

    def rows(self, x: Array) -> list[Summands]:
        """Return the normal equations of all readings at key poses x (n, 3)."""
        belief, n = self._belief, 3 * len(x) + len(SYSTEMATIC_SIGMAS)
        belief.state[3:] = self.values
        blocks: dict[int, list[tuple[Array, Array, Array]]] = {}
        for seen in self._seen:
            pose = se2.compose(x[seen.key], seen.u)
            belief.stand(pose)
            m = self._drive.measurements[seen.sensor]
            found = self._models[seen.sensor].innovations(m, seen.reading, belief)
            for one in () if isinstance(found, SightLines) else found[:1]:
                if one.verdict == RowVerdict.DISTURBED or not one.numbers:
                    continue
                y, states, by_state, R = belief.equation([one])
                H = by_state[:, :3]
                moved = H.copy()
                lever = pose[:2] - x[seen.key, :2]
                moved[:, 2] += H[:, 1] * lever[0] - H[:, 0] * lever[1]
                J = np.hstack((moved, by_state[:, 3:]))
                turned = se2.rotation(pose[2] - seen.u[2]) @ seen.C @ se2.rotation(pose[2] - seen.u[2]).T
                W = np.linalg.inv(R + H @ turned @ H.T)
                W /= 1.0 + float(y @ W @ y) / (WIDTH_SIGMAS**2 * len(y))
                columns: Any = np.concatenate((3 * seen.key + np.arange(3), n + states[3:] - 3))
                blocks.setdefault(J.shape[1], []).append((columns, J.T @ W @ J, J.T @ W @ y))
        rows = [Summands(*(np.array(part) for part in zip(*block, strict=True))) for block in blocks.values()]
        if self.states:
            H = np.diag(self._prior)[None]
            g = self._prior * (self.start - self.values)
            rows.append(Summands((n + np.arange(self.states))[None], H, g[None]))
        return rows


def _used(instants: Ints, audit: Audit | None) -> Ints:
    """Return the indices (k,) of readings that the filter did not reject; none if it rejected most of them."""
    if audit is None:
        return np.arange(len(instants))
    refused, accepted = (audit.instant[audit.verdict == v] for v in (RowVerdict.GATE, RowVerdict.ACCEPTED))
    kept = np.flatnonzero(~np.isin(instants, np.setdiff1d(refused, accepted)))
    # if most readings of a sensor are wrong, the accepted ones are probably wrong too
    return kept if 2 * len(kept) > len(instants) else kept[:0]


def _chosen(sensor: str, drive: Drive, odometry: Odometry, keys: Ints, used: Ints) -> list[SeenReading]:
    """Choose at most READINGS_PER_KEY of the `used` readings after each key, evenly spaced."""
    instants = drive.instant[sensor]
    key = np.searchsorted(keys, instants[used], side="right") - 1
    found = []
    for k in np.unique(key[key >= 0]).tolist():
        rows = used[key == k]
        picked = rows[evenly(len(rows), READINGS_PER_KEY)]
        at = instants[picked]
        u, C = odometry.between(np.full(len(at), keys[k]), at)
        C = add_lever_arm(C, -u[:, 1], u[:, 0])
        found += [SeenReading(sensor, int(r), k, u[n], C[n]) for n, r in enumerate(picked.tolist())]
    return found
