"""The table of `python -m benchmarks.consistency`: cases that can be driven, figures as named."""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec.structs import replace

from benchmarks import consistency
from benchmarks.consistency import Start, Wanted, alone, inside, share_inside, without
from benchmarks.consistency_cases import CASES, LASER, MOVING, Case, Goal, vague
from locfuse.cli.analysis.robot_tables import make_robot
from locfuse.formats.robot import robot_toml
from locfuse.fusion.data import Drive, Estimates
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.sample_logs.load import load
from locfuse.sample_logs.simulate import Simulation

SHORT = Case("short", LASER, Goal(), (*MOVING, "path.laps=0.1"))


@pytest.fixture(scope="module")
def short() -> tuple[Drive, Estimates]:
    drive, robot = consistency.drive_of(SHORT, 1)
    return drive, fuse(drive, robot, LASER)


def test_every_case_has_a_name_of_its_own() -> None:
    assert len({case.name for case in CASES}) == len(CASES)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_a_case_names_settings_that_exist(case: Case) -> None:
    tables = Simulation(load(case.scenario, case.sets), 1).robot_tables
    robot = make_robot(robot_toml.layered(tables, robot_toml.apply_sets(case.given)))
    assert all(robot.settings(sensor).topic for sensor in case.sensors)
    assert case.goal.aligned_as is None or case.goal.aligned_as[0] in {c.name for c in CASES}


def test_inside_counts_x_y_and_heading_and_leaves_out_what_is_exact(short: tuple[Drive, Estimates]) -> None:
    drive, run = short
    judged = evaluate(run, drive)
    n = len(judged.t)
    zero = replace(judged, deviation=np.zeros((n, 2)), heading=np.zeros(n), sigma=np.ones((n, 3)))
    far = np.where(np.arange(n) == 0, 3.1, 0.0)
    assert inside(zero) == 1.0
    assert inside(replace(zero, heading=far)) == pytest.approx(1 - 1 / (3 * n))
    assert inside(replace(zero, heading=far, sigma=np.where(np.arange(3 * n).reshape(n, 3) < 3, 0.0, 1.0))) == 1.0


def test_a_span_left_out_is_not_judged(short: tuple[Drive, Estimates]) -> None:
    drive, run = short
    judged = evaluate(without(run, drive, ((1.0, 2.0), (3.0, 3.5))), drive)
    whole = evaluate(run, drive).t
    hidden = ((whole >= 1.0) & (whole < 2.0)) | ((whole >= 3.0) & (whole < 3.5))
    assert hidden.any()
    assert np.array_equal(judged.t, whole[~hidden])


def test_a_drive_gives_finite_figures_and_a_line_of_the_table(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(consistency.NAMED, SHORT.name, replace(SHORT, goal=Goal((0.8, 1.4), walls=0.95)))
    found = consistency.judged(SHORT, 1)
    assert np.isfinite(found[:-1]).all()
    assert math.isnan(found.in_frame)  # nobody asked
    head, _, line = consistency.table([{"task": [SHORT.name, 1], "figures": list(found)}])
    assert line.count("|") == head.count("|")
    assert "ANEES ≥ 0.8 ≤ 1.4; inside ≥ 0.99; walls ≥ 0.95 |" in line


def test_a_goal_is_met_between_its_bounds_only() -> None:
    assert Wanted("ANEES", 1.0, 0.8, 1.4).met
    assert not Wanted("ANEES", 0.7, 0.8, 1.4).met
    assert not Wanted("ANEES", 1.5, high=1.4).met


def test_the_starts_alone_have_the_anees_of_what_the_simulator_draws() -> None:
    """That of the very errors with which the drives begin, over the sigmas that are stated."""
    off = []
    for seed in (1, 2, 3):
        tables = Simulation(load("rounded_rectangle", vague(2, 0.05)), seed).robot_tables["start"]
        true = Simulation(load("rounded_rectangle", MOVING), seed).robot_tables["start"]
        off.append([(tables[k] - true[k]) / sigma for k, sigma in (("x", 0.05), ("y", 0.05), ("theta_deg", 2.0))])
    found = alone(Start(math.radians(2.0), 0.05), np.zeros((1, 2)), range(1, 4))
    assert found.anees == pytest.approx(float(np.square(off).mean()), rel=1e-6)


def test_a_start_s_error_goes_with_the_drive_as_its_sigma_does() -> None:
    """On a straight way one draw decides each direction: beside the start x, y mix with the heading's lever."""
    way = np.stack((np.linspace(0.0, 50.0, 200), np.zeros(200)), axis=-1)
    start = Start(math.radians(2.0), 0.05)
    x, y, heading = 2.9, 3.1, 3.2
    beside = 3.0 * 0.05 / math.sqrt(heading**2 - 9.0) / math.radians(2.0) / 50.0  # of the way has y inside
    assert share_inside(np.array([[x, 0.0, 0.0]]), start, way)[0] == 1.0
    assert share_inside(np.array([[0.0, 0.0, heading]]), start, way)[0] == pytest.approx(
        (1.0 + beside) / 3.0, abs=0.01
    )
    at_first = share_inside(np.array([[0.0, y, 0.0]]), start, way)[0]  # the lever's variance hides it soon
    assert 0.98 < at_first < 1.0


def test_a_vague_start_s_goal_is_what_its_draws_allow_and_others_keep_theirs() -> None:
    seeds = range(1000, 1030)
    vaguely = next(c for c in CASES if c.name == "laser, start 2°, 0.05 m")
    found = dict.fromkeys((vaguely.name, SHORT.name), consistency.Figures(1.0, 0.0, 0.0, 1.0, 1.0))
    least = {
        c.name: [w.low for w in consistency.wanted(c, found, seeds) if w.name == "inside"]
        for c in (vaguely, SHORT)
    }
    assert least[vaguely.name] == pytest.approx([0.9806 - consistency.LEEWAY], abs=0.002)
    assert least[SHORT.name] == [0.99]


def test_a_laser_whose_clock_is_off_is_judged_as_the_drive_tells_it() -> None:
    case = next(c for c in CASES if c.late_by)
    (given,) = set(consistency.as_found(case, 1001).given) - set(case.given)
    assert float(given.removeprefix("lrf.time_offset=")) == pytest.approx(-case.late_by, abs=0.005)
    assert consistency.as_found(SHORT, 1) is SHORT
