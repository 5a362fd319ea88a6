"""The words that name many logs: lists of them in a file, patterns, and folders with logs somewhere below."""

from __future__ import annotations

import fnmatch
import glob
import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from locfuse.formats.container.url import Url, is_url
from locfuse.formats.inputs import read_small
from locfuse.formats.logs.files import ENDINGS
from locfuse.formats.whole_files import RESULTS
from locfuse.fusion.data import LocfuseError, UsageError

MAX_LIST_BYTES = 64 * 1024 * 1024  # of a list of logs: half a million paths


def expanded(words: Sequence[str], each: Sequence[str] = ()) -> list[str]:
    """Return one word per log or part of a log: @FILE names those in its lines, a pattern all files that fit it.

    Of the folders in `each` every log below is named; a rosbag2 folder is one. Raises UsageError for a pattern
    that nothing fits and for a folder without logs, LocfuseError for a list that cannot be read.
    """
    found = [path for word in words for path in _expanded(word)]
    for folder in each:
        below = list(_objects(Url(folder)) if is_url(folder) else _below(Path(folder)))
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
    fitting = sorted(glob.glob(word, recursive=True))  # noqa: PTH207 - of an absolute pattern too
    if not fitting:
        raise UsageError(f"{word}: nothing fits this pattern")
    return fitting


def _fitting(pattern: Url) -> list[str]:
    """Return the objects that fit a pattern: ** is any number of folders, * and ? stay within one."""
    from locfuse.formats.container.remote_objects import below

    fixed = re.split(r"[*?\[]", pattern.key)[0].rpartition("/")[0]
    wanted = re.compile(_regex(pattern.key))
    found = below(pattern.at(f"{fixed}/" if fixed else ""))
    if not (fitting := [str(one) for one in found if wanted.fullmatch(one.key)]):
        raise UsageError(f"{pattern}: nothing fits this pattern")
    return fitting


def _regex(pattern: str) -> str:
    """Return a pattern of the shell as a regular expression."""
    whole = {"**/": "(?:.*/)?", "**": ".*", "*": "[^/]*", "?": "[^/]"}
    parts = re.split(r"(\*\*/|\*\*|\*|\?|\[[^\]]*\])", pattern)
    return "".join(_characters(p) if p.startswith("[") else whole.get(p) or re.escape(p) for p in parts)


def _characters(word: str) -> str:
    """Return "[abc]", "[a-c]" or "[!abc]" of the shell as a regular expression, as fnmatch reads it."""
    return fnmatch.translate(word).removeprefix("(?s:")[:-3]  # without the marks of a whole name


def _objects(folder: Url) -> Iterator[str]:
    """Yield every log below a folder of a store, by key; the parts of a recording one by one."""
    from locfuse.formats.container.remote_objects import below

    for found in below(folder):
        if any(Path(found.name).match(ending) for ending in ENDINGS):
            yield str(found)


def _lines(file: Path) -> list[str]:
    """Return the lines of a list that name something; # begins a comment line."""
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
    """Yield every log below a folder in the order of paths; results of locfuse are none."""
    for place, folders, names in os.walk(folder):
        folders.sort()
        if set(RESULTS) & set(names):  # what it exported lies there, and a folder for each log
            folders.clear()
            continue
        if "metadata.yaml" in names:
            yield place
            folders.clear()
            continue
        for name in sorted(names):
            if any(Path(name).match(ending) for ending in ENDINGS):
                yield str(Path(place) / name)
