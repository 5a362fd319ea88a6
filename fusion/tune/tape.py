"""Record a filter run and replay it with other noise; acceptance, matches and linearisation stay as recorded.

With other noise, the deviations from the recorded run follow a linear Kalman filter, whose innovations have a
likelihood (Schweppe 1965). New map lines start with a large variance, so that their first measurements are treated
like later ones. Many sets of noise are replayed together along a leading axis, since NumPy's call overhead is most
of the cost (27 filters take three times as long as one).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import msgspec
import numpy as np
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
    Moved,
    VarianceAdded,
)
from locfuse.fusion.fuse import fuse
from locfuse.fusion.mount import exact
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY

UNKNOWN_VARIANCE = 100.0  # variance of a new map line [m^2, rad^2]


class SplitCorrection(NamedTuple):
    """Filter correction whose measurement covariance R is split into two parts, R_sigma + R_rest.

    R_sigma is proportional to the square of the sensor's sigma setting; R_rest does not depend on sigma.
    """

    event: Corrected
    R_sigma: Array  # (m, m) for the recorded sigma
    R_rest: Array  # (m, m)
    sensor: Ints  # (m,) index of the sensor; -1: no sensor (two lines are one wall), without likelihood


class Tape(msgspec.Struct):
    """Recorded events of one run of the filter."""

    sensors: tuple[str, ...]
    P0: Array  # (n, n)
    t: Array  # (instants,) s
    ops: list[tuple[int, Event | SplitCorrection]] = []  # index of the update time, event
    drifts: dict[str, tuple[Ints, Array]] = {}  # block -> columns, variance per s
    wheels: slice | None = None  # columns of the wheel parameters


def record(drive: Drive, robot: Robot, sensors: Sequence[str]) -> Tape:
    """Run the filter with these sensors and return the recorded run.

    Mounts are exact as configured: as states they would change the R of lines, which could then not be split.
    """
    robot = replace(robot, sensors={name: exact(settings) for name, settings in robot.sensors.items()})
    events, names = Events(backward=False), tuple(s for s in REGISTRY if s in sensors)
    fuse(drive, robot, sensors, events=events)
    assert events.start is not None
    tape = Tape(names, events.start.P, drive.t, drifts=events.drifts, wheels=events.wheels)
    instant = -1
    for event in events.list:
        instant += isinstance(event, Moved)
        op = split(event, drive, names) if isinstance(event, Corrected) else event
        tape.ops.append((max(instant, 0), op))
    return tape


def split(event: Corrected, drive: Drive, names: Sequence[str]) -> SplitCorrection:
    """Split the R of a correction into the part proportional to each sensor's sigma^2, and the rest."""
    R_sigma, sensor, k = np.zeros_like(event.R), np.full(len(event.y), -1), 0
    for name, row, numbers in event.sources:
        at = slice(k, k + numbers)
        if row >= 0:
            sensor[at] = names.index(name)
            R_sigma[at, at] = _of_sigma(event.R[at, at], drive.measurements[name], row)
        k = at.stop
    return SplitCorrection(event, R_sigma, event.R - R_sigma, sensor)


def _of_sigma(R: Array, m: Measurements, row: int) -> Array:
    """Return the part (d, d) of an innovation's R that is proportional to the sensor's sigma^2."""
    part: Array = m.scale**2 * m.R_unit[row]
    rest = m.extra.get("rest")
    if rest is not None:
        part = part - rest[row] * np.eye(len(part))
    if not (np.diagonal(R) >= 0.999 * np.diagonal(part)).all():
        return R  # the model uses a smaller R, which is proportional to sigma^2
    if len(R) == 2 and R[0, 1] * m.covariances(slice(row, row + 1))[0, 0, 1] < 0.0:
        part = part * np.array(((1.0, -1.0), (-1.0, 1.0)))  # the line is compared as (-r, psi + pi)
    return part


