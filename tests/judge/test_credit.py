"""Credit, intervals and verdicts, held to brute force, closed forms and drives whose answer is known."""

import math
from functools import cache
from itertools import permutations
from typing import Any

import numpy as np
import pytest
import small_drive
from present import present
from scipy import stats
from textbook import correlated

from locfuse.cli.analysis.verdicts import _by_itself, credit_values, verdicts
from locfuse.fusion.data import Array, Evaluation
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.bootstrap import RESAMPLE_COUNT, Errors, block_means, by_chance, effective_samples
from locfuse.fusion.judge.credit import (
    Credit,
    Effect,
    _Book,
    credit,
    credit_over_logs,
    shapley_steps,
    subsets,
    verdict,
)
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.judge.without_truth import Score

SENSORS = ("compass", "lrf")
HELP = {"helps", "seems to help"}  # one short drive seldom proves it


@cache
def credit_of(seed: int, noise_deg: float = 1.0, bias_deg: float = 0.0, **compass: float) -> Credit:
    robot = small_drive.robot(compass=compass)
    drive = small_drive.drive(seed, robot, laps=0.7, compass_noise_deg=noise_deg, compass_bias_deg=bias_deg)
    judged = {frozenset(s): evaluate(fuse(drive, robot, s), drive) for s in subsets(SENSORS)}
    return present(credit(judged, SENSORS))


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_shapley_steps_are_the_mean_over_all_orders_of_adding(n: int) -> None:
    rng = np.random.default_rng(n)
    sensors = [f"s{i}" for i in range(n)]
    value = {frozenset(s): float(v) for s, v in zip(subsets(sensors), rng.normal(size=2**n), strict=True)}
    for sensor in sensors:
        gains = []
        for order in permutations(sensors):
            before = frozenset(order[: order.index(sensor)])
            gains.append(value[before] - value[before | {sensor}])
        found = sum(s.weight * (value[s.before] - value[s.after]) for s in shapley_steps(sensor, sensors))
        assert found == pytest.approx(np.mean(gains), abs=1e-12)


def test_a_drive_counts_as_many_samples_as_its_most_lasting_error() -> None:
    judged = of_sets(*subsets(SENSORS), laps=0.7)
    each = [effective_samples(e.deviation) for e in judged.values()]
    assert min(each) < 0.8 * max(each)
    assert present(credit(judged, SENSORS)).effective_samples == pytest.approx(min(each))


def test_credits_sum_to_what_all_sensors_bought() -> None:
    found = credit_of(1)
    assert found.complete
    credits_ = [present(c.credit).value for c in found.sensors.values()]
    assert sum(credits_) == pytest.approx(present(found.total), abs=1e-12)
    assert sum(present(c.share) for c in found.sensors.values()) == pytest.approx(1.0, abs=1e-12)


def test_the_interval_of_a_ratio_contains_the_truth_as_often_as_it_says() -> None:
    rng = np.random.default_rng(5)
    inside = 0
    for _ in range(100):
        common, own = correlated(rng, 300, 0.8, 2), 0.5 * correlated(rng, 300, 0.8, 2)
        errors = Errors.of(np.stack((common, 0.6 * common + own)))
        low, high = errors.interval(np.array([1.0, -1.0]))
        truth = -0.5 * math.log(0.6**2 + 0.5**2)
        inside += low <= truth <= high
    assert inside >= 90  # 95 expected; 2.2 sigma below


NOTHING = {"noise_deg": 180.0, "sigma_deg": 180.0}  # noise that carries nothing
BIASED = {"noise_deg": 0.5, "bias_deg": 5.0, "sigma_deg": 1.0, "offset_deg": 0.0}  # and claims to be good


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    ("compass", "verdicts"),
    [({}, HELP), (NOTHING, {"no effect seen"}), (BIASED, {"hurts"})],
    ids=["good", "empty", "biased"],
)
def test_a_sensor_gets_its_verdict(compass: dict[str, float], verdicts: set[str], seed: int) -> None:
    found = credit_of(seed, **compass)
    assert found.sensors["compass"].verdict in verdicts
    assert found.sensors["lrf"].verdict in HELP


