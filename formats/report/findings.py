"""Findings as sentences for all output formats: the problem, the fix that was tried, and its effect."""

from __future__ import annotations

import re
import shlex
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

KEY_SET = re.compile(r"--set ([\w.]+)=")
CLAUSE_END = re.compile(r"; |, but ")
MIN_HEADING_CHANGE = 0.2  # share of the heading error; smaller changes are not shown
MIN_SCORE_CHANGE_NATS = 0.02  # per number; a smaller change is shown as no change
MAX_ANEES = 50.0  # larger ones are shown as "over 50"


class Warned(NamedTuple):
    """A warning to show in a box: why error figures are void (not valid) or doubtful."""

    kind: str  # "Void", "Warning"
    at: int  # index of the warning in report["validity"]
    finding: Mapping[str, Any] | None  # the finding with the same problem and its fix; None if there is none


def warnings_of(report: Mapping[str, Any]) -> list[Warned]:
    """Return the warnings of a report that its headline does not contain.

    If one finding covers several warnings, only the first of these is returned.
    """
    headline, shown, found = report.get("headline") or "", list[Any](), list[Warned]()
    for i, warning in enumerate(report.get("validity") or ()):
        finding = next((f for f in report.get("findings") or () if _is_about(f, warning)), None)
        if warning["message"] not in headline and finding not in shown:
            found.append(Warned("Void" if warning.get("void", True) else "Warning", i, finding))
            shown += [] if finding is None else [finding]
    return found


def banner_of(report: Mapping[str, Any]) -> list[str]:
    """Return the warnings of a report as lines, each with the finding and fix that belong to it, if any."""
    return [
        f"{kind}: {report['validity'][at]['message']}." if finding is None else f"{kind}: {sentence(finding)}"
        for kind, at, finding in warnings_of(report)
    ]


def _is_about(finding: Mapping[str, Any], warning: Mapping[str, Any]) -> bool:
    """Return whether a finding and a warning (of doubtful figures) are about the same problem."""
    role, _, words = warning["message"].partition(": ")
    found = words.partition(". ")[0] in without_correlation(finding["message"])
    keys = {*KEY_SET.findall(words)}  # the fix of the finding replaces these
    found |= bool(keys) and keys <= {fix.partition("=")[0] for fix in finding["fixes"]}
    return not warning.get("void", True) and finding["role"] == role and found


def without_correlation(words: str) -> str:
    """Return a finding's text without the correlation of two signals in brackets."""
    return re.sub(r" \(correlation [^()]*\)", "", words)


