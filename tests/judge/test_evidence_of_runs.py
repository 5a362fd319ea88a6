"""Who is to blame where runs disagree: what each run says of each sensor is laid by hand."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
import small_drive
from msgspec.structs import replace
from numpy.typing import NDArray

from locfuse.fusion.data import Drive, Estimates, Measurements, Motions, Truth
from locfuse.fusion.judge import consistency
from locfuse.fusion.judge.consistency import Evidence, Run, as_run, judge
from locfuse.fusion.judge.innovations import Heard, Own
from locfuse.fusion.robot import Robot

FINE = Heard(
    readings=400, wild=0.0, bias=0.0, sure=0.01, white=1.0, slow=0.0, spread=1.0, memory=1.0, period=0.1,
    reference=0.01, R=1.0,
)  # fmt: skip
OFF = FINE._replace(bias=2.0)
OWN = Own(
    compared=400, refused=0.0, nis=1.0, bounds=(0.9, 1.1), bias=(0.0,), middle=(0.0,), sure=(0.1,),
    whiteness=(0.0,) * 5, raw=1.0, scale=1.0, white=0.9, share=0.9, R=(1.0,),
)  # fmt: skip
ROBOT: Robot = small_drive.robot()
SENSORS = ("compass", "gyro", "lrf")
N = 30
T: NDArray[np.float64] = np.linspace(0.0, 2.9, N)


def readings(n: int = N) -> Measurements:
    return Measurements(T[:n], np.arange(n + 1), np.zeros((n, 1)), np.ones((n, 1, 1)), 1.0, np.zeros((1, 1)))


def drive(truth: Truth | None = None) -> Drive:
    motions = Motions(np.zeros((N, 3)), np.zeros((N, 3, 3)), np.zeros((N, 3, 0)))
    return Drive(0, T[:N], motions, {s: readings() for s in SENSORS}, {}, {}, truth)


def run(name: str, own: Mapping[str, Own | None] | None = None, truth: Truth | None = None) -> Run:
    """The run of the sensors in its name: "compass+lrf"."""
    sensors = tuple(s for s in name.split("+") if s != "odometry")
    found = drive(truth)
    e = Estimates(name, sensors, found.t, np.zeros((N, 3)), np.zeros((N, 6)), {})
    return Run(found, e, dict.fromkeys(sensors, OWN) | dict(own or {}))


class Told:
    """What runs say of sensors: "run: sensor" -> Heard; nothing of the others."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.said: dict[str, Heard] = {}
        monkeypatch.setattr(consistency, "heard", lambda _, __, e, sensor: self.said.get(f"{e.name}: {sensor}"))


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch) -> Told:
    return Told(monkeypatch)


def names(evidence: Evidence, sensor: str) -> list[str]:
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
    assert names(Evidence(runs, ROBOT), "compass") == ["gyro+lrf", "lrf", "gyro"]
    assert names(Evidence(runs, ROBOT, {"lrf"}), "compass") == ["gyro+lrf", "gyro"]


@pytest.mark.parametrize(
    ("own", "healthy"),
    [
        (OWN._replace(scale=2.24), True),
        (OWN._replace(scale=2.25), False),  # sigma understated by one and a half
        (OWN._replace(refused=0.24), True),
        (OWN._replace(refused=0.25), False),
        (None, False),
    ],
)
def test_a_run_that_understates_noise_or_refuses_much_is_no_reference(
    told: Told, own: Own | None, healthy: bool
) -> None:
    told.said = {"gyro+lrf: compass": FINE}
    evidence = Evidence([run("compass"), run("gyro+lrf", {"lrf": own})], ROBOT)
    assert names(evidence, "compass") == (["gyro+lrf"] if healthy else [])


@pytest.mark.parametrize(("n", "enough"), [(19, False), (20, True)])
def test_twenty_readings_are_enough(told: Told, n: int, enough: bool) -> None:
    told.said = {"lrf: compass": FINE._replace(readings=n)}
    assert bool(names(Evidence([run("compass"), run("lrf")], ROBOT), "compass")) is enough


def flagged(told: Told, said: dict[str, Heard], *runs: str) -> tuple[set[str], set[str]]:
    """The sensors whose mean is off, and those that contradict each other."""
    told.said = said
    evidence = Evidence([run(n) for n in ("odometry", *runs)], ROBOT)
    return set(evidence.flagged), evidence.contradict


