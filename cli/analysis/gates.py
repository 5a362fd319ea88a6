"""Gates for CI: `--fail-if` and `--baseline`. A gate fails also if its figure is missing. Exit code: 4.

A gate on one log is `<configuration>.<key> <op> <number>` with a key of report.json; a dot leads into a table:
all.sensors.lrf.nis. A gate on many logs is `fleet.<configuration>.<key>.<statistic> > 0.05`, with the statistic
mean, median, p90 or worst; `fleet.failed` counts logs without a result.
"""

from __future__ import annotations

import json
import math
import operator
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from locfuse.formats.inputs import MAX_REPORT, read_small
from locfuse.formats.logs.log import Log
from locfuse.formats.report import json_report
from locfuse.formats.report.changes import judged_by
from locfuse.formats.report.structure import ReportedResult
from locfuse.formats.report.summary import OVER_LOGS
from locfuse.formats.text import did_you_mean
from locfuse.fusion.data import LocfuseError, UsageError
from locfuse.fusion.judge.evaluate import ERROR_KEYS

from .settings import GateOptions

EXIT_GATE_FAILED = 4
OF_REFERENCE = "reference."  # prefix of errors against a reference, in a log without truth
OF_FLEET = "fleet."  # prefix of figures over all logs
OPERATORS: dict[str, Callable[[float, float], bool]]
OPERATORS = {">=": operator.ge, "<=": operator.le, ">": operator.gt, "<": operator.lt}
TOLERANCE_UNITS = {
    "": ("share", 1.0),
    "%": ("share", 0.01),
    "mm": ("metres", 1e-3),
    "cm": ("metres", 1e-2),
    "m": ("metres", 1.0),
    "deg": ("degrees", 1.0),
    "°": ("degrees", 1.0),
}
TOLERANCE_PATTERN = re.compile(r"(\S*?)\s*(%|mm|cm|m|deg|°|)")  # a number and its unit
GATE_PATTERN = re.compile(r"\s*(?P<figure>[^\s<>=](?:[^<>=]*[^\s<>=])?)\s*(?P<op>>=|<=|>|<)\s*(?P<limit>\S+)\s*")


class Gate(msgspec.Struct, frozen=True):
    """A limit on a figure of the report; the gate fails if `figure op limit` is true."""

    text: str
    figure: str  # "<configuration>.<key>"
    op: str
    limit: float

    def line(self, value: float | None, missing: str) -> str | None:
        """Return the line on a failed gate, else None; `missing` is the reason why `value` is None."""
        if value is None:
            return f"{self.text}: {missing}"
        return f"{self.text}: it is {value:.6g}" if OPERATORS[self.op](value, self.limit) else None


class Tolerance(msgspec.Struct, frozen=True):
    """Allowed growth of an error: the larger of a share of the baseline's error and a length or angle."""

    text: str
    share: float = 0.0
    metres: float = 0.0
    degrees: float = 0.0

    def limit(self, key: str, old: float) -> float:
        """Return the largest error that passes; `old`: error of the baseline, `key`: name of both, with unit."""
        floor = self.metres if key.endswith("_m") else self.degrees if key.endswith("_deg") else 0.0
        return old + max(self.share * old, floor)


class Baseline(msgspec.Struct, frozen=True):
    """An earlier report of the same log, or summary of the same logs, whose error figures are limits."""

    path: Path
    values: Mapping[str, Any]
    figures: Mapping[tuple[str, ...], float]  # its error figures (`_error_figures`)
    tolerance: Tolerance
    of_fleet: bool = False

    def grown(self, later: Mapping[str, Any], what: str) -> list[str]:
        """Return a line for each error that grew beyond the tolerance, or one if there is no `what`."""
        old, new = self.figures, _error_figures(later["configurations"], self.of_fleet)
        common = [at for at in old if at in new]
        if not common:
            return [f"--baseline {self.path}: it has no {what}"]
        return [
            f"{at[0]}: {new[at]:.6g} is {f'{new[at] / old[at] - 1.0:.1%} more' if old[at] > 0.0 else 'more'} than "
            f"the baseline's {old[at]:.6g} (tolerance {self.tolerance.text})"
            for at in common
            if new[at] > self.tolerance.limit(at[1], old[at])
        ]


