"""Credit, intervals and verdicts, held to brute force, closed forms and drives whose answer is known."""

from __future__ import annotations

import math
from functools import cache
from itertools import permutations

import numpy as np
import pytest
import small_drive
from msgspec.structs import replace
from numpy.typing import NDArray
from scipy import stats

from locfuse.cli.analysis.verdicts import credit_values, verdicts
from locfuse.fusion.data import Drive, Estimates
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge import bootstrap
from locfuse.fusion.judge.bootstrap import Errors, block_means, by_chance, effective_samples, student_t
from locfuse.fusion.judge.credit import Credit, Step, _Book, credit, credit_over_logs, shapley_steps, subsets
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.judge.verdict import Effect, overconfident, verdict

Array = NDArray[np.float64]
SENSORS = ("compass", "lrf")
HELP = {"helps", "seems to help"}  # one short drive seldom proves it


def ar1(rng: np.random.Generator, q: int, phi: float, sigma: float = 1.0) -> Array:
    """Two independent AR(1) series with standard deviation sigma, (q, 2)."""
    noise = rng.normal(size=(q, 2)) * sigma * math.sqrt(1.0 - phi**2)
    out = np.empty((q, 2))
    out[0] = sigma * rng.normal(size=2)
    for k in range(1, q):
        out[k] = phi * out[k - 1] + noise[k]
    return out


@cache
def credit_of(seed: int, noise_deg: float = 1.0, bias_deg: float = 0.0, **compass: float) -> Credit:
    robot = small_drive.robot(compass=compass)
    drive = small_drive.drive(seed, robot, laps=0.7, compass_noise_deg=noise_deg, compass_bias_deg=bias_deg)
    judged = {frozenset(s): evaluate(fuse(drive, robot, s), drive) for s in subsets(SENSORS)}
    found = credit(judged, SENSORS)
    assert found is not None
    return found


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


def test_credits_sum_to_what_all_sensors_bought() -> None:
    found = credit_of(1)
    assert found.complete
    assert found.total is not None
    credits_ = [c.credit.value for c in found.sensors.values() if c.credit]
    assert sum(credits_) == pytest.approx(found.total, abs=1e-12)
    assert sum(c.share for c in found.sensors.values() if c.share) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("freedom", [1.0, 1.5, 2.0, 3.3, 10.0, 200.0])
def test_students_t_equals_scipys(freedom: float) -> None:
    assert student_t(0.95, freedom) == pytest.approx(stats.t.ppf(0.975, freedom), rel=1e-5)


@pytest.mark.parametrize("phi", [0.0, 0.6, 0.9])
def test_effective_samples_of_a_series_with_known_memory(phi: float) -> None:
    rng = np.random.default_rng(3)
    q = 4000
    found = np.mean([effective_samples(ar1(rng, q, phi)) for _ in range(10)])
    assert found == pytest.approx(q * (1 - phi) / (1 + phi), rel=0.25)


def test_an_error_that_stays_is_one_error() -> None:
    assert effective_samples(np.full((500, 2), 0.3)) < 1.01


def test_block_means_keep_pairs_and_the_mean() -> None:
    values = np.random.default_rng(0).normal(size=300) ** 2
    means = block_means(np.stack((values, 2.0 * values)), 20)
    np.testing.assert_allclose(means[:, 1], 2.0 * means[:, 0])
    assert means[:, 0].mean() == pytest.approx(values.mean(), rel=0.02)


def test_means_are_the_same_however_few_blocks_are_held_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    values = np.random.default_rng(0).normal(size=(2, 503))
    whole = block_means(values, 7)
    monkeypatch.setattr(bootstrap, "STARTS_AT_ONCE", 1000)
    np.testing.assert_array_equal(block_means(values, 7), whole)


def test_the_interval_of_a_ratio_contains_the_truth_as_often_as_it_says() -> None:
    rng = np.random.default_rng(5)
    inside = 0
    for _ in range(100):
        common, own = ar1(rng, 300, 0.8), ar1(rng, 300, 0.8, 0.5)
        errors = Errors.of(np.stack((common, 0.6 * common + own)))
        low, high = errors.interval(np.array([1.0, -1.0]))
        truth = -0.5 * math.log(0.6**2 + 0.5**2)
        inside += low <= truth <= high
    assert inside >= 90  # 95 expected; 2.2 sigma below


