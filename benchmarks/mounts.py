"""Consistency of the covariance if the laser's mount is uncertain; each drive draws another mount.

    python -m benchmarks.mounts --drives 20

In each drive the configured mount has an error drawn from lrf.sigma_x, sigma_y and sigma_yaw_deg. In the case
`stated` the filter uses these sigmas, in the case `certain` sigmas of 0, in the case `exact` the true mount.
"""

import numpy as np

from benchmarks import experiment
from benchmarks.accuracy import LOCK_STEP, figures, table
from benchmarks.experiment import Row
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate

PRIOR = {"sigma_x": 0.01, "sigma_y": 0.01, "sigma_yaw_deg": 0.5}


def work(seed: int) -> Row:
    """Simulate one drive and judge it under every map and every configured mount."""
    run = experiment.simulated("rounded_rectangle", (*LOCK_STEP, "camera.enabled=false"), seed)
    off = np.random.default_rng(seed).normal(size=3) * np.array(list(PRIOR.values()))
    mount = zip(("x", "y", "yaw_deg"), off, strict=True)
    wrong = {key: float(run.tables["lrf"].get(key, 0.0) + d) for key, d in mount}
    certain = dict.fromkeys(PRIOR, 0.0)
    found: Row = {}
    for how, keys in {"stated": PRIOR | wrong, "certain": certain | wrong, "exact": certain}.items():
        sets = [f"lrf.{key}={value!r}" for key, value in keys.items()]
        drive, _ = run.measured(["lrf.map=grow", *sets])
        for mode in ("grow", "refine", "consider"):
            robot = run.robot([f"lrf.map={mode}", *sets])
            judged = [evaluate(fuse(drive, robot, sensors), drive) for sensors in (["lrf"], ["compass", "lrf"])]
            found |= {f"{mode} {e.name}, {how}": figures(e) for e in judged}
    return {"found": found}


main = experiment.command(work, table)

if __name__ == "__main__":
    main()
