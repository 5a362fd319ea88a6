"""Which version of a distribution is installed: by the name of its folder.

importlib.metadata tells the same, but takes longer to import than a short log takes to read.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ENDING = ".dist-info"  # of folders named "distribution-version.dist-info"


def installed(distribution: str) -> str | None:
    """Return the version of a distribution, None where there is none of that name."""
    found = _by_folder().get(_normal(distribution))
    return _asked(distribution) if found is None else found


def own() -> str:
    """Return the version of locfuse."""
    return installed("locfuse") or "unknown"


def _asked(distribution: str) -> str | None:
    """Return the version as Python's own search says: it also finds what is not in a folder of its own."""
    from importlib import metadata

    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return None


@cache
def _by_folder() -> dict[str, str]:
    """Return the versions of all distributions by name; of two the one that is imported."""
    found: dict[str, str] = {}
    for name in _folders():
        distribution, _, of = name.removesuffix(ENDING).partition("-")
        found.setdefault(_normal(distribution), of)
    return found


def _folders() -> Iterator[str]:
    for place in sys.path:
        try:
            yield from (folder.name for folder in Path(place).glob(f"*{ENDING}"))
        except OSError:  # a place may be a zip file, or not exist
            continue


def _normal(distribution: str) -> str:
    return re.sub(r"[-_.]+", "_", distribution).lower()
