"""The first line: what a reference may say of sensors, and what a fix that was found would give."""

from typing import Any

import pytest
from msgspec.structs import replace

from locfuse.cli.advice.report import Advised, add_findings, add_validity, covariance, headline, settled
from locfuse.formats.report.findings import in_one_unit, sentence
from locfuse.fusion.checks.finding import Finding
from locfuse.fusion.checks.tried import Advice
from locfuse.fusion.checks.turning import MIRROR

SETS = {"odometry": (), "compass": ("compass",), "lrf": ("lrf",), "all": ("compass", "lrf")}
LATE_LASER = {"odometry": 0.25, "compass": 0.033, "lrf": 0.058, "all": 0.055}


def of_errors(errors: dict[str, float], verdicts: dict[str, str] | None = None, **more: Any) -> dict[str, Any]:
    """A report with these position errors [m] by configuration and verdicts by sensor."""
    judged = {sensor: {"verdict": verdict} for sensor, verdict in (verdicts or {}).items()}
    rows = {name: {"position_rmse_m": error} for name, error in errors.items()}
    return {"configurations": rows, "verdicts": judged, **more}


@pytest.mark.parametrize(
    ("verdicts", "end"),
    [
        ({"lrf": "no verdict"}, "the laser (lrf) itself cannot be checked."),
        ({"lrf": "no verdict", "compass": "no verdict"}, "of the sensors nothing is sure."),
        ({"lrf": "no effect seen"}, "of the sensors nothing is sure."),
        ({"lrf": "helps", "compass": "no verdict"}, "the laser (lrf) helps."),
        ({"lrf": "helps", "compass": "hurts"}, "the laser (lrf) helps; the compass hurts."),
    ],
)
def test_a_reference_says_which_sensors_help_and_what_nobody_judges(verdicts: dict[str, str], end: str) -> None:
    found = headline(of_errors({"odometry": 0.052}, verdicts, reference={"sensors": ["lrf"]}), {"odometry": ()})
    assert found == f"Measured against a reference, not truth: odometry alone differs by 52 mm; {end}"


@pytest.mark.parametrize(
    ("after", "aligned", "end"),
    [
        (0.0035, False, "With the laser (lrf) and the fixes found it is 3.5 mm."),
        (0.0320, False, "before the fixes."),  # as good as the best without it
        (0.0035, True, "before the fixes."),  # of the path's shape: another figure
    ],
)
def test_a_sensor_that_is_good_once_its_fix_is_set_is_named(after: float, aligned: bool, end: str) -> None:
    """A laser 0.2 s late: without its fix one would keep the compass and sell the laser."""
    score = {"position_rmse_m": after, "aligned": aligned}
    tried = {"configuration": "lrf", "before": {"position_rmse_m": 0.058}, "after": score}
    findings = [{"fixes": ["lrf.time_offset=0"], "tried": tried}, {"fixes": [], "tried": None}]
    found = headline(of_errors(LATE_LASER, {"lrf": "hurts"}, findings=findings), SETS)
    assert found.startswith("Keep the compass: 33 mm. With all sensors it is 55 mm before the fixes.")
    assert found.endswith(end)


@pytest.mark.parametrize(
    ("compass", "camera", "end"),
    [
        ("hurts", "no effect seen", "the compass hurts."),
        ("seems to hurt", "hurts", "one of the compass and the camera hurts."),
        ("seems to help", "no effect seen", "leave the compass and the camera out."),
    ],
)
def test_hurts_is_said_only_of_a_sensor_whose_verdict_says_so(compass: str, camera: str, end: str) -> None:
    verdicts = {"lrf": "helps", "compass": compass, "camera": camera}
    report = of_errors({"odometry": 3.0, "lrf": 0.75, "all": 4.2}, verdicts)
    found = headline(report, {"odometry": (), "lrf": ("lrf",), "all": ("lrf", "compass", "camera")})
    assert found == f"Keep the laser (lrf): 0.75 m. With all sensors it is 4.20 m: {end}"


@pytest.mark.parametrize(
    ("smoothed", "end"), [(0.9, " Smoothed, the laser (lrf) does: 0.9 m."), (4.1, ""), (7.0, "")]
)
def test_where_only_smoothing_improves_on_the_wheels_it_is_named(smoothed: float, end: str) -> None:
    report = of_errors({"odometry": 4.28, "lrf": 6.5, "lrf-smoothed": smoothed})
    del report["verdicts"]
    found = headline(report, {"odometry": (), "lrf": ("lrf",)})
    assert found == f"No sensor improves on odometry: 4.28 m.{end}"


