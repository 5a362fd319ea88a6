"""Wheel motion against closed forms, brute force and Monte Carlo."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from lock_step import simulated
from textbook import numeric_jacobian

from locfuse.formats.report.findings import notes_of
from locfuse.fusion import se2
from locfuse.fusion.data import Estimates
from locfuse.fusion.fuse import fuse
from locfuse.fusion.wheels.motion import Wheels, geometry_by_states, geometry_of_states

TRACK, K = 0.6, 4e-4
RNG = np.random.default_rng(5)


def wheels_from(rolled: np.ndarray, dt: float = 0.02, track: float = TRACK) -> Wheels:
    left, right = (np.append(0.0, np.cumsum(rolled[:, i])) for i in (0, 1))
    t: Any = np.arange(len(left)) * dt
    return Wheels.from_wheels(t, left, right, track, K)


def random_drive(n: int = 400) -> np.ndarray:
    return 0.006 + 0.004 * RNG.standard_normal((n, 2))


def wheels_of_poses(t: np.ndarray, poses: np.ndarray) -> Wheels:
    """The wheels behind another odometry's poses (n, 3): only their increments count."""
    step = se2.between(poses[:-1], poses[1:])
    step[:, 2] = se2.wrap_all(step[:, 2])
    return Wheels.from_twists(t, se2.log(step), 0.3, K)


def test_a_circle_driven_with_constant_wheel_speeds_closes_exactly() -> None:
    wheels = wheels_from(np.tile([0.02 * math.pi * (1.5 + side * TRACK / 2) for side in (-1, 1)], (100, 1)))
    np.testing.assert_allclose(wheels.pose[-1], [0, 0, 2 * math.pi], atol=1e-12)
    np.testing.assert_allclose(wheels.pose[25], [1.5, 1.5, math.pi / 2], atol=1e-12)


def wheels_of(kind: str) -> Wheels:
    """Wheels, with a gap or not, an odometry that also moves sideways, or scans that were matched."""
    rng, a = np.random.default_rng(1), np.random.default_rng(4).normal(0.03, 0.02, (40, 3))
    t = np.cumsum(rng.uniform(0.01, 0.1, 41))
    if kind == "gap":
        t[21:] += 7.0
    if kind in {"wheels", "gap"}:
        left, right = np.concatenate((np.zeros((1, 2)), np.cumsum(a[:, :2], axis=0))).T
        return Wheels.from_wheels(t, left, right, 0.4, 1e-3)
    if kind == "twists":
        return Wheels.from_twists(t, a, 0.4, 1e-3)
    root = rng.normal(0.0, 0.01, (40, 3, 3))
    return Wheels.from_matches(t, a, root @ root.transpose(0, 2, 1), 0.4, 1e-3)


@pytest.mark.parametrize("kind", ["wheels", "gap", "twists", "matches"])
def test_two_intervals_on_end_are_one(kind: str) -> None:
    """Motion, and covariance where the noise of either is its own: J Q J' + Q of the second (eq. 6)."""
    wheels = wheels_of(kind)
    start, cut, end = (np.array([np.interp(k, np.arange(41), wheels.t)]) for k in (0.4, 13.3, 31.8))
    pieces = [wheels.between(*ends).u for ends in ((start, cut), (cut, end), (start, end))]
    np.testing.assert_allclose(se2.compose(pieces[0], pieces[1]), pieces[2], atol=1e-12)
    a, b, c = (wheels.t[[k]] for k in (0, 13, 31))
    first, second, whole = wheels.between(a, b), wheels.between(b, c), wheels.between(a, c)
    np.testing.assert_allclose(se2.compose(first.u, second.u), whole.u, atol=1e-13)
    (u,), (x, y, _) = first.u, second.u[0]
    cos, sin = math.cos(u[2]), math.sin(u[2])
    A = np.array([[1.0, 0.0, -sin * x - cos * y], [0.0, 1.0, cos * x - sin * y], [0.0, 0.0, 1.0]])
    W = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(A @ first.Q[0] @ A.T + W @ second.Q[0] @ W.T, whole.Q[0], rtol=1e-9, atol=1e-18)