class NoiseFactors(NamedTuple):
    """B sets of noise to replay a run with; each number is a factor on a recorded variance."""

    wheels: Array  # (B,)
    sensors: Array  # (B, number of sensors)
    drifts: Mapping[str, Array]  # block -> (B,)
    turns: Array | None = None  # (B,) for motions that turn, instead of `wheels`


class Likelihoods(NamedTuple):
    """Log likelihoods of c corrections under B sets of noise."""

    scores: Array  # (B, c) log likelihood [nats]
    instant: Ints  # (c,)
    numbers: Ints  # (c,) measured numbers with a likelihood


def play(tape: Tape, noise: NoiseFactors, until: float = math.inf) -> Likelihoods:
    """Replay a recorded run under B sets of noise up to the time `until` [s]; return the log likelihoods."""
    replay = Replay(tape, noise)
    end = int(np.searchsorted(tape.t, until))
    scores, instants, numbers = [np.zeros((len(noise.wheels), 0))], [], []
    for instant, op in tape.ops:
        if isinstance(op, Moved):
            if instant >= end:
                break
            replay.move(instant, op)
        elif isinstance(op, SplitCorrection):
            scores.append(replay.correct(op)[:, None])
            instants.append(instant)
            numbers.append(int((op.sensor >= 0).sum()))
        elif isinstance(op, VarianceAdded):
            replay.P[:, op.columns, op.columns] += op.variance
        elif isinstance(op, FrameTurned):
            replay.turn_frame(op)
        elif isinstance(op, Added):
            replay.add(op)
        elif isinstance(op, Dropped):
            replay.m = np.delete(replay.m, op.columns, axis=1)
            replay.P = np.delete(np.delete(replay.P, op.columns, axis=1), op.columns, axis=2)
        elif isinstance(op, Changed):
            replay.change(op)
    return Likelihoods(np.concatenate(scores, axis=1), np.array(instants, np.int64), np.array(numbers, np.int64))


class Replay:
    """B Kalman filters for the deviation from the recorded run."""

    def __init__(self, tape: Tape, noise: NoiseFactors) -> None:
        B = len(noise.wheels)
        self.tape, self.noise = tape, noise
        # a last column for corrections without a sensor
        self.scale = np.concatenate((np.sqrt(noise.sensors), np.ones((B, 1))), axis=1)
        self.P = np.tile(tape.P0, (B, 1, 1))
        self.m = np.zeros((B, len(tape.P0)))

    def move(self, instant: int, op: Moved) -> None:
        """Predict the deviations and covariances: eq. 5-7, with the derivatives of eq. 7 by the heading theta."""
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
        factor = turns if turns is not None and turning(op) else self.noise.wheels
        P[:, :3, :3] += factor[:, None, None] * op.Q
        dt = float(self.tape.t[instant] - self.tape.t[max(instant - 1, 0)])
        for name, (columns, drift) in self.tape.drifts.items():
            P[:, columns, columns] += np.outer(self.noise.drifts.get(name, np.ones(len(P))), drift * dt)

    def correct(self, op: SplitCorrection) -> Array:
        """Correct (eq. 10-12) and return the log likelihoods (B,) of the measurements."""
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
        """Update the deviations of the map frame: its origin moved when its direction was corrected in the run."""
        P, m, turn = self.P, self.m, op.first + 2
        for column, by in ((op.first, -op.dy), (op.first + 1, op.dx)):
            m[:, column] += by * m[:, turn]
            P[:, column, :] += by * P[:, turn, :]
        for column, by in ((op.first, -op.dy), (op.first + 1, op.dx)):
            P[:, :, column] += by * P[:, :, turn]

    def add(self, op: Added) -> None:
        """Append new states as in the run: a map frame copies the pose, other states get UNKNOWN_VARIANCE."""
        n, k = op.before, op.states
        T = np.eye(n + k, n)
        if op.frame:
            T[n:, :3] = np.eye(3)
        self.P, self.m = T @ self.P @ T.T, self.m @ T.T
        if not op.frame:
            self.P[:, range(n, n + k), range(n, n + k)] = UNKNOWN_VARIANCE

    def change(self, op: Changed) -> None:
        """Replace the states `op.rows` by linear functions `op.by` of all states, with noise added."""
        P = self.P
        self.m[:, op.rows] = self.m @ op.by.T
        P[:, op.rows, :] = op.by @ P
        P[:, :, op.rows] = P @ op.by.T
        P[:, op.rows[:, None], op.rows] += op.noise


