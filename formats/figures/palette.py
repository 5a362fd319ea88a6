"""One colour per configuration, the same in every figure and every report, apart for every kind of colour vision.

Chosen by search so that all pairs stay apart under protanopia, deuteranopia and tritanopia and each has a
contrast of 3 against its page (tests/figures/test_figures.py measures both). A sensor brings its own colour and
keeps it whatever else the log holds; sets of several sensors are dashed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from locfuse.fusion.data import VERDICTS, Colour

SMOOTHED = " smoothed"  # ends the name of a configuration that has seen the whole drive
PAGE = Colour("#ffffff", "#14171c")
ODOMETRY = Colour("#686a70", "#94979c")
ALL = Colour("#8a0a55", "#bf2f80")
TRUTH = Colour("#0d0f12", "#f4f5f7")
SETS = (  # of several sensors but not all: told apart by their dashes and names too
    Colour("#0b6e6e", "#58c6c6"),
    Colour("#6d4fc4", "#a58bf0"),
    Colour("#8c6a00", "#d2b13a"),
    Colour("#b0413e", "#f08a80"),
    Colour("#4d7a1f", "#9fce62"),
)
REFUSED = Colour("#a3123a", "#e0566f")
ROLES = {  # what is drawn besides configurations
    **dict.fromkeys(VERDICTS, REFUSED),
    "truth": TRUTH,
    "walls of the first scan": Colour("#9aa3af", "#667080"),
    "walls seen later": Colour("#cfc09f", "#6f6750"),
    "bounds": Colour("#8c94a0", "#6b7480"),
    "accepted": Colour("#c5cad3", "#47505d"),
    "new": Colour("#7f97e8", "#4a66b8"),
    "ambiguous": Colour("#e2b04a", "#b98a2c"),
    "unmatched": Colour("#c7843a", "#a8642a"),
    "lost": Colour("#3b3f46", "#b9bec7"),
    "disturbed": Colour("#6a1b6a", "#b06ab8"),
}


def colours(configurations: Sequence[str], sensors: Mapping[str, Colour]) -> dict[str, Colour]:
    """Return a colour for every configuration, by those of all sensors known to the product."""
    return {name: _colour(name, sensors) for name in configurations}


def dashed(configuration: str) -> bool:
    """Return whether a configuration is drawn dashed: sets that are not `all`, what-ifs, smoothed ones."""
    return "+" in configuration or "@" in configuration or configuration.endswith(SMOOTHED)


def _colour(name: str, sensors: Mapping[str, Colour]) -> Colour:
    name = name.removesuffix(SMOOTHED)
    if name in {"odometry", "all"}:
        return ODOMETRY if name == "odometry" else ALL
    members = [part.split("@")[0] for part in name.split("+")]
    if len(members) == 1 and members[0] in sensors:
        return sensors[members[0]]
    order = list(sensors)
    places = [order.index(m) if m in sensors else len(order) for m in members]
    return SETS[sum(2**p for p in places) % len(SETS)]