def test_covariance_equals_monte_carlo_over_wheel_noise() -> None:
    rolled = random_drive(120)
    clean = wheels_from(rolled)
    Q = clean.between(np.array([0.0]), np.array([clean.t[-1]])).Q[0]
    rng = np.random.default_rng(1)
    ends = []
    for _ in range(4000):
        noisy = rolled + np.sqrt(K * np.abs(rolled)) * rng.standard_normal(rolled.shape)
        ends.append(se2.between(clean.pose[-1], wheels_from(noisy).pose[-1]))
    turn = clean.pose[-1, 2]
    c, s = math.cos(turn), math.sin(turn)
    T = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    seen = T @ np.cov(np.array(ends).T) @ T.T
    # relative standard error of a variance from 4000 drives is sqrt(2/4000) = 2.2 %
    np.testing.assert_allclose(np.diag(seen), np.diag(Q), rtol=0.1)
    correlation = Q / np.sqrt(np.outer(np.diag(Q), np.diag(Q)))
    seen_correlation = seen / np.sqrt(np.outer(np.diag(seen), np.diag(seen)))
    np.testing.assert_allclose(seen_correlation, correlation, atol=0.06)


@pytest.mark.parametrize("steps", [1, 10, 1000])
def test_a_straight_run_has_the_closed_form_variances_at_any_encoder_rate(steps: int) -> None:
    D = 5.0
    wheels = wheels_from(np.full((steps, 2), D / steps))
    Q = wheels.between(np.array([0.0]), np.array([wheels.t[-1]])).Q[0]
    assert Q[0, 0] == pytest.approx(K * D / 2, rel=1e-9)
    assert Q[2, 2] == pytest.approx(2 * K * D / TRACK**2, rel=1e-9)
    if steps == 1000:
        assert Q[1, 1] == pytest.approx(2 * K * D**3 / (3 * TRACK**2), rel=2e-3)


def test_a_turn_on_the_spot_has_the_closed_form_variance_and_at_rest_nothing_grows() -> None:
    phi = 2.5
    wheels = wheels_from(np.tile([-phi * TRACK / 2 / 50, phi * TRACK / 2 / 50], (50, 1)))
    Q = wheels.between(np.array([0.0]), np.array([wheels.t[-1]])).Q[0]
    assert Q[2, 2] == pytest.approx(K * phi / TRACK, rel=1e-9)
    wheels = wheels_from(np.zeros((50, 2)))
    motion = wheels.between(np.array([0.0]), np.array([1.0]))
    assert not motion.Q.any()
    assert not motion.u.any()


def test_wheel_parameter_derivatives_equal_finite_differences() -> None:
    rolled = random_drive(200)

    def end(p: np.ndarray) -> np.ndarray:
        pose: np.ndarray = wheels_from(rolled * (1 + p[:2]), track=TRACK * (1 + p[2])).pose[-1]
        return pose

    wheels = wheels_from(rolled)
    J = wheels.between(np.array([0.0]), np.array([wheels.t[-1]]), parameters=True).J[0]
    # a piece's own noise column uses the chord at mid-turn: third order in a piece's turn
    np.testing.assert_allclose(J, numeric_jacobian(end, np.zeros(3)), rtol=2e-5, atol=2e-5)


def test_another_odometry_gives_back_its_own_increments() -> None:
    t: Any = np.arange(30) * 0.05
    poses = np.column_stack((np.cumsum(RNG.uniform(0, 0.02, 30)), RNG.uniform(-1, 1, 30) * 0.01, 3.0 + 0.02 * t))
    poses[:, 2] = se2.wrap_all(poses[:, 2] + np.linspace(0, 1.0, 30))  # crosses pi on the way
    wheels = wheels_of_poses(t, poses)
    motion = wheels.between(t[:-1], t[1:])
    expected = se2.between(poses[:-1], poses[1:])
    expected[:, 2] = se2.wrap_all(expected[:, 2])
    np.testing.assert_allclose(motion.u, expected, atol=1e-12)


def test_relative_motion_between_any_two_times_follows_the_arc() -> None:
    wheels = wheels_from(np.tile([0.01, 0.014], (50, 1)))
    t = RNG.uniform(0, 1, (2, 20))
    rate = np.array([0.012, 0.0, 0.004 / TRACK]) / 0.02
    expected = se2.exp((t[1] - t[0])[:, None] * rate)
    np.testing.assert_allclose(wheels.relative(t[0], t[1]), expected, atol=1e-12)


def test_a_window_holds_both_readings_at_its_ends_and_what_lies_between() -> None:
    wheels = wheels_from(random_drive(20), dt=0.5)  # readings at 0, 0.5 .. 10 s
    for begin, end, first, last in ((2.0, 4.0, 4, 8), (1.9, 4.1, 4, 8), (2.1, 3.9, 5, 7), (9.5, 99.0, 19, 20)):
        part = wheels.window(begin, end)
        np.testing.assert_array_equal(part.t, wheels.t[first : last + 1])
        np.testing.assert_array_equal(part.pose, wheels.pose[first : last + 1])
        for column in ("twist", "rolled", "gap_uncertainty"):
            np.testing.assert_array_equal(getattr(part, column), getattr(wheels, column)[first:last])


