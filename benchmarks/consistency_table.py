"""The table of `benchmarks.consistency`: figures now, those of version 0.1, the goal, and whether it is met."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

from .consistency_cases import Case
from .consistency_figures import Means

KEPT = 1.05  # a position that is to be no worse may be this many times larger: chance
FRAMED = ", in its frame {0.in_frame:.1f}"
COLUMNS = ("ANEES", "position [mm]", "aligned [mm]", "inside 3 sigma", "walls")
HEAD = "| case | " + " | ".join(f"{c} | 0.1 | goal" for c in COLUMNS) + " | met | time |\n" + "|---" * 18 + "|"
SHOW: tuple[Callable[[Means], str], ...] = (
    lambda m: f"{m.anees:.3g} ({m.anees_worst:.3g})",
    lambda m: f"{m.position:.1f}",
    lambda m: f"{m.aligned:.1f} ({m.aligned_worst:.1f})" + ("" if math.isnan(m.in_frame) else FRAMED.format(m)),
    lambda m: f"{100 * m.inside:.1f} %",
    lambda m: f"{m.walls:.2f}",
)


class Wanted(NamedTuple):
    """One figure's goal in words, and whether it is met."""

    words: str
    met: bool


NOTHING = Wanted("", True)


def row(
    case: Case, found: Mapping[str, Means], before: Means | None, seconds: float, same: Means | None = None
) -> str:
    """Return the line of one case that took `seconds` [s]; `same` are the drives that are `before`'s too."""
    now = found[case.name]
    goals = wanted(case, found, before, same or now)
    cells = [case.name]
    for show, goal in zip(SHOW, goals, strict=True):
        cells += [show(now), "" if before is None else show(before), goal.words]
    if case.goal.walls is None:
        cells[-3:] = ["", "", ""]
    met = "yes" if all(goal.met for goal in goals) else "no"
    return "| " + " | ".join((*cells, met, f"{seconds:.0f} s")) + " |"


def wanted(case: Case, found: Mapping[str, Means], before: Means | None, same: Means) -> tuple[Wanted, ...]:
    """Return the goals of a case, in the order of the columns."""
    now, goal = found[case.name], case.goal
    low, high = goal.anees or (0.0, math.inf)
    anees = NOTHING if goal.anees is None else Wanted(f"{low:g}-{high:.3g}", low <= now.anees <= high)
    return (
        anees,
        position(case, found, before, same),
        shape(case, found),
        at_least(now.inside, goal.inside, "{:.0%}"),
        at_least(now.walls, goal.walls, "{:g}"),
    )


def position(case: Case, found: Mapping[str, Means], before: Means | None, same: Means) -> Wanted:
    """Return the goal of the position: that of 0.1 on the same drives, or of another case that was run."""
    if case.goal.position_kept and before is not None:
        limit, on = before.position * KEPT, "" if same is found[case.name] else f" on {same.drives}"
        return Wanted(f"≤ {limit:.3g}{on}", same.position <= limit)
    other, ratio = case.goal.position_as or ("", 0.0)
    return at_most(found[case.name].position, found[other].position * ratio if other in found else None)


def shape(case: Case, found: Mapping[str, Means]) -> Wanted:
    """Return the goal of the aligned error [mm], or of the path's within its frame; others' where one is named."""
    now, goal = found[case.name], case.goal
    value, named = (now.aligned, goal.aligned_as) if goal.in_frame is None else (now.in_frame, goal.in_frame)
    other, ratio = named or ("", 0.0)
    return at_most(value, found[other].aligned * ratio if other in found else goal.aligned)


def at_most(value: float, limit: float | None) -> Wanted:
    """Return the goal that a figure is at most `limit`."""
    return NOTHING if limit is None else Wanted(f"≤ {limit:.3g}", value <= limit)


def at_least(value: float, limit: float | None, form: str) -> Wanted:
    """Return the goal that a figure is at least `limit`."""
    return NOTHING if limit is None else Wanted(f"≥ {form.format(limit)}", value >= limit)
