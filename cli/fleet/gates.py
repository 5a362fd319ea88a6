"""Gates over a fleet: limits on figures over all logs, and a summary.json that must not get worse.

`fleet.<configuration>.<key>.<statistic> > 0.05`, with mean, median, p90 or worst; `fleet.failed` counts logs
without a result. Gates without `fleet.` are held against every single log.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
from msgspec.structs import replace

from locfuse.cli.analysis.ci_gates import OPERATORS, Gate, Tolerance, figure, parse_gate, parse_tolerance
from locfuse.cli.analysis.ci_gates import failures as failures_of_log
from locfuse.formats.caps import MAX_REPORT
from locfuse.formats.inputs import read_small
from locfuse.formats.report.summary import OVER_LOGS
from locfuse.fusion.data import LocfuseError
from locfuse.fusion.judge.evaluate import ERROR_KEYS

PREFIX = "fleet."
FAILED = "failed"  # fleet.failed


class Baseline(msgspec.Struct, frozen=True):
    """The summary of an earlier run over the same logs."""

    path: Path
    summary: Mapping[str, Any]
    tolerance: Tolerance


class FleetGates(msgspec.Struct, frozen=True):
    """Everything that a fleet must hold."""

    each: Sequence[Gate]  # for every log
    together: Sequence[Gate]  # for all logs; the figure without "fleet."
    baseline: Baseline | None

    @classmethod
    def read(cls, fail_if: Sequence[str], baseline: Path | None, tolerance: str) -> FleetGates:
        """Return the gates of --fail-if, --baseline, --tolerance. Raises LocfuseError for what cannot be one."""
        gates = [parse_gate(text) for text in fail_if]
        together = [replace(g, figure=g.figure.removeprefix(PREFIX)) for g in gates if g.figure.startswith(PREFIX)]
        each = [g for g in gates if not g.figure.startswith(PREFIX)]
        return cls(each, together, read_baseline(baseline, tolerance) if baseline else None)

    def of_log(self, name: str, report: Mapping[str, Any]) -> list[str]:
        """Return a line per gate that one log fails."""
        return [f"{name}: {line}" for line in failures_of_log(report, self.each, None)]

    def of_fleet(self, summary: Mapping[str, Any]) -> list[str]:
        """Return a line per gate that all logs together fail."""
        lines = [line for gate in self.together if (line := _violated(summary, gate))]
        return lines + (_worse(summary, self.baseline) if self.baseline else [])


def read_baseline(path: Path, tolerance: str) -> Baseline:
    """Return an earlier summary.json. Raises LocfuseError where the file is none."""
    try:
        summary = json.loads(read_small(path, MAX_REPORT))
        rows = [c["figures"] for c in summary["configurations"].values()]
        if not all(isinstance(v, dict) for v in (summary["logs"], *summary["logs"].values(), *rows)):
            raise TypeError
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        raise LocfuseError(
            f"--baseline {path}: not a summary.json of locfuse; make one with: locfuse compare LOGS... -o DIR"
        ) from None
    return Baseline(path, summary, parse_tolerance(tolerance))


def _violated(summary: Mapping[str, Any], gate: Gate) -> str | None:
    if gate.figure == FAILED:
        value: float | None = float(sum(log["state"] != "done" for log in summary["logs"].values()))
        name: str | None = FAILED
    else:
        name, value = figure({n: c["figures"] for n, c in summary["configurations"].items()}, gate.figure)
    if value is None:
        return f"{gate.text}: {_missing(summary, gate, name)}"
    return f"{gate.text}: it is {value:.6g}" if OPERATORS[gate.op](value, gate.limit) else None


def _missing(summary: Mapping[str, Any], gate: Gate, name: str | None) -> str:
    if name is None:
        return f"no such configuration in these logs ({', '.join(summary['configurations'])})"
    figures = summary["configurations"][name]["figures"]
    key = gate.figure[len(name) + 1 :].partition(".")[0]
    if key in figures:
        return f"name a statistic: {PREFIX}{name}.{key}.{'|'.join(OVER_LOGS)}"
    return f"no such figure; there are {', '.join(figures) or 'none: no log has a truth'}"


def _worse(summary: Mapping[str, Any], baseline: Baseline) -> list[str]:
    """Return statistics that both summaries have and that grew by more than the tolerance."""
    if other := _other_logs(summary, baseline):
        return [other]
    lines, compared = [], 0
    for name, old in baseline.summary["configurations"].items():
        new = summary["configurations"].get(name, {}).get("figures", {})
        for key in (k for k in ERROR_KEYS if k in old["figures"] and k in new):
            for which in (w for w in OVER_LOGS if w in old["figures"][key]):
                before, now = old["figures"][key][which], new[key][which]
                compared += 1
                if now > baseline.tolerance.limit(key, before):
                    lines.append(
                        f"{PREFIX}{name}.{key}.{which}: {now:.6g} is more than the baseline's {before:.6g} "
                        f"(tolerance {baseline.tolerance.text})"
                    )
    return lines if compared else [f"--baseline {baseline.path}: it has no figure in common with these logs"]


def _other_logs(summary: Mapping[str, Any], baseline: Baseline) -> str | None:
    """Say where the two summaries are not over the same logs: what got worse may then be the drives."""
    before, now = _contents(baseline.summary), _contents(summary)
    missing = [name for content, name in before.items() if content not in now]
    new = [name for content, name in now.items() if content not in before]
    if not missing and not new:
        return None
    parts = [f"{len(missing)} of its logs have no result now ({missing[0]})"] if missing else []
    parts += [f"{len(new)} logs are not in it ({new[0]})"] if new else []
    return f"--baseline {baseline.path}: it is over other logs: {'; '.join(parts)}"


def _contents(summary: Mapping[str, Any]) -> dict[str, str]:
    """Return what each log with a result is known by, and its name."""
    logs = summary["logs"].items()
    return {str(v.get("identity") or v.get("sha256")): n for n, v in logs if v.get("state", "done") == "done"}
