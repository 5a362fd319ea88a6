"""A report as a notebook shows it: verdicts and one table as HTML, in the notebook's own style."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from . import summary as over
from .render import html, html_text
from .tables import configurations


def render(report: Mapping[str, Any]) -> str:
    """Return verdicts and main figures of a report. Text from the log is escaped."""
    return _verdicts(report.get("verdicts", {})) + html(configurations(report))


def render_summary(summary: Mapping[str, Any]) -> str:
    """Return headline, verdicts and the figures of every configuration over several logs."""
    head = f"<p>{html_text(over.headline(summary))}</p>"
    return head + _verdicts(summary["verdicts"]) + html(over.table(summary))


def _verdicts(found: Mapping[str, Mapping[str, Any]]) -> str:
    return "".join(
        f"<p><b>{html_text(sensor)} {html_text(v['verdict'])}.</b> {html_text(v['words'])}</p>"
        for sensor, v in found.items()
    )