def matched(P: np.ndarray) -> Wheels:
    """Odometry by scans: each step with its own covariance."""
    twist = np.column_stack((np.full(len(P), 0.1), np.zeros(len(P)), np.full(len(P), 0.3)))
    return Wheels.from_matches(np.arange(len(P) + 1.0), twist, P, TRACK, K)


def test_the_variance_of_a_step_by_scans_is_spread_evenly_over_its_time() -> None:
    """A quarter of the time, a quarter of the variance; at the middle of its arc, with the lever to its end."""
    P = np.diag([4e-4, 1e-4, 9e-4])[None]
    start, end = np.array([0.0, 0.25]), np.array([0.25, 1.0])
    for share, turn, way, Q in zip(
        (0.25, 0.75), (0.075, 0.225), (0.025, 0.075), matched(P).between(start, end).Q, strict=True
    ):
        c, s = math.cos(0.5 * turn), math.sin(0.5 * turn)
        J = np.array([[c, -s, -0.5 * way * s], [s, c, 0.5 * way * c], [0.0, 0.0, 1.0]])
        np.testing.assert_allclose(Q, share * J @ P[0] @ J.T, rtol=1e-9, atol=1e-15)


def test_scans_count_as_wheels_that_leave_the_turn_as_uncertain() -> None:
    """The turn is (right - left) / track, so of two like wheels each has track^2 / 2 of its variance."""
    P = np.diag([4e-4, 1e-4, 9e-4]) * np.array([1.0, 2.0, 3.0])[:, None, None]
    slips = matched(P).slips(np.array([0.0, 1.0, 2.5]))
    np.testing.assert_allclose(slips.sum(axis=-1) / TRACK**2, [9e-4, 9e-4 * (2.0 + 0.5 * 3.0)])
    np.testing.assert_array_equal(slips[:, 0], slips[:, 1])


def wanderer(seed: int, gap: tuple[float, float]) -> tuple[Wheels, Wheels]:
    """A minute of straight pieces and turns by chance: all that the wheels said, and the same with a gap."""
    rng = np.random.default_rng(seed)
    turning = np.repeat(rng.choice([-0.45, 0.0, 0.0, 0.45], size=75), 40)  # rad/s, anew every 0.8 s
    speed = 0.3 + np.stack((-0.5 * TRACK * turning, 0.5 * TRACK * turning), axis=-1)
    t: Any = np.arange(len(turning) + 1) * 0.02
    way: Any = np.concatenate((np.zeros((1, 2)), np.cumsum(speed * 0.02, axis=0)))
    heard = (t <= gap[0]) | (t >= gap[1])
    whole, gappy = (Wheels.from_wheels(t[k], way[k, 0], way[k, 1], TRACK, 1e-12) for k in (t >= 0.0, heard))
    return whole, gappy


def in_gap(until: float, end: float) -> tuple[np.ndarray, np.ndarray]:
    """Errors and sigmas (200, 3) of the motion from 20 s `until` a time, in a gap from 20 s to its `end`."""
    a, b = np.array([20.0]), np.array([until])
    errors, sigmas = [], []
    for seed in range(200):
        whole, gappy = wanderer(seed, (20.0, end))
        told, true = gappy.between(a, b), whole.between(a, b)
        errors.append(np.abs(told.u - true.u)[0])
        sigmas.append(np.sqrt(np.diag(told.Q[0])))
    return np.array(errors), np.array(sigmas)


@pytest.mark.parametrize("seconds", [2.0, 5.0, 12.0])
def test_where_a_robot_went_while_its_wheels_were_silent_lies_within_three_sigma(seconds: float) -> None:
    error, sigma = in_gap(20.0 + seconds, 20.0 + seconds)
    assert (error[:, :2] < 3.0 * sigma[:, :2]).all()
    assert np.sqrt((error[:, :2] ** 2).mean()) > 0.2 * np.sqrt((sigma[:, :2] ** 2).mean())  # and not by much
    assert error[:, 2].max() < 1e-9  # how far it turned is the difference of the sums
    assert sigma[:, 2].max() < 1e-5


def test_halfway_through_a_gap_the_heading_lies_within_three_sigma_too() -> None:
    error, sigma = in_gap(23.0, 26.0)
    assert (error[:, 2] < 3.0 * sigma[:, 2]).all()
    assert error[:, 2].max() > 0.3