class Gates(msgspec.Struct, frozen=True):
    """Gates on one log, or on each log of a fleet and on the whole fleet."""

    limits: Sequence[Gate]  # on each log
    baseline: Baseline | None = None
    together: Sequence[Gate] = ()  # on the whole fleet

    @classmethod
    def read(cls, typed: GateOptions, of_fleet: bool = False) -> Gates:
        """Return the gates of --fail-if, --baseline and --tolerance. Raises LocfuseError for an invalid gate."""
        limits = [parse_gate(text) for text in typed.fail_if]
        together = [gate for gate in limits if of_fleet and gate.figure.startswith(OF_FLEET)]
        each, known = [gate for gate in limits if gate not in together], ReportedResult.__struct_fields__
        for gate in each:
            configuration, *keys = gate.figure.removeprefix(OF_REFERENCE).split(".")
            if not set(keys) & set(known):
                near = did_you_mean(keys[-1], known) or "see: locfuse schema report"
                raise UsageError(f"--fail-if {gate.text!r}: no report has {keys[-1]} of {configuration}; {near}")
        earlier = read_baseline(typed.baseline, typed.tolerance, of_fleet) if typed.baseline else None
        return cls(each, earlier, together)

    def failures(self, report: Mapping[str, Any]) -> list[str]:
        """Return one line per gate on one log that fails or whose figure is missing."""
        lines, where = [], "without truth" if report.get("truth") is None else "here"
        absent = f"the figure does not exist {where}"
        for gate in self.limits:
            path, mixed = gate.figure.removeprefix(OF_REFERENCE), _mixed(report, gate)
            value, missing = (None, mixed) if mixed else _reported(report["configurations"], path, absent)
            lines.append(gate.line(value, missing))
        worse = _worse(report, self.baseline) if self.baseline and not self.baseline.of_fleet else []
        return [line for line in lines if line] + worse

    def failures_together(self, summary: Mapping[str, Any]) -> list[str]:
        """Return one line per gate on the whole fleet that fails or whose figure is missing."""
        figures = {name: c["figures"] for name, c in summary["configurations"].items()}
        failed = float(sum(log["state"] != "done" for log in summary["logs"].values()))
        lines, absent = [], f"name a statistic: {', '.join(OVER_LOGS)}"
        for gate in self.together:
            path = gate.figure.removeprefix(OF_FLEET)
            value, missing = (failed, "") if path == "failed" else _reported(figures, path, absent)
            lines.append(gate.line(value, missing))
        found = [line for line in lines if line]
        if self.baseline is None:
            return found
        other = _other_logs(summary, self.baseline)
        return [*found, *([other] if other else self.baseline.grown(summary, "figure in common with these logs"))]


def parse_gate(text: str) -> Gate:
    """Return the gate of one `--fail-if`. Raises UsageError, with an example, for another form."""
    found = GATE_PATTERN.fullmatch(text)
    limit = _number(found["limit"]) if found else None
    if found is None or limit is None or "." not in found["figure"]:
        raise UsageError(f'--fail-if {text!r}: write it like "all.position_rmse_m > 0.02" (one of > >= < <=)')
    return Gate(text.strip(), found["figure"], found["op"], limit)


def parse_tolerance(text: str) -> Tolerance:
    """Return the tolerance of "5%", "0.05", "1mm" or "5%,1mm,0.1deg". Raises UsageError, as for 5 (500 %)."""
    found: dict[str, float] = {}
    for part in text.split(","):
        read = TOLERANCE_PATTERN.fullmatch(part.strip())
        number, unit = read.groups() if read else ("", "")
        kind, scale = TOLERANCE_UNITS[unit]
        value = _number(number)
        if value is None or value < 0.0 or kind in found or (not unit and value >= 1.0):
            meant = f"{part.strip()}%, or " if value is not None and value >= 1.0 and not unit else ""
            raise UsageError(f"--tolerance {text!r}: write it like {meant}5%, 0.05 or 5%,1mm,0.1deg")
        found[kind] = value * scale
    return Tolerance(text.strip(), **found)


def read_baseline(path: Path, tolerance: str, of_fleet: bool = False) -> Baseline:
    """Return an earlier report.json, or a fleet's summary.json. Raises LocfuseError for any other file."""
    try:
        values = json.loads(read_small(path, MAX_REPORT))
        if of_fleet:
            figures = (c["figures"] for c in values["configurations"].values())
            tables = [values["logs"], *values["logs"].values(), *figures]
        else:
            values = json_report.readable(values, f"--baseline {path}")
            tables = [values.get("input", {}), *values["configurations"].values()]
        if not all(isinstance(table, dict) for table in tables):
            raise TypeError
        errors = _error_figures(values["configurations"], of_fleet)
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
        wanted = ("summary.json", "fleet LOGS...") if of_fleet else ("report.json", "compare LOG")
        words = f"not a {wanted[0]} of locfuse; make one with: locfuse {wanted[1]} -o DIR"
        raise LocfuseError(f"--baseline {path}: {words}") from None
    return Baseline(path, values, errors, parse_tolerance(tolerance), of_fleet)


