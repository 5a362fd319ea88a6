"""The verdicts on noise at the bounds of their rules: one figure at a time is moved over its threshold."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
import small_drive
from numpy.typing import NDArray
from present import present

from locfuse.fusion.data import Drive, Estimates, Measurements, Motions, Truth
from locfuse.fusion.judge import consistency
from locfuse.fusion.judge.consistency import (
    Consistency,
    NoiseEvidence,
    RunInnovations,
    biased_against,
    by_itself,
    by_memory,
    by_reference_run,
    judge,
    of_messages,
)
from locfuse.fusion.judge.innovations import ComparedReadings, OwnInnovations
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY

DEG = math.radians(1.0)
# a compass of 3 degrees whose errors are white and as large as configured
HEARD = ComparedReadings(
    readings=400, outlier_share=0.0, bias=0.0, standard_error=0.1 * DEG, white=(3 * DEG) ** 2,
    slow=0.0, spread=(3 * DEG) ** 2, memory=1.0, period=0.1, reference=(0.1 * DEG) ** 2, R=(3 * DEG) ** 2,
)  # fmt: skip
OWN = OwnInnovations(
    compared=400, refused=0.0, nis=1.0, bounds=(0.9, 1.1), bias=(0.0,), middle=(0.0,), standard_error=(0.1 * DEG,),
    whiteness=(0.0,) * 5, raw=1.0, scale=1.0, white=0.9, share=0.9, R=((3 * DEG) ** 2,),
)  # fmt: skip


def settings(sensor: str, **values: Any) -> Any:
    return REGISTRY[sensor].Settings(**values)


def by_run(**changed: Any) -> Consistency | None:
    return by_reference_run("compass", settings("compass", sigma_deg=3.0), HEARD._replace(**changed))


def alone(**changed: Any) -> Consistency:
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
def test_another_run_measures_the_noise(changed: dict[str, float], verdict: str, scale: float) -> None:
    found = present(by_run(**changed))
    assert found.verdict == verdict
    assert found.scale == pytest.approx(scale, rel=0.01)


@pytest.mark.parametrize(("repeats", "verdict"), [(3.9, "consistent"), (4.1, "correlated")])
def test_errors_that_last_matter_where_they_double_a_mean_s_error(repeats: float, verdict: str) -> None:
    given = settings("compass", sigma_deg=3.0)
    found = by_memory("compass", given, (3 * DEG) ** 2, repeats, 0.5, (3 * DEG) ** 2)
    assert found.verdict == verdict
    if verdict == "correlated":
        assert found.scale == pytest.approx(math.sqrt(repeats))
        memory = 0.5 * repeats
        assert found.fix_values == {
            "compass.sigma_deg": float(f"{3.0 * math.sqrt(repeats):.2g}"),
            "compass.offset_drift_deg": float(f"{3.0 * math.sqrt(4.0 / memory):.2g}"),
        }
        assert found.words.startswith("errors of 3° last about 2 s, so ")
    assert by_memory("compass", given, 0.5, 0.5, 0.1, 1.0).scale == pytest.approx(0.5)
    assert by_memory("compass", given, 2.0, 1.5, 0.1, 1.0).scale == 1.0


@pytest.mark.parametrize(
    ("raw", "correlation", "wandering"), [(0.68, 0.26, True), (0.65, 0.26, False), (0.68, 0.24, False)]
)
def test_similar_residuals_point_to_the_prediction(raw: float, correlation: float, wandering: bool) -> None:
    found = alone(raw=raw, whiteness=(correlation, 0, 0, 0, 0))
    assert found.words.startswith("successive residuals are similar (26%)") is wandering
    assert (found.verdict == "correlated") is wandering


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
def test_a_sigma_is_too_large_only_where_residuals_show_it(changed: dict[str, float], verdict: str) -> None:
    assert alone(**changed).verdict == verdict


@pytest.mark.parametrize(
    ("verdict", "scale", "words"),
    [
        ("understated", 3.0, "its messages claim errors about 3 times smaller than they are"),
        ("overstated", 0.25, "its messages claim errors about 4 times larger than they are"),
        ("correlated", 2.0, "errors last longer than a reading, while its messages claim each to be independent"),
        ("understated", float("inf"), "its messages claim errors that are far smaller than they are"),
        ("consistent", 1.0, "as it was"),
        ("understated", None, "as it was"),
    ],
)
def test_sigmas_replace_the_noise_that_messages_bring(verdict: Any, scale: float | None, words: str) -> None:
    found = of_messages(Consistency(verdict, "as it was", scale, {"gps.sigma": 2.0}), "gps", {"sigma": 0.5})
    assert (found.verdict, found.scale, found.words) == (verdict, scale, words)
    if words == "as it was":
        assert found.fix_values == {"gps.sigma": 2.0}
    elif verdict == "correlated" or math.isinf(scale or 0.0):
        assert found.fix_values == {}
    else:
        assert found.fix_values == {"gps.sigma": pytest.approx(0.5 * (scale or 0.0), rel=0.05)}


@pytest.mark.parametrize(("error", "given"), [(0.29, False), (0.31, True)])
def test_an_offset_comes_with_its_sigma_where_another_error_is_in_it(error: float, given: bool) -> None:
    """3 degrees of noise over 400 readings leave 0.15 degrees: twice that is still its own."""
    h = HEARD._replace(bias=5.0 * DEG, standard_error=error * DEG)
    found = biased_against("compass", settings("compass", offset_deg=170.0), h)
    assert found.words.startswith("differs from the other sensors by +5 deg on average")
    assert found.fix_values["compass.offset_deg"] == pytest.approx(175.0)
    assert ("compass.sigma_offset_deg" in found.fix_values) is given
    assert ("(1 sigma 0.31)" in found.words) is given


# --- who is to blame where runs disagree: what each run says of each sensor is laid by hand


FINE = HEARD._replace(standard_error=0.01, white=1.0, spread=1.0, reference=0.01, R=1.0)
OFF = FINE._replace(bias=2.0)
OWN_RUN = OWN._replace(standard_error=(0.1,), R=(1.0,))
ROBOT: Robot = small_drive.robot()
SENSORS, N = ("compass", "gyro", "lrf"), 30
T: NDArray[np.float64] = np.linspace(0.0, 2.9, N)


def readings(n: int = N) -> Measurements:
    return Measurements(T[:n], np.arange(n + 1), np.zeros((n, 1)), np.ones((n, 1, 1)), 1.0, np.zeros((1, 1)))


def drive(truth: Truth | None = None) -> Drive:
    motions = Motions(np.zeros((N, 3)), np.zeros((N, 3, 3)), np.zeros((N, 3, 0)))
    return Drive(0, T[:N], motions, {s: readings() for s in SENSORS}, {}, {}, truth)


def run(
    name: str, own: Mapping[str, OwnInnovations | None] | None = None, truth: Truth | None = None
) -> RunInnovations:
    """The run of the sensors in its name: "compass+lrf"."""
    sensors = tuple(s for s in name.split("+") if s != "odometry")
    found = drive(truth)
    e = Estimates(name, sensors, found.t, np.zeros((N, 3)), np.zeros((N, 6)), {})
    return RunInnovations(found, e, dict.fromkeys(sensors, OWN_RUN) | dict(own or {}))


class Told:
    """What runs say of sensors: "run: sensor" -> ComparedReadings; nothing of the others."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.said: dict[str, ComparedReadings] = {}
        monkeypatch.setattr(
            consistency, "compare_readings", lambda _, __, e, sensor: self.said.get(f"{e.name}: {sensor}")
        )


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch) -> Told:
    return Told(monkeypatch)


