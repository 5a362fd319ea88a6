"""Does obeying the advice help on real logs? Every printed fix is set, and the whole log is compared again.

    LOCFUSE_DATA=folder python -m benchmarks.advice_logs -o advice_logs.jsonl

Two tables. First every finding with its fix, the configuration by which it was judged and that one's figure
before and after, as printed. Then what all fixes of a log together do when they are obeyed over the whole log:
position error, heading error and ANEES of the best configurations, odometry and `all`, by the log's truth.
Without truth it is how well the sensors are predicted that only listen, in nats per number (more is better; a
reference would be another one under other settings). Beside a file of relations, the relative poses that people
verified by hand count as well. "Worse" is an error that grows by more than 2 % + 0.2 mm (0.02 degrees). The last
column is the CPU time of `compare` over that of `compare --no-advice`; at most 2 + the number of printed fixes is
wanted.

`--log brenner` runs only some.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import click
import numpy as np

from benchmarks import experiment
from benchmarks.advice import MAX_LOSS, MAX_LOSS_DEG, MAX_LOSS_M
from benchmarks.building import EPOCH_S, FAR_S, relation_errors
from benchmarks.experiment import Row
from benchmarks.real_logs import FILES, KNOWN, folder
from locfuse.cli.analysis.settings import set_words
from locfuse.cli.session.session import Session, load
from locfuse.formats.report.findings import length


@dataclass(frozen=True)
class RealLog:
    """A log, and what is known of its robot."""

    name: str  # in FILES
    sets: tuple[str, ...] = ()
    align: str = "none"


ARENA = (*set_words(KNOWN["brenner"]), "wheels.track=0.155")
DATA_SHEET = ("truth.topic=/icp_pose", "wheels.radius=0.30", "wheels.track=1.14")
LOGS = {
    "brenner, as measured": RealLog("brenner", ARENA),
    **{name: RealLog(name) for name in ("turtlebot4", "pimouse", "mrclam")},
    "warthog": RealLog("warthog", DATA_SHEET, "origin"),
    **{name: RealLog(name) for name in ("freiburg-101", "edmonton", "fr079", "aces")},
}


def work(name: str, below: Path) -> Row:
    """Return what is found in one log, and its figures before and after everything that is advised is set."""
    one = LOGS[name]
    path = below / FILES[one.name]
    if not path.exists():
        raise FileNotFoundError(f"{path}: missing")
    session = load(path, sets=one.sets)
    _, without = compared(session, one, advice=False)
    report, cpu = compared(session, one)
    obeyed = session.with_settings(report["fixes"]) if report["fixes"] else session
    after = compared(obeyed, one)[0] if report["fixes"] else report
    relations = path.with_suffix(".relations")
    return {
        "headline": report["headline"],
        "fixes": report["fixes"],
        "again": after["fixes"] if report["fixes"] else [],
        "findings": [finding(f) for f in report["findings"]],
        "before": figures(report),
        "after": figures(after),
        "cpu": [without, cpu],
        "relations": [by_relations(s, relations) for s in (session, obeyed)] if relations.exists() else None,
    }


def compared(session: Session, one: RealLog, advice: bool = True) -> tuple[dict[str, Any], float]:
    """Return the report of `compare` on the whole log, and its CPU time [s]."""
    start = time.process_time()
    report = session.compare(align=one.align, audits=False, advice=advice, smooth=False).report
    return report, time.process_time() - start


def finding(found: Mapping[str, Any]) -> Row:
    """Return one finding: its fixes, or the result of those that were tried, and its figure before and after."""
    tried = found["tried"]
    row = {"what": f"{found['role']}: {found['code']}", "fixes": found["fixes"], "judged": None, "words": ""}
    if not found["fixes"] or tried is None:
        became = "changes little" if found["harmless"] else "makes it worse"
        return row | {"words": became if found["alternatives"] else "nothing says which"}
    scores = [tried[when]["position_rmse_m"] for when in ("before", "after")]
    if None in scores:
        scores = [tried[when]["prediction_nats"] for when in ("before", "after")]
        return row | {"judged": [tried["configuration"], *(f"{score:.2f} nats" for score in scores)]}
    return row | {"judged": [tried["configuration"], *map(length, scores)]}


def figures(report: Mapping[str, Any]) -> Row:
    """Return position error [m], heading error [deg] and ANEES of every configuration, void or not; else nats."""
    found: dict[str, Any] = {}
    for name, values in report["configurations"].items():
        void = values.get("void")
        seen = void["figures"] if void else values
        keys = ("position_rmse_m", "heading_rmse_deg", "anees")
        found[name] = {"errors": [seen.get(key) for key in keys], "void": bool(void)}
    if report["truth"] is None:
        ranking = (report["prediction"] or {"scores": []})["scores"]
        for name in found:
            nats = [s["score_nats"] for s in ranking if s["configuration"] == name]
            found[name] = {"nats": float(np.mean(nats)) if nats else None}
    return found


def by_relations(session: Session, relations: Path) -> list[float]:
    """Return mean errors of relative poses that people verified: near in time [m], [deg], and far [m]."""
    drive = session.drive
    table = np.loadtxt(relations)
    table[:, :2] += EPOCH_S - drive.epoch_ns * 1e-9 + session.robot.settings("lrf").time_offset
    estimates = session.run("lrf", advice=False).filtered
    far = table[:, 1] - table[:, 0] > FAR_S
    (near, turn), (beyond, _) = (relation_errors(estimates.t, estimates.pose, table[rows]) for rows in (~far, far))
    return [float(near.mean()), float(np.degrees(turn.mean())), float(beyond.mean())]


def shown(row: Row) -> Iterator[str]:
    """Yield the configurations that are worth a line: the best ones before and after, and `all`."""
    by_truth = {n: v["errors"][0] for n, v in row["before"].items() if v.get("errors", [None])[0] is not None}
    after = {n: v["errors"][0] for n, v in row["after"].items() if v.get("errors", [None])[0] is not None}
    if not by_truth or not after:
        yield [n for n in row["before"] if "reference" not in n][-1]
        return
    best = (min(found, key=lambda n: found[n]) for found in (by_truth, after))
    yield from (n for n in dict.fromkeys((*best, "odometry", "all")) if n in by_truth and n in after)


def cells(figure: Mapping[str, Any]) -> list[str]:
    """Return position error, heading error and ANEES, or how well sensors are predicted, in words."""
    if "nats" in figure:
        return ["" if figure["nats"] is None else f"{figure['nats']:.2f} nats", "", ""]
    error, turn, anees = figure["errors"]
    words = "" if error is None else f"{length(error)}{', void' if figure['void'] else ''}"
    return [words, "" if turn is None else f"{turn:.2f}°", "" if anees is None else f"{anees:.3g}"]


def grew(before: Mapping[str, Any], after: Mapping[str, Any]) -> bool:
    """Return whether an error of a configuration grew, or a prediction got worse."""
    if "nats" in before:
        return None not in (before["nats"], after["nats"]) and after["nats"] < before["nats"] - MAX_LOSS
    pairs = zip(before["errors"][:2], after["errors"][:2], (MAX_LOSS_M, MAX_LOSS_DEG), strict=True)
    return any(None not in (was, now) and now > was * (1 + MAX_LOSS) + more for was, now, more in pairs)


def found_table(rows: Sequence[Row]) -> list[str]:
    """Return every finding with its fix, and what its trial showed."""
    lines = []
    for row in rows:
        for f in row["findings"]:
            fixes = " ".join(f"`{fix}`" for fix in f["fixes"]) or f["words"]
            lines.append((row["task"][0], f["what"], fixes, *(f["judged"] or ("", "", ""))))
        if not row["findings"]:
            lines.append((row["task"][0], "nothing", "", "", "", ""))
    return experiment.table(("log", "finding", "fix", "judged by", "before", "after"), lines, "45")


def obeyed_table(rows: Sequence[Row]) -> list[str]:
    """Return what obeying all fixes does to the figures of the whole log."""
    lines = []
    for row in rows:
        ratio = f"{row['cpu'][1] / row['cpu'][0]:.1f} x, {len(row['fixes'])} fixes"
        again = " ".join(f"`{fix}`" for fix in row["again"]) or "nothing"
        for name in shown(row):
            before, after = row["before"][name], row["after"][name]
            pairs = (f"{a} -> {b}" if a or b else "" for a, b in zip(cells(before), cells(after), strict=True))
            bad = "**yes**" if row["fixes"] and grew(before, after) else "no"
            lines.append((row["task"][0], name, *pairs, bad, again, ratio))
            again = ratio = ""
        if row["relations"]:
            near, turn, far = (f"{a:.3f} -> {b:.3f}" for a, b in zip(*row["relations"], strict=True))
            lines.append(
                (row["task"][0], "relations, lrf", f"near {near} m, far {far} m", f"{turn}°", "", "", "", "")
            )
    head = ("log", "configuration", "position error", "heading", "ANEES", "worse", "compared again", "CPU")
    return experiment.table(head, lines)


@click.command()
@click.option("--log", "words", multiple=True, help="Only logs whose name holds this word. Repeatable.")
@click.option("--jobs", default=1, show_default=True)
@click.option("-o", "out", type=click.Path(path_type=Path), default=Path("advice_logs.jsonl"), show_default=True)
def main(words: tuple[str, ...], jobs: int, out: Path) -> None:
    """Print what is found in the real logs of LOCFUSE_DATA; logs in the file of -o are not run again."""
    names = [(name,) for name in LOGS if not words or any(word in name for word in words)]
    made = experiment.rows(partial(work, below=folder()), names, out, jobs, show=lambda row: row["task"][0])
    found = experiment.well(made)
    lines = [*found_table(found), "", *obeyed_table(found)]
    for line in (*lines, *experiment.failures(made)):
        click.echo(line)


if __name__ == "__main__":
    main()
