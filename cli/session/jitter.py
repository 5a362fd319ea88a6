"""Jitter (`--jitter N`): each configuration is fused N more times, each time on a slightly changed drive.

A difference of two figures is chance if it is smaller than their range over these runs. A verdict that changes its
direction in any run becomes "no effect seen".
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from msgspec.structs import replace

from locfuse.cli.analysis.compare import Compared, compare_log
from locfuse.cli.analysis.settings import Asked, Progress, silent
from locfuse.cli.analysis.verdicts import verdicts
from locfuse.fusion.measure import DROPPED_SHARE, MOVED_S, jittered

DIRECTIONS = {"helps": 1, "seems to help": 1, "hurts": -1, "seems to hurt": -1}
NO_EFFECT = "no effect seen"
JITTER_NOTE = (
    f"The drive was fused {{runs}} times more with stamps moved by up to {1e6 * MOVED_S:g} µs and "
    f"{DROPPED_SHARE:.0%} of the readings dropped. Differences between configurations that are smaller than these "
    "ranges mean nothing."
)


class Jittered(NamedTuple):
    """Figures, path changes and verdicts of one run on a jittered drive."""

    figures: Mapping[str, Mapping[str, float | None]]  # result -> figure -> value
    away: Mapping[str, float]  # result -> largest distance of its path to that of the original drive [m]
    verdicts: Mapping[str, str]  # sensor -> verdict


def add_jitter(report: dict[str, Any], compared: Compared, asked: Asked, progress: Progress) -> None:
    """Fuse and judge all configurations on jittered drives, and add the ranges of the figures to the report."""
    loaded, plain = compared.loaded, {e.name: e for e in compared.estimates}
    once, found = replace(asked, reference=False, audits=False), []
    for seed in range(asked.jitter):
        progress(f"jitter {seed + 1} of {asked.jitter}")
        other = replace(loaded, drive=jittered(loaded.drive, loaded.robot, seed))
        run = compare_log(other, compared.configurations, once, silent)
        away = {}
        for e in run.estimates:
            own = plain[e.name]
            x, y = (np.interp(own.t, e.t, e.pose[:, k]) - own.pose[:, k] for k in (0, 1))
            away[e.name] = float(np.hypot(x, y).max())
        words = {s: v["verdict"] for s, v in verdicts(run.credit, run.scores, run.sets).items()}
        found.append(Jittered({e.name: e.figures for e in run.evaluations}, away, words))
    add_ranges(report, found)


def add_ranges(report: dict[str, Any], found: Sequence[Jittered]) -> None:
    """Add each figure's range over all runs to the report; a verdict that changes becomes "no effect seen"."""
    if not found:
        return
    report["jitter"] = {"runs": len(found), "words": JITTER_NOTE.format(runs=len(found))}
    for name, values in report["configurations"].items():
        if name in found[0].figures:
            values["jitter"] = _ranges(values, [run.figures[name] for run in found])
            values["jitter"]["path_moved_m"] = max(run.away[name] for run in found)
    for sensor, own in report.get("verdicts", {}).items():
        seen = Counter(run.verdicts[sensor] for run in found if sensor in run.verdicts)
        if len({DIRECTIONS.get(word, 0) for word in (own["verdict"], *seen)}) > 1:
            counted = ", ".join(f"{w} {n}" for w, n in sorted(seen.items(), key=lambda pair: (-pair[1], pair[0])))
            words = f"The verdict is chance: it changes under jitter ({counted})."
            recorded = "" if own["verdict"] == NO_EFFECT else f" As recorded: {own['verdict']}."
            own.update(verdict=NO_EFFECT, words=f"{words}{recorded} {own['words']}")


def _ranges(own: Mapping[str, Any], runs: Sequence[Mapping[str, float | None]]) -> dict[str, Any]:
    """Return [smallest, largest] value of each figure that exists in all runs."""
    out = {}
    for key in runs[0]:
        values = [own.get(key), *(run.get(key) for run in runs)]
        numbers = [v for v in values if v is not None and math.isfinite(v)]
        if len(numbers) == len(values):
            out[key] = [min(numbers), max(numbers)]
    return out