def names(evidence: NoiseEvidence, sensor: str) -> list[str]:
    return [r.estimates.name for r, _ in evidence.reference_runs(sensor)]


def test_a_reference_is_a_run_of_other_sensors_the_most_certain_first(told: Told) -> None:
    told.said = {
        "odometry: compass": FINE,
        "compass: compass": FINE,
        "compass+lrf: compass": FINE,
        "gyro: compass": FINE._replace(reference=0.02),
        "lrf: compass": FINE,
        "gyro+lrf: compass": FINE._replace(reference=0.001),
    }
    runs = [run(n) for n in ("odometry", "compass", "gyro", "lrf", "compass+lrf", "gyro+lrf")]
    assert names(NoiseEvidence(runs, ROBOT), "compass") == ["gyro+lrf", "lrf", "gyro"]
    assert names(NoiseEvidence(runs, ROBOT, {"lrf"}), "compass") == ["gyro+lrf", "gyro"]


@pytest.mark.parametrize(
    ("own", "healthy"),
    [
        (OWN_RUN._replace(scale=2.24), True),
        (OWN_RUN._replace(scale=2.25), False),  # sigma understated by one and a half
        (OWN_RUN._replace(refused=0.24), True),
        (OWN_RUN._replace(refused=0.25), False),
        (None, False),
    ],
)
def test_a_run_understating_noise_is_no_reference(told: Told, own: OwnInnovations | None, healthy: bool) -> None:
    told.said = {"gyro+lrf: compass": FINE}
    evidence = NoiseEvidence([run("compass"), run("gyro+lrf", {"lrf": own})], ROBOT)
    assert names(evidence, "compass") == (["gyro+lrf"] if healthy else [])