def test_of_no_time_nothing_is_summed_and_what_comes_behind_is_as_ever() -> None:
    wheels = wheels_from(random_drive(30))
    begins, ends = np.array([0.1, 0.1, 0.3, 0.3]), np.array([0.1, 0.3, 0.3, 0.45])
    found, alone = wheels.between(begins, ends), wheels.between(begins[[1, 3]], ends[[1, 3]])
    assert not found.Q[[0, 2]].any()
    np.testing.assert_allclose(found.u[[0, 2]], 0.0, atol=1e-15)
    np.testing.assert_allclose(found.Q[[1, 3]], alone.Q, rtol=1e-12)


def test_beyond_its_ends_a_drive_goes_on_for_one_interval() -> None:
    wheels = wheels_from(np.tile([0.01, 0.014], (50, 1)))
    _, _, poses = wheels.at(np.array([-0.02, -9.0, 1.02, 9.0]))
    before, after = se2.exp(-wheels.twist[0]), se2.compose(wheels.pose[-1], se2.exp(wheels.twist[-1]))
    np.testing.assert_allclose(poses, [before, before, after, after], atol=1e-12)


@pytest.mark.parametrize(
    ("period", "gap", "is_gap"), [(0.02, 0.45, False), (0.02, 0.6, True), (0.2, 0.9, False), (0.2, 1.2, True)]
)
def test_a_gap_is_longer_than_half_a_second_and_than_five_periods(period: float, gap: float, is_gap: bool) -> None:
    t = np.append(np.arange(50.0) * period, 49.0 * period + gap)
    wheels = Wheels.from_wheels(t, 0.3 * t, 0.3 * t + 0.01 * np.sin(t), TRACK, K)
    assert bool(wheels.gap_uncertainty.any()) is is_gap


def test_wheels_that_speak_rarely_or_in_bursts_are_not_silent() -> None:
    bursts = np.repeat(np.arange(100.0), 10) * 0.2 + np.tile(np.arange(10.0), 100) * 1e-4
    for t in (np.arange(100.0), bursts):
        assert not Wheels.from_wheels(t, 0.3 * t, 0.3 * t + 0.1 * np.sin(t), TRACK, K).gap_uncertainty.any()


@pytest.mark.parametrize(("seconds", "stray"), [(2.0, 0.2 * 2.0 / 4.0 / math.sqrt(3.0)), (60.0, 0.5)])
def test_places_after_a_gap_stray_by_a_uniform_heading_at_most_over_a_disc(seconds: float, stray: float) -> None:
    """A heading uniform within w T / 4 to either side; a place uniform in a disc has half its radius per axis."""
    t = np.append(np.arange(0.0, 40.0, 0.1), 39.9 + seconds)
    way, turn = 0.3 * t, 0.2 * t  # rad/s is the fastest turning seen
    wheels = Wheels.from_wheels(t, way - 0.5 * TRACK * turn, way + 0.5 * TRACK * turn, TRACK, 1e-12)
    assert wheels.gap_uncertainty[-1, 0] == pytest.approx((0.3 * seconds * stray) ** 2, rel=1e-6)
    assert wheels.gap_uncertainty[-1, 1] == pytest.approx(0.2, rel=1e-6)
    assert not wheels.gap_uncertainty[:-1].any()
    quarter = wheels.between(t[-2:-1], t[-2:-1] + 0.25 * seconds).Q[0, 2, 2]
    assert quarter == pytest.approx(0.75 * (0.2 * 0.25 * seconds) ** 2 / 3.0, rel=1e-6)


def test_an_odometry_knows_its_path_over_a_gap() -> None:
    t = np.array([0.0, 0.1, 0.2, 0.3, 5.0, 5.1])
    poses = np.stack((t, np.sin(t), 0.1 * t), axis=-1)
    assert not wheels_of_poses(t, poses).gap_uncertainty.any()


@pytest.mark.parametrize("aside", [0.5 * math.pi, -0.5 * math.pi, math.pi, 0.7, -2.5])
def test_a_base_that_goes_sideways_is_as_uncertain_as_one_that_goes_ahead(aside: float) -> None:
    """Nothing but the name of its axes differs: mecanum wheels and legs roll the way they go."""
    ahead = wheels_from(random_drive(150))
    c, s = math.cos(aside), math.sin(aside)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    other = Wheels.from_twists(ahead.t, ahead.twist @ R.T, TRACK, K)
    cuts = ahead.t[[0, 40, 90]], ahead.t[[40, 90, 150]]
    one, two = ahead.between(*cuts), other.between(*cuts)
    np.testing.assert_allclose(two.u, one.u @ R.T, atol=1e-12)
    np.testing.assert_allclose(two.Q, R @ one.Q @ R.T, rtol=1e-9, atol=1e-15)