@pytest.mark.parametrize(("move", "n"), [(0.3, 1), (0.5, 4), (2.0, 3)])
def test_luck_is_what_adding_random_moves_does(move: float, n: int) -> None:
    rng = np.random.default_rng(9)
    after = np.ones(n) + move * rng.normal(size=(40_000, n))
    effect = -0.5 * np.log((after**2).mean(axis=1))
    expected = np.percentile(effect, (2.5, 97.5))
    np.testing.assert_allclose(by_chance(move, float(n)), expected, rtol=0.15)


def test_many_independent_pairs_give_pitmans_and_morgans_interval() -> None:
    rng = np.random.default_rng(6)
    q = 4000
    a = rng.normal(size=(q, 2))
    b = 0.8 * a + 0.6 * rng.normal(size=(q, 2))
    low, high = Errors.of(np.stack((a, b))).interval(np.array([1.0, -1.0]))
    expected = 1.96 * math.sqrt((1.0 - 0.8**2) / (2 * q))
    assert 0.5 * (high - low) == pytest.approx(expected, rel=0.15)


@pytest.mark.parametrize("seed", range(4))
def test_a_sensor_whose_noise_carries_nothing_does_nothing(seed: int) -> None:
    found = credit_of(seed, noise_deg=180.0, sigma_deg=180.0)
    assert found.sensors["compass"].verdict == "no effect seen"
    assert found.sensors["lrf"].verdict in HELP


@pytest.mark.parametrize("seed", range(4))
def test_a_compass_with_a_constant_bias_that_claims_to_be_good_hurts(seed: int) -> None:
    found = credit_of(seed, noise_deg=0.5, bias_deg=5.0, sigma_deg=1.0, offset_deg=0.0)
    assert found.sensors["compass"].verdict == "hurts"
    assert found.sensors["lrf"].verdict in HELP


def test_overconfidence_is_a_remark_of_its_own() -> None:
    found = credit_of(0, noise_deg=0.5, bias_deg=5.0, sigma_deg=1.0, offset_deg=0.0)
    compass = found.sensors["compass"]
    sure = replace(compass, verdict="hurts", anees=(1.1, 240.0))
    words = verdicts(replace(found, sensors={"compass": sure}), [], {})["compass"]["words"]
    assert words.startswith("Alone: ")
    assert words.endswith(
        "Overconfident: errors are 15 times what the filter claims with it, 1.05 times without it."
    )


def test_of_what_hurts_beside_the_others_only_that_is_said() -> None:
    found = credit_of(0)
    average, last = Effect(0.14, -1.2, 0.8, 1.0), Effect(-1.4, -2.1, -0.6, 0.0)
    compass = replace(found.sensors["compass"], verdict="hurts", credit=average, last=last, anees=None)
    sensors = {**found.sensors, "compass": compass}
    words = verdicts(replace(found, sensors=sensors), [], {})["compass"]["words"]
    assert words == "Beside all others: 4.1x worse (1.8x to 8.2x worse)."


@pytest.mark.parametrize("seed", range(3))
def test_good_sensors_help(seed: int) -> None:
    assert {c.verdict for c in credit_of(seed).sensors.values()} <= HELP


def test_without_every_subset_only_the_effect_alone_is_known() -> None:
    robot = small_drive.robot()
    drive = small_drive.drive(1, robot)
    judged = {frozenset(s): evaluate(fuse(drive, robot, s), drive) for s in ((), ("compass",), ("lrf",))}
    found = credit(judged, SENSORS)
    assert found is not None
    assert not found.complete
    assert found.sensors["lrf"].credit is None
    assert found.sensors["lrf"].last is None
    assert found.sensors["lrf"].alone is not None


@pytest.mark.parametrize(
    ("sets", "beside", "words"),
    [
        (
            (("lrf",), ("compass", "lrf")),
            {"compass": ("lrf",), "lrf": None},
            "Beside lrf: ",
        ),
        (
            ((), ("compass",), ("compass", "lrf")),
            {"compass": (), "lrf": ("compass",)},
            "Alone: ",
        ),
        (((), ("compass", "lrf")), {"compass": None, "lrf": None}, "No two configurations differ by it alone"),
        (((), ("compass",)), {"compass": ()}, "Alone: "),
    ],
)
def test_a_sensor_is_judged_by_sets_that_differ_by_it_alone_and_not_at_all_where_there_are_none(
    sets: tuple[tuple[str, ...], ...], beside: dict[str, tuple[str, ...] | None], words: str
) -> None:
    robot = small_drive.robot()
    drive = small_drive.drive(1, robot)
    judged = {frozenset(s): evaluate(fuse(drive, robot, s), drive) for s in sets}
    found = credit(judged, SENSORS)
    assert found is not None
    assert list(found.sensors) == list(beside)
    for sensor, others in beside.items():
        if others is None:
            assert found.sensors[sensor].verdict == "no verdict"
            continue
        effect = found.sensors[sensor].alone
        before, after = (judged[frozenset(s)].figures["position_rmse_m"] for s in (others, (*others, sensor)))
        assert effect is not None
        assert before is not None
        assert after is not None
        assert effect.value == pytest.approx(math.log(before / after))
        assert found.sensors[sensor].beside == others
    assert verdicts(found, [], {})["compass"]["words"].startswith(words)


