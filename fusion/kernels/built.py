"""Test whether the kernels of this installation are compiled."""

from __future__ import annotations

from functools import cache
from importlib.machinery import EXTENSION_SUFFIXES
from importlib.util import find_spec
from pathlib import Path

COMPILED, INTERPRETED = "compiled", "not compiled: slower"


@cache
def how() -> str:
    """Return COMPILED, or INTERPRETED if any kernel is not compiled."""
    names = [path.stem for path in Path(__file__).parent.glob("*.pxd")]
    origins = [spec.origin for name in names if (spec := find_spec(f"{__package__}.{name}"))]
    return COMPILED if all(str(origin).endswith(tuple(EXTENSION_SUFFIXES)) for origin in origins) else INTERPRETED
