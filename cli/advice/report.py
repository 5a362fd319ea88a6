"""Advice in a report: findings, fixes, validity, and the headline."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import msgspec
from msgspec.structs import replace

from locfuse.cli.analysis.choose import may_be_truth
from locfuse.cli.analysis.compare import Compared
from locfuse.cli.analysis.load import Loaded, start_error
from locfuse.cli.analysis.motion_evidence import unjudged
from locfuse.cli.analysis.results import void_figures, withdraw_verdicts
from locfuse.formats.report import json_report
from locfuse.formats.report.findings import (
    MAX_ANEES,
    in_one_unit,
    length,
    options,
    void_reasons,
    without_correlation,
)
from locfuse.formats.report.tables import errors_are_in_mm
from locfuse.formats.robot import robot_toml
from locfuse.fusion.checks.examine import BLIND, HOLE, holes, of_data, of_holes
from locfuse.fusion.checks.finding import Finding
from locfuse.fusion.checks.probes import MOUNT
from locfuse.fusion.checks.tried import MAX_SETTLED_SHARE, Advice, Fixes, Marks, by_key, keys, together
from locfuse.fusion.checks.truth import MOVED, unusable
from locfuse.fusion.checks.turning import MIRROR
from locfuse.fusion.data import BASES, result_name
from locfuse.fusion.judge.credit import MAX_CONSISTENT_ANEES
from locfuse.fusion.judge.without_truth import is_better
from locfuse.fusion.mount import OTHER_MOUNT
from locfuse.fusion.sensors.registry import REGISTRY


class Advised(msgspec.Struct, frozen=True):
    """The findings of a log's evaluation, and the number of filter runs that it took."""

    advice: tuple[Advice, ...] = ()  # advice that helps comes first, in the order of trying
    fusions: int = 0  # runs of the filter

    @property
    def fixes(self) -> Fixes:
        """All fixes that help, combined."""
        kept: Fixes = ()
        for advice in self.advice:
            kept = together(kept, advice.fixes)
        return kept


FIXES_FILE = "fixes.toml"
FIXES_HEAD = "# fixes that locfuse tried and found to help"
MAX_REFINED_SHARE = 0.2  # of a value: a smaller change is a refinement of the same fix


def add_findings(report: dict[str, Any], advised: Advised | None) -> None:
    """Add `findings` and `fixes` (all fixes that help) to the report; both are null without evaluation."""
    if advised is None:
        report["findings"] = report["fixes"] = None
        return
    by_role: dict[tuple[str, bool], list[Advice]] = {}
    for advice in advised.advice:
        by_role.setdefault((advice.finding.role, advice.helps), []).append(advice)
    report["findings"] = [_finding(_joined(found)) for found in by_role.values()]
    report["fixes"] = list(advised.fixes)


def fixes_file(report: Mapping[str, Any], name: str = FIXES_FILE) -> dict[str, str]:
    """Return {name: text of fixes.toml}, {} if no fix helps. Usage: --robot robot.toml --robot fixes.toml."""
    fixes = report.get("fixes")
    if not fixes:
        return {}
    head = f"{FIXES_HEAD}; later files win:\n#   --robot robot.toml --robot {name}\n"
    return {name: head + robot_toml.dump(robot_toml.apply_sets(fixes))}


def forget_fixes(written: Collection[Path]) -> None:
    """Delete fixes*.toml of earlier results in the folders of the `written` files."""
    for folder in {path.parent for path in written}:
        for path in folder.glob("fixes*.toml"):
            if path not in written and path.read_text(errors="replace").startswith(FIXES_HEAD):
                path.unlink()


def _joined(found: Sequence[Advice]) -> Advice:
    """Return all findings on one sensor as one finding with all their fixes."""
    first, *later = found
    earlier = first.finding.brief  # the message so far, without repeated findings of one code
    for advice in later:
        if advice.finding.code == first.finding.code:
            moved = _differ(first.fixes, advice.fixes)  # else only a refinement
            message = f"{earlier}, then {advice.finding.brief}" if moved else first.finding.brief
        else:
            earlier = first.finding.brief
            message = f"{earlier}; after this fix: {advice.finding.brief}"
            if keys(first.fixes) <= keys(advice.fixes) and _differ(first.fixes, advice.fixes):
                message = advice.finding.brief
            elif keys(first.fixes) == keys(advice.fixes):
                message = earlier
        # the first figures before, and the last after, if both are before or both after alignment
        of_all = {**advice.pairs, **first.pairs}
        last = {n: pair for n, pair in advice.pairs.items() if pair[1].aligned == of_all[n][0].aligned}
        pairs = {name: (pair[0], last.get(name, pair)[1]) for name, pair in of_all.items()}
        finding = replace(first.finding, message=message, hint="", source="")
        first = replace(first, finding=finding, fixes=together(first.fixes, advice.fixes), pairs=pairs)
    return first


