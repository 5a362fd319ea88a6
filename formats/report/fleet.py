"""Reports over many logs: the short form of each log's report, a row per log (CSV, Parquet), and one HTML page.

Ten thousand short forms fit into memory. On the page, what grows with the number of logs is aggregated
(distributions, days) or limited to the worst rows: ten thousand logs give a page below 3 MB.
"""

from __future__ import annotations

import io
import math
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from datetime import date
from importlib.resources import files
from pathlib import PurePosixPath
from statistics import median
from typing import Any, Literal, NamedTuple
from urllib.parse import quote

import msgspec
import numpy as np
from markupsafe import Markup
from msgspec.structs import replace

from locfuse.formats.figures import palette
from locfuse.formats.figures.palette import Trace
from locfuse.formats.figures.panels import Band, Curve, Dots, Panel, Section
from locfuse.fusion.data import Array, Colour

from . import json_report, summary as over
from .findings import void_reasons
from .html import page_of, section_drawings
from .table import SIGNS, Cell, Column, Swatches, Table, csv_text, html, of_rows
from .tables import RMSE

State = Literal["done", "failed", "not run"]
COUNTS = ("accepted", "rejected", "absent", "nis")  # of a sensor in a configuration
EFFECTS = ("credit", "alone", "leave_one_out")  # of a sensor on the position error


class Entry(msgspec.Struct, frozen=True):
    """One log of many: its state and the short form of its report."""

    name: str
    robot: str | None = None
    state: State = "done"
    reason: str = ""  # why it failed or was not run, in one line
    report: Mapping[str, Any] = {}  # short form by `slim`; empty unless done
    cells: tuple[str, ...] = ()  # names of the cells of a sweep; a cell is one combination of settings

    @property
    def losses(self) -> dict[str, int]:
        """Unreadable bytes and messages of the log."""
        places = (self.report.get("input", {}).get("losses") or {}).values()
        return {unit: sum(p[unit] for p in places) for unit in ("bytes", "messages")}

    @property
    def void(self) -> list[str]:
        """Reasons why error figures of this log are void (not valid)."""
        return list(self.report.get("void") or ())

    @property
    def doubtful(self) -> list[str]:
        """Reasons why error figures of this log are doubtful; its verdicts are then withdrawn."""
        return list(self.report.get("doubtful") or ())


def label(configuration: str, cell: str) -> str:
    """Return the name of a configuration in a cell of a sweep: "lrf [lrf.noise=0.1]"."""
    return f"{configuration} [{cell}]" if cell else configuration


