"""A report as a notebook shows it: verdicts and one table as plain HTML, in the notebook's own style."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from . import summary as over
from .columns import cell, columns_of


def render(report: Mapping[str, Any]) -> str:
    """Return verdicts and main figures of a report. Text from the log is escaped."""
    rows = report["configurations"]
    columns = columns_of(rows, main=True)
    heads = ["configuration", *(f"{c.title}, {c.unit}" if c.unit else c.title for c in columns)]
    cells = [(name, *(cell(c, values.get(c.key)) for c in columns)) for name, values in rows.items()]
    return _verdicts(report.get("verdicts", {})) + _table(heads, cells)


def render_summary(summary: Mapping[str, Any]) -> str:
    """Return headline, verdicts and the mean of every main figure over several logs."""
    columns = over.columns_of(summary)
    heads = ["configuration", *(f"mean {c.title}, {c.unit}" if c.unit else f"mean {c.title}" for c in columns)]
    cells = [
        (name, *(cell(c, v["figures"].get(c.key, {}).get("mean")) for c in columns), str(v["best_in"]))
        for name, v in summary["configurations"].items()
    ]
    head = f"<p>{escape(over.headline(summary))}</p>"
    return head + _verdicts(summary["verdicts"]) + _table([*heads, f"best in, of {summary['judged']}"], cells)


def _verdicts(found: Mapping[str, Mapping[str, Any]]) -> str:
    return "".join(
        f"<p><b>{escape(sensor)} {escape(v['verdict'])}.</b> {escape(v['words'])}</p>"
        for sensor, v in found.items()
    )


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    top = "".join(f"<th>{escape(head)}</th>" for head in heads)
    body = "".join(
        f"<tr><th>{escape(first)}</th>{''.join(f'<td>{escape(text)}</td>' for text in rest)}</tr>"
        for first, *rest in rows
    )
    return f"<table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>"
