"""The words of a report, for a reader who meets them for the first time."""

from __future__ import annotations

GLOSSARY = {
    "odometry": "The pose from the wheels alone. It starts right and drifts: every error of a turn stays.",
    "all": "Every sensor of the log in one filter.",
    "rmse": "Root mean square error: the size of a typical error, in which large errors count more.",
    "truth": "The reference poses that the log carries. All error figures are estimate minus truth.",
    "drift": "How much the error grows over a stretch of the given length, as a share of that length.",
    "along, left of the way": "The error split into its part ahead along the path and its part to the left.",
    "sigma": "The standard deviation that the filter claims for itself. Almost all errors stay within three.",
    "innovation": "What a sensor measured minus what the filter expected of it.",
    "gate": "The test that refuses a measurement too far from what was expected: an outlier.",
    "ambiguous": "A measured line that could be either of two walls. It is not used.",
    "NEES, ANEES": "Squared error over the variance that the filter claims; ANEES is its mean. One is right, "
    "above one the filter is overconfident, below it is too careful.",
    "NIS": "The same of innovations. It needs no truth, and being near one proves nothing by itself.",
    "credit": "The effect of a sensor on the error, averaged over every order in which the sensors can be added.",
    "smoothed": "An estimate that uses the whole drive for every instant, so also what came later.",
    "aligned": "The estimate was moved onto the truth before it was judged: its shape counts, its place does not.",
}