def test_no_sensor_is_said_to_hurt_by_an_error_that_the_fixes_halve() -> None:
    before, later = ({"configuration": "lrf", "after": {"position_rmse_m": e}} for e in (0.06, 0.004))
    found = [{"fixes": ["a=1"], "tried": {**t, "before": {"position_rmse_m": 0.11}}} for t in (later, before)]
    verdicts = {"lrf": "seems to hurt", "compass": "hurts"}
    report = of_errors({"odometry": 0.065, "lrf": 0.11, "compass": 0.2}, verdicts, findings=found)
    sets = {"odometry": (), "lrf": ("lrf",), "compass": ("compass",)}
    assert settled(report, sets) == {"lrf"}
    assert settled({**report, "findings": found[1:]}, sets) == set()
    words = (
        "As configured no sensor improves on odometry: 65 mm. With the laser (lrf) and the fixes found it is 4 mm."
    )
    assert headline(report, sets) == words


def test_while_a_setting_is_surely_wrong_no_sensor_is_to_be_left_out() -> None:
    doubts = {"validity": [{"void": False, "message": "lrf: stamps look 0.2 s late"}], "fixes": ["lrf.x=1"]}
    for more, words in (({}, ""), ({"compass-smoothed": 0.016}, ", smoothed 16 mm")):
        report = of_errors(LATE_LASER | more, {"lrf": "no verdict"}, **doubts)
        best = f"As configured the best is the compass: 33 mm{words}."
        assert headline(report, SETS) == f"{best} Set the fixes first."


@pytest.mark.parametrize(
    ("anees", "fixed", "sigma", "words"),
    [
        (2.9, None, 0.0, ""),
        (9.0, None, 0.0, " The covariance (all) is 3.0 times too small, and no setting explains it."),
        (9.0, 1.1, 0.0, ""),
        (9.0, 4.0, 0.0, " The covariance (all) is still 2.0 times too small, and no setting explains it."),
        (4235.0, None, 0.0, " ANEES (all) is over 50: set truth.sigma, the truth's own noise, to judge it."),
        (400.0, None, 0.01, " The covariance (all) is 20.0 times too small, and no setting explains it."),
    ],
)
def test_an_unexplained_covariance_is_named(anees: float, fixed: float | None, sigma: float, words: str) -> None:
    tried = {"configuration": "all", "after": {"anees": fixed}}
    report: dict[str, Any] = {
        "configurations": {"lrf": {"anees": 100.0}, "all": {"anees": anees}},
        "findings": [{"fixes": ["lrf.yaw_deg=1"], "tried": tried}] if fixed else [],
        "settings": {"truth": {"sigma": sigma}},
    }
    assert covariance(report, {"lrf": ("lrf",), "all": ("compass", "lrf")}) == words


@pytest.mark.parametrize(
    ("anees", "settings", "words"),
    [
        (0.06, {"truth": {"sigma": 0.5}}, ""),
        (0.01, {"truth": {"sigma": 0.5}}, ": truth.sigma=0.5 m is far larger than the errors show."),
        (0.01, {"start": {"sigma_xy": 5.0}}, ": start.sigma_xy=5 m is far larger than the errors show."),
        (0.01, {}, ": wheels.noise is far larger than the errors show."),
    ],
)
def test_a_covariance_that_is_far_too_large_names_the_sigma(
    anees: float, settings: dict[str, Any], words: str
) -> None:
    rows = {"odometry": {"anees": anees, "position_rmse_m": 0.1}, "lrf": {"anees": 1.0, "position_rmse_m": 0.1}}
    report: dict[str, Any] = {"configurations": rows, "findings": [], "settings": settings}
    said = covariance(report, {"odometry": (), "lrf": ("lrf",)})
    assert said == (f" The covariance is 10 times too large{words}" if words else "")


@pytest.mark.parametrize(
    ("own", "smoothed", "end"),
    [
        (0.47, 0.64, "agree, in lrf-smoothed 64%, which hints that it is better. Try: --reference"),
        (0.47, 0.68, "agree, in lrf-smoothed 68%, which shows that it is better. Try: --reference"),
        (0.47, 0.50, " At places seen twice 47% of the points agree, in lrf-smoothed 50%. Try: --reference"),
        (0.91, 0.91, " At places seen twice 91% of the points agree, in lrf-smoothed 91%. Try: --reference"),
        (0.47, None, "errors cannot be measured. Try: --reference"),  # no place was seen twice
    ],
)
def test_without_truth_places_seen_twice_judge_smoothing(own: float, smoothed: float | None, end: str) -> None:
    rows = {"odometry": None, "lrf": own, "lrf-smoothed": smoothed}
    report = {
        "configurations": {name: {"revisit_agreement": share} for name, share in rows.items()},
        "verdicts": {"lrf": {"verdict": "no verdict"}},
    }
    assert headline(report, {"odometry": (), "lrf": ("lrf",)}).endswith(end)


