"""The bound of `python -m benchmarks.consistency`: held to closed forms of the wheels' noise and to the filter."""

from __future__ import annotations

import math

import numpy as np
import pytest

from benchmarks import consistency
from benchmarks.consistency_bound import bound, drive_once, moved, path_in_frame, roll_of, shape_error
from benchmarks.consistency_cases import CASES, GIVEN, LASER, MOVING, SCENARIO
from locfuse.fusion.data import Array
from locfuse.sample_logs.load import load
from locfuse.sample_logs.record import in_memory

NOISE, TRACK, SPEED = 4e-4, 0.6, 0.3  # m, m, m/s: the simulated robot's
STRAIGHT = (*MOVING, "path.laps=0.1")  # 1.7 m, before its first corner


def test_on_a_straight_way_the_wheels_noise_grows_as_its_closed_form() -> None:
    """var(along) = k D / 2, var(yaw) = 2 k D / L^2, var(across) = 2 k D^3 / (3 L^2): random walks, summed."""
    roll, _ = drive_once(load(SCENARIO, STRAIGHT), 1)
    t = np.linspace(2.0, 4.0, 201)
    P = np.zeros((3, 3))
    for begin, end in zip(t[:-1].tolist(), t[1:].tolist(), strict=True):
        P = moved(P, roll, begin, end, NOISE, TRACK)
    (first, last), ways = roll.at(t[[0, -1]])
    D = float((ways[1] - ways[0]).mean())
    assert np.hypot(*(last - first)[:2]) == pytest.approx(D, rel=0.05)
    variances = sorted(np.linalg.eigvalsh(P[:2, :2]))
    assert sum(variances) == pytest.approx(NOISE * D / 2 + 2 * NOISE * D**3 / (3 * TRACK**2), rel=0.05)
    assert P[2, 2] == pytest.approx(2 * NOISE * D / TRACK**2, rel=1e-6)


def test_a_perfect_laser_leaves_what_the_wheels_slip_until_the_truth_s_next_stamp() -> None:
    """The truth is stamped 0.1 s less 25 ms of sweep and 7 ms after the sweep's beginning: 0.082 s of slip."""
    perfect = ("lrf.sigma_range=1e-5", "lrf.sigma_angle_deg=1e-4", "lrf.lost=0")
    found = bound(load(SCENARIO, (*STRAIGHT, *perfect)), *drive_once(load(SCENARIO, STRAIGHT), 1))
    way = SPEED * (0.1 - 0.025 + 0.007)
    assert found.after_scan < 5e-4
    assert found.at_truth == pytest.approx(math.sqrt(NOISE * way / 2), rel=0.15)


def test_less_noise_and_more_scans_lower_the_bound() -> None:
    of = [
        bound(load(SCENARIO, (*STRAIGHT, *sets)), *drive_once(load(SCENARIO, STRAIGHT), 1))
        for sets in ((), ("lrf.sigma_range=0.01",), ("lrf.rate=20",))
    ]
    assert of[1].at_truth < of[0].at_truth
    assert of[2].at_truth < of[0].at_truth
    assert all(b.after_scan < b.at_truth for b in of)


def test_the_filter_is_near_the_bound_and_not_below_it() -> None:
    """A filter that learns the walls cannot beat one that knows them; one drive varies by 5 %."""
    case = next(c for c in CASES if c.name == "laser alone")
    ratio = consistency.judged(case, 1000).aligned / (1000.0 * consistency.least(case, range(1000, 1001)).at_truth)
    assert 0.95 < ratio < 1.15


def test_a_compass_that_turns_the_map_leaves_the_path_within_the_frame_as_it_is() -> None:
    """In the world the compass bends the path while it finds the map's direction: within the frame it cannot."""
    given = next(c for c in CASES if c.name == GIVEN)
    drive, robot = consistency.drive_of(given, 1000)
    assert drive.truth is not None
    inside = [shape_error(path_in_frame(drive, robot, s), drive.truth.xy) for s in (LASER, given.sensors)]
    assert inside[1] == pytest.approx(inside[0], rel=0.02)
    assert consistency.judged(given, 1000).aligned > 1000.0 * inside[1]


def test_the_error_of_a_shape_forgets_where_it_lies_and_how_it_is_turned(path: Array) -> None:
    c, s = math.cos(2.0), math.sin(2.0)
    turned = path @ np.array([[c, s], [-s, c]]) + (3.0, -8.0)
    turned[:5] = np.nan
    assert shape_error(turned, path) == pytest.approx(0.0, abs=1e-12)
    off = path + np.where(np.arange(len(path)) % 2 == 0, 0.01, -0.01)[:, None] * (1.0, 0.0)
    assert shape_error(off, path) == pytest.approx(0.01, rel=0.01)


@pytest.fixture
def path() -> Array:
    t = np.linspace(0.0, 6.0, 600)
    return np.column_stack((2.0 * np.cos(t), np.sin(2.0 * t)))


def test_the_roll_is_the_way_of_the_wheels_that_the_simulator_counted() -> None:
    _, _, outcome = in_memory(load(SCENARIO, STRAIGHT), 1)
    roll = roll_of(outcome)
    assert float(roll.rolled[-1].mean()) == pytest.approx(outcome.way, rel=1e-6)
    assert (np.diff(roll.rolled, axis=0) >= 0.0).all()
