"""Iron about a magnetometer, simulated: on the robot it is a setting, in the room it is a place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from locfuse.cli.session.session import load
from locfuse.fusion.checks.compass import of_iron
from locfuse.fusion.checks.finding import Finding
from locfuse.sample_logs.load import load as scenario_of
from locfuse.sample_logs.record import on_truth, write_log

CLEAN = ("compass.hard_iron=[0, 0]", "compass.soft_iron=[1, 1, 0]", "camera.enabled=false", "lrf.enabled=false")
CABINET = 'faults=[{kind="magnetic", x=4.0, y=5.4, strength=4e-6, axis_deg=20}]'


def found(folder: Path, *sets: str, robot: tuple[str, ...] = ()) -> list[Finding]:
    log = folder / f"{len(robot)}.mcap"
    write_log(scenario_of("rounded_rectangle", (*CLEAN, *sets)), 3000, on_truth, log)
    loaded = load(log, sets=robot).loaded
    return of_iron(loaded.drive, loaded.robot, {"compass": loaded.stream("compass")})


def test_a_field_without_iron_says_nothing(tmp_path: Path) -> None:
    assert found(tmp_path) == []


def test_a_magnet_on_the_robot_is_measured_and_is_no_finding_once_it_is_set(tmp_path: Path) -> None:
    """By 14 % of the field."""
    (one,) = found(tmp_path, "compass.hard_iron=[2.8e-6, 0]")
    (fix,) = one.fixes
    key, _, value = fix.partition("=")
    assert (one.code, key, one.severe) == ("iron", "compass.hard_iron", True)
    x, y = (float(v) for v in value.strip("[]").split(","))
    assert x == pytest.approx(2.8e-6, rel=0.05)
    assert y == pytest.approx(0.0, abs=2e-7)
    assert found(tmp_path, "compass.hard_iron=[2.8e-6, 0]", robot=(fix,)) == []


def test_steel_on_the_robot_is_an_ellipse_which_is_no_finding_once_it_is_set(tmp_path: Path) -> None:
    """10 % longer along one axis and shorter along the other: the setting undoes both."""
    steel = "compass.soft_iron=[1.1, 0.9, 0]"
    (one,) = found(tmp_path, steel)
    (fix,) = one.fixes
    key, _, value = fix.partition("=")
    assert (one.code, key) == ("iron", "compass.soft_iron")
    xx, xy, _, yy = (float(v) for v in value.strip("[]").split(","))
    assert (xx / yy, xy) == pytest.approx((0.9 / 1.1, 0.0), abs=0.02)
    assert found(tmp_path, steel, robot=(fix,)) == []


def test_a_steel_cabinet_is_named_with_its_place(tmp_path: Path) -> None:
    (one,) = found(tmp_path, CABINET)
    assert one.code == "iron in the room"
    assert not one.severe
    x, y = (float(v) for v in one.message.partition("(")[2].partition(")")[0].split(","))
    assert np.hypot(x - 4.0, y - 5.4) < 2.0