def test_of_two_sensors_that_disagree_nobody_knows_which_is_wrong(told: Told) -> None:
    for said in ({"compass: lrf": OFF, "lrf: compass": OFF}, {"compass: lrf": FINE, "lrf: compass": OFF}):
        assert flagged(told, said, "compass", "lrf") == (set(), {"compass", "lrf"})
    assert flagged(told, {"compass: lrf": FINE, "lrf: compass": FINE}, "compass", "lrf") == (set(), set())


def test_a_sensor_that_nobody_can_check_the_other_way_round_is_off(told: Told) -> None:
    """A laser, whose own runs tell of the compass, while none tells of the laser."""
    assert flagged(told, {"lrf: compass": OFF}, "compass", "lrf") == ({"compass"}, set())


def test_of_three_sensors_the_one_with_which_two_disagree_is_off(told: Told) -> None:
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
    evidence = Evidence(runs, ROBOT)
    assert (set(evidence.flagged), evidence.contradict) == ({"compass"}, set())
    assert names(evidence, "lrf") == ["gyro"]


def test_runs_that_were_smoothed_are_no_evidence(told: Told) -> None:
    told.said = {"lrf: compass": OFF}
    smoothed = run("lrf")._replace(estimates=replace(run("lrf").estimates, smoothed=True))
    assert list(judge([run("compass"), smoothed], ROBOT)) == ["compass"]


@pytest.mark.parametrize("name", ["compass", "lrf"])
def test_a_verdict_comes_with_the_figures_of_its_run(told: Told, name: str) -> None:
    told.said = {"lrf: compass": OFF}
    mine = OWN._replace(bounds=(0.5, 2.0), bias=(0.3,), whiteness=(0.4,), refused=0.1)
    runs = [
        run("odometry"),
        run("compass", {"compass": mine}),
        run("lrf", {"lrf": OWN if name == "compass" else None}),
    ]
    found = judge(runs, ROBOT)
    assert found["odometry"] == {}
    figures = found[name][name]
    if name == "compass":
        assert figures.verdict == "biased"
        assert (figures.nis_bounds, figures.bias_sigma, figures.whiteness) == ((0.5, 2.0), (0.3,), (0.4,))
        assert figures.refused == 0.1
        assert "compass.offset_deg" in figures.cures
    else:
        assert (figures.verdict, figures.nis_bounds, figures.refused) == ("unclear", None, None)


def test_contradicting_sensors_name_each_other(told: Told) -> None:
    told.said = {"compass: lrf": OFF, "lrf: compass": OFF}
    found = judge([run("compass"), run("lrf")], ROBOT)
    assert found["compass"]["compass"].words.startswith("compass and lrf contradict")
    assert found["lrf"]["lrf"].words.startswith("lrf and compass contradict")


def verdict_of(told: Told, sensor: str, *runs: Run) -> tuple[str, str]:
    told.said = {}
    found = Evidence(list(runs), ROBOT).finding(sensor)
    return found.verdict, found.words


@pytest.mark.parametrize(("compared", "verdict"), [(19, "unclear"), (20, "consistent")])
def test_without_a_reference_its_own_run_judges_it_by_twenty_readings(
    told: Told, compared: int, verdict: str
) -> None:
    mine = run("compass", {"compass": OWN._replace(compared=compared)})
    found = verdict_of(told, "compass", mine)
    assert found[0] == verdict
    assert verdict == "consistent" or found[1] == "noise cannot be judged: too few measurements"
    assert verdict_of(told, "compass", run("compass", {"compass": None}))[0] == "unclear"


def test_its_own_run_is_the_one_with_the_fewest_others_that_are_healthy(told: Told) -> None:
    """The understated laser spoils the pair, unless the sensor itself is the worst of it."""
    low, high = OWN._replace(scale=4.0), OWN._replace(scale=9.0)
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
    own = {"compass": OWN._replace(compared=3), "gyro": OWN._replace(scale=scale), "lrf": None}
    pair = run("compass+gyro+lrf", own)
    assert ("the noise of gyro" in verdict_of(told, "compass", pair)[1]) is blamed


def test_readings_of_one_instant_are_not_judged(told: Told) -> None:
    mine = run("compass")
    at_once = replace(readings(), t=np.zeros(N))
    mine = mine._replace(drive=replace(mine.drive, measurements={"compass": at_once}))
    assert verdict_of(told, "compass", mine)[0] == "unclear"


