"""Effect of following the advice: faults of settings and robots, alone and in pairs, and errors after all fixes.

    python -m benchmarks.advice --seeds 8 --jobs 2 -o advice.jsonl
    python -m benchmarks.advice --case none --seeds 15 -o clean.jsonl

Each seed is one lap of the paper's robot with one or two faults (benchmarks/advice_cases.py). `compare` searches
for faults, with and without truth in the log. All its fixes are set, and the errors are compared with those before
and with those of the right settings. Errors are computed by the simulator's own truth, which no fault changes. A
fault counts if it increases an error to more than 1.2 times the error with the right settings + 1 mm. The columns:

- right key: a fix sets one of the fault's keys; if no key can fix the fault, a finding names the sensor. Of two
  faults, one that is not named is no miss if the fixes leave no error that counts: alone it costs nothing, as a
  mount that the filter estimates.
- others: a fix for another sensor is printed.
- plaster: a fix that only hides the fault. It increases a noise or leaves out a sensor although a key would fix
  the fault, or sets a noise so large that the sensor has no effect.
- worse: an error of `all`, or of the best configuration, grew by more than 2 % + 0.2 mm (heading: 0.02 degrees).
- gap closed: median of (before - after) / (before - right). If the truth itself is wrong, `before` and `after` are
  the errors that `compare` prints (`after` at least the real error), and `right` is the right value of the error.

The cases "none" have no fault; the compass offset is given or estimated. Every finding in these cases is needless.
"""

import math
import re
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from benchmarks import experiment
from benchmarks.advice_cases import CAMERA, CASES, CLEAN, Case
from benchmarks.experiment import Row
from locfuse.cli.session.session import load
from locfuse.fusion.data import Array
from locfuse.sample_logs.scenario import load as scenario_of
from locfuse.sample_logs.simulate import EPOCH_NS, on_truth, write_log

SIDES = {"with truth": True, "without": False}
MAX_LOSS, MAX_LOSS_M, MAX_LOSS_DEG = 0.02, 2e-4, 0.02
MIN_COST, MIN_COST_M = 0.2, 1e-3  # relative, m: a fault counts if it increases an error by more
LOADED = (CAMERA,)  # set when a log is opened: a later change would search all pictures again
PLASTER = re.compile(
    r"wheels\.noise=|(compass|camera)\.sigma_deg=|lrf\.sigma_(range|angle_deg)=|(truth|start)\.sigma|"
    r".*\.field_tolerance=|.*\.topic=none"
)
USELESS_DEG = 45.0  # a compass or camera with more noise is not used
QUICK: dict[str, Any] = {"audits": False, "reference": False, "smooth": False}
LEAVE_OUT = re.compile(r"leave (?:the )?(\w+)[^.]* out")
Errors = dict[str, tuple[float, float]]  # configuration -> position error [m], heading error [deg]; rms


class Lap:
    """One simulated lap: its log, the simulator's truth, and errors computed so far."""

    def __init__(self, seed: int, scenario: tuple[str, ...]) -> None:
        path = Path(tempfile.mkdtemp(dir=experiment.scratch())) / "lap.mcap"
        outcome = write_log(scenario_of("rounded_rectangle", scenario), seed, on_truth, path)
        self.t, self.truth = outcome.truth_t, outcome.truth
        self.sessions = {True: load(path, sets=LOADED), False: load(path, sets=(*LOADED, "truth.topic=none"))}
        self._errors: dict[tuple[str, ...], Errors] = {}

    def report(self, sets: tuple[str, ...], truth: bool, advice: bool = True) -> dict[str, Any]:
        """Return the report of `compare` under settings, with the log's truth or without it."""
        return self.sessions[truth].with_settings(sets).compare(advice=advice, **QUICK).report

    def errors(self, sets: tuple[str, ...]) -> Errors:
        """Return each configuration's error against the simulator's truth (the log's truth may be wrong)."""
        if sets not in self._errors:
            session = self.sessions[True].with_settings(sets)
            found = session.compare(advice=False, **QUICK).estimates
            start = (session.drive.epoch_ns - EPOCH_NS) * 1e-9
            self._errors[sets] = {name: self._error(e.t + start, e.pose) for name, e in found.items()}
        return self._errors[sets]

    def _error(self, t: Array, pose: Array) -> tuple[float, float]:
        x, y, theta = (np.interp(t, self.t, self.truth[:, i]) for i in range(3))
        away = np.hypot(pose[:, 0] - x, pose[:, 1] - y)
        turn = np.degrees((pose[:, 2] - theta + np.pi) % (2 * np.pi) - np.pi)
        return math.sqrt(float((away**2).mean())), math.sqrt(float((turn**2).mean()))


