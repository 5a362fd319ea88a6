"""Ticks of an axis with labels: steps of 1, 2, 5; decades on logarithmic axes."""

from __future__ import annotations

import math


def linear(low: float, high: float, most: int = 6) -> list[tuple[float, str]]:
    """Return ticks (value, label) within [low, high]: about `most`, but at least two, which show the scale."""
    step = nice_step((high - low) / max(1, most))
    while _count(low, high, step) > most and _count(low, high, nice_step(1.5 * step)) >= 3:
        step = nice_step(1.5 * step)
    while _count(low, high, step) < 2:
        step = nice_step(step / 2.5)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    return [(k * step, _plain(k * step, decimals)) for k in range(first, last + 1)]


def of(low: float, high: float, log: bool, most: int = 6) -> list[tuple[float, str]]:
    """Return ticks (value, label) of a linear or a logarithmic axis."""
    return logarithmic(low, high, most) if log else linear(low, high, most)


def _count(low: float, high: float, step: float) -> int:
    return math.floor(high / step + 1e-9) - math.ceil(low / step - 1e-9) + 1


def nice_step(least: float) -> float:
    """Return the smallest number of the form 1, 2 or 5 times a power of ten that is at least `least`."""
    if least <= 0.0 or not math.isfinite(least):
        return 1.0
    power = 10.0 ** math.floor(math.log10(least))
    return next((m * power for m in (1.0, 2.0, 5.0) if m * power >= least * (1 - 1e-9)), 10.0 * power)


def logarithmic(low: float, high: float, most: int = 6) -> list[tuple[float, str]]:
    """Return ticks (value, label) at powers of ten in [low, high], in a small range also at 2 and 5."""
    first, last = math.ceil(math.log10(low) - 1e-9), math.floor(math.log10(high) + 1e-9)
    if last - first < 1:
        steps = [m * 10.0**p for p in range(first - 1, last + 2) for m in (1.0, 2.0, 5.0)]
        return [(s, _compact(s)) for s in steps if low <= s <= high]
    every = math.ceil((last - first + 1) / most)
    return [(10.0**p, _compact(10.0**p)) for p in range(first, last + 1, every)]


def _plain(value: float, decimals: int) -> str:
    text = f"{value:.{decimals}f}"
    return text.replace("-", "−") if float(text) else text.replace("-", "")


def _compact(value: float) -> str:
    power = str(round(math.log10(value))).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return f"{value:g}" if 1e-4 <= value < 1e5 else f"10{power}"
