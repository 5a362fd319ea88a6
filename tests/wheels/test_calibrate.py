"""Calibration against closed forms, against noise that was drawn, and against the simulator."""

import json
import math
import tomllib
from pathlib import Path

import numpy as np
import pytest
from bags import real_log
from commands import locfuse, ok, refused, reported
from msgspec.structs import replace
from scipy.stats import chi2
from wheel_bags import GEOMETRY, angles, joint_states, log_of

from benchmarks.experiment import simulated
from locfuse.fusion import se2
from locfuse.fusion.data import Array, Drive, LocfuseError, Measurements, Truth
from locfuse.fusion.wheels.calibrate import (
    STRAIGHT,
    TURN,
    Residuals,
    WheelCalibration,
    calibrate_wheels,
    find_pieces,
    find_runs,
)
from locfuse.fusion.wheels.calibrate_without_truth import (
    NAMES,
    Intervals as Pieces,
    ScanMotions,
    calibrate_by_gyro,
    calibrate_by_scans,
    first_guess,
)
from locfuse.fusion.wheels.motion import Wheels

K, TRACK = 4e-4, 0.6
STRAIGHT_RUNS = [("forward", way) for _ in range(6) for way in (3.0, -3.0)]
SHORT = {
    "straight_runs": "[{forward=3, speed=0.2}, {forward=-3, speed=0.4}, {forward=3, speed=0.6}]",
    "turns_on_the_spot": "[{turn_deg=360, speed=0.2}, {turn_deg=-360, speed=0.4}, {turn_deg=360, speed=0.6}]",
}
TURNS = [("turn", math.tau * sign) for _ in range(6) for sign in (1, -1)]


def legs(
    seed: int,
    plan: list[tuple[str, float]],
    k: float = K,
    errors: tuple[float, float, float] = (0.0, 0.0, 0.0),
    truth_noise: tuple[float, float] = (0.0, 0.0),
    heading: bool = True,
) -> Drive:
    """A drive of straight runs and turns at 0.3 m/s with pauses: truth at 50 Hz, what the wheels say beside it.

    `errors` are relative, of the left radius, the right radius and the track that the wheels are computed with.
    """
    rng = np.random.default_rng(seed)
    dt, speed = 0.02, 0.3
    sides = []
    for what, amount in plan:
        way = amount if what == "forward" else 0.5 * TRACK * amount
        n = round(abs(way) / speed / dt)
        step = math.copysign(speed * dt, way)
        sides += [(step if what == "forward" else -step, step)] * n + [(0.0, 0.0)] * 50
    rolled = np.array(sides)
    over_ground = rolled + np.sqrt(k * np.abs(rolled)) * rng.normal(size=rolled.shape)
    t = np.asarray(np.arange(len(rolled) + 1) * dt, np.float64)
    ds, turn = over_ground.mean(axis=1), (over_ground[:, 1] - over_ground[:, 0]) / TRACK
    middle = np.cumsum(turn) - 0.5 * turn
    chord = ds * np.sinc(0.5 * turn / math.pi)
    pose = np.zeros((len(t), 3))
    pose[1:] = np.cumsum(np.stack((chord * np.cos(middle), chord * np.sin(middle), turn), axis=-1), axis=0)
    left, right = (np.append(0.0, np.cumsum(side)) for side in (rolled / (1.0 + np.array(errors[:2]))).T)
    wheels = Wheels.from_wheels(t, left, right, TRACK / (1.0 + errors[2]), K)
    xy = pose[:, :2] + truth_noise[0] * rng.normal(size=(len(t), 2))
    theta = se2.wrap_all(pose[:, 2] + truth_noise[1] * rng.normal(size=len(t))) if heading else None
    truth, none = Truth("/gt", t, xy, theta), dict[str, Measurements]()
    still, instant = wheels.between(t[:1], t[:1]), np.zeros(0, np.int64)
    return Drive(0, t, still, none, {}, {}, truth, truth_instant=instant, wheels=wheels)