def _differ(before: Iterable[str], after: Iterable[str]) -> bool:
    """Return whether any setting has clearly different values in two sets of fixes (not a refinement)."""
    first, last = by_key(before), by_key(after)
    return any(_values_differ(value, last[key]) for key, value in first.items() if key in last)


def _values_differ(one: str, other: str) -> bool:
    try:
        a, b = float(one), float(other)
    except ValueError:
        return one != other
    return abs(a - b) > MAX_REFINED_SHARE * max(abs(a), abs(b))


def _finding(advice: Advice) -> dict[str, Any]:
    name, tried = advice.shown_by, None
    if name is not None:
        before, after = map(score, advice.pairs[name])
        tried = {"configuration": name, "before": before, "after": after}
    return {
        "role": advice.finding.role,
        "code": advice.finding.code,
        "message": advice.finding.brief,
        "fixes": list(advice.fixes),
        "tried": tried,
        "alternatives": [list(fixes) for fixes in advice.tried],
        "harmless": advice.harmless,
    }


def score(score: Marks) -> dict[str, float | None]:
    """Return the figures of one configuration as plain values for the report."""
    return {
        "position_rmse_m": score.position,
        "aligned": score.aligned,
        "anees": score.anees,
        "prediction_nats": score.prediction,
        "lost_share": score.lost,
        "heading_rmse_deg": score.heading,
    }


MAX_LOST_SHARE = 0.1  # of the drive: a filter that is lost for longer has void figures
MAX_START_ERROR_M = 0.5  # between the truth's first position and a start that is not configured
BASE_ROLES = ("wheels", "truth", "log")  # roles that every configuration depends on


def add_validity(
    report: dict[str, Any], given: Sequence[Advice], start_error_m: float | None, truth: Finding | None = None
) -> None:
    """Add `validity`, the list of void and doubtful configurations, and move void figures to the key `void`."""
    found: dict[str, dict[str, Any]] = {}  # by message
    known_faults = [truth] if truth is not None else []
    known_faults += [a.finding for a in given if a.finding.code in {MIRROR, MOVED}]
    spoilt = next(((f.code, f"truth: {f.sentence}") for f in known_faults), None)
    for name, values in report["configurations"].items():
        reason = _void_reason(values, spoilt, start_error_m)
        if reason is None:
            continue
        code, message = reason
        void_figures(values, message)
        since = float(values["lost"][0][0]) if code == "lost" else 0.0
        entry = {"code": code, "message": message, "since_s": since, "configurations": [], "void": True}
        found.setdefault(message, entry)["configurations"].append(name)
    void = {entry["code"] for entry in found.values()}  # reported once: as void, not as doubtful
    doubts = [d for d in _doubts(report, given) if d["code"] not in void]
    report["validity"] = [*found.values(), *doubts]
    if found and all("void" in values for values in report["configurations"].values()):
        report["credit"] = None
        withdraw_verdicts(report, "All errors of this log are void.")
    elif doubts:
        report["credit"] = None  # its factors depend on the doubtful errors
        withdraw_verdicts(report, "Not judged while a warning is open.")
    elif found:
        known = (v["sensors"] for v in report["configurations"].values() if "void" not in v)
        usable = {sensor for sensors in known for sensor in sensors}
        withdraw_verdicts(report, "All its errors are void.", {*(report.get("verdicts") or ())} - usable)


def _doubts(report: dict[str, Any], given: Sequence[Advice]) -> list[dict[str, Any]]:
    """Return warnings on severe faults of settings or sensors, except those whose fix has no effect.

    The effects of the fixes are in `findings`.
    """
    doubts = []
    for advice in given:
        found = advice.finding
        using = [n for n, v in report["configurations"].items() if found.role in {*BASE_ROLES, *v["sensors"]}]
        if found.severe and using and found.code not in {"start", BLIND} and not advice.harmless:
            first_sentence = without_correlation(found.brief.partition(". ")[0])
            message = f"{found.role}: {first_sentence}"
            if advice.fixes:
                message += f". All figures are without this fix: {options(advice.fixes)}"
            entry = {"code": found.code, "message": message, "since_s": 0.0, "configurations": using}
            doubts.append({**entry, "void": False})
    return doubts


