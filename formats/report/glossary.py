"""Glossary of a report: shown at the end of report.html, and by `locfuse explain TERM`."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence

GLOSSARY: Mapping[str, str] = {
    "scan matching": "The estimate from the laser's scans alone, each matched with one before it: no wheels were "
    "recorded. A laser beside it sees the same scans once more.",
    "odometry": "The estimate from the wheels alone. It starts right and drifts: every error of a turn stays.",
    "all": "Every sensor of the log in one filter.",
    "truth": (
        "A reference trajectory in the log, from a tracker or a simulator. It judges estimates and corrects none. "
        "All error figures are estimate minus truth."
    ),
    "reference": (
        "In a log without truth, the solution of the whole drive by all its sensors, forward and backward, in the "
        "place of truth. It shares the wheels with every estimate, so it is no truth. A sensor is judged by one "
        "that was solved without it, where that one's sigma is at most a third of the error. *: its own sensors "
        "are in the reference, so the error is larger than shown. ?: the reference disagrees with the one of all "
        "sensors. docs/report.md"
    ),
    "rmse": (
        "Root mean square error: the usual distance between estimate and truth, in metres. Large errors count "
        "more."
    ),
    "max": "The largest distance between estimate and truth.",
    "final": "The distance between estimate and truth at the end of the drive.",
    "heading": "Root mean square error of the heading, in degrees.",
    "drift": (
        "How far the estimate is off after 5 m, given that it was right before: 4 % is 20 cm. Also for 1 and 10 m."
    ),
    "along, left of the way": "The error split into its part ahead along the path and its part to the left.",
    "sigma": "The standard deviation that the filter claims for itself. Almost all errors stay within three.",
    "innovation": "A reading minus what the filter predicted for it. Also called residual.",
    "gate": "The NIS above which a reading is rejected as an outlier.",
    "accepted": "Readings (of a laser: lines) that corrected the filter.",
    "rejected": "Readings that were compared with the prediction and not used, mostly by the gate.",
    "unusable, absent": "Readings that gave no measurement: a picture without the landmark, a scan without lines.",
    "ambiguous": "A measured line that could be either of two walls. It is not used.",
    "NEES, ANEES": (
        "Normalised estimation error squared: the squared error over the variance that the filter claims, per "
        "state; ANEES is its average. 1 is right. 4 means that errors are twice as large as claimed "
        "(overconfident), 0.25 half as large (underconfident). On one drive even a correct filter scatters: the "
        "report gives the range. docs/trust.md"
    ),
    "overconfident": "Errors are larger than the filter claims: ANEES is above its range.",
    "underconfident": "Errors are smaller than the filter claims: ANEES is below its range.",
    "NIS": (
        "Normalised innovation squared: how far a reading was from its prediction, squared, over the predicted "
        "variance, per number. 1 is right on average. Above 1 the noise is set too low, or a clock, a mount or a "
        "scale is wrong; below 1 the noise is set too high. It needs no truth, and it can be 1 although all is "
        "wrong."
    ),
    "lost": (
        "The share of the drive in which the filter did not know where the robot was. Above 10 % its figures are "
        "void."
    ),
    "void": (
        "A figure that would look like a result and is none: the filter was lost, or the truth starts elsewhere."
    ),
    "credit": (
        "The effect of a sensor on the error, averaged over every order of adding the sensors (Shapley value)."
    ),
    "interval": (
        "Where the effect lies with 95 % confidence. It includes no effect if it reaches from smaller to larger."
    ),
    "prediction": (
        "Without truth: how well a configuration predicts the readings of sensors that it does not use, in nats "
        "per number compared with odometry. More is better; 0.1 is much."
    ),
    "nats": (
        "The unit of a natural logarithm: +0.69 nats means that what happened was predicted twice as likely."
    ),
    "finding": (
        "Something in the log or its settings that looks wrong, with the fix that was tried. docs/advice.md"
    ),
    "revisits agree": (
        "The share of a scan's points that lie on an earlier scan of the same place. It needs no truth. More is "
        "better; below 30 % the path is bad. docs/maps.md"
    ),
    "crispness": (
        "The number of 5 cm cells that the points of all scans hit, divided by the smallest number of the table. "
        "Fewer is better: walls are thin. Rows that differ by less than x 1.2 are equal."
    ),
    "smoothed": "An estimate that uses the whole drive for every instant, so also what came later.",
    "aligned": "The estimate was moved onto the truth before it was judged: its shape counts, its place does not.",
}


def explained(term: str) -> str | None:
    """Return the explanation of a term such as "anees" (upper or lower case); None for an unknown term."""
    wanted = term.strip().lower()
    by_lower = {name.lower(): words for name, words in GLOSSARY.items()}
    return next((words for name, words in by_lower.items() if wanted in {name, *_names(name)}), None)


def similar(term: str) -> Sequence[str]:
    """Return glossary terms with similar spelling; all terms if none is similar."""
    known = {name.lower(): name for names in GLOSSARY for name in _names(names)}
    return [known[name] for name in difflib.get_close_matches(term.lower(), known, n=3)] or [*known.values()]


def _names(entry: str) -> list[str]:
    return entry.split(", ")
