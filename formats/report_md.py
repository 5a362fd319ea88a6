"""report.md: the comparison as Markdown that fits a pull request."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

COLUMNS = (
    ("position rmse", "position_rmse_m", "{:.4f} m"),
    ("median", "position_median_m", "{:.4f} m"),
    ("max", "position_max_m", "{:.4f} m"),
    ("final", "final_position_error_m", "{:.4f} m"),
    ("along rmse", "along_rmse_m", "{:.4f} m"),
    ("cross rmse", "cross_rmse_m", "{:.4f} m"),
    ("heading rmse", "heading_rmse_deg", "{:.3f}°"),
    ("drift /1 m", "drift_1m", "{:.2%}"),
    ("/5 m", "drift_5m", "{:.2%}"),
    ("/10 m", "drift_10m", "{:.2%}"),
    ("ANEES", "anees", "{:.2f}"),
)


def render(report: Mapping[str, Any]) -> str:
    """Return the report as Markdown. Text from the log is escaped."""
    source = report["input"]
    parts = [
        f"# locfuse: {escape(source['name'])}",
        _truth_line(report),
        _table(report),
        _sensors(report),
        _listing("Absent", {k: v for k, v in report["absent"].items()}),
        _listing("Dropped", {k: _counts(v) for k, v in source["dropped"].items()}),
        _listing("Lost", {k: _counts(v) for k, v in source["losses"].items()}),
        _listing("Notes", dict.fromkeys(report["notes"], "")),
        f"Input `{source['sha256'][:16]}`, locfuse {report['locfuse']}. Deviation = estimate - truth.",
    ]
    return "\n\n".join(p for p in parts if p) + "\n"


def _truth_line(report: Mapping[str, Any]) -> str:
    truth = report["truth"]
    if truth is None:
        return "No truth in this log: error figures do not exist."
    aligned = {v["align"] for v in report["configurations"].values()} - {"none"}
    how = f" Estimates were aligned to the truth ({', '.join(sorted(aligned))})." if aligned else ""
    heading = "" if truth["heading"] else " It has no heading."
    return f"Truth: `{escape(truth['topic'])}`, {truth['used']} of {truth['stamps']} stamps used.{heading}{how}"


def _table(report: Mapping[str, Any]) -> str:
    rows = report["configurations"]
    columns = [c for c in COLUMNS if any(v.get(c[1]) is not None for v in rows.values())]
    if not columns:
        columns = [("distance", "distance_m", "{:.2f} m"), ("duration", "duration_s", "{:.1f} s")]
    lines = [
        "| configuration | " + " | ".join(c[0] for c in columns) + " |",
        "|---|" + "--:|" * len(columns),
    ]
    for name, values in rows.items():
        cells = ["-" if values.get(key) is None else form.format(values[key]) for _, key, form in columns]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _sensors(report: Mapping[str, Any]) -> str:
    rows = [
        f"| {name} | {sensor} | {c['accepted']} | {c['rejected']} | {c['absent']} | "
        + ("-" if c["nis"] is None else f"{c['nis']:.2f}")
        + f" | {_counts({k: v for k, v in c['verdicts'].items() if k != 'accepted'})} |"
        for name, values in report["configurations"].items()
        for sensor, c in values["sensors"].items()
    ]
    if not rows:
        return ""
    head = ["| in | sensor | accepted | rejected | absent | NIS | not accepted |", "|---|---|--:|--:|--:|--:|---|"]
    return "\n".join(head + rows)


def _listing(title: str, entries: Mapping[str, str]) -> str:
    if not entries:
        return ""
    lines = [f"- {escape(k)}" + (f": {escape(v)}" if v else "") for k, v in entries.items()]
    return f"**{title}**\n\n" + "\n".join(lines)


def _counts(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{v} {k.replace('_', ' ')}" for k, v in counts.items())


def escape(text: str) -> str:
    """Escape what Markdown would read as markup: topic names and notes come from logs."""
    for character in "\\`*_[]<>|":
        text = text.replace(character, "\\" + character)
    return " ".join(text.split())
