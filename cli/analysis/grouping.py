"""Classifies paths of a command line: finished results, parts of one log, or several logs.

Many logs are given by a list in a file, by a pattern, or by a folder with logs at any depth.
"""

from __future__ import annotations

import fnmatch
import glob
import os
import re
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

from locfuse.formats.container.file_bytes import Url, is_url, place
from locfuse.formats.inputs import read_small
from locfuse.formats.logs.files import ENDINGS, REPORTS, log_name
from locfuse.formats.logs.log import open_log
from locfuse.formats.text import writable
from locfuse.formats.whole_files import RESULTS
from locfuse.fusion.data import LocfuseError, UsageError

from .load import find_log

PART_NAME_PATTERN = re.compile(r"(?P<name>.+)_(?P<number>\d+)\.(?:mcap(?:\.zstd)?|db3(?:\.zstd)?)")
OVERLAP_NS = 1_000_000_000  # parts of one recording may overlap by less
METADATA_FILE = "metadata.yaml"
MAX_LIST_BYTES = 64 * 1024 * 1024  # of a list of logs: half a million paths


def expanded(words: Sequence[str], each: Sequence[str] = ()) -> list[str]:
    """Return the paths of all logs, or parts of logs, that the words name.

    @FILE stands for its lines, a pattern for its matches; all logs below the folders in `each` are added.
    A rosbag2 folder is one log. Raises UsageError for a pattern without a match and a folder without logs,
    LocfuseError for an unreadable list.
    """
    found = [path for word in words for path in _expanded(word)]
    for folder in each:
        below = _objects(Url(folder)) if is_url(folder) else list(_below(Path(folder)))
        if not below:
            raise UsageError(f"--each {folder}: no log below it ({', '.join(ENDINGS)})")
        found += below
    return found


def _expanded(word: str) -> list[str]:
    if word.startswith("@") and not Path(word).exists():
        return [path for line in _lines(Path(word[1:]).expanduser()) for path in _expanded(line)]
    if is_url(word):
        return _fitting(Url(word)) if glob.has_magic(word) else [word]
    if not glob.has_magic(word) or Path(word).exists():
        return [word]
    fitting = sorted(glob.glob(word, recursive=True))  # noqa: PTH207 - Path.glob refuses absolute patterns
    if not fitting:
        raise UsageError(f"{word}: nothing fits this pattern")
    return fitting


def _fitting(pattern: Url) -> list[str]:
    """Return the remote objects that match a pattern: ** is any number of folders, * and ? stay in one."""
    from locfuse.formats.container.remote_objects import below

    wanted = re.compile(_regex(pattern.key))
    fixed = re.split(r"[*?\[]", pattern.key)[0].rpartition("/")[0]
    found = below(pattern.at(f"{fixed}/" if fixed else ""))
    if not (fitting := [str(one) for one in found if wanted.fullmatch(one.key)]):
        raise UsageError(f"{pattern}: nothing fits this pattern")
    return fitting


def _regex(pattern: str) -> str:
    """Return a shell pattern as a regular expression."""
    whole = {"**/": "(?:.*/)?", "**": ".*", "*": "[^/]*", "?": "[^/]"}
    parts = re.split(r"(\*\*/|\*\*|\*|\?|\[[^\]]*\])", pattern)
    some = {p: fnmatch.translate(p).removeprefix("(?s:")[:-3] for p in parts if p.startswith("[")}  # "[!a-c]"
    return "".join((whole | some).get(p) or re.escape(p) for p in parts)


def _objects(folder: Url) -> list[str]:
    """Return every log file below a remote folder, sorted by key; each part of a recording by itself."""
    from locfuse.formats.container.remote_objects import below

    return [str(found) for found in below(folder) if is_log(found.name)]


def is_log(name: str) -> bool:
    """Return whether a file is a log, by the ending of its name."""
    return any(Path(name).match(ending) for ending in ENDINGS)