def of_sets(*sets: tuple[str, ...], **how: Any) -> dict[frozenset[str], Evaluation]:
    """The errors of one drive with these sets of sensors."""
    robot = small_drive.robot()
    drive = small_drive.drive(1, robot, **how)
    return {frozenset(s): evaluate(fuse(drive, robot, s), drive) for s in sets}


def test_without_every_subset_only_the_effect_alone_is_known_and_without_truth_none() -> None:
    found = present(credit(of_sets((), ("compass",), ("lrf",)), SENSORS))
    assert not found.complete
    lrf = found.sensors["lrf"]
    assert (lrf.credit, lrf.last, lrf.alone is None) == (None, None, False)
    assert credit(of_sets((), ("compass",), truth=False), ("compass",)) is None


@pytest.mark.parametrize(
    ("sets", "beside", "words"),
    [
        ((("lrf",), ("compass", "lrf")), {"compass": ("lrf",), "lrf": None}, "Beside lrf: "),
        (((), ("compass",), ("compass", "lrf")), {"compass": (), "lrf": ("compass",)}, "Alone: "),
        (((), ("compass", "lrf")), {"compass": None, "lrf": None}, "No two configurations differ by it alone"),
        (((), ("compass",)), {"compass": ()}, "Alone: "),
    ],
)
def test_a_sensor_is_judged_by_sets_that_differ_by_it_alone_and_not_at_all_where_there_are_none(
    sets: tuple[tuple[str, ...], ...], beside: dict[str, tuple[str, ...] | None], words: str
) -> None:
    judged = of_sets(*sets)
    found = present(credit(judged, SENSORS))
    assert list(found.sensors) == list(beside)
    for sensor, others in beside.items():
        if others is None:
            assert found.sensors[sensor].verdict == "no verdict"
            continue
        pair = frozenset(others), frozenset((*others, sensor))
        before, after = (present(judged[s].figures["position_rmse_m"]) for s in pair)
        assert present(found.sensors[sensor].alone).value == pytest.approx(math.log(before / after))
        assert found.sensors[sensor].beside == others
    assert verdicts(found, [], {})["compass"]["words"].startswith(words)


def test_over_several_logs_the_interval_is_students() -> None:
    drives = [credit_of(seed) for seed in range(4)]
    found = credit_over_logs(drives)
    values = [d.sensors["lrf"].credit.value for d in drives if d.sensors["lrf"].credit]
    effect = present(found.sensors["lrf"].credit)
    low, high = stats.t.interval(0.95, 3, loc=np.mean(values), scale=stats.sem(values))
    assert (effect.low, effect.high) == pytest.approx((low, high), rel=1e-4)
    assert (found.logs, found.effective_samples) == (4, 4)


@pytest.mark.parametrize("drives", [2, 3])
def test_over_fewer_than_four_logs_there_is_no_interval_and_nothing_is_sure(drives: int) -> None:
    found = credit_over_logs([credit_of(seed) for seed in range(drives)])
    effect = present(found.sensors["lrf"].credit)
    assert math.isnan(effect.low)
    assert math.isnan(effect.high)
    assert found.sensors["lrf"].verdict == "seems to help"
    assert credit_values(found)["sensors"]["lrf"]["credit"]["low"] is None
    words = verdicts(found, [], {})["lrf"]["words"]
    assert not {word for word in ("plausible", "nan") if word in words}
    assert f"Not proven by {drives} drives." in words