def _void_reason(
    values: dict[str, Any], spoilt: tuple[str, str] | None, start_error_m: float | None
) -> tuple[str, str] | None:
    """Return code and message on why figures are void, `spoilt` by a wrong truth; None if they are valid."""
    share = values.get("lost_share") or 0.0
    if share > MAX_LOST_SHARE:
        name = values["configuration"]  # also of a smoothed result, which is lost where its filter is
        return "lost", f"{name}: lost for {share:.0%} of the drive, first at {values['lost'][0][0]:.1f} s"
    if spoilt or start_error_m is None or start_error_m < MAX_START_ERROR_M or values.get("align") != "none":
        return spoilt
    away = f"the truth starts {start_error_m:.2f} m from where the drive starts"
    return "start", f"{away}; set [start], or judge the shape with --align origin"


NAME_TRUTH = "--set truth.topic=/TOPIC, a topic that holds the true poses"
SENSOR_WORDS = {"lrf": "laser", "gps": "GPS"}
MIN_HINT = 0.1  # of the agreeing share of points: a smaller gain is not reported
TIE_SHARE, TIE_M = 0.10, 5e-4  # relative, m: errors that differ by less are equal
MIN_CONSISTENT_ANEES, MIN_SIGMA_RATIO = 0.05, 2.0  # a smaller ANEES has a cause; sigma / error that is this cause
NO_EFFECT, HELPS, HURTS = "no effect seen", ("helps", "seems to help"), ("hurts", "seems to hurt")


def headline(report: Mapping[str, Any], sets: Mapping[str, Sequence[str]]) -> str:
    """Return the report's headline; `sets` are the sensors of each configuration to compare.

    The first "the laser" becomes "the laser (lrf)", with the name of its settings. Lengths are in m if the
    table's are.
    """
    words = " ".join(filter(None, (report.get("doubt"), _verdict(report, sets))))
    words = in_one_unit(words, errors_are_in_mm(report) is False)
    return re.sub(r"\bthe laser\b(?!')", "the laser (lrf)", words, count=1)


def _verdict(report: Mapping[str, Any], sets: Mapping[str, Sequence[str]]) -> str:
    """Return the advice on which sensors to keep, by truth, by a reference, or without either."""
    errors = {n: e for n in sets if (e := report["configurations"][n].get("position_rmse_m")) is not None}
    void = void_reasons(report)
    if void and not any(sets[name] for name in errors):
        return f"No verdict on this log: {void[0]}."
    if not errors:
        located = any(REGISTRY[s].locates for sensors in sets.values() for s in sensors)
        return _without_truth(report, _by_places(report), "--reference" if located else NAME_TRUTH)
    known = _by_reference(report, errors) if report.get("reference") else _by_errors(report, sets, errors)
    return " ".join((known, *(f"Not counted is {line}." for line in void)))


def _by_errors(report: Mapping[str, Any], sets: Mapping[str, Sequence[str]], errors: Mapping[str, float]) -> str:
    """Return which sensors to keep, by the position errors to truth."""
    if len(errors) == 1:
        ((name, error),) = errors.items()
        return f"{_with(name, sets[name])}: position error {length(error)}.{_with_fixes(report, sets, error)}"
    least, ties = min(errors.values()), _ties(errors)
    best = min(ties, key=lambda n: len(sets[n]))
    if not sets[best]:
        fixed, smoothed = _with_fixes(report, sets, least), _smoothed_instead(report, sets, least)
        none = f"{'As configured no' if fixed else 'No'} sensor improves on {best}: {length(errors[best])}."
        return f"{none}{smoothed}{fixed}"
    after = _smoothed_error(report, best)
    smoothed = "" if after is None or after >= errors[best] else f", smoothed {length(after)}"
    if doubts := [v.get("code") for v in report.get("validity") or () if not v["void"]]:
        first = f"As configured the best is {_names(sets[best])}: {length(errors[best])}{smoothed}."
        todo = "Set the fixes first." if report.get("fixes") else "Something is wrong that no setting explains."
        first += "" if {*doubts} == {HOLE} else f" {todo}"
        return f"{first}{_with_fixes(report, sets, least)}"
    seen = any(report.get("verdicts", {}).get(s, {}).get("verdict") != NO_EFFECT for s in sets[best])
    keep = "Keep" if seen else "The best on this drive is"
    first = f"{keep} {_names(sets[best])}: {length(errors[best])}{smoothed}."
    return f"{_as_configured(report, sets, errors, best, first)}{_with_fixes(report, sets, least)}"