def slim(reports: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Return the short form of the reports of one log.

    `reports` maps a cell of a sweep (a combination of settings; "" without a sweep) to its report. Verdicts and
    effects are taken from the first cell.
    """
    first = next(iter(reports.values()))
    source = first["input"]
    return {
        "input": {key: source.get(key) for key in ("name", "size", "identity", "sha256", "start", "losses")},
        "configurations": {
            label(name, cell): {
                **{key: value for key, value in values.items() if not isinstance(value, Mapping | list)},
                "configuration": name,
                "cell": cell,
                "slowed": bool(values.get("rates_hz")),
                "key": report.get("key"),
            }
            for cell, report in reports.items()
            for name, values in report["configurations"].items()
        },
        "sensors": {
            label(name, cell): {s: [found[c] for c in COUNTS] for s, found in values["sensors"].items()}
            for cell, report in reports.items()
            for name, values in report["configurations"].items()
        },
        "void": list(dict.fromkeys(line for report in reports.values() for line in void_reasons(report))),
        "doubtful": [v["message"] for v in first.get("validity") or () if not v["void"]],
        "findings": [(f["role"], f["code"], f["message"], bool(f["fixes"])) for f in first.get("findings") or ()],
        "verdicts": {sensor: v["verdict"] for sensor, v in (first.get("verdicts") or {}).items()},
        "credit": _effects(first.get("credit")),
        "measured": first.get("measured"),
    }


def _effects(credit: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """Return each sensor's effects without confidence intervals, which are computed over all logs later."""
    if not credit:
        return None
    sensors = {
        sensor: {
            "verdict": "",
            **{key: found[key] for key in ("share", "anees_without", "anees_with", "beside")},
            **{name: (e := found[name]) and {"ln": e["ln"], "expected": e["expected"]} for name in EFFECTS},
        }
        for sensor, found in credit["sensors"].items()
    }
    return {"complete": credit["complete"], "total_factor": credit["total_factor"], "sensors": sensors}


KINDS = frozenset({"json", "md", "csv", "html"})
PARQUET = "fleet.parquet"


def summary_files(
    summary: Mapping[str, Any],
    entries: Sequence[Entry],
    asked: Collection[str],
    colours: Mapping[str, Colour],
    sweep: Sequence[str] = (),
) -> dict[str, str | bytes]:
    """Return file name -> content: summary.json, and the kinds in `asked` (all kinds if it is empty).

    `colours`: the colour of every sensor known to locfuse.
    """
    kinds = KINDS.intersection(asked) or KINDS
    files: dict[str, str | bytes] = {"summary.json": json_report.encode(summary)}
    if "md" in kinds:
        files["summary.md"] = over.render(summary)
    if "csv" in kinds:
        table = fleet_table(entries, sweep)
        files["summary.csv"] = csv(table)
        packed = parquet(table)
        files |= {} if packed is None else {PARQUET: packed}
    if "html" in kinds:
        files["summary.html"] = _page(summary, entries, colours)
    return files


# --- Tables with a row per log, configuration and cell of a sweep, or per failed log: CSV and Parquet

FIRST_COLUMNS = ("log", "robot", "start", "configuration", "cell", "state", "reason")
LAST_COLUMNS = ("lost_bytes", "lost_messages", "key")
TEXT = {*FIRST_COLUMNS, "key", "align"}
NOT_FIGURES = ("configuration", "cell", "slowed", "key")  # entries of a configuration without a figure


class FleetTable(NamedTuple):
    """Columns of the table, and its rows in the order of the logs; a row lacks the keys of missing values."""

    columns: tuple[str, ...]
    rows: list[dict[str, Any]]
    text: frozenset[str]  # columns of text


def fleet_table(entries: Sequence[Entry], sweep: Sequence[str] = ()) -> FleetTable:
    """Return the table of all logs; `sweep`: the settings that a sweep varies."""
    reports = [e.report for e in entries if e.state == "done"]
    figures = dict.fromkeys(key for r in reports for values in r["configurations"].values() for key in values)
    sensors = dict.fromkeys(s for r in reports for found in r["sensors"].values() for s in found)
    verdicts = [f"{s}_verdict" for s in dict.fromkeys(s for r in reports for s in r["verdicts"])]
    columns = (
        *FIRST_COLUMNS,
        *sweep,
        *(key for key in figures if key not in NOT_FIGURES),
        *(f"{s}_{count}" for s in sensors for count in COUNTS),
        *verdicts,
        *LAST_COLUMNS,
    )
    return FleetTable(columns, [r for e in entries for r in _rows(e)], frozenset({*TEXT, *sweep, *verdicts}))


def _rows(entry: Entry) -> Iterator[dict[str, Any]]:
    lead = {"log": entry.name, "robot": entry.robot, "state": entry.state, "reason": entry.reason or None}
    if entry.state != "done":
        yield lead
        return
    report, lost = entry.report, entry.losses
    for name, values in report["configurations"].items():
        counts = {
            f"{s}_{count}": value
            for s, found in report["sensors"][name].items()
            for count, value in zip(COUNTS, found, strict=True)
        }
        yield {
            **lead,
            "start": report["input"]["start"],
            **dict(word.split("=", 1) for word in values["cell"].split(" ") if "=" in word),
            **values,
            **counts,
            **{f"{s}_verdict": verdict for s, verdict in report["verdicts"].items()},
            **{f"lost_{unit}": n for unit, n in lost.items()},
        }


def csv(table: FleetTable) -> str:
    """Return the table as CSV in full precision; missing values are empty."""
    return csv_text(table.columns, ([row.get(column) for column in table.columns] for row in table.rows))


def parquet(table: FleetTable) -> bytes | None:
    """Return the table as Parquet; None if pyarrow (a dependency of rerun-sdk) is not installed."""
    try:
        import pyarrow as pa
        from pyarrow import parquet as written
    except ImportError:
        return None

    def column(name: str) -> Any:
        found = pa.array([row.get(name) for row in table.rows], pa.string() if name in table.text else None)
        return found.cast(pa.float64()) if pa.types.is_null(found.type) else found

    sink = io.BytesIO()
    written.write_table(pa.table({c: column(c) for c in table.columns}), sink, compression="zstd")
    return sink.getvalue()


RMSE_M = "position rmse, m"
MAX_ROWS = 200  # of each table on the page; all rows are in summary.csv
MAX_CONFIGURATIONS = 12  # columns of the table of logs
LOG, ROBOT = (Column(key, key, kind="text") for key in ("log", "robot"))
MAX_TINT_RATIO, MAX_TINT_PERCENT = 10.0, 30  # error / smallest error of the log at the strongest tint


def _page(summary: Mapping[str, Any], entries: Sequence[Entry], sensors: Mapping[str, Colour]) -> str:
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
