"""The verdicts on noise at the bounds of their rules: one figure at a time is moved over its threshold."""

from __future__ import annotations

import math
from typing import Any

import pytest
from msgspec.structs import replace

from locfuse.fusion.judge.innovations import Heard, Own
from locfuse.fusion.judge.noise_verdicts import (
    NoiseVerdict,
    biased,
    biased_against,
    by_itself,
    by_memory,
    by_reference_run,
    by_scale,
    by_share,
    contradicting,
    correlated,
    disagrees,
    many_refused,
    notable,
    of_messages,
    wanders,
)
from locfuse.fusion.sensors.registry import REGISTRY

DEG = math.radians(1.0)
# a compass of 3 degrees whose errors are white and as large as configured
HEARD = Heard(
    readings=400, wild=0.0, bias=0.0, sure=0.1 * DEG, white=(3 * DEG) ** 2, slow=0.0, spread=(3 * DEG) ** 2,
    memory=1.0, period=0.1, reference=(0.1 * DEG) ** 2, R=(3 * DEG) ** 2,
)  # fmt: skip
OWN = Own(
    compared=400, refused=0.0, nis=1.0, bounds=(0.9, 1.1), bias=(0.0,), middle=(0.0,), sure=(0.1 * DEG,),
    whiteness=(0.0,) * 5, raw=1.0, scale=1.0, white=0.9, share=0.9, R=((3 * DEG) ** 2,),
)  # fmt: skip


def settings(sensor: str, **values: Any) -> Any:
    return REGISTRY[sensor].Settings(**values)


def by_run(**changed: Any) -> NoiseVerdict | None:
    return by_reference_run("compass", settings("compass", sigma_deg=3.0), HEARD._replace(**changed))


def alone(**changed: Any) -> NoiseVerdict:
    return by_itself("compass", settings("compass", sigma_deg=3.0), OWN._replace(**changed), [0.0], 0.1)


@pytest.mark.parametrize(
    ("bias", "sure", "white", "off", "is_notable"),
    [
        (2.0, 0.5, 3.0, True, True),
        (-2.0, 0.5, 3.0, True, True),
        (2.0, 0.68, 3.0, False, True),  # less than three standard errors
        (2.0, 0.65, 3.0, True, True),
        (1.4, 0.1, 3.0, False, False),  # less than half its noise
        (1.6, 0.1, 3.0, True, True),
        (None, 0.1, 3.0, False, False),
    ],
)
def test_a_mean_is_off_by_three_standard_errors_and_half_its_noise(
    bias: float | None, sure: float, white: float, off: bool, is_notable: bool
) -> None:
    h = HEARD._replace(bias=None if bias is None else bias * DEG, sure=sure * DEG, white=(white * DEG) ** 2)
    assert disagrees(h) is off
    assert notable(h) is is_notable


@pytest.mark.parametrize(
    ("factor", "verdict"),
    [(0.65, "overstated"), (0.68, "consistent"), (1.0, "consistent"), (1.49, "consistent"), (1.52, "understated")],
)
def test_a_sigma_within_a_factor_of_one_and_a_half_is_no_complaint(factor: float, verdict: str) -> None:
    found = by_scale("landmarks", settings("landmarks", sigma_bearing_deg=2.0, sigma_range=0.1), factor)
    assert (found.verdict, found.scale) == (verdict, factor)
    if verdict == "consistent":
        assert not found.cures
        return
    assert found.cures == {
        "landmarks.sigma_bearing_deg": float(f"{2.0 * factor:.2g}"),
        "landmarks.sigma_range": float(f"{0.1 * factor:.2g}"),
    }
    way = "high" if factor < 1.0 else "low"
    assert found.words == f"noise is set too {way}: 2° configured, {2.0 * factor:.2g}° observed"


def test_of_metres_the_words_say_so() -> None:
    assert "0.1 m configured, 0.2 m observed" in by_scale("gps", settings("gps", sigma=0.1), 2.0).words