def refuse_another_log(baseline: Baseline | None, log: Log) -> None:
    """Raise LocfuseError if the baseline is of another log, where errors may differ for other reasons."""
    then = {} if baseline is None else baseline.values.get("input", {})
    if baseline is None or then.get("identity") in {None, log.identity.digest}:
        return
    name, other = log.name, then.get("name")
    which = f"{other}, and this is {name}" if other != name else f"another log that is also called {name}"
    words = f"--baseline {baseline.path} is of {which}: the error figures of two drives cannot be compared"
    raise LocfuseError(f"{words}. Make a baseline of this log: locfuse compare {name} -o DIR")


def _mixed(report: Mapping[str, Any], gate: Gate) -> str | None:
    """Return why gate and report do not fit: one means errors to truth, the other to a reference; else None."""
    asked = gate.figure.startswith(OF_REFERENCE) and gate.figure not in report["configurations"]
    if asked:
        return None if report.get("reference") else "no reference judged this log; it needs a log without truth"
    if report.get("reference") and gate.figure.rpartition(".")[2] in ERROR_KEYS:
        return f"errors are against a reference, not truth; if that is meant: {OF_REFERENCE}{gate.text}"
    return None


def figure(configurations: Mapping[str, Any], path: str) -> tuple[str | None, float | None]:
    """Return (configuration, value) of a path such as "all.position_rmse_m"; each is None if it is missing."""
    fitting = [name for name in configurations if path.startswith(f"{name}.")]
    if not fitting:
        return None, None
    name = max(fitting, key=len)
    value: Any = configurations[name]
    for key in path[len(name) + 1 :].split("."):
        value = value.get(key) if isinstance(value, Mapping) else None
    return name, float(value) if _is_number(value) and math.isfinite(value) else None


def _reported(configurations: Mapping[str, Any], path: str, absent: str) -> tuple[float | None, str]:
    """Return a number of the report, such as "all.position_rmse_m", and the reason if there is none.

    The reason is `absent` if the report has this name, but no number.
    """
    name, value = figure(configurations, path)
    if name is None:
        return None, f"no such configuration; there are {', '.join(configurations)}"
    of, rest = configurations[name], path[len(name) + 1 :]
    if rest in of or rest.rpartition(".")[0] in of:
        return value, absent
    numbers = [key for key, value in of.items() if value is None or _is_number(value)]
    return value, f"no such figure; there are {', '.join(numbers or of) or 'none: no log has a truth'}"


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _worse(report: Mapping[str, Any], baseline: Baseline) -> list[str]:
    """Return a line for each error that grew beyond the tolerance, or one line why errors cannot be compared."""
    then, now = judged_by(baseline.values), judged_by(report)
    if then != now and None not in (then, now):
        return [f"--baseline {baseline.path}: its errors are against {then}, these against {now}: no comparison"]
    return baseline.grown(report, "error figure in common with this report")


def _error_figures(configurations: Mapping[str, Any], of_fleet: bool) -> dict[tuple[str, ...], float]:
    """Return a report's errors, or with `of_fleet` a summary's. Keys: (path, error name, *reference sensors)."""
    found: dict[tuple[str, ...], float] = {}
    for name, values in configurations.items():
        reference = (values.get("reference") or {}).get("sensors") or ()
        for key in ERROR_KEYS:
            figures: dict[str, Any] = {f"{name}.{key}": values.get(key)}
            if of_fleet:
                of_logs = values["figures"].get(key) or {}
                figures = {f"{OF_FLEET}{name}.{key}.{which}": of_logs.get(which) for which in OVER_LOGS}
            for path, value in figures.items():
                if _is_number(value) and math.isfinite(value):
                    found[path, key, *reference] = float(value)
    return found


def _other_logs(summary: Mapping[str, Any], baseline: Baseline) -> str | None:
    """Return a line if the summary and the baseline are of different logs, else None."""
    before, now = (  # names of the logs with a result, by the hash of the log's content
        {str(v.get("identity")): n for n, v in of["logs"].items() if v.get("state", "done") == "done"}
        for of in (baseline.values, summary)
    )
    missing = [name for content, name in before.items() if content not in now]
    new = [name for content, name in now.items() if content not in before]
    parts = [f"{len(missing)} of its logs have no result now ({missing[0]})"] if missing else []
    parts += [f"{len(new)} logs are not in it ({new[0]})"] if new else []
    return f"--baseline {baseline.path}: it is over other logs: {'; '.join(parts)}" if parts else None


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None