def flagged(told: Told, said: dict[str, ComparedReadings], *runs: str) -> tuple[set[str], set[str]]:
    """The sensors whose mean is off, and those that contradict each other."""
    told.said = said
    evidence = NoiseEvidence([run(n) for n in ("odometry", *runs)], ROBOT)
    return set(evidence.flagged), evidence.contradict


def test_of_three_sensors_two_outvote_one_and_of_two_nobody_knows(told: Told) -> None:
    for said in ({"compass: lrf": OFF, "lrf: compass": OFF}, {"compass: lrf": FINE, "lrf: compass": OFF}):
        assert flagged(told, said, "compass", "lrf") == (set(), {"compass", "lrf"})
    assert flagged(told, {"compass: lrf": FINE, "lrf: compass": FINE}, "compass", "lrf") == (set(), set())
    said = {
        "lrf: compass": OFF, "lrf: gyro": FINE, "gyro: compass": OFF, "gyro: lrf": FINE,
        "compass: lrf": OFF._replace(reference=0.001), "compass: gyro": OFF._replace(reference=0.001),
    }  # fmt: skip
    assert flagged(told, said, *SENSORS) == ({"compass"}, set())


def test_a_sensor_that_is_off_is_no_reference_any_more(told: Told) -> None:
    """Once the compass is found out, its run accuses nobody."""
    said = {"gyro+lrf: compass": OFF._replace(reference=0.001), "compass: lrf": OFF, "gyro: lrf": FINE}
    told.said = said
    runs = [run(n) for n in ("compass", "gyro", "lrf", "gyro+lrf")]
    evidence = NoiseEvidence(runs, ROBOT)
    assert (set(evidence.flagged), evidence.contradict) == ({"compass"}, set())
    assert names(evidence, "lrf") == ["gyro"]


def test_contradicting_sensors_name_each_other(told: Told) -> None:
    told.said = {"compass: lrf": OFF, "lrf: compass": OFF}
    found = judge([run("compass"), run("lrf")], ROBOT)
    assert found["compass"]["compass"].words.startswith("compass and lrf contradict")
    assert found["lrf"]["lrf"].words.startswith("lrf and compass contradict")


def verdict_of(told: Told, sensor: str, *runs: RunInnovations) -> tuple[str, str]:
    told.said = {}
    found = NoiseEvidence(list(runs), ROBOT).finding(sensor)
    return found.verdict, found.words


@pytest.mark.parametrize(("compared", "verdict"), [(19, "unclear"), (20, "consistent")])
def test_without_a_reference_twenty_readings_judge(told: Told, compared: int, verdict: str) -> None:
    mine = run("compass", {"compass": OWN_RUN._replace(compared=compared)})
    found = verdict_of(told, "compass", mine)
    assert found[0] == verdict
    assert verdict == "consistent" or found[1] == "noise cannot be judged: too few measurements"
    assert verdict_of(told, "compass", run("compass", {"compass": None}))[0] == "unclear"


def test_its_own_run_is_the_one_with_the_fewest_others_that_are_healthy(told: Told) -> None:
    """The understated laser spoils the pair, unless the sensor itself is the worst of it."""
    low, high = OWN_RUN._replace(scale=4.0), OWN_RUN._replace(scale=9.0)
    pair = run("compass+lrf", {"lrf": low})
    assert verdict_of(told, "compass", pair) == (
        "unclear", "noise cannot be judged: the noise of lrf must be set first",
    )  # fmt: skip
    assert verdict_of(told, "compass", run("compass+lrf", {"compass": high, "lrf": low}))[0] == "understated"
    assert verdict_of(told, "lrf", pair)[0] == "understated"
    alone = run("compass", {"compass": high})
    assert verdict_of(told, "compass", run("compass+gyro"), alone)[0] == "understated"
    assert verdict_of(told, "compass", alone, run("compass+gyro"))[0] == "understated"
    three = run("compass+gyro+lrf", {"gyro": low, "lrf": high})
    assert verdict_of(told, "compass", three)[1].endswith("the noise of gyro and lrf must be set first")


@pytest.mark.parametrize(("scale", "blamed"), [(2.24, False), (2.26, True)])
def test_only_noise_that_is_understated_must_be_set_first(told: Told, scale: float, blamed: bool) -> None:
    own = {"compass": OWN_RUN._replace(compared=3), "gyro": OWN_RUN._replace(scale=scale), "lrf": None}
    pair = run("compass+gyro+lrf", own)
    assert ("the noise of gyro" in verdict_of(told, "compass", pair)[1]) is blamed
