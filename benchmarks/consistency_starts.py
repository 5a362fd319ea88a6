"""What the drawn starts alone do to `benchmarks.consistency`: the figures of a filter that errs nowhere else.

Where nothing observes the start, its error is one draw per drive, and every later error of that drive is that
draw again. So thirty drives are thirty draws, however many instants they have, and a single draw near 3 sigma
takes most of its drive's instants with it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from locfuse.fusion.data import Array
from locfuse.fusion.kernels.ekf import bent
from locfuse.sample_logs.messages import streams

SETS = 2000  # of so many drives each, drawn to see what chance does
ENOUGH = 0.99  # share of errors within 3 sigma


class Start(NamedTuple):
    """The sigmas of a start."""

    theta: float  # rad
    xy: float  # m


class Alone(NamedTuple):
    """What the starts alone give."""

    anees: float
    inside: float  # share of errors of x, y and heading within 3 sigma


def alone(start: Start, way: Array, seeds: Iterable[int]) -> Alone:
    """Return what the starts of these drives alone give along the way (n, 2) [m] from the start."""
    drawn = np.array([streams(seed)("start").standard_normal(3) for seed in seeds])
    return Alone(float(np.square(drawn).mean()), float(inside(drawn, start, way).mean()))


def often_short(start: Start, way: Array, drives: int) -> float:
    """Return the share of sets of so many other drives whose starts alone leave less than ENOUGH inside."""
    others = np.random.default_rng(0).standard_normal((SETS * drives, 3))
    shares = inside(others, start, way).reshape(SETS, drives).mean(axis=1)
    return float((shares < ENOUGH).mean())


def inside(drawn: Array, start: Start, way: Array) -> Array:
    """Return which share of a drive's errors lies within 3 sigma (k,), by draws (k, 3) of its start.

    An error of the start moves and turns the whole drive. The covariance is the start's, carried along the way as
    it is believed: across a lever r by the heading's variance, along it by E (cos a - 1)^2 of a Gaussian angle a.
    """
    off = drawn * (start.xy, start.xy, start.theta)
    c, s = np.cos(off[:, 2:]), np.sin(off[:, 2:])
    x, y = c * way[:, 0] - s * way[:, 1], s * way[:, 0] + c * way[:, 1]  # (k, n) m, as believed
    turned = start.theta**2
    along = bent(turned)
    heading = np.broadcast_to(off[:, 2:], x.shape)
    errors = np.abs([off[:, :1] + x - way[:, 0], off[:, 1:2] + y - way[:, 1], heading])
    variances = [start.xy**2 + y * y * turned + along * x * x, start.xy**2 + x * x * turned + along * y * y]
    limits = 3.0 * np.sqrt([*variances, np.full(x.shape, turned)])
    share: Array = (errors <= limits).mean(axis=(0, 2))
    return share


def start_of(sets: Iterable[str]) -> Start | None:
    """Return the sigmas of the start that a scenario's settings state; None: it is known exactly."""
    stated = dict(one.split("=", 1) for one in sets)
    if "start.sigma_theta_deg" not in stated:
        return None
    return Start(math.radians(float(stated["start.sigma_theta_deg"])), float(stated["start.sigma_xy"]))
