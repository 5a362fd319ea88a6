"""The table of `python -m benchmarks.consistency`: cases that exist, figures as named, a bound that holds."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from benchmarks import consistency
from benchmarks.consistency import CASES, LASER, MOVING, SCENARIO, Case, Goals, Roll, bound, inside, moved, without
from benchmarks.experiment import simulated
from locfuse.cli.analysis.robot_tables import make_robot
from locfuse.formats.robot import robot_toml
from locfuse.fusion.data import Drive, Estimates
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.sample_logs.scenario import load
from locfuse.sample_logs.simulate import Simulation

STRAIGHT = (*MOVING, "path.laps=0.1")  # 1.7 m, before its first corner
SHORT = Case("short", LASER, {}, STRAIGHT)
NOISE, TRACK, SPEED = 4e-4, 0.6, 0.3  # m, m, m/s: the simulated robot's


@pytest.fixture(scope="module")
def short() -> tuple[Drive, Estimates]:
    drive, robot = consistency.drive_of(SHORT, 1)
    return drive, fuse(drive, robot, LASER)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_a_case_names_settings_that_exist(case: Case) -> None:
    tables = Simulation(load(case.scenario, case.sets), 1).robot_tables
    robot = make_robot(robot_toml.layered(tables, robot_toml.apply_sets(case.given)))
    assert all(robot.settings(sensor).topic for sensor in case.sensors)
    others = {of for of, _ in case.goals.values() if isinstance(of, str)}
    assert others <= {"bound", *(c.name for c in CASES)}


def test_inside_counts_x_y_and_heading_where_sigma_is_not_0_and_spans_are_left_out(
    short: tuple[Drive, Estimates],
) -> None:
    drive, run = short
    whole = evaluate(run, drive)
    n, t = len(whole.t), whole.t
    zero = replace(whole, deviation=np.zeros((n, 2)), heading=np.zeros(n), sigma=np.ones((n, 3)))
    far = np.where(np.arange(n) == 0, 3.1, 0.0)
    assert inside(zero) == 1.0
    assert inside(replace(zero, heading=far)) == pytest.approx(1 - 1 / (3 * n))
    assert inside(replace(zero, heading=far, sigma=np.where(np.arange(3 * n).reshape(n, 3) < 3, 0.0, 1.0))) == 1.0
    hidden = ((t >= 1.0) & (t < 2.0)) | ((t >= 3.0) & (t < 3.5))
    assert hidden.any()
    assert np.array_equal(evaluate(without(run, drive, ((1.0, 2.0), (3.0, 3.5))), drive).t, t[~hidden])


def test_a_goal_is_missed_outside_its_bounds_or_beyond_the_other_case(monkeypatch: pytest.MonkeyPatch) -> None:
    cases: dict[str, Goals] = {
        "a": {"anees": (0.8, 1.4)},
        "b": {"aligned": ("a", 1.1)},
        "c": {"aligned": ("bound", 1.1)},
    }
    for name, goals in cases.items():
        monkeypatch.setitem(consistency.NAMED, name, replace(SHORT, name=name, goals=goals))
    good, bad = [1.0, 1.0, 2.0, 1.0, 1.0], [0.7, 1.0, 2.3, 1.0, 1.0]
    for figures, missed in ((good, ["", "", ""]), (bad, ["anees ≥ 0.8 ≤ 1.4", "", "aligned ≤ 2.2"])):
        rows = [{"task": [name, 1], "figures": figures, "bound": (0.002, 0.001)} for name in "abc"]
        lines = list(consistency.table(rows))[2:5]
        assert [line.split("|")[-2].strip() for line in lines] == missed


# --- the bound: held to closed forms of the wheels' noise and to the filter


def test_on_a_straight_way_the_wheels_noise_grows_as_its_closed_form() -> None:
    """var(along) = k D / 2, var(yaw) = 2 k D / L^2, var(across) = 2 k D^3 / (3 L^2): random walks, summed."""
    roll = Roll.of(simulated(SCENARIO, STRAIGHT, 1).outcome)
    t = np.linspace(2.0, 4.0, 201)
    P = np.zeros((3, 3))
    for begin, end in zip(t[:-1].tolist(), t[1:].tolist(), strict=True):
        P = moved(P, roll, (begin, end), NOISE, TRACK)
    (first, last), ways = roll.at(t[[0, -1]])
    D = float((ways[1] - ways[0]).mean())
    assert np.hypot(*(last - first)[:2]) == pytest.approx(D, rel=0.05)
    variances = sorted(np.linalg.eigvalsh(P[:2, :2]))
    assert sum(variances) == pytest.approx(NOISE * D / 2 + 2 * NOISE * D**3 / (3 * TRACK**2), rel=0.05)
    assert P[2, 2] == pytest.approx(2 * NOISE * D / TRACK**2, rel=1e-6)


def test_a_perfect_laser_leaves_what_the_wheels_slip_until_the_truth_s_next_stamp() -> None:
    """The truth is stamped 0.1 s less 25 ms of sweep and 7 ms after the sweep's beginning: 0.082 s of slip."""
    perfect = ("lrf.sigma_range=1e-5", "lrf.sigma_angle_deg=1e-4", "lrf.lost=0")
    found = bound(load(SCENARIO, (*STRAIGHT, *perfect)), 1, simulated(SCENARIO, STRAIGHT, 1).outcome)
    way = SPEED * (0.1 - 0.025 + 0.007)
    assert found[1] < 5e-4
    assert found[0] == pytest.approx(math.sqrt(NOISE * way / 2), rel=0.15)


def test_the_filter_is_near_the_bound_and_not_below_it() -> None:
    """A filter that learns the walls cannot beat one that knows them; one drive varies by 5 %."""
    row = consistency.work("laser alone", 1000)
    ratio = row["figures"][2] / (1000.0 * row["bound"][0])
    assert 0.95 < ratio < 1.15
