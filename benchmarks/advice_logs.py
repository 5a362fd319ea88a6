"""Does obeying the advice help on real logs? Every printed fix is set, and the log is compared again.

    LOCFUSE_DATA=folder python -m benchmarks.advice_logs --write

Every log below that the folder holds is compared, then compared with all fixes that were found. With truth the
figure is the position error of the best configuration and of `all`; without it, how well the sensors that only
listen are predicted. `--write` puts the table into docs/advice.md; `--log brenner` runs only some.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from benchmarks.advice import PAGE, put
from locfuse.cli.session.session import load
from locfuse.formats.tables.findings import length


@dataclass(frozen=True)
class RealLog:
    """A log, and what is known of its robot."""

    name: str
    path: str
    sets: tuple[str, ...] = ()


ARENA = (
    "wheels.radius=0.0199962",
    "wheels.track=0.155",
    "start.x=1.87516",
    "start.y=1.91334",
    "start.theta_deg=213",
    "truth.x=0.03",
)
LOGS = (
    RealLog("brenner, as measured", "brenner/brenner.mcap", ARENA),
    RealLog("turtlebot4", "turtlebot4/tb4_mcap.mcap"),
    RealLog("pimouse", "strangers/pimouse.bag"),
    RealLog("mrclam", "mrclam/mrclam.mcap"),
    RealLog("fr079", "fr079/fr079.mcap"),
    RealLog("aces", "aces/aces.mcap"),
)
HEAD = ("| log | finding | fix | judged by | before | after |", "|---|---|---|---|--:|--:|")


def results(one: RealLog, path: Path) -> Iterator[str]:
    """Yield the lines of one log: each finding, then what all fixes together do when they are obeyed."""
    session = load(path, sets=one.sets)
    before = session.compare().report
    findings = before["findings"]
    if not findings:
        yield f"| {one.name} | nothing to fix |  | {_figures(before)} |"
        return
    for finding in findings:
        yield f"| {one.name} | {finding['role']}: {finding['code']} | {' | '.join(_tried(finding))} |"
    if before["fixes"]:
        after = session.with_settings(before["fixes"]).compare(advice=False).report
        names = [n for n in dict.fromkeys((_best(before), _best(after), "all")) if n in before["configurations"]]
        for name in names:
            cells = (_error(before, name), _error(after, name))
            yield f"| {one.name} | **all of it, obeyed** |  | {name} | {' | '.join(cells)} |"


def _tried(finding: Mapping[str, Any]) -> tuple[str, str, str, str]:
    """Return the fix, the configuration that gains most by it, and its figure before and after."""
    fixes, tried = " ".join(f"`{fix}`" for fix in finding["fixes"]), finding["tried"]
    if not fixes or tried is None:
        return "none helps", "", "", ""
    return fixes, tried["configuration"], _score(tried["before"]), _score(tried["after"])


def _figures(report: Mapping[str, Any]) -> str:
    best = _best(report)
    return f"{best} | {_error(report, best)} | "


def _best(report: Mapping[str, Any]) -> str:
    """Return the configuration with the smallest error, without truth the last, which uses most sensors."""
    rows: Mapping[str, Any] = report["configurations"]
    known = {n: v["position_rmse_m"] for n, v in rows.items() if v["position_rmse_m"] is not None}
    return min(known, key=lambda n: known[n]) if known else list(rows)[-1]


def _error(report: Mapping[str, Any], name: str) -> str:
    """Return a configuration's position error, else how it predicts the sensors that it leaves out."""
    values = report["configurations"][name]
    if values["position_rmse_m"] is not None:
        return length(values["position_rmse_m"])
    if values.get("void"):
        return str(values["void"]["reason"])
    ranks = {r["configuration"]: r for r in (report["prediction"] or {}).get("ranking", ())}
    gain = ranks.get(name, {}).get("gain_nats")
    return "" if gain is None else f"{gain:+.2f} nats against odometry"


def _score(score: Mapping[str, float | None]) -> str:
    error, nats = score["position_rmse_m"], score["prediction_nats"]
    return length(error) if error is not None else "" if nats is None else f"{nats:.2f} nats"


def table(chosen: Sequence[RealLog], folder: Path) -> Iterator[str]:
    """Yield the table's lines; a log that is not there is said to be missing."""
    yield from HEAD
    for one in chosen:
        path = folder / one.path
        if path.exists():
            click.echo(one.name, err=True)
            yield from results(one, path)
        else:
            click.echo(f"{path}: missing", err=True)


@click.command()
@click.option("--log", "words", multiple=True, help="Only logs whose name holds this word. Repeatable.")
@click.option("--write", is_flag=True, help="Put the table into docs/advice.md.")
def main(words: tuple[str, ...], write: bool) -> None:
    """Print a table of the real logs in LOCFUSE_DATA: every fix, and what obeying all of them does."""
    data = os.environ.get("LOCFUSE_DATA")
    if not data:
        raise click.ClickException("LOCFUSE_DATA is not set: no real logs to try")
    chosen = [one for one in LOGS if not words or any(word in one.name for word in words)]
    lines = []
    for line in table(chosen, Path(data)):
        lines.append(line)
        click.echo(line)
    if write:
        put(PAGE, "logs", lines)


if __name__ == "__main__":
    main()
