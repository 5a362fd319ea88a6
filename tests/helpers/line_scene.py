"""A robot among map lines and a scan that sees some of them, drawn at random."""

from __future__ import annotations

import math

import numpy as np

from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.kernels.sight import Seat
from locfuse.fusion.map.line_map import LineMap
from locfuse.fusion.map.scan import Scan

# of `seated`, m, m, rad: a mount as configured, and how far it is from there
MOUNT, MOVED = np.array([0.2, -0.3, 0.0]), np.array([0.03, -0.02, 0.05])
UPPER = (0.01, 0.001, 0.0005, 0.02, -0.0004, 0.001)


def covariance(rng: np.random.Generator, size: float = 0.02) -> np.ndarray:
    L = np.tril(rng.normal(size=(2, 2))) * size + size * np.eye(2)
    return np.asarray(L @ L.T)


def scene(seed: int, states: bool) -> tuple[Scan, LineMap, JointBelief]:
    """A robot among lines at a few angles, some near and on either side, and a scan that sees some of them."""
    rng = np.random.default_rng(seed)
    pose = (float(rng.normal()), float(rng.normal()), float(rng.uniform(-9.0, 9.0)))
    xx, xy, xt, yy, yt, tt = (np.array(UPPER) * 10 ** rng.uniform(-4, 2)).tolist()
    P0 = (xx, xy, xt, yy, yt, tt)
    belief = JointBelief(pose, P0)
    lines = LineMap()
    for _ in range(int(rng.integers(1, 32))):
        value = np.array([rng.normal() * 0.02, rng.choice([0.0, 0.5, 1.0, 1.5]) * math.pi + rng.normal() * 0.1])
        anchor, half = rng.normal(size=2) * 2.0, rng.uniform(0.2, 3.0)
        P, column = covariance(rng), -1
        if states:
            column = belief.augment(value, rng.normal(size=(2, 3)), P)
        lines.append(anchor, value, P, column, (-half, half), 0)
    k = int(rng.integers(1, 9))
    psi = rng.choice([0.0, 0.5, 1.0, 1.5], k) * math.pi + rng.normal(0.0, 0.1, k) - pose[2]
    z = np.stack((rng.uniform(-0.1, 4.0, k), (psi + math.pi) % (2 * math.pi) - math.pi), axis=-1)
    ends = np.sort(rng.normal(size=(k, 2)) * 2.0, axis=1)
    return Scan.of(z, np.array([covariance(rng) for _ in range(k)]), ends), lines, belief


def seated(belief: JointBelief, free: tuple[int, ...]) -> Seat:
    """A laser at MOUNT, of which these of x, y, yaw are states, correlated with all else."""
    rng = np.random.default_rng(len(free))
    G = 0.3 * rng.normal(size=(len(free), 3))
    first = belief.augment(
        (MOUNT + MOVED)[list(free)],
        G,
        covariance(rng, 0.03)[: len(free), : len(free)] if len(free) < 3 else 1e-3 * np.eye(3),
    )
    columns = np.arange(first, first + len(free), dtype=np.intp)
    return Seat(MOUNT.copy(), np.array(free, np.intp), columns)
