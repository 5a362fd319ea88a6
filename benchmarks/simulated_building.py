"""How well does the laser hold a simulated building, whose truth is known? Means over drives; -o keeps each run.

    python -m benchmarks.simulated_building --drives 20
    python -m benchmarks.simulated_building --scenario hall --drives 5 --robot-set lrf.recover=false

Every drive has another seed: other noise, other walls, other walks of the people. Only wheels and laser are fused,
causally and smoothed. The position error is that after the best rigid alignment (SE(2), without scale) with the
truth; ANEES is that of the poses as they are, since both start at the known start. The CPU time of a smoothed run
includes the causal run under it. Doubted are the drives that the headline doubts: the causal path is too far from
the smoothed one.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np

from benchmarks import experiment
from benchmarks.experiment import Row
from locfuse.fusion.data import Drive, Estimates
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.judge.own_scans import Distance
from locfuse.fusion.robot import Robot
from locfuse.fusion.whole_drive.smooth import fuse_and_smooth

SENSORS = ["lrf"]
FIGURES = ("aligned_m", "aligned_worst_m", "position_m", "heading_deg", "anees", "lost")


def work(seed: int, scenario: str, sets: tuple[str, ...], robot_sets: tuple[str, ...], smooth: bool) -> Row:
    """Simulate a drive, fuse it causally and smoothed, and return the figures of each."""
    begin = time.process_time()
    run = experiment.simulated(scenario, ("compass.enabled=false", *sets), seed)
    seconds = time.process_time() - begin
    drive, robot = run.measured(robot_sets)
    kinds = ("causal", "smoothed") if smooth else ("causal",)
    facts = {"way_m": run.outcome.way, "duration_s": run.outcome.duration, "simulation_cpu_s": seconds}
    return {
        **facts,
        "scenario": scenario,
        "runs": {kind: timed(drive, robot, kind == "smoothed") for kind in kinds},
    }


def timed(drive: Drive, robot: Robot, smooth: bool) -> dict[str, Any]:
    """Fuse once and return figures and CPU seconds; an error of the filter is its result."""
    begin = time.process_time()
    try:
        runs = fuse_and_smooth(drive, robot, SENSORS) if smooth else [fuse(drive, robot, SENSORS)]
    except Exception as error:  # the next drive is still to be judged
        return {"failed": f"{type(error).__name__}: {error}"}
    seconds = time.process_time() - begin
    estimates, way = runs[-1], float(np.hypot(*np.diff(runs[0].pose[:, :2], axis=0).T).sum())
    apart = Distance.between(drive.t, runs[0].pose[:, :2], estimates.pose[:, :2])
    return {
        **judged(estimates, drive),
        "doubted": apart.doubted(way) if smooth else None,
        "cpu_s": seconds,
        "lines": len(estimates.final_map),
    }


def judged(estimates: Estimates, drive: Drive) -> dict[str, Any]:
    """Return errors, consistency and the share of the drive's time in which the robot was called lost."""
    aligned, plain = evaluate(estimates, drive, "se2").figures, evaluate(estimates, drive).figures
    lost = sum(end - begin for begin, end in estimates.lost)
    return {
        "aligned_m": aligned["position_rmse_m"],
        "aligned_worst_m": aligned["position_max_m"],
        "position_m": plain["position_rmse_m"],
        "heading_deg": plain["heading_rmse_deg"],
        "anees": plain["anees"],
        "lost": lost / float(drive.t[-1] - drive.t[0]),
    }


def table(rows: list[Row]) -> Iterator[str]:
    """Yield the means over all drives, with the worst aligned error of any drive."""
    lines = []
    for kind in ("causal", "smoothed"):
        of_kind = [row["runs"][kind] for row in rows if kind in row["runs"]]
        good = [r for r in of_kind if "failed" not in r]
        if good:
            m = {key: float(np.mean([r[key] for r in good])) for key in (*FIGURES, "cpu_s")}
            worst = max(r["aligned_m"] for r in good)
            lines.append(
                (
                    f"{rows[0]['scenario']}, {kind}",
                    len(of_kind),
                    len(of_kind) - len(good),
                    f"{m['aligned_m']:.3f} m ({worst:.3f})",
                    f"{m['position_m']:.3f} m",
                    f"{m['heading_deg']:.2f}°",
                    f"{m['anees']:.3g}",
                    f"{m['lost']:.0%}",
                    f"{sum(r['doubted'] for r in good)}" if kind == "smoothed" else "-",
                    f"{m['cpu_s']:.1f} s",
                )
            )
    head = ("scenario", "drives", "failed", "aligned rmse (worst drive)", "unaligned", "heading", "ANEES", "lost")
    yield from experiment.table((*head, "doubted", "CPU"), lines, "123456789")


OPTIONS = (
    experiment.option("--scenario", default="office"),
    experiment.option("--set", "sets", multiple=True, help="Scenario key."),
    experiment.option("--robot-set", "robot_sets", multiple=True, help="robot.toml key."),
    experiment.option("--smooth/--no-smooth", default=True, help="Also judge the smoothed drives."),
)
main = experiment.command(work, table, first=2000, options=OPTIONS)  # nothing else looks at these drives

if __name__ == "__main__":
    main()
