"""Replacements for the module `cython` and C's math functions, for interpreted kernels.

C's functions return NaN or Inf where Python's raise.
"""

from __future__ import annotations

import math

compiled = False  # as `cython.compiled`


def cos(angle: float) -> float:
    """Return the cosine of an angle [rad]; NaN for an infinite angle."""
    return math.cos(angle) if math.isfinite(angle) else math.nan


def floor(value: float) -> float:
    """Return the floor of a number as float; NaN and Inf stay."""
    return float(math.floor(value)) if math.isfinite(value) else value


def sin(angle: float) -> float:
    """Return the sine of an angle [rad]; NaN for an infinite angle."""
    return math.sin(angle) if math.isfinite(angle) else math.nan


def sqrt(value: float) -> float:
    """Return the square root; NaN for a negative number."""
    return math.sqrt(value) if value >= 0.0 else math.nan
