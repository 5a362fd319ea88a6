"""Findings in words: the problem, the fix that was tried, and its effect. The same sentence in every medium."""

from __future__ import annotations

import re
import shlex
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

CLAUSE_END = re.compile(r"; |, but ")
SAME_TURN = 0.2  # of a heading error: a smaller change is not said
SAME_NATS = 0.02  # nats per number: predictions that differ by less are equal
MAX_ANEES = 50.0  # above: the number says nothing more, only that something is wrong


def banner_of(report: Mapping[str, Any]) -> list[str]:
    """Return warnings to read before any figure: what is void or doubtful, and why."""
    found = [report["validity"][i] for i in boxed(report)]
    return [f"{'Void' if v.get('void', True) else 'Warning'}: {v['message']}." for v in found]


def boxed(report: Mapping[str, Any]) -> list[int]:
    """Return the positions of void or doubtful entries that the headline does not name."""
    headline = report.get("headline") or ""
    return [i for i, v in enumerate(report.get("validity") or ()) if v["message"] not in headline]


def void_reasons(report: Mapping[str, Any]) -> list[str]:
    """Return why figures are void, one line each: the command then exits with 3."""
    return [v["message"] for v in report.get("validity") or () if v["void"]]


def findings_of(report: Mapping[str, Any]) -> list[str]:
    """Return one line per finding; reports of earlier versions have none."""
    return [sentence(f) for f in report.get("findings") or ()]


def sentence(finding: Mapping[str, Any], brief: bool = False) -> str:
    """Return "compass: ... Fix (tried with all: error 110 -> 4 mm): --set ..."; brief: its first clause."""
    return " ".join(filter(None, in_parts(finding, brief)))


def in_parts(finding: Mapping[str, Any], brief: bool = False) -> tuple[str, str]:
    """Return a finding's sentence and the options that fix it, "" without a fix."""
    words = finding["message"].rstrip(". ")
    head = f"{finding['role']}: {CLAUSE_END.split(words)[0] if brief and finding['fixes'] else words}."
    if not finding["fixes"]:
        return f"{head}{_in_vain(finding)}", ""
    tried = finding["tried"]
    which = "Fix for the covariance only" if _worse(tried) else "Fix"
    with_what = "" if brief else f" with {tried['configuration']}"
    return f"{head} {which} (tried{with_what}: {effect_of(tried, brief)}):", options(finding["fixes"])


def _worse(tried: Mapping[str, Any]) -> bool:
    """Return whether the tried fix made the position error larger."""
    before, after = tried["before"]["position_rmse_m"], tried["after"]["position_rmse_m"]
    return before is not None and after is not None and after > 1.01 * before


def _in_vain(finding: Mapping[str, Any]) -> str:
    """Return the fixes that were tried without success, as a sentence; "" if there are none."""
    tried = ", or ".join(" and ".join(fixes) for fixes in finding.get("alternatives", ()))
    if not tried:
        return ""
    if finding.get("harmless"):
        return f" With {tried} little changes on this drive."
    return f" No setting found that helps ({tried} could explain it, but the result gets no better)."


def counts(by_reason: Mapping[str, int]) -> str:
    """Return "3 out of order, 1 repeat"."""
    return ", ".join(f"{n} {reason.replace('_', ' ')}" for reason, n in by_reason.items())


def options(fixes: Sequence[str]) -> str:
    """Return settings as options of the command line."""
    return " ".join(f"--set {shlex.quote(fix)}" for fix in fixes)


def together(report: Mapping[str, Any]) -> str | None:
    """Return all fixes as one line to type; None where there is at most one finding with a fix."""
    fixed = [f for f in report.get("findings") or () if f["fixes"]]
    return f"All of these together: {options(report['fixes'])}" if len(fixed) > 1 else None


def effect_of(tried: Mapping[str, Any], brief: bool) -> str:
    """Return what a fix does to the figures `before` and `after` it: "error 31 -> 3.9 mm, ANEES 29 -> 0.67"."""
    before, after = tried["before"], tried["after"]
    parts = []
    if before["lost_share"] != after["lost_share"]:
        parts.append(f"lost {before['lost_share']:.0%} -> {after['lost_share']:.0%} of the drive")
    if before["position_rmse_m"] is not None:
        whose = "error of the path's shape" if before.get("aligned") else "error"
        parts.append(f"{whose} {change(before['position_rmse_m'], after['position_rmse_m'])}")
    turned = [values.get("heading_rmse_deg") for values in (before, after)]
    if not brief and turned[0] and turned[1] is not None and abs(turned[0] - turned[1]) > SAME_TURN * turned[0]:
        parts.append("heading " + " -> ".join(f"{v:.0f}°" if v >= 10.0 else f"{v:.2g}°" for v in turned))
    if before["anees"] and after["anees"]:
        parts.append(f"ANEES {_ratio(before['anees'])} -> {_ratio(after['anees'])}")
    if before["prediction_nats"] is not None:
        gained = after["prediction_nats"] - before["prediction_nats"]
        same = abs(gained) < SAME_NATS
        parts.append("prediction as before" if same else f"prediction {gained:+.2f} nats per number")
    return ", ".join(parts)


