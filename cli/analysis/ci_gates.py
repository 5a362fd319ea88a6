"""Gates for CI: `--fail-if` and `--baseline`. A gate that fails, or whose figure does not exist, is exit code 4.

A gate is `<configuration>.<key> <op> number`, keys as in report.json, deeper ones with dots: all.sensors.lrf.nis.
"""

from __future__ import annotations

import json
import math
import operator
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import msgspec

from locfuse.formats.caps import MAX_REPORT
from locfuse.formats.inputs import read_small
from locfuse.formats.logs.files import Identity
from locfuse.formats.report import json_report
from locfuse.fusion.data import LocfuseError, UsageError

FAILED = 4
OF_REFERENCE = "reference."  # before a figure: that of a log without truth, against its reference
OPERATORS: dict[str, Callable[[float, float], bool]] = {
    ">=": operator.ge,
    "<=": operator.le,
    ">": operator.gt,
    "<": operator.lt,
}
UNITS = {
    "": ("share", 1.0),
    "%": ("share", 0.01),
    "mm": ("metres", 1e-3),
    "cm": ("metres", 1e-2),
    "m": ("metres", 1.0),
    "deg": ("degrees", 1.0),
    "°": ("degrees", 1.0),
}
PART = re.compile(r"(\S*?)\s*(%|mm|cm|m|deg|°|)")  # of a tolerance: a number and its unit
GATE = re.compile(r"\s*(?P<figure>[^\s<>=]+)\s*(?P<op>>=|<=|>|<)\s*(?P<limit>\S+)\s*")


class Gate(msgspec.Struct, frozen=True):
    """Fail if `figure op limit`."""

    text: str
    figure: str  # "<configuration>.<key>"
    op: str
    limit: float


class Tolerance(msgspec.Struct, frozen=True):
    """How much worse a figure may be: a share of the baseline's, or a length or an angle where that is more."""

    text: str
    share: float = 0.0
    metres: float = 0.0
    degrees: float = 0.0

    def limit(self, key: str, old: float) -> float:
        """Return the largest value that passes; the unit stands at the end of the key."""
        floor = self.metres if key.endswith("_m") else self.degrees if key.endswith("_deg") else 0.0
        return old + max(self.share * old, floor)


class Baseline(msgspec.Struct, frozen=True):
    """An earlier report of the same log that this one must not be worse than."""

    path: Path
    report: Mapping[str, Any]
    tolerance: Tolerance


class Content(Protocol):
    """What a log is known by."""

    @property
    def name(self) -> str:
        """What to call it."""

    @property
    def identity(self) -> Identity:
        """What its content is known by without reading all of it."""

    @property
    def sha256(self) -> str:
        """Hash of all its bytes."""


class Gates(msgspec.Struct, frozen=True):
    """Everything that a report must hold."""

    limits: Sequence[Gate]
    baseline: Baseline | None

    def failures(self, report: Mapping[str, Any]) -> list[str]:
        """Return one line per gate that failed or whose figure does not exist."""
        return failures(report, self.limits, self.baseline)

    def refuse_another_log(self, log: Content) -> None:
        """Raise LocfuseError where the baseline was made of another log."""
        if self.baseline is not None:
            refuse_another_log(self.baseline, log)


def read(fail_if: Sequence[str], baseline: Path | None, tolerance: str) -> Gates:
    """Return the gates of --fail-if, --baseline and --tolerance. Raises LocfuseError for what cannot be one."""
    limits = [parse_gate(text) for text in fail_if]
    return Gates(limits, read_baseline(baseline, tolerance) if baseline else None)


def parse_gate(text: str) -> Gate:
    """Return the gate that `--fail-if` names. Raises UsageError with an example."""
    found = GATE.fullmatch(text)
    limit = _number(found["limit"]) if found else None
    if found is None or limit is None or "." not in found["figure"]:
        raise UsageError(f'--fail-if {text!r}: write it like "all.position_rmse_m > 0.02" (one of > >= < <=)')
    return Gate(text.strip(), found["figure"], found["op"], limit)


def parse_tolerance(text: str) -> Tolerance:
    """Return "5%", "0.05", "1mm" or "5%,1mm,0.1deg". Raises UsageError, also for 5, which would be 500 %."""
    found: dict[str, float] = {}
    for part in text.split(","):
        read = PART.fullmatch(part.strip())
        number, unit = read.groups() if read else ("", "")
        kind, scale = UNITS[unit]
        value = _number(number)
        if value is None or value < 0.0 or kind in found or (not unit and value >= 1.0):
            meant = f"{part.strip()}%, or " if value is not None and value >= 1.0 and not unit else ""
            raise UsageError(f"--tolerance {text!r}: write it like {meant}5%, 0.05 or 5%,1mm,0.1deg")
        found[kind] = value * scale
    return Tolerance(text.strip(), **found)