def test_there_is_no_credit_without_truth() -> None:
    robot = small_drive.robot()
    drive = small_drive.drive(1, robot, truth=False)
    judged = {frozenset(s): evaluate(fuse(drive, robot, s), drive) for s in ((), ("compass",))}
    assert credit(judged, ("compass",)) is None


def test_over_several_logs_the_interval_is_students() -> None:
    drives = [credit_of(seed) for seed in range(4)]
    found = credit_over_logs(drives)
    values = [d.sensors["lrf"].credit.value for d in drives if d.sensors["lrf"].credit]
    effect = found.sensors["lrf"].credit
    assert effect is not None
    low, high = stats.t.interval(0.95, 3, loc=np.mean(values), scale=stats.sem(values))
    assert (effect.low, effect.high) == pytest.approx((low, high), rel=1e-4)
    assert found.logs == 4
    assert found.effective_samples == 4


@pytest.mark.parametrize("drives", [2, 3])
def test_over_fewer_than_four_logs_there_is_no_interval_and_nothing_is_sure(drives: int) -> None:
    found = credit_over_logs([credit_of(seed) for seed in range(drives)])
    effect = found.sensors["lrf"].credit
    assert effect is not None
    assert math.isnan(effect.low)
    assert math.isnan(effect.high)
    assert found.sensors["lrf"].verdict == "seems to help"
    assert credit_values(found)["sensors"]["lrf"]["credit"]["low"] is None
    words = verdicts(found, [], {})["lrf"]["words"]
    assert "plausible" not in words
    assert "nan" not in words
    assert f"Not proven by {drives} drives." in words


def test_the_interval_of_few_gaussian_pairs_is_students_with_the_degrees_of_freedom_left() -> None:
    """Closed form: two uncorrelated runs of 4 places (8 numbers) each; by Welch and Satterthwaite 16 - 1."""
    errors = Errors(np.zeros((2, 4, 2)), np.zeros(2), np.full(2, 4.0), np.eye(2), np.zeros((50, 2)), 1)
    half = math.asinh(stats.t.ppf(0.975, 15) * math.sqrt(0.5 * (1 / 8 + 1 / 8)))
    assert errors.interval(np.array([1.0, -1.0])) == pytest.approx((-half, half), rel=1e-4)


@pytest.mark.parametrize("samples", [8.0, 20.0])
def test_an_effect_is_no_surer_than_moves_by_chance_of_half_as_many_samples(samples: float) -> None:
    """Brute force: so many equal errors of 0.2 m, each moved by what the sensor took off the variance."""
    errors = Errors(
        np.zeros((2, 40, 2)), np.log([0.2, 0.1]), np.array([samples, 40.0]), np.eye(2), np.zeros((50, 2)), 1
    )
    expected = np.log([0.2, 0.16])  # the predicted deviation shrinks by sqrt(0.2^2 - 0.16^2) = 0.12 m
    book = _Book([frozenset(), frozenset({"lrf"})], errors, expected, [None, None])
    moves = 0.12 * np.random.default_rng(3).standard_normal((200_000, round(samples / 2)))
    ratio = -0.5 * np.log(np.mean((0.2 + moves) ** 2, axis=1) / 0.2**2)
    assert book._luck(0, 1) == pytest.approx(tuple(np.percentile(ratio, (2.5, 97.5))), abs=0.02)


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


