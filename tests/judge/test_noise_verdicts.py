"""The verdicts on noise at the bounds of their rules: one figure at a time is moved over its threshold."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
import small_drive
from numpy.typing import NDArray
from present import present

from locfuse.fusion.data import Drive, Estimates, Measurements, Motions
from locfuse.fusion.judge import consistency
from locfuse.fusion.judge.innovations import ComparedReadings, OwnInnovations
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY

DEG = math.radians(1.0)
# a compass of 3 degrees whose errors are white and as large as configured
HEARD = ComparedReadings(
    readings=400,
    outlier_share=0.0,
    bias=0.0,
    standard_error=0.1 * DEG,
    white=(3 * DEG) ** 2,
    slow=0.0,
    spread=(3 * DEG) ** 2,
    memory=1.0,
    period=0.1,
    reference=(0.1 * DEG) ** 2,
    R=(3 * DEG) ** 2,
)
OWN = OwnInnovations(
    compared=400,
    refused=0.0,
    nis=1.0,
    bounds=(0.9, 1.1),
    bias=(0.0,),
    middle=(0.0,),
    standard_error=(0.1 * DEG,),
    whiteness=(0.0,) * 5,
    raw=1.0,
    scale=1.0,
    white=0.9,
    share=0.9,
    R=((3 * DEG) ** 2,),
)


def settings(sensor: str, **values: Any) -> Any:
    return REGISTRY[sensor].Settings(**values)


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
def test_another_run_measures_the_noise(changed: dict[str, Any], verdict: str, scale: float) -> None:
    given = settings("compass", sigma_deg=3.0)
    found = present(consistency.by_reference_run("compass", given, HEARD._replace(**changed)))
    assert found.verdict == verdict
    assert found.scale == pytest.approx(scale, rel=0.01)


@pytest.mark.parametrize(("repeats", "verdict"), [(3.9, "consistent"), (4.1, "correlated")])
def test_errors_that_last_matter_where_they_double_a_mean_s_error(repeats: float, verdict: str) -> None:
    given = settings("compass", sigma_deg=3.0)
    found = consistency.by_memory("compass", given, (3 * DEG) ** 2, repeats, 0.5, (3 * DEG) ** 2)
    assert found.verdict == verdict
    if verdict == "correlated":
        assert found.scale == pytest.approx(math.sqrt(repeats))
        memory = 0.5 * repeats
        assert found.fix_values == {
            "compass.sigma_deg": float(f"{3.0 * math.sqrt(repeats):.2g}"),
            "compass.offset_drift_deg": float(f"{3.0 * math.sqrt(4.0 / memory):.2g}"),
        }
        assert found.words.startswith("errors of 3° last about 2 s, so ")
    assert consistency.by_memory("compass", given, 0.5, 0.5, 0.1, 1.0).scale == pytest.approx(0.5)
    assert consistency.by_memory("compass", given, 2.0, 1.5, 0.1, 1.0).scale == 1.0


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
    found = consistency.of_messages(
        consistency.Consistency(verdict, "as it was", scale, {"gps.sigma": 2.0}), "gps", {"sigma": 0.5}
    )
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
    found = consistency.biased_against("compass", settings("compass", offset_deg=170.0), h)
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


def readings() -> Measurements:
    return Measurements(T, np.arange(N + 1), np.zeros((N, 1)), np.ones((N, 1, 1)), 1.0, np.zeros((1, 1)))


def run(name: str, own: Mapping[str, OwnInnovations | None] | None = None) -> consistency.RunInnovations:
    """The run of the sensors in its name: "compass+lrf"."""
    sensors = tuple(s for s in name.split("+") if s != "odometry")
    motions = Motions(np.zeros((N, 3)), np.zeros((N, 3, 3)), np.zeros((N, 3, 0)))
    found = Drive(0, T, motions, {s: readings() for s in SENSORS}, {}, {})
    e = Estimates(name, sensors, found.t, np.zeros((N, 3)), np.zeros((N, 6)), {})
    return consistency.RunInnovations(found, e, dict.fromkeys(sensors, OWN_RUN) | dict(own or {}))


class Told:
    """What runs say of sensors: "run: sensor" -> ComparedReadings; nothing of the others."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.said: dict[str, ComparedReadings] = {}
        compared = "locfuse.fusion.judge.consistency.compare_readings"
        monkeypatch.setattr(compared, lambda _, __, e, sensor: self.said.get(f"{e.name}: {sensor}"))


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch) -> Told:
    return Told(monkeypatch)


