"""What a reader of the figures must know, each thing once: of the log, and of what configurations found in it."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

NUMBER = re.compile(r"(?<![\w@])-?\d+(?:\.\d+)?(?:e[-+]?\d+)?[%°]?")  # not one within a name: lrf2, lrf@2Hz


def title_of(report: Mapping[str, Any]) -> str:
    """Return the name of the log, and of the preset unless it is the default one."""
    preset = report["settings"].get("preset", "default")
    name: str = report["input"]["name"]
    return name if preset == "default" else f"{name}, preset {preset}"


def notes_of(report: Mapping[str, Any]) -> list[str]:
    """Return the log's notes, then the configurations' (slips, a track that was found), with who found them."""
    runs = report["configurations"]
    found: dict[tuple[str, int], dict[str, str]] = {}
    for name, values in runs.items():
        times: Counter[str] = Counter()
        for words in values["notes"]:
            form = _form(words)
            found.setdefault((form, times[form]), {})[name] = words
            times[form] += 1
    said = (next(iter(own.values())) if len(runs) == 1 else _whose(own) for own in found.values())
    return [*_of_log(report["notes"]), *said]


def _form(words: str) -> str:
    """Return words without their numbers: what differs only there is the same note."""
    return NUMBER.sub("#", words)


def _of_log(notes: Sequence[str]) -> list[str]:
    """Return the log's notes; what is true of several streams stands once, with the names of all."""
    found: dict[tuple[str, int], dict[str, str]] = {}
    times: Counter[tuple[str, str]] = Counter()
    for note in notes:
        who, colon, words = note.partition(": ")
        who, words = (who, words) if colon else ("", note)
        form = _form(words) if colon else note
        found.setdefault((form, times[who, form]), {})[who] = words
        times[who, form] += 1
    return [f"{', '.join(own)}: {_with_others(own)}" if "" not in own else own[""] for own in found.values()]


def _whose(own: Mapping[str, str]) -> str:
    """Put the configurations before what they found, words by name; a sensor's own words name it already.

    Numbers that are not the first one's stand behind it: "19 (all: 5) places were recognised".
    """
    first, *others = own
    words = _with_others(own)
    if not own[first].startswith(f"{first}: "):
        return f"{', '.join(own)}: {words}"
    alike = [name for name in others if own[name] == own[first]]
    return f"{words} ({', '.join(alike)}: alike)" if alike else words


def _with_others(own: Mapping[str, str]) -> str:
    """Return the first configuration's words; behind each number, whose is another one."""
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
    """Return the hash of the input's bytes, or where not all were read, what its content is known by."""
    if source.get("sha256") is not None:
        return f"sha256 {source['sha256'][:digits]}"
    return f"identity {source['identity'][:digits]}"