def _smoothed_error(report: Mapping[str, Any], name: str) -> float | None:
    """Return the position error [m] of a configuration after smoothing; None if it was not smoothed or judged."""
    row = report["configurations"].get(result_name(name, smoothed=True), {})
    return cast("float | None", row.get("position_rmse_m"))


def _smoothed_instead(report: Mapping[str, Any], sets: Mapping[str, Sequence[str]], least: float) -> str:
    """Return a sentence on the smoothed result with the smallest error; "" unless it is below `least` [m]."""
    found = {n: error for n in sets if sets[n] and (error := _smoothed_error(report, n)) is not None}
    best = min(found, key=lambda n: found[n], default=None)
    if best is None or found[best] > (1.0 - TIE_SHARE) * least:
        return ""
    return f" Smoothed, {_names(sets[best])} does: {length(found[best])}."


def _as_configured(
    report: Mapping[str, Any],
    sets: Mapping[str, Sequence[str]],
    errors: Mapping[str, float],
    best: str,
    first: str,
) -> str:
    """Return which sensors to keep under the present settings, and the effect of the other sensors."""
    every = max(sets, key=lambda n: len(sets[n]))
    ties = _ties(errors)
    others = [s for s in sets[every] if s not in sets[best]]
    if not others or every not in errors:
        base = next((n for n in BASES if n in errors), None)
        return first if base is None or others else f"{first} {_with(base, ())}: {length(errors[base])}."
    beside = "it" if len(sets[best]) == 1 else "them"
    if every in ties:
        adds = _all_do(others, "adds", "add")[0]
        return f"{first} {adds[0].upper()}{adds[1:]} nothing measurable beside {beside}."
    if any(f["fixes"] for f in report.get("findings") or ()):
        return f"{first} With all sensors it is {length(errors[every])} before the fixes."
    bad = [s for s in others if s in _judged(report, HURTS)]
    all_of_them = f"{first} With all sensors it is {length(errors[every])}: "
    if suspect := [s for s in others if any(f["role"] == s for f in report.get("findings") or ())]:
        return f"{all_of_them}see the findings on {_names(suspect)}."
    if not bad:  # no single sensor is proven to hurt
        return f"{all_of_them}leave {_names(others)} out."
    return f"{all_of_them}{'' if len(bad) == 1 else 'one of '}{_names(bad)} hurts."


def covariance(report: Mapping[str, Any], sets: Mapping[str, Sequence[str]]) -> str:
    """Return a warning if, after the fixes, the covariance is too small with all sensors, or far too large."""
    name = max(sets, key=lambda n: len(sets[n]), default="")
    anees = report["configurations"][name].get("anees") if name else None
    found = report.get("findings") or ()
    fixed = [f["tried"] for f in found if f["fixes"] and f["tried"]]
    shown = [t["after"].get("anees") for t in fixed if t["configuration"] == name]
    if fixed and not any(shown):
        return ""  # the covariance after the fixes is unknown
    anees = next((value for value in reversed(shown) if value), anees)
    if words := _claims_too_much(report, sets):
        return words
    if anees is None or anees <= MAX_CONSISTENT_ANEES or any(not v["void"] for v in report.get("validity") or ()):
        return ""
    truth = report.get("settings", {}).get("truth", {})
    open_ = [f["role"] for f in found if not f["fixes"] and not f["harmless"] and f["code"] != BLIND]
    if anees <= MAX_ANEES or truth.get("sigma") or truth.get("sigma_theta_deg"):
        times = f"{'still ' if any(shown) else ''}{anees**0.5:.1f} times too small"
        return f" The covariance ({name}) is {times}, and no setting explains it."
    other = f"most likely due to the finding on the {open_[0]}" if open_ else ""
    cause = other or "set truth.sigma, the truth's own noise"
    return f" ANEES ({name}) is over {MAX_ANEES:g}: {cause}{'' if open_ else ', to judge it'}."


