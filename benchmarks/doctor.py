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

import click
import numpy as np

from locfuse.cli.analysis.settings import LogOptions
from locfuse.cli.inspect.inspect_log import inspect_log
from locfuse.fusion.checks.finding import Finding
from locfuse.sample_logs.load import load
from locfuse.sample_logs.record import on_truth, write_log

SETTINGS = ("camera.enabled=false", "control.estimator=truth")
FIRST_SEED = 500


class Wrong(NamedTuple):
    """A setting that is wrong, and what it should be."""

    key: str
    value: str
    right: str
    within: float | None = None  # of a number: how far the fix may be off; None: a word
    also: str = ""  # a key that has to follow

    def cured(self, found: list[Finding]) -> float | None:
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


def drives(number: int, folder: Path) -> Iterator[tuple[Path, float]]:
    """Yield logs of random tours, and the heading [deg] at which each starts."""
    scenario = load("tour", SETTINGS)
    for seed in range(FIRST_SEED, FIRST_SEED + number):
        path = folder / f"{seed}.mcap"
        outcome = write_log(scenario, seed, on_truth, path)
        yield path, float(np.degrees(outcome.truth[0, 2]))


def findings(log: Path, *sets: str) -> list[Finding]:
    """Return what would spoil an estimate under these settings."""
    overview = inspect_log([log], LogOptions(None, sets, None, strict=False, quiet=True))
    return [o for o in overview.findings if o.severe]


def row(wrong: Wrong, off: list[float | None], others: int) -> str:
    """Return one line of the table."""
    known = [o for o in off if o is not None]
    right = sum(o <= (wrong.within or 0.0) for o in known)
    worst = f"{max(known):.3g}" if known and wrong.within is not None else ""
    median = f"{np.median(known):.2g}" if known and wrong.within is not None else ""
    return f"| `{wrong.key}` = {wrong.value} | {len(known)} | {right} | {median} | {worst} | {others} |"


@click.command()
@click.option("--drives", "number", default=20, show_default=True)
def main(number: int) -> None:
    """Print a table."""
    with tempfile.TemporaryDirectory() as folder:
        logs = list(drives(number, Path(folder)))
        click.echo(
            f"nothing is wrong: {sum(bool(findings(log)) for log, _ in logs)} of {number} drives complain\n"
        )
        click.echo(
            "| wrong | found | cured | median error | worst | other complaints |\n|---|--:|--:|--:|--:|--:|"
        )
        for wrong in WRONG:
            off, others = [], 0
            for log, heading in logs:
                right = wrong._replace(right=str(heading)) if wrong.key == "start.theta_deg" else wrong
                value = str(heading + float(wrong.value)) if right is not wrong else wrong.value
                found = findings(log, f"{wrong.key}={value}")
                off.append(right.cured(found))
                told = [key for o in found for key in {c.partition("=")[0] for c in o.fixes[:1]}]
                others += sum(key not in {wrong.key, wrong.also} for key in told)
            click.echo(row(wrong, off, others))


if __name__ == "__main__":
    main()
