"""What evaluating adds to a report: findings, fixes, and the headline that answers first."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from locfuse.formats.report import json_report

from .evaluator import Advised
from .headline import headline
from .validity import add_validity
from .values import add_findings


def complete(
    report: dict[str, Any],
    advised: Advised | None,
    start_error_m: float | None = None,
    foreign: Collection[str] = (),
) -> None:
    """Add findings, validity and headline to a finished report; None: the log was not evaluated.

    `start_error_m` is how far the truth starts from where the drive does, None where somebody stated the start.
    Rows that are `foreign` estimates say nothing of which sensors to keep.
    """
    add_findings(report, advised)
    add_validity(report, advised, start_error_m)
    sets = {
        name: tuple(values["sensors"])
        for name, values in report["configurations"].items()
        if not values.get("smoothed") and not values.get("rates_hz") and name not in foreign
    }
    report["headline"] = headline(report, sets)
    report.update(json_report.plain(report))
