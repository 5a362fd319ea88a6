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
