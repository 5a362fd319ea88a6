"""Accuracy of two measures without truth: do revisit agreement and crispness rank paths like their errors?

    LOCFUSE_DATA=... python -m benchmarks.revisits

Every log with a laser and a truth is fused in several ways, some of them wrong on purpose. If the errors of two
paths differ by a fifth, the better one should have the higher agreement, and a crisper map: fewer occupied cells.
A pair counts only if the measures differ enough (MIN_HINT, MIN_RATIO), as in the report.
"""

import itertools
from collections.abc import Iterator
from typing import Any

import locfuse
from benchmarks import experiment
from benchmarks.experiment import Row
from benchmarks.real_logs import FILES, KNOWN, are_there, folder
from locfuse.cli.advice.report import MIN_HINT

REAL: dict[str, dict[str, Any]] = {  # log -> its settings
    "fr079": KNOWN["fr079"],
    "edmonton": {},
    "freiburg-101": {},
    "brenner": {**KNOWN["brenner"], "wheels.track": 0.173},
}
SAMPLES = ("rounded_rectangle", "rounded_triangle", "disturbed")
WAYS: dict[str, dict[str, Any]] = {  # how a log is fused, beside odometry: name -> its settings
    "as it is": {},
    "turned by 3°": {"lrf.yaw_deg": 3, "lrf.sigma_yaw_deg": 0, "lrf.sigma_x": 0, "lrf.sigma_y": 0},
    "0.3 s late": {"lrf.time_offset": 0.3},
    "without recovery": {"lrf.recover": False},
}
FORMS = (".3f", ".0%", ".0f")  # of a path's figures: error, agreement, cells
MIN_DIFFERENCE = 1.2  # least ratio of two errors that count as different
MIN_RATIO = 1.2  # least ratio of the numbers of cells


def work(name: str) -> Row:
    """Return error, revisit agreement and number of cells of a log's paths, by settings."""
    log = folder() / FILES[name] if name in REAL else name
    found: dict[str, list[float | None]] = {}
    for way, sets in WAYS.items():
        session = locfuse.load(log, sets={**REAL.get(name, {}), **sets})
        sensors = ["odometry", "lrf"] if not found else ["lrf"]
        report = session.compare(sensors, align="se2", advice=False, audits=False, smooth=True).report
        for row, values in report["configurations"].items():
            figures = [values[key] for key in ("position_rmse_m", "revisit_agreement", "crispness_cells")]
            found[row if row == "odometry" else f"{row}, {way}"] = figures
    return {"paths": found}


def ranked(paths: dict[str, list[float | None]], figure: int) -> tuple[int, int]:
    """Return (pairs of paths that a figure ranks like their errors, all pairs); figure 1: agreement, 2: cells."""
    right = asked = 0
    known = [(e, f) for path in paths.values() if (e := path[0]) is not None and (f := path[figure]) is not None]
    for (least, one), (most, other) in itertools.combinations(sorted(known), 2):
        differ = abs(one - other) >= MIN_HINT if figure == 1 else max(one, other) >= MIN_RATIO * min(one, other)
        if differ and most >= MIN_DIFFERENCE * least:
            asked += 1
            right += one > other if figure == 1 else one < other
    return right, asked


def table(rows: list[Row]) -> Iterator[str]:
    lines = [
        (row["task"][0], way, *("-" if v is None else f"{v:{form}}" for v, form in zip(path, FORMS, strict=True)))
        for row in rows
        for way, path in row["paths"].items()
    ]
    yield from experiment.table(("log", "path", "error", "revisits agree", "cells"), lines, "345")
    for figure, name in ((1, "Revisit agreement"), (2, "Crispness")):
        right, asked = (sum(n) for n in zip(*(ranked(row["paths"], figure) for row in rows), strict=True))
        yield f"\n{name}: {right} of {asked} pairs of paths are ranked as their errors are."


main = experiment.command(work, table, (*SAMPLES, *(REAL if are_there() else ())), drives=0)

if __name__ == "__main__":
    main()
