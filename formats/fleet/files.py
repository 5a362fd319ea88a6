"""The files over many logs: summary.json, .md, .html and .csv, and fleet.parquet."""

from __future__ import annotations

import io
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from locfuse.formats.report import json_report, summary as over
from locfuse.formats.report.table import csv_text
from locfuse.formats.whole_files import Content
from locfuse.fusion.data import Colour

from .entry import COUNTS, Entry

KINDS = frozenset({"json", "md", "csv", "html"})
PARQUET = "fleet.parquet"


def summary_files(
    summary: Mapping[str, Any],
    entries: Sequence[Entry],
    asked: Collection[str],
    colours: Mapping[str, Colour],
    sweep: Sequence[str] = (),
) -> dict[str, Content]:
    """Return file name -> content: summary.json, and the kinds in `asked` (all kinds if it is empty).

    `colours`: the colour of every sensor known to locfuse.
    """
    kinds = KINDS.intersection(asked) or KINDS
    files: dict[str, Content] = {"summary.json": json_report.encode(summary)}
    if "md" in kinds:
        files["summary.md"] = over.render(summary)
    if "csv" in kinds:
        table = fleet_table(entries, sweep)
        files["summary.csv"] = csv(table)
        packed = parquet(table)
        files |= {} if packed is None else {PARQUET: packed}
    if "html" in kinds:
        from .page import render

        files["summary.html"] = render(summary, entries, colours)
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