def test_straight_runs_and_turns_are_found_and_arcs_and_short_moves_are_neither() -> None:
    runs = find_runs(legs(0, [("forward", 3.0), ("turn", 2.0), ("forward", -2.0), ("turn", -6.0)]).wheels)
    kinds, starts, ends = zip(*runs, strict=True)
    assert kinds == (STRAIGHT, TURN, STRAIGHT, TURN)
    lengths = (np.array(ends) - starts) * 0.3 / np.array([3.0, 0.3 * 2.0, 2.0, 0.3 * 6.0])
    np.testing.assert_allclose(lengths, 1.0, atol=0.15)
    t = np.arange(0.0, 20.0, 0.02)
    arc = Wheels.from_wheels(t, 0.2 * t, 0.4 * t, TRACK, K)
    assert len(find_runs(arc)) == 0
    assert len(find_runs(legs(0, [("forward", 0.3), ("turn", 0.5)] * 5).wheels)) == 0


def test_straight_pieces_and_turns_have_the_closed_form_covariances_and_delta_is_that_of_one_period() -> None:
    pieces = find_pieces(legs(1, STRAIGHT_RUNS, k=0.0), np.zeros(3))
    D = pieces.size
    forms = {(0, 0): D / 2, (2, 2): 2 * D / TRACK**2, (1, 1): 2 * D**3 / (3 * TRACK**2)}
    for (i, j), variance in forms.items():
        np.testing.assert_allclose(pieces.Q[:, i, j], variance, rtol=1e-3)
    np.testing.assert_allclose(np.abs(pieces.e).max(), 0.0, atol=1e-9)
    np.testing.assert_allclose(pieces.Q_delta, pieces.Q * 0.3 * 0.1, rtol=1e-6, atol=1e-12)
    turns = find_pieces(legs(1, TURNS, k=0.0), np.zeros(3))
    np.testing.assert_allclose(turns.Q[:, 2, 2], turns.size / TRACK, rtol=1e-9)


def test_without_truth_noise_the_interval_is_the_chi_square_one() -> None:
    rng = np.random.default_rng(3)
    n, d, p, s = 80, 3, 2, 5e-4
    roots = rng.normal(size=(n, d, d))
    X = rng.normal(size=(n, d, p))
    e = math.sqrt(s) * np.einsum("nij,nj->ni", roots, rng.normal(size=(n, d))) + X @ np.array([0.3, -0.2])
    Q = roots @ roots.transpose(0, 2, 1)
    figure, _ = Residuals(e, X, Q, np.zeros((n, d, d)), np.full(p, 100.0)).fit()
    white = np.linalg.solve(np.linalg.cholesky(Q), np.concatenate((e[..., None], X), axis=2)).reshape(n * d, -1)
    squares = float(np.linalg.lstsq(white[:, 1:], white[:, 0], rcond=None)[1][0])
    dof = n * d - p
    assert figure.value == pytest.approx(squares / dof, rel=1e-3)
    assert figure.low == pytest.approx(squares / chi2.ppf(0.975, dof), rel=0.02)
    assert figure.high == pytest.approx(squares / chi2.ppf(0.025, dof), rel=0.02)


@pytest.mark.parametrize("plan", [STRAIGHT_RUNS, TURNS], ids=["straight", "turns"])
def test_the_noise_drawn_lies_in_its_interval_as_often_as_that_says(plan: list[tuple[str, float]]) -> None:
    found = [calibrate_wheels([legs(1000 + seed, plan)]).k for seed in range(20)]
    assert sum(f.low <= K <= f.high for f in found) >= 17  # of 95 %: fewer in one of 60 such tests
    assert np.mean([f.value for f in found]) == pytest.approx(K, rel=0.06)


def test_a_longer_experiment_gives_a_narrower_interval() -> None:
    short, long = (calibrate_wheels([legs(seed, STRAIGHT_RUNS) for seed in range(n)]).k for n in (1, 4))
    assert math.log(long.high / long.low) == pytest.approx(0.5 * math.log(short.high / short.low), rel=0.15)


