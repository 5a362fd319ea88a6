"""A results' folder as a scene: trajectories, truth, table. Scans and gates are not in its files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from locfuse.formats.caps import MAX_REPORT
from locfuse.formats.figures.palette import traces_in
from locfuse.formats.inputs import read_small
from locfuse.formats.logs.files import REPORTS
from locfuse.formats.report import json_report
from locfuse.formats.rerun.scene import RerunScene
from locfuse.formats.results.trajectory import read_tum
from locfuse.fusion.data import Array, Drive, Estimates, Ints, LocfuseError, Motions, Truth, matrices
from locfuse.fusion.judge.evaluate import evaluate

from .scene import palette, table_of

TRUTH = "truth.tum"
COVARIANCE, SMOOTHED = "trajectory.csv", "smoothed.csv"


def report_of(folder: Path) -> Path | None:
    """Return the report of a folder of results, None without one."""
    return next((folder / name for name in REPORTS if (folder / name).is_file()), None)


def scene_of(folder: Path) -> RerunScene:
    """Return the scene of a results' folder. Raises LocfuseError if its files cannot be read."""
    path = report_of(folder)
    if path is None:
        raise LocfuseError(f"{folder} holds no locfuse result: neither report.json nor run.json")
    try:
        report = json_report.readable(msgspec.json.decode(read_small(path, MAX_REPORT)), str(path))
        rows = report["configurations"]
        tracks = {name: _track(folder / _file(name, rows[name], path.name)) for name in rows}
        return _scene(folder, report, tracks)
    except FileNotFoundError as problem:
        missing = Path(str(problem.filename)).name
        raise LocfuseError(
            f"{folder} lacks {missing}, so there is no trajectory to show; make it again without --write"
        ) from None
    except (msgspec.DecodeError, UnicodeDecodeError, ValueError, KeyError, IndexError, TypeError) as problem:
        raise LocfuseError(f"{folder}: its files are not as locfuse writes them: {problem}") from None


def _file(name: str, row: Mapping[str, Any], report: str) -> str:
    """Return the trajectory of one result: `run` names the file by its kind, `compare` by the result."""
    if report == "run.json":
        return "smoothed.tum" if row["smoothed"] else "trajectory.tum"
    return f"{name}.tum"


def _track(file: Path) -> tuple[Ints, Array]:
    """Return t_ns (n,) and poses (n, 3), theta unwrapped, of one result."""
    t_ns, pose = read_tum(file.read_text())
    if len(t_ns) < 2:
        raise ValueError(f"{file.name} has {len(t_ns)} poses")
    pose[:, 2] = np.unwrap(pose[:, 2])
    return t_ns, pose


def _scene(folder: Path, report: Mapping[str, Any], tracks: Mapping[str, tuple[Ints, Array]]) -> RerunScene:
    t_ns = next(iter(tracks.values()))[0]
    truth, stamps = _truth(folder, report, int(t_ns[0]))
    t = seconds(t_ns, int(t_ns[0]))
    still = Motions(np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3, 0)))
    drive = Drive(int(t_ns[0]), t, still, {}, {}, {}, truth)
    estimates = [
        _estimates(folder, report["configurations"][name], track, int(t_ns[0]), stamps)
        for name, track in tracks.items()
    ]
    judged = {e.name: evaluate(e, drive, report["configurations"][e.name]["align"]) for e in estimates}
    track_width = report["settings"].get("wheels", {}).get("track", 0.3)
    return RerunScene(
        str(report["input"]["name"]),
        drive,
        estimates,
        judged,
        track=track_width,
        table=table_of(report),
        palette=palette(traces_in(report)),
    )


def _truth(folder: Path, report: Mapping[str, Any], epoch_ns: int) -> tuple[Truth | None, Ints]:
    """Return the truth and its stamps [ns], (q,)."""
    path = folder / TRUTH
    if not path.is_file() or not report["truth"]:
        return None, np.zeros(0, np.int64)
    t_ns, pose = read_tum(path.read_text())
    settings = report["settings"].get("truth", {})
    point = (float(settings.get("x", 0.0)), float(settings.get("y", 0.0)))
    theta = np.unwrap(pose[:, 2]) if report["truth"]["heading"] else None
    return Truth(str(report["truth"]["topic"]), seconds(t_ns, epoch_ns), pose[:, :2], theta, point), t_ns


def _estimates(
    folder: Path,
    figures: Mapping[str, Any],
    track: tuple[Ints, Array],
    epoch_ns: int,
    stamps: Ints,
) -> Estimates:
    t_ns, pose = track
    triangles = _covariances(folder / (SMOOTHED if figures["smoothed"] else COVARIANCE), len(t_ns))
    at = np.minimum(np.searchsorted(t_ns, stamps), len(t_ns) - 1)
    known = t_ns[at] == stamps  # a .tum has a row at every truth stamp within the drive
    truth_pose = np.where(known[:, None], pose[at], np.nan)
    t = seconds(t_ns, epoch_ns)
    return Estimates(
        figures["configuration"],
        tuple(figures["sensors"]),
        t,
        pose,
        triangles,
        {},
        truth_pose=truth_pose,
        truth_P=matrices(triangles[at]),
        smoothed=figures["smoothed"],
        rates=figures["rates_hz"],
    )


def seconds(t_ns: Ints, epoch_ns: int) -> Array:
    """Return stamps as seconds since an epoch."""
    return (t_ns - epoch_ns) * np.float64(1e-9)


def _covariances(path: Path, n: int) -> Array:
    """Return the triangles (n, 6) of P that a run wrote beside its trajectory, zeros without them."""
    if not path.is_file():
        return np.zeros((n, 6))
    upper = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)[:, 4:10]
    if len(upper) != n:
        raise ValueError(f"{path.name} has {len(upper)} rows, the trajectory {n}")
    return upper