def turning(op: Moved) -> bool:
    """Return whether a motion's curvature is above MIN_CURVATURE_PER_M; a turn on the spot counts."""
    return abs(op.turned) > MIN_CURVATURE_PER_M * op.driven


# ---- the likelihood of recorded runs, its maximum and its curvature ----

WHEELS = "wheels.noise"
DRIFT = ":drift"  # suffix of the name of a search variable: drift of a sensor's estimated offset
DRIFT_START = 0.1  # degrees per sqrt(s)
SEARCH_BOUND_LOG = math.log(1e3)  # largest change of a logarithm in one search
STEP_LOG, HESSIAN_STEP_LOG = 0.02, 0.1
MAX_SIGMA_LOG = 0.5  # largest standard error of an identifiable logarithm
MIN_CURVATURE_PER_M = 0.5  # 1/m: a path with a larger curvature turns
MIN_CURVATURE_NATS = 1e-3  # smallest curvature in a standard error
PROFILE_DROP_NATS, PROFILE_REACH_LOG, PROFILE_POINTS = 0.5, math.log(30.0), 25  # for the search beyond the maximum
NO_TURNS = (
    "rotation noise is not identifiable: these logs turn by only {turned:.0f} deg. wheels.noise was found on "
    "straights and may be wrong in turns"
)
NO_STRAIGHTS = (
    "translation noise is not identifiable: these logs drive only {driven:.1f} m straight on. wheels.noise was "
    "found in turns and may be wrong on straights"
)


class Figures(msgspec.Struct):
    """Noise settings during tuning: the configured ones, and the change of each search variable.

    `factors` are ln(present / configured) for the wheels' variance, the sensors' sigmas, and the drift.
    """

    configured: Robot
    sensors: tuple[str, ...]
    drift: str | None = None  # sensor whose estimated offset may drift
    factors: dict[str, float] = {}

    @property
    def names(self) -> list[str]:
        """Names of the search variables (logarithms), in order."""
        return [WHEELS, *self.sensors, *([self.drift + DRIFT] if self.drift else [])]

    def factor(self, name: str) -> float:
        """Return the ratio of the present to the configured value of a search variable."""
        return math.exp(self.factors.get(name, 0.0))

    def values(self) -> dict[str, float]:
        """Return the present noise settings by key of robot.toml."""
        out = {WHEELS: self.configured.wheels.noise * self.factor(WHEELS)}
        for s in self.sensors:
            settings = self.configured.settings(s)
            out |= {f"{s}.{k}": getattr(settings, k) * self.factor(s) for k in REGISTRY[s].noise_keys}
        if self.drift:
            key = REGISTRY[self.drift].drift_key or ""
            start = getattr(self.configured.settings(self.drift), key) or DRIFT_START
            out[f"{self.drift}.{key}"] = start * self.factor(self.drift + DRIFT)
        return out

    def name_of(self, key: str) -> str:
        """Return the name of the search variable for a key of robot.toml."""
        table, _, name = key.partition(".")
        if key == WHEELS:
            return WHEELS
        return table + DRIFT if table == self.drift and name == REGISTRY[table].drift_key else table

    def robot(self, robot: Robot) -> Robot:
        """Return a robot with the present noise settings."""
        tables: dict[str, dict[str, float]] = {}
        for key, value in self.values().items():
            table, _, name = key.partition(".")
            tables.setdefault(table, {})[name] = value
        wheels = msgspec.structs.replace(robot.wheels, **tables.pop("wheels"))
        settings = {s: msgspec.structs.replace(c, **tables.get(s, {})) for s, c in robot.sensors.items()}
        return replace(robot, wheels=wheels, sensors=settings)


