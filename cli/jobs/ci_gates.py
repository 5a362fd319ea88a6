"""Gates for CI: `--fail-if` and `--baseline`. A gate that fails, or whose figure does not exist, is exit code 4.

A gate is `<configuration>.<key> <op> number`, keys as in report.json, deeper ones with dots: all.sensors.lrf.nis.
"""

from __future__ import annotations

import json
import math
import operator
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from locfuse.formats.caps import MAX_REPORT
from locfuse.formats.inputs import read_small
from locfuse.fusion.data import LocfuseError, UsageError

FAILED = 4
OPERATORS: dict[str, Callable[[float, float], bool]] = {
    ">=": operator.ge,
    "<=": operator.le,
    ">": operator.gt,
    "<": operator.lt,
}
GATE = re.compile(r"\s*(?P<figure>[^\s<>=]+)\s*(?P<op>>=|<=|>|<)\s*(?P<limit>\S+)\s*")


@dataclass(frozen=True)
class Gate:
    """Fail if `figure op limit`."""

    text: str
    figure: str  # "<configuration>.<key>"
    op: str
    limit: float


@dataclass(frozen=True)
class Baseline:
    """An earlier report that this one must not be worse than, by more than a share."""

    path: Path
    report: Mapping[str, Any]
    tolerance: float


def parse_gate(text: str) -> Gate:
    """Return the gate that `--fail-if` names. Raises UsageError with an example."""
    found = GATE.fullmatch(text)
    limit = _number(found["limit"]) if found else None
    if found is None or limit is None or "." not in found["figure"]:
        raise UsageError(f'--fail-if {text!r}: write it like "all.position_rmse_m > 0.02" (one of > >= < <=)')
    return Gate(text.strip(), found["figure"], found["op"], limit)


def parse_tolerance(text: str) -> float:
    """Return "5%" or "0.05" as 0.05. Raises UsageError."""
    value = _number(text.strip().removesuffix("%"))
    if value is None or value < 0.0:
        raise UsageError(f"--tolerance {text!r}: write it like 5% or 0.05")
    return value / 100.0 if text.strip().endswith("%") else value


def read_baseline(path: Path, tolerance: str) -> Baseline:
    """Return an earlier report.json. Raises LocfuseError where the file is none."""
    try:
        report = json.loads(read_small(path, MAX_REPORT))
        configurations = report["configurations"]
        if not all(isinstance(values, dict) for values in (report.get("input", {}), *configurations.values())):
            raise TypeError
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        raise LocfuseError(
            f"--baseline {path}: not a report.json of locfuse; make one with: locfuse compare LOG -o DIR"
        ) from None
    return Baseline(path, report, parse_tolerance(tolerance))


def of_another_log(report: Mapping[str, Any], baseline: Baseline) -> str | None:
    """Say where the baseline was made of other bytes than this report; None where of the same."""
    then, now = baseline.report.get("input", {}), report["input"]
    if then.get("sha256") in (None, now["sha256"]):
        return None
    which = (
        f"of {then.get('name')}, this is {now['name']}" if then.get("name") != now["name"] else "of other bytes"
    )
    return f"the baseline {baseline.path} is {which}: what got worse may be the log"


def failures(report: Mapping[str, Any], gates: Sequence[Gate], baseline: Baseline | None) -> list[str]:
    """Return one line per gate that failed or whose figure does not exist."""
    lines = [line for gate in gates if (line := _violated(report, gate))]
    return lines + (_worse(report, baseline) if baseline else [])


def _violated(report: Mapping[str, Any], gate: Gate) -> str | None:
    name, value = figure(report["configurations"], gate.figure)
    if value is None:
        return f"{gate.text}: {_missing(report, gate, name)}"
    if OPERATORS[gate.op](value, gate.limit):
        return f"{gate.text}: it is {value:.6g}"
    return None


def figure(configurations: Mapping[str, Any], path: str) -> tuple[str | None, float | None]:
    """Return the configuration that a path names (it may hold dots) and its figure; None where there is none."""
    fitting = [name for name in configurations if path.startswith(f"{name}.")]
    if not fitting:
        return None, None
    name = max(fitting, key=len)
    value: Any = configurations[name]
    for key in path[len(name) + 1 :].split("."):
        value = value.get(key) if isinstance(value, Mapping) else None
    number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    return name, float(value) if number else None


def _missing(report: Mapping[str, Any], gate: Gate, name: str | None) -> str:
    configurations = report["configurations"]
    if name is None:
        return f"no such configuration in this report ({', '.join(configurations)})"
    key = gate.figure[len(name) + 1 :]
    if key in configurations[name]:
        why = "without truth" if report.get("truth") is None else "here"
        return f"the figure does not exist {why}"
    return f"no such figure; there are {', '.join(k for k, v in configurations[name].items() if _is_figure(v))}"


def _is_figure(value: Any) -> bool:
    return value is None or (isinstance(value, int | float) and not isinstance(value, bool))


def _worse(report: Mapping[str, Any], baseline: Baseline) -> list[str]:
    """Return error figures that both reports have and that grew by more than the tolerance."""
    from locfuse.fusion.judge.evaluate import ERROR_KEYS

    lines, compared = [], 0
    for name, old_values in baseline.report["configurations"].items():
        for key in ERROR_KEYS:
            _, old = figure({name: old_values}, f"{name}.{key}")
            _, new = (
                figure(report["configurations"], f"{name}.{key}")
                if name in report["configurations"]
                else (None, None)
            )
            if old is None or new is None:
                continue
            compared += 1
            if new > old * (1.0 + baseline.tolerance):
                more = f"{new / old - 1.0:.1%} more" if old > 0.0 else "more"
                lines.append(
                    f"{name}.{key}: {new:.6g} is {more} than the baseline's {old:.6g} "
                    f"(tolerance {baseline.tolerance:.3g} of it)"
                )
    if not compared:
        return [f"--baseline {baseline.path}: it has no error figure in common with this report"]
    return lines


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None
