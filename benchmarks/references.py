"""Do verdicts by a reference agree with those by truth? Logs that have a truth, judged with it and without it.

    LOCFUSE_DATA=... python -m benchmarks.references
    python -m benchmarks.references --log rounded_triangle

Each log is compared twice: by its truth, and with the truth hidden, so that only a reference and prediction judge.
The sample logs are also compared under wrong settings, where a sensor harms. Printed are both verdicts of every
sensor, and the error of its own configuration by truth and by reference (*: which has the sensor in it). A sensor
helps or hurts, or neither: verdicts agree where they say the same of that, and contradict where one says helps and
the other hurts.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import click

import locfuse

DATA = "LOCFUSE_DATA"
HIDDEN = {"truth.topic": "none"}
SAMPLES = ("rounded_rectangle", "rounded_triangle", "disturbed")
BRENNER = {
    "wheels.radius": 0.0199962,
    "start.x": 1.87516,
    "start.y": 1.91334,
    "start.theta_deg": 213,
    "truth.x": 0.03,
}
WRONG: dict[str, dict[str, Any]] = {
    "compass 5° off, called exact": {"compass.offset_deg": -60, "compass.sigma_deg": 1},
    "compass 40° off, called exact": {"compass.offset_deg": -25, "compass.sigma_deg": 1},
    "laser turned by 4°, called exact": {"lrf.yaw_deg": 4, "lrf.sigma_yaw_deg": 0},
    "camera mirrored": {"camera.clockwise": True},
    "wheels 5 % too large": {"wheels.radius": 0.0525},
}
GRADES = {"helps": 1, "seems to help": 1, "hurts": -1, "seems to hurt": -1, "no effect seen": 0}


class Case(NamedTuple):
    """A log with truth under some settings."""

    name: str
    log: str
    sets: dict[str, Any]


class Row(NamedTuple):
    """One sensor, judged both ways."""

    case: str
    sensor: str
    by_truth: str
    by_reference: str
    error: tuple[float | None, float | None]  # m, of the sensor alone, by truth and by reference
    independent: bool  # the reference that judged it has no part of it

    @property
    def outcome(self) -> str:
        """Whether both verdicts agree."""
        truth, other = GRADES.get(self.by_truth), GRADES.get(self.by_reference)
        if other is None:
            return "no verdict without truth"
        if truth is None:
            return "no verdict by truth"
        return "agree" if truth == other else "contradict" if truth * other < 0 else "one sees no effect"


def cases(data: Path | None) -> Iterator[Case]:
    """Yield the sample logs, as they are and with wrong settings, and real logs with a truth if they are there."""
    for log in SAMPLES:
        yield Case(log, log, {})
    for log in SAMPLES[:2]:
        for name, sets in WRONG.items():
            yield Case(f"{log}, {name}", log, sets)
    if data is not None:
        brenner = str(data / "brenner" / "brenner.mcap")
        for track in (0.155, 0.173):
            yield Case(f"brenner, track {track}", brenner, {**BRENNER, "wheels.track": track})
        right = {"wheels.track": 0.173, "lrf.time_offset": -0.45, "lrf.range_scale": 1.126}
        yield Case("brenner, clock and scale right", brenner, {**BRENNER, **right})


def rows(case: Case) -> Iterator[Row]:
    """Yield every sensor's verdicts and errors with the truth and without it."""
    by_truth, hidden = (
        locfuse.load(case.log, sets={**case.sets, **more}).compare(advice=False, audits=False).report
        for more in ({}, HIDDEN)
    )
    for sensor, verdict in by_truth["verdicts"].items():
        name = next(n for n, v in hidden["configurations"].items() if list(v["sensors"]) == [sensor])
        judged = hidden["configurations"][name]
        yield Row(
            case.name,
            sensor,
            verdict["verdict"],
            hidden["verdicts"].get(sensor, {"verdict": "no verdict"})["verdict"],
            (by_truth["configurations"][name]["position_rmse_m"], judged["position_rmse_m"]),
            not (judged["reference"] or {"shared": [sensor]})["shared"],
        )


@click.command()
@click.option("--log", "names", multiple=True, help="Only cases of this log.")
def main(names: tuple[str, ...]) -> None:
    """Print both verdicts of every sensor, and how often they agree."""
    place = os.environ.get(DATA)
    click.echo("| log | sensor | by truth | without truth | alone, by truth | by reference |")
    click.echo("|---|---|---|---|--:|--:|")
    found: list[Row] = []
    for case in cases(Path(place) if place else None):
        if names and not any(name in case.name for name in names):
            continue
        for row in rows(case):
            found.append(row)
            errors = " | ".join("-" if e is None else f"{e:.3f} m" for e in row.error)
            star = "" if row.independent else " *"
            click.echo(f"| {row.case} | {row.sensor} | {row.by_truth} | {row.by_reference} | {errors}{star} |")
    counts = Counter(row.outcome for row in found)
    click.echo(f"\n{len(found)} sensors: " + ", ".join(f"{what} {n}" for what, n in counts.most_common()) + ".")
    ratios = [b / a for row in found if row.independent for a, b in [row.error] if a and b]
    near = sum(0.9 <= ratio <= 1.1 for ratio in ratios)
    click.echo(
        f"Judged by a reference without it: {len(ratios)} errors, {near} of them within 10 % of the truth's."
    )


if __name__ == "__main__":
    main()