def read_baseline(path: Path, tolerance: str) -> Baseline:
    """Return an earlier report.json. Raises LocfuseError where the file is none."""
    try:
        report = json_report.current(json.loads(read_small(path, MAX_REPORT)), f"--baseline {path}")
        configurations = report["configurations"]
        if not all(isinstance(values, dict) for values in (report.get("input", {}), *configurations.values())):
            raise TypeError
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        raise LocfuseError(
            f"--baseline {path}: not a report.json of locfuse; make one with: locfuse compare LOG -o DIR"
        ) from None
    return Baseline(path, report, parse_tolerance(tolerance))


def refuse_another_log(baseline: Baseline, log: Content) -> None:
    """Raise LocfuseError where the baseline is of another content: what got worse may be the drive."""
    then = baseline.report.get("input", {})
    if _is_of(then, log):
        return
    name, other = log.name, then.get("name")
    which = f"{other}, and this is {name}" if other != name else f"another log that is also called {name}"
    raise LocfuseError(
        f"--baseline {baseline.path} is of {which}: the error figures of two drives cannot be compared. Make a "
        f"baseline of this log: locfuse compare {name} -o DIR"
    )


def _is_of(then: Mapping[str, Any], log: Content) -> bool:
    """Tell whether a report's input is this log: by its identity, in a report of 0.1 by the hash of all bytes."""
    if then.get("identity") is not None:
        return bool(then["identity"] == log.identity.digest)
    return then.get("sha256") is None or then["sha256"] == log.sha256


def failures(report: Mapping[str, Any], gates: Sequence[Gate], baseline: Baseline | None) -> list[str]:
    """Return one line per gate that failed or whose figure does not exist."""
    lines = [line for gate in gates if (line := _violated(report, gate))]
    return lines + (_worse(report, baseline) if baseline else [])


def _violated(report: Mapping[str, Any], gate: Gate) -> str | None:
    if mixed := _mixed(report, gate):
        return f"{gate.text}: {mixed}"
    name, value = figure(report["configurations"], gate.figure.removeprefix(OF_REFERENCE))
    if value is None:
        return f"{gate.text}: {_missing(report, gate, name)}"
    if OPERATORS[gate.op](value, gate.limit):
        return f"{gate.text}: it is {value:.6g}"
    return None


def _mixed(report: Mapping[str, Any], gate: Gate) -> str | None:
    """Say where a gate on truth meets a reference, or the other way round: the two are different figures."""
    from locfuse.fusion.judge.evaluate import ERROR_KEYS

    asked = gate.figure.startswith(OF_REFERENCE) and gate.figure not in report["configurations"]
    if asked:
        return None if report.get("reference") else "no reference judged this log; it needs a log without truth"
    if report.get("reference") and gate.figure.rpartition(".")[2] in ERROR_KEYS:
        return f"errors are against a reference, not truth; if that is meant: {OF_REFERENCE}{gate.text}"
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
    key = gate.figure.removeprefix(OF_REFERENCE)[len(name) + 1 :]
    if key in configurations[name]:
        why = "without truth" if report.get("truth") is None else "here"
        return f"the figure does not exist {why}"
    return f"no such figure; there are {', '.join(k for k, v in configurations[name].items() if _is_figure(v))}"


def _is_figure(value: Any) -> bool:
    return value is None or (isinstance(value, int | float) and not isinstance(value, bool))


def _worse(report: Mapping[str, Any], baseline: Baseline) -> list[str]:
    """Return error figures that both reports have and that grew by more than the tolerance."""
    from locfuse.formats.report.changes import judged_by
    from locfuse.fusion.judge.evaluate import ERROR_KEYS

    then, now = judged_by(baseline.report), judged_by(report)
    if then != now and None not in (then, now):
        return [f"--baseline {baseline.path}: its errors are against {then}, these against {now}: no comparison"]
    lines, compared = [], 0
    for name, old_values in baseline.report["configurations"].items():
        if _judge(old_values) != _judge(report["configurations"].get(name, {})):
            continue
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
            if new > baseline.tolerance.limit(key, old):
                more = f"{new / old - 1.0:.1%} more" if old > 0.0 else "more"
                lines.append(
                    f"{name}.{key}: {new:.6g} is {more} than the baseline's {old:.6g} "
                    f"(tolerance {baseline.tolerance.text})"
                )
    if not compared:
        return [f"--baseline {baseline.path}: it has no error figure in common with this report"]
    return lines


def _judge(values: Mapping[str, Any]) -> Any:
    """Return the sensors of the reference that judged a result; None where it was no reference."""
    return (values.get("reference") or {}).get("sensors")


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None
