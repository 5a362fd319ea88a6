"""The table of `benchmarks.consistency`: figures now, those of version 0.1, the goal, and whether it is met."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

from .consistency_cases import Case
from .consistency_figures import Means

KEPT = 1.05  # a position that is to be no worse may be this many times larger: chance
COLUMNS = ("ANEES", "position [mm]", "aligned [mm]", "inside 3 sigma", "walls")
HEAD = "| case | " + " | ".join(f"{c} | 0.1 | goal" for c in COLUMNS) + " | met | time |\n" + "|---" * 18 + "|"
SHOW: tuple[Callable[[Means], str], ...] = (
    lambda m: f"{m.anees:.3g} ({m.anees_worst:.3g})",
    lambda m: f"{m.position:.1f}",
    lambda m: f"{m.aligned:.1f} ({m.aligned_worst:.1f})",
    lambda m: f"{100 * m.inside:.1f} %",
    lambda m: f"{m.walls:.2f}",
)


class Wanted(NamedTuple):
    """One figure's goal in words, and whether it is met."""

    words: str
    met: bool


NOTHING = Wanted("", True)


def row(case: Case, found: Mapping[str, Means], before: Means | None, seconds: float) -> str:
    """Return the line of one case that took `seconds` [s]."""
    now = found[case.name]
    goals = wanted(case, found, before)
    cells = [case.name]
    for show, goal in zip(SHOW, goals, strict=True):
        cells += [show(now), "" if before is None else show(before), goal.words]
    if case.goal.walls is None:
        cells[-3:] = ["", "", ""]
    met = "yes" if all(goal.met for goal in goals) else "no"
    return "| " + " | ".join((*cells, met, f"{seconds:.0f} s")) + " |"


def wanted(case: Case, found: Mapping[str, Means], before: Means | None) -> tuple[Wanted, ...]:
    """Return the goals of a case, in the order of the columns."""
    now, goal = found[case.name], case.goal
    low, high = goal.anees or (0.0, math.inf)
    anees = NOTHING if goal.anees is None else Wanted(f"{low:g}-{high:g}", low <= now.anees <= high)
    limit = before.position * KEPT if goal.position_kept and before is not None else goal.position
    return (
        anees,
        at_most(now.position, limit),
        at_most(now.aligned, aligned_limit(case, found)),
        at_least(now.inside, goal.inside, "{:.0%}"),
        at_least(now.walls, goal.walls, "{:g}"),
    )


def aligned_limit(case: Case, found: Mapping[str, Means]) -> float | None:
    """Return the largest aligned error [mm]; that of another case where the goal names one that was run."""
    if case.goal.aligned_as is None:
        return case.goal.aligned
    other, ratio = case.goal.aligned_as
    return found[other].aligned * ratio if other in found else None


def at_most(value: float, limit: float | None) -> Wanted:
    """Return the goal that a figure is at most `limit`."""
    return NOTHING if limit is None else Wanted(f"≤ {limit:.3g}", value <= limit)


def at_least(value: float, limit: float | None, form: str) -> Wanted:
    """Return the goal that a figure is at least `limit`."""
    return NOTHING if limit is None else Wanted(f"≥ {form.format(limit)}", value >= limit)
