"""A sweep over settings: every combination of values is a cell, named by its settings."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from itertools import product
from math import prod

from locfuse.fusion.data import UsageError

MAX_CELLS = 1000
BETWEEN_VALUES = re.compile(r",(?![^\[{]*[\]}])")  # a comma that is not inside a list or a table
UNFIT_FOR_FOLDER = re.compile(r"[\s/\\]")  # cannot stand in the name of a folder


def parse(words: Sequence[str]) -> dict[str, list[str]]:
    """Return the words of --sweep by key: "lrf.x=0.1,0.2" is {"lrf.x": ["lrf.x=0.1", "lrf.x=0.2"]}."""
    found: dict[str, list[str]] = {}
    for word in words:
        key, equals, values = word.partition("=")
        if not equals or not key.strip() or not values.strip():
            raise UsageError(f'--sweep {word!r}: write it like "lrf.sigma_range=0.01,0.03,0.1"')
        if key.strip() in found:
            raise UsageError(f"--sweep {key.strip()} is given twice: name all its values in one")
        parts = [value.strip() for value in BETWEEN_VALUES.split(values)]
        found[key.strip()] = [f"{key.strip()}={value}" for value in parts if value]
    return found


def cells(sets: Mapping[str, Sequence[str]]) -> dict[str, tuple[str, ...]]:
    """Return the --set words of every combination by its name, which is these words joined by a blank.

    Raises UsageError for more than MAX_CELLS, and for a value that cannot be part of a folder's name.
    """
    for word in (word for words in sets.values() for word in words):
        if UNFIT_FOR_FOLDER.search(word):
            raise UsageError(f"--sweep {word!r}: a value with blanks or slashes cannot name a folder")
    count = prod(len(words) for words in sets.values())
    if count > MAX_CELLS:
        raise UsageError(f"--sweep: {count} combinations, more than {MAX_CELLS}; sweep fewer values")
    return {" ".join(combination): combination for combination in product(*sets.values())}
