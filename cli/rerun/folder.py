"""The Rerun scene of a results' folder: trajectories, truth and table. Its files have no scans and no gates."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from locfuse.formats.caps import MAX_REPORT
from locfuse.formats.figures.palette import traces_in
from locfuse.formats.inputs import read_small
from locfuse.formats.report import json_report
from locfuse.formats.rerun.scene import RerunScene
from locfuse.formats.results.trajectory import read_tum
from locfuse.fusion.data import Array, Drive, Estimates, Ints, LocfuseError, Motions, Truth, matrices
from locfuse.fusion.judge.evaluate import evaluate

from .scene import palette, table_of


def scene_of(report_file: Path) -> RerunScene:
    """Return the scene of a results' folder, by its report. Raises LocfuseError for unreadable files."""
    folder = report_file.parent
    try:
        report = json_report.readable(msgspec.json.decode(read_small(report_file, MAX_REPORT)), str(report_file))
        return _scene(folder, report, report_file.name == "run.json")
    except FileNotFoundError as problem:
        missing = Path(str(problem.filename)).name
        raise LocfuseError(
            f"{folder} lacks {missing}, so there is no trajectory to show; make it again without --write"
        ) from None
    except (msgspec.DecodeError, UnicodeDecodeError, ValueError, KeyError, IndexError, TypeError) as problem:
        raise LocfuseError(f"{folder}: its files are not as locfuse writes them: {problem}") from None


def _scene(folder: Path, report: Mapping[str, Any], by_run: bool) -> RerunScene:
    """Return the scene of a results' folder.

    `by_run`: the trajectories are in trajectory.tum and smoothed.tum, else in one .tum file per result.
    """
    rows = report["configurations"]
    tracks = {}
    for name, row in rows.items():
        file = name if not by_run else "smoothed" if row["smoothed"] else "trajectory"
        tracks[name] = t_ns, pose = read_tum((folder / f"{file}.tum").read_text())
        if len(t_ns) < 2:
            raise ValueError(f"{file}.tum has {len(t_ns)} poses")
        pose[:, 2] = np.unwrap(pose[:, 2])
    t_ns, _ = next(iter(tracks.values()))
    epoch_ns = int(t_ns[0])
    truth, stamps = _truth(folder, report, epoch_ns)
    still = Motions(np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3, 0)))
    drive = Drive(epoch_ns, _seconds(t_ns, epoch_ns), still, {}, {}, {}, truth)
    estimates = [_estimates(folder, rows[name], track, epoch_ns, stamps) for name, track in tracks.items()]
    return RerunScene(
        str(report["input"]["name"]),
        drive,
        estimates,
        {e.name: evaluate(e, drive, rows[e.name]["align"]) for e in estimates},
        track=report["settings"].get("wheels", {}).get("track", 0.3),
        table=table_of(report),
        palette=palette(traces_in(report)),
    )


def _truth(folder: Path, report: Mapping[str, Any], epoch_ns: int) -> tuple[Truth | None, Ints]:
    """Return the truth (None without one) and its stamps [ns], (q,)."""
    path = folder / "truth.tum"
    if not path.is_file() or not report["truth"]:
        return None, np.zeros(0, np.int64)
    t_ns, pose = read_tum(path.read_text())
    settings = report["settings"].get("truth", {})
    point = (float(settings.get("x", 0.0)), float(settings.get("y", 0.0)))
    theta = np.unwrap(pose[:, 2]) if report["truth"]["heading"] else None
    return Truth(str(report["truth"]["topic"]), _seconds(t_ns, epoch_ns), pose[:, :2], theta, point), t_ns


def _estimates(
    folder: Path, figures: Mapping[str, Any], track: tuple[Ints, Array], epoch_ns: int, stamps: Ints
) -> Estimates:
    """Return one result's trajectory, with covariances if trajectory.csv exists, else zeros."""
    t_ns, pose = track
    covariances = folder / ("smoothed.csv" if figures["smoothed"] else "trajectory.csv")
    triangles = np.zeros((len(t_ns), 6))
    if covariances.is_file():
        triangles = np.loadtxt(covariances, delimiter=",", skiprows=1, ndmin=2)[:, 4:10]
    if len(triangles) != len(t_ns):
        raise ValueError(f"{covariances.name} has {len(triangles)} rows, the trajectory {len(t_ns)}")
    at = np.minimum(np.searchsorted(t_ns, stamps), len(t_ns) - 1)
    known = t_ns[at] == stamps  # a .tum has a row at every truth stamp within the drive
    return Estimates(
        figures["configuration"],
        tuple(figures["sensors"]),
        _seconds(t_ns, epoch_ns),
        pose,
        triangles,
        {},
        truth_pose=np.where(known[:, None], pose[at], np.nan),
        truth_P=matrices(triangles[at]),
        smoothed=figures["smoothed"],
        rates=figures["rates_hz"],
    )


def _seconds(t_ns: Ints, epoch_ns: int) -> Array:
    return (t_ns - epoch_ns) * np.float64(1e-9)