@pytest.mark.parametrize(
    ("value", "low", "high", "expected", "anees", "word"),
    [
        (0.7, 0.3, 1.1, 0.8, None, "helps"),
        (0.7, -0.3, 1.7, 0.8, None, "seems to help"),  # not sure, but the filter's covariance says the same
        (-0.7, -1.7, 0.3, 0.8, None, "seems to hurt"),
        (0.7, -0.3, 1.7, 0.0, (1.0, 103.0), "seems to help"),  # an inconsistent covariance has no veto
        (0.7, -0.3, 1.7, 0.0, None, "no effect seen"),  # not sure, and nobody else says so
        (0.01, 0.005, 0.015, 0.5, None, "no effect seen"),  # sure, and too small to matter
        (0.3, 0.1, 0.5, 0.05, None, "no effect seen"),  # surprising: the filter took next to nothing from it
        (0.3, 0.2, 0.4, 0.05, None, "helps"),  # surprising, and beyond doubt
        (-0.7, -1.1, -0.3, 0.8, None, "hurts"),
        (-1.9, -10.0, 3.1, None, None, "no effect seen"),  # 22000 times larger to 22 times smaller
        (0.4, 0.2, 0.9, 2.0, (1.0, 200.0), "helps"),  # overconfident is a remark of its own, no harm
        (3.0, 2.0, 4.0, 3.0, (1.0, 26.0), "helps"),  # the paper's frozen map: overconfident, but far better
    ],
)
def test_verdicts(
    value: float, low: float, high: float, expected: float, anees: tuple[float, float] | None, word: str
) -> None:
    assert verdict(Effect(value, low, high, expected), None, None, anees) == word


def known(anees: tuple[float | None, ...] = (None,) * 4, predicted: Array | None = None) -> _Book:
    """All sets of two sensors with errors 0.8, 0.4, 0.2 and 0.1 m that many independent samples back."""
    sets = [frozenset(s) for s in subsets(SENSORS)]
    ln = np.log([0.8, 0.4, 0.2, 0.1])
    rest = np.eye(4), np.tile(ln, (50, 1)), 1
    return _Book(sets, Errors(np.zeros((4, 9, 2)), ln, np.full(4, 1e9), *rest), predicted, list(anees))


def test_an_effect_says_what_the_filter_expected_of_it() -> None:
    predicted = np.log([0.8, 0.5, 0.25, 0.1])
    found = known(predicted=predicted).sensor("compass", SENSORS)
    alone, last = present(found.alone), present(found.last)
    assert (alone.value, alone.expected) == pytest.approx((math.log(2.0), math.log(1.6)))
    assert (last.value, last.expected) == pytest.approx((math.log(2.0), math.log(2.5)))
    assert present(found.credit).expected == pytest.approx(0.5 * (math.log(1.6) + math.log(2.5)))
    assert found.share == pytest.approx(1.0 / 3.0)
    alone = present(known().sensor("compass", SENSORS).alone)
    assert alone.expected is None
    assert (alone.low, alone.high) == pytest.approx((alone.value, alone.value), abs=1e-3)


def test_a_set_better_off_without_a_sensor_is_hurt_and_nothing_compared_is_no_verdict() -> None:
    helps, hurts = Effect(0.9, 0.5, 1.3, 1.0), Effect(-0.4, -0.6, -0.2, 0.0)
    assert verdict(helps, helps, hurts, None) == "hurts"
    assert verdict(None, None, None, (1.0, 100.0)) == "no verdict"


# --- intervals from correlated errors, figure by figure against the same written out with NumPy and SciPy


def colored(seed: int, q: int, keep: float) -> Array:
    return correlated(np.random.default_rng(seed), q, keep, 2)


@pytest.mark.parametrize("q", [1, 2, 3, 50, 64, 65])
@pytest.mark.parametrize("keep", [-0.5, 0.0, 0.8, 0.999])
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


def test_errors_of_nothing_are_independent_with_a_finite_logarithm() -> None:
    assert effective_samples(np.zeros((7, 2))) == 7.0
    found = Errors.of(np.zeros((1, 10, 2)))
    assert found.ln_rmse.tolist() == pytest.approx([math.log(1e-9)])


