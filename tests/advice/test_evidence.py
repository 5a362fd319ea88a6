"""What looks wrong with a log, and which settings are tried: evidence written by hand."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from locfuse.cli.advice.evidence import Evidence
from locfuse.fusion.checks.finding import Finding
from locfuse.fusion.data import Measurements
from locfuse.fusion.judge.consistency import Consistency, Verdict
from locfuse.fusion.judge.covariance import Honesty
from locfuse.fusion.sensors.lrf import LrfSettings


def doubtful(anees: float, verdict: Verdict = "overstated") -> Evidence:
    """A log whose one run has this ANEES, 0.5 to 2 being chance."""
    made = Evidence.__new__(Evidence)
    vars(made).update(
        honesty={"lrf": Honesty(anees, (0.5, 2.0))},
        consistency={"lrf": Consistency(verdict, "", cures={"lrf.sigma_range": 0.01})},
        compared=SimpleNamespace(evaluations=[SimpleNamespace(name="lrf", figures={"position_rmse_m": 0.1})]),
        trial=SimpleNamespace(configurations={"lrf": SimpleNamespace(sensors=("lrf",))}),
    )
    return made


@pytest.mark.parametrize(("anees", "factors"), [(20.0, {3.0, 10.0}), (0.1, {0.1, 0.3})])
def test_of_a_filter_that_is_too_sure_no_smaller_noise_of_the_wheels_is_tried(
    anees: float, factors: set[float]
) -> None:
    """On one drive chance may make it look better."""
    assert set(doubtful(anees)._noise_factors) == factors


@pytest.mark.parametrize(
    ("anees", "verdict", "too_sure"),
    [(20.0, "overstated", True), (20.0, "understated", False), (1.0, "overstated", False)],
)
def test_a_sensor_is_not_to_be_trusted_more_where_truth_shows_that_it_is_trusted_too_much(
    anees: float, verdict: Verdict, too_sure: bool
) -> None:
    made = doubtful(anees, verdict)
    assert made._too_sure("lrf", made.consistency["lrf"]) == too_sure


def test_what_is_unusual_and_has_no_setting_is_told_all_the_same() -> None:
    made = doubtful(1.0)
    vars(made)["consistency"] = {
        "lrf": Consistency("outliers", "34% of the lines do not fit the map"),
        "compass": Consistency("consistent", ""),
        "camera": Consistency("overstated", "", cures={"camera.sigma_deg": 0.1}),
    }
    vars(made)["_spins"] = []
    (found,) = made.unexplained()
    assert (found.finding.role, found.finding.code) == ("lrf", "outliers")
    assert not found.alternatives
    assert not found.offer


@pytest.mark.parametrize(
    ("verdict", "cures", "nis", "offered"),
    [
        ("correlated", {}, 2.7, True),
        ("correlated", {}, 1.3, False),  # they scatter as their beams say
        ("correlated", {"lrf.sigma_range": 0.05}, 2.7, False),  # a sigma explains it
        ("outliers", {}, 2.7, False),  # people
    ],
)
def test_floors_of_lines_are_tried_where_lines_scatter_more_than_their_beams(
    verdict: Verdict, cures: dict[str, float], nis: float, offered: bool
) -> None:
    made = doubtful(1.0)
    robot = SimpleNamespace(settings=lambda _: LrfSettings())
    compared = SimpleNamespace(loaded=SimpleNamespace(robot=robot), evaluations=[])
    vars(made).update(compared=compared, _own=lambda sensor, fixes: SimpleNamespace(nis=nis))
    found = made._shared_by_lines("lrf", Consistency(verdict, "", cures=cures))
    assert bool(found) == offered
    if found:
        assert found[0].alternatives[1] == ("lrf.floor_range=0.02", "lrf.floor_angle_deg=0.5")
        assert found[0].offer
    assert not made._shared_by_lines("compass", Consistency(verdict, "", cures=cures))


@pytest.mark.parametrize(("others", "decided"), [((), False), (("compass",), False), (("camera",), True)])
def test_a_range_scale_is_only_tried_where_something_else_than_turning_tells(
    others: tuple[str, ...], decided: bool
) -> None:
    made = Evidence.__new__(Evidence)
    columns = Measurements(np.zeros(3), np.arange(4), np.zeros((3, 1)), np.ones((3, 1, 1)), 1.0, np.zeros((1, 1)))
    lines = replace(columns, z=np.zeros((3, 2)), R_unit=np.tile(np.eye(2), (3, 1, 1)), floor=np.zeros((2, 2)))
    measured = {"lrf": lines} | dict.fromkeys(others, columns)
    vars(made)["compared"] = SimpleNamespace(loaded=SimpleNamespace(drive=SimpleNamespace(measurements=measured)))
    found = made._decided(Finding("lrf", "distances", "too long", ("lrf.range_scale=0.95",), True))
    assert bool(found.fixes) == decided
    assert found.message.endswith("Nothing in this log says which") != decided


@pytest.mark.parametrize(
    ("lines", "ranges", "offered"),
    [
        (0.047, 0.034, ("lrf.sigma_range=0.034", "lrf.sigma_angle_deg=0.28")),
        (0.047, 0.050, ()),  # no less than the lines show
        (0.047, 0.020, ()),  # the two do not show the same
        (0.047, None, ()),
    ],
)
def test_a_range_noise_that_is_set_too_high_is_also_tried_as_the_ranges_show_it(
    lines: float, ranges: float | None, offered: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    made, cures = doubtful(1.0), {"lrf.sigma_range": lines, "lrf.sigma_angle_deg": lines / 0.12}
    loaded = SimpleNamespace(
        robot=SimpleNamespace(settings=lambda _: LrfSettings(sigma_range=0.09, sigma_angle_deg=0.75)),
        drive=SimpleNamespace(measurements=("lrf",)),
        stream=lambda _: None,
    )
    vars(made)["compared"] = SimpleNamespace(loaded=loaded)
    monkeypatch.setattr("locfuse.cli.advice.judged.ranges_sigma", lambda *_: ranges)
    assert made._as_ranges_scatter("lrf", Consistency("overstated", "", cures=cures)) == offered
    assert not made._as_ranges_scatter("lrf", Consistency("understated", "", cures=cures))


@pytest.mark.parametrize(("verdict", "tried"), [("consistent", False), ("unclear", True)])
def test_a_sigma_is_not_changed_against_what_the_residuals_show(verdict: Verdict, tried: bool) -> None:
    """One drive's error lies outside its 95 % range once in twenty."""
    made = doubtful(0.2, verdict)
    robot = SimpleNamespace(settings=lambda _: SimpleNamespace(sigma_deg=1.0))
    vars(made).update(
        fixes=(),
        consistency={"compass": Consistency(verdict, "")},
        honesty={"compass": Honesty(0.2, (0.5, 2.0))},
        compared=SimpleNamespace(loaded=SimpleNamespace(robot=robot)),
        trial=SimpleNamespace(configurations={"compass": SimpleNamespace(sensors=("compass",))}),
    )
    assert bool(made._by_anees("compass")) == tried