def _lines(file: Path) -> list[str]:
    """Return the lines of a list of logs, without empty lines and comment lines (#)."""
    try:
        lines = read_small(file, MAX_LIST_BYTES).decode().splitlines()
    except UnicodeDecodeError:
        raise LocfuseError(f"@{file}: not a text in UTF-8; write one log on each line") from None
    named = [line.strip() for line in lines if line.strip() and not line.lstrip().startswith("#")]
    if not named:
        raise UsageError(f"@{file}: it names no log; write one on each line")
    if nested := [line for line in named if line.startswith("@")]:
        raise UsageError(f"@{file}: {nested[0]}: a list in a list is not read")
    return named


def _below(folder: Path) -> Iterator[str]:
    """Yield every log below a folder, sorted by path; folders with results of locfuse are skipped."""
    for here, folders, names in os.walk(folder):
        folders.sort()
        results = bool(set(RESULTS) & set(names))  # a folder of results: its logs are exports
        if results or METADATA_FILE in names:
            folders.clear()
            yield from [] if results else [here]
            continue
        yield from (str(Path(here) / name) for name in sorted(names) if is_log(name))


def result_file(word: str) -> Path | None:
    """Return the report of a finished result, named by its folder or its report; None for any other path."""
    if is_url(word):
        return None
    path = Path(word)
    if path.name in REPORTS and path.is_file():
        return path
    return next((path / name for name in REPORTS if (path / name).is_file()), None)


def results_of(words: Sequence[str]) -> list[Path] | None:
    """Return the reports if every path is a finished result, else None.

    None for a single path: one result cannot be compared. Raises UsageError for a mix of logs and results.
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
    """Return the logs of the command line as lists of parts: NAME_0.mcap, NAME_1.mcap of one folder are one log.

    Parts follow each other in time; recordings that overlap are separate logs. A file given twice counts once: two
    copies of a drive are not two samples.
    """
    groups: dict[object, list[str]] = {}
    for word in _once(words):
        at = place(word)
        key: object = word
        part = PART_NAME_PATTERN.fullmatch(at.name)
        if part and (isinstance(at, Url) or at.is_file()):
            key = at.parent if isinstance(at, Url) else at.resolve().parent, part["name"]
        groups.setdefault(key, []).append(word)
    return [log for parts in groups.values() for log in _split(parts)]


def named(logs: Sequence[Sequence[str]]) -> dict[str, Sequence[str]]:
    """Return the logs by the names of their result folders; equal names are numbered."""
    found: dict[str, Sequence[str]] = {}
    numbers: dict[str, int] = {}
    for parts in logs:
        try:
            name = stem = log_name(find_log(parts))
        except UsageError:  # raised again when the log is opened
            name = stem = writable(Path(parts[0]).stem) or "log"
        while name in found:
            numbers[stem] = numbers.get(stem, 1) + 1
            name = f"{stem}_{numbers[stem]}"
        found[name] = parts
    return found


def _once(words: Sequence[str]) -> list[str]:
    """Remove repeated files, and a metadata.yaml given with files of its folder (as in `bag/*`)."""
    first: dict[object, str] = {}
    for word in words:
        here = not is_url(word) and Path(word).exists()
        first.setdefault(Path(word).resolve() if here else word, word)
    parts = {path.parent for path in first if isinstance(path, Path) and path.name != METADATA_FILE}
    bags = {p for p in first if isinstance(p, Path) and p.name == METADATA_FILE and p.parent in parts}
    return [w for p, w in first.items() if p not in bags]


def _split(parts: list[str]) -> list[list[str]]:
    """Return the parts as one log, or as separate logs if they overlap in time."""
    if len(parts) < 2:
        return [parts]
    try:
        spans = sorted(span for part in parts if (span := open_log([place(part)]).time_span_ns) is not None)
    except LocfuseError:  # raised again when that log is opened
        return [[part] for part in parts]
    apart = all(b[0] > a[1] - OVERLAP_NS for a, b in pairwise(spans))
    return [parts] if apart else [[part] for part in parts]