def within(found: WheelCalibration, expected: tuple[float, float, float]) -> bool:
    return bool((np.abs(found.parameters - np.array(expected)) < 3.3 * found.sigmas).all())


def test_wrong_radii_and_track_are_found_and_not_taken_for_noise() -> None:
    errors = (0.02, -0.01, 0.12)
    found = calibrate_wheels([legs(seed, STRAIGHT_RUNS + TURNS, errors=errors) for seed in range(2)])
    assert within(found, (0.005, -0.03, 0.12)), (found.parameters, found.sigmas)
    assert found.sigmas.max() < 0.01
    assert found.k.low < K < found.k.high
    assert found.outliers == 0


def test_what_a_drive_cannot_tell_is_said_and_stays_as_it_is() -> None:
    straight, turns = (calibrate_wheels([legs(3, plan)]) for plan in (STRAIGHT_RUNS, TURNS))
    assert np.isnan(straight.sigmas).tolist() == [False, False, True]
    assert np.isnan(turns.sigmas).tolist() == [True, False, False]
    assert straight.parameters[2] == pytest.approx(0.0, abs=1e-6)
    assert turns.parameters[0] == pytest.approx(0.0, abs=1e-6)


def test_noise_of_the_truth_is_not_taken_for_noise_of_the_wheels() -> None:
    noise = (0.01, math.radians(0.5))
    drives = [legs(seed, STRAIGHT_RUNS + TURNS, truth_noise=noise) for seed in range(3)]
    found = calibrate_wheels(drives)
    assert found.k.low < K < found.k.high
    ignorant = [replace(d, truth=replace(d.truth, sigma=1e-6)) for d in drives if d.truth is not None]
    assert calibrate_wheels(ignorant).k.value > found.k.value


def test_a_truth_of_points_tells_the_radius_and_nothing_of_turns() -> None:
    errors = (0.03, 0.03, 0.0)
    found = calibrate_wheels([legs(s, STRAIGHT_RUNS + TURNS, errors=errors, heading=False) for s in range(3)])
    assert found.pieces["turn"] == 0
    assert np.isnan(found.sigmas).tolist() == [False, True, True]
    assert abs(found.parameters[0] - 0.03) < 3.3 * found.sigmas[0]
    assert found.k.low < K < found.k.high


def test_a_jump_of_the_truth_is_an_outlier_and_not_noise() -> None:
    drive = legs(5, STRAIGHT_RUNS)
    assert drive.truth is not None
    xy = drive.truth.xy.copy()
    xy[250:] += np.array([0.3, -0.2])
    found = calibrate_wheels([replace(drive, truth=replace(drive.truth, xy=xy))])
    assert found.outliers == 1
    assert found.k.value == pytest.approx(calibrate_wheels([drive]).k.value, rel=0.1)


def test_noise_is_found_for_wheels_that_were_said_to_have_none() -> None:
    drive = legs(5, STRAIGHT_RUNS + TURNS, truth_noise=(0.002, 0.002))
    exact = replace(drive, wheels=replace(drive.wheels, noise=0.0))
    assert calibrate_wheels([exact]).k == calibrate_wheels([drive]).k


def test_too_little_motion_is_refused_with_what_is_needed() -> None:
    with pytest.raises(LocfuseError, match="at least 4"):
        calibrate_wheels([legs(0, [("forward", 1.0)])])
    with pytest.raises(LocfuseError, match="no truth"):
        calibrate_wheels([replace(legs(0, STRAIGHT_RUNS), truth=None)])


def test_the_simulators_noise_lies_in_the_interval() -> None:
    off = ("camera.enabled=false", "lrf.enabled=false", "compass.enabled=false")
    runs = [simulated(name, (*off, f"path.legs={path}"), 101) for name, path in SHORT.items()]
    found = calibrate_wheels([run.measured()[0] for run in runs])
    assert found.k.low < K < found.k.high
    assert found.prefers_k > 0.0, "the simulator's noise grows per metre, whatever the speed"
    assert within(found, (0.0, 0.0, 0.0))


