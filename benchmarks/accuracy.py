"""How accurate and how consistent is the filter? Many simulated drives, every configuration, every map mode.

    python -m benchmarks.accuracy --drives 50
    python -m benchmarks.accuracy --drives 50 --modes refine,grow --smooth

The drives are the paper's robot in lock-step (paper, section IV): every sensor and the truth once per 0.1 s,
compass and camera as exact as maths allows. `--set` changes the scenario, `--robot-set` the filter's settings.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from benchmarks import experiment
from benchmarks.experiment import Row
from locfuse.fusion.data import Evaluation
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.measure import measure
from locfuse.fusion.whole_drive.smooth import fuse_and_smooth

MODES = "first-scan,consider,refine,grow"
SMOOTHED = ("refine", "grow")  # smoothing assumes optimal weights
# Every sensor at each step of 0.1 s and truth just after: the set-up of the paper. The compass is the sketch's,
# white and calibrated; its rate and the camera's are those of the laser. Noise is configured as it is: that of the
# camera as `locfuse tune` finds it.
LOCK_STEP = (
    *("compass.rate=10", "compass.phase=0.05", "compass.noise_deg=0.1", "compass.sigma_deg=0.1"),
    *("compass.hard_iron=[0, 0]", "compass.soft_iron=[1, 1, 0]", "lrf.phase=0.05", "lrf.duration=1e-6"),
    *("camera.rate=10", "camera.phase=0.05", "camera.sigma_deg=0.15", "truth.rate=10", "truth.phase=0.050001"),
)


def work(
    seed: int,
    scenario: str = "rounded_rectangle",
    sets: tuple[str, ...] = (),
    robot_sets: tuple[str, ...] = (),
    modes: str = MODES,
    as_shipped: bool = False,
    no_camera: bool = False,
    smooth: bool = False,
) -> Row:
    """Simulate one drive and judge it: "<mode> <configuration>" -> figures."""
    more = ("camera.enabled=false",) if no_camera else ()
    run = experiment.simulated(scenario, (*(() if as_shipped else LOCK_STEP), *more, *sets), seed)
    sensors = ("compass", "lrf", "camera")[: 2 if no_camera else 3]
    robots = {mode: run.robot((f"lrf.map={mode}", *robot_sets)) for mode in modes.split(",")}
    measured = measure(run.streams, next(iter(robots.values())))
    found: dict[str, dict[str, Any]] = {}
    for mode, robot in robots.items():
        for used in ((), *((s,) for s in sensors), sensors):
            if set(used) <= set(measured.measurements):
                both = smooth and used and mode in SMOOTHED
                for run_of in fuse_and_smooth(measured, robot, used) if both else (fuse(measured, robot, used),):
                    judged = evaluate(run_of, measured)
                    found[f"{mode} {judged.name}"] = figures(judged)
    return {"found": found}


def figures(judged: Evaluation) -> dict[str, Any]:
    """Return what the table needs of one run; `nees`: squared error over predicted variance of x, y and theta."""
    found: dict[str, Any] = {k: judged.figures[k] for k in ("position_rmse_m", "heading_rmse_deg", "anees")}
    if judged.heading is not None:
        good = (judged.sigma > 0).all(axis=1)
        errors = np.column_stack((judged.deviation, judged.heading))[good]
        found["nees"] = ((errors / judged.sigma[good]) ** 2).mean(axis=0).tolist()
    return found


def over_drives(results: Sequence[dict[str, dict[str, Any]]]) -> dict[str, dict[str, float]]:
    """Return for every mode and configuration the mean, median and spread over drives."""
    found = {}
    for name in results[0]:
        rows = [r[name] for r in results if name in r]
        mm = 1000 * np.array([r["position_rmse_m"] for r in rows])
        x, y, theta = np.mean([r["nees"] for r in rows], axis=0).tolist()
        found[name] = {
            "position_rmse_mm": float(np.sqrt((mm**2).mean())),
            "mean_mm": float(mm.mean()),
            "median_mm": float(np.median(mm)),
            "worst_mm": float(mm.max()),
            "heading_rmse_deg": math.sqrt(float(np.mean([r["heading_rmse_deg"] ** 2 for r in rows]))),
            "anees": float(np.mean([r["anees"] for r in rows])),
            "nees_x": x,
            "nees_y": y,
            "nees_theta": theta,
        }
    return found


def table(rows: list[Row]) -> Iterator[str]:
    """Yield the table of all drives."""
    head = (
        "map, configuration",
        "rmse of all",
        "mean of drives",
        "median",
        "worst",
        "heading",
        "ANEES",
        *"xy",
        "theta",
    )
    forms = ("{:.2f} mm", "{:.2f}", "{:.2f}", "{:.2f}", "{:.4f}°", *["{:.2f}"] * 4)
    found = over_drives([row["found"] for row in rows]).items()
    lines = [(name, *(form.format(v) for form, v in zip(forms, row.values(), strict=True))) for name, row in found]
    yield from experiment.table(head, lines, "123456789")


OPTIONS = (
    experiment.option("--scenario", default="rounded_rectangle"),
    experiment.option("--set", "sets", multiple=True, help="Scenario key, after lock-step."),
    experiment.option("--robot-set", "robot_sets", multiple=True, help="robot.toml key."),
    experiment.option("--modes", default=MODES),
    experiment.option("--as-shipped", is_flag=True, help="Sensors asynchronous, as in the shipped scenario."),
    experiment.option("--no-camera", is_flag=True, help="Leave out the camera: rendering takes most of the time."),
    experiment.option("--smooth", is_flag=True, help="Also judge the smoothed drives, where the map allows it."),
)
main = experiment.command(work, table, drives=50, options=OPTIONS)

if __name__ == "__main__":
    main()
