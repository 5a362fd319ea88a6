"""Figure 14 of the paper: the way a robot really takes when it steers on odometry, and on the EKF."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import NamedTuple

import numpy as np

from locfuse.formats.figures.panels import Curve, Panel, Strokes
from locfuse.fusion.data import Array, Colour
from locfuse.sample_logs.load import load
from locfuse.sample_logs.paths import polygon
from locfuse.sample_logs.record import in_memory
from locfuse.sample_logs.scenario import Polygon

from .simulate import localise

PATHS = {"a": "rounded_rectangle", "b": "rounded_triangle"}
WITHOUT, WITH, INTENDED, WALLS = "steered on odometry", "steered on the EKF", "path", "walls"
INKS = {
    WITHOUT: Colour("#cb7627", "#ec8c10"),
    WITH: Colour("#1a34b0", "#3a78de"),
    INTENDED: Colour("#0d0f12", "#f4f5f7"),
    WALLS: Colour("#9aa3af", "#667080"),
}
LOOKS = {WITHOUT: "dash", WITH: "over"}  # the path is seen in the gaps of the way on the EKF
SEED = 1


class Driven(NamedTuple):
    """One drive of one scenario."""

    scenario: str
    seed: int
    xy: Array  # (n, 2) m, where the robot really was
    path: Array  # (m, 2) m, where it should have been


class Distance(NamedTuple):
    """How far from its path a robot was."""

    figure: str  # "14 a"
    steered: str
    rms: float  # m
    largest: float  # m


def drives(seed: int = SEED, jobs: int = 2) -> dict[str, Driven]:
    """Drive both paths with and without the EKF in the loop."""
    names = [name for path in PATHS.values() for name in (path, f"{path}_ekf")]
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        return dict(zip(names, pool.map(drive, names, [seed] * len(names)), strict=True))


def drive(scenario: str, seed: int) -> Driven:
    """Drive a scenario with its own estimator in the loop."""
    chosen = load(scenario)
    if not isinstance(chosen.path, Polygon):
        raise TypeError(f"{scenario} follows no closed path")
    *_, outcome = in_memory(chosen, seed, localise(chosen.control.estimator))
    return Driven(scenario, seed, outcome.truth[::10, :2], polygon(chosen.path).pose[:, :2])


def distances(driven: Driven) -> Array:
    """Return the distance of every point driven to the nearest point of the path, (n,) m; it has one every cm."""
    return np.array([np.hypot(*(driven.path - p).T).min() for p in driven.xy])


def table(driven: Mapping[str, Driven]) -> Iterator[Distance]:
    """Yield a row per drive."""
    for letter, path in PATHS.items():
        for name, steered in ((path, WITHOUT), (f"{path}_ekf", WITH)):
            d = distances(driven[name])
            yield Distance(f"14 {letter}", steered, float(np.sqrt((d**2).mean())), float(d.max()))


def panels(driven: Mapping[str, Driven]) -> list[Panel]:
    """Return figures 14 a and 14 b."""
    return [_panel(letter, driven[path], driven[f"{path}_ekf"]) for letter, path in PATHS.items()]


def _panel(letter: str, without: Driven, with_ekf: Driven) -> Panel:
    room = load(without.scenario).room
    x, y = room.size
    sides = [((0, 0), (x, 0)), ((x, 0), (x, y)), ((x, y), (0, y)), ((0, y), (0, 0))]
    ends = np.array([*sides, *(((a, b), (c, d)) for a, b, c, d in room.plates)], float)
    closed = np.concatenate((without.path, without.path[:1]))
    curves = {INTENDED: closed, WITHOUT: without.xy, WITH: with_ekf.xy}
    title = f"Figure 14 {letter}: {without.scenario.replace('_', ' ')}"
    return Panel(
        name=f"fig14{letter}",
        title=title,
        y_label="y, m",
        x_label="x, m",
        marks=(Strokes(WALLS, ends), *(Curve(of, xy[:, 0], xy[:, 1]) for of, xy in curves.items())),
        summary=f"{title}: the way that the robot really took, steered on odometry and on the EKF.",
        equal=True,
        keys=(INTENDED, WITHOUT, WITH),
    )
