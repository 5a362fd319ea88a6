"""What a reader of the figures must know, each thing once: of the log, and of what configurations found in it."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any


def title_of(report: Mapping[str, Any]) -> str:
    """Return the name of the log, and of the preset unless it is the default one."""
    preset = report["settings"].get("preset", "default")
    name: str = report["input"]["name"]
    return name if preset == "default" else f"{name}, preset {preset}"


def notes_of(report: Mapping[str, Any]) -> list[str]:
    """Return the log's notes, then the configurations' (slips, a track that was found), with who found them."""
    runs = report["configurations"]
    found: dict[str, tuple[str, list[str]]] = {}
    for name, values in runs.items():
        for words in values["notes"]:
            found.setdefault(_form(words), (words, []))[1].append(name)
    said = (words if len(runs) == 1 else _whose(words, names) for words, names in found.values())
    return [*_of_log(report["notes"]), *said]


def _form(words: str) -> str:
    """Return words without their numbers: what differs only there is the same note."""
    return re.sub(r"\d+(\.\d+)?", "#", words)


def _of_log(notes: Sequence[str]) -> list[str]:
    """Return the log's notes; what is true of several streams stands once, with the names of all."""
    found: dict[str, tuple[str, str, list[str]]] = {}
    for note in notes:
        who, colon, words = note.partition(": ")
        found.setdefault(_form(words) if colon else note, (who, note, []))[2].append(who)
    return [
        note if len(names) < 2 else note.replace(who, ", ".join(names), 1) for who, note, names in found.values()
    ]


def _whose(words: str, names: Sequence[str]) -> str:
    """Put the configurations before what they found; a sensor's own words name it already."""
    first, *others = names
    if words.startswith(f"{first}: "):
        return f"{words} ({', '.join(others)}: alike)" if others else words
    return f"{', '.join(names)}: {words}"


def fingerprint(source: Mapping[str, Any], digits: int | None = None) -> str:
    """Return the hash of the input's bytes, or where not all were read, what its content is known by."""
    if source.get("sha256") is not None:
        return f"sha256 {source['sha256'][:digits]}"
    return f"identity {source['identity'][:digits]}"