def test_in_however_long_a_silence_a_heading_is_at_most_unknown() -> None:
    _, heard = wanderer(0, (20.0, 30.0))
    t = heard.t + np.where(heard.t > 25.0, 1e9, 0.0)  # a stamp from another decade
    way: Any = np.concatenate((np.zeros((1, 2)), np.cumsum(heard.rolled, axis=0)))
    wheels = Wheels.from_wheels(t, way[:, 0], way[:, 1], TRACK, K)
    middle = wheels.between(np.array([20.0]), np.array([5e8]))
    assert 0.1 < middle.Q[0, 2, 2] < math.pi**2 / 3.0 + 1.0


# --- radius and track as states


def test_geometry_s_derivative_equals_finite_differences() -> None:
    for x in ([0.0, 0.0, 0.0], [0.05, -0.02, 0.3], [-0.1, 0.03, -0.2]):
        numeric = numeric_jacobian(geometry_of_states, np.array(x))
        np.testing.assert_allclose(geometry_by_states(np.array(x)), numeric, atol=1e-8)


def test_states_mean_what_wheels_of_that_geometry_do() -> None:
    """Told track 0.5, really 0.6, wheels 4 % larger: the linear motion is the true one."""
    rng = np.random.default_rng(0)
    t = np.arange(50) * np.float64(0.02)
    left, right = np.cumsum(rng.uniform(0.0, 0.01, (2, 50)), axis=1)
    x = np.array([0.04, 0.04, 1.04 * (1.0 - 0.5 / 0.6)])
    told = Wheels.from_wheels(t, left, right, 0.5, 1e-4).between(t[:-1], t[1:], parameters=True)
    real = Wheels.from_wheels(t, 1.04 * left, 1.04 * right, 0.6, 1e-4).between(t[:-1], t[1:])
    np.testing.assert_allclose(told.u + told.J @ x, real.u, atol=2e-6)
    np.testing.assert_allclose(geometry_of_states(x), [0.04, 0.0, 0.2], atol=1e-12)


def drive(sensors: Sequence[str], *sets: str) -> Estimates:
    found, robot = simulated(1000, robot_sets=("wheels.estimate=true", *sets))
    return fuse(found, robot, sensors)


@pytest.mark.parametrize("told", [0.5, 0.72])
def test_a_wrong_track_is_found(told: float) -> None:
    (words,) = [n for n in drive(["lrf"], f"wheels.track={told}").notes if n.startswith("wheels")]
    track, sigma = (float(w.rstrip(")")) for w in words.split("track ")[1].split(" (1 sigma: "))
    assert track == pytest.approx(0.6, abs=3 * sigma)
    assert sigma < 0.02


def test_wheels_told_10_percent_too_small_leave_the_metre_in_doubt() -> None:
    (words,) = [n for n in drive(["lrf"], "wheels.radius=0.045").notes if "not identifiable" in n]
    assert "larger than configured" in words
    scale = float(words.split("lrf.range_scale should be ")[1].split()[0])
    assert scale == pytest.approx(0.9, abs=0.03)  # the prior of 2 % holds back a little


def test_a_compass_sees_neither_radius_nor_track_but_their_quotient() -> None:
    compass, wheels = drive(["compass"]).notes, drive([]).notes
    assert any("not identifiable from compass: only track over radius is" in n for n in compass)
    assert any("not identifiable from wheels alone" in n for n in wheels)


def test_where_notes_differ_in_numbers_those_of_every_configuration_and_stream_are_shown() -> None:
    places = "lrf: {} submaps, {} revisited places"
    runs = {
        "lrf": {"notes": [places.format(9, 19), "lrf: 29 slips", "lrf: 30 slips"]},
        "lrf@2Hz": {"notes": [places.format(9, 5), "lrf: 29 slips", "lrf: 4 slips"]},
        "all": {"notes": [places.format(8, 5), "lrf: 29 slips"]},
    }
    log = ["lrf: 0.05 s late (3%)", "compass: 0.12 s late (3%)", "3 readings share a stamp"]
    assert notes_of({"notes": log, "configurations": runs}) == [
        "lrf, compass: 0.05 (compass: 0.12) s late (3%)",
        "3 readings share a stamp",
        "lrf: 9 (all: 8) submaps, 19 (lrf@2Hz, all: 5) revisited places",
        "lrf: 29 slips (the same in lrf@2Hz, all)",
        "lrf: 30 (lrf@2Hz: 4) slips",
    ]
