"""Which lags are tried: held to what chance does to a lag against wheels that slip."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from locfuse.cli.advice.evidence import Evidence
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
