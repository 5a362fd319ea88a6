"""The first line of every report: which sensors should I keep?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from locfuse.formats.report.findings import MAX_ANEES, length, void_reasons
from locfuse.fusion.data import BASES, result_name
from locfuse.fusion.sensors.registry import REGISTRY

NAMES = {"lrf": "laser", "gps": "GPS", "imu": "IMU"}
TIE, TIE_M = 0.10, 5e-4  # relative, m: errors that differ by less are equal
MAX_CONSISTENT_ANEES = 3.0  # above: the covariance is too small
HELPS, HURTS = ("helps", "seems to help"), ("hurts", "seems to hurt")


def headline(report: Mapping[str, Any], sets: Mapping[str, Sequence[str]]) -> str:
    """Return one or two sentences; `sets` are the sensors of every configuration that the report may name."""
    return " ".join(filter(None, (report.get("doubt"), _verdict(report, sets))))


def _verdict(report: Mapping[str, Any], sets: Mapping[str, Sequence[str]]) -> str:
    """Return the advice on the sensors."""
    errors = {n: e for n in sets if (e := report["configurations"][n].get("position_rmse_m")) is not None}
    void = void_reasons(report)
    if void and not any(sets[name] for name in errors):
        return f"No verdict on this log: {void[0]}."
    if not errors:
        return _without_truth(report)
    known = _by_reference(report, errors) if report.get("reference") else _by_errors(report, sets, errors)
    return " ".join((known, *(f"Not counted is {line}." for line in void)))


def _by_errors(report: Mapping[str, Any], sets: Mapping[str, Sequence[str]], errors: Mapping[str, float]) -> str:
    """Return which sensors to keep by the position errors of the configurations that have one."""
    if len(errors) == 1:
        ((name, error),) = errors.items()
        return f"{_with(name, sets[name])}: position error {length(error)}.{_with_fixes(report, sets, error)}"
    least, ties = min(errors.values()), _ties(errors)
    best = min(ties, key=lambda n: len(sets[n]))
    if not sets[best]:
        return f"No sensor improves on {best}: {length(errors[best])}.{_with_fixes(report, sets, least)}"
    smoothed = _smoothed(report, best, errors[best])
    if any(not v["void"] for v in report.get("validity") or ()):
        first = f"As configured the best is {_names(sets[best])}: {length(errors[best])}{smoothed}."
        first += (
            " Set the fixes first." if report.get("fixes") else " Something is wrong that no setting explains."
        )
        return f"{first}{_with_fixes(report, sets, least)}"
    first = f"Keep {_names(sets[best])}: {length(errors[best])}{smoothed}."
    return f"{_as_configured(report, sets, errors, best, first)}{_with_fixes(report, sets, least)}"


def _smoothed(report: Mapping[str, Any], best: str, error: float) -> str:
    """Return the error with smoothing beside the error [m] while driving, "" if it is not smaller."""
    after = report["configurations"].get(result_name(best, smoothed=True), {}).get("position_rmse_m")
    return "" if after is None or after >= error else f", smoothed {length(after)}"


def _as_configured(
    report: Mapping[str, Any],
    sets: Mapping[str, Sequence[str]],
    errors: Mapping[str, float],
    best: str,
    first: str,
) -> str:
    """Return which sensors to keep under the present settings, and the effect of the others."""
    every = max(sets, key=lambda n: len(sets[n]))
    ties = _ties(errors)
    others = [s for s in sets[every] if s not in sets[best]]
    if not others or every not in errors:
        base = next((n for n in BASES if n in errors), None)
        return first if base is None or others else f"{first} {_with(base, ())}: {length(errors[base])}."
    beside = "it" if len(sets[best]) == 1 else "them"
    if every in ties:
        adds = "adds" if len(others) == 1 else "add"
        return f"{first} {_names(others).capitalize()} {adds} nothing measurable beside {beside}."
    if any(f["fixes"] for f in report.get("findings") or ()):
        return f"{first} With all sensors it is {length(errors[every])} before the fixes."
    bad = [s for s in others if report.get("verdicts", {}).get(s, {}).get("verdict") in HURTS]
    all_of_them = f"{first} With all sensors it is {length(errors[every])}: "
    if suspect := [s for s in others if any(f["role"] == s for f in report.get("findings") or ())]:
        return f"{all_of_them}see the findings on {_names(suspect)}."
    if not bad:  # one drive does not settle which
        return f"{all_of_them}leave {_names(others)} out."
    return f"{all_of_them}{'' if len(bad) == 1 else 'one of '}{_names(bad)} hurts."


def covariance(report: Mapping[str, Any], sets: Mapping[str, Sequence[str]]) -> str:
    """Return that the covariance of all sensors is too small, if no finding explains it, else ""."""
    name = max(sets, key=lambda n: len(sets[n]), default="")
    anees = report["configurations"][name].get("anees") if name else None
    found = report.get("findings") or ()
    fixed = [f["tried"] for f in found if f["fixes"] and f["tried"]]
    shown = [t["after"].get("anees") for t in fixed if t["configuration"] == name]
    if fixed and not any(shown):
        return ""  # what is left once the fixes are set is not known
    anees = next((value for value in reversed(shown) if value), anees)
    if anees is None or anees <= MAX_CONSISTENT_ANEES or any(not v["void"] for v in report.get("validity") or ()):
        return ""
    truth = report.get("settings", {}).get("truth", {})
    open_ = [f["role"] for f in found if not f["fixes"] and not f["harmless"]]
    if anees <= MAX_ANEES or truth.get("sigma") or truth.get("sigma_theta_deg"):
        return f" The covariance ({name}) is {anees**0.5:.1f} times too small, and no setting explains it."
    cause = (
        f"most likely due to the finding on the {open_[0]}" if open_ else "set truth.sigma, the truth's own noise"
    )
    return f" ANEES ({name}) is over {MAX_ANEES:g}: {cause}{'' if open_ else ', to judge it'}."


def _ties(errors: Mapping[str, float]) -> list[str]:
    """Return the configurations whose errors are equal to the least."""
    least = min(errors.values())
    return [n for n, e in errors.items() if e <= least * (1.0 + TIE) + TIE_M]


def _with_fixes(report: Mapping[str, Any], sets: Mapping[str, Sequence[str]], least: float) -> str:
    """Return the effect of a fix, if its error is smaller than any without it [m], else ""."""
    tried = [f["tried"] for f in report.get("findings") or () if f["fixes"] and f["tried"]]
    after = {
        t["configuration"]: t["after"]["position_rmse_m"]
        for t in tried
        if t["configuration"] in sets
        and t["after"]["position_rmse_m"] is not None
        and not t["after"].get("aligned")  # of the path's shape: another figure
    }
    name = min(after, key=lambda n: after[n], default=None)
    if name is None or after[name] * (1.0 + TIE) + TIE_M >= least:
        return ""
    which = f"{_with(name, sets[name])} and" if len(sets) > 1 else "With"
    return f" {which} the fixes found it is {length(after[name])}."


def _by_reference(report: Mapping[str, Any], errors: Mapping[str, float]) -> str:
    """Return the order of odometry and sensors by a reference; it is no truth, so it keeps or drops none."""
    verdicts = report.get("verdicts", {})
    words = {which: [s for s, v in verdicts.items() if v["verdict"] in which] for which in (HELPS, HURTS)}
    parts = [f"{n} alone differs by {length(errors[n])}" for n in BASES if n in errors]
    for which, one, several in ((HELPS, "helps", "help"), (HURTS, "hurts", "hurt")):
        if words[which]:
            parts.append(f"{_names(words[which])} {one if len(words[which]) == 1 else several}")
    if verdicts and not any(words.values()):  # odometry alone has none
        unjudged = len(verdicts) == 1 and all(v["verdict"] == "no verdict" for v in verdicts.values())
        judge = f"{_names([*verdicts])} itself cannot be checked"
        parts.append(judge if unjudged else "of the sensors nothing is sure")
    rows = (report["configurations"][name].get("reference") or {} for name in errors)
    shared = any(row.get("shared") for row in rows)  # its own sensors are in what judges it
    agreement = " Figures with a * show agreement, not error." if shared else ""
    return f"Measured against a reference, not truth: {'; '.join(parts)}.{agreement}"


def _without_truth(report: Mapping[str, Any]) -> str:
    """Return the order of the sensors by prediction, which is no error in metres."""
    verdicts = report.get("verdicts", {})
    good = [s for s, v in verdicts.items() if v["verdict"] in HELPS]
    bad = [s for s, v in verdicts.items() if v["verdict"] in HURTS]
    parts = []
    if good:
        parts.append(f"{_names(good)} {'helps' if len(good) == 1 else 'help'} to predict the other sensors")
    if bad:
        parts.append(f"{_names(bad)} {'contradicts' if len(bad) == 1 else 'contradict'} them")
    if not parts:
        return "No truth and nothing else to judge the sensors: errors cannot be measured. Try: --reference"
    return f"No truth in this log, so no error is known: {', and '.join(parts)}."


def _with(name: str, sensors: Sequence[str]) -> str:
    return f"With {_names(sensors)}" if sensors else f"{name.capitalize()} alone"


def _names(sensors: Sequence[str]) -> str:
    """Return "the laser, the compass and the camera"."""
    words = [f"the {NAMES.get(s, s)}" for s in REGISTRY if s in sensors]
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