@pytest.fixture(scope="module")
def strong_iron(tmp_path_factory: pytest.TempPathFactory) -> Path:
    log = tmp_path_factory.mktemp("iron") / "drive.mcap"
    words = ("lrf.enabled=false", "camera.enabled=false", "control.estimator=truth")
    iron = ("compass.hard_iron=[9e-6, -6e-6]", "compass.soft_iron=[1.25, 0.85, 0.1]")
    ok("simulate", "rounded_rectangle", "-o", log, *(w for s in (*words, *iron) for w in ("--set", s)))
    return log


def test_iron_found_without_truth_makes_the_headings_right(strong_iron: Path, tmp_path: Path) -> None:
    robot = tmp_path / "robot.toml"
    done = ok("calibrate", strong_iron, "-o", robot)
    assert "compass.hard_iron x" in done.stdout
    words = ("--sensors", "compass", "--no-advice", "--no-smooth")
    before, after = (reported("run", strong_iron, *words, *more) for more in ((), ("--robot", robot)))
    rmse = [found.rows["compass"]["heading_rmse_deg"] for found in (before, after)]
    assert rmse[0] > 5.0
    assert rmse[1] < 1.0


def test_the_result_as_json_and_what_it_needs(strong_iron: Path, tmp_path: Path) -> None:
    done = locfuse("calibrate", strong_iron, "--json")
    found = json.loads(done.stdout)
    assert found["compass"]["hard_iron"] == pytest.approx([9e-6, -6e-6], abs=1e-7)
    assert found["wheels"]["noise_m"]["low"] < K < found["wheels"]["noise_m"]["high"]
    assert found["robot"]["compass"]["soft_iron"] == pytest.approx(found["compass"]["soft_iron"], rel=1e-5)
    taken = tmp_path / "robot.toml"
    taken.write_text("precious")
    assert "--overwrite" in refused("calibrate", strong_iron, "-o", taken, code=2)
    assert taken.read_text() == "precious"


def test_a_log_that_allows_nothing_says_why(tmp_path: Path) -> None:
    log = tmp_path / "still.mcap"
    sets = ("lrf.enabled=false", "camera.enabled=false", "compass.enabled=false", "path.legs=[{forward=0.4}]")
    words = [w for s in sets for w in ("--set", s)]
    assert locfuse("simulate", "straight_runs", "-o", log, *words).exit_code == 0
    refusal = refused("calibrate", log)
    assert "straight runs" in refusal
    assert "magnetometer" in refusal


# --- wheels calibrated by a gyro

GYRO_TRACK, RATIO, DELAY, BIAS = 0.42, 1.03, 0.3, 0.002
WHITE = 1e-4


