"""Effect of following the advice on real logs: each printed fix is set, and the whole log is compared again.

    LOCFUSE_DATA=folder python -m benchmarks.advice_logs -o advice_logs.jsonl

The table has the fixes of each log and their joint effect on the best configurations, odometry and `all`: position
error, heading error and ANEES by the log's truth. Without truth it has the likelihood of the sensors that are not
fused, in nats per number (more is better; a reference is not used, since it depends on the settings). An error is
"worse" if it grows by more than 2 % + 0.2 mm (0.02 degrees). The last column is the CPU time of `locfuse compare`
divided by that of `locfuse compare --no-advice`; it should be at most 2 + the number of printed fixes.
"""

import json
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks import experiment
from benchmarks.advice import MAX_LOSS, MAX_LOSS_DEG, MAX_LOSS_M
from benchmarks.experiment import Row, locfuse, scratch
from benchmarks.real_logs import FILES, KNOWN, folder
from locfuse.formats.report.findings import length

DATA_SHEET = {"truth.topic": "/icp_pose", "wheels.radius": 0.30, "wheels.track": 1.14}
LOGS: dict[str, dict[str, Any]] = {  # name -> settings
    "brenner": {**KNOWN["brenner"], "wheels.track": 0.155},
    "warthog": DATA_SHEET,
    **{name: {} for name in ("turtlebot4", "pimouse", "mrclam", "freiburg-101", "edmonton", "fr079", "aces")},
}
DOUBTFUL = 3  # exit code of a command whose result is doubtful
KEYS = ("position_rmse_m", "heading_rmse_deg", "anees")


def work(name: str) -> Row:
    """Return the fixes of one log, and its figures before and after all of them are set."""
    sets = [f"{key}={value}" for key, value in LOGS[name].items()]
    _, without = compared(name, sets, "--no-advice")
    report, cpu = compared(name, sets)
    fixes = report["fixes"]
    after = compared(name, [*sets, *fixes])[0] if fixes else report
    again, both = after["fixes"] if fixes else [], {"before": figures(report), "after": figures(after)}
    return {"fixes": fixes, "again": again, **both, "cpu": cpu / without}


def compared(name: str, sets: Sequence[str], *words: str) -> tuple[dict[str, Any], float]:
    """Return the report of `locfuse compare` on the whole log, and its CPU time [s]."""
    out, align = scratch() / name, "origin" if name == "warthog" else "none"
    chosen = [word for one in sets for word in ("--set", one)]
    start = time.process_time()
    said = locfuse("compare", str(folder() / FILES[name]), *chosen, "--align", align, "-q", "-o", str(out), *words)
    cpu = time.process_time() - start
    if said.exit_code not in (0, DOUBTFUL):
        raise RuntimeError(said.stderr)
    return json.loads((out / "report.json").read_text()), cpu


def figures(report: Mapping[str, Any]) -> dict[str, list[float | None]]:
    """Return position error [m], heading error [deg] and ANEES of every configuration; without truth nats."""
    configurations = report["configurations"]
    if report["truth"] is not None:
        seen = {name: (found.get("void") or {}).get("figures", found) for name, found in configurations.items()}
        return {name: [found.get(key) for key in KEYS] for name, found in seen.items()}
    scores = (report["prediction"] or {"scores": []})["scores"]
    nats = {n: [s["score_nats"] for s in scores if s["configuration"] == n] for n in configurations}
    return {name: [float(np.mean(found)) if found else None] for name, found in nats.items()}


def shown(row: Row) -> list[str]:
    """Return the configurations to print: the best ones before and after, odometry and `all`."""
    both = (row["before"], row["after"])
    by_truth = [{n: v[0] for n, v in found.items() if len(v) > 1 and v[0] is not None} for found in both]
    if not all(by_truth):
        return [n for n, found in row["before"].items() if None not in (*found, *row["after"][n])][-1:]
    best = (min(found, key=lambda n: found[n]) for found in by_truth)
    return [n for n in dict.fromkeys((*best, "odometry", "all")) if all(n in found for found in by_truth)]


def grew(before: list[float | None], after: list[float | None]) -> bool:
    if len(before) == 1:
        return None not in (*before, *after) and -(after[0] or 0.0) > -(before[0] or 0.0) + MAX_LOSS
    pairs = zip(before, after, (MAX_LOSS_M, MAX_LOSS_DEG), strict=False)
    known = [(was, now, more) for was, now, more in pairs if was is not None and now is not None]
    return any(now > was * (1 + MAX_LOSS) + more for was, now, more in known)


def table(rows: list[Row]) -> Iterator[str]:
    forms, lines = (length, "{:.2f}°".format, "{:.3g}".format), []
    for row in rows:
        fixes, again = (" ".join(f"`{fix}`" for fix in row[key]) or "nothing" for key in ("fixes", "again"))
        for name in shown(row):
            before, after = row["before"][name], row["after"][name]
            how = forms if len(before) > 1 else ("{:.2f} nats".format,)
            both = zip(how, before, after, strict=True)
            cells = ["" if None in (a, b) else f"{form(a)} -> {form(b)}" for form, a, b in both]
            bad = "**yes**" if row["fixes"] and grew(before, after) else "no"
            lines.append((row["task"][0], fixes, name, *[*cells, "", ""][:3], bad, again, f"{row['cpu']:.1f} x"))
            fixes = again = ""
    figures_of = ("configuration", "position error", "heading", "ANEES", "worse")
    yield from experiment.table(("log", "fixes", *figures_of, "compared again", "CPU"), lines)


main = experiment.command(work, table, LOGS, drives=0)

if __name__ == "__main__":
    main()
