"""How well does a growing map hold a whole building? Relation errors (Kümmerle et al. 2009), also perturbed.

A relation is `t1 t2 dx dy dz droll dpitch dyaw`: pose 2 seen from pose 1, verified by hand. Its error needs no
common frame, so it judges a map's shape where no truth exists.

    LOCFUSE_DATA=... python -m benchmarks.building --runs 10
    LOCFUSE_DATA=... python -m benchmarks.building --log aces --runs 0 --smooth

The log is measured anew for every run: with extra range noise, with scans dropped, and from another start heading.
The relations are between scans, so the stamps are those of the scans: it is the wheels that are 0.13 s off.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click
import numpy as np
from msgspec.structs import replace

from benchmarks.real_logs import KNOWN, folder
from locfuse.cli.analysis.load import load
from locfuse.cli.analysis.settings import LogOptions, set_words
from locfuse.fusion import se2
from locfuse.fusion.data import Array, Estimates, Ints, Measurements
from locfuse.fusion.fuse import fuse
from locfuse.fusion.sensors import lrf
from locfuse.fusion.whole_drive.smooth import fuse_and_smooth

BUILDINGS = ("fr079", "aces")
FAR_S = 60.0  # between two scans of a relation: beyond, no filter bridges them without closing a loop
EXTRA_RANGE, DROPPED = 0.008, 0.02  # m of extra range noise, share of scans dropped
EPOCH_S = 1e9  # s: the stamps of a relation plus this are those of the logs in docs/maps.md


@contextmanager
def noisier(sigma: float, rng: np.random.Generator) -> Iterator[None]:
    """Add noise [m] to every range before lines are extracted, for as long as the block lasts."""
    plain = vars(lrf)["lines_in_base"]

    def noisy(scans: dict[str, Any], *rest: Any) -> Any:
        ranges = scans["ranges"]
        return plain({**scans, "ranges": ranges + sigma * rng.normal(size=ranges.shape)}, *rest)

    vars(lrf)["lines_in_base"] = noisy
    try:
        yield
    finally:
        vars(lrf)["lines_in_base"] = plain


def without_some(m: Measurements, rng: np.random.Generator) -> Measurements:
    """Return the scans with DROPPED of them empty: their lines are gone, their instants stay."""
    counts = np.diff(m.first)
    gone = rng.random(len(counts)) < DROPPED
    rows = np.flatnonzero(~np.repeat(gone, counts))
    first: Ints = np.concatenate(([0], np.cumsum(np.where(gone, 0, counts))))
    extra = {k: v[rows] for k, v in m.extra.items()}
    return replace(m, first=first, z=m.z[rows], R_unit=m.R_unit[rows], extra=extra)


def one_run(
    below: Path, name: str, seed: int | None, sets: tuple[str, ...], smooth: bool
) -> Iterator[dict[str, Any]]:
    """Measure, fuse and judge once, smoothed too if `smooth`; `seed` None is the log as it is."""
    rng = np.random.default_rng(seed)
    heading = () if seed is None else (f"start.theta_deg={rng.uniform(-180.0, 180.0):.3f}",)
    how = LogOptions(sets=(*set_words(KNOWN.get(name)), *heading, *sets), quiet=True)
    with noisier(EXTRA_RANGE if seed is not None else 0.0, rng):
        loaded = load([below / name / f"{name}.mcap"], how)
    drive = loaded.drive
    if seed is not None:
        scans = without_some(drive.measurements["lrf"], rng)
        drive = replace(drive, measurements={**drive.measurements, "lrf": scans})
    relations = np.loadtxt(below / name / f"{name}.relations")
    relations[:, :2] += EPOCH_S - drive.epoch_ns * 1e-9
    start = time.process_time()
    robot = loaded.robot
    runs = list(fuse_and_smooth(drive, robot, ["lrf"])) if smooth else [fuse(drive, robot, ["lrf"])]
    seconds = time.process_time() - start
    for estimates in runs:
        yield {
            "log": name,
            "seed": seed,
            "smoothed": estimates.smoothed,
            **judged(estimates, relations),
            "cpu_s": seconds,  # of all runs of this log together
            "ms_per_scan": 1000.0 * seconds / len(drive.instant["lrf"]),
            "lines": len(estimates.final_map),
            "lost": [list(interval) for interval in estimates.lost],
            "notes": estimates.notes,
        }


def judged(estimates: Estimates, relations: Array) -> dict[str, Any]:
    """Return the figures of all relations (k, 8), and of those far apart in time."""
    translation, rotation = relation_errors(estimates.t, estimates.pose, relations)
    found = {**summary(translation, rotation), "within_3_sigma": contained(estimates, relations, translation)}
    far = relations[relations[:, 1] - relations[:, 0] > FAR_S]
    if len(far):
        errors = relation_errors(estimates.t, estimates.pose, far)
        found |= {"far_m": float(errors[0].mean()), "far_within_3_sigma": contained(estimates, far, errors[0])}
    return found


def contained(estimates: Estimates, relations: Array, translation: Array) -> float:
    """Return the share of relations whose error lies within 3 sigma of both poses' covariances (independent)."""
    inside = (relations[:, :2] >= estimates.t[0]).all(axis=1) & (relations[:, :2] <= estimates.t[-1]).all(axis=1)
    variance = estimates.P[:, 0, 0] + estimates.P[:, 1, 1]
    both = sum(np.interp(relations[inside, i], estimates.t, variance) for i in (0, 1))
    return float((translation <= 3.0 * np.sqrt(both)).mean())


