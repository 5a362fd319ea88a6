"""summary.html: one self-contained page over all logs, with links to the page of each log.

Content that grows with the number of logs is aggregated (distributions, days) or limited to the worst rows: ten
thousand logs give a page below 3 MB.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import date
from importlib.resources import files
from pathlib import PurePosixPath
from statistics import median
from typing import Any
from urllib.parse import quote

import numpy as np
from markupsafe import Markup
from msgspec.structs import replace

from locfuse.formats.figures import palette
from locfuse.formats.figures.palette import Trace
from locfuse.formats.figures.panels import Band, Curve, Dots, Panel, Section
from locfuse.formats.report import summary as over
from locfuse.formats.report.html import page_of, section_drawings
from locfuse.formats.report.table import SIGNS, Cell, Column, Swatches, Table, html, of_rows
from locfuse.formats.report.tables import RMSE
from locfuse.fusion.data import Array, Colour

from .entry import Entry

RMSE_M = "position rmse, m"
MAX_ROWS = 200  # of each table on the page; all rows are in summary.csv
MAX_CONFIGURATIONS = 12  # columns of the table of logs
LOG, ROBOT = (Column(key, key, kind="text") for key in ("log", "robot"))
MAX_TINT_RATIO, MAX_TINT_PERCENT = 10.0, 30  # error / smallest error of the log at the strongest tint


def render(summary: Mapping[str, Any], entries: Sequence[Entry], sensors: Mapping[str, Colour]) -> str:
    """Return summary.html. `sensors`: the colour of every sensor known to locfuse."""
    figures = sections(summary, entries)
    traces = _traces(entries)
    swatches = Swatches(palette.colours(traces, sensors), palette.looks_of(traces))
    shown = {mark.of for s in figures for p in s.panels for mark in p.marks}
    return page_of(
        files(__package__) / "fleet.html.j2",
        summary["locfuse"],
        swatches,
        script=False,
        summary=summary,
        headline=over.headline(summary),
        replicates=_replicates(summary),
        table=lambda found, painted=False, most=None: Markup(
            html(replace(found, rows=found.rows[:most]), swatches if painted else None)
        ),
        max_rows=MAX_ROWS,
        over=over,
        sections=[section_drawings(s, swatches) for s in figures],
        legend=[(name, swatches.slugs[name]) for name in summary["configurations"] if name in shown],
        logs=logs(summary, entries),
        findings=findings(entries),
        robots=robots(summary, entries),
        matrix=matrix(entries),
        failures=_without_figure(entries),
        losses=_losses(entries),
    )


def _traces(entries: Sequence[Entry]) -> dict[str, Trace]:
    """Return the style of each configuration by its name; dashed for cells of a sweep."""
    found: dict[str, Trace] = {}
    for entry in entries:
        for name, values in entry.report.get("configurations", {}).items():
            sensors = tuple(entry.report["sensors"][name])
            what_if = bool(values["slowed"] or values["cell"])
            found.setdefault(name, Trace(values["configuration"], sensors, what_if, values["smoothed"]))
    return found


def _replicates(summary: Mapping[str, Any]) -> str:
    """Return a sentence on the number of logs and robots behind the confidence intervals."""
    of = summary["replicates"]
    if of["of"] == "robots":
        return (
            f"{of['logs']} logs of {of['robots']} robots. Means are of each robot first, then over robots, with "
            "Student's 95 % interval from four robots on: logs of one robot share its wheels and mounts."
        )
    return (
        f"{of['logs']} logs. Robots are not named (--robot-from), so each log counts as independent: intervals "
        "are too narrow where several logs are of one robot."
    )


def _error(entry: Entry, configuration: str) -> float | None:
    value = entry.report.get("configurations", {}).get(configuration, {}).get(RMSE.key)
    return None if value is None else float(value)


def logs(summary: Mapping[str, Any], entries: Sequence[Entry]) -> tuple[Table, list[str]]:
    """Return the table of errors (logs x configurations), worst log first, and notes on omitted rows and columns.

    The name of a log links to its page; cell colours compare the errors of a log.
    """
    best, every = summary["best"], list(summary["configurations"])
    names = every[:MAX_CONFIGURATIONS]
    known = [(error, entry) for entry in entries if best and (error := _error(entry, best)) is not None]
    worst = [entry for _, entry in sorted(known, key=lambda pair: -pair[0])]
    rows = [_log(entry, best, names) for entry in worst[:MAX_ROWS]]
    columns = (LOG, ROBOT, *(Column(name, name, form=RMSE.form) for name in names))
    table = Table(columns, tuple(rows), "Position error of every log")
    if not any(entry.robot for entry in worst):
        table = table.without("robot")
    left = [(len(worst) - len(rows), "logs"), (len(every) - len(names), "configurations")] if rows else []
    return table, [f"{n} more {what}" for n, what in left if n]


def _log(entry: Entry, best: str, names: Sequence[str]) -> tuple[Cell, ...]:
    """Return a log's row: its name, its robot, and the position error of each configuration."""
    folder = PurePosixPath(entry.name, entry.report["configurations"][best]["cell"].replace(" ", ","))
    errors = [_error(entry, name) for name in names]
    least = min((e for e in errors if e), default=0.0)
    cells = [Cell(entry.name, link=f"{quote(str(folder))}/report.html"), Cell(entry.robot)]
    for error in errors:  # green for the log's smallest error, redder for larger ones
        share = min(math.log(error / least) / math.log(MAX_TINT_RATIO), 1.0) if error else 0.0
        percent = MAX_TINT_PERCENT * share if share else MAX_TINT_PERCENT
        colour = f"var(--{'bad' if share else 'good'}) {percent:.0f}%"
        cells.append(Cell(error, tint=f"color-mix(in srgb,{colour},transparent)" if error else ""))
    return tuple(cells)


