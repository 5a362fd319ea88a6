"""How often `info` finds what is wrong, how exact its fixes are, and how often it complains without cause.

    python -m benchmarks.doctor --drives 20

Random tours with a robot.toml that is right but for one key: what `info` then tells to set is held against the
right value. A complaint about anything else, or about a robot.toml that is right, is a false alarm.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks import experiment
from benchmarks.experiment import Row
from locfuse.cli.analysis.settings import LogOptions
from locfuse.cli.inspect.inspect_log import inspect_log
from locfuse.fusion.checks.finding import Finding
from locfuse.sample_logs.load import load
from locfuse.sample_logs.record import on_truth, write_log

SETTINGS = ("camera.enabled=false", "control.estimator=truth")


class Wrong(NamedTuple):
    """A setting that is wrong, and what it should be."""

    key: str
    value: str
    right: str
    within: float | None = None  # of a number: how far the fix may be off; None: a word
    also: str = ""  # a key that has to follow

    def fixed(self, found: list[Finding]) -> float | None:
        """Return by how much the fix is off (0 for the right word), None where there is none."""
        fixes = dict(c.partition("=")[::2] for o in found for c in o.fixes)
        if self.key not in fixes:
            return None
        if self.within is None:
            return 0.0 if fixes[self.key] == self.right else np.inf
        return abs(float(fixes[self.key]) - float(self.right))


WRONG = (
    Wrong("lrf.time_offset", "0.3", "0", 0.08),
    Wrong("compass.time_offset", "-0.3", "0", 0.08),
    Wrong("truth.time_offset", "0.4", "0", 0.08),
    Wrong("lrf.yaw_deg", "25", "0", 3.0),
    Wrong("lrf.range_scale", "1.12", "1", 0.05),
    Wrong("lrf.flipped", "true", "false"),
    Wrong("compass.roll_deg", "180", "0", 1.0),
    Wrong("wheels.track", "0.68", "0.6", 0.03),
    Wrong("wheels.radius", "0.056", "0.05", 0.002, "wheels.track"),
    Wrong("wheels.mirrored", "left", "none"),
    Wrong("truth.x", "0.3", "0", 0.1),
    Wrong("start.theta_deg", "200", "0", 5.0, "start.x"),
)


def findings(log: Path, *sets: str) -> list[Finding]:
    """Return what would spoil an estimate under these settings."""
    overview = inspect_log([log], LogOptions(None, sets, None, strict=False, quiet=True))
    return [o for o in overview.findings if o.severe]


def work(seed: int) -> Row:
    """Return the complaints of a right tour, and what becomes of each wrong setting."""
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "tour.mcap"
        outcome = write_log(load("tour", SETTINGS), seed, on_truth, log)
        heading = float(np.degrees(outcome.truth[0, 2]))
        return {"complaints": len(findings(log)), "wrong": [tried(log, wrong, heading) for wrong in WRONG]}


def tried(log: Path, wrong: Wrong, heading: float) -> tuple[float | None, int]:
    """Return by how much the fix is off, None without one, and how many others are named."""
    right = wrong._replace(right=str(heading)) if wrong.key == "start.theta_deg" else wrong
    value = str(heading + float(wrong.value)) if right is not wrong else wrong.value
    found = findings(log, f"{wrong.key}={value}")
    named = [key for o in found for key in {c.partition("=")[0] for c in o.fixes[:1]}]
    return right.fixed(found), sum(key not in {wrong.key, wrong.also} for key in named)


def table(rows: list[Row]) -> Iterator[str]:
    """Yield how often a right log is complained of, and a line for each wrong setting."""
    yield f"nothing is wrong: {sum(row['complaints'] > 0 for row in rows)} of {len(rows)} drives complain\n"
    lines = []
    for i, wrong in enumerate(WRONG):
        known = [off for row in rows for off, _ in [row["wrong"][i]] if off is not None]
        spread = ("", "")
        if known and wrong.within is not None:
            spread = f"{np.median(known):.2g}", f"{max(known):.3g}"
        right = sum(off <= (wrong.within or 0.0) for off in known)
        others = sum(row["wrong"][i][1] for row in rows)
        lines.append((f"`{wrong.key}` = {wrong.value}", len(known), right, *spread, others))
    head = ("wrong", "found", "fixed", "median error", "worst", "other complaints")
    yield from experiment.table(head, lines, "12345")


main = experiment.command(work, table, first=500)

if __name__ == "__main__":
    main()