@pytest.mark.parametrize(
    ("changed", "verdict", "scale"),
    [
        ({}, "consistent", 1.0),
        ({"white": (6 * DEG) ** 2, "spread": (6 * DEG) ** 2}, "understated", 2.0),
        ({"white": (1 * DEG) ** 2, "spread": (1 * DEG) ** 2}, "overstated", 1 / 3),
        # the reference's own variance is taken off the spread, up to half of what is white
        ({"white": 4.0, "spread": 4.0, "reference": 1.0, "R": 3.0, "slow": 0.0}, "consistent", 1.0),
        ({"white": 4.0, "spread": 4.0, "reference": 3.0, "R": 2.0, "slow": 0.0}, "consistent", 1.0),
        ({"white": 4.0, "spread": 9.0, "reference": 1.0, "R": 4.0, "slow": 0.0}, "consistent", 1.0),
        ({"white": 1.0, "spread": 1.0, "reference": 1.9, "R": 0.5}, "consistent", 1.0),
    ],
)
def test_a_run_without_the_sensor_measures_its_noise(
    changed: dict[str, float], verdict: str, scale: float
) -> None:
    found = by_run(**changed)
    assert found is not None
    assert found.verdict == verdict
    assert found.scale == pytest.approx(scale, rel=0.01)


@pytest.mark.parametrize(("reference", "judges"), [(1.99, True), (2.01, False)])
def test_a_run_four_times_as_uncertain_as_the_sensor_is_no_judge(reference: float, judges: bool) -> None:
    """Of 1 that is white half counts, since the run's own variance is larger: 0.5 against 4 x 0.5."""
    assert (by_run(white=1.0, spread=1.0, reference=reference, R=0.5) is not None) is judges


@pytest.mark.parametrize(
    ("changed", "verdict"),
    [
        ({"slow": 0.31, "reference": 0.1, "spread": 1.31}, "correlated"),
        ({"slow": 0.29, "reference": 0.1, "spread": 1.29}, "consistent"),  # the run itself may be so slow
        ({"slow": 0.11, "reference": 0.01, "spread": 1.11}, "correlated"),
        ({"slow": 0.09, "reference": 0.01, "spread": 1.09}, "consistent"),  # next to nothing of it lasts
    ],
)
def test_errors_that_last_are_the_sensors_where_the_reference_is_better(
    changed: dict[str, float], verdict: str
) -> None:
    found = by_run(white=1.0, memory=20.0, R=1.0, **changed)
    assert found is not None
    assert found.verdict == verdict


@pytest.mark.parametrize(("repeats", "verdict"), [(3.9, "consistent"), (4.1, "correlated")])
def test_errors_that_last_matter_where_a_mean_of_many_is_off_by_twice_what_is_claimed(
    repeats: float, verdict: str
) -> None:
    given = settings("compass", sigma_deg=3.0)
    found = by_memory("compass", given, (3 * DEG) ** 2, repeats, 0.5, (3 * DEG) ** 2)
    assert found.verdict == verdict
    if verdict == "correlated":
        assert found.scale == pytest.approx(math.sqrt(repeats))
        memory = 0.5 * repeats
        assert found.cures == {
            "compass.sigma_deg": float(f"{3.0 * math.sqrt(repeats):.2g}"),
            "compass.offset_drift_deg": float(f"{3.0 * math.sqrt(4.0 / memory):.2g}"),
        }
        assert found.words.startswith("errors of 3° last about 2 s, but")
    assert by_memory("compass", given, 0.5, 0.5, 0.1, 1.0).scale == pytest.approx(0.5)
    assert by_memory("compass", given, 2.0, 1.5, 0.1, 1.0).scale == 1.0


def test_a_sensor_without_a_drift_gets_a_larger_sigma_only() -> None:
    found = correlated("lrf", settings("lrf"), 0.02, 9.0, 0.1)
    assert found.cures == {"lrf.sigma_range": 0.06}
    assert found.words.startswith("errors of 0.02 m last about 0.9 s")


@pytest.mark.parametrize(
    ("drift_deg", "bias", "verdict"),
    [(0.51, None, "consistent"), (0.49, None, "correlated"), (0.51, 0.0, "correlated")],
)
def test_an_offset_that_drifts_half_as_fast_as_the_errors_need_is_enough(
    drift_deg: float, bias: float | None, verdict: str
) -> None:
    """Errors of 1 degree that last 4 s need a drift of 1 degree per root second; a given offset does not drift."""
    given = settings("compass", sigma_deg=1.0, offset_drift_deg=drift_deg)
    h = HEARD._replace(
        bias=bias, spread=DEG**2, white=0.8 * DEG**2, slow=0.9 * DEG**2, memory=40.0, period=0.1, R=DEG**2,
        reference=1e-9,
    )  # fmt: skip
    found = by_reference_run("compass", given, h)
    assert found is not None
    assert found.verdict == verdict


