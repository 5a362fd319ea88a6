"""The search for noise: the likelihood of tapes as a function of logarithms, its peak and its curvature."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import msgspec
import numpy as np

from locfuse.fusion.data import Array
from locfuse.fusion.ekf.events import Moved

from .noise import DRIFT, WHEELS
from .record import Tape
from .replay import Noise, bends, play

SEARCH_BOUND_LOG = math.log(1e3)  # of one search
STEP_LOG, HESSIAN_STEP_LOG = 0.02, 0.1
MAX_SIGMA_LOG = 0.5  # standard error of a logarithm: more is not identifiable
MIN_CURVATURE_PER_M = 0.5  # 1/m: a path that bends more is turning
MIN_CURVATURE_NATS = 1e-3  # curvature that counts as none
PROFILE_DROP_NATS, PROFILE_REACH_LOG, PROFILE_POINTS = (
    0.5,
    math.log(30.0),
    25,
)  # nats; logarithms looked at beyond the peak, how many
NO_TURNS = (
    "rotation noise is not identifiable: these logs turn by only {turned:.0f} deg. wheels.noise was found on "
    "straights and may be wrong in turns"
)
NO_STRAIGHTS = (
    "translation noise is not identifiable: these logs drive only {driven:.1f} m straight on. wheels.noise was "
    "found in turns and may be wrong on straights"
)


class Problem(msgspec.Struct):
    """The likelihood of tapes as a function of logarithms relative to what was recorded."""

    tapes: Sequence[Tape]
    until: Sequence[float]  # s: what is later is held out
    names: Sequence[str]  # of the logarithms

    def __call__(self, theta: Array, turns: Array | None = None, least: Sequence[float] | None = None) -> Array:
        """Return the log likelihood in training of B points (B, p).

        `turns` (B,) is the logarithm of the wheels' noise in turns, `least` ends the tapes even earlier [s].
        """
        total = np.zeros(len(theta))
        for tape, end in zip(
            self.tapes, self.until if least is None else map(min, self.until, least), strict=True
        ):
            if end > tape.t[0]:
                total += play(tape, self._noise(tape, theta, turns), MIN_CURVATURE_PER_M, end).scores.sum(axis=1)
        return total

    def means(self, theta: Array) -> tuple[list[tuple[float, ...] | None], tuple[int, int]]:
        """Return mean scores per number of B points, in training and held out, and the counts of these numbers."""
        sums, counts = np.zeros((2, len(theta))), np.zeros(2)
        for tape, end in zip(self.tapes, self.until, strict=True):
            played = play(tape, self._noise(tape, theta))
            training = (tape.t[played.instant] < end).astype(np.float64)
            for i, part in enumerate((training, 1.0 - training)):
                sums[i] += played.scores @ part
                counts[i] += played.numbers @ part
        found = [tuple((s / n).tolist()) if n else None for s, n in zip(sums, counts.tolist(), strict=True)]
        return found, (int(counts[0]), int(counts[1]))

    def _noise(self, tape: Tape, theta: Array, turns: Array | None = None) -> Noise:
        """Turn logarithms into factors on the variances of one tape."""
        sensors = [np.exp(2.0 * theta[:, self.names.index(s)]) for s in tape.sensors]
        drifts = {}
        if self.names[-1].endswith(DRIFT):
            drifts = dict.fromkeys(tape.drifts, np.exp(2.0 * theta[:, -1]))
        columns = np.stack(sensors, axis=1) if sensors else np.ones((len(theta), 0))
        wheels = theta[:, self.names.index(WHEELS)]
        return Noise(np.exp(wheels), columns, drifts, None if turns is None else np.exp(turns))


def best(problem: Problem, starts: Sequence[float], least: Sequence[float] | None = None) -> Array:
    """Return the most likely logarithms (p,) relative to the recording; a start is all of them at once.

    `least` ends the tapes early [s]: to tell the starts apart, a part of the logs is enough.
    """
    from scipy.optimize import minimize

    p = len(problem.names)
    steps = np.concatenate((np.zeros((1, p)), STEP_LOG * np.eye(p), -STEP_LOG * np.eye(p)))

    def cost(theta: Array) -> tuple[float, Array]:
        values = -problem(theta + steps, least=least)
        return float(values[0]), (values[1 : p + 1] - values[p + 1 :]) / (2.0 * STEP_LOG)

    limits = [(-SEARCH_BOUND_LOG, SEARCH_BOUND_LOG)] * p
    found = [
        minimize(cost, np.full(p, s), jac=True, method="L-BFGS-B", bounds=limits, options={"ftol": 1e-8})
        for s in starts
    ]
    return np.asarray(min(found, key=lambda f: float(f.fun)).x, np.float64)


def identify(problem: Problem) -> tuple[Array, list[str]]:
    """Return the standard error of every logarithm (p,), and in words why the wheels' noise was not identified.

    From the likelihood's curvature with the wheels' noise split: on straights, and in turns.
    """
    p = len(problem.names)
    H = -hessian(lambda v: problem(v[:, :p], v[:, p]), p + 1)
    whole = np.vstack((np.eye(p), np.eye(p)[:1]))  # the split noise follows from the one
    split = standard_errors(H)
    flags = []
    if split[p] > MAX_SIGMA_LOG:
        flags.append(NO_TURNS.format(turned=math.degrees(sum(abs(m.turned) for m in _moves(problem, True)))))
    if split[0] > MAX_SIGMA_LOG:
        flags.append(NO_STRAIGHTS.format(driven=sum(m.driven for m in _moves(problem, False))))
    return standard_errors(whole.T @ H @ whole), flags


def at_most(problem: Problem, which: int, told: float) -> float:
    """Return the largest value of one logarithm, up to `told`, that is hardly less likely than 0, the peak.

    Where the likelihood is flat towards small noise, its shoulder is what can be said.
    """
    grid = np.linspace(0.0, max(told, PROFILE_REACH_LOG), PROFILE_POINTS)
    theta = np.zeros((PROFILE_POINTS, len(problem.names)))
    theta[:, which] = grid
    likelihood = problem(theta)
    worse = np.flatnonzero(likelihood < likelihood[0] - PROFILE_DROP_NATS)
    return float(grid[worse[0] - 1]) if len(worse) else math.inf


def _moves(problem: Problem, turning: bool) -> list[Moved]:
    """Return the motions in training that turn, or those that do not."""
    return [
        op
        for tape, end in zip(problem.tapes, problem.until, strict=True)
        for instant, op in tape.ops
        if isinstance(op, Moved) and tape.t[instant] < end and bends(op, MIN_CURVATURE_PER_M) == turning
    ]


def hessian(f: Callable[[Array], Array], p: int) -> Array:
    """Second derivatives (p, p) of f: (B, p) -> (B,) at zero, by central differences in one call."""
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
    """Return standard errors (p,) from the curvature H of -ln L; enormous along directions without any."""
    values, vectors = np.linalg.eigh(H)
    errors: Array = np.sqrt((vectors**2 / np.maximum(values, MIN_CURVATURE_NATS)).sum(axis=1))
    return errors
