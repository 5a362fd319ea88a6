"""Is the covariance consistent when nobody knows exactly where the laser sits? The mount is drawn anew per drive.

    python -m benchmarks.mounts --drives 20

The laser of each drive sits where its prior allows: configured values are off by a draw from lrf.sigma_x, sigma_y
and sigma_yaw_deg. `stated` gives the filter these sigmas, `certain` does not, `exact` gives it the true mount.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from benchmarks import experiment
from benchmarks.accuracy import LOCK_STEP, figures, markdown, over_drives
from benchmarks.experiment import Row, Simulated
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate

PRIOR = {"sigma_x": 0.01, "sigma_y": 0.01, "sigma_yaw_deg": 0.5}
SENSORS = (["lrf"], ["compass", "lrf"])
MODES = "grow,refine,consider"


def configured(run: Simulated, seed: int, mode: str, how: str) -> list[str]:
    """Return how the laser is configured."""
    off = np.random.default_rng(seed).normal(size=3) * np.array(list(PRIOR.values()))
    mount = run.tables["lrf"]
    keys = dict(PRIOR if how == "stated" else dict.fromkeys(PRIOR, 0.0))
    if how != "exact":
        keys |= {k: float(mount.get(k, 0.0) + d) for k, d in zip(("x", "y", "yaw_deg"), off, strict=True)}
    return [f"lrf.map={mode}", *(f"lrf.{key}={value!r}" for key, value in keys.items())]


def work(seed: int, modes: str) -> Row:
    """Simulate one drive and judge it under every map and every configured mount."""
    run = experiment.simulated("rounded_rectangle", (*LOCK_STEP, "camera.enabled=false"), seed)
    found = {}
    for how in ("stated", "certain", "exact"):
        drive, _ = run.measured(configured(run, seed, "grow", how))
        for mode in modes.split(","):
            robot = run.robot(configured(run, seed, mode, how))
            for sensors in SENSORS:
                judged = evaluate(fuse(drive, robot, sensors), drive)
                found[f"{mode} {judged.name}, {how}"] = figures(judged)
    return {"found": found}


def table(rows: list[Row]) -> Iterator[str]:
    """Yield errors and ANEES of drives whose laser sits a little off where it should."""
    yield markdown(over_drives([row["found"] for row in rows]))


main = experiment.command(work, table, options=[experiment.option("--modes", default=MODES)])

if __name__ == "__main__":
    main()
