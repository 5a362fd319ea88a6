"""Which lags are tried: held to what chance does to a lag against wheels that slip."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import pytest

from locfuse.cli.advice import evidence as module
from locfuse.cli.advice.evidence import Evidence
from locfuse.fusion.doctor.finding import Finding
from locfuse.fusion.doctor.lag import Lag

SIGMA_S = 0.004


def evidence(*offsets: float) -> Evidence:
    """Sensors whose turning lags the wheels' by these times [s], each known to 4 ms."""
    names = ("compass", "lrf", "gyro")
    found = {name: Lag(s, 0.998, 0.99, SIGMA_S) for name, s in zip(names, offsets, strict=False)}
    robot = SimpleNamespace(
        wheels=SimpleNamespace(time_offset=0.0), settings=lambda _: SimpleNamespace(time_offset=0.0)
    )
    made = Evidence.__new__(Evidence)
    vars(made).update(
        _by_wheels=found,
        compared=SimpleNamespace(loaded=SimpleNamespace(robot=robot)),
        trial=SimpleNamespace(configurations={n: SimpleNamespace(sensors=(n,)) for n in names}),
    )
    return made


@pytest.mark.parametrize(
    ("sigmas", "others", "offered"),
    [
        ((3.5, 3.2), 1.0, False),
        ((4.5, 3.2), 1.0, True),
        ((3.5, 0.0), 1.0, True),
        ((3.5, 3.2), 3.0, True),
        ((3.5,), 1.0, True),
        ((2.4,), 1.0, False),
    ],
)
def test_a_lag_that_another_sensor_shares_is_tried_from_four_sigma_on(
    sigmas: tuple[float, ...], others: float, offered: bool
) -> None:
    """Slips pull both alike; a sensor whose own lag is three times as vague (`others`) says nothing of that."""
    made = evidence(*(-s * SIGMA_S for s in sigmas))
    vague = {
        name: lag._replace(sigma=others * SIGMA_S) for name, lag in made._by_wheels.items() if name != "compass"
    }
    vars(made)["_by_wheels"] = {**made._by_wheels, **vague}
    assert any(finding.role == "compass" for finding, _ in made._late_by_wheels()) == offered


@pytest.mark.parametrize(("sigmas", "offered"), [(3.0, False), (5.0, True)])
def test_slips_pull_all_sensors_alike_so_that_three_lags_are_no_surer_than_one(
    sigmas: float, offered: bool
) -> None:
    """A mean of three independent lags of three sigma would be 5.2 sigma; one ground moved them all."""
    found = list(evidence(*(-sigmas * SIGMA_S,) * 3)._late_wheels())
    assert bool(found) == offered
    assert all(fix == "wheels.time_offset=0.020" for _, tries in found for fixes in tries for fix in fixes)


def test_sensors_that_are_late_by_different_times_do_not_accuse_the_wheels() -> None:
    assert not list(evidence(-0.02, -0.04, -0.06)._late_wheels())


WHEELS_LATE, LASER_LATE = Finding("wheels", "lag", "late"), Finding("lrf", "lag", "late")


@pytest.mark.parametrize(
    ("open_findings", "sigma", "used"),
    [
        ((), 0.002, True),
        ((), 0.006, False),  # the lines tell it better
        ((LASER_LATE,), 0.002, True),
        ((replace(LASER_LATE, severe=True),), 0.002, False),
        ((WHEELS_LATE,), 0.002, False),
        ((replace(WHEELS_LATE, code="track"),), 0.002, True),
    ],
)
def test_the_laser_s_own_run_tells_its_clock_only_while_no_other_clock_looks_wrong(
    monkeypatch: pytest.MonkeyPatch, open_findings: tuple[Finding, ...], sigma: float, used: bool
) -> None:
    """The run goes by the wheels too: on a real log whose wheels are 0.13 s early it was 0.014 s early itself."""
    by_lines, by_run = Lag(-0.01, 0.99, 0.98, 0.005), Lag(-0.02, 0.999, 0.99, sigma)
    monkeypatch.setattr(module, "lags_by_truth", lambda *_: {"lrf": by_lines})
    monkeypatch.setattr(module, "lag_of_run", lambda *_: by_run)
    made, run = Evidence.__new__(Evidence), SimpleNamespace(sensors=("lrf",), smoothed=False, lost=())
    loaded = SimpleNamespace(drive=SimpleNamespace(truth=None))
    vars(made).update(doctor=list(open_findings), compared=SimpleNamespace(loaded=loaded, estimates=[run]))
    assert made._lags_by_truth() == {"lrf": by_run if used else by_lines}
