"""Estimates of other programs as rows of a comparison: `--estimate NAME=/topic` or `NAME=file.tum`."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from typing import cast

import numpy as np

from locfuse.cli.analysis.load import Loaded
from locfuse.cli.analysis.topics import checked
from locfuse.fusion import se2
from locfuse.fusion.data import BASES, PLANE_ROWS, Array, Drive, Estimates, LocfuseError, Stream, UsageError
from locfuse.fusion.sensors.pose import WITH_COVARIANCE
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.streams import seconds
from locfuse.fusion.wheels.odometry import POSE
from locfuse.fusion.whole_drive.reference import interpolated

ESTIMATE_NAME = re.compile(r"[A-Za-z][\w.-]*")
COVARIANCE = "pose.covariance"
UPPER_TRIANGLE = np.triu_indices(3)


def named_sources(words: Sequence[str] | Mapping[str, str]) -> dict[str, str]:
    """Parse `--estimate` words NAME=SOURCE; return name -> topic or file.

    Raises UsageError if a source is missing, or if a name is invalid, reserved for a configuration, or used twice.
    """
    found: dict[str, str] = {}
    for name, source in words.items() if isinstance(words, Mapping) else (w.partition("=")[::2] for w in words):
        if not ESTIMATE_NAME.fullmatch(name) or not source:
            raise UsageError(f"--estimate {name}={source}: it reads NAME=/topic or NAME=file.tum")
        if name == "truth" or name.removesuffix("-smoothed") in {*REGISTRY, *BASES, "all"}:
            raise UsageError(f"--estimate {name}: that is the name of a configuration; choose another")
        if name in found:
            raise UsageError(f"--estimate {name}: two estimates have this name")
        found[name] = source
    return found


def foreign_estimates(loaded: Loaded, sources: Mapping[str, str], taken: Collection[str]) -> list[Estimates]:
    """Read the topics or files in `sources` (name -> source) as estimates.

    Raises UsageError for a name in `taken`, and LocfuseError for a source with fewer than two poses in the drive.
    """
    log, drive, estimates = loaded.log, loaded.drive, list[Estimates]()
    for name, source in sources.items():
        if name in taken:
            raise UsageError(f"--estimate {name}: that is the name of a configuration; choose another")
        if log.find(source) is None:
            words = f"{log.name} has no topic {source}, nor is there a .tum or .csv file"
            raise LocfuseError(f"--estimate {name}: {words}")
        try:
            stream = log.stream(checked(log, "pose", source, POSE))
        except LocfuseError as problem:
            raise LocfuseError(f"--estimate {name}: {problem}") from None
        if (found := estimates_in(stream, drive, name)) is None:
            t = seconds(stream.t_ns, drive.epoch_ns)
            span = f"{t[0]:.1f} to {t[-1]:.1f} s" if len(t) else "nothing"
            words = f"{source} covers {span} of a drive from 0 to {drive.t[-1]:.1f} s: another clock?"
            raise LocfuseError(f"--estimate {name}: {words}")
        estimates.append(found)
    return estimates


def estimates_in(stream: Stream, drive: Drive, name: str) -> Estimates | None:
    """Convert a stream of poses to estimates named `name`; None for fewer than two poses during the drive."""
    t = seconds(stream.t_ns, drive.epoch_ns)
    x, y, *q = (np.asarray(c, np.float64) for c in stream.columns(*POSE[stream.msgtype]).values())
    pose = np.stack((x, y, se2.yaw(*q)), axis=-1)
    triangles = np.zeros((len(pose), 6))  # upper triangles of covariances, 0 for a pose without one
    if stream.msgtype in WITH_COVARIANCE:
        P = np.asarray(cast("Array", stream.columns(COVARIANCE)[COVARIANCE]), np.float64).reshape(-1, 6, 6)
        P = P[:, PLANE_ROWS][:, :, PLANE_ROWS]
        given = np.isfinite(P).all(axis=(1, 2)) & (np.diagonal(P, axis1=1, axis2=2) > 0.0).all(axis=1)
        triangles[given] = P[given][:, UPPER_TRIANGLE[0], UPPER_TRIANGLE[1]]
    inside = (t >= drive.t[0]) & (t <= drive.t[-1]) & np.isfinite(pose).all(axis=1)
    inside[1:] &= np.diff(t) > 0
    if inside.sum() < 2:
        return None
    t, pose, triangles = t[inside], pose[inside], triangles[inside]
    pose[:, 2] = np.unwrap(pose[:, 2])
    at = None if drive.truth is None else interpolated(drive.truth.t, t, pose, triangles)
    return Estimates(
        configuration=name,
        sensors=(),
        t=t,
        pose=pose,
        triangles=triangles,
        audits={},
        truth_pose=None if at is None else at[0],
        truth_P=None if at is None else at[1],
    )
