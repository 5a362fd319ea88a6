"""Findings and headline as plain values of report.json, and the fixes as a robot.toml of their own."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from msgspec.structs import replace

from locfuse.formats.robot import robot_toml
from locfuse.fusion.checks.score import Score
from locfuse.fusion.checks.tried import Advice, keys, together

from .advised import Advised

FIXES_FILE = "fixes.toml"
MAX_REFINED_SHARE = 0.2  # of a value: a larger change between two fixes is not the same measured better


def add_findings(report: dict[str, Any], advised: Advised | None) -> None:
    """Add `findings`, and `fixes`: all helpful ones together; null if the log was not evaluated."""
    if advised is None:
        report["findings"] = report["fixes"] = None
        return
    by_role: dict[tuple[str, bool], list[Advice]] = {}
    for advice in advised.advice:
        by_role.setdefault((advice.finding.role, advice.helps), []).append(advice)
    report["findings"] = [_finding(_joined(found)) for found in by_role.values()]
    report["fixes"] = list(advised.fixes)


def fixes_file(report: Mapping[str, Any]) -> dict[str, str]:
    """Return fixes.toml by its name, empty if no fix helps: --robot robot.toml --robot fixes.toml."""
    fixes = report.get("fixes")
    if not fixes:
        return {}
    head = (
        "# fixes that locfuse tried and found to help; later files win:\n"
        f"#   --robot robot.toml --robot {FIXES_FILE}\n"
    )
    return {FIXES_FILE: head + robot_toml.dump(robot_toml.apply_sets(fixes))}


def _joined(found: Sequence[Advice]) -> Advice:
    """Return the findings of one sensor, step by step, as one finding with one fix."""
    first, *later = found
    before_it = first.finding.brief  # what was found before this kind of fault was measured again
    for advice in later:
        if advice.finding.code != first.finding.code:
            before_it = first.finding.brief
        message = f"{before_it}; then {advice.finding.brief}"
        if advice.finding.code == first.finding.code and not _moved(first.fixes, advice.fixes):
            message = first.finding.brief  # the same once more, measured better
        elif advice.finding.code != first.finding.code and keys(first.fixes) <= keys(advice.fixes):
            message = advice.finding.brief  # the first one's fix is not what was set in the end
        before = {**(advice.before or {}), **(first.before or {})}
        after = {**(first.after or {}), **(advice.after or {})}
        fixes = together(first.fixes, advice.fixes)
        finding = replace(first.finding, message=message, hint="", source="")
        first = replace(first, finding=finding, fixes=fixes, before=before, after=after)
    return first


def _moved(before: Iterable[str], after: Iterable[str]) -> bool:
    """Return whether a value changed in the end, by more than measuring again changes it."""
    first, last = (dict(fix.partition("=")[::2] for fix in fixes) for fixes in (before, after))
    return any(_apart(value, last[key]) for key, value in first.items() if key in last)


def _apart(one: str, other: str) -> bool:
    try:
        a, b = float(one), float(other)
    except ValueError:
        return one != other
    return abs(a - b) > MAX_REFINED_SHARE * max(abs(a), abs(b))


def _finding(advice: Advice) -> dict[str, Any]:
    name, tried = advice.shown_by, None
    if name is not None and advice.before is not None and advice.after is not None:
        tried = {
            "configuration": name,
            "before": _score(advice.before[name]),
            "after": _score(advice.after[name]),
        }
    return {
        "role": advice.finding.role,
        "code": advice.finding.code,
        "message": advice.finding.brief,
        "fixes": list(advice.fixes),
        "tried": tried,
        "alternatives": [list(fixes) for fixes in advice.tried],
        "harmless": advice.harmless,
    }


def _score(score: Score) -> dict[str, float | None]:
    return {
        "position_rmse_m": score.position,
        "aligned": score.aligned,
        "anees": score.anees,
        "prediction_nats": score.prediction,
        "lost_share": score.lost,
        "heading_rmse_deg": score.heading,
    }