def drive(noise: float, seed: int = 0, track: float = 0.3) -> tuple[Wheels, Array, Array]:
    """Wheels told by another track, which slip by `noise` per metre, and a late gyro of the true turns."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 300.0, 0.05)
    speed = 0.5 + 0.2 * np.sin(0.13 * t)
    rate = 0.5 * np.sin(0.31 * t) + 0.3 * np.sin(0.05 * t)
    true = np.stack((speed - 0.5 * GYRO_TRACK * rate, speed + 0.5 * GYRO_TRACK * rate), axis=-1)[1:] * 0.05
    share = np.array([2.0 / (1.0 + RATIO), 2.0 * RATIO / (1.0 + RATIO)])
    counted = true / share + rng.normal(0.0, 1.0, true.shape) * np.sqrt(noise * np.abs(true))
    left, right = (np.append(0.0, np.cumsum(side)) for side in counted.T)
    turned = np.append(0.0, np.cumsum((true[:, 1] - true[:, 0]) / GYRO_TRACK))
    own = turned + BIAS * t + np.append(0.0, np.cumsum(rng.normal(0.0, WHITE * math.sqrt(0.05), len(t) - 1)))
    return Wheels.from_wheels(t, left, right, track, 4e-4), t - DELAY, own


def test_track_and_ratio_are_found_within_what_is_claimed_and_the_noise_at_every_scale() -> None:
    noise = 2e-4
    found = calibrate_by_gyro([drive(noise, seed, 0.36) for seed in (1, 2)], 0.0, WHITE)
    ratio = (2.0 + found.parameters[1]) / (2.0 - found.parameters[1])
    track = 0.36 * (1.0 + found.parameters[2])
    assert found.slides == 0.0
    assert ratio == pytest.approx(RATIO, abs=4.0 * found.sigmas[1])
    assert track == pytest.approx(GYRO_TRACK, abs=4.0 * 0.3 * found.sigmas[2])
    assert max(found.sigmas[1:]) < 0.01
    assert math.isnan(found.sigmas[0])  # a gyro knows no lengths
    assert found.delay == pytest.approx(DELAY, abs=0.05)
    assert list(found.noise.values())[2:] == pytest.approx([noise] * 3, rel=0.5)


def test_what_both_sides_of_a_skidding_robot_slide_together_is_in_the_noise() -> None:
    """Both wheels slide alike, anything up to twice the mean in 10 s: its error is as claimed, of 20 drives."""
    ratios = []
    for seed in range(20):
        wheels, t, own = drive(1e-6, seed)
        rng = np.random.default_rng(1000 + seed)
        slides = 0.5 * (GYRO_TRACK - wheels.track)
        turned = np.interp(np.arange(0.0, 300.1, 10.0), t + DELAY, own - BIAS * t)
        slid = float((rng.uniform(-1.0, 1.0, 30) * slides * np.abs(np.diff(turned))).sum())
        found = calibrate_by_gyro([(wheels, t, own)], 0.0, WHITE)
        assert found.slides == pytest.approx(slides, rel=0.1)
        claimed = 0.25 * found.k.value * float(np.abs(wheels.rolled).sum())  # variance of the mean of both wheels
        ratios.append(slid**2 / claimed)
    assert 0.25 < np.mean(ratios) < 2.0  # half: the two wheels of the model slide independently


def test_a_drive_that_hardly_turns_and_one_that_turns_otherwise_are_refused() -> None:
    wheels, t, own = drive(1e-4)
    with pytest.raises(LocfuseError, match="at least 180 degrees"):
        calibrate_by_gyro([(wheels, t, 0.001 * own)], 0.0, WHITE)
    with pytest.raises(LocfuseError, match="of the gyro's turning: is its axis up"):
        calibrate_by_gyro([(wheels, t, -own)], 0.0, WHITE)


def test_a_robot_that_skids_gets_its_track_and_ratio_without_truth(tmp_path: Path) -> None:
    log = real_log("warthog/warthog.mcap")
    sheet = ("--set", "wheels.radius=0.30", "--set", "wheels.track=1.14")
    late = locfuse("calibrate", log, *sheet)
    assert "(equivalent: gyro.time_offset=0.18)" in late.stderr
    told = (*sheet, "--set", "gyro.time_offset=0.176")
    found = ok("calibrate", log, *told, "-o", tmp_path / "robot.toml", "--json")
    values = json.loads(found.stdout)["gyro"]
    assert 1.78 < values["track"]["value"] < 1.92
    assert values["time_offset_s"] == pytest.approx(0.0, abs=0.04)
    truth = ("--set", "truth.topic=/icp_pose", "--align", "origin", "--no-advice")
    words = ("--robot", tmp_path / "robot.toml", "--set", "wheels.radius=0.30", "--sensors", "odometry")
    assert reported("run", log, *words, *truth).rows["odometry"]["position_rmse_m"] < 1.0
    placed = ("--set", "start.theta_deg=-73.1", "--set", "truth.time_offset=-0.07", "--set", "truth.sigma=0.0023")
    odometry = reported("run", log, *words, *truth[:2], *placed, "--no-advice").rows["odometry"]
    assert 0.5 < odometry["anees"] < 2.0


# --- wheels and the laser's mount calibrated by scans alone

LASER_TRACK, LASER_K, DT = 0.5, 4e-4, 0.05
MOUNT = np.array([0.18, -0.07, math.radians(70.0)])
MATCH = np.array([0.003, 0.003, math.radians(0.15)])  # noise of one match
WRONG = (0.04, -0.03, 0.08)  # of the left radius, the right one, the track: what the wheels are computed with
LATE = 0.12  # s that the laser's stamps are late


def laser_drive(seed: int, turns: bool = True, straight: bool = True, seconds: float = 90.0) -> ScanMotions:
    """A drive that speeds up, slows down and turns both ways, as wrong wheels and a late laser tell it."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, DT)
    speed = (0.35 + 0.15 * np.sin(t / 1.7)) * straight
    rate = (0.5 * np.sin(t / 3.1) + 0.3 * np.sin(t / 1.3)) * turns
    ds, turn = speed[:-1] * DT, rate[:-1] * DT
    pose = Wheels.from_twists(t, np.stack((ds, 0.0 * ds, turn), axis=-1), LASER_TRACK, LASER_K).pose
    sides = np.stack((ds - 0.5 * LASER_TRACK * turn, ds + 0.5 * LASER_TRACK * turn), axis=-1)
    sides += np.sqrt(LASER_K * np.abs(sides)) * rng.normal(size=sides.shape)
    left, right = (np.append(0.0, np.cumsum(side)) for side in (sides / (1.0 + np.array(WRONG[:2]))).T)
    wheels = Wheels.from_wheels(t, left, right, LASER_TRACK / (1.0 + WRONG[2]), LASER_K)
    seen = se2.compose(pose[::4], np.broadcast_to(MOUNT, pose[::4].shape))
    steps = se2.between(seen[:-1], seen[1:]) + MATCH * rng.normal(size=(len(seen) - 1, 3))
    P = np.broadcast_to(np.diag(MATCH**2), (len(steps), 3, 3))
    return ScanMotions(wheels, Wheels.from_matches(t[::4] + LATE, se2.log(steps), P, LASER_TRACK, LASER_K), 0.0)


