"""Verdicts on noise: figures against scalar filters of known noise, words against drives with a wrong setting."""

import math
import re
from typing import Any

import numpy as np
import pytest
import small_drive
from commands import reported
from msgspec.structs import replace
from numpy.typing import NDArray
from present import present
from scipy import stats
from textbook import correlated

import locfuse
from locfuse.cli.analysis.verdicts import unless_overconfident
from locfuse.fusion.data import VERDICTS, Array, Audit, Drive, Evaluation, Measurements
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge import consistency
from locfuse.fusion.judge.consistency import (
    Consistency,
    NoiseEvidence,
    RunInnovations,
    as_run,
    biased_against,
    judge,
)
from locfuse.fusion.judge.evaluate import CovarianceCheck, covariance_check
from locfuse.fusion.judge.innovations import (
    MAX_COMPARED_READINGS,
    STRETCH_READINGS,
    _agreement,
    _sampled,
    compare_readings,
    own,
)
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.truth import body_poses


def scalar_filter(
    seed: int, q: float, r: float, told: float, n: int = 2000, gate: float = 15.1
) -> tuple[Audit, Measurements]:
    rng = np.random.default_rng(seed)
    x, found, P = 0.0, 0.0, 0.0
    rows = []
    for k in range(n):
        x += math.sqrt(q) * rng.normal()
        P += q
        y, S = x + math.sqrt(r) * rng.normal() - found, P + told
        accepted = y * y / S <= gate
        rows.append((k, 0 if accepted else 1, y * y / S, y, math.sqrt(S)))
        if accepted:
            found += P / S * y
            P -= P * P / S
    k, verdict, nis, y, sigma = np.array(rows).T
    at, none = k.astype(np.int64), np.full(n, -1)
    audit = Audit(at, at, verdict.astype(np.int8), none, nis, np.full(n, gate), y[:, None], sigma[:, None])
    m = Measurements(k, np.arange(n + 1), y[:, None], np.ones((n, 1, 1)), math.sqrt(told), np.zeros((1, 1)))
    return audit, m


@pytest.mark.parametrize("told", [0.25, 1.0, 4.0, 9.0])
def test_the_noise_of_a_scalar_filter_is_found_whatever_it_was_told(told: float) -> None:
    """True variance 1: the factor asked for is 1 / told, though state and innovation share the error."""
    factors = [present(own(*scalar_filter(seed, 0.01, 1.0, told))).scale * told for seed in range(5)]
    assert np.mean(factors) == pytest.approx(1.0, rel=0.25)


def test_right_noise_lies_within_its_bounds_and_is_white() -> None:
    inside = 0
    for seed in range(40):
        o = present(own(*scalar_filter(seed, 0.05, 1.0, 1.0, n=400)))
        inside += o.bounds[0] <= o.nis <= o.bounds[1]
        assert abs(o.whiteness[0]) < 0.25
    assert inside >= 34, f"{inside} of 40 within bounds that should hold 95 %"


def complaints(robot: Robot, drive: Drive) -> dict[str, Consistency]:
    sets: list[tuple[str, ...]] = [(), ("compass",), ("lrf",), ("compass", "lrf")]
    found = judge([RunInnovations.of(drive, fuse(drive, robot, s)) for s in sets], robot)
    assert set(found) == {"odometry", "compass", "lrf", "all"}
    assert found["odometry"] == {}
    assert {s: c.words for s, c in found["all"].items()} == {s: found[s][s].words for s in ("compass", "lrf")}
    return found["all"]


def told(drive: Drive, sensor: str, factor: float) -> Drive:
    """The drive as if the sensor's sigma had been stated `factor` times as large."""
    m = drive.measurements[sensor]
    return replace(drive, measurements={**drive.measurements, sensor: replace(m, scale=factor * m.scale)})


def turned(drive: Drive, by: Any) -> Drive:
    """The drive whose compass reads so much more [rad]: one angle, or one for each reading (n,)."""
    m = drive.measurements["compass"]
    moved = replace(m, z=m.z + np.broadcast_to(by, len(m.z))[:, None])
    return replace(drive, measurements={**drive.measurements, "compass": moved})


SEEDS = (1, 2)


