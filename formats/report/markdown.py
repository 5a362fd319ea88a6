"""report.md: the comparison as Markdown that fits a pull request: verdicts, one table, the rest folded away."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from .columns import cell, columns_of
from .notes import notes_of

SIGNS = {"helps": "▲", "does nothing": "■", "hurts": "▼"}


def render(report: Mapping[str, Any]) -> str:
    """Return the report as Markdown. Text from the log is escaped."""
    source = report["input"]
    details = [
        _table(report, main=False) if report["truth"] else "",
        _sensors(report),
        _listing("Absent", dict(report["absent"])),
        _listing("Dropped", {k: counts(v) for k, v in source["dropped"].items()}),
        _listing("Lost", {k: counts(v) for k, v in source["losses"].items()}),
    ]
    parts = [
        f"# locfuse: {escape(source['name'])}",
        _verdicts(report),
        _table(report, main=True),
        _truth_line(report),
        _prediction(report),
        _listing("Noise", {v["words"]: "" for v in report.get("consistency", {}).values()}),
        _listing("Notes", dict.fromkeys(notes_of(report), "")),
        _folded("All figures, sensors, and what was dropped", details),
        f"Input {code(source['sha256'][:16])}, locfuse {escape(report['locfuse'])}. Deviation = estimate - truth.",
    ]
    return "\n\n".join(p for p in parts if p) + "\n"


def _verdicts(report: Mapping[str, Any]) -> str:
    return "\n".join(
        f"- {SIGNS.get(v['verdict'], '●')} **{escape(sensor)} {v['verdict']}.** {escape(v['words'])}"
        for sensor, v in report.get("verdicts", {}).items()
    )


def _truth_line(report: Mapping[str, Any]) -> str:
    truth = report["truth"]
    if truth is None:
        return "No truth in this log: error figures do not exist."
    aligned = {v["align"] for v in report["configurations"].values()} - {"none"}
    how = f" Estimates were aligned to the truth ({', '.join(sorted(aligned))})." if aligned else ""
    heading = "" if truth["heading"] else " It has no heading."
    return f"Truth: {code(truth['topic'])}, {truth['used']} of {truth['stamps']} stamps used.{heading}{how}"


def _prediction(report: Mapping[str, Any]) -> str:
    prediction = report.get("prediction")
    if not prediction:
        return ""
    rows = [
        (
            escape(r["configuration"]),
            "-" if r["gain_nats"] is None else f"{r['gain_nats']:+.3f}",
            ", ".join(r["sensors"]),
        )
        for r in prediction["ranking"]
    ]
    return escape(prediction["trust"]) + "\n\n" + _grid(("ranked by prediction", "nats", "of"), rows, "lrl")


def _table(report: Mapping[str, Any], main: bool) -> str:
    rows = report["configurations"]
    columns = columns_of(rows, main)
    heads = ["configuration", *(f"{c.title}, {c.unit}" if c.unit else c.title for c in columns)]
    cells = [(escape(name), *(cell(c, v.get(c.key)) for c in columns)) for name, v in rows.items()]
    return _grid(heads, cells, "l" + "r" * len(columns))


def _sensors(report: Mapping[str, Any]) -> str:
    rows = [
        (
            escape(name),
            escape(sensor),
            str(c["accepted"]),
            str(c["rejected"]),
            str(c["absent"]),
            "-" if c["nis"] is None else f"{c['nis']:.2f}",
            counts({k: v for k, v in c["verdicts"].items() if k != "accepted"}),
        )
        for name, values in report["configurations"].items()
        for sensor, c in values["sensors"].items()
        if not values.get("smoothed")  # its measurements are those of the filter
    ]
    heads = ("in", "sensor", "accepted", "rejected", "absent", "NIS", "not accepted")
    return _grid(heads, rows, "llrrrrl") if rows else ""


def _grid(heads: Sequence[str], rows: Sequence[Sequence[str]], sides: str) -> str:
    rule = "|" + "".join("--:|" if side == "r" else "---|" for side in sides)
    return "\n".join(["| " + " | ".join(heads) + " |", rule, *("| " + " | ".join(row) + " |" for row in rows)])


def _folded(title: str, parts: Sequence[str]) -> str:
    inside = "\n\n".join(p for p in parts if p)
    return f"<details><summary>{title}</summary>\n\n{inside}\n\n</details>" if inside else ""


def _listing(title: str, entries: Mapping[str, str]) -> str:
    if not entries:
        return ""
    lines = [f"- {escape(k)}" + (f": {escape(v)}" if v else "") for k, v in entries.items()]
    return f"**{title}**\n\n" + "\n".join(lines)


def counts(by_reason: Mapping[str, int]) -> str:
    """Return "3 out of order, 1 repeat"."""
    return ", ".join(f"{v} {k.replace('_', ' ')}" for k, v in by_reason.items())


def escape(text: str) -> str:
    """Escape what Markdown would read as markup: topic names and notes come from logs."""
    for character in "\\`*_[]<>|":
        text = text.replace(character, "\\" + character)
    return " ".join(text.split())


def code(text: str) -> str:
    """Return a code span, fenced so that no backtick of the text can end it."""
    text = " ".join(text.split()).replace("|", "\\|")
    fence = "`" * (1 + max((len(run) for run in re.findall(r"`+", text)), default=0))
    pad = " " if text.startswith("`") or text.endswith("`") else ""
    return f"{fence}{pad}{text}{pad}{fence}"