# --- what several steps of advice for one sensor become: one finding, whose words are those of what is set

SURE = Finding("lrf", "lag", "late (correlation 0.9 as stamped, 0.99 shifted). It is the laser's", severe=True)
LATE = Advice(Finding("lrf", "lag", "stamps look 0.1 s late"), ("lrf.time_offset=-0.1",))
AGAIN = Advice(Finding("lrf", "lag", "stamps look 0.01 s early"), ("lrf.time_offset=-0.09",))
BOTH = Advice(Finding("lrf", "mount", "seems to sit 0.1 m back"), (*AGAIN.fixes, "lrf.x=-0.1"))
HIGH = Advice(Finding("lrf", "too high", "noise is set too high"), ("lrf.sigma_range=0.01",))
LOW = Advice(Finding("lrf", "anees", "errors are 2 times what is claimed"), ("lrf.sigma_range=0.04",))


def finding(*advice: Advice) -> Any:
    report: dict[str, Any] = {}
    add_findings(report, Advised(advice))
    (found,) = report["findings"]
    return found


@pytest.mark.parametrize(
    ("steps", "message", "fixes"),
    [
        ((LATE, HIGH), "stamps look 0.1 s late; after this fix: noise is set too high", LATE.fixes + HIGH.fixes),
        ((HIGH, LOW), LOW.finding.message, LOW.fixes),
        ((LATE, AGAIN), LATE.finding.message, AGAIN.fixes),
        ((LATE, BOTH), f"{LATE.finding.message}; after this fix: {BOTH.finding.message}", BOTH.fixes),
    ],
    ids=[
        "of different things: one after the other",
        "set otherwise later: not told",
        "measured again: told once",
        "measured again with another thing: both told",
    ],
)
def test_several_steps_become_one_message(steps: tuple[Advice, ...], message: str, fixes: tuple[str, ...]) -> None:
    found = finding(*steps)
    assert (found["message"], found["fixes"]) == (message, list(fixes))


def test_a_value_that_ends_far_from_the_first_is_told_with_what_was_found_last() -> None:
    """Words of 0.15 m beside a fix of 0.003 m would contradict each other."""
    words = "noise is set too high: {} m configured, {} m observed"
    pairs = (("1.5", "0.15"), ("0.15", "0.015"), ("0.015", "0.003"))
    steps = [Advice(Finding("gps", "overstated", words.format(*p)), (f"gps.sigma={p[1]}",)) for p in pairs]
    first, last = (step.finding.message for step in (steps[0], steps[-1]))
    found = finding(*steps)
    assert found["message"] == f"{first}, then {last}"
    assert found["fixes"] == ["gps.sigma=0.003"]


def test_what_has_no_fix_stands_beside_what_has_one() -> None:
    """Else the fix of one would seem to be that of both."""
    report: dict[str, Any] = {}
    open_scale = Advice(Finding("lrf", "distances", "ranges differ from the wheels'", severe=True))
    add_findings(report, Advised((LATE, open_scale)))
    found = [(f["code"], f["fixes"]) for f in report["findings"]]
    assert found == [("lag", ["lrf.time_offset=-0.1"]), ("distances", [])]


@pytest.mark.parametrize(("harmless", "said"), [(True, "little changes"), (False, "No setting found that helps")])
def test_what_was_tried_in_vain_says_why_it_is_not_offered(harmless: bool, said: str) -> None:
    words = sentence(finding(Advice(HIGH.finding, tried=(HIGH.fixes,), harmless=harmless)))
    assert words.startswith("lrf: noise is set too high. ")
    assert "lrf.sigma_range=0.01" in words
    assert said in words
    assert sentence(finding(Advice(HIGH.finding))) == "lrf: noise is set too high."


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ({"anees": 0.921}, {"anees": 1.0}, "ANEES 0.92 -> 1)"),
        ({"anees": 47.3}, {"anees": 1.0}, "ANEES 47 -> 1)"),
        ({"anees": 50.2}, {"anees": 1.0}, "ANEES over 50 -> 1)"),
        ({"anees": 6.6e10}, {"anees": 1.0}, "ANEES over 50 -> 1)"),
        (
            {"position_rmse_m": 0.0052, "aligned": True},
            {"position_rmse_m": 0.0036, "aligned": True},
            "(tried with lrf: error of the path's shape 5.2 -> 3.6 mm)",
        ),
    ],
)
def test_what_a_fix_did_is_said_in_two_digits_and_an_error_of_the_shape_is_called_so(
    before: dict[str, Any], after: dict[str, Any], words: str
) -> None:
    none = {"lost_share": 0.0, "position_rmse_m": None, "prediction_nats": None, "anees": None}
    tried = {"configuration": "lrf", "before": none | before, "after": none | after}
    assert words in sentence({"role": "lrf", "message": "noise", "fixes": ["lrf.sigma_range=1"], "tried": tried})


