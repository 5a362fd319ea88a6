"""How accurate and how consistent is the filter? Many simulated drives, every configuration, every map mode.

    python -m benchmarks.accuracy --drives 50
    python -m benchmarks.accuracy --drives 50 --no-camera --smooth

The drives are those of the paper's robot with synchronous sensors (paper, section IV): every sensor and the truth
are sampled once per 0.1 s, and compass and camera have no systematic errors. `--robot-set` changes the filter's
settings.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from benchmarks import experiment
from benchmarks.experiment import Row
from locfuse.fusion.data import Evaluation
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.whole_drive.smooth import fuse_and_smooth

MODES = ("first-scan", "consider", "refine", "grow")
SMOOTHED = ("refine", "grow")  # map modes with the optimal gain, which smoothing needs
# As in the paper, every sensor is sampled at each step of 0.1 s, and the truth just after. The compass is that of
# the sketch, with white noise and calibrated; compass and camera have the laser's rate. The true noise is
# configured, for the camera the noise that `locfuse tune` finds.
LOCK_STEP = (
    *("compass.rate=10", "compass.phase=0.05", "compass.noise_deg=0.1", "compass.sigma_deg=0.1"),
    *("compass.hard_iron=[0, 0]", "compass.soft_iron=[1, 1, 0]", "lrf.phase=0.05", "lrf.duration=1e-6"),
    *("camera.rate=10", "camera.phase=0.05", "camera.sigma_deg=0.15", "truth.rate=10", "truth.phase=0.050001"),
)


def work(seed: int, robot_sets: tuple[str, ...] = (), no_camera: bool = False, smooth: bool = False) -> Row:
    """Simulate and evaluate one drive; return "<mode> <configuration>" -> figures."""
    more = ("camera.enabled=false",) if no_camera else ()
    run = experiment.simulated("rounded_rectangle", (*LOCK_STEP, *more), seed)
    sensors = ("compass", "lrf", "camera")[: 2 if no_camera else 3]
    measured, _ = run.measured((f"lrf.map={MODES[0]}", *robot_sets))
    found: Row = {}
    for mode in MODES:
        robot = run.robot((f"lrf.map={mode}", *robot_sets))
        for used in ((), *((s,) for s in sensors), sensors):
            both = smooth and used and mode in SMOOTHED
            runs = fuse_and_smooth(measured, robot, used) if both else [fuse(measured, robot, used)]
            found |= {f"{mode} {e.name}": figures(e) for e in (evaluate(one, measured) for one in runs)}
    return {"found": found}


def figures(judged: Evaluation) -> Row:
    return {key: judged.figures[key] for key in ("position_rmse_m", "heading_rmse_deg", "anees")}


def over_drives(results: Sequence[Row]) -> dict[str, dict[str, float]]:
    """Return mean and spread over drives for each map mode and configuration."""
    found = {}
    for name in results[0]:
        metres, degrees, anees = np.array([list(r[name].values()) for r in results if name in r]).T
        found[name] = {
            "position_rmse_mm": float(1000 * np.sqrt((metres**2).mean())),
            "mean_mm": float(1000 * metres.mean()),
            "worst_mm": float(1000 * metres.max()),
            "heading_rmse_deg": float(np.sqrt((degrees**2).mean())),
            "anees": float(anees.mean()),
        }
    return found


def table(rows: list[Row]) -> Iterator[str]:
    head = ("map, configuration", "rmse of all", "mean of drives", "worst", "heading", "ANEES")
    forms = ("{:.2f} mm", "{:.2f}", "{:.2f}", "{:.4f}°", "{:.2f}")
    found = over_drives([row["found"] for row in rows]).items()
    lines = [(name, *(form.format(v) for form, v in zip(forms, row.values(), strict=True))) for name, row in found]
    yield from experiment.table(head, lines, "12345")


OPTIONS = (
    experiment.option("--robot-set", "robot_sets", multiple=True, help="robot.toml key."),
    experiment.option("--no-camera", is_flag=True, help="Leave out the camera: rendering takes most of the time."),
    experiment.option("--smooth", is_flag=True, help="Also judge the smoothed drives, where the map allows it."),
)
main = experiment.command(work, table, drives=50, options=OPTIONS)

if __name__ == "__main__":
    main()