@pytest.mark.parametrize("block", [1, 7, 40, 60])
def test_block_means_are_of_blocks_that_wrap_around_the_end(block: int) -> None:
    values = np.random.default_rng(1).normal(size=(2, 60))
    count = math.ceil(60 / block)
    starts = np.random.default_rng(1).integers(0, 60, size=(RESAMPLE_COUNT, count))
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


def errors(resampled: Array, samples: tuple[float, ...] = (1e6, 1e6), r: float = 0.0) -> Errors:
    k = len(samples)
    correlation = np.full((k, k), r)
    np.fill_diagonal(correlation, 1.0)
    return Errors(np.zeros((k, 4, 2)), np.zeros(k), np.array(samples), correlation, resampled, 1)


def test_the_interval_is_the_wider_of_the_bootstrap_and_students_whose_freedom_is_one_at_least() -> None:
    drawn = np.linspace(-3.0, 5.0, RESAMPLE_COUNT)
    found = errors(np.column_stack((drawn, np.zeros(RESAMPLE_COUNT)))).interval(np.array([1.0, -1.0]))
    assert found == pytest.approx((-3.0 + 0.2, 5.0 - 0.2))
    half = math.asinh(stats.t.ppf(0.975, 1.0) * math.sqrt(0.25))
    found = errors(np.zeros((RESAMPLE_COUNT, 1)), (1.0,)).interval(np.array([1.0]))
    assert found == pytest.approx((-half, half), rel=1e-3)


@pytest.mark.parametrize("samples", [(4.0, 4.0), (3.0, 50.0)])
@pytest.mark.parametrize("r", [0.0, 0.7])
def test_no_interval_is_narrower_than_of_gaussian_pairs(samples: tuple[float, float], r: float) -> None:
    """Var ln(rms) = 1 / 2n each, less what they share; Student's quantile by Welch and Satterthwaite, less one."""
    n = 2.0 * np.array(samples)
    variance = 0.5 * (1 / n[0] + 1 / n[1] - 2.0 * r**2 / math.sqrt(n[0] * n[1]))
    freedom = (1 / n).sum() ** 2 / (1 / n**3).sum()
    half = math.asinh(stats.t.ppf(0.975, freedom - 1.0) * math.sqrt(variance))
    found = errors(np.zeros((RESAMPLE_COUNT, 2)), samples, r).interval(np.array([1.0, -1.0]))
    assert found == pytest.approx((-half, half), rel=1e-4)
    assert errors(np.zeros((RESAMPLE_COUNT, 2)), samples, r).interval(np.zeros(2)) == (0.0, 0.0)


@pytest.mark.parametrize("move", [0.0, 0.2, 1.5])
@pytest.mark.parametrize("n", [1.0, 2.0, 7.0])
def test_chance_is_that_of_gaussian_moves_of_equal_errors(move: float, n: float) -> None:
    moved = 1.0 + move * np.random.default_rng(5).normal(size=(400_000, round(n)))
    expected = np.percentile(-0.5 * np.log((moved**2).mean(axis=1)), (2.5, 97.5))
    np.testing.assert_allclose(by_chance(move, n), expected, rtol=0.05, atol=0.01)


@pytest.mark.parametrize(
    ("gain", "verdict", "words"),
    [(-0.3, "hurts", "failed"), (-0.004, "no verdict", "no better than"), (0.3, "no verdict", "passed")],
)
def test_a_gain_below_a_fiftieth_of_a_nat_is_no_self_check(gain: float, verdict: str, words: str) -> None:
    """A short drive may show it beyond its 95 % interval."""
    score = Score("odometry", "lrf", 500, 1.0, gain, gain - 0.001, gain + 0.001, stretches=True)
    found = _by_itself(score, "odometry")
    assert found["verdict"] == verdict
    assert words in found["words"]