@pytest.mark.parametrize(
    ("middle", "sure", "several", "verdict"),
    [
        (3.1, 0.1, False, "biased"),
        (-3.1, 0.1, False, "biased"),
        (2.9, 0.1, False, "consistent"),  # within its sigma of 3 degrees
        (3.1, 1.1, False, "consistent"),  # not three standard errors
        (3.4, 1.1, False, "biased"),
        (9.0, 0.1, True, "consistent"),  # of several numbers nobody knows which is off
    ],
)
def test_by_itself_a_sensor_is_biased_by_more_than_its_sigma(
    middle: float, sure: float, several: bool, verdict: str
) -> None:
    found = (
        alone(middle=(middle * DEG,), sure=(sure * DEG,), R=(OWN.R[0],) * (2 if several else 1))
        if not several
        else by_itself(
            "lrf", settings("lrf"), OWN._replace(middle=(9.0,) * 2, sure=(0.1,) * 2, R=(1.0, 1.0)), [0.0, 0.0], 0.1
        )
    )
    assert found.verdict == verdict
    if verdict == "biased":
        assert found.cures["compass.offset_deg"] == pytest.approx(middle)
        # its own noise would leave 3 degrees / sqrt(400) = 0.15 degrees: twice as much is another's error
        assert ("compass.sigma_offset_deg" in found.cures) is (sure > 0.3)


@pytest.mark.parametrize(
    ("white", "correlation", "verdict"),
    [(0.29, 0.55, "correlated"), (0.31, 0.55, "consistent"), (0.29, 0.49, "consistent")],
)
def test_by_itself_a_sensor_whose_errors_the_state_follows_is_correlated(
    white: float, correlation: float, verdict: str
) -> None:
    found = alone(white=white, whiteness=(correlation, 0, 0, 0, 0), raw=0.5, scale=0.5, share=0.9)
    assert found.verdict == verdict
    if verdict == "correlated":
        repeats = 1.0 + 2.0 * correlation / (1.0 - correlation)  # of a Markov chain
        assert found.scale == pytest.approx(math.sqrt(repeats))
        assert found.cures["compass.sigma_deg"] == float(f"{3.0 * math.sqrt(repeats):.2g}")


def test_of_errors_that_never_forget_the_memory_is_bounded() -> None:
    found = alone(white=0.0, whiteness=(1.0, 1.0, 1.0, 1.0, 1.0), nis=4.0)
    assert found.scale == pytest.approx(math.sqrt(1.0 + 2.0 * 0.98 / 0.02 + 2.0 * 0.02 / 0.02), rel=1e-3)
    assert found.words.startswith("errors of 6° last about")


@pytest.mark.parametrize(
    ("raw", "correlation", "wandering"), [(0.68, 0.26, True), (0.65, 0.26, False), (0.68, 0.24, False)]
)
def test_residuals_as_large_as_configured_that_are_similar_point_to_the_prediction(
    raw: float, correlation: float, wandering: bool
) -> None:
    found = alone(raw=raw, whiteness=(correlation, 0, 0, 0, 0))
    assert found.words.startswith("successive residuals are similar (26%)") is wandering
    assert (found.verdict == "correlated") is wandering
    assert wanders("compass", OWN._replace(whiteness=(0.5,))).words.startswith(
        "successive residuals are similar (50%)"
    )


@pytest.mark.parametrize(
    ("changed", "verdict"),
    [
        ({"scale": 0.3, "raw": 0.3, "nis": 0.3, "share": 0.09}, "unclear"),
        ({"scale": 0.3, "raw": 0.3, "nis": 0.3, "share": 0.11}, "overstated"),
        ({"scale": 0.3, "raw": 0.68, "nis": 0.3}, "consistent"),
        ({"scale": 0.3, "raw": 0.3, "nis": 0.68}, "consistent"),
        ({"scale": 0.46, "raw": 0.3, "nis": 0.3}, "consistent"),  # sqrt(0.46) = 0.68
        ({"scale": 0.43, "raw": 0.3, "nis": 0.3}, "overstated"),
        ({"scale": 2.2, "raw": 2.2, "nis": 2.2, "share": 0.01}, "consistent"),
        ({"scale": 2.3, "raw": 2.3, "nis": 2.3, "share": 0.01}, "understated"),
    ],
)
def test_by_itself_a_sigma_is_too_large_only_where_residuals_show_it(
    changed: dict[str, float], verdict: str
) -> None:
    assert alone(**changed).verdict == verdict


