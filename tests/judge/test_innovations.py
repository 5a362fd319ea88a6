"""The figures of innovations, held to the same figures written out with NumPy and SciPy."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from locfuse.fusion.data import VERDICTS, Audit, Measurements
from locfuse.fusion.judge.innovations import (
    MAX_LISTENED_READINGS,
    STRETCH_READINGS,
    Heard,
    _agreement,
    _some,
    own,
    usual_period,
)

Array = NDArray[np.float64]
ACCEPTED, GATE, UNMATCHED, DISTURBED, LOST = (
    VERDICTS.index(v) for v in ("accepted", "gate", "unmatched", "disturbed", "lost")
)
LAGS = 5


def colored(rng: np.random.Generator, n: int, keep: float, d: int = 1) -> Array:
    """Series of unit variance (n, d) whose neighbours correlate by `keep`."""
    out = rng.normal(size=(n, d))
    for k in range(1, n):
        out[k] = keep * out[k - 1] + math.sqrt(1.0 - keep**2) * out[k]
    return out


def audited(
    y: Array, sigma: Array, verdict: NDArray[np.int8], landmark: NDArray[np.int64], gate: float, scale: float = 1.5
) -> tuple[Audit, Measurements]:
    """An audit of innovations y (n, d); R of row i is scale^2 (1 + i / n) + 0.1."""
    n, d = y.shape
    nis = ((y / sigma) ** 2).sum(axis=1)
    row = np.arange(n)[::-1].copy()
    audit = Audit(np.arange(n), row, verdict, landmark, nis, np.full(n, gate), y, sigma)
    unit = (1.0 + np.arange(n) / n)[:, None, None] * np.eye(d)
    return audit, Measurements(np.linspace(0.0, 1.0, n), np.arange(n + 1), y, unit, scale, 0.1 * np.eye(d))


def autocorrelation(series: list[Array], lags: int) -> Array:
    """At lags 1.. of several series (k, d) of one variance, pairs within each."""
    every = np.concatenate(series)
    return np.array(
        [
            (np.concatenate([s[lag:] * s[:-lag] for s in series]).mean(axis=0) / (every**2).mean(axis=0)).mean()
            for lag in range(1, lags + 1)
        ]
    )


def memory(correlation: Array) -> float:
    total = 1.0
    for value in correlation:
        if value < 0.05:
            break
        total += 2.0 * value
    return float(total)


@pytest.mark.parametrize("d", [1, 2])
@pytest.mark.parametrize("keep", [0.0, 0.7])
def test_the_figures_of_a_run_are_those_written_out(d: int, keep: float) -> None:
    """Two landmarks take turns; some readings are refused, lost, or of a disturbed field."""
    n, gate = 900, 12.0
    rng = np.random.default_rng(10 * d)
    landmark = np.arange(n) % 2 + 7
    y = np.empty((n, d))
    for mark in (7, 8):
        y[landmark == mark] = 2.0 * colored(rng, n // 2, keep, d) + 0.4
    sigma = np.full((n, d), 2.2) + 0.3 * rng.random((n, d))
    verdict = np.zeros(n, np.int8)
    verdict[5::40], verdict[7::40], verdict[9::40], verdict[11::40] = GATE, UNMATCHED, DISTURBED, LOST
    verdict[13::80], verdict[15::80] = GATE, UNMATCHED
    for refused in (
        GATE,
        UNMATCHED,
    ):  # every other one lies beyond the gate; the rest is refused for other reasons
        y[np.flatnonzero(verdict == refused)[::2]] += 12.0
    audit, m = audited(y, sigma, verdict, landmark, gate)
    found = own(audit, m)
    assert found is not None

    beyond = audit.nis > gate
    accepted = verdict == ACCEPTED
    compared = accepted | ((verdict == GATE) & beyond)
    refused = np.isin(verdict, (GATE, UNMATCHED, LOST)).sum()
    assert found.compared == compared.sum()
    assert found.refused == refused / (accepted.sum() + refused)
    nis = audit.nis[accepted]
    assert found.nis == pytest.approx(nis.mean() / d)
    far = int((np.isin(verdict, (GATE, UNMATCHED)) & beyond).sum())
    middle = np.sort(np.append(nis, np.full(far, np.inf)))[(len(nis) + far) // 2]
    assert found.raw == pytest.approx(middle / stats.chi2.ppf(0.5, d), rel=1e-6)
    of_nis = [nis[landmark[accepted] == mark][:, None] - nis.mean() for mark in (7, 8)]
    freedom = max(1, round(d * max(1.0, len(nis) / memory(autocorrelation(of_nis, LAGS)))))
    assert found.bounds == pytest.approx(stats.chi2.ppf((0.025, 0.975), freedom) / freedom, rel=1e-3)

    some, unit = y[compared], y[compared] / sigma[compared]
    np.testing.assert_allclose(found.bias, unit.mean(axis=0))
    np.testing.assert_allclose(found.middle, np.median(some, axis=0))
    centred = unit - np.median(unit, axis=0)
    white = autocorrelation([centred[landmark[compared] == mark] for mark in (7, 8)], LAGS)
    np.testing.assert_allclose(found.whiteness, white)
    spread = stats.median_abs_deviation(some, axis=0, scale="normal")
    np.testing.assert_allclose(found.sure, spread * math.sqrt(memory(white) / compared.sum()), rtol=1e-4)

    R = 1.5**2 * (1.0 + audit.row[compared] / n) + 0.1
    np.testing.assert_allclose(found.R, np.full(d, R.mean()))
    ratio = np.median(sigma[compared] ** 2 / R[:, None])
    assert found.share == pytest.approx(1.0 / ratio)
    assert found.white == pytest.approx(max(1.0 / ratio - white[0], 0.0))
    assert found.scale == pytest.approx(found.raw * np.clip(1.0 - white[0] * ratio, 0.3, 2.0))


def test_the_share_of_white_noise_is_never_below_zero_and_the_factor_stays_in_bounds() -> None:
    rng = np.random.default_rng(1)
    for keep, least in ((0.95, 0.3), (-0.95, 2.0)):
        y = 3.0 * colored(rng, 400, keep)
        audit, m = audited(y, np.full((400, 1), 6.0), np.zeros(400, np.int8), np.full(400, -1), 99.0, 0.5)
        found = own(audit, m)
        assert found is not None
        assert found.scale / found.raw == pytest.approx(least)
        assert bool(found.white) is (keep < 0.0)


@pytest.mark.parametrize(("n", "known"), [(2 * LAGS - 1, False), (2 * LAGS, True)])
def test_figures_need_twice_as_many_readings_as_lags(n: int, known: bool) -> None:
    y = np.random.default_rng(2).normal(size=(n, 1))
    audit, m = audited(y, np.ones((n, 1)), np.zeros(n, np.int8), np.full(n, -1), 99.0)
    assert (own(audit, m) is not None) is known


def test_where_most_lie_beyond_the_gate_the_factor_has_no_bound() -> None:
    y = np.append(np.random.default_rng(3).normal(size=20), np.full(21, 50.0))[:, None]
    verdict = np.append(np.zeros(20, np.int8), np.full(21, GATE, np.int8)).astype(np.int8)
    found = own(*audited(y, np.ones((41, 1)), verdict, np.full(41, -1), 9.0))
    assert found is not None
    assert math.isinf(found.raw)
    one_less = own(*audited(y[:-2], np.ones((39, 1)), verdict[:-2], np.full(39, -1), 9.0))
    assert one_less is not None
    assert math.isfinite(one_less.raw)


def test_landmarks_of_any_number_are_told_apart() -> None:
    rng = np.random.default_rng(4)
    n = 400
    y = colored(rng, n, 0.8)
    for marks in ((-40_000, 1), (1, 40_000), (2**15, -(2**15)), (2**15 - 1, -(2**15)), (0, 2**16)):
        mark = np.where(np.arange(n) < n // 2, *marks)
        order = np.argsort(np.arange(n) % (n // 2), kind="stable")  # they take turns
        audit, m = audited(y[order], np.ones((n, 1)), np.zeros(n, np.int8), mark[order], 99.0)
        found = own(audit, m)
        assert found is not None
        assert found.whiteness[0] == pytest.approx(0.8, abs=0.1)


def test_the_usual_period_is_between_instants() -> None:
    assert usual_period(np.array([0.0, 0.0, 0.5, 0.5, 1.0, 1.5, 9.0])) == 0.5
    assert usual_period(np.zeros(4)) is None


def agreed(t: NDArray[Any], y: Array, h: Array, R: Array, unknown: bool = False, angular: bool = False) -> Heard:
    found = _agreement(np.column_stack((t, y, h, R)), unknown, angular)
    assert found is not None
    return found


@pytest.mark.parametrize("angular", [False, True])
@pytest.mark.parametrize("keep", [0.0, 0.9])
def test_what_a_run_that_does_not_use_a_sensor_says_of_it(keep: float, angular: bool) -> None:
    rng = np.random.default_rng(5)
    n = 500
    t = 0.2 * np.arange(n)
    y = 0.05 * colored(rng, n, keep)[:, 0] + 3.1  # as an angle next to where they wrap
    wild = np.zeros(n, bool)
    wild[::50] = True
    y[wild] += 2.0
    seen = np.angle(np.exp(1j * y)) if angular else y
    h, R = 0.01 + 0.001 * rng.random(n), 0.002 + 0.001 * rng.random(n)
    found = agreed(t, seen, h, R, angular=angular)
    tame = ~wild
    some = y[tame]
    assert found.readings == tame.sum()
    assert found.wild == pytest.approx(10 / n)
    assert found.bias == pytest.approx(some.mean() if not angular else math.remainder(some.mean(), 2 * math.pi))
    variance = some.var()
    assert found.spread == pytest.approx(variance)
    near = np.diff(t[tame]) < 0.3
    new = 0.5 * (np.diff(some)[near] ** 2).mean()
    assert found.white == pytest.approx(new)
    assert found.slow == pytest.approx(variance - new)
    centred, times = some - some.mean(), t[tame]
    correlation = []
    for lag in range(1, STRETCH_READINGS):
        close = times[lag:] - times[:-lag] < (lag + 0.5) * 0.2
        if not close.any():
            break
        correlation.append((centred[lag:] * centred[:-lag])[close].mean() / variance)
    assert found.memory == pytest.approx(memory(np.array(correlation)))
    assert found.sure == pytest.approx(math.sqrt(variance * found.memory / tame.sum() + h[tame].mean()))
    assert found.period == pytest.approx(0.2)
    assert found.reference == pytest.approx(h[tame].mean())
    assert pytest.approx(R[tame].mean()) == found.R


def test_a_reading_is_an_outlier_from_six_sigmas_on() -> None:
    """By the median: of readings at -1 and 1 the sigma is 1 / 0.6745."""
    for far, wild in ((5.9 / 0.6745, 0), (6.1 / 0.6745, 2)):
        y = np.append(np.tile([-1.0, 1.0], 50), [0.0, far, -far])
        found = agreed(0.1 * np.arange(103), y, np.zeros(103), np.ones(103))
        assert found.readings == 103 - wild


def test_a_bias_is_none_where_the_sensor_has_an_offset_of_its_own() -> None:
    y = np.random.default_rng(6).normal(size=50)
    assert agreed(np.arange(50.0), y, np.zeros(50), np.ones(50), unknown=True).bias is None
    assert _agreement(np.column_stack((np.zeros(50), y, y, y)), False, False) is None


def test_neighbours_over_a_gap_are_no_neighbours() -> None:
    """Two stretches, each constant: across the gap between them their error changes, and nowhere else."""
    t = np.append(0.1 * np.arange(50), 60.0 + 0.1 * np.arange(50))
    y = np.repeat([0.0, 1.0], 50)
    found = agreed(t, y, np.zeros(100), np.ones(100))
    assert found.white == 0.0
    assert found.slow == pytest.approx(0.25)


def test_of_many_readings_some_stretches_of_neighbours_are_heard() -> None:
    np.testing.assert_array_equal(_some(MAX_LISTENED_READINGS), np.arange(MAX_LISTENED_READINGS))
    found = _some(MAX_LISTENED_READINGS + 1)
    assert found[0] == 0
    assert found[-1] == MAX_LISTENED_READINGS
    stretches = _some(100_000).reshape(-1, STRETCH_READINGS)
    assert len(stretches) == MAX_LISTENED_READINGS // STRETCH_READINGS
    assert (np.diff(stretches, axis=1) == 1).all()
    assert stretches[-1, -1] == 99_999
    starts = np.diff(stretches[:, 0])
    assert starts.max() - starts.min() <= 1