def robots(summary: Mapping[str, Any], entries: Sequence[Entry]) -> Table:
    """Return the table of robots, largest median error first.

    Columns: numbers of logs and of failed logs, the best configuration on this robot, and median, 90 % quantile
    and maximum of the errors [m] with the configuration that is best over all logs.
    """
    best = summary["best"]
    rows: list[dict[str, Any]] = []
    for robot in dict.fromkeys(e.robot for e in entries if e.robot is not None):
        own = [e for e in entries if e.robot == robot]
        errors = sorted(x for e in own if best and (x := _error(e, best)) is not None)
        rows.append(
            {
                "robot": robot,
                "logs": len(own),
                "failed": sum(e.state == "failed" for e in own),
                "best": best_of(own),
                "median": median(errors) if errors else None,
                "p90": float(np.quantile(errors, 0.9)) if errors else None,
                "worst": errors[-1] if errors else None,
            }
        )
    rows.sort(key=lambda row: -(row["median"] or 0.0))
    of = f"{best}: " if best else ""
    columns = (
        ROBOT,
        Column("logs", "logs"),
        Column("failed", "failed"),
        Column("best", "best on it", kind="text"),
        Column("median", f"{of}median", "m", "{:.4f}"),
        Column("p90", "p90", "m", "{:.4f}"),
        Column("worst", "worst", "m", "{:.4f}"),
    )
    return of_rows(columns, rows)


def best_of(entries: Sequence[Entry]) -> str | None:
    """Return the configuration with the smallest median error over the logs; None if none can be compared.

    A configuration can be compared if it has an error in every log in which any configuration has one.
    """
    judged = [e for e in entries if any(_error(e, c) is not None for c in e.report.get("configurations", {}))]
    names = dict.fromkeys(c for e in judged for c in e.report["configurations"])
    errors = {c: [x for e in judged if (x := _error(e, c)) is not None] for c in names}
    everywhere = {c: median(found) for c, found in errors.items() if found and len(found) == len(judged)}
    return min(everywhere, key=lambda c: everywhere[c]) if everywhere else None


def matrix(entries: Sequence[Entry]) -> Table:
    """Return the table robot x sensor with the number of logs by verdict.

    Robots with most "hurts" per log come first.
    """
    sensors = list(dict.fromkeys(s for e in entries for s in e.report.get("verdicts", {})))
    groups: dict[str, list[Entry]] = {}
    for e in entries:
        if e.report.get("verdicts"):
            groups.setdefault(e.robot or "all logs", []).append(e)
    rows = []
    for robot, own in groups.items():
        counts = {s: Counter(v for e in own if (v := e.report["verdicts"].get(s))) for s in sensors}
        rows.append((-sum(c["hurts"] for c in counts.values()) / len(own), robot, counts))
    rows.sort(key=lambda row: row[:2])
    shown: list[dict[str, str | None]] = []
    for _, robot, counts in rows:
        shown.append({"robot": robot})
        for s, verdicts in counts.items():
            signed = [(f"{SIGNS.get(v, '●')} {v}", n) for v, n in verdicts.most_common()]
            numbered = [words if len(signed) == 1 else f"{words} {n}" for words, n in signed]  # if not all agree
            shown[-1][f"of {s}"] = ", ".join(numbered) or None
    return of_rows((ROBOT, *(Column(f"of {s}", s, kind="text") for s in sensors)), shown)