@pytest.mark.parametrize(
    ("R", "floor", "scale", "factor"),
    [
        ((4.0,), (0.0,), 4.0, 2.0),
        ((4.0,), (1.0,), 4.0, math.sqrt(15.0 / 3.0)),  # the floor does not change with sigma
        ((4.0,), (3.9,), 4.0, 2.0),  # next to nothing but the floor: then as if there were none
        ((1.0, 4.0), (0.95, 1.0), 4.0, math.sqrt(15.0 / 3.0)),
        ((2.0, 4.0), (1.0, 1.0), 4.0, math.sqrt(0.5 * (7.0 / 1.0 + 15.0 / 3.0))),
        ((4.0,), (3.0,), 0.5, 0.1),  # never below a tenth
    ],
)
def test_the_factor_is_on_sigma_and_not_on_the_floor(
    R: tuple[float, ...], floor: tuple[float, ...], scale: float, factor: float
) -> None:
    o = OWN._replace(R=R, scale=scale, raw=scale, nis=scale, middle=(0.0,) * len(R), sure=(0.1,) * len(R))
    assert by_itself("lrf", settings("lrf"), o, floor, 0.1).scale == pytest.approx(factor)


@pytest.mark.parametrize(
    ("sensor", "share", "many"),
    [("compass", 0.051, True), ("compass", 0.049, False), ("lrf", 0.26, True), ("lrf", 0.24, False)],
)
def test_one_reading_in_twenty_may_be_refused_and_of_lines_one_in_four(
    sensor: str, share: float, many: bool
) -> None:
    assert many_refused(sensor, share) is many
    rest = NoiseVerdict("consistent", "fine")
    found = by_share(sensor, share, rest)
    assert (found is rest) is not many
    low = NoiseVerdict("understated", "low")
    assert by_share(sensor, share, low) is low


@pytest.mark.parametrize(
    ("verdict", "scale", "words"),
    [
        ("understated", 3.0, "compass: its messages claim errors about 3 times smaller than they are"),
        ("overstated", 0.25, "compass: its messages claim errors about 4 times larger than they are"),
        (
            "correlated",
            2.0,
            "compass errors last longer than one reading, while its messages claim each to be independent",
        ),
        ("consistent", 1.0, "as it was"),
        ("understated", None, "as it was"),
    ],
)
def test_of_noise_that_messages_bring_no_setting_is_the_fix(verdict: Any, scale: float | None, words: str) -> None:
    found = of_messages("compass", NoiseVerdict(verdict, "as it was", scale, {"compass.sigma_deg": 2.0}))
    assert (found.verdict, found.scale, found.words) == (verdict, scale, words)
    assert bool(found.cures) is (words == "as it was")


@pytest.mark.parametrize(("sure", "given"), [(0.29, False), (0.31, True)])
def test_an_offset_comes_with_its_sigma_where_another_error_is_in_it(sure: float, given: bool) -> None:
    """3 degrees of noise over 400 readings leave 0.15 degrees: twice that is still its own."""
    h = HEARD._replace(bias=5.0 * DEG, sure=sure * DEG)
    found = biased_against("compass", settings("compass", offset_deg=170.0), h)
    assert found.words.startswith("differs from the other sensors by +5 deg on average")
    assert found.cures["compass.offset_deg"] == pytest.approx(175.0)
    assert ("compass.sigma_offset_deg" in found.cures) is given
    assert ("(1 sigma 0.31)" in found.words) is given


def test_an_offset_is_turned_into_half_a_turn_either_way_and_a_sensor_without_one_has_no_fix() -> None:
    turned = biased("compass", settings("compass", offset_deg=170.0), 30.0 * DEG, DEG, DEG)
    assert turned.cures["compass.offset_deg"] == pytest.approx(-160.0)
    assert biased("compass", settings("compass"), 30.0 * DEG, DEG, DEG).cures["compass.offset_deg"] == 30.0
    camera = biased("camera", settings("camera", zero_deg=10.0), 3.0 * DEG, DEG, DEG)
    assert camera.cures["camera.zero_deg"] == pytest.approx(7.0)  # its zero counts against what it measures
    assert not biased("gps", settings("gps"), 1.0, 0.1, 0.1).cures
    assert "+1 m on average" in biased("gps", settings("gps"), 1.0, 0.1, 0.1).words


def test_sensors_that_contradict_each_other_are_named() -> None:
    words = contradicting("lrf", ["compass", "gps"]).words
    assert words.startswith("lrf and compass and gps contradict each other")
    assert replace(contradicting("a", ["b"]), words="").verdict == "contradicts"
