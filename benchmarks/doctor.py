"""Accuracy of `info`: how often it finds a wrong setting, the error of its fixes, and false alarms.

    python -m benchmarks.doctor --drives 20

Random tours with one wrong key in robot.toml: the value that `info` proposes is compared with the right one. A
finding about another key, or about a right robot.toml, is a false alarm.
"""

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import experiment
from benchmarks.experiment import Row
from locfuse.cli.analysis.settings import LogOptions
from locfuse.cli.inspect.inspect_log import inspect_log
from locfuse.fusion.checks.finding import Finding
from locfuse.sample_logs.scenario import load
from locfuse.sample_logs.simulate import on_truth, write_log

# key, wrong value, right value, largest error of the fix (0: a word), and a key that has to change with it
WRONG: tuple[tuple[str, str, str, float, str], ...] = (
    ("lrf.time_offset", "0.3", "0", 0.08, ""),
    ("compass.time_offset", "-0.3", "0", 0.08, ""),
    ("truth.time_offset", "0.4", "0", 0.08, ""),
    ("lrf.yaw_deg", "25", "0", 3.0, ""),
    ("lrf.range_scale", "1.12", "1", 0.05, ""),
    ("lrf.flipped", "true", "false", 0.0, ""),
    ("compass.roll_deg", "180", "0", 1.0, ""),
    ("wheels.track", "0.68", "0.6", 0.03, ""),
    ("wheels.radius", "0.056", "0.05", 0.002, "wheels.track"),
    ("wheels.mirrored", "left", "none", 0.0, ""),
    ("truth.x", "0.3", "0", 0.1, ""),
    ("start.theta_deg", "200", "0", 5.0, "start.x"),  # both as seen from the true heading
)


def findings(log: Path, *sets: str) -> list[Finding]:
    overview = inspect_log([log], LogOptions(sets=sets, quiet=True))
    return [o for o in overview.findings if o.severe]


def work(seed: int) -> Row:
    """Return false alarms without a wrong setting; for each wrong setting its fix's error, and other findings."""
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "tour.mcap"
        outcome = write_log(load("tour", ("camera.enabled=false", "control.estimator=truth")), seed, on_truth, log)
        rows = []
        for key, wrong, right, within, also in WRONG:
            if key == "start.theta_deg":
                heading = float(np.degrees(outcome.truth[0, 2]))
                wrong, right = str(heading + float(wrong)), str(heading)  # noqa: PLW2901
            found = findings(log, f"{key}={wrong}")
            fix = dict(c.partition("=")[::2] for o in found for c in o.fixes).get(key)
            named = [name for o in found for name in {c.partition("=")[0] for c in o.fixes[:1]}]
            off = None
            if fix is not None:
                off = abs(float(fix) - float(right)) if within else 0.0 if fix == right else np.inf
            rows.append((off, sum(name not in {key, also} for name in named)))
        return {"complaints": len(findings(log)), "wrong": rows}


def table(rows: list[Row]) -> Iterator[str]:
    yield f"nothing is wrong: {sum(row['complaints'] > 0 for row in rows)} of {len(rows)} drives complain\n"
    lines: list[tuple[Any, ...]] = []
    for i, (key, value, _, within, _) in enumerate(WRONG):
        known = [off for row in rows for off, _ in [row["wrong"][i]] if off is not None]
        spread = (f"{np.median(known):.2g}", f"{max(known):.3g}") if known and within else ("", "")
        others = sum(row["wrong"][i][1] for row in rows)
        lines.append((f"`{key}` = {value}", len(known), sum(off <= within for off in known), *spread, others))
    head = ("wrong", "found", "fixed", "median error", "worst", "other complaints")
    yield from experiment.table(head, lines, "12345")


main = experiment.command(work, table, first=500)

if __name__ == "__main__":
    main()
