"""The noise that ranges show by themselves, held to walls in closed form with noise that was drawn."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest
from commands import locfuse
from scan_streams import scan_stream

from locfuse.fusion.checks import laser
from locfuse.fusion.checks.laser import of_scatter, ranges_sigma, scatter_more
from locfuse.fusion.data import Array, Ragged
from locfuse.fusion.lines.scans import MAX_BEAMS
from locfuse.fusion.sensors.lrf import Lrf, LrfSettings

BEAMS, SCANS = 360, 30
SCAN = "sensor_msgs/msg/LaserScan"
ANGLES = np.arange(BEAMS) * (2.0 * np.pi / BEAMS) - np.pi
NORMALS, DISTANCES = np.radians([0.0, 90.0, 180.0, 270.0]) + 0.2, np.array([2.5, 1.5, 3.0, 2.0])


def room() -> Array:
    """The ranges (SCANS, BEAMS) of a closed room: to the nearest of four walls."""
    cos = np.cos(ANGLES[:, None] - NORMALS)
    return np.tile(np.where(cos > 1e-3, DISTANCES / np.maximum(cos, 1e-3), np.inf).min(axis=1), (SCANS, 1))


def said(ranges: Array, **settings: Any) -> float | None:
    """The sigma that is suggested, None where nothing is said."""
    found = of_scatter(scan_stream(range(len(ranges)), ranges), LrfSettings(**settings))
    return float(found[0].fixes[0].removeprefix("lrf.sigma_range=")) if found else None


def noise(sigma: float) -> Array:
    return sigma * np.random.default_rng(3).normal(size=(SCANS, BEAMS))


@pytest.mark.parametrize("sigma", [0.01, 0.03, 0.05])
def test_a_noise_that_is_set_too_low_is_named_with_the_one_that_was_drawn(sigma: float) -> None:
    assert said(room() + noise(sigma), sigma_range=sigma / 2.0) == pytest.approx(sigma, rel=0.12)


def test_a_noise_that_is_right_or_too_high_is_not_mentioned() -> None:
    for configured in (0.03, 0.05):
        assert said(room() + noise(0.03), sigma_range=configured) is None


@pytest.mark.parametrize(("sigma", "more"), [(0.02, True), (0.028, False), (0.04, False)])
def test_a_smaller_sigma_is_contradicted_by_the_ranges(sigma: float, more: bool) -> None:
    ranges = room() + noise(0.03)
    assert scatter_more(ranges_sigma(scan_stream(range(SCANS), ranges), LrfSettings()), sigma) == more


def test_walls_without_noise_leave_nothing_however_they_lie() -> None:
    assert said(room(), sigma_range=1e-6) is None


def test_rounded_ranges_and_clutter_tell_no_noise() -> None:
    assert said(np.round(room() / 0.05) * 0.05, sigma_range=0.005) is None
    rng = np.random.default_rng(4)
    leaves = np.minimum(rng.exponential(0.3, (SCANS, BEAMS)), 1.0)
    some = rng.random((SCANS, BEAMS)) < 0.3
    assert said(room() - leaves, sigma_range=0.01) is None
    assert said(room() + noise(0.005) - some * leaves, sigma_range=0.001) is None


def test_info_names_the_noise_of_a_recorded_laser() -> None:
    """The sample's is 0.03 m."""
    told = locfuse("info", "rounded_triangle", "--set", "lrf.sigma_range=0.01")
    assert "fix: --set lrf.sigma_range=0.034" in told.stdout
    assert "scatter" not in locfuse("info", "rounded_triangle").stdout


def test_scans_of_more_beams_than_a_laser_has_are_not_looked_at() -> None:
    """38 of 40 scans have a million beams: a log of 0.2 MB, and 1.7 GiB where they all are put together."""
    lengths = np.full(40, MAX_BEAMS + 1)
    lengths[[3, 7]] = 5
    values = np.broadcast_to(np.float32(1.0), (int(lengths.sum()),))
    columns: dict[str, Any] = {name: np.zeros(40, np.float32) for name in Lrf.reads[SCAN] if name != "ranges"}
    columns["ranges"] = Ragged(values, np.append(0, np.cumsum(lengths)))

    class Stream:
        msgtype = SCAN

        def blocks(self, *_: str, rows: int) -> Any:
            yield np.arange(40), columns

    ((rows, kept),) = laser._first(cast("Any", Stream()))
    assert rows.tolist() == [3, 7]
    assert kept["ranges"].lengths.tolist() == [5, 5]
    assert {len(v) for k, v in kept.items() if k != "ranges"} == {2}
