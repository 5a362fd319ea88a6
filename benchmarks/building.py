"""Accuracy of the laser in buildings, recorded or simulated: means over drives, and the worst drive.

    LOCFUSE_DATA=... python -m benchmarks.building --log aces --drives 11 --smooth
    python -m benchmarks.building --log office --drives 20 --smooth
    LOCFUSE_DATA=... python -m benchmarks.building --log edmonton --set lrf.recover=false

Drive 0 of a recorded log is the unchanged log. The other drives are the same log with more noise of the ranges,
without some of the scans, and with another start heading. Every drive of a scenario has another seed: other noise,
other walls, other paths of the people.

A recorded log is evaluated by relations in a file: `t1 t2 dx dy dz droll dpitch dyaw`, pose 2 relative to pose 1,
verified by hand (Kümmerle et al. 2009). They need no common frame. Their poses are those of scans, with the stamps
of the scans (the wheels' stamps are 0.13 s off). If a run estimates another mount of the laser than the configured
one, its base is elsewhere (fr079: x = 0.00 m, not -0.04 m), so the poses of its laser are compared. Without
relations, the truth is used, after the best rigid alignment; without truth, the distance to the smoothed path of
the unchanged log. ANEES is computed for simulated drives only, whose start is known. A drive counts as doubted if
the headline doubts it: the filtered path is too far from the smoothed one.
"""

import time
from collections.abc import Iterator
from functools import cache, partial
from typing import Any
from unittest.mock import patch

import numpy as np
from msgspec.structs import replace

from benchmarks import campus, experiment
from benchmarks.experiment import Row
from benchmarks.real_logs import FILES, KNOWN, are_there, folder
from locfuse.cli.analysis.load import load
from locfuse.cli.analysis.settings import LogOptions, set_words
from locfuse.fusion import se2
from locfuse.fusion.data import Array, Drive, Estimates, Ints, Measurements
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.judge.without_truth import Distance
from locfuse.fusion.lines.scans import lines_in_base
from locfuse.fusion.mount import found_mount
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors import lrf
from locfuse.fusion.whole_drive.smooth import fuse_and_smooth

RECORDED = ("fr079", "aces", "edmonton", "freiburg-101", "pimouse", "turtlebot4")
SCENARIOS = ("office", "hall", "campus")
FIRST_SEED = 2000  # of a scenario: these drives are not used elsewhere
FAR_S = 60.0  # s between two scans of a relation from which the filter needs a loop closure
EXTRA_RANGE, DROPPED = 0.008, 0.02  # m of extra range noise, share of scans dropped
EPOCH_S = 1e9  # s: the stamps of a relation plus this are those of the logs in docs/maps.md


def work(name: str, number: int, smooth: bool, sets: tuple[str, ...]) -> Row:
    """Fuse a drive of a building, smoothed too if `smooth`, and return the figures of each run."""
    if name in SCENARIOS:
        scenario = campus_file() if name == "campus" else name
        run = experiment.simulated(scenario, ("compass.enabled=false",), FIRST_SEED + number)
        drive, robot = run.measured(sets)
    else:
        drive, robot = measured(name, number, sets)
    begin = time.process_time()
    runs = fuse_and_smooth(drive, robot, ["lrf"]) if smooth else [fuse(drive, robot, ["lrf"])]
    seconds = time.process_time() - begin
    found = {"smoothed" if run.smoothed else "causal": judged(name, run, drive) for run in runs}
    apart = Distance.between(drive.t, runs[0].pose[:, :2], runs[-1].pose[:, :2])
    way = float(np.hypot(*np.diff(runs[0].pose[:, :2], axis=0).T).sum())
    return {"runs": found, "doubted": apart.doubted(way), "cpu_s": seconds, "notes": list(runs[-1].notes)}


@cache
def campus_file() -> str:
    path = experiment.scratch() / "campus.toml"
    path.write_text(campus.scenario(), encoding="utf-8")
    return str(path)


def measured(name: str, number: int, sets: tuple[str, ...]) -> tuple[Drive, Robot]:
    """Return a recorded log unchanged (`number` 0), or with new noise and missing scans."""
    path, known = folder() / FILES[name], set_words(KNOWN.get(name))
    if not number:
        loaded = load([path], LogOptions(sets=(*known, *sets), quiet=True))
        return loaded.drive, loaded.robot
    rng = np.random.default_rng(number - 1)
    heading = f"start.theta_deg={rng.uniform(-180.0, 180.0):.3f}"
    with patch.object(lrf, "lines_in_base", partial(noisier, rng)):
        loaded = load([path], LogOptions(sets=(*known, heading, *sets), quiet=True))
    scans = without_some(loaded.drive.measurements["lrf"], rng)
    return replace(loaded.drive, measurements={**loaded.drive.measurements, "lrf": scans}), loaded.robot


def noisier(rng: np.random.Generator, scans: dict[str, Any], *rest: Any) -> Any:
    more = EXTRA_RANGE * rng.normal(size=scans["ranges"].shape)
    return lines_in_base({**scans, "ranges": scans["ranges"] + more}, *rest)


def without_some(m: Measurements, rng: np.random.Generator) -> Measurements:
    """Return the scans with a share DROPPED of them emptied: without lines, at the same times."""
    counts = np.diff(m.first)
    gone = rng.random(len(counts)) < DROPPED
    rows = np.flatnonzero(~np.repeat(gone, counts))
    first: Ints = np.concatenate(([0], np.cumsum(np.where(gone, 0, counts))))
    extra = {k: v[rows] for k, v in m.extra.items()}
    return replace(m, first=first, z=m.z[rows], R_unit=m.R_unit[rows], extra=extra)


