"""What is measured of one drive in `benchmarks.consistency`, and the mean over drives."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from locfuse.fusion.data import Drive, Estimates, Evaluation
from locfuse.fusion.judge.evaluate import evaluate

Span = tuple[float, float]  # s since the first wheel reading: from, to
POSITION = "position_rmse_m"


class Figures(NamedTuple):
    """One drive, judged against the truth."""

    anees: float  # of x, y and heading together, per degree of freedom: 1 is right
    position: float  # mm, rmse as estimated
    aligned: float  # mm, rmse after the best rigid motion onto the truth: the shape alone
    inside: float  # share of all errors of x, y and heading within 3 of their sigmas
    walls: float  # smallest sigma of a map line's direction at the end, over that of the heading at the first scan
    in_frame: float = math.nan  # mm, error of the shape of the path within the map's frame, where it is asked for


class Means(NamedTuple):
    """All drives of one case."""

    drives: int
    anees: float
    anees_worst: float
    position: float  # mm
    aligned: float  # mm
    aligned_worst: float  # mm
    inside: float
    walls: float  # of all drives the smallest
    in_frame: float = math.nan  # mm


def figures(
    estimates: Estimates, drive: Drive, aligned_from: float = 0.0, unknowable: Span = (0.0, 0.0)
) -> Figures:
    """Judge one run except where it says that it is lost, and in the `unknowable` span [s].

    The aligned error counts from `aligned_from` [s] on.
    """
    judged = evaluate(without(estimates, drive, (*estimates.lost, unknowable)), drive)
    early = (-math.inf, aligned_from)
    aligned = evaluate(without(estimates, drive, (*estimates.lost, unknowable, early)), drive, align="se2")
    return Figures(
        number(judged.figures["anees"]),
        1000 * number(judged.figures[POSITION]),
        1000 * number(aligned.figures[POSITION]),
        inside(judged),
        walls_kept(estimates, drive),
    )


def number(value: float | None) -> float:
    """Return a figure, NaN where there is none."""
    return math.nan if value is None else value


def without(estimates: Estimates, drive: Drive, spans: Sequence[Span]) -> Estimates:
    """Return the estimates without what they say of the truth's stamps inside any of the spans [s]."""
    if drive.truth is None or estimates.truth_pose is None:
        return estimates
    t = drive.truth.t
    hidden = np.any([(t >= begin) & (t < end) for begin, end in spans], axis=0)
    return replace(estimates, truth_pose=np.where(hidden[:, None], np.nan, estimates.truth_pose))


def inside(judged: Evaluation) -> float:
    """Return the share of the errors of x, y and heading within 3 sigma; where sigma is 0, nothing is judged."""
    assert judged.heading is not None
    errors = np.column_stack((judged.deviation, judged.heading))
    stated = judged.sigma > 0
    return float((np.abs(errors) <= 3 * judged.sigma)[stated].mean())


def walls_kept(estimates: Estimates, drive: Drive) -> float:
    """Return the smallest sigma of a line's direction at the end over that of the heading at the first scan.

    With a laser alone it cannot honestly be below 1: every direction in the map hangs on that one heading.
    """
    first = drive.instant["lrf"][0]
    heading = math.sqrt(estimates.triangles[first, 5])
    directions = [math.sqrt(line.P_map[1, 1]) for line in estimates.final_map]
    return min(directions) / heading if directions and heading > 0 else math.nan


def means(found: Sequence[Figures]) -> Means:
    """Return the mean and worst figures over drives."""
    table = np.array(found)
    anees, position, aligned, within, walls, in_frame = table.T
    return Means(
        len(found),
        float(anees.mean()),
        float(anees.max()),
        float(position.mean()),
        float(aligned.mean()),
        float(aligned.max()),
        float(within.mean()),
        float(walls.min()),
        float(in_frame.mean()),
    )
