"""A reference in the place of truth: what it measures, and what its own errors leave open."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import small_drive
from msgspec.structs import replace
from numpy.typing import NDArray
from scipy import stats

from locfuse import sample_logs
from locfuse.cli.analysis.load import load
from locfuse.cli.analysis.settings import LogOptions
from locfuse.fusion import data, se2
from locfuse.fusion.data import Audit, Drive, Estimates, Jump, Measurements, Motions, stretches, upper_triangles
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.credit import Effect
from locfuse.fusion.judge.evaluate import evaluate, events_of_drive, events_of_run
from locfuse.fusion.judge.without_truth import (
    OUTLIER_SHARE,
    Distance,
    OwnScans,
    contradictions,
    listeners,
    log_density,
    ranking,
    scores,
)
from locfuse.fusion.robot import Robot
from locfuse.fusion.whole_drive.reference import Reference, interpolated

N = 400
SIGMA = 0.02  # m, of each axis of the solved drive


MOVED, STOOD = (0.1, 0.0, 0.0), (0.0, 0.0, 0.0)


def rolled(steps: list[tuple[float, float, float]], period: float = 0.5) -> Drive:
    """A drive of these steps of the wheels (forward, left [m], turn [rad]), one every half second."""
    u, n = np.array(steps), len(steps)
    motions = Motions(u, np.zeros((n, 3, 3)), np.zeros((n, 3, 0)))
    return Drive(0, np.linspace(0.0, period * (n - 1), n), motions, {}, {}, {})


def path() -> NDArray[np.float64]:
    t = np.linspace(0.0, 40.0, N)
    return np.column_stack((np.cos(0.2 * t), np.sin(0.2 * t), 0.2 * t + np.pi / 2.0))


def of_poses(pose: NDArray[np.float64], name: str = "lrf", sigma: float = SIGMA) -> Estimates:
    P = np.broadcast_to(np.diag([sigma**2, sigma**2, 1e-6]), (len(pose), 3, 3))
    return Estimates(name, (name,), np.linspace(0.0, 40.0, len(pose)), pose, upper_triangles(P), {})


def drive() -> Drive:
    return rolled([STOOD] * N, 40.0 / (N - 1))


def reference() -> Reference:
    return Reference.of(of_poses(path()), drive(), ("compass",))


def test_errors_are_distances_to_the_reference_and_no_claim_is_made_of_consistency() -> None:
    moved = of_poses(path() + np.array([0.3, -0.4, 0.01]), "compass")
    found = reference().judge(evaluate(moved, drive()), moved)
    assert found.reference
    assert found.figures["position_rmse_m"] == pytest.approx(0.5)
    assert found.figures["heading_rmse_deg"] == pytest.approx(math.degrees(0.01))
    assert (found.figures["anees"], found.figures["truth_coverage"]) == (None, None)
    assert np.isnan(found.nees).all()


def test_an_estimate_is_read_at_its_own_stamps_between_them_and_nowhere_else() -> None:
    """Rows each second but for a gap from 4 to 90 s; theta is three times, y twice x."""
    t = np.array([0.0, 1.0, 2.0, 3.0, 4.0, 90.0, 91.0])
    pose = np.column_stack((t, 2.0 * t, 3.0 * t))
    P = np.eye(3) * (1.0 + t)[:, None, None]
    stamps = np.array([-0.1, 0.0, 0.4, 1.0, 4.0, 4.1, 89.9, 90.0, 90.5, 91.0, 91.1])
    seen, spread = interpolated(stamps, t, pose, upper_triangles(P))
    known = [False, True, True, True, True, False, False, True, True, True, False]
    assert np.isfinite(seen).all(axis=1).tolist() == known
    assert np.isfinite(spread).all(axis=(1, 2)).tolist() == known
    np.testing.assert_allclose(seen[known], (stamps[:, None] * [1.0, 2.0, 3.0])[known])
    row_before = np.array([0.0, 0.0, 1.0, 4.0, 90.0, 90.0, 91.0])
    np.testing.assert_allclose(spread[known], np.eye(3) * (1.0 + row_before)[:, None, None])


def test_an_effect_is_widened_by_what_the_reference_may_add_or_hide() -> None:
    """Errors of 50 and 30 mm by a reference of 28 mm lie between sqrt(e^2 - s^2) and sqrt(e^2 + s^2)."""
    square = 2.0 * SIGMA**2
    least = [math.sqrt(e**2 - square) for e in (0.05, 0.03)]
    most = [math.sqrt(e**2 + square) for e in (0.05, 0.03)]
    value = math.log(0.05 / 0.03)
    found = reference().widened(Effect(value, value - 0.1, value + 0.2, 0.3), 0.05, 0.03)
    assert found.low == pytest.approx(math.log(least[0] / most[1]) - 0.1)
    assert found.high == pytest.approx(math.log(most[0] / least[1]) + 0.2)
    assert (found.value, found.expected) == (value, 0.3)
    below = reference().widened(Effect(0.0, 0.0, 0.0, None), 0.05, 0.02)  # less than the reference's own error
    assert below.high == pytest.approx(math.log(most[0] / 0.05 / 1e-3))


@pytest.mark.parametrize("shares", [False, True])
def test_the_widened_interval_has_the_true_ratio_whether_or_not_errors_are_shared(shares: bool) -> None:
    """Errors drawn anew: of an estimate of its own, or one whose error the reference halves and so shares."""
    rng = np.random.default_rng(5)
    own = rng.normal(size=(N, 2)) * 0.3
    after = rng.normal(size=(N, 2)) * 0.05
    wrong = rng.normal(size=(N, 2)) * SIGMA
    if shares:
        after = after + wrong  # what is measured is then without the error that both have
    before, now, true_before, true_now = (
        math.sqrt((errors**2).sum(axis=1).mean()) for errors in (own - wrong, after - wrong, own, after)
    )
    true, value = math.log(true_before / true_now), math.log(before / now)
    found = reference().widened(Effect(value, value, value, None), before, now)
    chance = 0.02  # where errors are shared the bound is what is expected, and so many draws miss it by this
    assert found.low - chance < true < found.high + chance
    assert found.high - found.low < 0.3


WALL = np.column_stack((np.linspace(-3.0, 3.0, 301), np.full(301, 2.0)))


def twice(offset: float) -> tuple[OwnScans, Any]:
    """Drive along a straight wall and, a minute later, along it again, believed `offset` [m] aside of it."""
    x = np.tile(np.arange(0.0, 7.0, 0.7), 2)
    true = np.column_stack((x, np.zeros(20), np.zeros(20)))
    seen = [se2.transform(np.broadcast_to(se2.inverse(p), (len(WALL), 3)), WALL) for p in true]
    believed = true + np.outer(np.repeat((0.0, offset), 10), (0.0, 1.0, 0.0))
    t = np.concatenate((np.arange(10.0), 60.0 + np.arange(10.0)))
    return OwnScans(t, np.arange(20), seen, np.zeros(3)), SimpleNamespace(pose=believed, blocks={})


@pytest.mark.parametrize(("aside", "agreement"), [(0.0, 1.0), (0.2, 0.0)])
def test_a_path_agrees_with_itself_where_it_sees_the_wall_where_it_was(aside: float, agreement: float) -> None:
    scans, path = twice(aside)
    assert scans.judge(path)[0] == pytest.approx(agreement)


def test_a_wall_that_is_seen_twice_fills_more_cells_than_one() -> None:
    sharp, blurred = (scans.judge(path)[1] for scans, path in (twice(0.0), twice(0.2)))
    assert 119 <= sharp <= 123  # 6 m of wall in cells of 5 cm
    assert 1.9 * sharp < blurred < 2.1 * sharp
    scans, path = twice(0.0)  # and where no place was seen twice nothing is said
    first, alone = (OwnScans(scans.t[:n], scans.instants[:n], scans.points[:n], scans.mount) for n in (10, 1))
    assert (first.judge(path)[0], alone.judge(path)[2]) == (None, 1.0)


def test_two_paths_are_laid_on_each_other_before_they_are_compared() -> None:
    t = np.linspace(0.0, 10.0, 101)
    a = np.column_stack((t, np.sin(t)))
    turned = se2.transform(np.broadcast_to(np.array([5.0, -2.0, 1.0]), (101, 3)), a)
    assert Distance.between(t, a, turned).max < 1e-12
    bent = turned.copy()
    bent[-1] += (1.0, 0.0)
    found = Distance.between(t, a, bent)
    assert found.t_s == 10.0
    assert 0.9 < found.max < 1.0
    assert found.doubted(20.0)
    assert not found.doubted(200.0)


# --- listening, scoring and ranking without truth, and thinning a sensor

SETS: tuple[tuple[str, ...], ...] = ((), ("compass",), ("lrf",), ("compass", "lrf"))


def tried(drive: Drive, robot: Robot) -> list[Estimates]:
    sets = [s for s in SETS if set(s) <= set(drive.measurements)]
    return [fuse(drive, robot, s, listen=listeners(drive, s)) for s in sets]


@pytest.mark.parametrize("mode", ["consider", "refine", "grow"])
@pytest.mark.parametrize("sensors", [(), ("compass",), ("lrf",)])
def test_a_sensor_that_listens_never_moves_the_pose(mode: str, sensors: tuple[str, ...]) -> None:
    robot = small_drive.robot(lrf={"map": mode})
    drive = small_drive.drive(1, robot, laps=0.4)
    alone, heard = fuse(drive, robot, sensors), fuse(drive, robot, sensors, listen=listeners(drive, sensors))
    np.testing.assert_allclose(heard.pose, alone.pose, atol=1e-12)
    np.testing.assert_allclose(heard.P, alone.P, atol=1e-12)
    assert heard.sensors == sensors
    assert set(heard.audits) == {"compass", "lrf"}


def test_a_listening_sensor_of_an_honest_filter_is_predicted_as_well_as_claimed() -> None:
    means = []
    for seed in range(4):
        robot = small_drive.robot()
        drive = small_drive.drive(seed, robot, laps=0.6)
        audit = fuse(drive, robot, ("lrf",), listen=listeners(drive, ("lrf",))).audits["compass"]
        means.append(np.nanmean(audit.nis))
    assert 0.8 < np.mean(means) < 1.3


def test_the_score_is_the_mixture_of_the_predicted_normal_and_anything() -> None:
    y, sigma = np.array([[0.5], [math.nan]]), np.array([[2.0], [math.nan]])
    zero = np.zeros(2)
    audit = Audit(np.arange(2), np.array([0, 2]), np.zeros(2, np.int8), np.full(2, -1), zero, zero, y, sigma)
    z = np.array([[0.0], [4.0], [10.0]])
    found = log_density(audit, z)
    density = (1 - OUTLIER_SHARE) * stats.norm.pdf(0.5, scale=2.0) + OUTLIER_SHARE / 10.0
    assert found[0] == pytest.approx(math.log(density), rel=1e-12)
    assert math.isnan(found[1])  # never compared
    assert found[2] == pytest.approx(math.log(OUTLIER_SHARE / 10.0))  # compared, and nothing was predicted


READINGS = 40


def laid(matched: object = None) -> Drive:
    """Forty readings of two sensors, one each half second, with values from -5 to 5."""
    n, drive = READINGS, rolled([STOOD] * READINGS)
    z = np.linspace(-5.0, 5.0, n)[:, None]
    m = Measurements(drive.t, np.arange(n + 1), z, np.ones((n, 1, 1)), 1.0, np.zeros((1, 1)))
    at = {sensor: np.arange(n) for sensor in ("compass", "lrf")}
    wheels = SimpleNamespace(matched=matched)
    return replace(drive, measurements=dict.fromkeys(at, m), instant=at, wheels=wheels)


def test_sensors_take_turns_of_five_seconds_where_none_is_left_out() -> None:
    drive = laid()
    turns = listeners(drive, ("compass", "lrf"))
    assert turns["compass"].tolist() == [5.0 <= t < 10.0 for t in drive.t]
    assert turns["lrf"].tolist() == [10.0 <= t < 15.0 for t in drive.t]
    assert {s: flags.all() for s, flags in listeners(drive, ("lrf",)).items()} == {"compass": True}


@pytest.mark.parametrize("seed", range(2))
def test_good_sensors_predict_each_other_better_than_odometry_does(seed: int) -> None:
    robot = small_drive.robot()
    drive = small_drive.drive(seed, robot, laps=0.6, truth=False)
    found = scores(drive, tried(drive, robot))
    ranked = ranking(found, ["odometry", "compass", "lrf", "all"])
    assert ranked[-2].configuration == "odometry"
    assert ranked[-1].configuration == "all"
    assert ranked[-1].gain is None  # it leaves nothing out
    assert all(s.low > 0.0 for s in found if s.configuration in {"compass", "lrf"})
    assert contradictions(found, {"compass": "compass", "lrf": "lrf"}) == []


@pytest.mark.parametrize("seed", range(2))
def test_a_biased_compass_and_a_laser_contradict_each_other(seed: int) -> None:
    robot = small_drive.robot(compass={"offset_deg": 0.0})
    drive = small_drive.drive(seed, robot, laps=0.6, compass_noise_deg=0.5, compass_bias_deg=5.0, truth=False)
    found = scores(drive, tried(drive, robot))
    assert contradictions(found, {"compass": "compass", "lrf": "lrf"}) == [("compass", "lrf")]
    assert ranking(found, ["odometry", "compass", "lrf"])[0].configuration == "odometry"


# --- what happened when: rest, refusals in a row, being lost, labelled faults


def test_a_rest_is_as_long_as_the_wheels_stand() -> None:
    drive = small_drive.drive(1, small_drive.robot(), laps=0.5)
    first = 40
    last = first + int(np.searchsorted(drive.t[first:] - drive.t[first - 1], 3.0))
    u = drive.motions.u.copy()
    u[first : last + 1] = 0.0
    (event,) = events_of_drive(replace(drive, motions=replace(drive.motions, u=u)))
    assert event.kind == data.REST
    assert (event.start, event.end) == (drive.t[first - 1], drive.t[last])


@pytest.mark.parametrize(("refused", "told"), [(4, 0), (5, 1), (9, 1)])
def test_readings_refused_in_a_row_are_told(refused: int, told: int) -> None:
    robot = small_drive.robot()
    drive = small_drive.drive(1, robot, laps=0.5)
    run = fuse(drive, robot, ["compass"])
    audit = run.audits["compass"]
    verdict = np.full_like(audit.verdict, data.VERDICTS.index("accepted"))
    verdict[10 : 10 + refused] = data.VERDICTS.index("gate")
    changed = replace(run, audits={"compass": replace(audit, verdict=verdict)})
    events = [e for e in events_of_run(drive, changed) if e.kind == data.REFUSED]
    assert len(events) == told
    for event in events:
        times = drive.t[drive.instant["compass"]]
        assert (event.start, event.end) == (times[10], times[9 + refused])
        assert f"{refused} readings in a row" in event.words


def test_stretches_are_runs_of_true_values() -> None:
    assert stretches(np.array([], bool)) == []
    assert stretches(np.array([True, True, False, True, False, False, True])) == [(0, 1), (3, 3), (6, 6)]


def test_a_reading_counts_as_taken_by_any_of_its_lines_and_an_empty_scan_does_not_count() -> None:
    """Scans of two lines: of the third one is taken; then one that saw nothing amid five that were refused."""
    first = np.array([0, 2, 4, 6, 8, 10, 10, 12, 14, 16])
    m = Measurements(np.arange(9.0), first, np.zeros((16, 2)), np.ones((16, 2, 2)), 1.0, np.zeros((2, 2)))
    for taken, told in (("accepted", 1), ("new", 1), ("repeated", 1), ("unmatched", 0)):
        verdict = np.full(16, data.VERDICTS.index("gate"), np.int8)
        verdict[[5, 15]] = data.VERDICTS.index(taken)
        instant, zero, zeros = first[:-1].repeat(np.diff(first)), np.zeros(16), np.zeros((16, 2))
        audit = Audit(instant, np.arange(16), verdict, np.full(16, -1), zero, zero, zeros, zeros)
        drive = rolled([MOVED] * 9)
        drive = replace(drive, measurements={"lrf": m}, instant={"lrf": np.arange(9)})
        run = Estimates("lrf", ("lrf",), drive.t, np.zeros((9, 3)), np.zeros((9, 6)), {"lrf": audit})
        found = [(e.start, e.end) for e in events_of_run(drive, run)]
        assert found == ([] if told else [(0.0, 4.0)])  # two before, and four behind it


def test_being_lost_jumps_and_loops_are_told_with_their_times() -> None:
    robot = small_drive.robot()
    drive = small_drive.drive(1, robot, laps=0.5)
    odometry = fuse(drive, robot, [])
    (event,) = events_of_run(drive, replace(odometry, lost=((1.0, 2.5),)))
    assert (event.start, event.end, event.kind, event.configuration) == (1.0, 2.5, data.LOST, "odometry")
    jumps = (
        Jump(1.5, data.SLIP, (0.0, 0.0, np.radians(-8.0))),
        Jump(2.0, data.LOOP_TAKEN, (0.3, 0.4, 0.0)),
    )
    first, second = events_of_run(drive, replace(odometry, jumps=jumps))
    assert (first.start, first.end, first.kind) == (1.5, 1.5, data.JUMP)
    assert first.words == "wheel slip undone: moved 0.00 m, turned -8.0°"
    assert second.words == "loop closed: moved 0.50 m, turned +0.0°"
    loops = np.array([(1.0, 40.0), (3.5, 42.0), (2.0, 60.0)])
    first, second = events_of_run(drive, replace(odometry, loops=loops))
    assert (first.start, first.end, first.kind) == (40.0, 42.0, data.LOOP)
    assert first.words == "places of 1 to 4 s recognised"
    assert (second.start, second.end, second.words) == (60.0, 60.0, "the place of 2 s recognised")


def test_the_faults_that_a_log_labels_are_events_with_their_times() -> None:
    loaded = load([sample_logs.path("disturbed")], LogOptions(quiet=True))
    kinds = {event.words.split(" ")[0]: event for event in loaded.labels}
    assert all(event.kind == data.FAULT for event in loaded.labels)
    assert {"people", "magnetic", "slip", "hidden_landmark", "red_object"} <= set(kinds)
    assert kinds["magnetic"].end - kinds["magnetic"].start == pytest.approx(13.0, abs=2.0)
