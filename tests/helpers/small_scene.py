"""What a report shows, made of random numbers: pages of any length without running a filter."""

import math
from typing import Any

import numpy as np
import small_drive

from locfuse.cli.analysis.verdicts import prediction_values, verdicts
from locfuse.formats.figures.panels import Scene
from locfuse.formats.report import json_report
from locfuse.fusion.data import (
    Array,
    Audit,
    Component,
    Drive,
    Estimates,
    Evaluation,
    MapLine,
    Motions,
    SensorFigures,
    Truth,
    upper_triangles,
)
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate, running_nis
from locfuse.fusion.judge.without_truth import listeners, scores

NAMES = ("odometry", "compass", "lrf", "camera", "compass+lrf", "all")
COMPONENTS = {
    "compass": (Component("heading", "deg", 57.3),),
    "lrf": (Component("r", "m", 1.0), Component("psi", "deg", 57.3)),
    "camera": (Component("bearing", "deg", 57.3),),
}
SOURCE: dict[str, Any] = {
    "name": "made_up",
    "files": ["made_up.mcap"],
    "sha256": "0" * 64,
    "topics": {"wheels": "/joint_states", "truth": "/ground_truth"},
    "messages": {"/joint_states": 10, "/ground_truth": 10},
    "losses": {},
}


def long(minutes: float, configurations: int) -> tuple[Scene, dict[str, Any]]:
    """A drive of noise: truth at 50 Hz, four lines per scan at 10 Hz, nothing smooth that could be left out."""
    rng = np.random.default_rng(0)
    t = np.arange(0.0, 60.0 * minutes, 1 / 30.0)
    q = np.arange(0.0, 60.0 * minutes, 1 / 50.0)
    drive = _drive(t, q)
    found = [_configuration(name, drive, t, q, rng) for name in NAMES[:configurations]]
    estimates, judged = [e for e, _ in found], [j for _, j in found]
    scene = Scene(
        drive=drive,
        estimates=estimates,
        evaluations=judged,
        nis={(e.name, s): running_nis(a, e.t) for e in estimates for s, a in e.audits.items()},
        nees_bounds=(0.07, 3.1),
        components=COMPONENTS,
    )
    report = json_report.report(drive, judged, SOURCE, {"wheels": {"radius": 0.05}}, "0.0")
    return scene, {**report, "verdicts": {}, "credit": None, "prediction": None}


def untrue() -> tuple[Scene, dict[str, Any]]:
    """A real run over a drive without truth."""
    robot = small_drive.robot()
    drive = small_drive.drive(1, robot, laps=0.3, truth=False)
    sets = {"odometry": (), "compass": ("compass",), "lrf": ("lrf",), "all": ("compass", "lrf")}
    estimates = [fuse(drive, robot, s) for s in sets.values()]
    judged = [evaluate(e, drive) for e in estimates]
    found = scores(drive, [fuse(drive, robot, s, n, listeners(drive, s)) for n, s in sets.items()])
    report = json_report.report(drive, judged, SOURCE, {"order": "auto"}, "0.0")
    report |= {
        "verdicts": verdicts(None, found, sets),
        "credit": None,
        "prediction": prediction_values(found, list(sets)),
    }
    return Scene(drive, estimates, judged, components=COMPONENTS), report


def _drive(t: Array, q: Array) -> Drive:
    empty = Motions(np.zeros((len(t), 3)), np.zeros((len(t), 3, 3)), np.zeros((len(t), 3, 0)))
    xy = np.stack((3 + 2 * np.cos(q / 9), 3 + 2 * np.sin(q / 9)), axis=-1)
    truth = Truth("/ground_truth", q, xy, q / 9)
    return Drive(0, t, empty, {"compass": None, "lrf": None, "camera": None}, {}, {}, truth)  # type: ignore[dict-item]


def _configuration(
    name: str, drive: Drive, t: Array, q: Array, rng: np.random.Generator
) -> tuple[Estimates, Evaluation]:
    assert drive.truth is not None
    sensors = {"odometry": (), "all": ("compass", "lrf", "camera")}.get(name, tuple(name.split("+")))
    audits = {s: _audit(s, t, rng) for s in sensors}
    noise = 0.005 * rng.normal(size=(len(q), 2))
    heading = 0.01 * rng.normal(size=len(q))
    pose = np.column_stack([np.interp(t, q, c) for c in (*drive.truth.xy.T, q / 9)])
    pose[:, :2] += 0.002 * rng.normal(size=(len(t), 2))
    walls = [MapLine(i, 6.0, i * math.pi / 2, (-3.0, 3.0), np.eye(2)) for i in range(4)]
    blocks = {"compass_offset": 0.01 * rng.normal(size=(len(t), 1))} if "compass" in sensors else {}
    estimates = Estimates(
        name,
        sensors,
        t,
        pose,
        np.tile(upper_triangles(np.eye(3) * 1e-4), (len(t), 1)),
        audits,
        blocks,
        {k: np.full_like(v, 0.01) for k, v in blocks.items()},
        walls[:2],
        walls,
    )
    figures = dict.fromkeys(("position_rmse_m", "x_rmse_m", "heading_rmse_deg", "anees"), 0.5)
    counts = {s: SensorFigures(9, 1, 0, 1.0, None, {"accepted": 9, "gate": 1}) for s in sensors}
    judged = Evaluation(
        name,
        counts,
        {**figures, "duration_s": 60.0, "distance_m": 9.0},
        q,
        noise,
        heading,
        noise,
        np.full((len(q), 3), 0.01) * (1 + 0.3 * rng.random((len(q), 1))),
        rng.chisquare(3, len(q)) / 3,
        q * 0.3,
        drive.truth.xy + noise,
    )
    return estimates, judged


def _audit(sensor: str, t: Array, rng: np.random.Generator) -> Audit:
    lines, width = (4, 2) if sensor == "lrf" else (1, 1)
    instant = np.repeat(np.arange(0, len(t), 3), lines)
    n = len(instant)
    y = 0.02 * rng.normal(size=(n, width))
    verdict = np.where(rng.random(n) < 0.9, 0, rng.integers(1, 5, n)).astype(np.int8)
    sigma = np.full((n, width), 0.02) * (1 + rng.random((n, width)))
    return Audit(
        instant,
        np.arange(n),
        verdict,
        np.zeros(n, dtype=np.int64),
        rng.chisquare(width, n),
        np.full(n, 9.0),
        y,
        sigma,
    )