def drifting(robot: Robot, sensors: Sequence[str], wanted: bool) -> str | None:
    """Return the first sensor with an estimated offset, provided that the offset drifts; else None.

    With `wanted`, the configured drift may be 0.
    """
    for s in sensors:
        offset, key = REGISTRY[s].bias, REGISTRY[s].drift_key
        if key and offset is not None and getattr(robot.settings(s), offset.key) is None:
            return s if wanted or getattr(robot.settings(s), key) > 0.0 else None
    return None


class Likelihood(msgspec.Struct):
    """Log likelihood of recorded runs as a function of theta = ln(noise / recorded noise)."""

    tapes: Sequence[Tape]
    until: Sequence[float]  # s: later corrections are held out
    names: Sequence[str]  # of the logarithms

    def __call__(self, theta: Array, turns: Array | None = None, least: Sequence[float] | None = None) -> Array:
        """Return the training log likelihoods (B,) at B points theta (B, p).

        `turns` (B,) are logarithms of the wheels' noise in turns, `least` is an earlier end of each run [s].
        """
        total = np.zeros(len(theta))
        ends = self.until if least is None else map(min, self.until, least)
        for tape, end in zip(self.tapes, ends, strict=True):
            if end > tape.t[0]:
                total += play(tape, self._noise(tape, theta, turns), end).scores.sum(axis=1)
        return total

    def means(self, theta: Array) -> tuple[list[tuple[float, ...] | None], tuple[int, int]]:
        """Return the mean log likelihood per measured number, and how many numbers: (training, held out) each.

        Both means have B values, one per point of theta (B, p); None for a part without numbers.
        """
        sums, counts = np.zeros((2, len(theta))), np.zeros(2)
        for tape, end in zip(self.tapes, self.until, strict=True):
            played = play(tape, self._noise(tape, theta))
            training = (tape.t[played.instant] < end).astype(np.float64)
            for i, part in enumerate((training, 1.0 - training)):
                sums[i] += played.scores @ part
                counts[i] += played.numbers @ part
        found = [tuple((s / n).tolist()) if n else None for s, n in zip(sums, counts.tolist(), strict=True)]
        return found, (int(counts[0]), int(counts[1]))

    def _noise(self, tape: Tape, theta: Array, turns: Array | None = None) -> NoiseFactors:
        """Return the noise of a recorded run for logarithms theta (B, p)."""
        sensors = [np.exp(2.0 * theta[:, self.names.index(s)]) for s in tape.sensors]
        drifts = {}
        if self.names[-1].endswith(DRIFT):
            drifts = dict.fromkeys(tape.drifts, np.exp(2.0 * theta[:, -1]))
        columns = np.stack(sensors, axis=1) if sensors else np.ones((len(theta), 0))
        wheels = theta[:, self.names.index(WHEELS)]
        return NoiseFactors(np.exp(wheels), columns, drifts, None if turns is None else np.exp(turns))


def best(problem: Likelihood, starts: Sequence[float], least: Sequence[float] | None = None) -> Array:
    """Return the logarithms (p,) of maximum likelihood, from searches that begin at each of `starts`.

    Each start value holds for all variables. `least` is an earlier end of each run [s], to save time.
    """
    from scipy.optimize import minimize

    p = len(problem.names)
    steps = np.concatenate((np.zeros((1, p)), STEP_LOG * np.eye(p), -STEP_LOG * np.eye(p)))

    def cost(theta: Array) -> tuple[float, Array]:
        values = -problem(theta + steps, least=least)
        return float(values[0]), (values[1 : p + 1] - values[p + 1 :]) / (2.0 * STEP_LOG)

    limits = [(-SEARCH_BOUND_LOG, SEARCH_BOUND_LOG)] * p
    how = {"jac": True, "method": "L-BFGS-B", "bounds": limits, "options": {"ftol": 1e-8}}
    found = [minimize(cost, np.full(p, s), **how) for s in starts]
    return np.asarray(min(found, key=lambda f: float(f.fun)).x, np.float64)


