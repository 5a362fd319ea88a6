"""Wrapping of angles to [-pi, pi)."""

from __future__ import annotations

try:
    import cython
except ImportError:  # Cython is only needed to compile
    from . import uncompiled as cython
if not cython.compiled:
    from math import pi

    from .uncompiled import floor


def wrapped(angle: float) -> float:
    """Return an angle wrapped to [-pi, pi); NaN stays NaN."""
    return (angle + pi) - 2.0 * pi * floor((angle + pi) / (2.0 * pi)) - pi