lap = lru_cache(maxsize=3)(Lap)  # many cases use the same lap


def work(name: str, seed: int) -> Row:
    """Return the findings of one case with truth and without, and the errors before and after all fixes."""
    case = CASES[name]
    clean, drive = lap(seed, CASES["none"].scenario), lap(seed, case.scenario)
    found: Row = {}
    for side, truth in SIDES.items():
        if case.of_truth and not truth:  # only the truth is wrong
            continue
        report = drive.report(case.sets, truth)
        obeyed = (*case.sets, *report["fixes"])
        found[side] = {
            "fixes": report["fixes"],
            "headline": report["headline"],
            "findings": [[f["role"], f["fixes"], f["message"]] for f in report["findings"]],
            "right": drive.errors(case.right) if case.has_key else clean.errors(case.right),
            "before": drive.errors(case.sets),
            "after": drive.errors(obeyed),
        }
        if case.of_truth:
            found[side]["printed"] = printed(report), printed(drive.report(obeyed, truth=True, advice=False))
    return found


def printed(report: Mapping[str, Any]) -> dict[str, float | None]:
    """Return the position errors [m] in a report; None for errors that `compare` does not print."""
    return {name: values["position_rmse_m"] for name, values in report["configurations"].items()}


def judged(name: str, row: Row) -> Row:
    """Return the row of a case (with or without truth), with the columns named, others, plaster and so on."""
    # position errors [m]
    right, before, after = ({n: e for n, (e, _) in row[key].items()} for key in ("right", "before", "after"))
    if "printed" in row:
        # An error that is not printed counts as right, since it does not mislead. A fix that only makes the filter
        # agree with a wrong truth is no success: after the fixes, the larger of printed and real error counts.
        shown = [{n: right[n] if e is None else e for n, e in one.items() if n in right} for one in row["printed"]]
        before, after = shown[0], {n: max(e, after[n]) for n, e in shown[1].items() if n in after}
    harmed = worse(row["right"], row["before"], row["after"])
    return {**row, "case": name, **named(CASES[name], row), "worse": harmed, **gap(right, before, after)}


def named(case: Case, row: Row) -> Row:
    """Return whether a fix sets the right key (or a finding names the right sensor), and the other advice."""
    keys = {fix.partition("=")[0] for fix in row["fixes"]}
    roles = {role for role, _, _ in row["findings"]}
    plaster = [fix for fix in row["fixes"] if PLASTER.match(fix)]
    plaster += [f"leave {what} out" for what in LEAVE_OUT.findall(row["headline"])]
    own = {key for fault in case.faults for key in fault.keys}
    sigmas = {fix: fix.partition(".sigma_deg=")[2] for fix in plaster}
    useless = [fix for fix, sigma in sigmas.items() if sigma and float(sigma) >= USELESS_DEG]
    hit = [keys & set(f.keys) if f.keys else not f.roles or roles & set(f.roles) for f in case.faults]
    missed = [f for f, found in zip(case.faults, hit, strict=True) if not found]
    right, after = ({n: e for n, (e, _) in row[key].items()} for key in ("right", "after"))
    costs = len(missed) == len(case.faults) or gap(right, after, after)["errors_m"] is not None
    return {
        "named": not (missed and costs),
        "others": sorted({role for role, fixes, _ in row["findings"] if fixes} - case.roles),
        "plaster": [p for p in plaster if p in useless or (case.has_key and p.partition("=")[0] not in own)],
    }


