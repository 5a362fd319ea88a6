"""Validity: figures that are void or doubtful, and why.

A robot that was lost for a notable share of the drive has no accuracy; a truth that starts somewhere else judges
the start and nothing more; one that jumps again and again judges nothing. Such a figure is null in report.json,
"-" in tables, fails a gate, and is named.
While a clock, a scale or a direction is surely wrong, or the truth jumps, figures exist and are called doubtful.
"""

from __future__ import annotations

import re
from typing import Any

from locfuse.formats.report.findings import options
from locfuse.fusion.checks.truth import Jumps
from locfuse.fusion.judge.evaluate import ERROR_KEYS

from .advised import Advised

MAX_LOST_SHARE = 0.1  # of the drive for which a filter may be lost before its figures mean nothing
MAX_START_ERROR_M = 0.5  # m between the first pose of the truth and the start, where nobody states a start
EVERY = ("wheels", "truth")  # roles that every configuration depends on
JUMP = "jump"  # code of the finding on a truth that jumps
JUDGED = (*ERROR_KEYS, "anees")


def add_validity(
    report: dict[str, Any], advised: Advised | None, start_error_m: float | None, jumps: Jumps | None = None
) -> None:
    """Add `validity`; move void figures out of their configurations to `void`, where they stay readable."""
    found = []
    for name, values in report["configurations"].items():
        reason = _lost(values) or _jumping(jumps) or _elsewhere(start_error_m, values)
        if reason is None:
            continue
        code, message = reason
        known = {key: values[key] for key in JUDGED if values.get(key) is not None}
        values["void"] = {"reason": message, "figures": known}
        values.update(dict.fromkeys(known))
        found.append({"configuration": name, "code": code, "message": message, "since_s": _since(values, code)})
    void = {entry["code"] for entry in found}  # what is void is not doubtful as well
    doubts = [d for d in _doubts(report, advised) if d["code"] != JUMP or JUMP not in void]
    report["validity"] = [*_once(found), *doubts]
    if found and all("void" in values for values in report["configurations"].values()):
        report["credit"] = None
        _withdraw_verdicts(report, "All errors of this log are void.")
    elif doubts:
        report["credit"] = None  # a factor is a verdict too
        _withdraw_verdicts(report, "Not judged while a warning is open.")


def _withdraw_verdicts(report: dict[str, Any], words: str) -> None:
    """Withdraw verdicts that rest on void or doubtful figures."""
    for verdict in report.get("verdicts", {}).values():
        verdict.update(verdict="no verdict", words=words)


def _doubts(report: dict[str, Any], advised: Advised | None) -> list[dict[str, Any]]:
    """Return certain faults of the settings; the effects of their fixes are in the findings.

    Where the fix was tried and changes little, the figures do not depend on it.
    """
    doubts = []
    for advice in advised.advice if advised is not None else ():
        found = advice.finding
        using = [n for n, v in report["configurations"].items() if found.role in {*EVERY, *v["sensors"]}]
        if found.severe and using and found.code != "start" and not advice.harmless:
            message = f"{found.role}: {_first_sentence(found.brief)}"
            if advice.fixes:
                message += f". All figures are without this fix: {options(advice.fixes)}"
            entry = {"code": found.code, "message": message, "since_s": 0.0, "configurations": using}
            doubts.append({**entry, "void": False})
    return doubts


def _first_sentence(words: str) -> str:
    """Return the fault without how it was measured, which is in the finding."""
    return re.sub(r" \(correlation [^()]*\)", "", words.partition(". ")[0])


def _lost(values: dict[str, Any]) -> tuple[str, str] | None:
    share = values.get("lost_share") or 0.0
    if share <= MAX_LOST_SHARE:
        return None
    name = values["configuration"]  # of its smoothed result too: that is lost where its filter is
    return "lost", f"{name}: lost for {share:.0%} of the drive, first at {values['lost'][0][0]:.1f} s"


def _jumping(jumps: Jumps | None) -> tuple[str, str] | None:
    if jumps is None or not jumps.spoil:
        return None
    return JUMP, f"truth: {jumps.words}. Set truth.max_speed, or truth.sigma if this is its noise"


def _elsewhere(error_m: float | None, values: dict[str, Any]) -> tuple[str, str] | None:
    if error_m is None or error_m < MAX_START_ERROR_M or values.get("align") != "none":
        return None
    return "start", (
        f"the truth starts {error_m:.2f} m from where the drive starts; set [start], or judge the shape "
        "with --align origin"
    )


def _since(values: dict[str, Any], code: str) -> float:
    return float(values["lost"][0][0]) if code == "lost" else 0.0


def _once(found: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return one entry for each message, with all configurations it applies to."""
    by_message: dict[str, dict[str, Any]] = {}
    for entry in found:
        name = entry.pop("configuration")
        by_message.setdefault(entry["message"], {**entry, "configurations": [], "void": True})[
            "configurations"
        ].append(name)
    return list(by_message.values())