def _claims_too_much(report: Mapping[str, Any], sets: Mapping[str, Sequence[str]]) -> str:
    """Return a warning if the covariance of the motion alone is far too large, with the sigma at fault."""
    row: Mapping[str, Any] = next((report["configurations"][name] for name in BASES if name in sets), {})
    error, anees, tables = row.get("position_rmse_m"), row.get("anees"), report.get("settings", {})
    if not error or not anees or anees > MIN_CONSISTENT_ANEES:
        return ""
    sigmas = {f"{t}.{key}": tables.get(t, {}).get(key) for t, key in (("truth", "sigma"), ("start", "sigma_xy"))}
    large = [f"{key}={value:g} m is" for key, value in sigmas.items() if (value or 0.0) > MIN_SIGMA_RATIO * error]
    times = f"{anees**-0.5:.0f} times too large"
    return f" The covariance is {times}: {(large or ['wheels.noise is'])[0]} far larger than the errors show."


def _ties(errors: Mapping[str, float]) -> list[str]:
    """Return the configurations whose errors equal the smallest within 10 % and 0.5 mm."""
    least = min(errors.values())
    return [n for n, e in errors.items() if e <= least * (1.0 + TIE_SHARE) + TIE_M]


def _with_fixes(report: Mapping[str, Any], sets: Mapping[str, Sequence[str]], least: float) -> str:
    """Return a sentence with the error after all fixes if it is smaller than `least` [m], else ""."""
    if any(v.get("code") == HOLE for v in report.get("validity") or ()):
        return ""  # fixes were tried on a part of the drive
    tried = [f["tried"] for f in report.get("findings") or () if f["fixes"] and f["tried"]]
    # a finding that was followed by those of others has an earlier, larger error; aligned ones are not comparable
    found = [
        (float(error), t["configuration"])
        for t in tried
        if t["configuration"] in sets
        and (error := t["after"]["position_rmse_m"]) is not None
        and not t["after"].get("aligned")
    ]
    error, name = min(found, default=(math.inf, ""))
    if error * (1.0 + TIE_SHARE) + TIE_M >= least:
        return ""
    which = f"{_with(name, sets[name])} and" if len(sets) > 1 else "With"
    return f" {which} the fixes found it is {length(error)}."


def _by_reference(report: Mapping[str, Any], errors: Mapping[str, float]) -> str:
    """Return a sentence on odometry's error against a reference, and on sensors that help or hurt."""
    verdicts, good, bad = report.get("verdicts", {}), _judged(report, HELPS), _judged(report, HURTS)
    parts = [f"{n} alone differs by {length(errors[n])}" for n in BASES if n in errors]
    parts += [*_all_do(good, "helps", "help"), *_all_do(bad, "hurts", "hurt")]
    if verdicts and not (good or bad):  # no sensor helps or hurts
        alone = len(verdicts) == 1 and all(v["verdict"] == "no verdict" for v in verdicts.values())
        judge = f"{_names([*verdicts])} itself cannot be checked"
        parts.append(judge if alone else "of the sensors nothing is sure")
    rows = (report["configurations"][name].get("reference") or {} for name in errors)
    shared = any(row.get("shared") for row in rows)  # the reference uses sensors of the result
    agreement = " Figures with a * show agreement, not error." if shared else ""
    return f"Measured against a reference, not truth: {'; '.join(parts)}.{agreement}"


def _without_truth(report: Mapping[str, Any], places: str, instead: str) -> str:
    """Return the headline for a log without truth and reference: sensors that help to predict the others.

    `instead`: the option to try if there are none.
    """
    parts = [f"{words} to predict the other sensors" for words in _all_do(_judged(report, HELPS), "helps", "help")]
    parts += _all_do(_judged(report, HURTS), "contradicts them", "contradict them")
    if not parts:
        why = "No truth and nothing else to judge the sensors: errors cannot be measured."
        return f"{why}{places} Try: {instead}"
    return f"No truth in this log, so no error is known: {', and '.join(parts)}.{places}"