@pytest.mark.parametrize(
    ("advice", "doubt"),
    [
        (replace(LATE, finding=SURE), "lrf: late. All figures are without this fix: --set lrf.time_offset=-0.1"),
        (Advice(SURE, tried=(("lrf.time_offset=-0.1",),)), "lrf: late"),
        (Advice(SURE, tried=(("lrf.time_offset=-0.1",),), harmless=True), None),
        (LATE, None),
    ],
)
def test_figures_are_doubtful_while_something_is_wrong(advice: Advice, doubt: str | None) -> None:
    """How it was measured stands with the finding."""
    lrf = {"configuration": "lrf", "sensors": {"lrf": {}}, "lost_share": 0.0}
    report: dict[str, Any] = {"configurations": {"lrf": lrf}}
    add_validity(report, (advice,), None)
    assert [v["message"] for v in report["validity"]] == ([] if doubt is None else [doubt])


@pytest.mark.parametrize("by_advice", [False, True])
def test_errors_by_an_unusable_truth_are_void(by_advice: bool) -> None:
    lrf = {"configuration": "lrf", "sensors": {}, "lost_share": 0.0, "position_rmse_m": 0.1}
    report: dict[str, Any] = {"configurations": {"lrf": lrf}}
    fault = Finding("truth", MIRROR, "it is a mirror image of the drive", (), True)
    add_validity(report, (Advice(fault),) if by_advice else (), 3.0, None if by_advice else fault)
    (entry,) = report["validity"]
    assert (entry["message"], entry["void"]) == ("truth: it is a mirror image of the drive", True)
    assert report["configurations"]["lrf"]["position_rmse_m"] is None


def test_a_smoothed_run_is_void_by_the_words_of_its_filter() -> None:
    lost = {"configuration": "all", "sensors": {}, "lost_share": 0.14, "lost": [[3.0, 10.0]], "anees": 2.0}
    report: dict[str, Any] = {"configurations": {"all": lost, "all-smoothed": {**lost, "smoothed": True}}}
    add_validity(report, (), None)
    (entry,) = report["validity"]
    assert entry["message"] == "all: lost for 14% of the drive, first at 3.0 s"
    assert entry["configurations"] == ["all", "all-smoothed"]
    assert all(values["anees"] is None for values in report["configurations"].values())


def test_a_sensor_whose_errors_are_all_void_gets_no_verdict() -> None:
    lost = {"configuration": "lrf", "sensors": {"lrf": {}}, "lost_share": 0.14, "lost": [[3.0, 10.0]]}
    known: dict[str, Any] = {"configuration": "compass", "sensors": {"compass": {}}, "lost_share": 0.0}
    verdicts = {name: {"verdict": "helps", "words": "Better."} for name in ("lrf", "compass")}
    report: dict[str, Any] = {"configurations": {"lrf": lost, "compass": known}, "verdicts": verdicts}
    add_validity(report, (), None)
    assert {name: v["verdict"] for name, v in report["verdicts"].items()} == {
        "lrf": "no verdict",
        "compass": "helps",
    }


@pytest.mark.parametrize(
    ("words", "same"),
    [
        ("Keep it: 68 mm. Odometry alone: 113 mm.", "Keep it: 68 mm. Odometry alone: 113 mm."),
        ("Keep it: 87 mm, smoothed 4.5 mm. With all it is 1.20 m.", None),
    ],
)
def test_a_headline_has_one_unit_of_length(words: str, same: str | None) -> None:
    assert in_one_unit(words) == (same or "Keep it: 0.087 m, smoothed 0.0045 m. With all it is 1.20 m.")
    assert in_one_unit("At 4.5 mm, then 124 mm.", in_m=True) == "At 0.0045 m, then 0.124 m."