def _ratio(value: float) -> str:
    """Return a ratio with two digits: "0.92", "4.7"; very large ones only as a limit."""
    return f"over {MAX_ANEES:g}" if value > MAX_ANEES else f"{value:.2g}"


def change(before: float, after: float) -> str:
    """Return two lengths [m] in one unit: "109 -> 102 mm", "1.47 -> 0.25 m"."""
    if max(before, after) >= 1.0:
        return f"{before:.2f} -> {after:.2f} m"
    fine = min(before, after) < 0.00995
    first, last = (f"{1000.0 * v:.2g}" if fine and v < 0.00995 else f"{1000.0 * v:.0f}" for v in (before, after))
    return f"{first} -> {last} mm"


def length(metres: float) -> str:
    """Return a readable length: "4 mm", "0.11 m", "12 m"."""
    if metres < 0.0995:
        return f"{1000.0 * metres:.2g} mm" if metres < 0.00995 else f"{1000.0 * metres:.0f} mm"
    return f"{metres:.2f} m" if metres < 9.95 else f"{metres:.0f} m"


# --- Notes: what a reader of the figures must know, each thing once

NUMBER = re.compile(r"(?<![\w@])-?\d+(?:\.\d+)?(?:e[-+]?\d+)?[%°]?")  # not one within a name: lrf2, lrf@2Hz


def title_of(report: Mapping[str, Any]) -> str:
    """Return the name of the log, and of the preset unless it is the default one."""
    preset = report["settings"].get("preset", "default")
    name: str = report["input"]["name"]
    return name if preset == "default" else f"{name}, preset {preset}"


def notes_of(report: Mapping[str, Any]) -> list[str]:
    """Return the log's notes, then those of configurations (slips, an estimated track), with their names."""
    runs = report["configurations"]
    found = _grouped((name, _form(words), words) for name, values in runs.items() for words in values["notes"])
    said = (next(iter(own.values())) if len(runs) == 1 else _whose(own) for own in found)
    return [*_of_log(report["notes"]), *said]


def _grouped(notes: Iterable[tuple[str, str, str]]) -> Iterable[dict[str, str]]:
    """Group notes (who, form, words) of one form by who says them; the n-th of each belong together."""
    found: dict[tuple[str, int], dict[str, str]] = {}
    times: Counter[tuple[str, str]] = Counter()
    for who, form, words in notes:
        found.setdefault((form, times[who, form]), {})[who] = words
        times[who, form] += 1
    return found.values()


def _form(words: str) -> str:
    """Return words without their numbers, to find notes that differ only in numbers."""
    return NUMBER.sub("#", words)


def _of_log(notes: Sequence[str]) -> list[str]:
    """Return the log's notes; one that holds for several streams appears once, with all names."""
    parted = (("", "", note) if ": " not in note else note.partition(": ") for note in notes)
    found = _grouped((who, _form(words) if who else words, words) for who, _, words in parted)
    return [f"{', '.join(own)}: {_with_others(own)}" if "" not in own else own[""] for own in found]


def _whose(own: Mapping[str, str]) -> str:
    """Put the names of configurations before their notes; notes that name a sensor already are unchanged.

    Numbers that are not the first one's stand behind it: "19 (all: 5) revisited places".
    """
    first, *others = own
    words = _with_others(own)
    if not own[first].startswith(f"{first}: "):
        return f"{', '.join(own)}: {words}"
    alike = [name for name in others if own[name] == own[first]]
    return f"{words} (the same in {', '.join(alike)})" if alike else words


def _with_others(own: Mapping[str, str]) -> str:
    """Return the first configuration's words; numbers of others are added if they differ: "0.4 m (lrf: 0.5)"."""
    first, *others = own
    numbers = {name: iter(NUMBER.findall(words)) for name, words in own.items()}

    def with_others(match: re.Match[str]) -> str:
        values = {name: next(left) for name, left in numbers.items()}
        differing: dict[str, list[str]] = {}
        for name in others:
            if values[name] != values[first]:
                differing.setdefault(values[name], []).append(name)
        if not differing:
            return match[0]
        shown = "; ".join(f"{', '.join(names)}: {value}" for value, names in differing.items())
        return f"{match[0]} ({shown})"

    return NUMBER.sub(with_others, own[first])


def fingerprint(source: Mapping[str, Any], digits: int | None = None) -> str:
    """Return the hash of the input's bytes, or the identity of its content if not all were read."""
    if source.get("sha256") is not None:
        return f"sha256 {source['sha256'][:digits]}"
    return f"identity {source['identity'][:digits]}"
