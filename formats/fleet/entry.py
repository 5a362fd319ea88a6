"""One log of many: the short form of its report, or the reason why there is no report.

Ten thousand short forms fit into memory.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import msgspec

from locfuse.formats.report.findings import void_reasons

State = Literal["done", "failed", "not run"]
COUNTS = ("accepted", "rejected", "absent", "nis")  # of a sensor in a configuration
EFFECTS = ("credit", "alone", "leave_one_out")  # of a sensor on the position error


class Entry(msgspec.Struct, frozen=True):
    """One log of many: its state and the short form of its report."""

    name: str
    robot: str | None = None
    state: State = "done"
    reason: str = ""  # why it failed or was not run, in one line
    report: Mapping[str, Any] = {}  # short form by `slim`; empty unless done
    cells: tuple[str, ...] = ()  # names of the cells of a sweep; a cell is one combination of settings

    @property
    def losses(self) -> dict[str, int]:
        """Unreadable bytes and messages of the log."""
        places = (self.report.get("input", {}).get("losses") or {}).values()
        return {unit: sum(p[unit] for p in places) for unit in ("bytes", "messages")}

    @property
    def void(self) -> list[str]:
        """Reasons why error figures of this log are void (not valid)."""
        return list(self.report.get("void") or ())

    @property
    def doubtful(self) -> list[str]:
        """Reasons why error figures of this log are doubtful; its verdicts are then withdrawn."""
        return list(self.report.get("doubtful") or ())


def label(configuration: str, cell: str) -> str:
    """Return the name of a configuration in a cell of a sweep: "lrf [lrf.noise=0.1]"."""
    return f"{configuration} [{cell}]" if cell else configuration


def slim(reports: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Return the short form of the reports of one log.

    `reports` maps a cell of a sweep (a combination of settings; "" without a sweep) to its report. Verdicts and
    effects are taken from the first cell.
    """
    first = next(iter(reports.values()))
    source = first["input"]
    return {
        "input": {key: source.get(key) for key in ("name", "size", "identity", "sha256", "start", "losses")},
        "configurations": {
            label(name, cell): {
                **{key: value for key, value in values.items() if not isinstance(value, Mapping | list)},
                "configuration": name,
                "cell": cell,
                "slowed": bool(values.get("rates_hz")),
                "key": report.get("key"),
            }
            for cell, report in reports.items()
            for name, values in report["configurations"].items()
        },
        "sensors": {
            label(name, cell): {s: [found[c] for c in COUNTS] for s, found in values["sensors"].items()}
            for cell, report in reports.items()
            for name, values in report["configurations"].items()
        },
        "void": list(dict.fromkeys(line for report in reports.values() for line in void_reasons(report))),
        "doubtful": [v["message"] for v in first.get("validity") or () if not v["void"]],
        "findings": [(f["role"], f["code"], f["message"], bool(f["fixes"])) for f in first.get("findings") or ()],
        "verdicts": {sensor: v["verdict"] for sensor, v in (first.get("verdicts") or {}).items()},
        "credit": _effects(first.get("credit")),
        "measured": first.get("measured"),
    }


def _effects(credit: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """Return each sensor's effects without confidence intervals, which are computed over all logs later."""
    if not credit:
        return None
    sensors = {
        sensor: {
            "verdict": "",
            **{key: found[key] for key in ("share", "anees_without", "anees_with", "beside")},
            **{name: (e := found[name]) and {"ln": e["ln"], "expected": e["expected"]} for name in EFFECTS},
        }
        for sensor, found in credit["sensors"].items()
    }
    return {"complete": credit["complete"], "total_factor": credit["total_factor"], "sensors": sensors}
