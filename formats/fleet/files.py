"""The files over all logs of a fleet: summary.json, .md, .html and .csv, and fleet.parquet."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from locfuse.formats.report import json_report
from locfuse.formats.report import summary as over
from locfuse.formats.whole_files import Content
from locfuse.fusion.data import Colour

from .entry import Entry
from .rows import Rows, csv, parquet

KINDS = frozenset({"json", "md", "csv", "html"})
PARQUET = "fleet.parquet"


def summary_files(
    summary: Mapping[str, Any],
    entries: Sequence[Entry],
    asked: Collection[str],
    colours: Mapping[str, Colour],
    sweep: Sequence[str] = (),
) -> dict[str, Content]:
    """Return the content of every file by its name: .json always, others as `asked`, all if none of them is.

    `colours` are those of all sensors known to the product.
    """
    kinds = KINDS.intersection(asked) or KINDS
    files: dict[str, Content] = {"summary.json": json_report.encode(summary)}
    if "md" in kinds:
        files["summary.md"] = over.render(summary)
    if "csv" in kinds:
        rows = Rows(entries, sweep)
        files["summary.csv"] = csv(rows)
        table = parquet(rows)
        files |= {} if table is None else {PARQUET: table}
    if "html" in kinds:
        from .page import render

        files["summary.html"] = render(summary, entries, colours)
    return files