@pytest.mark.parametrize(
    ("effect", "anees", "word"),
    [
        ((0.021, 0.001, 0.04, 0.5), None, "helps"),
        ((0.019, 0.001, 0.04, 0.5), None, "no effect seen"),  # below 2 %
        ((-0.021, -0.04, -0.001, 0.5), None, "hurts"),
        ((-0.019, -0.04, -0.001, 0.5), None, "no effect seen"),
        ((0.3, 0.151, 0.5, 0.14), None, "helps"),  # surprising: the bound must lie twice as far from none
        ((0.3, 0.149, 0.5, 0.14), None, "no effect seen"),
        ((0.3, 0.001, 0.5, 0.16), None, "helps"),
        ((0.3, 0.001, 0.5, -0.16), None, "helps"),
        ((0.16, -0.1, 0.5, 0.16), None, "seems to help"),
        ((0.14, -0.1, 0.5, 0.16), None, "no effect seen"),  # 15 % are asked for
        ((-0.16, -0.5, 0.1, 0.16), None, "seems to hurt"),
        ((-0.14, -0.5, 0.1, 0.16), None, "no effect seen"),
        ((0.5, -2.29, 2.4, 0.5), None, "seems to help"),
        ((0.5, -2.31, 2.4, 0.5), None, "no effect seen"),  # ten times smaller to ten times larger
        ((0.5, -2.31, 2.29, 0.5), None, "seems to help"),
        ((0.5, -0.1, 1.0, 0.14), (9.0, 2.9), "no effect seen"),  # a consistent covariance has a veto
        ((0.5, -0.1, 1.0, 0.14), (1.0, 3.1), "seems to help"),
        ((0.5, -0.1, 1.0, None), None, "seems to help"),
    ],
)
def test_verdicts_at_their_bounds(
    effect: tuple[float, float, float, float | None], anees: tuple[float, float] | None, word: str
) -> None:
    assert verdict(Effect(*effect), None, None, anees) == word
    assert verdict(None, Effect(*effect), None, anees) == word
    assert verdict(None, None, Effect(*effect), anees) == word


def test_where_nothing_was_compared_there_is_no_verdict() -> None:
    assert verdict(None, None, None, (1.0, 100.0)) == "no verdict"


@pytest.mark.parametrize(("high", "word"), [(-0.11, "hurts"), (-0.09, "helps")])
def test_a_set_must_be_ten_percent_better_off_without_a_sensor(high: float, word: str) -> None:
    assert verdict(Effect(0.9, 0.5, 1.3, 1.0), None, Effect(-0.4, -0.6, high, 0.0), None) == word


@pytest.mark.parametrize(
    ("anees", "over"),
    [((1.0, 10.1), True), ((1.0, 9.9), False), ((3.0, 15.1), True), ((3.0, 14.9), False), (None, False)],
)
def test_a_filter_is_overconfident_above_ten_and_five_times_what_it_was(
    anees: tuple[float, float] | None, over: bool
) -> None:
    assert overconfident(anees) is over


def known(anees: tuple[float | None, ...] = (None,) * 4, predicted: Array | None = None) -> _Book:
    """All sets of two sensors with errors 0.8, 0.4, 0.2 and 0.1 m that many independent samples back."""
    sets = [frozenset(s) for s in subsets(SENSORS)]
    ln = np.log([0.8, 0.4, 0.2, 0.1])
    rest = np.eye(4), np.tile(ln, (50, 1)), 1
    return _Book(sets, Errors(np.zeros((4, 9, 2)), ln, np.full(4, 1e9), *rest), predicted, list(anees))


def test_an_effect_says_what_the_filter_expected_of_it() -> None:
    predicted = np.log([0.8, 0.5, 0.25, 0.1])
    found = known(predicted=predicted).sensor("compass", SENSORS)
    assert found.alone is not None
    assert found.last is not None
    assert found.credit is not None
    assert (found.alone.value, found.alone.expected) == pytest.approx((math.log(2.0), math.log(1.6)))
    assert (found.last.value, found.last.expected) == pytest.approx((math.log(2.0), math.log(2.5)))
    assert found.credit.expected == pytest.approx(0.5 * (math.log(1.6) + math.log(2.5)))
    assert found.share == pytest.approx(1.0 / 3.0)
    alone = known().sensor("compass", SENSORS).alone
    assert alone is not None
    assert alone.expected is None
    assert (alone.low, alone.high) == pytest.approx((alone.value, alone.value), abs=1e-3)


def test_an_interval_is_as_wide_as_chance_on_both_sides() -> None:
    """By what a sensor that knows nothing does: the effect may be all of that."""
    predicted = np.log([0.5, 0.4, 0.2, 0.1])
    book = known(predicted=predicted)
    few = replace(book, errors=replace(book.errors, samples=np.full(4, 8.0)))
    least, most = few._luck(0, 1)
    assert (least, most) == pytest.approx(by_chance(0.3 / 0.8, 4.0))
    found = few.effect([Step(1.0, frozenset(), frozenset({"compass"}))])
    assert found is not None
    low, high = few.errors.interval(np.array([1.0, -1.0, 0.0, 0.0]))
    assert found.low == pytest.approx(min(low, math.log(2.0) - most))
    assert found.high == pytest.approx(max(high, math.log(2.0) - least))
    assert found.low < math.log(2.0) - 0.2


