"""summary.json and summary.md: error figures of each configuration over several logs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from statistics import fmean, median
from typing import Any

import numpy as np
from msgspec.structs import replace

from .findings import counts, effect_of, options
from .table import Column, Table, escape, markdown, of_rows
from .tables import CONFIGURATION, DURATION, MAIN, RMSE

OVER_LOGS = ("mean", "median", "p90", "worst")  # statistics of a figure over the logs
BRIEF = (RMSE.key, "heading_rmse_deg", "anees")  # on a terminal: all OVER_LOGS of rmse, means of the others
OF = Column("of", "of", kind="text")
BEST_IN = Column("best_in", "best in")
MAX_NAMED_TIES = 3  # configurations named in one sentence
MAX_LISTED = 6  # logs whose figures fit into one sentence
NOT_ERRORS = ("duration_s", "distance_m", "truth_coverage")
Reports = Mapping[str, Mapping[str, Any]]  # name of the log -> its report.json


def summarise(reports: Reports) -> dict[str, Any]:
    """Return mean, median, p90 and worst of every error figure per configuration, and the best configuration."""
    names = list(dict.fromkeys(name for r in reports.values() for name in r["configurations"]))
    best = {log: best_of(report) for log, report in reports.items()}
    judged = [b for b in best.values() if b is not None]
    configurations: dict[str, Any] = {
        name: {
            "logs": sum(name in r["configurations"] for r in reports.values()),
            "best_in": judged.count(name),
            "figures": _figures(name, reports),
        }
        for name in names
    }
    logs = {}
    for log, report in reports.items():
        first = next(iter(report["configurations"].values()))
        known = {key: report["input"].get(key) for key in ("name", "sha256", "identity", "start")}
        figures = {"duration_s": first["duration_s"], "figures": errors_of(report)}
        logs[log] = {**known, **figures, "best": best[log]}
    errors = {n: e for n, c in configurations.items() if (e := c["figures"].get(RMSE.key))}
    everywhere = {n: e["mean"] for n, e in errors.items() if e["logs"] == len(judged)}  # an error in every log
    return {
        "logs": logs,
        "judged": len(judged),
        "best": min(everywhere, key=lambda name: everywhere[name]) if everywhere else None,
        "configurations": configurations,
    }


def best_of(report: Mapping[str, Any]) -> str | None:
    """Return the configuration with the smallest position error of one report; None without truth."""
    known = errors_of(report)
    return min(known, key=lambda name: known[name]) if known else None


def errors_of(report: Mapping[str, Any]) -> dict[str, float]:
    """Return configuration -> its position error [m], if it has one."""
    return {n: v[RMSE.key] for n, v in report["configurations"].items() if v.get(RMSE.key) is not None}


def _figures(name: str, reports: Reports) -> dict[str, dict[str, Any]]:
    rows = {log: r["configurations"][name] for log, r in reports.items() if name in r["configurations"]}
    keys = dict.fromkeys(k for row in rows.values() for k, v in row.items() if is_figure(k, v))
    found = {}
    for key in keys:
        values = {log: float(row[key]) for log, row in rows.items() if row.get(key) is not None}
        # a consistent filter has ANEES 1, so the worst ANEES is the one furthest from 1
        far = {log: max(v, 1.0 / v if v > 0 else v) if key == "anees" else v for log, v in values.items()}
        order = sorted(values, key=lambda log: far[log])
        nine_of_ten = values[order[round(0.9 * (len(order) - 1))]]
        worst = max(far, key=lambda log: far[log])
        found[key] = {
            "mean": fmean(values.values()),
            "median": median(values.values()),
            "p90": nine_of_ten if key == "anees" else float(np.quantile([*values.values()], 0.9)),
            "worst": values[worst],
            "worst_log": worst,
            "logs": len(values),
        }
    return found


def is_figure(key: str, value: Any) -> bool:
    """Return whether an entry (key, value) of a configuration is an error figure that has a value."""
    return isinstance(value, float | int) and not isinstance(value, bool) and key not in NOT_ERRORS


def columns_of(summary: Mapping[str, Any]) -> list[Column]:
    """Return the columns of the main figures that at least one configuration has."""
    rows = [c["figures"] for c in summary["configurations"].values()]
    return [c for c in MAIN if any(c.key in row for row in rows)]


def table(summary: Mapping[str, Any]) -> Table:
    """Return the main figures over logs: four rows (mean, median, p90, worst) per configuration."""
    rows = []
    for name, values in summary["configurations"].items():
        for which in OVER_LOGS:
            own = {key: figure[which] for key, figure in values["figures"].items()}
            best_in = _best_in(values, summary) if which == "mean" else ""
            rows.append({**own, "configuration": name, "of": which, "best_in": best_in})
    return of_rows((CONFIGURATION, OF, *columns_of(summary), BEST_IN), rows).once()


def brief(summary: Mapping[str, Any]) -> Table:
    """Return the table for a terminal: rmse, heading and ANEES over logs, one row per configuration."""
    columns, rows = [], []
    for c in (c for c in columns_of(summary) if c.key in BRIEF):
        for which in OVER_LOGS if c is RMSE else OVER_LOGS[:1]:
            heading = f"{c.brief or c.heading} {which}"
            columns.append(replace(c, key=f"{c.key} {which}", brief=heading, brief_form=c.form))
    for name, values in summary["configurations"].items():
        own = {f"{key} {w}": figure[w] for key, figure in values["figures"].items() for w in OVER_LOGS}
        rows.append({**own, "configuration": name, "best_in": _best_in(values, summary)})
    return of_rows((CONFIGURATION, *columns, BEST_IN), rows)


def _best_in(values: Mapping[str, Any], summary: Mapping[str, Any]) -> str:
    return f"{values['best_in']} of {summary['judged']}"


def _logs(summary: Mapping[str, Any]) -> Table:
    columns = [Column("log", "log", kind="text"), DURATION, Column("best", "best", kind="text")]
    if any(v.get("robot") for v in summary["logs"].values()):
        columns.insert(1, Column("robot", "robot", kind="text"))
    rows = []
    for name, log in summary["logs"].items():
        reason = log.get("reason") or "; ".join(f"void: {line}" for line in log.get("void") or ()) or None
        rows.append({**log, "log": name, "reason": reason})
    if any(row["reason"] for row in rows):
        columns.append(Column("reason", "not judged", kind="text", missing=""))
    return of_rows(columns, rows)


def render(summary: Mapping[str, Any]) -> str:
    """Return summary.md; names from logs are escaped."""
    parts = [
        f"# locfuse: {len(summary['logs'])} logs",
        headline(summary),
        markdown(table(summary)) if columns_of(summary) else "",
        markdown(_logs(summary)),
        "\n\n".join(
            f"**{escape(s)} {v['verdict']}.** {v['words']}" for s, v in summary.get("verdicts", {}).items()
        ),
        "\n".join(f"- {escape(words)}{f' `{typed}`' if typed else ''}" for words, typed in robots(summary)),
        f"locfuse {summary['locfuse']}. Deviation = estimate - truth.",
    ]
    return "\n\n".join(p for p in parts if p) + "\n"


def headline(summary: Mapping[str, Any]) -> str:
    """Return a sentence with the best configuration and its mean position rmse."""
    best, judged = summary["best"], summary["judged"]
    done = [log for log in summary["logs"].values() if log.get("state", "done") == "done"]
    if not done:
        return "No log could be compared."
    unjudged = ["void" if log.get("void") else "without truth" for log in done if log.get("best") is None]
    left_out = counts(Counter(sorted(unjudged)))  # "2 void, 1 without truth"
    if best is None:
        without_truth = "None of these logs has a truth: error figures do not exist."
        reason = f"No log has an error figure: {left_out}." if "void" in unjudged else without_truth
        return f"{reason}{not_done(summary)}"
    found = summary["configurations"][best]
    mean = found["figures"][RMSE.key]["mean"]
    rivals = {n: c["best_in"] for n, c in summary["configurations"].items() if n != best and c["best_in"]}
    others = "".join(f", {n} in {k}" for n, k in rivals.items())
    left = f" {left_out}." if unjudged else ""
    rest = f"{left}{_ties(summary)}{not_done(summary)}"
    partly = any(summary["configurations"][n]["figures"][RMSE.key]["logs"] < judged for n in rivals)
    if partly and not found["best_in"]:
        first, *more = sorted(rivals, key=lambda n: -rivals[n])
        wins = "".join(f", {n} in {rivals[n]}" for n in more)
        return (
            f"The logs differ in their sensors: {first} is the best in {rivals[first]} of {judged} logs{wins}. "
            f"In all of them, {best}: mean position rmse {mean:.4f} m.{rest}"
        )
    wins = f"the best in {found['best_in']} of {judged} logs{others}."
    return f"Best is {best}: mean position rmse {mean:.4f} m; {wins}{rest}"


def _ties(summary: Mapping[str, Any]) -> str:
    """Return a sentence with the configurations that are not significantly worse than the best; "" if none."""
    ties, of = summary.get("ties") or {}, summary.get("replicates") or {}
    if not ties:
        return ""
    one = next(iter(ties.values()))["replicates"]
    what = of.get("of", "logs") if one != 1 else of.get("of", "logs").removesuffix("s")
    names = list(ties)[:MAX_NAMED_TIES]
    more = [f"{len(ties) - len(names)} more"] if len(ties) > len(names) else []
    return f" A tie with {' and '.join([*names, *more])}: {one} {what} cannot tell them apart."


Line = tuple[str, str]  # text, and command-line options ("": none)


def robots(summary: Mapping[str, Any]) -> list[Line]:
    """Return lines on each robot: values that differ from its settings in all of its logs, and the fix."""
    lines: list[Line] = []
    for robot in summary.get("robots") or ():
        name = f"{robot['robot']}: " if robot["robot"] else ""
        values = [(f"{v['words']}.", "") for v in robot["values"] if v["off"] or v["value"] is None]
        lines += [(f"{name}{words}", typed) for words, typed in (*values, *fix_of(robot))]
    return lines


def fix_of(robot: Mapping[str, Any]) -> list[Line]:
    """Return the fix that helps in all logs of a robot, with its effects.

    If no fix helps in all logs, return the settings that were tried.
    """
    helped = [tried for tried in robot["tried"] if tried["helps"]]
    for tried in helped[:1]:
        each = [f"{log} {effect_of(pair, True)}" for log, pair in tried["logs"].items()]
        more = f"; and {len(each) - MAX_LISTED} more" if len(each) > MAX_LISTED else ""
        what = f"Fix for all of them (tried on {len(each)} logs with {tried['configuration']}"
        return [(f"{what}: {'; '.join(each[:MAX_LISTED])}{more}):", options(robot["fixes"]))]
    does = [f"worse in {' and '.join(t['worse'])}" if t["worse"] else "changes little" for t in robot["tried"]]
    tries = "; ".join(f"{' '.join(t['fixes'])}, {what}" for t, what in zip(robot["tried"], does, strict=True))
    return [(f"No common setting helps in all of them (tried {tries}).", "")] if tries else []


def not_done(summary: Mapping[str, Any]) -> str:
    """Return a text on the logs that failed or were not run: " 2 failed. 1 were not run."."""
    states = [log.get("state", "done") for log in summary["logs"].values()]
    counts = ((states.count("failed"), "failed"), (states.count("not run"), "were not run"))
    return "".join(f" {n} {words}." for n, words in counts if n)
