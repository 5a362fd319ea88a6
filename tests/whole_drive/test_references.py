"""References of a drive without truth: which sets of sensors are solved, and which of them judges what."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from msgspec.structs import replace

import locfuse
from locfuse.fusion.data import Drive, UsageError
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.robot import Robot
from locfuse.fusion.whole_drive.reference import References, refuse, sets

NO_TRUTH = {"truth.topic": "none"}


@cache
def session() -> locfuse.Session:
    return locfuse.load("rounded_triangle", sets=NO_TRUTH)


@cache
def references() -> References:
    found = References.of(session().drive, session().robot, {}, {"compass": 10.0})
    assert found is not None
    return found


def only(*sensors: str) -> Drive:
    drive = session().drive
    return replace(drive, measurements={s: m for s, m in drive.measurements.items() if s in sensors})


def test_all_sensors_are_solved_and_all_but_each_that_leave_one_which_locates() -> None:
    assert sets(session().drive) == [
        ("compass", "lrf", "camera"),
        ("lrf", "camera"),
        ("compass", "camera"),
        ("compass", "lrf"),
    ]
    assert sets(only("compass", "lrf")) == [("compass", "lrf"), ("lrf",)]
    assert sets(only("compass")) == []


def test_where_no_sensor_says_where_the_robot_is_there_is_no_reference() -> None:
    with pytest.raises(UsageError, match="no sensor of this log says where"):
        refuse(only("compass"), session().robot)


def test_a_sensor_that_measured_nothing_makes_no_reference() -> None:
    """A dead laser: its whole-drive solution would be the odometry, and judge it as perfect."""
    both = only("compass", "lrf")
    lrf = both.measurements["lrf"]
    none = replace(lrf, t=lrf.t[:0], first=lrf.first[:1], z=lrf.z[:0], R_unit=lrf.R_unit[:0])
    dead = replace(both, measurements={**both.measurements, "lrf": none})
    assert sets(dead) == []
    with pytest.raises(UsageError, match="no sensor of this log says where"):
        refuse(dead, session().robot)


def test_a_log_with_truth_needs_no_reference() -> None:
    log = locfuse.load("rounded_triangle")
    with pytest.raises(UsageError, match="has a truth, /ground_truth/pose"):
        refuse(log.drive, log.robot)


def test_a_sensor_is_judged_by_the_others_and_all_of_them_by_all() -> None:
    found = references()
    for sensors, judge in [
        ((), ("compass", "lrf", "camera")),
        (("compass",), ("lrf", "camera")),
        (("camera",), ("compass", "lrf")),
        (("compass", "lrf", "camera"), ("compass", "lrf", "camera")),
    ]:
        e = fuse(session().drive, session().robot, sensors)
        _, reference = found.judged(evaluate(e, session().drive), e, "none")
        assert reference.sensors == judge


def test_errors_by_reference_are_those_by_truth_where_the_reference_is_exact_enough() -> None:
    """Held against the sample log's truth, which the reference has not seen."""
    with_truth = locfuse.load("rounded_triangle")
    for sensors in [(), ("compass",), ("camera",)]:
        e = fuse(session().drive, session().robot, sensors)
        judged, _ = references().judged(evaluate(e, session().drive), e, "none")
        true = evaluate(fuse(with_truth.drive, with_truth.robot, sensors), with_truth.drive)
        assert judged.figures["position_rmse_m"] == pytest.approx(true.figures["position_rmse_m"], rel=0.05)


def test_a_laser_better_than_the_reference_without_it_is_judged_by_all_which_it_shares() -> None:
    e = fuse(session().drive, session().robot, ("lrf",))
    judged, reference = references().judged(evaluate(e, session().drive), e, "none")
    assert reference.left_out == ()
    error = judged.figures["position_rmse_m"]
    assert error is not None
    assert error < references().solved[frozenset({"compass", "camera"})].sigma


def test_sensors_that_contradict_each_other_do_not_judge_each_other() -> None:
    found = replace(references(), contradict=[("compass", "lrf")])
    e = fuse(session().drive, session().robot, ("compass",))
    _, reference = found.judged(evaluate(e, session().drive), e, "none")
    assert reference.left_out == ()


def test_the_one_that_contradicts_all_others_is_judged_by_them_and_judges_nobody() -> None:
    found = replace(references(), contradict=[("camera", "compass"), ("compass", "lrf")])
    assert found.outlier == "compass"
    assert found.whole.left_out == ("compass",)
    for sensor, judge in [("compass", ("lrf", "camera")), ("camera", ("lrf", "camera"))]:
        e = fuse(session().drive, session().robot, (sensor,))
        _, reference = found.judged(evaluate(e, session().drive), e, "none")
        assert reference.sensors == judge


def test_a_reference_is_solved_with_the_noise_that_residuals_show() -> None:
    robot: Robot = session().robot
    drive = only("compass", "camera")
    sure, honest = (References.of(drive, robot, {}, {"compass": k}) for k in (1.0, 10.0))
    assert sure is not None
    assert honest is not None
    assert honest.whole.sigma > 1.1 * sure.whole.sigma
    assert np.isfinite(honest.whole.sigma)
