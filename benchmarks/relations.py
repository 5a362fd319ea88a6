"""Relation errors of a trajectory (Kümmerle et al. 2009): the relative poses that somebody verified by hand.

    python -m benchmarks.relations lrf.tum fr079.relations --shift 1e9

A relation is `t1 t2 dx dy dz droll dpitch dyaw`: pose 2 seen from pose 1. The error needs no common frame, so it
judges a map's shape where no truth exists.
"""

from __future__ import annotations

import json
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray

from locfuse.formats.results.trajectory import read_tum
from locfuse.fusion import se2

Array = NDArray[np.float64]

EPOCH_S = 1e9  # s: the stamps of a relation plus this are those of the logs in docs/maps.md


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
@click.argument("trajectory", type=click.Path(path_type=Path, exists=True))
@click.argument("relations", type=click.Path(path_type=Path, exists=True))
@click.option("--shift", default=0.0, help="Seconds to add to the relations' stamps.")
def main(trajectory: Path, relations: Path, shift: float) -> None:
    """Judge a TUM trajectory by a file of relations."""
    t_ns, pose = read_tum(trajectory.read_text())
    table = np.loadtxt(relations)
    table[:, :2] += shift - t_ns[0] * 1e-9
    errors = relation_errors((t_ns - t_ns[0]) * 1e-9, pose, table)
    click.echo(json.dumps(summary(*errors), indent=2))


if __name__ == "__main__":
    main()
