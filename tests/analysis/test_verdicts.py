"""What pairs of configurations add to a verdict: a lower rate, and sensors beside which one harms."""

from __future__ import annotations

from locfuse.cli.analysis.verdicts import add_pairs

SETS: dict[str, tuple[str, ...]] = {
    "odometry": (),
    "compass": ("compass",),
    "camera": ("camera",),
    "lrf": ("lrf",),
    "compass+camera": ("compass", "camera"),
    "all": ("compass", "camera", "lrf"),
}
ERRORS = {"odometry": 0.5, "compass": 0.3, "camera": 0.064, "lrf": 0.004, "compass+camera": 0.12, "lrf@2Hz": 0.008}


def test_a_lower_rate_and_a_pair_in_which_one_harms_are_said_in_figures() -> None:
    found = {s: {"verdict": "helps", "words": "Why."} for s in ("compass", "camera", "lrf")}
    add_pairs(found, SETS, {"lrf@2Hz": ("lrf",)}, ERRORS, by_truth=True)
    words = {s: v["words"].removeprefix("Why.").strip() for s, v in found.items()}
    assert words["camera"] == ""
    assert words["compass"] == "Beside camera: 64 mm -> 0.12 m (1.9x worse)."
    assert words["lrf"] == "lrf@2Hz: 4 mm -> 8 mm (2.0x worse)."


def test_without_errors_nothing_is_added() -> None:
    found = {"lrf": {"verdict": "no verdict", "words": ""}}
    add_pairs(found, SETS, {"lrf@2Hz": ("lrf",)}, dict.fromkeys(ERRORS), by_truth=True)
    assert found == {"lrf": {"verdict": "no verdict", "words": ""}}
