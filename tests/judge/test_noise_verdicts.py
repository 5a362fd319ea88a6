"""The verdicts on noise at the bounds of their rules: one figure at a time is moved over its threshold."""

from __future__ import annotations

import math
from typing import Any

import pytest
from msgspec.structs import replace

from locfuse.fusion.judge.innovations import Heard, Own
from locfuse.fusion.judge.noise_verdicts import (
    NoiseVerdict,
    biased_against,
    by_itself,
    by_memory,
    by_reference_run,
    contradicting,
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


def test_sensors_that_contradict_each_other_are_named() -> None:
    words = contradicting("lrf", ["compass", "gps"]).words
    assert words.startswith("lrf and compass and gps contradict each other")
    assert replace(contradicting("a", ["b"]), words="").verdict == "contradicts"