@pytest.mark.parametrize("seed", SEEDS)
def test_right_noise_gets_no_complaint_and_noise_that_lasts_is_not_called_white(seed: int) -> None:
    robot = small_drive.robot()
    found = complaints(robot, small_drive.drive(seed, robot))
    assert {s: c.verdict for s, c in found.items()} == {"compass": "consistent", "lrf": "consistent"}
    robot = small_drive.robot(compass={"sigma_deg": 2.0})
    drive = small_drive.drive(seed, robot, compass_noise_deg=0.3)
    t = drive.measurements["compass"].t
    keep = math.exp(-float(np.median(np.diff(t))) / 3.0)  # errors last 3 s
    slow = math.radians(2.0) * correlated(np.random.default_rng(seed), len(t), keep)[:, 0]
    slowly = complaints(robot, turned(drive, slow))["compass"]
    assert slowly.verdict == "correlated"
    assert slowly.fix_values["compass.sigma_deg"] > 4.0
    assert slowly.fix_values["compass.offset_drift_deg"] == pytest.approx(2.0 * math.sqrt(2.0 / 3.0), rel=0.6)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("sensor", ["compass", "lrf"])
@pytest.mark.parametrize(("factor", "verdict"), [(1 / 3, "understated"), (3.0, "overstated")])
def test_a_sigma_wrong_by_three_is_named_with_its_key(seed: int, sensor: str, factor: float, verdict: str) -> None:
    robot = small_drive.robot()
    drive = told(small_drive.drive(seed, robot), sensor, factor)
    found = complaints(robot, drive)
    mine = found.pop(sensor)
    assert mine.verdict == verdict, mine.words
    assert mine.scale is not None
    assert mine.scale * factor == pytest.approx(1.0, rel=0.4)
    assert f"{sensor}.{ {'compass': 'sigma_deg', 'lrf': 'sigma_range'}[sensor] }" in mine.fix_values
    assert f"noise is set too {'low' if verdict == 'understated' else 'high'}" in mine.words
    assert [c.verdict for c in found.values()] in (["consistent"], ["unclear"])