def identify(problem: Likelihood) -> tuple[Array, list[str]]:
    """Return standard errors (p,) of the log noise at the maximum, and notes on unidentifiable wheel noise.

    They follow from the likelihood's curvature, with separate wheel noise for straight motions and for turns.
    """
    p = len(problem.names)
    H = -hessian(lambda v: problem(v[:, :p], v[:, p]), p + 1)
    whole = np.vstack((np.eye(p), np.eye(p)[:1]))  # equal wheel noise for straight motions and turns
    split = standard_errors(H)
    flags = []
    if split[p] > MAX_SIGMA_LOG:
        flags.append(NO_TURNS.format(turned=math.degrees(sum(abs(m.turned) for m in _moves(problem, True)))))
    if split[0] > MAX_SIGMA_LOG:
        flags.append(NO_STRAIGHTS.format(driven=sum(m.driven for m in _moves(problem, False))))
    return standard_errors(whole.T @ H @ whole), flags


def at_most(problem: Likelihood, which: int, upper: float) -> float:
    """Return the largest log noise that is nearly as likely as the maximum at 0; inf if all searched values are.

    `which` is the index of the search variable; the other ones stay at 0. The search ends at `upper` or
    PROFILE_REACH_LOG, whichever is larger. If the likelihood is flat towards small noise, the result is the end of
    the flat part.
    """
    grid = np.linspace(0.0, max(upper, PROFILE_REACH_LOG), PROFILE_POINTS)
    theta = np.zeros((PROFILE_POINTS, len(problem.names)))
    theta[:, which] = grid
    likelihood = problem(theta)
    worse = np.flatnonzero(likelihood < likelihood[0] - PROFILE_DROP_NATS)
    return float(grid[worse[0] - 1]) if len(worse) else math.inf


def _moves(problem: Likelihood, turn: bool) -> list[Moved]:
    """Return the recorded motions used for training: those that turn, or with `turn` false the straight ones."""
    return [
        op
        for tape, end in zip(problem.tapes, problem.until, strict=True)
        for instant, op in tape.ops
        if isinstance(op, Moved) and tape.t[instant] < end and turning(op) == turn
    ]


def hessian(f: Callable[[Array], Array], p: int) -> Array:
    """Return the second derivatives (p, p) at zero of f: (B, p) -> (B,), by central differences in one call."""
    signs = np.array(((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)))
    pairs = [(i, j) for i in range(p) for j in range(i, p)]
    points = np.zeros((len(pairs), 4, p))
    for point, (i, j) in zip(points, pairs, strict=True):
        point[:, i] += HESSIAN_STEP_LOG * signs[:, 0]
        point[:, j] += HESSIAN_STEP_LOG * signs[:, 1]
    values = f(points.reshape(-1, p)).reshape(-1, 4) @ (signs[:, 0] * signs[:, 1])
    out = np.zeros((p, p))
    for (i, j), value in zip(pairs, values.tolist(), strict=True):
        out[i, j] = out[j, i] = value / (4.0 * HESSIAN_STEP_LOG**2)
    return out


def standard_errors(H: Array) -> Array:
    """Return standard errors (p,) from the curvature H (p, p) of -ln L; very large along flat directions."""
    values, vectors = np.linalg.eigh(H)
    errors: Array = np.sqrt((vectors**2 / np.maximum(values, MIN_CURVATURE_NATS)).sum(axis=1))
    return errors
