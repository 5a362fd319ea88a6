"""What a reader of the figures must know, each thing once: of the log, and of what configurations found in it."""

from __future__ import annotations

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
    found: dict[str, list[str]] = {}
    for name, values in runs.items():
        for words in values["notes"]:
            found.setdefault(words, []).append(name)
    said = (words if len(runs) == 1 else _whose(words, names) for words, names in found.items())
    return [*report["notes"], *said]


def _whose(words: str, names: Sequence[str]) -> str:
    """Put the configurations before what they found; a sensor's own words name it already."""
    names_them = ", ".join(names)
    return words if words.startswith(f"{names_them}: ") else f"{names_them}: {words}"


def fingerprint(source: Mapping[str, Any], digits: int | None = None) -> str:
    """Return the hash of the input's bytes, or where not all were read, what its content is known by."""
    if source.get("sha256") is not None:
        return f"sha256 {source['sha256'][:digits]}"
    return f"identity {source['identity'][:digits]}"