def relation_errors(t: Array, pose: Array, relations: Array) -> tuple[Array, Array]:
    """Return translational [m] and rotational [rad] errors (k,) of relations (k, 8) by a trajectory at t (n,).

    Poses between two rows follow the arc between them; relations outside the trajectory are left out.
    """
    inside = (relations[:, :2] >= t[0]).all(axis=1) & (relations[:, :2] <= t[-1]).all(axis=1)
    r = relations[inside]
    found = se2.between(pose_at(t, pose, r[:, 0]), pose_at(t, pose, r[:, 1]))
    error = se2.between(r[:, [2, 3, 7]], found)
    return np.hypot(error[:, 0], error[:, 1]), np.abs(se2.wrap_all(error[:, 2]))


def pose_at(t: Array, pose: Array, when: Array) -> Array:
    """Interpolate poses along constant twists, (k, 3)."""
    k = np.clip(np.searchsorted(t, when, side="right") - 1, 0, len(t) - 2)
    step = se2.between(pose[k], pose[k + 1])
    step[:, 2] = se2.wrap_all(step[:, 2])
    share = (when - t[k]) / (t[k + 1] - t[k])
    return se2.compose(pose[k], se2.exp(share[:, None] * se2.log(step)))


def summary(translation: Array, rotation: Array) -> dict[str, float]:
    """Return the figures people quote."""
    return {
        "relations": len(translation),
        "mean_m": float(translation.mean()),
        "mean_deg": float(np.degrees(rotation.mean())),
        "median_m": float(np.median(translation)),
        "worst_m": float(translation.max()),
        "worst_deg": float(np.degrees(rotation.max())),
    }


@click.command()
@click.option("--log", "name", type=click.Choice(BUILDINGS), default="fr079", show_default=True)
@click.option("--runs", default=10, show_default=True, help="Perturbed runs after the one of the log as it is.")
@click.option("--set", "sets", multiple=True, help="robot.toml key.")
@click.option("--smooth", is_flag=True, help="Also judge the smoothed drive.")
def main(name: str, runs: int, sets: tuple[str, ...], smooth: bool) -> None:
    """Judge the map of a building; one JSON line per run."""
    for seed in (None, *range(runs)):
        for row in one_run(folder(), name, seed, sets, smooth):
            click.echo(json.dumps(row))


if __name__ == "__main__":
    main()
