"""Trilateration along a path: the start of a drive among known anchors, or an anchor's place beside a drive.

With the detector at s_k by the wheels, in the frame of the robot at the first range, and an anchor a,

    range_k = |p + R(theta) s_k - a| + offset + noise     unknown p, theta: the start among known anchors
    range_k = |s_k - a| + offset + noise                  unknown a: an anchor beside a known path

Ranges alone leave several answers (mirror images, a drive that does not turn). So a grid of guesses is refined by
Levenberg and Marquardt's method with Cauchy weights (Nocedal and Wright 2006, 10.3; a reflection counts for
little), and the best answer counts only where no other one fits nearly as well.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.chi_square import MAD
from locfuse.fusion.data import Array

STRETCHES_S = (5.0, 10.0, 20.0, 40.0, 80.0)  # of the drive: the shortest that tells; the wheels drift
MIN_ROWS = 8
MAX_FIT_ROUNDS = 60  # of the refinement, at most
SAME_DIGITS = 3  # of m and rad: answers that agree so far are one
CAUCHY_SIGMAS = 2.0  # residuals from which a range counts for less
CLEARLY_BETTER = 8.0  # by which the best answer's cost (half a chi-square) must lie below any other's
APART_M, APART_RAD = 0.3, math.radians(20.0)  # answers further apart are different ones
MAX_SIGMA_M, MAX_SIGMA_RAD = 0.5, math.radians(15.0)  # of an answer that counts
GRID, DIRECTIONS = 5, 12  # places along each side of the anchors' box; directions of the first guess
HEADING_ENTRY = slice(2, -1)  # of what is looked for: between the place and the offset a heading, or nothing
Predict = Callable[[Array], tuple[Array, Array]]  # guesses (s, k) -> ranges (s, n), derivatives (s, n, k)


class Answer(NamedTuple):
    """The best fit to the ranges."""

    values: Array  # (k,) x, y [m], perhaps theta [rad]; last the offset of the ranges [m]
    covariance: Array  # (k, k)


def start_among(
    anchors: Array, seen: Array, t: Array, ranges: Array, sigmas: tuple[float, float]
) -> Answer | None:
    """Return the pose x, y, theta of the robot at the first of n ranges, and their offset; or None.

    anchors (n, 2) [m, map frame] of each range, `seen` (n, 2) [m] the places of the detector by the wheels, in the
    frame of the robot at the first range, t (n,) [s], ranges (n,) [m]; `sigmas` of a range and of the offset [m].
    """
    low, high = anchors.min(axis=0), anchors.max(axis=0)
    margin = 0.25 * float(np.hypot(*(high - low)))
    x, y = (np.linspace(a - margin, b + margin, GRID) for a, b in zip(low, high, strict=True))
    turns = np.arange(DIRECTIONS) * (2.0 * np.pi / DIRECTIONS)
    guesses = np.stack([g.ravel() for g in np.meshgrid(x, y, turns, [0.0], indexing="ij")], axis=-1)

    def predict(n: int) -> Predict:
        def ranges_of(v: Array) -> tuple[Array, Array]:
            c, s = np.cos(v[:, 2:3]), np.sin(v[:, 2:3])
            ahead, left = c * seen[:n, 0] - s * seen[:n, 1], s * seen[:n, 0] + c * seen[:n, 1]
            dx, dy = v[:, 0:1] + ahead - anchors[:n, 0], v[:, 1:2] + left - anchors[:n, 1]
            h = np.maximum(np.hypot(dx, dy), 1e-6)
            J = np.stack((dx / h, dy / h, (dy * ahead - dx * left) / h, np.ones_like(h)), axis=-1)
            return h + v[:, 3:4], J

        return ranges_of

    return _shortest(predict, guesses, t, ranges, sigmas)


def anchor_beside(seen: Array, t: Array, ranges: Array, sigmas: tuple[float, float]) -> Answer | None:
    """Return an anchor's place in the frame of `seen` (n, 2) [m], and the offset; None if it is ambiguous."""
    turns = np.arange(DIRECTIONS) * (2.0 * np.pi / DIRECTIONS)
    around = seen[0] + ranges[0] * np.stack((np.cos(turns), np.sin(turns)), axis=-1)
    guesses = np.column_stack((around, np.zeros(DIRECTIONS)))

    def predict(n: int) -> Predict:
        def ranges_of(v: Array) -> tuple[Array, Array]:
            dx, dy = v[:, 0:1] - seen[:n, 0], v[:, 1:2] - seen[:n, 1]
            h = np.maximum(np.hypot(dx, dy), 1e-6)
            return h + v[:, 2:3], np.stack((dx / h, dy / h, np.ones_like(h)), axis=-1)

        return ranges_of

    return _shortest(predict, guesses, t, ranges, sigmas)


