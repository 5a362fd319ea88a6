"""Intervals from correlated errors, figure by figure against the same written out with NumPy and SciPy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from locfuse.fusion.judge.bootstrap import (
    RESAMPLES,
    Errors,
    _correlation,
    block_means,
    by_chance,
    effective_samples,
)

Array = NDArray[np.float64]


def colored(seed: int, q: int, keep: float) -> Array:
    rng = np.random.default_rng(seed)
    out = rng.normal(size=(q, 2))
    for k in range(1, q):
        out[k] += keep * out[k - 1]
    return out


@pytest.mark.parametrize("q", [1, 2, 3, 50, 64, 65])
@pytest.mark.parametrize("keep", [-0.5, 0.0, 0.8, 1.0])
def test_effective_samples_are_by_the_autocorrelation_up_to_its_first_negative(q: int, keep: float) -> None:
    for seed in range(3):
        deviation = colored(seed, q, keep)
        lags = [sum(float(np.dot(c[lag:], c[: q - lag])) for c in deviation.T) for lag in range(q)]
        total = 0.0
        for value in lags[1:]:
            if value <= 0.0:
                break
            total += value / lags[0]
        assert effective_samples(deviation) == pytest.approx(max(1.0, q / (1.0 + 2.0 * total)))


def test_errors_that_are_zero_are_independent() -> None:
    assert effective_samples(np.zeros((7, 2))) == 7.0


@pytest.mark.parametrize("block", [1, 7, 40, 60])
def test_block_means_are_of_blocks_that_wrap_around_the_end(block: int) -> None:
    values = np.random.default_rng(1).normal(size=(2, 60))
    count = math.ceil(60 / block)
    starts = np.random.default_rng(1).integers(0, 60, size=(RESAMPLES, count))
    at = (starts[:, :, None] + np.arange(block)) % 60
    np.testing.assert_allclose(block_means(values, block), values[:, at].mean(axis=(2, 3)).T, atol=1e-12)


@pytest.mark.parametrize(
    ("q", "keep", "block"),
    [
        (40, 1.0, 40),  # an error that stays: the drive is one block
        (1000, 0.0, None),
        (1000, 0.9, None),
    ],
)
def test_blocks_are_twice_as_long_as_errors_last(q: int, keep: float, block: int | None) -> None:
    deviation = np.stack((colored(1, q, keep) if block is None else np.full((q, 2), 0.3), colored(2, q, 0.0)))
    found = Errors.of(deviation)
    samples = [effective_samples(d) for d in deviation]
    assert found.samples.tolist() == samples
    expected = max(math.ceil(q / 200), min(q, math.ceil(2.0 * q / min(samples))))
    assert found.block == (expected if block is None else block)
    squares = (deviation**2).sum(axis=2)
    np.testing.assert_allclose(found.ln_rmse, 0.5 * np.log(squares.mean(axis=1)))
    np.testing.assert_allclose(found.resampled, 0.5 * np.log(block_means(squares, found.block)))


def test_no_more_than_two_hundred_blocks_are_drawn() -> None:
    alternating = np.tile([[1.0, 1.0], [-1.0, -1.0]], (500, 1))  # worth as many samples as there are: 1000
    assert Errors.of(alternating[None]).block == 5


def test_an_error_of_nothing_has_a_finite_logarithm() -> None:
    found = Errors.of(np.zeros((1, 10, 2)))
    assert found.ln_rmse.tolist() == pytest.approx([math.log(1e-9)])


@pytest.mark.parametrize("mixed", [0.0, 0.4, 0.99, -0.9])
def test_a_correlation_counts_as_far_as_so_few_samples_support_it(mixed: float) -> None:
    """By Fisher's z, of two numbers a sample; about zero, so that a common offset correlates."""
    a, b = colored(3, 200, 0.0), colored(4, 200, 0.5)
    b = mixed * a + math.sqrt(1.0 - mixed**2) * b + 0.1
    found = Errors.of(np.stack((a, b)))
    r = float((a * b).sum() / math.sqrt((a * a).sum() * (b * b).sum()))
    n = 2.0 * found.samples.min()
    z = max(abs(math.atanh(r)) - 1.0 / math.sqrt(n - 3.0), 0.0)
    np.testing.assert_allclose(found.correlation, [[1.0, math.tanh(z)], [math.tanh(z), 1.0]], atol=1e-9)


@pytest.mark.parametrize(("samples", "known"), [(1.5, False), (1.6, True), (2.5, True)])
def test_three_numbers_and_fewer_support_no_correlation(samples: float, known: bool) -> None:
    same = np.tile(colored(5, 20, 0.0), (2, 1, 1))
    found = _correlation(same, np.array([samples, 9.0]))
    assert bool(found[0, 1] > 0.5) is known
    np.testing.assert_array_equal(np.diag(found), 1.0)


def errors(resampled: Array, samples: tuple[float, ...] = (1e6, 1e6), r: float = 0.0) -> Errors:
    k = len(samples)
    correlation = np.full((k, k), r)
    np.fill_diagonal(correlation, 1.0)
    return Errors(np.zeros((k, 4, 2)), np.zeros(k), np.array(samples), correlation, resampled, 1)


def test_the_interval_is_that_of_the_bootstrap_where_it_is_wider() -> None:
    drawn = np.linspace(-3.0, 5.0, RESAMPLES)
    found = errors(np.column_stack((drawn, np.zeros(RESAMPLES)))).interval(np.array([1.0, -1.0]))
    assert found == pytest.approx((-3.0 + 0.2, 5.0 - 0.2))


@pytest.mark.parametrize("samples", [(4.0, 4.0), (3.0, 50.0)])
@pytest.mark.parametrize("r", [0.0, 0.7])
def test_the_interval_is_never_narrower_than_that_of_so_many_gaussian_pairs(
    samples: tuple[float, float], r: float
) -> None:
    """Var ln(rms) = 1 / 2n each, less what they share; Student's quantile by Welch and Satterthwaite, less one."""
    n = 2.0 * np.array(samples)
    variance = 0.5 * (1 / n[0] + 1 / n[1] - 2.0 * r**2 / math.sqrt(n[0] * n[1]))
    freedom = (1 / n).sum() ** 2 / (1 / n**3).sum()
    half = math.asinh(stats.t.ppf(0.975, freedom - 1.0) * math.sqrt(variance))
    found = errors(np.zeros((RESAMPLES, 2)), samples, r).interval(np.array([1.0, -1.0]))
    assert found == pytest.approx((-half, half), rel=1e-4)
    assert errors(np.zeros((RESAMPLES, 2)), samples, r).interval(np.zeros(2)) == (0.0, 0.0)


def test_of_one_sample_students_freedom_is_one() -> None:
    half = math.asinh(stats.t.ppf(0.975, 1.0) * math.sqrt(0.25))
    found = errors(np.zeros((RESAMPLES, 1)), (1.0,)).interval(np.array([1.0]))
    assert found == pytest.approx((-half, half), rel=1e-3)


@pytest.mark.parametrize("move", [0.0, 0.2, 1.5])
@pytest.mark.parametrize("n", [1.0, 2.0, 7.0])
def test_chance_is_that_of_gaussian_moves_of_equal_errors(move: float, n: float) -> None:
    moved = 1.0 + move * np.random.default_rng(5).normal(size=(400_000, round(n)))
    expected = np.percentile(-0.5 * np.log((moved**2).mean(axis=1)), (2.5, 97.5))
    np.testing.assert_allclose(by_chance(move, n), expected, rtol=0.05, atol=0.01)