def worse(right: Errors, before: Errors, after: Errors) -> list[str]:
    """Return the configurations (`all` and the best one before) whose error grew."""
    found = []
    for name in dict.fromkeys(("all", min(before, key=lambda n: before[n][0]))):
        if name not in after or name not in right:
            continue
        # an error up to that of the right settings is no harm, even if the wrong ones are better by chance
        (was, turned), (now, turns) = map(max, zip(before[name], right[name], strict=True)), after[name]
        if now > was * (1 + MAX_LOSS) + MAX_LOSS_M:
            found.append(f"{name} {1000 * before[name][0]:.1f} -> {1000 * now:.1f} mm")
        elif turns > turned * (1 + MAX_LOSS) + MAX_LOSS_DEG:
            found.append(f"{name} {before[name][1]:.2f} -> {turns:.2f} degrees")
    return found


def gap(right: Mapping[str, float], before: Mapping[str, float], after: Mapping[str, float]) -> Row:
    """Return the errors of the configuration that a fault affects most, and the share that the fixes remove."""
    both = [n for n in before if n in after and n in right]
    gaps = {n: before[n] - right[n] for n in both if before[n] > right[n] * (1 + MIN_COST) + MIN_COST_M}
    if not gaps:
        return {"closed": None, "errors_m": None}
    n = max(gaps, key=lambda n: math.log(before[n] / right[n]))
    return {"closed": (before[n] - after[n]) / gaps[n], "errors_m": [right[n], before[n], after[n]]}


def costly(rows: Iterable[Row]) -> list[Row]:
    return [row for row in rows if row["errors_m"] is not None]


def share(rows: Sequence[Row], key: str) -> str:
    """Return "3 of 4": the number of rows in which `key` is true."""
    return f"{sum(bool(row[key]) for row in rows)} of {len(rows)}" if rows else "-"


def closed(rows: Iterable[Row]) -> str:
    """Return the median share of the error that the fixes remove, at most 100 %."""
    values = [min(row["closed"], 1.0) for row in rows if CASES[row["case"]].closes]
    return f"{median(values):.0%}" if values else "-"


def table(rows: Sequence[Row]) -> Iterator[str]:
    """Yield the totals of all cases, then a row per case (with truth, without), then needless findings."""
    sides = [[judged(row["task"][0], row[side]) for row in rows if side in row] for side in SIDES]
    faulty = [[row for row in side if row["case"] not in CLEAN] for side in sides]
    keyed = [[row for row in costly(side) if CASES[row["case"]].has_key] for side in faulty]
    keyless = [[row for row in costly(side) if not CASES[row["case"]].has_key] for side in faulty]
    every = [
        ("right key, where the fault costs something", *(share(side, "named") for side in keyed)),
        ("the sensor is named, where no key sets that right", *(share(side, "named") for side in keyless)),
        ("somebody else gets a fix", *(share(side, "others") for side in faulty)),
        ("plaster", *(share(side, "plaster") for side in faulty)),
        ("an error grows", *(share(side, "worse") for side in sides)),
        ("gap closed, median", *(closed(costly(side)) for side in faulty)),
        *((f"{name}: a needless line", *(share(_of(name, side), "findings") for side in sides)) for name in CLEAN),
    ]
    yield from (*experiment.table(("all cases", *SIDES), every, "12"), "")
    lines = []
    for name in dict.fromkeys(row["task"][0] for row in rows):
        both = [_of(name, side) for side in sides]
        cells = (
            [share(costly(side), "named") for side in both],
            *([share(side, key) for side in both] for key in ("others", "plaster", "worse")),
            [closed(costly(side)) for side in both],
        )
        means = [np.mean([row["errors_m"] for row in costly(side)], axis=0) for side in both if costly(side)]
        metres = [*means[0][:2], *(mean[2] for mean in means)] if means else []
        lines.append((name, *map(", ".join, cells), ", ".join(f"{1000 * mean:.1f}" for mean in metres)))
    head = ("fault", "right key", "others", "plaster", "worse", "gap closed", "mm: right, before, after")
    yield from (*experiment.table(head, lines), "")
    for side, found in zip(SIDES, sides, strict=True):
        for row in (row for row in found if row["case"] in CLEAN):
            yield from (f"{row['case']}, {side}: {words} {' '.join(fixes)}" for _, fixes, words in row["findings"])


def _of(name: str, rows: Iterable[Row]) -> list[Row]:
    return [row for row in rows if row["case"] == name]


main = experiment.command(work, table, CASES, drives=8, first=3000)

if __name__ == "__main__":
    main()
