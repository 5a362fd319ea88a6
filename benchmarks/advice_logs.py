"""Does obeying the advice help on real logs? Every printed fix is set, and the log is compared again.

    LOCFUSE_DATA=folder python -m benchmarks.advice_logs --write

Every log below that the folder holds is compared, then compared with all fixes that were found. With truth the
figure is the position error of the best configuration and of `all`; without it, how well the sensors that only
listen are predicted; beside a file of relations, that of the relative poses too. `--write` puts the table into
docs/advice.md; `--log brenner` runs only some.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np

from benchmarks.advice import PAGE
from benchmarks.building import FAR_S
from benchmarks.experiment import put
from benchmarks.relations import EPOCH_S, relation_errors
from locfuse.cli.advice.evaluator import standard
from locfuse.cli.advice.trial import Trial
from locfuse.cli.analysis.settings import silent
from locfuse.cli.session.session import Session, load
from locfuse.formats.report.findings import length


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
AGAIN = "compared again: "


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
    if not before["fixes"]:
        return
    obeyed = session.with_settings(before["fixes"])
    compared = obeyed.compare()
    again = " ".join(f"`{fix}`" for fix in compared.report["fixes"]) or "nothing to fix"
    for name, *cells in _obeyed(session, before, obeyed, compared.report):
        yield f"| {one.name} | **all of it, obeyed** | {AGAIN}{again} | {name} | {' | '.join(cells)} |"
        again = "the same"
    relations = path.with_suffix(".relations")
    if relations.exists():
        cells = [_by_relations(s, relations) for s in (session, obeyed)]
        yield f"| {one.name} | **all of it, obeyed** |  | {relations.name}, lrf | {' | '.join(cells)} |"


def _obeyed(
    session: Session, before: Mapping[str, Any], obeyed: Session, after: Mapping[str, Any]
) -> Iterator[tuple[str, str, str]]:
    """Yield configurations with their figures before and after.

    By truth the best ones and `all`; without truth the one of most sensors, by what it predicts: a reference would
    be another one under other settings.
    """
    if before["truth"] is not None:
        for name in dict.fromkeys((_best(before), _best(after), "all")):
            if name in before["configurations"]:
                yield name, _error(before, name), _error(after, name)
        return
    name = list(before["configurations"])[-1]
    scores = [
        Trial(s.loaded, {c.name: c for c in standard(s.loaded)}, "none", silent)((), (name,))[name]
        for s in (session, obeyed)
    ]
    was, now = (_score({"position_rmse_m": None, "prediction_nats": score.prediction}) for score in scores)
    yield name, was, now


def _by_relations(session: Session, relations: Path) -> str:
    """Return the mean errors of relative poses that people verified by hand: of scans near and far in time."""
    drive = session.loaded.drive
    table = np.loadtxt(relations)
    table[:, :2] += EPOCH_S - drive.epoch_ns * 1e-9 + session.robot.settings("lrf").time_offset
    estimates = session.run("lrf", advice=False).filtered
    far = table[:, 1] - table[:, 0] > FAR_S
    (near, turn), (beyond, _) = (relation_errors(estimates.t, estimates.pose, table[rows]) for rows in (~far, far))
    return f"{length(float(near.mean()))}, {np.degrees(turn.mean()):.2f}°; far {length(float(beyond.mean()))}"


def _tried(finding: Mapping[str, Any]) -> tuple[str, str, str, str]:
    """Return the fix, the configuration that gains most by it, and its figure before and after."""
    fixes, tried = " ".join(f"`{fix}`" for fix in finding["fixes"]), finding["tried"]
    if not fixes or tried is None:
        tried = "changes little" if finding["harmless"] else "makes it worse"
        return tried if finding["alternatives"] else "nothing says which", "", "", ""
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
    """Return a configuration's position error, void or not; "" where it has none."""
    values = report["configurations"][name]
    if values["position_rmse_m"] is not None:
        return length(values["position_rmse_m"])
    void = values.get("void")
    return f"{length(void['figures']['position_rmse_m'])}, void" if void else ""


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
