"""Several words on a command line: finished results, the parts of one log, or several logs."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from locfuse.formats.container.url import Place, Url, is_url, place
from locfuse.formats.logs.files import log_name
from locfuse.formats.visible import writable
from locfuse.fusion.data import LocfuseError, UsageError

from .load import find_log

PART_NAME_PATTERN = re.compile(r"(?P<name>.+)_(?P<number>\d+)\.(?:mcap(?:\.zstd)?|db3(?:\.zstd)?)")
OVERLAP_NS = 1_000_000_000  # parts of one recording follow each other; two drives need not
METADATA_FILE = "metadata.yaml"
REPORT_FILES = ("report.json", "run.json")


def result_file(word: str) -> Path | None:
    """Return the report of a finished result that a word names (its folder or the file itself), else None."""
    if is_url(word):
        return None
    path = Path(word)
    if path.name in REPORT_FILES and path.is_file():
        return path
    return next((path / name for name in REPORT_FILES if (path / name).is_file()), None)


def results_of(words: Sequence[str]) -> list[Path] | None:
    """Return the reports where every word names a finished result, None where none does.

    A single word is never a comparison of results. Raises UsageError for logs and results mixed.
    """
    found = [result_file(word) for word in words]
    reports = [file for file in found if file is not None]
    if len(words) < 2 or not reports:
        return None
    if len(reports) < len(words):
        log = words[found.index(None)]
        raise UsageError(f"{log} is no result, {reports[0].parent} is one: compare either logs or results")
    return reports


def logs_of(words: Sequence[str]) -> list[list[str]]:
    """Return the logs that the words name, each as its parts: NAME_0.mcap, NAME_1.mcap of one folder are one log.

    Parts follow each other in time; recordings that overlap are logs of their own, whatever their names. What is
    named twice counts once: two logs of one drive would be sure of everything.
    """
    groups: dict[object, list[str]] = {}
    for word in _once(words):
        part = PART_NAME_PATTERN.fullmatch(place(word).name)
        key = (_folder(word), part["name"]) if part and (is_url(word) or Path(word).is_file()) else word
        groups.setdefault(key, []).append(word)
    return [log for parts in groups.values() for log in _split(parts)]


def named(logs: Sequence[Sequence[str]]) -> dict[str, Sequence[str]]:
    """Return the logs by a name for the folder of each; of equal names the later ones are numbered."""
    found: dict[str, Sequence[str]] = {}
    numbers: dict[str, int] = {}
    for parts in logs:
        name = stem = _name(parts)
        while name in found:
            numbers[stem] = numbers.get(stem, 1) + 1
            name = f"{stem}_{numbers[stem]}"
        found[name] = parts
    return found


def _name(parts: Sequence[str]) -> str:
    try:
        return log_name(find_log(parts))
    except UsageError:  # no such file: opening it raises this again
        return writable(Path(parts[0]).stem) or "log"


def _folder(word: str) -> Place:
    found = place(word)
    return found.parent if isinstance(found, Url) else found.resolve().parent


def _once(words: Sequence[str]) -> list[str]:
    """Leave out other paths to the same file, and a metadata.yaml beside files of its folder: `bag/*` names it."""
    first: dict[object, str] = {}
    for word in words:
        here = not is_url(word) and Path(word).exists()
        first.setdefault(Path(word).resolve() if here else word, word)
    parts = {path.parent for path in first if isinstance(path, Path) and path.name != METADATA_FILE}
    return [
        w for p, w in first.items() if not (isinstance(p, Path) and p.name == METADATA_FILE and p.parent in parts)
    ]


def _split(parts: list[str]) -> list[list[str]]:
    """Return the parts as one log, or as several where they overlap in time."""
    if len(parts) < 2:
        return [parts]
    from locfuse.formats.logs.log import open_log

    try:
        spans = sorted(span for part in parts if (span := open_log([place(part)]).time_span_ns) is not None)
    except LocfuseError:  # the one that cannot be opened fails by itself
        return [[part] for part in parts]
    apart = all(b[0] > a[1] - OVERLAP_NS for a, b in pairwise(spans))
    return [parts] if apart else [[part] for part in parts]