@pytest.mark.parametrize(
    ("anees", "worst"),
    [
        ((1.0, 3.0, 2.0, 5.0), (1.0, 3.0)),  # 3 times, against 2.5 times
        ((1.0, 2.0, 2.0, 5.0), (2.0, 5.0)),
        ((11.0, 99.0, 10.0, 15.0), (10.0, 15.0)),  # more than ten is overconfident already
        ((0.0, 9.0, 2.0, 3.0), (2.0, 3.0)),
        ((None, 9.0, 2.0, 3.0), (2.0, 3.0)),
        ((1.0, None, 2.0, None), None),
    ],
)
def test_the_anees_of_a_sensor_is_that_where_adding_it_makes_most_of_it(
    anees: tuple[float | None, ...], worst: tuple[float, float] | None
) -> None:
    assert known(anees).sensor("compass", SENSORS).anees == worst


def test_no_share_is_said_of_an_improvement_below_two_percent() -> None:
    book = known()
    for total, given in ((0.019, False), (0.021, True)):
        ln = np.array([0.0, -0.01, -0.005, -total])
        small = replace(book, errors=replace(book.errors, ln_rmse=ln))
        assert (small.sensor("compass", SENSORS).share is not None) is given


def test_over_logs_the_figures_are_means_and_medians() -> None:
    drives = [credit_of(seed) for seed in range(3)]
    found = credit_over_logs(drives)
    mine = [d.sensors["compass"] for d in drives]
    assert found.total == pytest.approx(np.mean([d.total for d in drives if d.total is not None]))
    assert found.sensors["compass"].share == pytest.approx(np.mean([c.share for c in mine if c.share is not None]))
    anees = np.median([c.anees for c in mine if c.anees is not None], axis=0)
    assert found.sensors["compass"].anees == pytest.approx(tuple(anees))
    effect = found.sensors["compass"].last
    assert effect is not None
    assert effect.expected == pytest.approx(np.mean([c.last.expected for c in mine if c.last and c.last.expected]))
    partly = [*drives[:2], replace(drives[2], complete=False, total=None)]
    assert (credit_over_logs(drives).complete, credit_over_logs(partly).complete) == (True, False)
    assert credit_over_logs(partly).total is None
    without = [*drives[:2], replace(drives[2], sensors={"lrf": drives[2].sensors["lrf"]})]
    assert list(credit_over_logs(without).sensors) == ["lrf"]
    unknown = replace(
        drives[2], sensors={**drives[2].sensors, "lrf": replace(drives[2].sensors["lrf"], share=None, last=None)}
    )
    of_lrf = credit_over_logs([*drives[:2], unknown]).sensors["lrf"]
    assert of_lrf.share is None
    assert of_lrf.last is None
    one = credit_over_logs(drives[:1]).sensors["lrf"]
    assert one.alone is None


def test_what_a_filter_predicts_is_of_the_place_and_not_of_the_heading() -> None:
    e = evaluate(*small_run())
    sigma = np.tile([0.3, 0.4, 9.0], (len(e.t), 1))
    other = replace(e, sigma=2.0 * sigma)
    found = credit({frozenset(): replace(e, sigma=sigma), frozenset({"lrf"}): other}, ("lrf",))
    assert found is not None
    assert found.sensors["lrf"].alone is not None
    assert found.sensors["lrf"].alone.expected == pytest.approx(-math.log(2.0))
    certain = credit({frozenset(): e, frozenset({"lrf"}): replace(e, sigma=0.0 * sigma)}, ("lrf",))
    assert certain is not None
    assert certain.sensors["lrf"].alone is not None
    assert certain.sensors["lrf"].alone.expected is None


def small_run() -> tuple[Estimates, Drive]:
    robot = small_drive.robot()
    drive = small_drive.drive(1, robot, laps=0.3)
    return fuse(drive, robot, ()), drive


def test_a_block_is_said_in_seconds() -> None:
    found = credit_of(1)
    robot = small_drive.robot()
    drive = small_drive.drive(1, robot, laps=0.7, compass_noise_deg=1.0)
    judged = [evaluate(fuse(drive, robot, s), drive) for s in subsets(SENSORS)]
    errors = Errors.of(np.stack([e.deviation for e in judged]))
    assert found.block_s == pytest.approx(errors.block * float(np.diff(judged[0].t).mean()))
    assert found.effective_samples == errors.samples.min()


def test_a_set_that_is_surely_better_off_without_a_sensor_is_hurt_by_it() -> None:
    helps, hurts = Effect(0.9, 0.5, 1.3, 1.0), Effect(-0.4, -0.6, -0.2, 0.0)
    assert verdict(helps, helps, hurts, None) == "hurts"