def unwarned(report: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the findings whose problem is in no printed warning."""
    printed = [report["validity"][warning.at] for warning in warnings_of(report)]
    return [f for f in report.get("findings") or () if not any(_is_about(f, warning) for warning in printed)]


def void_reasons(report: Mapping[str, Any]) -> list[str]:
    """Return the reasons why error figures are void; if there are any, the command exits with code 3."""
    return [v["message"] for v in report.get("validity") or () if v["void"]]


def sentence(finding: Mapping[str, Any], brief: bool = False) -> str:
    """Return a finding as text: "compass: ... Fix (tried with all: error 110 -> 4 mm): --set ...".

    `brief` shortens the problem to its first clause.
    """
    return " ".join(filter(None, in_parts(finding, brief)))


def in_parts(finding: Mapping[str, Any], brief: bool = False) -> tuple[str, str]:
    """Return a finding's sentence, and the command-line options of its fix; "" if it has none."""
    words, tried = finding["message"].rstrip(". "), finding["tried"]
    head = f"{finding['role']}: {CLAUSE_END.split(words)[0] if brief and finding['fixes'] else words}."
    if not finding["fixes"]:
        failed = ", or ".join(" and ".join(fixes) for fixes in finding.get("alternatives", ()))
        if failed and finding.get("harmless"):
            head += f" With {failed} little changes on this drive."
        elif failed:
            head += f" No setting found that helps ({failed} could explain it, but the result gets no better)."
        return head, ""
    if tried is None:
        return f"{head} Fix (not tried):", options(finding["fixes"])
    before, after = tried["before"]["position_rmse_m"], tried["after"]["position_rmse_m"]
    worse = before is not None and after is not None and after > 1.01 * before
    which = "Fix for the covariance only" if worse else "Fix"
    with_what = "" if brief else f" with {tried['configuration']}"
    return f"{head} {which} (tried{with_what}: {effect_of(tried, brief)}):", options(finding["fixes"])


def counts(by_reason: Mapping[str, int]) -> str:
    """Return counts as text: "3 out of order, 1 repeat"."""
    return ", ".join(f"{n} {reason.replace('_', ' ')}" for reason, n in by_reason.items())


def options(fixes: Sequence[str]) -> str:
    """Return settings as command-line options: "--set lrf.time_offset=-0.16"."""
    return " ".join(f"--set {shlex.quote(fix)}" for fix in fixes)


def together(report: Mapping[str, Any]) -> str | None:
    """Return a line with the options of all fixes together; None if fewer than two findings have a fix."""
    fixed = [f for f in report.get("findings") or () if f["fixes"]]
    return f"All fixes together: {options(report['fixes'])}" if len(fixed) > 1 else None


def effect_of(tried: Mapping[str, Any], brief: bool) -> str:
    """Return the effect of a tried fix on the error figures: "error 31 -> 3.9 mm, ANEES 29 -> 0.67"."""
    before, after = tried["before"], tried["after"]
    parts = []
    if before["lost_share"] != after["lost_share"]:
        parts.append(f"lost {before['lost_share']:.0%} -> {after['lost_share']:.0%} of the drive")
    if before["position_rmse_m"] is not None:
        error = "error of the path's shape" if before.get("aligned") else "error"
        parts.append(f"{error} {change(before['position_rmse_m'], after['position_rmse_m'])}")
    first, last = (values.get("heading_rmse_deg") for values in (before, after))
    if not brief and first and last is not None and abs(first - last) > MIN_HEADING_CHANGE * first:
        parts.append("heading " + " -> ".join(f"{v:.0f}°" if v >= 10.0 else f"{v:.2g}°" for v in (first, last)))
    if before["anees"] and after["anees"]:
        parts.append(f"ANEES {_anees(before['anees'])} -> {_anees(after['anees'])}")
    if before["prediction_nats"] is not None:
        gained = after["prediction_nats"] - before["prediction_nats"]
        same = abs(gained) < MIN_SCORE_CHANGE_NATS
        parts.append("prediction as before" if same else f"prediction {gained:+.2f} nats per number")
    return ", ".join(parts)


def _anees(value: float) -> str:
    """Return an ANEES with two digits: "0.92", "4.7"; "over 50" above MAX_ANEES."""
    return f"over {MAX_ANEES:g}" if value > MAX_ANEES else f"{value:.2g}"


def change(before: float, after: float) -> str:
    """Return two lengths [m] in one unit: "109 -> 102 mm", "1.47 -> 0.25 m"."""
    if max(before, after) >= 1.0:
        return f"{before:.2f} -> {after:.2f} m"
    fine = min(before, after) < 0.00995
    first, last = (f"{1000.0 * v:.2g}" if fine and v < 0.00995 else f"{1000.0 * v:.0f}" for v in (before, after))
    return f"{first} -> {last} mm"


def length(metres: float) -> str:
    """Return a readable length: "4 mm", "110 mm", "1.20 m", "12 m"."""
    if metres < 0.9995:
        return f"{1000.0 * metres:.2g} mm" if metres < 0.00995 else f"{1000.0 * metres:.0f} mm"
    return f"{metres:.2f} m" if metres < 9.95 else f"{metres:.0f} m"


def in_one_unit(words: str, in_m: bool = False) -> str:
    """Return a text whose lengths are all in m if one of them is: "87 mm ... 1.20 m" -> "0.087 m ... 1.20 m".

    With `in_m` they are always in m.
    """
    if not in_m and not LENGTH_M.search(words):
        return words
    return LENGTH_MM.sub(lambda found: f"{float(found[1]) / 1000.0:.3g} m", words)


# --- Notes; those that differ only in numbers or names are merged into one note

LENGTH_M, LENGTH_MM = re.compile(r"\d m\b"), re.compile(r"\b([\d.]+) mm\b")
NUMBER = re.compile(r"(?<![\w@])-?\d+(?:\.\d+)?(?:e[-+]?\d+)?[%°]?")  # not the digits of a name (lrf2, lrf@2Hz)


def title_of(report: Mapping[str, Any]) -> str:
    """Return the name of the log, and of the preset unless it is the default one."""
    preset = report["settings"].get("preset", "default")
    name: str = report["input"]["name"]
    return name if preset == "default" else f"{name}, preset {preset}"


def notes_of(report: Mapping[str, Any]) -> list[str]:
    """Return the notes of the log, then of the configurations (wheel slips, estimated track width).

    Equal notes on several streams become one note with all stream names.
    """
    parted = (("", "", note) if ": " not in note else note.partition(": ") for note in report["notes"])
    streams = _grouped((name, NUMBER.sub("#", words) if name else words, words) for name, _, words in parted)
    of_log = [f"{', '.join(own)}: {_with_others(own)}" if "" not in own else own[""] for own in streams]
    runs = report["configurations"]
    notes = ((name, NUMBER.sub("#", words), words) for name, values in runs.items() for words in values["notes"])
    return [*of_log, *(next(iter(own.values())) if len(runs) == 1 else _named(own) for own in _grouped(notes))]


def _grouped(notes: Iterable[tuple[str, str, str]]) -> Iterable[dict[str, str]]:
    """Group notes (source, form, words) by their form; return each group as source -> words.

    The form is the words with "#" in place of each number. If a source has several notes of one form, the k-th
    notes of all sources are one group.
    """
    found: dict[tuple[str, int], dict[str, str]] = {}
    times: Counter[tuple[str, str]] = Counter()
    for source, form, words in notes:
        found.setdefault((form, times[source, form]), {})[source] = words
        times[source, form] += 1
    return found.values()


def _named(own: Mapping[str, str]) -> str:
    """Merge notes (configuration -> note) into one that begins with the configurations: "lrf, gps: ...".

    If the first note already begins with its configuration, the names of configurations with an equal note follow
    at its end.
    """
    first, *others = own
    words = _with_others(own)
    if not own[first].startswith(f"{first}: "):
        return f"{', '.join(own)}: {words}"
    alike = [name for name in others if own[name] == own[first]]
    return f"{words} (the same in {', '.join(alike)})" if alike else words


def _with_others(own: Mapping[str, str]) -> str:
    """Return the first of several notes, with differing numbers of the others in brackets.

    Example: "0.4 m (lrf: 0.5)".
    """
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
    """Return the SHA-256 of the input's bytes, or the log's identity if not all bytes were read."""
    if source.get("sha256") is not None:
        return f"sha256 {source['sha256'][:digits]}"
    return f"identity {source['identity'][:digits]}"
