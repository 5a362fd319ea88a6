"""The columns of the comparison, the same in Markdown, HTML, CSV and LaTeX: figure, heading, how it is written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

LARGE = 1e5


class Column(NamedTuple):
    """One figure of a configuration."""

    title: str
    key: str  # in report.json
    form: str  # str.format of the value
    unit: str = ""
    main: bool = True  # shown on the page's first table


COLUMNS = (
    Column("position rmse", "position_rmse_m", "{:.4f}", "m"),
    Column("median", "position_median_m", "{:.4f}", "m", main=False),
    Column("max", "position_max_m", "{:.4f}", "m"),
    Column("final", "final_position_error_m", "{:.4f}", "m"),
    Column("along rmse", "along_rmse_m", "{:.4f}", "m", main=False),
    Column("cross rmse", "cross_rmse_m", "{:.4f}", "m", main=False),
    Column("heading rmse", "heading_rmse_deg", "{:.3f}", "°"),
    Column("drift /1 m", "drift_1m", "{:.2%}", main=False),
    Column("drift /5 m", "drift_5m", "{:.2%}"),
    Column("drift /10 m", "drift_10m", "{:.2%}", main=False),
    Column("ANEES", "anees", "{:.2f}"),
)
WITHOUT_TRUTH = (
    Column("distance", "distance_m", "{:.2f}", "m"),
    Column("duration", "duration_s", "{:.1f}", "s"),
)


def columns_of(configurations: Mapping[str, Mapping[str, Any]], main: bool = False) -> Sequence[Column]:
    """Return the columns that hold anything; without truth what is left."""
    found = [
        c
        for c in COLUMNS
        if (c.main or not main) and any(v.get(c.key) is not None for v in configurations.values())
    ]
    return found or WITHOUT_TRUTH


def cell(column: Column, value: float | None, missing: str = "-") -> str:
    """Return a figure as text without its unit."""
    return missing if value is None else written(value, column.form)


def written(value: float | str, form: str) -> str:
    """Format a figure; powers of ten where it is too large to be read (the ANEES of the printed filter)."""
    return f"{value:.1e}" if isinstance(value, float) and abs(value) >= LARGE else form.format(value)
