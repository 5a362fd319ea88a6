"""Does obeying the advice help on real logs? Every printed fix is set, and the whole log is compared again.

    LOCFUSE_DATA=folder python -m benchmarks.advice_logs -o advice_logs.jsonl

The table has the fixes of each log and what they do together: position error, heading error and ANEES of the best
configurations, odometry and `all`, by the log's truth. Without truth it is how well the sensors are predicted that
only listen, in nats per number (more is better; a reference would be another one under other settings). "Worse"
is an error that grows by more than 2 % + 0.2 mm (0.02 degrees). The last column is the CPU time of `compare` over
that of `compare --no-advice`; at most 2 + the number of printed fixes is wanted.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from benchmarks import experiment
from benchmarks.advice import MAX_LOSS, MAX_LOSS_DEG, MAX_LOSS_M
from benchmarks.experiment import Row
from benchmarks.real_logs import FILES, KNOWN, folder
from locfuse.cli.session.session import Session, load
from locfuse.formats.report.findings import length

DATA_SHEET = {"truth.topic": "/icp_pose", "wheels.radius": 0.30, "wheels.track": 1.14}
LOGS: dict[str, dict[str, Any]] = {  # name -> settings
    "brenner": {**KNOWN["brenner"], "wheels.track": 0.155},
    "warthog": DATA_SHEET,
    **{name: {} for name in ("turtlebot4", "pimouse", "mrclam", "freiburg-101", "edmonton", "fr079", "aces")},
}
KEYS = ("position_rmse_m", "heading_rmse_deg", "anees")


def work(name: str) -> Row:
    """Return the fixes of one log, and its figures before and after all of them are set."""
    session = load(folder() / FILES[name], sets=LOGS[name])
    _, without = compared(session, name, advice=False)
    report, cpu = compared(session, name)
    fixes = report["fixes"]
    after = compared(session.with_settings(fixes), name)[0] if fixes else report
    return {
        "fixes": fixes,
        "again": after["fixes"] if fixes else [],
        "before": figures(report),
        "after": figures(after),
        "cpu": cpu / without,
    }


def compared(session: Session, name: str, advice: bool = True) -> tuple[dict[str, Any], float]:
    """Return the report of `compare` on the whole log, and its CPU time [s]."""
    start, align = time.process_time(), "origin" if name == "warthog" else "none"
    report = session.compare(align=align, audits=False, advice=advice, smooth=False).report
    return report, time.process_time() - start


def figures(report: Mapping[str, Any]) -> dict[str, list[float | None]]:
    """Return position error [m], heading error [deg] and ANEES of every configuration, void or not; else nats."""
    configurations = report["configurations"]
    if report["truth"] is not None:
        seen = {name: (found.get("void") or {}).get("figures", found) for name, found in configurations.items()}
        return {name: [found.get(key) for key in KEYS] for name, found in seen.items()}
    scores = (report["prediction"] or {"scores": []})["scores"]
    nats = {n: [s["score_nats"] for s in scores if s["configuration"] == n] for n in configurations}
    return {name: [float(np.mean(found)) if found else None] for name, found in nats.items()}


def shown(row: Row) -> list[str]:
    """Return the configurations that are worth a line: the best ones before and after, odometry and `all`."""
    by_truth = [{n: v[0] for n, v in row[when].items() if len(v) > 1 and v[0] is not None} for when in WHEN]
    if not all(by_truth):
        return [n for n in row["before"] if "reference" not in n][-1:]
    best = (min(found, key=lambda n: found[n]) for found in by_truth)
    return [n for n in dict.fromkeys((*best, "odometry", "all")) if all(n in found for found in by_truth)]


WHEN = ("before", "after")


def grew(before: list[float | None], after: list[float | None]) -> bool:
    """Return whether an error of a configuration grew, or a prediction got worse."""
    if len(before) == 1:
        return None not in (*before, *after) and -(after[0] or 0.0) > -(before[0] or 0.0) + MAX_LOSS
    pairs = zip(before, after, (MAX_LOSS_M, MAX_LOSS_DEG), strict=False)
    return any(
        was is not None and now is not None and now > was * (1 + MAX_LOSS) + more for was, now, more in pairs
    )


def table(rows: list[Row]) -> Iterator[str]:
    """Yield what obeying all fixes does to the figures of the whole log."""
    forms, lines = (length, "{:.2f}°".format, "{:.3g}".format), []
    for row in rows:
        fixes, again = (" ".join(f"`{fix}`" for fix in row[key]) or "nothing" for key in ("fixes", "again"))
        for name in shown(row):
            before, after = row["before"][name], row["after"][name]
            how = forms if len(before) > 1 else ("{:.2f} nats".format,)
            cells = [
                "" if None in (a, b) else f"{f(a)} -> {f(b)}" for f, a, b in zip(how, before, after, strict=True)
            ]
            bad = "**yes**" if row["fixes"] and grew(before, after) else "no"
            lines.append((row["task"][0], fixes, name, *[*cells, "", ""][:3], bad, again, f"{row['cpu']:.1f} x"))
            fixes = again = ""
    head = (
        "log",
        "fixes",
        "configuration",
        "position error",
        "heading",
        "ANEES",
        "worse",
        "compared again",
        "CPU",
    )
    yield from experiment.table(head, lines)


main = experiment.command(work, table, LOGS, drives=0)

if __name__ == "__main__":
    main()