def true() -> Array:
    left, right, track = WRONG
    return np.array([0.5 * (left + right), right - left, track, *MOUNT, -LATE])


def test_all_parameters_are_found_and_their_sigmas_are_right() -> None:
    """Six drives: no parameter further off than three sigma, and none whose sigma is idle talk."""
    found = [calibrate_by_scans([laser_drive(seed)]) for seed in range(6)]
    z = np.array([(one.parameters - true()) / one.sigmas for one in found])
    assert np.isfinite(z).all()
    assert np.abs(z).max() < 3.0
    sigmas = np.mean([one.sigmas for one in found], axis=0)
    assert (sigmas < (0.01, 0.01, 0.02, 0.03, 0.03, 0.02, 0.03)).all()
    assert found[0].noise == pytest.approx(LASER_K, rel=0.5)


def test_the_closed_form_alone_comes_near_from_nothing() -> None:
    """The mount is turned by 70 degrees and the laser is late: no guess is asked for."""
    p = first_guess([Pieces.of(laser_drive(0))])
    assert np.abs(p - true())[[0, 2, 3, 4, 5]] == pytest.approx(0.0, abs=0.06)
    assert p[6] == pytest.approx(-LATE, abs=0.06)


@pytest.mark.parametrize(
    ("turns", "straight", "undetermined"),
    [(False, True, {"track", "x", "y"}), (True, False, {"scale", "difference", "track", "yaw"})],
)
def test_what_a_drive_does_not_tell_is_said(turns: bool, straight: bool, undetermined: set[str]) -> None:
    """Straight on nothing says where the laser sits; on the spot nothing says how far a wheel rolls."""
    found, both = (calibrate_by_scans([laser_drive(0, *how)]) for how in ((turns, straight), ()))
    vague = {name for name, s, b in zip(NAMES, found.sigmas, both.sigmas, strict=True) if s > 10.0 * b}
    assert undetermined <= set(found.undetermined()) | vague


