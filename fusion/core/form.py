"""Which form of the core runs: compiled ahead of time, or the same source interpreted.

The compiled form carries the fingerprint of the source it was made from. Where the source is another by now - an
editable install whose .py was changed - the source counts. LOCFUSE_CORE=python asks for the source.
"""

import importlib
import os
import warnings
import zlib
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

SOURCES = (
    "pieces",
    "walls",
    "fit",
    "curves",
    "lines",
    "places",
    "pairs",
    "match",
    "doubles",
    "filter",
    "nees",
    "tables",
    "intervals",
    "red",
    "rests",
    "scans",
    "singles",
    "bearings",
    "echoes",
    "fixes",
    "turns",
    "sightings",
    "poses",
    "twists",
    "coast",
)  # compiled as one unit: a file uses those before it
COMPILED = "compiled"  # the extension's name, beside the sources
VARIABLE = "LOCFUSE_CORE"
OUTDATED = "locfuse's compiled core is older than its source, which is interpreted now: install again"


class Form(NamedTuple):
    """What runs."""

    functions: ModuleType | None  # the compiled unit; None: the source is interpreted
    words: str  # "compiled", or "not compiled" and why


def fingerprint(folder: Path) -> int:
    """Return a checksum of the core's sources."""
    value = 0
    for name in SOURCES:
        for kind in (".py", ".pxd"):
            value = zlib.crc32((folder / name).with_suffix(kind).read_bytes(), value)
    return value


@cache
def form() -> Form:
    """Return which form runs in this process."""
    if os.environ.get(VARIABLE) == "python":
        return Form(None, f"not compiled: {VARIABLE}=python")
    try:
        unit = importlib.import_module(f"{__package__}.{COMPILED}")
    except ImportError:
        return Form(None, "not compiled")
    return checked(unit, Path(__file__).parent)


def checked(unit: ModuleType, folder: Path) -> Form:
    """Return the compiled unit, or the source where that has changed since."""
    if fingerprint(folder) == unit.SOURCE:
        return Form(unit, "compiled")
    warnings.warn(OUTDATED, stacklevel=2)
    return Form(None, "not compiled: its source has changed since, install again")
