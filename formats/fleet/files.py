"""The files over many logs: summary.json, .md, .html and .csv, and fleet.parquet."""

from __future__ import annotations

import io
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

from locfuse.formats.report import json_report
from locfuse.formats.report import summary as over
from locfuse.formats.report.render import csv_text
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
        rows = TableRows(entries, sweep)
        files["summary.csv"] = csv(rows)
        table = parquet(rows)
        files |= {} if table is None else {PARQUET: table}
    if "html" in kinds:
        from .page import render

        files["summary.html"] = render(summary, entries, colours)
    return files


# --- Tables with a row per log, configuration and cell of a sweep, or per failed log: CSV and Parquet

FIRST_COLUMNS = ("log", "robot", "start", "configuration", "cell", "state", "reason")
LAST_COLUMNS = ("lost_bytes", "lost_messages", "key")
TEXT = {*FIRST_COLUMNS, "key", "align"}
NOT_FIGURES = ("configuration", "cell", "slowed", "key")  # values of a configuration


class TableRows:
    """The rows of the table in the order of the logs, and its columns."""

    def __init__(self, entries: Sequence[Entry], sweep: Sequence[str] = ()) -> None:
        self._entries = entries
        configurations = [values for e in entries for values in e.report.get("configurations", {}).values()]
        figures = dict.fromkeys(key for values in configurations for key in values if key not in NOT_FIGURES)
        sensors = dict.fromkeys(
            s for e in entries for found in e.report.get("sensors", {}).values() for s in found
        )
        verdicts = dict.fromkeys(s for e in entries for s in e.report.get("verdicts", {}))
        self.sweep = tuple(sweep)  # settings that a sweep varies; text columns
        self.columns = (
            *FIRST_COLUMNS,
            *self.sweep,
            *figures,
            *(f"{s}_{count}" for s in sensors for count in COUNTS),
            *(f"{s}_verdict" for s in verdicts),
            *LAST_COLUMNS,
        )

    def __iter__(self) -> Iterator[dict[str, Any]]:
        """Yield rows as column -> value, without missing values."""
        for entry in self._entries:
            lead = {"log": entry.name, "robot": entry.robot, "state": entry.state, "reason": entry.reason or None}
            if entry.state == "done":
                yield from self._of(entry, lead)
            else:
                yield lead

    def _of(self, entry: Entry, lead: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
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


def csv(rows: TableRows) -> str:
    """Return the rows as CSV in full precision, with empty missing values."""
    return csv_text(rows.columns, ([row.get(column) for column in rows.columns] for row in rows))


def parquet(rows: TableRows) -> bytes | None:
    """Return the rows as Parquet; None without pyarrow, which is a dependency of rerun-sdk."""
    try:
        import pyarrow as pa
        from pyarrow import parquet as written
    except ImportError:
        return None
    text = {*TEXT, *rows.sweep, *(c for c in rows.columns if c.endswith("_verdict"))}
    found = list(rows)
    sink = io.BytesIO()
    columns = {c: _column(pa, [row.get(c) for row in found], c in text) for c in rows.columns}
    written.write_table(pa.table(columns), sink, compression="zstd")
    return sink.getvalue()


def _column(pa: Any, values: list[Any], text: bool) -> Any:
    """Return a pyarrow column of text, integers, booleans or floats; missing values are null."""
    known = [v for v in values if v is not None]
    if text or any(isinstance(v, str) for v in known):
        return pa.array([None if v is None else str(v) for v in values], pa.string())
    if known and all(isinstance(v, bool) for v in known):
        return pa.array(values, pa.bool_())
    if known and all(isinstance(v, int) and not isinstance(v, bool) for v in known):
        return pa.array(values, pa.int64())
    return pa.array([None if v is None else float(v) for v in values], pa.float64())