def test_slips_and_wrong_matches_are_left_out() -> None:
    motion = laser_drive(1)
    twist = motion.laser.twist.copy()
    twist[50] += (0.5, 0.3, 0.6)
    assert motion.laser.matched is not None
    wrong = Wheels.from_matches(motion.laser.t, twist, motion.laser.matched, LASER_TRACK, LASER_K)
    found = calibrate_by_scans([motion._replace(laser=wrong)])
    assert found.outliers >= 1
    assert np.abs((found.parameters - true()) / found.sigmas).max() < 3.0


def test_wheels_in_another_unit_and_a_short_drive_are_refused_in_words() -> None:
    motion = laser_drive(0)
    far = Wheels.from_twists(motion.wheels.t, motion.wheels.twist * (57.3, 57.3, 1.0), LASER_TRACK, LASER_K)
    with pytest.raises(LocfuseError, match=r"goes 0\.0\d+ times as far as by the wheels"):
        calibrate_by_scans([motion._replace(wheels=far)])
    with pytest.raises(LocfuseError, match="at least 12"):
        calibrate_by_scans([laser_drive(0, seconds=4.0)])


LEGS = (
    "{turn_deg=80, speed=0.25}, {forward=2.0, speed=0.4}, {turn_deg=-120, speed=0.3}, {forward=1.5},"
    "{turn_deg=-170, speed=0.3}, {forward=2.5, speed=0.5}, {turn_deg=200, speed=0.3}, {forward=1.5}"
)


def test_the_command_finds_wheels_and_mount_of_a_simulated_robot(tmp_path: Path) -> None:
    """Configured 4 cm too long wheels, 8 % too narrow, and a laser at the middle: without truth all is found."""
    log, robot = tmp_path / "x.mcap", tmp_path / "robot.toml"
    path = f'path={{kind="legs", x=3.2, y=2.4, theta_deg=60.0, legs=[{LEGS}]}}'
    sets = (path, "control.estimator=truth", "compass.enabled=false", "camera.enabled=false", "lrf.rate=5")
    words = [word for one in sets for word in ("--set", one)]
    assert locfuse("simulate", "rounded_rectangle", *words, "--seed", "1", "-o", log).exit_code == 0
    wrong = ("wheels.radius=0.052", "wheels.track=0.55", "lrf.x=0", "truth.topic=none")
    words = [word for one in wrong for word in ("--set", one)]
    done = ok("calibrate", log, *words, "-o", robot, "--json")
    found = json.loads(done.stdout)["laser"]
    for key, value in {"radius": 0.05, "ratio": 1.0, "track": 0.6, "x": 0.2, "y": 0.0, "yaw_deg": 0.0}.items():
        sigma = (found[key]["high"] - found[key]["low"]) / (2.0 * 1.96)
        assert abs(found[key]["value"] - value) < 3.0 * sigma, key
    assert (found["x"]["high"] - found["x"]["low"]) < 0.1
    text = robot.read_text()
    assert "track = " in text
    assert "x = 0.1" in text or "x = 0.2" in text
    assert "the laser's metre is taken for the right one" in done.stderr


def test_a_log_without_a_laser_says_what_is_missing(tmp_path: Path) -> None:
    log = log_of(tmp_path / "x.mcap", joint_states(*angles(5.0)))
    assert "no wheels and laser together in x" in refused("calibrate", log, *GEOMETRY)


def test_a_larger_wheel_is_calibrated_though_a_finding_names_it(tmp_path: Path) -> None:
    ok("calibrate", "rounded_rectangle", "--set", "wheels.ratio=0.9", "-o", tmp_path / "robot.toml")
    found = tomllib.loads((tmp_path / "robot.toml").read_text(encoding="utf-8"))
    assert found["wheels"]["ratio"] == pytest.approx(1.0, abs=0.03)
