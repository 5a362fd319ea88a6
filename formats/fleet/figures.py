"""Figures over a fleet: how errors are distributed over the logs, and how they change from day to day."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import date
from typing import Any

import numpy as np

from locfuse.formats.figures.panels import Band, Curve, Dots, Panel, Section
from locfuse.formats.report.tables import RMSE
from locfuse.fusion.data import Array

from .entry import Entry

POINTS = 101  # of a distribution's curve
MAX_CURVES = 12  # configurations in one figure: the best by median
FEW_LOGS = 3  # below, a distribution is the table's numbers


def sections(summary: Mapping[str, Any], entries: Sequence[Entry]) -> list[Section]:
    """Return the figures that these logs allow."""
    errors = {
        name: np.array([v for e in entries if (v := _error(e, name)) is not None])
        for name in summary["configurations"]
    }
    known = {name: np.sort(v[v > 0.0]) for name, v in errors.items() if (v > 0.0).any()}
    best = dict(sorted(known.items(), key=lambda pair: float(np.median(pair[1])))[:MAX_CURVES])
    found = [_distribution(best)] if any(len(v) >= FEW_LOGS for v in best.values()) else []
    return [*found, *_trend(summary["best"], entries)]


def _error(entry: Entry, name: str) -> float | None:
    value: float | None = entry.report.get("configurations", {}).get(name, {}).get(RMSE.key)
    return value


def _distribution(errors: Mapping[str, Array]) -> Section:
    """Return the quantiles of the error: at 50 the median, at 90 what nine of ten logs stay below."""
    share = np.linspace(0.0, 100.0, POINTS)
    marks = tuple(Curve(name, share, np.percentile(v, share)) for name, v in errors.items())
    words = "; ".join(f"{name}: median {np.median(v):.4g} m, worst {v[-1]:.4g} m" for name, v in errors.items())
    panel = Panel(
        "distribution",
        "Position rmse",
        "m",
        "% of the logs stay below",
        marks,
        words,
        log=True,
        x_range=(0.0, 100.0),
    )
    text = "At 50 the median log, at 90 what nine of ten logs stay below, at 100 the worst."
    return Section("distribution", "How errors are distributed over the logs", text, (panel,), columns=1)


def _trend(best: str | None, entries: Sequence[Entry]) -> list[Section]:
    """Return the error of the best configuration by day, where the logs are of several days."""
    days: dict[date, list[float]] = {}
    for entry in entries:
        value = _error(entry, best) if best else None
        start = entry.report.get("input", {}).get("start")
        if value is not None and value > 0.0 and start:
            days.setdefault(date.fromisoformat(start[:10]), []).append(value)
    if best is None or len(days) < 2:
        return []
    first = min(days)
    x = np.array([(day - first).days for day in sorted(days)], float)
    low, middle, high = (
        np.array([np.percentile(days[day], share) for day in sorted(days)]) for share in (10.0, 50.0, 90.0)
    )
    marks = (Band(best, x, low, high), Curve(best, x, middle), Dots(best, x, middle))
    panel = Panel("trend", "Position rmse by day", "m", f"days since {first}", marks, "median by day", log=True)
    text = f"The median of {best} on each day; the band holds the logs between 10 and 90 %."
    return [Section("trend", "From day to day", text, (panel,), columns=1)]