def test_a_reference_that_is_too_vague_leaves_the_verdict_to_its_own_run(told: Told) -> None:
    told.said = {"lrf: compass": FINE._replace(reference=9.0), "gyro: compass": FINE._replace(reference=10.0)}
    runs = [run("compass", {"compass": OWN._replace(scale=9.0, raw=9.0)}), run("lrf"), run("gyro")]
    assert Evidence(runs, ROBOT).finding("compass").verdict == "understated"
    told.said = {"lrf: compass": FINE._replace(R=0.01)}
    assert Evidence(runs, ROBOT).finding("compass").scale == pytest.approx(10.0, rel=0.01)


@pytest.mark.parametrize(("bias", "known"), [(2.0, True), (0.4, False), (None, False)])
def test_a_mean_is_known_where_it_is_notable(told: Told, bias: float | None, known: bool) -> None:
    told.said = {"lrf: compass": FINE._replace(bias=bias, sure=9.0)}
    found = Evidence([run("compass"), run("lrf")], ROBOT).bias("compass")
    assert (found is not None) is known
    assert Evidence([run("compass")], ROBOT).bias("compass") is None


# --- a truth as a run


def truth(n: int = N, **changed: object) -> Truth:
    found = Truth("/truth", T[:n], np.zeros((n, 2)), np.zeros(n), (0.0, 0.0), 0.02, 0.03)
    return replace(found, **changed)


def test_what_the_truth_says_goes_before_every_run(told: Told) -> None:
    told.said = {"truth: compass": OFF, "lrf: compass": FINE._replace(reference=1e-6), "lrf: gyro": OFF}
    evidence = Evidence([run("compass", truth=truth()), run("gyro"), run("lrf")], ROBOT)
    assert set(evidence.flagged) == {"compass", "gyro"}
    assert evidence.bias("compass") is not None
    told.said = {"truth: compass": FINE, "lrf: compass": OFF}
    evidence = Evidence([run("compass", truth=truth()), run("lrf")], ROBOT)
    assert not evidence.flagged
    assert evidence.bias("compass") is None
    told.said = {"truth: compass": OFF._replace(readings=19), "lrf: compass": FINE}
    assert not Evidence([run("compass", truth=truth()), run("lrf")], ROBOT).flagged


def test_a_truth_is_a_run_without_sensors_as_certain_as_it_says() -> None:
    found = as_run(drive(truth()), run("odometry").estimates)
    assert found is not None
    assert found.estimates.sensors == ()
    np.testing.assert_allclose(found.estimates.pose, np.zeros((N, 3)))
    np.testing.assert_allclose(found.estimates.triangles, np.tile([0.02**2, 0, 0, 0.02**2, 0, 0.03**2], (N, 1)))


def test_a_truth_counts_between_its_first_and_last_stamp_and_not_in_gaps() -> None:
    t = T[5:25]
    inside = as_run(drive(truth(20, t=t)), run("odometry").estimates)
    assert inside is not None
    assert np.isfinite(inside.estimates.pose[:, 0]).tolist() == [5 <= i <= 24 for i in range(N)]
    assert as_run(drive(truth(t=0.1 * np.arange(N) + 100.0)), run("odometry").estimates) is None
    t = np.append(T[:10], 1.95 + 0.1 * np.arange(10))
    gap = as_run(drive(truth(20, t=t)), run("odometry").estimates)
    assert gap is not None
    assert np.isfinite(gap.estimates.pose[:, 0]).tolist() == [i <= 9 or 20 <= i <= 28 for i in range(N)]


@pytest.mark.parametrize(
    ("x", "y", "turn", "same"),
    [
        (0.3, 0.39, 0.0, True),
        (0.3, 0.41, 0.0, False),
        (0.0, 0.0, 0.34, True),
        (0.0, 0.0, 0.36, False),
        (0.0, 0.0, -0.36, False),
        (0.0, 0.0, 2.0 * np.pi + 0.34, True),
    ],
)
def test_a_truth_in_another_frame_is_none(x: float, y: float, turn: float, same: bool) -> None:
    moved = truth(xy=np.tile([x, y], (N, 1)), theta=np.full(N, turn))
    assert (as_run(drive(moved), run("odometry").estimates) is not None) is same
    assert as_run(drive(truth(19)), run("odometry").estimates) is None
    assert as_run(drive(truth(20)), run("odometry").estimates) is not None
    assert as_run(drive(truth(theta=None)), run("odometry").estimates) is None