def _by_places(report: Mapping[str, Any]) -> str:
    """Return a sentence on how well scans agree at revisited places, filtered and smoothed; "" if unknown."""
    rows = report["configurations"]
    for name, values in rows.items():
        row = result_name(name, smoothed=True)
        one, other = values.get("revisit_agreement"), rows.get(row, {}).get("revisit_agreement")
        if one is None or other is None:
            continue
        better = "" if other < one + MIN_HINT else "shows" if is_better(one, other) else "hints"
        end = f", which {better} that it is better" if better else ""
        return f" At places seen twice {one:.0%} of the points agree, in {row} {other:.0%}{end}."
    return ""


def _judged(report: Mapping[str, Any], verdicts: Collection[str]) -> list[str]:
    """Return the sensors that have one of these verdicts."""
    return [s for s, found in report.get("verdicts", {}).items() if found["verdict"] in verdicts]


def _all_do(sensors: Sequence[str], one_does: str, several_do: str) -> list[str]:
    """Return ["the laser helps"], or ["the laser and the camera help"]; [] without sensors."""
    return [f"{_names(sensors)} {one_does if len(sensors) == 1 else several_do}"] if sensors else []


def _with(name: str, sensors: Sequence[str]) -> str:
    return f"With {_names(sensors)}" if sensors else f"{name.capitalize()} alone"


def _names(sensors: Sequence[str]) -> str:
    """Return sensors in words: "the laser, the compass and the camera"."""
    words = [f"the {SENSOR_WORDS.get(s, s)}" for s in REGISTRY if s in sensors]
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def complete(report: dict[str, Any], compared: Compared, advised: Advised | None) -> None:
    """Add findings, validity and headline to a finished report.

    `advised` is None if the log was not evaluated: then verdicts are withdrawn only because of unusable data.
    """
    loaded, drive, sets = compared.loaded, compared.loaded.drive, compared.sets
    broken = of_holes(drive, holes(drive)) if advised is None else ()
    given = (*map(Advice, broken), *data_advice(loaded)) if advised is None else advised.advice
    add_findings(report, advised)
    # notes on a mount for which a finding has a fix: the report proposes only one value
    mounts = {f["role"] for f in report["findings"] or () if f["code"] == MOUNT and f["fixes"]}
    superseded = tuple(f"{sensor}: {OTHER_MOUNT}" for sensor in mounts)
    for values in report["configurations"].values():
        values["notes"] = [note for note in values["notes"] if not note.startswith(superseded)]
    truth = None if loaded.motion_faults else unusable(drive)  # makes errors to the truth void
    add_validity(report, given, start_error(loaded.robot, drive), truth)
    withdraw_verdicts(report, "Not judged before the fixes, which halve its error.", settled(report, sets))
    for blind in (a.finding.role for a in given if a.finding.code == BLIND):
        verdict = (report.get("verdicts") or {}).get(blind, {})
        if verdict.get("verdict") == "no effect seen":
            verdict.update(verdict="no verdict", words="It gives hardly any measurement.")
    words = f"{headline(report, sets)}{covariance(report, sets)}"
    if NAME_TRUTH in words and (poses := may_be_truth(loaded.log, loaded.robot, loaded.choice)):
        words = words.replace(NAME_TRUTH, f"--set truth.topic={poses[0]}, if it holds the true poses")
    if why := unjudged(drive):
        words = f"{why[0].upper()}{why[1:]}."
        withdraw_verdicts(report, "This drive cannot judge a sensor.")
    report["headline"] = words
    report.update(json_report.plain(report))


def settled(report: Mapping[str, Any], sets: Mapping[str, Sequence[str]]) -> set[str]:
    """Return the sensors without a good verdict whose errors the fixes reduce to less than half."""
    bad = {*_judged(report, (*HURTS, NO_EFFECT))}
    tried = [f["tried"] for f in report["findings"] or () if f["fixes"] and f["tried"]]
    errors = [(t["configuration"], t["before"]["position_rmse_m"], t["after"]["position_rmse_m"]) for t in tried]
    halved = [
        name for name, one, other in errors if other is not None and other < MAX_SETTLED_SHARE * (one or 0.0)
    ]
    return bad & {s for name in halved for s in sets.get(name, ())}


def data_advice(loaded: Loaded) -> tuple[Advice, ...]:
    """Return findings on unusable data; their fixes change how the log is read, and are not tried."""
    return tuple(Advice(f, f.fixes) for f in of_data(loaded.drive, loaded.robot, loaded.stream))
