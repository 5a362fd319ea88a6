"""A building: relation errors as they are defined, and the growing map on the first minutes of a real one."""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace
from numpy.typing import NDArray

from benchmarks.building import contained, relation_errors
from benchmarks.real_logs import KNOWN
from locfuse.cli.analysis.load import load
from locfuse.cli.analysis.settings import LogOptions, set_words
from locfuse.fusion import se2
from locfuse.fusion.data import Drive, Motions
from locfuse.fusion.fuse import fuse

Array = NDArray[np.float64]
DATA = os.environ.get("LOCFUSE_DATA")
MINUTES = 3.0


def circle(n: int = 200) -> tuple[Array, Array]:
    """Poses on a circle of 2 m, one turn in 20 s."""
    t = np.linspace(0.0, 20.0, n)
    a = 2.0 * math.pi * t / 20.0
    return t, np.stack((2.0 * np.sin(a), 2.0 - 2.0 * np.cos(a), a), axis=-1)


def relations(t: Array, pose: Array, pairs: list[tuple[int, int]]) -> Array:
    """What is true between pairs of poses, as a file of relations says it."""
    steps = [(t[i], t[j], *se2.between(pose[i], pose[j])[:2], pose[j, 2] - pose[i, 2]) for i, j in pairs]
    return np.insert(np.array(steps), [4, 4, 4], 0.0, axis=1)


def test_relations_are_blind_to_the_frame_and_see_a_bend() -> None:
    """Moved and turned as a whole a trajectory is as good as before; bent by 5 degrees in the middle it is not."""
    t, pose = circle()
    table = relations(t, pose, [(0, 50), (20, 120), (10, 190)])
    moved = se2.compose(np.array([3.0, -1.0, 2.5]), pose)
    translation, rotation = relation_errors(t, moved, table)
    assert translation.max() < 1e-9
    assert rotation.max() < 1e-9
    bent = pose.copy()
    pivot = np.array([*pose[80, :2], 0.0])
    bend = np.array([0.0, 0.0, math.radians(5.0)])
    bent[80:] = se2.compose(pivot, se2.compose(bend, se2.between(pivot, pose[80:])))
    translation, rotation = relation_errors(t, bent, table)
    assert np.degrees(rotation) == pytest.approx([0.0, 5.0, 5.0], abs=1e-6)
    ahead = np.hypot(*(pose[120, :2] - pose[80, :2]))
    assert translation[:2] == pytest.approx([0.0, 2.0 * ahead * math.sin(math.radians(2.5))], abs=1e-6)


def first(drive: Drive, seconds: float) -> Drive:
    """The beginning of a drive."""
    k = int(np.searchsorted(drive.t, seconds))
    m, at = drive.measurements["lrf"], drive.instant["lrf"]
    n = int(np.searchsorted(at, k))
    motions = Motions(*(a[:k] for a in (drive.motions.u, drive.motions.Q, drive.motions.J)))
    return replace(
        drive,
        t=drive.t[:k],
        motions=motions,
        measurements={"lrf": m.take(np.arange(n))},
        instant={"lrf": at[:n]},
        truth=None,
        truth_motions=None,
        truth_instant=None,
    )


@pytest.mark.skipif(DATA is None, reason="LOCFUSE_DATA is not set: no real building to map")
def test_the_map_of_a_real_corridor_is_as_good_as_its_covariance_says() -> None:
    folder = Path(str(DATA)) / "fr079"
    loaded = load([folder / "fr079.mcap"], LogOptions(None, set_words(KNOWN["fr079"]), None, False, True))
    drive = first(loaded.drive, 60.0 * MINUTES)
    found = fuse(drive, loaded.robot, ["lrf"])
    table = np.loadtxt(folder / "fr079.relations")
    table[:, :2] += 1e9 - drive.epoch_ns * 1e-9
    translation, rotation = relation_errors(found.t, found.pose, table)
    assert len(translation) > 100
    assert translation.mean() < 0.06
    assert np.degrees(rotation.mean()) < 1.0
    assert contained(found, table, translation) > 0.9
    assert found.lost == ()
    assert len(found.final_map) < 250  # merged and pruned: 1500 scans showed some 8000 lines
