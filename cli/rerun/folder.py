"""The Rerun scene of a results' folder: trajectories, truth and table. Its files have no scans and no gates.

A trajectory is read as `--estimate` reads one, and the truth as `--truth` does.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from msgspec.structs import replace

from locfuse.cli.session.foreign import estimates_in
from locfuse.formats.caps import MAX_REPORT
from locfuse.formats.figures.palette import traces_in
from locfuse.formats.inputs import read_small
from locfuse.formats.logs.clock import MadeStream
from locfuse.formats.logs.file_stream import read_file
from locfuse.formats.report import json_report
from locfuse.formats.rerun.scene import RerunScene
from locfuse.fusion.data import Drive, Estimates, LocfuseError, Motions, Truth
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.robot import TruthSettings
from locfuse.fusion.truth import read_truth

from .scene import palette, table_of


def scene_of(report_file: Path) -> RerunScene:
    """Return the scene of a results' folder, by its report. Raises LocfuseError for unreadable files."""
    folder = report_file.parent
    try:
        report = json_report.readable(msgspec.json.decode(read_small(report_file, MAX_REPORT)), str(report_file))
        return _scene(folder, report, report_file.name == "run.json")
    except (msgspec.DecodeError, UnicodeDecodeError, ValueError, KeyError, IndexError, TypeError) as problem:
        raise LocfuseError(f"{folder}: its files are not as locfuse writes them: {problem}") from None


def _scene(folder: Path, report: Mapping[str, Any], by_run: bool) -> RerunScene:
    """Return the scene of a results' folder.

    `by_run`: the trajectories are in trajectory.tum or .csv and smoothed.tum or .csv, else in one .tum per result.
    """
    rows = report["configurations"]
    file_of = {n: ("smoothed" if row["smoothed"] else "trajectory") if by_run else n for n, row in rows.items()}
    tracks = {name: _trajectory(folder, file) for name, file in file_of.items()}
    first = next(iter(tracks.values()))
    epoch_ns = int(first.t_ns[0])
    still = Motions(np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3, 0)))
    t = (first.t_ns - epoch_ns) * np.float64(1e-9)
    drive = Drive(epoch_ns, t, still, {}, {}, {}, _truth(folder, report, epoch_ns))
    estimates = [_estimates(track, drive, rows[name]) for name, track in tracks.items()]
    return RerunScene(
        str(report["input"]["name"]),
        drive,
        estimates,
        {e.name: evaluate(e, drive, rows[e.name]["align"]) for e in estimates},
        track=report["settings"].get("wheels", {}).get("track", 0.3),
        table=table_of(report),
        palette=palette(traces_in(report)),
    )


def _trajectory(folder: Path, name: str) -> MadeStream:
    """Return a trajectory: by the .csv, which has covariances, else by the .tum."""
    for path in (folder / f"{name}.csv", folder / f"{name}.tum"):
        if path.is_file():
            return read_file(str(path))
    raise LocfuseError(
        f"{folder} lacks {name}.tum, so there is no trajectory to show; make it again without --write"
    )


def _truth(folder: Path, report: Mapping[str, Any], epoch_ns: int) -> Truth | None:
    path, settings = folder / "truth.tum", report["settings"].get("truth", {})
    if not path.is_file() or not report["truth"]:
        return None
    point = TruthSettings(x=float(settings.get("x", 0.0)), y=float(settings.get("y", 0.0)))
    truth, _ = read_truth(read_file(str(path)), point, epoch_ns)
    return replace(truth, topic=str(report["truth"]["topic"]))


def _estimates(track: MadeStream, drive: Drive, figures: Mapping[str, Any]) -> Estimates:
    found = estimates_in(track, drive, figures["configuration"])
    if found is None:
        raise ValueError(f"{Path(track.topic).name} has fewer than two poses")
    sensors, rates = tuple(figures["sensors"]), figures["rates_hz"]
    return replace(found, sensors=sensors, smoothed=figures["smoothed"], rates=rates)