def names(evidence: consistency.NoiseEvidence, sensor: str) -> list[str]:
    return [r.estimates.name for r, _ in evidence.reference_runs(sensor)]


def test_a_reference_is_a_run_of_other_sensors_the_most_certain_first(told: Told) -> None:
    every = ("odometry", "compass", "gyro", "lrf", "compass+lrf", "gyro+lrf")
    how_sure = {"gyro": 0.02, "gyro+lrf": 0.001}
    told.said = {f"{name}: compass": FINE._replace(reference=how_sure.get(name, 0.01)) for name in every}
    runs = [run(name) for name in every]
    assert names(consistency.NoiseEvidence(runs, ROBOT), "compass") == ["gyro+lrf", "lrf", "gyro"]
    assert names(consistency.NoiseEvidence(runs, ROBOT, {"lrf"}), "compass") == ["gyro+lrf", "gyro"]


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
    evidence = consistency.NoiseEvidence([run("compass"), run("gyro+lrf", {"lrf": own})], ROBOT)
    assert names(evidence, "compass") == (["gyro+lrf"] if healthy else [])


def flagged(told: Told, said: dict[str, ComparedReadings], *runs: str) -> tuple[set[str], set[str]]:
    """The sensors whose mean is off, and those that contradict each other."""
    told.said = said
    evidence = consistency.NoiseEvidence([run(n) for n in ("odometry", *runs)], ROBOT)
    return set(evidence.flagged), evidence.contradict


def test_of_three_sensors_two_outvote_one_and_of_two_nobody_knows(told: Told) -> None:
    for said in ({"compass: lrf": OFF, "lrf: compass": OFF}, {"compass: lrf": FINE, "lrf: compass": OFF}):
        assert flagged(told, said, "compass", "lrf") == (set(), {"compass", "lrf"})
    assert flagged(told, {"compass: lrf": FINE, "lrf: compass": FINE}, "compass", "lrf") == (set(), set())
    said = {
        "lrf: compass": OFF,
        "lrf: gyro": FINE,
        "gyro: compass": OFF,
        "gyro: lrf": FINE,
        "compass: lrf": OFF._replace(reference=0.001),
        "compass: gyro": OFF._replace(reference=0.001),
    }
    assert flagged(told, said, *SENSORS) == ({"compass"}, set())


def test_a_sensor_that_is_off_is_no_reference_any_more(told: Told) -> None:
    """Once the compass is found out, its run accuses nobody."""
    said = {"gyro+lrf: compass": OFF._replace(reference=0.001), "compass: lrf": OFF, "gyro: lrf": FINE}
    told.said = said
    runs = [run(n) for n in ("compass", "gyro", "lrf", "gyro+lrf")]
    evidence = consistency.NoiseEvidence(runs, ROBOT)
    assert (set(evidence.flagged), evidence.contradict) == ({"compass"}, set())
    assert names(evidence, "lrf") == ["gyro"]


def test_contradicting_sensors_name_each_other(told: Told) -> None:
    told.said = {"compass: lrf": OFF, "lrf: compass": OFF}
    found = consistency.judge([run("compass"), run("lrf")], ROBOT)
    assert found["compass"]["compass"].words.startswith("compass and lrf contradict")
    assert found["lrf"]["lrf"].words.startswith("lrf and compass contradict")


def verdict_of(told: Told, sensor: str, *runs: consistency.RunInnovations) -> tuple[str, str]:
    told.said = {}
    found = consistency.NoiseEvidence(list(runs), ROBOT).finding(sensor)
    return found.verdict, found.words


def test_its_own_run_is_the_one_with_the_fewest_others_that_are_healthy(told: Told) -> None:
    """The understated laser spoils the pair, unless the sensor itself is the worst of it."""
    low, high = OWN_RUN._replace(scale=4.0), OWN_RUN._replace(scale=9.0)
    pair = run("compass+lrf", {"lrf": low})
    assert verdict_of(told, "compass", pair) == (
        "unclear",
        "noise cannot be judged: the noise of lrf must be set first",
    )
    assert verdict_of(told, "compass", run("compass+lrf", {"compass": high, "lrf": low}))[0] == "understated"
    assert verdict_of(told, "lrf", pair)[0] == "understated"
    alone = run("compass", {"compass": high})
    assert verdict_of(told, "compass", run("compass+gyro"), alone)[0] == "understated"
    assert verdict_of(told, "compass", alone, run("compass+gyro"))[0] == "understated"
    three = run("compass+gyro+lrf", {"gyro": low, "lrf": high})
    assert verdict_of(told, "compass", three)[1].endswith("the noise of gyro and lrf must be set first")
