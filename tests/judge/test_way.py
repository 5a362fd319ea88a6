"""The path of the truth: length, directions and drift do not depend on how often and exactly it was recorded."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from locfuse.fusion import se2
from locfuse.fusion.data import Drive, Estimates, Evaluation, Motions, Truth, upper_triangles
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.judge.way import noise_of, steps_of

Array = NDArray[np.float64]
FINE_S = 1e-3  # s: the true path in steps of 1 ms
DURATION_S = 60.0
T: Array = np.linspace(0.0, DURATION_S, round(DURATION_S / FINE_S) + 1)


def driven(speed: Array, turn: Array) -> Array:
    """True poses (n, 3) of a robot at T with this speed [m/s] and turn rate [rad/s]."""
    theta = np.append(0.0, np.cumsum(turn[:-1] * FINE_S))
    step = speed[:-1] * FINE_S * np.exp(0.5j * (theta[1:] + theta[:-1]))
    place = np.append(0.0, np.cumsum(step))
    return np.column_stack((place.real, place.imag, theta))


def recorded(pose: Array, hz: float, noise_m: float, seed: int = 1) -> tuple[Array, Array]:
    """Stamps (q,) and noisy places (q, 2) of a tracker that sees the robot `hz` times a second."""
    at = np.unique(np.round(np.arange(0.0, DURATION_S, 1.0 / hz) / FINE_S).astype(int))
    return T[at], pose[at, :2] + np.random.default_rng(seed).normal(0.0, noise_m, (len(at), 2))


def way(t: Array, xy: Array) -> float:
    return float(np.hypot(*steps_of(t, xy, np.zeros(len(t), np.int64)).T).sum())


def judged(t: Array, pose: Array, xy: Array, theta: Array | None) -> Evaluation:
    """The evaluation of an estimate (q, 3) against a truth (q, 2) at the same stamps."""
    n = len(t)
    P = np.broadcast_to(np.diag([1e-4, 1e-4, 1e-4]), (n, 3, 3))
    drive = Drive(
        0, t, Motions(np.zeros((n, 3)), np.zeros((n, 3, 3)), np.zeros((n, 3, 0))), {}, {}, {},
        Truth("/truth", t, xy, theta, (0.0, 0.0), 0.0),
    )  # fmt: skip
    return evaluate(Estimates("all", (), t, pose, upper_triangles(P), {}, truth_pose=pose, truth_P=P), drive)


STOPS = np.where((T > 20.0) & (T < 25.0), 0.0, 1.0)  # the robot stands for five seconds
WINDING = 0.8 * np.sin(0.4 * T) + 0.3 * np.cos(1.1 * T)


@settings(max_examples=60, deadline=None)
@given(
    hz=st.floats(5.0, 250.0),
    noise=st.floats(0.0, 0.005),
    speed=st.floats(0.3, 1.5),
    seed=st.integers(0, 10**6),
    heading=st.booleans(),
)
def test_length_and_drift_are_those_of_the_true_path_at_any_rate_and_noise(
    hz: float, noise: float, speed: float, seed: int, heading: bool
) -> None:
    """Oracle: the true path in steps of 1 ms, and the error of an odometry 15 % long that turns 2 % too far."""
    pose = driven(speed * STOPS * (1.0 + 0.3 * np.sin(0.9 * T)), WINDING)
    estimate = driven(1.15 * speed * STOPS * (1.0 + 0.3 * np.sin(0.9 * T)), 1.02 * WINDING)
    gone = np.append(0.0, np.cumsum(np.hypot(*np.diff(pose[:, :2], axis=0).T)))
    t, xy = recorded(pose, hz, noise, seed)
    at = np.round(t / FINE_S).astype(int)
    found = judged(t, estimate[at], xy, pose[at, 2] if heading else None)
    assert found.distance[-1] == pytest.approx(gone[-1], rel=0.02)
    for length in (1, 5):
        start = np.arange(0, len(T), 20)
        start = start[gone[start] + length < gone[-1]]
        end = np.searchsorted(gone, gone[start] + length)
        if heading:
            ours, theirs = (se2.between(p[start], p[end])[:, :2] for p in (estimate, pose))
        else:
            ours, theirs = (p[end, :2] - p[start, :2] for p in (estimate, pose))
        expected = float(np.hypot(*(ours - theirs).T).mean()) / length
        # 5 mm of noise at 5 Hz: over 5 m, of 120 drives 118 are within 2 %, the others within 2.7 %
        assert found.figures[f"drift_{length}m"] == pytest.approx(expected, rel={1: 0.02, 5: 0.04}[length])


@pytest.mark.parametrize("hz", [5.0, 10.0, 100.0, 250.0])
@pytest.mark.parametrize("noise", [0.0005, 0.002, 0.005, 0.03])
def test_a_robot_that_stands_for_a_minute_goes_nowhere(noise: float, hz: float) -> None:
    """As recorded its steps add up: to 21 m for 2 mm at 100 Hz."""
    t, xy = recorded(driven(np.zeros_like(T), np.zeros_like(T)), hz, noise)
    assert np.hypot(*np.diff(xy, axis=0).T).sum() > 500.0 * noise
    assert way(t, xy) < 0.01


@pytest.mark.parametrize("noise", [0.001, 0.005])
def test_a_tracker_that_repeats_readings_or_whose_noise_lasts_is_seen_through(noise: float) -> None:
    """Each reading of a 25 Hz tracker five times in a log of 125 Hz; and noise through a filter of 40 ms."""
    standing = driven(np.zeros_like(T), np.zeros_like(T))
    _, xy = recorded(standing, 25.0, noise)
    t: Array = np.linspace(0.0, len(xy) / 25.0, 5 * len(xy))
    assert way(t, np.repeat(xy, 5, axis=0)) < 0.01
    t, xy = recorded(standing, 250.0, noise)
    slow = np.stack([np.convolve(c, np.full(10, 0.1), "same") for c in xy.T], axis=-1)
    assert way(t, slow) < 0.01


@pytest.mark.parametrize("even", [True, False])
def test_the_noise_of_a_moving_truth_is_found(even: bool) -> None:
    pose = driven(0.5 * STOPS, WINDING)
    rng = np.random.default_rng(2)
    at = np.arange(0, len(T), 10) if even else np.sort(rng.choice(len(T), 6000, replace=False))
    for sigma in (0.0005, 0.002, 0.02):
        xy = pose[at, :2] + rng.normal(0.0, sigma, (len(at), 2))
        assert noise_of(T[at], xy, np.zeros(len(at), np.int64)) == pytest.approx(sigma, rel=0.1)


def test_a_smooth_path_has_no_noise_whatever_its_stamps() -> None:
    """A polynomial of degree 4, and a hole in the truth: what it jumps there is no noise."""
    t = np.sort(np.random.default_rng(3).uniform(0.0, 30.0, 300))
    xy = np.column_stack((t**4 / 1e4 - t**2, t**3 / 100.0 + 5.0 * t))
    assert noise_of(t, xy, np.zeros(300, np.int64)) < 1e-9
    pieces = np.repeat(np.arange(43), 7)[:300]
    xy += 100.0 * np.random.default_rng(4).normal(size=(43, 2))[pieces]
    assert noise_of(t, xy, pieces) < 1e-9


def test_a_truth_slower_than_the_drives_turns_is_taken_as_it_is() -> None:
    """One reading every 2 s: a corner is no noise."""
    t: Array = np.linspace(0.0, 78.0, 40)
    xy = np.cumsum(np.random.default_rng(6).normal(0.0, 1.0, (40, 2)), axis=0)
    assert way(t, xy) == pytest.approx(float(np.hypot(*np.diff(xy, axis=0).T).sum()))