def judged(name: str, run: Estimates, drive: Drive) -> Row:
    """Return errors and consistency of one run, and the time lost [s]."""
    found: Row = {"lost_s": sum(end - begin for begin, end in run.lost)}
    path = folder() / FILES[name] if name in FILES else None
    if path is not None and path.with_suffix(".relations").exists():
        relations = np.loadtxt(path.with_suffix(".relations"))
        relations[:, :2] += EPOCH_S - drive.epoch_ns * 1e-9
        far = relations[relations[:, 1] - relations[:, 0] > FAR_S]
        for which, rows in (("", relations), ("far_", far)):
            errors, turns = relation_errors(run.t, at_laser(run, drive), rows)
            found |= {f"{which}error_m": float(errors.mean()), f"{which}inside": contained(run, rows, errors)}
            found[f"{which}heading_deg"] = float(np.degrees(turns.mean()))
    elif drive.truth is not None:
        aligned = evaluate(run, drive, "se2").figures
        found |= {"error_m": aligned["position_rmse_m"], "heading_deg": aligned["heading_rmse_deg"]}
        found |= {"anees": evaluate(run, drive).figures["anees"]} if name in SCENARIOS else {}
    else:
        found["error_m"] = Distance.between(drive.t, run.pose[:, :2], smoothed_path(name)).rms
    return found


def at_laser(run: Estimates, drive: Drive) -> Array:
    """Return poses (n, 3) of the base, from the run's poses of the laser and the configured mount."""
    scans = drive.measurements["lrf"].points
    assert scans is not None
    moved = se2.compose(found_mount("lrf", scans.mount, run.blocks), se2.inverse(scans.mount))
    return se2.compose(run.pose, moved)


@cache
def smoothed_path(name: str) -> Array:
    """Return the smoothed path (n, 2) [m] of the unchanged recorded log."""
    path: Array = fuse_and_smooth(*measured(name, 0, ()), ["lrf"])[1].pose[:, :2]
    return path


def contained(estimates: Estimates, relations: Array, translation: Array) -> float:
    """Return the share of relations whose error lies within 3 sigma of both poses' covariances (independent)."""
    variance = estimates.P[:, 0, 0] + estimates.P[:, 1, 1]
    known = relations[covered(estimates.t, relations)]
    both = sum(np.interp(known[:, i], estimates.t, variance) for i in (0, 1))
    return float((translation <= 3.0 * np.sqrt(both)).mean())


def relation_errors(t: Array, pose: Array, relations: Array) -> tuple[Array, Array]:
    """Return translational [m] and rotational [rad] errors (k,) of relations (k, 8) by a trajectory at t (n,).

    Poses between two rows follow the arc between them; relations outside the trajectory are left out.
    """
    r = relations[covered(t, relations)]
    found = se2.between(pose_at(t, pose, r[:, 0]), pose_at(t, pose, r[:, 1]))
    error = se2.between(r[:, [2, 3, 7]], found)
    return np.hypot(error[:, 0], error[:, 1]), np.abs(se2.wrap_all(error[:, 2]))


def covered(t: Array, relations: Array) -> Array:
    """Return which relations (k, 8) lie within a trajectory at t (n,)."""
    inside: Array = ((relations[:, :2] >= t[0]) & (relations[:, :2] <= t[-1])).all(axis=1)
    return inside


def pose_at(t: Array, pose: Array, when: Array) -> Array:
    """Interpolate poses along constant twists, (k, 3)."""
    k = np.clip(np.searchsorted(t, when, side="right") - 1, 0, len(t) - 2)
    step = se2.between(pose[k], pose[k + 1])
    step[:, 2] = se2.wrap_all(step[:, 2])
    share = (when - t[k]) / (t[k + 1] - t[k])
    return se2.compose(pose[k], se2.exp(share[:, None] * se2.log(step)))


FORMS = {  # figure of a run -> its format
    "error_m": "{:.3f} m", "heading_deg": "{:.2f}°", "inside": "{:.0%}", "far_error_m": "{:.3f} m",
    "far_inside": "{:.0%}", "anees": "{:.3g}", "lost_s": "{:.1f} s",
}  # fmt: skip


def table(rows: list[Row]) -> Iterator[str]:
    """Yield the means over the drives of each building, with the worst error in brackets."""
    lines = []
    for name, mine in experiment.by_case(rows).items():
        seconds = f"{np.mean([row['cpu_s'] for row in mine]):.1f} s"
        for kind in mine[0]["runs"]:
            runs = [row["runs"][kind] for row in mine]
            means = {key: np.mean([run[key] for run in runs]) for key in runs[0]}
            cells = [form.format(means[key]) if key in means else "" for key, form in FORMS.items()]
            cells[0] += f" ({max(run['error_m'] for run in runs):.3f})"
            doubted = str(sum(row["doubted"] for row in mine)) if kind == "smoothed" else ""
            lines.append((f"{name}, {kind}", len(runs), *cells, doubted, seconds))
    head = ("error (worst)", "heading", "inside 3 sigma", "far relations", "inside", "ANEES", "lost", "doubted")
    yield from experiment.table(("building", "drives", *head, "CPU"), lines, "123456789")


OPTIONS = (
    experiment.option("--smooth", is_flag=True, help="Also judge the smoothed drives."),
    experiment.option("--set", "sets", multiple=True, help="robot.toml key."),
)
CASES = (*(RECORDED if are_there() else ()), *SCENARIOS)
main = experiment.command(work, table, CASES, drives=1, first=0, options=OPTIONS)

if __name__ == "__main__":
    main()