def findings(entries: Sequence[Entry]) -> Table:
    """Return the table of findings over all logs, most frequent first, each with the message of one log."""
    found: dict[tuple[str, str], dict[str, Any]] = {}
    for e in entries:
        for role, code, message, fixed in e.report.get("findings", ()):
            first = {"role": role, "logs": 0, "fixed": 0, "example": f"{e.name}: {message}"}
            row = found.setdefault((role, code), first)
            row["logs"] += 1
            row["fixed"] += fixed
    columns = (
        Column("role", "of", kind="text"),
        Column("logs", "logs"),
        Column("fixed", "with a fix"),
        Column("example", "for example", kind="long"),
    )
    return of_rows(columns, sorted(found.values(), key=lambda row: -row["logs"]))


def _without_figure(entries: Sequence[Entry]) -> Table:
    """Return the table of logs without an error figure: the state (failed, void, no truth) and the reason."""
    status, why = Column("state", "state", kind="text"), Column("reason", "reason", kind="long", missing="")
    columns = LOG, ROBOT, status, why
    rows = []
    for e in entries:
        unjudged = all(_error(e, name) is None for name in e.report.get("configurations", {}))
        state = e.state if e.state != "done" else "void" if e.void else "no truth" if unjudged else ""
        if state:
            rows.append({"log": e.name, "robot": e.robot, "state": state, "reason": e.reason or "; ".join(e.void)})
    return of_rows(columns, rows)


def _losses(entries: Sequence[Entry]) -> Table:
    numbers = (Column("bytes", "bytes"), Column("messages", "messages"))
    columns = (LOG, *numbers, Column("reasons", "reasons", kind="long"))
    found = (e for e in entries if e.report.get("input", {}).get("losses"))
    rows = ({"log": e.name, **e.losses, "reasons": ", ".join(e.report["input"]["losses"])} for e in found)
    return of_rows(columns, rows)


# --- Figures: distribution of the errors over the logs, and their change from day to day

CURVE_POINTS = 101  # points of the curve of a distribution
MAX_CURVES = 12  # configurations in one figure: the best by median
FEW_LOGS = 3  # smallest number of logs for a distribution


def sections(summary: Mapping[str, Any], entries: Sequence[Entry]) -> list[Section]:
    """Return the figures for which there are enough logs: distribution and trend of the errors."""
    names = summary["configurations"]
    errors = {name: np.sort([v for e in entries if (v := _error(e, name) or 0.0) > 0.0]) for name in names}
    known = {name: v for name, v in errors.items() if len(v)}
    best = dict(sorted(known.items(), key=lambda pair: float(np.median(pair[1])))[:MAX_CURVES])
    found = [_distribution(best)] if any(len(v) >= FEW_LOGS for v in best.values()) else []
    return [*found, *_trend(summary["best"], entries)]


def _distribution(errors: Mapping[str, Array]) -> Section:
    """Return the figure of quantiles of the position error [m] over the share of logs [%]."""
    share = np.linspace(0.0, 100.0, CURVE_POINTS)
    marks = tuple(Curve(name, share, np.percentile(v, share)) for name, v in errors.items())
    words = "; ".join(f"{name}: median {np.median(v):.4g} m, worst {v[-1]:.4g} m" for name, v in errors.items())
    label = "% of the logs stay below"
    panel = Panel("distribution", "Position rmse", RMSE_M, label, marks, words, log=True, x_range=(0.0, 100.0))
    text = "At 50 the median log, at 90 what nine of ten logs stay below, at 100 the worst."
    return Section("distribution", "How errors are distributed over the logs", text, (panel,), columns=1)


def _trend(best: str | None, entries: Sequence[Entry]) -> list[Section]:
    """Return the figure of the best configuration's error by day; [] if all logs are of one day."""
    days: dict[date, list[float]] = {}
    for entry in entries:
        value = _error(entry, best) if best else None
        start = entry.report.get("input", {}).get("start")
        if value is not None and value > 0.0 and start:
            days.setdefault(date.fromisoformat(start[:10]), []).append(value)
    if best is None or len(days) < 2:
        return []
    first = min(days)
    x = np.array([(day - first).days for day in sorted(days)], float)
    low, middle, high = np.array([np.percentile(days[day], (10.0, 50.0, 90.0)) for day in sorted(days)]).T
    marks = (Band(best, x, low, high), Curve(best, x, middle), Dots(best, x, middle))
    panel = Panel("trend", "Position rmse by day", RMSE_M, f"days since {first}", marks, "median by day", log=True)
    text = f"The median of {best} on each day; the band holds the logs between 10 and 90 %."
    return [Section("trend", "From day to day", text, (panel,), columns=1)]
