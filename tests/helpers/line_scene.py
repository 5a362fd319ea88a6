"""A robot among map lines and a scan that sees some of them, drawn at random."""

import math
from typing import NamedTuple

import numpy as np

from locfuse.fusion.data import Array
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.kernels.sight import MountStates, Rules
from locfuse.fusion.map.line_map import NO_SHARES, Association, LineMap, mount_states_of
from locfuse.fusion.map.scan import Scan
from locfuse.fusion.sensor import Equation

# of `mounted_states`, m, m, rad: a mount as configured, and how far it is from there
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


def mounted_states(belief: JointBelief, free: tuple[int, ...]) -> MountStates:
    """A laser at MOUNT, of which these of x, y, yaw are states, correlated with all else."""
    rng = np.random.default_rng(len(free))
    G = 0.3 * rng.normal(size=(len(free), 3))
    first = belief.augment(
        (MOUNT + MOVED)[list(free)],
        G,
        covariance(rng, 0.03)[: len(free), : len(free)] if len(free) < 3 else 1e-3 * np.eye(3),
    )
    columns = np.arange(first, first + len(free), dtype=np.intp)
    return MountStates(MOUNT.copy(), np.array(free, np.intp), columns)


# --- a scan that is associated with a map, and what the association has worked out on the way

UNMATCHED, AMBIGUOUS, NEW = 3, 2, 4  # verdicts


class Pair(NamedTuple):
    """A measured line and a map line."""

    line: int
    which: int
    y: Array  # (2,)
    R: Array  # (2, 2)
    S: Array  # (2, 2)
    d2: float
    score: float
    lo: float  # m along the map line
    hi: float
    overlap: float
    psi: float  # the measured psi as it is predicted


def side_of(pair: Pair, z: Array) -> float:
    """1.0, or -1.0 where the measured line (r, psi) is read as (-r, psi + pi)."""
    return math.copysign(1.0, math.cos(pair.psi - z[1]))


class Sighted(Association):
    """An association whose room can be looked into."""

    def in_base(self) -> Array:
        """Return the measured lines (n, 7) in the base frame, by the estimated mount."""
        return np.array(self.rows)[: self.lines]

    def column(self, k: int) -> list[int]:
        """Of every line: the pair that matches, the best, whether it has a rival, whether it is near."""
        values: list[int] = np.array((self.match, self.best, self.rival, self.near)[k])[: self.lines].tolist()
        return values

    pair_of = property(lambda self: self.column(0))
    best_of = property(lambda self: self.column(1))
    ambiguous = property(lambda self: [bool(v) for v in self.column(2)])
    is_near = property(lambda self: [bool(v) for v in self.column(3)])

    @property
    def pair_list(self) -> list[Pair]:
        """The candidates, line by line."""
        return [
            Pair(
                int(p[0]),
                int(p[1]),
                p[2:4],
                symmetric(p[4:7]),
                symmetric(p[7:10]),
                *p[[10, 11, 12, 13, 14, 18]].tolist(),
            )
            for p in np.array(self.pairs)[: self.found]
        ]

    def matched(self) -> list[Pair]:
        """The pairs that match, in the order of the lines."""
        return [self.pair_list[p] for p in self.pair_of if p >= 0]


def symmetric(upper: Array) -> Array:
    return upper[[0, 1, 1, 2]].reshape(2, 2)


def sighted(
    rows: Array,
    lines: LineMap,
    belief: JointBelief,
    gate: float,
    states: bool,
    mount_states: MountStates | None = None,
    shared: Array = NO_SHARES,
) -> Sighted:
    """Associate lines (n, 7) with a map, whose lines are `states` or not, and write what matches."""
    found = Sighted(
        Rules(gate, states, True, UNMATCHED, AMBIGUOUS, NEW), mount_states or mount_states_of(None, belief)
    )
    found.compare(belief, lines, rows, shared)
    belief.begin()
    found.state_rows(belief)
    return found


def equation_of(found: Sighted, belief: JointBelief) -> Equation:
    """What the lines that match say together, which is queued."""
    belief.queue(found)
    return belief.equation()
