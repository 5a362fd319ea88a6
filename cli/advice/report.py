"""The evaluation's part of a report: findings, fixes, and the headline."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from locfuse.cli.analysis.refused_motion import STANDS
from locfuse.formats.report import json_report
from locfuse.fusion.checks.probes import MOUNT
from locfuse.fusion.checks.truth import Jumps
from locfuse.fusion.mount import OTHER_MOUNT

from .advised import Advised
from .headline import covariance, headline
from .validity import add_validity
from .values import add_findings


def complete(
    report: dict[str, Any],
    advised: Advised | None,
    start_error_m: float | None = None,
    foreign: Collection[str] = (),
    stands: bool = False,
    jumps: Jumps | None = None,
) -> None:
    """Add findings, validity and headline to a finished report; None: the log was not evaluated.

    `start_error_m` is how far the truth starts from where the drive does, None where somebody stated the start;
    `jumps` are those of the truth.
    Rows that are `foreign` estimates say nothing of which sensors to keep; of a robot that `stands` nothing does.
    """
    add_findings(report, advised)
    _leave_out_what_findings_say(report)
    add_validity(report, advised, start_error_m, jumps)
    sets = {
        name: tuple(values["sensors"])
        for name, values in report["configurations"].items()
        if not values.get("smoothed") and not values.get("rates_hz") and name not in foreign
    }
    words = f"{headline(report, sets)}{covariance(report, sets)}"
    report["headline"] = f"{STANDS[0].upper()}{STANDS[1:]}." if stands else words
    report.update(json_report.plain(report))


def _leave_out_what_findings_say(report: dict[str, Any]) -> None:
    """Remove the notes on a mount that a finding gives as a fix, to avoid two different numbers."""
    mounts = {f["role"] for f in report["findings"] or () if f["code"] == MOUNT and f["fixes"]}
    for values in report["configurations"].values():
        values["notes"] = [
            note for note in values["notes"] if not any(note.startswith(f"{s}: {OTHER_MOUNT}") for s in mounts)
        ]