def test_a_sigma_that_is_too_high_stays_open_if_runs_without_the_sensor_are_too_uncertain(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(consistency, "by_reference_run", lambda *_: None)
    robot = small_drive.robot()
    found = complaints(robot, told(small_drive.drive(1, robot), "compass", 3.0))
    assert found["compass"].verdict == "unclear"
    assert found["compass"].fix_values == {}


@pytest.mark.parametrize("exact", [True, False])
@pytest.mark.parametrize("step", [True, False])
@pytest.mark.parametrize("seed", SEEDS)
def test_an_offset_that_steps_or_drifts_is_named_with_when_and_how_far(seed: int, step: bool, exact: bool) -> None:
    robot = small_drive.robot(compass={"offset_deg": 0.0} if exact else {})
    drive = small_drive.drive(seed, robot)
    m = drive.measurements["compass"]
    middle, share = float(m.t[len(m.t) // 2]), np.linspace(0.0, 1.0, len(m.t))
    extra = np.where(m.t < middle, 0.0, math.radians(-12.0)) if step else math.radians(-12.0) * share
    found = complaints(robot, turned(drive, extra))["compass"]
    assert found.verdict == "correlated", found.words
    kind, amount, when = re.findall(r"(steps|drifts) by (-\d+)° (?:at|in) ([\d.]+) s", found.words)[0]
    assert kind == ("steps" if step else "drifts")
    assert float(amount) == pytest.approx(-12.0, abs=1.5)
    assert float(when) == pytest.approx(middle if step else np.ptp(m.t), rel=0.1)
    assert found.fix_values["compass.offset_drift_deg"] == pytest.approx(12.0 / math.sqrt(np.ptp(m.t)), rel=0.2)
    assert ("compass.sigma_offset_deg" in found.fix_values) == exact


def judged_with(errors: Array, sigma: float) -> Evaluation:
    """Position errors (q, 2) of a filter that says `sigma` of each axis."""
    q = len(errors)
    none = np.zeros(0)
    nees = ((errors / sigma) ** 2).mean(axis=1)
    figures: dict[str, float | None] = {"anees": float(nees.mean())}
    said = np.full((q, 3), sigma)
    return Evaluation(
        "x", {}, figures, np.arange(q, dtype=np.float64), errors, None, errors, said, nees, none, errors
    )


def test_honest_errors_lie_within_bounds_that_know_how_few_they_are() -> None:
    rng = np.random.default_rng(3)
    slow = np.repeat(rng.normal(size=(12, 2)), 50, axis=0)  # 600 stamps worth a dozen
    found, fast = (present(covariance_check(judged_with(e, 1.0))) for e in (slow, rng.normal(size=(600, 2))))
    assert found.independent < 40
    assert fast.independent > 300
    assert found.bounds[1] - found.bounds[0] > 3 * (fast.bounds[1] - fast.bounds[0])
    assert fast.bounds[0] < fast.anees < fast.bounds[1]
    assert fast.words.startswith("consistent")
    freedom = round(2 * fast.independent)
    assert fast.bounds == pytest.approx(stats.chi2.ppf((0.025, 0.975), freedom) / freedom, rel=1e-3)


def test_over_confidence_is_said_by_state_and_only_errors_of_a_regular_claim_count() -> None:
    rng = np.random.default_rng(4)
    errors = rng.normal(size=(800, 2)) * (1.0, 5.0)
    found = present(covariance_check(judged_with(errors, 1.0)))
    assert found.states["x"] == pytest.approx(1.0, rel=0.2)
    assert found.states["y"] == pytest.approx(25.0, rel=0.2)
    assert "overconfident: errors are about 3.6 times" in found.words
    rng = np.random.default_rng(8)
    errors = rng.normal(size=(300, 2))
    whole = present(covariance_check(judged_with(errors, 1.0)))
    wild = np.vstack((errors, np.full((2, 2), 1e3)))
    spoiled = replace(judged_with(wild, 1.0), figures={"anees": whole.anees})
    spoiled.nees[300] = np.nan  # its covariance is singular
    spoiled.sigma[301, 1] = 0.0
    found = present(covariance_check(spoiled))
    assert found == whole
    for n, known in ((1, False), (2, True)):
        assert (covariance_check(judged_with(errors[:n], 1.0)) is not None) is known


def test_the_report_carries_verdicts_figures_and_words() -> None:
    words = ("--to", "32", "--set", "compass.offset_deg=-60", "--write", "json,md", "-v")
    found, stdout, _, out = reported("compare", "rounded_rectangle", *words)
    mine = found["configurations"]["all"]["sensors"]["compass"]["consistency"]
    assert {"verdict", "words", "nis_bounds", "bias_sigma", "whiteness", "scale"} <= set(mine)
    assert mine["verdict"] == "biased"
    assert "fix_values" not in mine  # what nobody tried is no advice
    (advice,) = [f for f in found["findings"] if f["role"] == "compass"]
    fixes = dict(fix.split("=") for fix in advice["fixes"])
    assert float(fixes["compass.offset_deg"]) == pytest.approx(-65.0, abs=1.0)
    assert found["consistency"]["compass"]["words"] == mine["words"]
    whole = " ".join(stdout.split())
    assert f"compass: {advice['message']}. Fix (tried with" in whole
    assert "differs from the other sensors by" in (out / "report.md").read_text()
    assert (out / "fixes.toml").read_text().count("\noffset_deg = ") == 1
    honest = found["configurations"]["all"]["consistency"]
    assert set(honest["states"]) == {"x", "y", "theta"}
    assert honest["bounds"][0] < 1.0 < honest["bounds"][1]


@pytest.mark.parametrize(("anees", "kept"), [((9.0, 4.0), False), ((9.0, 1.0), True), ((), True)])
def test_an_overconfident_sensor_is_not_to_be_trusted_more(anees: tuple[float, ...], kept: bool) -> None:
    found = Consistency("overstated", "lrf noise is overstated", scale=0.1, fix_values={"lrf.sigma_range": 0.002})
    judged = unless_overconfident(found, [CovarianceCheck(a, (0.5, 1.5)) for a in anees])
    assert (judged == found) == kept
    if not kept:
        words = "residuals are 10 times smaller than configured, yet position errors are 2.0 times"
        assert judged.words.startswith(words)
        assert not judged.fix_values


def test_a_heading_in_a_disturbed_field_is_no_evidence() -> None:
    """Every third heading is off by 0.1 rad, where the field is twice as strong as it should be."""
    robot = small_drive.robot()
    drive = small_drive.drive(1, robot)
    run = fuse(drive, robot, ("lrf",))
    m = drive.measurements["compass"]
    disturbed = np.arange(len(m.t)) % 3 == 0
    moved = replace(m, z=m.z + 0.1 * disturbed[:, None], extra={"strength": np.where(disturbed, 2.0, 1.0)})
    seen = (replace(drive, measurements={**drive.measurements, "compass": x}) for x in (m, moved))
    alone, spoiled = (present(compare_readings(one, robot, run, "compass")) for one in seen)
    assert alone.readings + round(alone.outlier_share * alone.readings) == pytest.approx(len(m.t), abs=2)
    assert spoiled.readings == pytest.approx(int((~disturbed).sum()), abs=2)
    assert spoiled.spread == pytest.approx(alone.spread, rel=0.2)


NOISE_RAD = math.radians(0.5)


@pytest.fixture(scope="module")
def right() -> tuple[Drive, Robot]:
    """Twenty seconds whose compass reads the true heading with white noise of half a degree."""
    session = locfuse.load("rounded_triangle", between=(None, 20.0), sets={"compass.offset_deg": 0.0})
    drive, robot = session.drive, session.robot
    m, truth = drive.measurements["compass"], present(drive.truth)
    noise = NOISE_RAD * np.random.default_rng(17).normal(size=len(m.t))
    z = (body_poses(truth, m.t)[:, 2] + noise)[:, None]
    exact = replace(m, z=z, scale=NOISE_RAD, R_unit=np.ones_like(m.R_unit), floor=np.zeros_like(m.floor))
    return replace(drive, measurements={**drive.measurements, "compass": exact}), robot


def runs(drive: Drive, robot: Robot, turned_deg: float) -> list[RunInnovations]:
    """Runs of compass and laser; that of the laser is turned, and claims to be sure of it."""
    found = [fuse(drive, robot, sensors) for sensors in ((), ("compass",), ("lrf",))]
    pose = found[2].pose + np.array([0.0, 0.0, math.radians(turned_deg)])
    found[2] = replace(found[2], pose=pose, triangles=1e-3 * found[2].triangles)
    return [RunInnovations.of(drive, e) for e in found]


def test_a_wrong_run_accuses_no_right_sensor_and_an_offset_too_small_is_still_known(
    right: tuple[Drive, Robot],
) -> None:
    drive, robot = right
    assert judge(runs(drive, robot, 3.0), robot)["compass"]["compass"].verdict == "consistent"
    blind = replace(drive, truth=None)
    assert judge(runs(blind, robot, 3.0), robot)["compass"]["compass"].verdict != "consistent"
    found = present(NoiseEvidence(runs(turned(drive, math.radians(0.4)), robot, 0.0), robot).bias("compass"))
    assert found.fix_values["compass.offset_deg"] == pytest.approx(0.4, abs=0.15)
    assert NoiseEvidence(runs(drive, robot, 0.0), robot).bias("compass") is None


@pytest.mark.parametrize("off_deg", [-4.0, 2.0])
def test_an_offset_is_measured_against_the_truth(right: tuple[Drive, Robot], off_deg: float) -> None:
    drive, robot = right
    found = judge(runs(turned(drive, math.radians(off_deg)), robot, 1.0), robot)["compass"]["compass"]
    assert found.verdict == "biased"
    # of some hundred readings of half a degree
    assert found.fix_values["compass.offset_deg"] == pytest.approx(off_deg, abs=0.15)
    assert "compass.sigma_offset_deg" not in found.fix_values  # the truth is exact


def test_an_offset_by_a_run_is_set_with_how_well_that_run_knows_its_heading(right: tuple[Drive, Robot]) -> None:
    """One that was set as exact would pull the estimate to the run's own error with the weight of all readings."""
    drive, robot = right
    found = runs(replace(turned(drive, math.radians(8.0)), truth=None), robot, 0.0)
    laser = found[2].estimates
    for sigma_deg in (0.5, 1.5):
        triangles = laser.triangles.copy()
        triangles[:, 5] = math.radians(sigma_deg) ** 2
        found[2] = found[2]._replace(estimates=replace(laser, triangles=triangles))
        cures = judge(found, robot)["compass"]["compass"].fix_values
        assert cures["compass.sigma_offset_deg"] == pytest.approx(sigma_deg, rel=0.1)
        assert cures["compass.offset_deg"] == pytest.approx(8.0, abs=2 * sigma_deg)


def test_a_sensor_that_takes_no_sigma_of_its_offset_gets_none(right: tuple[Drive, Robot]) -> None:
    drive, robot = right
    heard = NoiseEvidence(runs(drive, robot, 0.0), robot).reference_runs("compass")[0][1]
    off = heard._replace(bias=math.radians(5.0), standard_error=math.radians(0.4))
    camera: Any = REGISTRY["camera"].Settings
    assert set(biased_against("camera", camera(), off).fix_values) == {"camera.zero_deg", "camera.sigma_yaw_deg"}
    assert set(biased_against("camera", camera(bearing="absolute"), off).fix_values) == {"camera.zero_deg"}


def test_a_truth_is_no_reference_where_it_has_a_gap_or_another_frame(right: tuple[Drive, Robot]) -> None:
    drive, robot = right
    truth, e = present(drive.truth), fuse(drive, robot, ())
    assert truth.theta is not None
    kept = (truth.t < 5.0) | (truth.t > 9.0)
    gap = replace(truth, t=truth.t[kept], xy=truth.xy[kept], theta=truth.theta[kept])
    run = present(as_run(replace(drive, truth=gap), e))
    inside = (drive.t > 5.1) & (drive.t < 8.9)
    assert np.isnan(run.estimates.pose[inside]).all()
    assert np.isfinite(run.estimates.pose[(drive.t > 1.0) & (drive.t < 4.9)]).all()
    assert as_run(replace(drive, truth=replace(truth, xy=truth.xy + 2.0)), e) is None
    assert as_run(replace(drive, truth=replace(truth, theta=truth.theta + 1.0)), e) is None
    assert as_run(replace(drive, truth=replace(truth, theta=None)), e) is None


# --- the figures of innovations, held to the same figures written out with NumPy and SciPy

NAMES = ("accepted", "gate", "unmatched", "disturbed", "lost")
ACCEPTED, GATE, UNMATCHED, DISTURBED, LOST = map(VERDICTS.index, NAMES)
LAGS = 5


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
    variance = (np.concatenate(series) ** 2).mean(axis=0)
    products = ([s[lag:] * s[:-lag] for s in series] for lag in range(1, lags + 1))
    return np.array([(np.concatenate(pairs).mean(axis=0) / variance).mean() for pairs in products])


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
        y[landmark == mark] = 2.0 * correlated(rng, n // 2, keep, d) + 0.4
    sigma = np.full((n, d), 2.2) + 0.3 * rng.random((n, d))
    verdict = np.zeros(n, np.int8)
    verdict[5::40], verdict[7::40], verdict[9::40], verdict[11::40] = GATE, UNMATCHED, DISTURBED, LOST
    verdict[13::80], verdict[15::80] = GATE, UNMATCHED
    for refused in (GATE, UNMATCHED):  # every other one lies beyond the gate; the rest has other reasons
        y[np.flatnonzero(verdict == refused)[::2]] += 12.0
    audit, m = audited(y, sigma, verdict, landmark, gate)
    found = present(own(audit, m))

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
    np.testing.assert_allclose(found.standard_error, spread * math.sqrt(memory(white) / compared.sum()), rtol=1e-4)

    R = 1.5**2 * (1.0 + audit.row[compared] / n) + 0.1
    np.testing.assert_allclose(found.R, np.full(d, R.mean()))
    ratio = np.median(sigma[compared] ** 2 / R[:, None])
    assert found.share == pytest.approx(1.0 / ratio)
    assert found.white == pytest.approx(max(1.0 / ratio - white[0], 0.0))
    assert found.scale == pytest.approx(found.raw * np.clip(1.0 - white[0] * ratio, 0.3, 2.0))


@pytest.mark.parametrize("angular", [False, True])
@pytest.mark.parametrize("keep", [0.0, 0.9])
def test_what_a_run_that_does_not_use_a_sensor_says_of_it(keep: float, angular: bool) -> None:
    rng = np.random.default_rng(5)
    n = 500
    t = 0.2 * np.arange(n)
    y = 0.05 * correlated(rng, n, keep)[:, 0] + 3.1  # as an angle next to where they wrap
    wild = np.zeros(n, bool)
    wild[::50] = True
    y[wild] += 2.0
    seen = np.angle(np.exp(1j * y)) if angular else y
    h, R = 0.01 + 0.001 * rng.random(n), 0.002 + 0.001 * rng.random(n)
    found = present(_agreement(np.column_stack((t, seen, h, R, 0.1 * t)), False, angular))
    tame = ~wild
    some = y[tame]
    assert found.readings == tame.sum()
    assert found.outlier_share == pytest.approx(10 / n)
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
    assert found.standard_error == pytest.approx(math.sqrt(variance * found.memory / tame.sum() + h[tame].mean()))
    assert found.period == pytest.approx(0.2)
    assert found.reference == pytest.approx(h[tame].mean())
    assert pytest.approx(R[tame].mean()) == found.R


def test_of_many_readings_some_stretches_of_neighbours_are_heard() -> None:
    np.testing.assert_array_equal(_sampled(MAX_COMPARED_READINGS), np.arange(MAX_COMPARED_READINGS))
    found = _sampled(MAX_COMPARED_READINGS + 1)
    assert (found[0], found[-1]) == (0, MAX_COMPARED_READINGS)
    stretches = _sampled(100_000).reshape(-1, STRETCH_READINGS)
    assert len(stretches) == MAX_COMPARED_READINGS // STRETCH_READINGS
    assert (np.diff(stretches, axis=1) == 1).all()
    assert stretches[-1, -1] == 99_999
    starts = np.diff(stretches[:, 0])
    assert starts.max() - starts.min() <= 1