def _shortest(
    predict: Callable[[int], Predict], guesses: Array, t: Array, ranges: Array, sigmas: tuple[float, float]
) -> Answer | None:
    """Return the fit of the shortest part of the drive with a clear one."""
    tried = 0
    for seconds in STRETCHES_S:
        n = int(np.searchsorted(t, t[0] + seconds, side="right"))
        if n < MIN_ROWS or n == tried:
            continue
        tried = n
        answer = _clear(predict(n), guesses, ranges[:n], sigmas)
        if answer is not None:
            return answer
    return None


def _clear(predict: Predict, guesses: Array, ranges: Array, sigmas: tuple[float, float]) -> Answer | None:
    """Return the best fit if it is certain enough and no other one is nearly as good."""
    values, costs, scatter = _refined(predict, guesses, ranges, sigmas)
    best = values[np.argmin(costs)]
    _, J = predict(best[None])
    information = np.einsum("nj,nk->jk", J[0], J[0]) / max(sigmas[0], scatter) ** 2
    information[-1, -1] += 1.0 / sigmas[1] ** 2
    if np.linalg.cond(information) > 1e12:
        return None
    covariance: Array = np.linalg.inv(information)
    sigma = np.sqrt(np.diag(covariance))
    if np.hypot(sigma[0], sigma[1]) > MAX_SIGMA_M or (sigma[HEADING_ENTRY] > MAX_SIGMA_RAD).any():
        return None
    elsewhere = np.hypot(*(values[:, :2] - best[:2]).T) > APART_M
    elsewhere |= (np.abs(se2.wrap_all(values[:, HEADING_ENTRY] - best[HEADING_ENTRY])) > APART_RAD).any(axis=1)
    rival = costs[elsewhere].min(initial=np.inf)
    return Answer(best, covariance) if rival - costs.min() > CLEARLY_BETTER else None


def _refined(
    predict: Predict, guesses: Array, ranges: Array, sigmas: tuple[float, float]
) -> tuple[Array, Array, float]:
    """Return refined guesses (s, k), their costs (s,), and the scatter of the ranges about the best one [m].

    The costs are in units of that scatter where it is more than the sigma: wheels that drift make it so.
    """
    sigma, x = sigmas[0], guesses
    for _ in range(2):  # with the ranges' sigma, then with the scatter that was found
        x, costs = _descended(predict, x, ranges, (sigma, sigmas[1]))
        h, _ = predict(x[np.argmin(costs)][None])
        scatter = float(np.median(np.abs(ranges - h[0]))) / MAD
        sigma = max(sigmas[0], scatter)
        x[:, HEADING_ENTRY] = se2.wrap_all(x[:, HEADING_ENTRY])
        _, first = np.unique(np.round(x, SAME_DIGITS), axis=0, return_index=True)
        x, costs = x[first], costs[first]  # most guesses come to the same few answers
    return x, costs, scatter


def _descended(predict: Predict, x: Array, ranges: Array, sigmas: tuple[float, float]) -> tuple[Array, Array]:
    """Return guesses (s, k) after MAX_FIT_ROUNDS of Levenberg-Marquardt steps, and their costs (s,)."""
    damping = np.full(len(x), 1e-2)
    cost, A, g = _normal(predict, x, ranges, sigmas)
    diagonal = np.arange(x.shape[1])
    for _ in range(MAX_FIT_ROUNDS):
        damped = A.copy()
        damped[:, diagonal, diagonal] *= 1.0 + damping[:, None]
        damped[:, diagonal, diagonal] += 1e-9
        tried = x + np.linalg.solve(damped, g[:, :, None])[:, :, 0]
        cost_there, A_there, g_there = _normal(predict, tried, ranges, sigmas)
        better = cost_there < cost
        if not better.any():
            break
        x = np.where(better[:, None], tried, x)
        cost = np.where(better, cost_there, cost)
        A, g = np.where(better[:, None, None], A_there, A), np.where(better[:, None], g_there, g)
        damping = np.clip(np.where(better, damping / 3.0, damping * 4.0), 1e-6, 1e6)
    return x, cost


def _normal(predict: Predict, x: Array, ranges: Array, sigmas: tuple[float, float]) -> tuple[Array, Array, Array]:
    """Return the cost (s,), and the normal equations A (s, k, k), g (s, k) of its descent."""
    h, J = predict(x)
    e = (ranges - h) / sigmas[0]
    square = np.square(e / CAUCHY_SIGMAS)
    cost = 0.5 * (CAUCHY_SIGMAS**2 * np.log1p(square).sum(axis=1) + np.square(x[:, -1] / sigmas[1]))
    weight = 1.0 / (1.0 + square)
    A = np.einsum("sn,snj,snk->sjk", weight, J, J) / sigmas[0] ** 2
    g = np.einsum("sn,snj->sj", weight * e, J) / sigmas[0]
    A[:, -1, -1] += 1.0 / sigmas[1] ** 2
    g[:, -1] -= x[:, -1] / sigmas[1] ** 2
    return cost, A, g
