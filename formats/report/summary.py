"""summary.json, .md, .csv: what several logs say together about each configuration."""

from __future__ import annotations

import csv as csv_format
import io
from collections.abc import Mapping
from statistics import fmean, median
from typing import Any

from .columns import COLUMNS, Column, cell
from .markdown import escape

MAIN = "position_rmse_m"
NOT_ERRORS = ("duration_s", "distance_m", "truth_coverage")
Reports = Mapping[str, Mapping[str, Any]]  # name of the log -> its report.json


def summarise(reports: Reports) -> dict[str, Any]:
    """Return mean, median and worst of every error figure per configuration, and which configuration is best."""
    names = list(dict.fromkeys(name for r in reports.values() for name in r["configurations"]))
    best = {log: best_of(report) for log, report in reports.items()}
    judged = [b for b in best.values() if b is not None]
    configurations = {
        name: {
            "logs": sum(name in r["configurations"] for r in reports.values()),
            "best_in": judged.count(name),
            "figures": _figures(name, reports),
        }
        for name in names
    }
    return {
        "logs": {log: {**_log(report), "best": best[log]} for log, report in reports.items()},
        "judged": len(judged),
        "best": _best_mean(configurations, len(judged)),
        "configurations": configurations,
    }


def best_of(report: Mapping[str, Any]) -> str | None:
    """Return the configuration with the smallest position error of one report; None without truth."""
    known = {n: v[MAIN] for n, v in report["configurations"].items() if v.get(MAIN) is not None}
    return min(known, key=lambda name: known[name]) if known else None


def _best_mean(configurations: Mapping[str, Any], judged: int) -> str | None:
    """Return the configuration with the smallest mean position error among those that every judged log has."""
    known = {n: c["figures"][MAIN] for n, c in configurations.items() if MAIN in c["figures"]}
    everywhere = {n: f["mean"] for n, f in known.items() if f["logs"] == judged}
    return min(everywhere, key=lambda name: everywhere[name]) if everywhere else None


def _log(report: Mapping[str, Any]) -> dict[str, Any]:
    first = next(iter(report["configurations"].values()))
    source = report["input"]
    return {"name": source["name"], "sha256": source["sha256"], "duration_s": first["duration_s"]}


def _figures(name: str, reports: Reports) -> dict[str, dict[str, Any]]:
    rows = {log: r["configurations"][name] for log, r in reports.items() if name in r["configurations"]}
    keys = dict.fromkeys(k for row in rows.values() for k, v in row.items() if is_figure(k, v))
    found = {}
    for key in keys:
        values = {log: float(row[key]) for log, row in rows.items() if row.get(key) is not None}
        # the ANEES of an honest filter is 1: worst is what is furthest from it
        far = {log: max(v, 1.0 / v if v > 0 else v) if key == "anees" else v for log, v in values.items()}
        worst = max(far, key=lambda log: far[log])
        found[key] = {
            "mean": fmean(values.values()),
            "median": median(values.values()),
            "worst": values[worst],
            "worst_log": worst,
            "logs": len(values),
        }
    return found


def is_figure(key: str, value: Any) -> bool:
    """Return whether an entry of a configuration is an error figure that exists."""
    return isinstance(value, float | int) and not isinstance(value, bool) and key not in NOT_ERRORS


def columns_of(summary: Mapping[str, Any]) -> list[Column]:
    """Return the main columns that any configuration has."""
    rows = [c["figures"] for c in summary["configurations"].values()]
    return [c for c in COLUMNS if c.main and any(c.key in row for row in rows)]


def render(summary: Mapping[str, Any]) -> str:
    """Return the summary as Markdown. Names from logs are escaped."""
    logs = summary["logs"]
    parts = [
        f"# locfuse: {len(logs)} logs",
        headline(summary),
        _table(summary),
        "\n".join(
            ["| log | duration | best |", "|---|--:|---|"]
            + [f"| {escape(n)} | {v['duration_s']:.1f} s | {v['best'] or '-'} |" for n, v in logs.items()]
        ),
        "\n\n".join(
            f"**{escape(s)} {v['verdict']}.** {v['words']}" for s, v in summary.get("verdicts", {}).items()
        ),
        f"locfuse {summary['locfuse']}. Deviation = estimate - truth.",
    ]
    return "\n\n".join(p for p in parts if p) + "\n"


def headline(summary: Mapping[str, Any]) -> str:
    """Return in one sentence which configuration is best."""
    best, judged = summary["best"], summary["judged"]
    if best is None:
        return "None of these logs has a truth: error figures do not exist."
    found = summary["configurations"][best]
    mean = found["figures"][MAIN]["mean"]
    rivals = {n: c["best_in"] for n, c in summary["configurations"].items() if n != best and c["best_in"]}
    others = "".join(f", {n} in {k}" for n, k in rivals.items())
    unjudged = len(summary["logs"]) - judged
    left = f" {unjudged} without truth." if unjudged else ""
    wins = f"the best in {found['best_in']} of {judged} logs{others}.{left}"
    return f"Best is {best}: mean position rmse {mean:.4f} m; {wins}"


def _table(summary: Mapping[str, Any]) -> str:
    columns = columns_of(summary)
    if not columns:
        return ""
    heads = [f"{c.title} [{c.unit}]" if c.unit else c.title for c in columns]
    lines = [
        "| configuration | of | " + " | ".join([*heads, "best in"]) + " |",
        "|---|---|" + "--:|" * (len(heads) + 1),
    ]
    for name, values in summary["configurations"].items():
        for which in ("mean", "median", "worst"):
            cells = [cell(c, values["figures"].get(c.key, {}).get(which)) for c in columns]
            count = f"{values['best_in']} of {summary['judged']}" if which == "mean" else ""
            lines.append(f"| {name if which == 'mean' else ''} | {which} | " + " | ".join([*cells, count]) + " |")
    return "\n".join(lines)


def csv(reports: Reports) -> str:
    """Return one row per log and configuration with every error figure in full precision."""
    rows = [(log, name, values) for log, r in reports.items() for name, values in r["configurations"].items()]
    keys = list(dict.fromkeys(k for _, _, values in rows for k, v in values.items() if is_figure(k, v)))
    out = io.StringIO()
    writer = csv_format.writer(out, lineterminator="\n")
    writer.writerow(["log", "configuration", *keys])
    for log, name, values in rows:
        writer.writerow([log, name, *("" if values.get(k) is None else repr(values[k]) for k in keys)])
    return out.getvalue()
