"""The words of a report, explained: `locfuse explain TERM`, and the short line below a table."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence

TERMS: Mapping[str, str] = {
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
    "ANEES": (
        "Average normalised estimation error squared: the squared error over the variance that the filter "
        "claims, per state. 1 is right. 4 means that errors are twice as large as claimed (overconfident), "
        "0.25 half as large (underconfident). On one drive even a correct filter scatters: the report gives "
        "the range. docs/trust.md"
    ),
    "NIS": (
        "Normalised innovation squared: how far a reading was from its prediction, squared, over the "
        "predicted variance, per number. 1 is right on average. It needs no truth, and it can be 1 although "
        "everything is wrong."
    ),
    "innovation": "A reading minus what the filter predicted for it. Also called residual.",
    "gate": "The NIS above which a reading is rejected as an outlier.",
    "accepted": "Readings (of a laser: lines) that corrected the filter.",
    "rejected": "Readings that were compared with the prediction and refused, mostly by the gate.",
    "absent": "Readings that gave no measurement: a picture without the landmark, a scan without lines.",
    "lost": (
        "The share of the drive in which the filter did not know where the robot was. Above 10 % its figures "
        "are void."
    ),
    "void": (
        "A figure that would look like a result and is none: the filter was lost, or the truth starts elsewhere."
    ),
    "overconfident": "Errors are larger than the filter claims: ANEES is above its range.",
    "underconfident": "Errors are smaller than the filter claims: ANEES is below its range.",
    "credit": (
        "The effect of a sensor on the error, averaged over every order of adding the sensors (Shapley value)."
    ),
    "interval": (
        "Where the effect lies with 95 % confidence. It includes no effect if it reaches from smaller to larger."
    ),
    "prediction": (
        "Without truth: how well a configuration predicts the readings of sensors that it does not use, in "
        "nats per number compared with odometry. More is better; 0.1 is much."
    ),
    "nats": (
        "The unit of a natural logarithm: +0.69 nats means that what happened was predicted twice as likely."
    ),
    "odometry": "The estimate from the wheels alone.",
    "truth": (
        "A reference trajectory in the log, from a tracker or a simulator. It judges estimates and corrects none."
    ),
    "finding": (
        "Something in the log or its settings that looks wrong, with the fix that was tried. docs/advice.md"
    ),
}


def explained(term: str) -> str | None:
    """Return what a term means, whatever its case; None where it is not known."""
    by_lower = {name.lower(): words for name, words in TERMS.items()}
    return by_lower.get(term.strip().lower())


def similar(term: str) -> Sequence[str]:
    """Return known terms that are written like this one, else all of them."""
    return difflib.get_close_matches(term, TERMS, n=3) or list(TERMS)
