"""A truth with headings says first whose mean is off: held to a compass that is right and a run that is not."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

import locfuse
from locfuse.fusion.data import Drive
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.consistency import Evidence, Run, as_run, judge
from locfuse.fusion.judge.noise_verdicts import biased_against
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.truth import body_poses

NOISE_RAD = math.radians(0.5)


@pytest.fixture(scope="module")
def right() -> tuple[Drive, Robot]:
    """Twenty seconds whose compass reads the true heading with white noise of half a degree."""
    session = locfuse.load("rounded_triangle", between=(None, 20.0), sets={"compass.offset_deg": 0.0})
    drive, robot = session.drive, session.robot
    m, truth = drive.measurements["compass"], drive.truth
    assert truth is not None
    noise = NOISE_RAD * np.random.default_rng(17).normal(size=len(m.t))
    z = (body_poses(truth, m.t)[:, 2] + noise)[:, None]
    exact = replace(m, z=z, scale=NOISE_RAD, R_unit=np.ones_like(m.R_unit), floor=np.zeros_like(m.floor))
    return replace(drive, measurements={**drive.measurements, "compass": exact}), robot


def runs(drive: Drive, robot: Robot, turned_deg: float) -> list[Run]:
    """Runs of compass and laser; that of the laser is turned, and claims to be sure of it."""
    found = [fuse(drive, robot, sensors) for sensors in ((), ("compass",), ("lrf",))]
    pose = found[2].pose + np.array([0.0, 0.0, math.radians(turned_deg)])
    found[2] = replace(found[2], pose=pose, triangles=1e-3 * found[2].triangles)
    return [Run.of(drive, e) for e in found]


def test_a_sure_run_that_is_wrong_does_not_accuse_a_sensor_that_truth_finds_right(
    right: tuple[Drive, Robot],
) -> None:
    drive, robot = right
    assert judge(runs(drive, robot, 3.0), robot)["compass"]["compass"].verdict == "consistent"
    blind = replace(drive, truth=None)
    assert judge(runs(blind, robot, 3.0), robot)["compass"]["compass"].verdict != "consistent"


@pytest.mark.parametrize("off_deg", [-4.0, 2.0])
def test_an_offset_is_measured_against_the_truth_and_not_against_a_run(
    right: tuple[Drive, Robot], off_deg: float
) -> None:
    drive, robot = right
    m = drive.measurements["compass"]
    off = replace(drive, measurements={**drive.measurements, "compass": replace(m, z=m.z + math.radians(off_deg))})
    found = judge(runs(off, robot, 1.0), robot)["compass"]["compass"]
    assert found.verdict == "biased"
    # of some hundred readings of half a degree
    assert found.cures["compass.offset_deg"] == pytest.approx(off_deg, abs=0.15)
    assert "compass.sigma_offset_deg" not in found.cures  # the truth is exact: nothing but the readings' own noise


def test_an_offset_by_a_run_is_set_with_how_well_that_run_knows_its_heading(right: tuple[Drive, Robot]) -> None:
    """One that was set as exact would pull the estimate to the run's own error with the weight of all readings."""
    drive, robot = right
    m = drive.measurements["compass"]
    off = replace(m, z=m.z + math.radians(8.0))
    blind = replace(drive, truth=None, measurements={**drive.measurements, "compass": off})
    found = runs(blind, robot, 0.0)
    laser = found[2].estimates
    for sigma_deg in (0.5, 1.5):
        triangles = laser.triangles.copy()
        triangles[:, 5] = math.radians(sigma_deg) ** 2
        found[2] = found[2]._replace(estimates=replace(laser, triangles=triangles))
        cures = judge(found, robot)["compass"]["compass"].cures
        assert cures["compass.sigma_offset_deg"] == pytest.approx(sigma_deg, rel=0.1)
        assert cures["compass.offset_deg"] == pytest.approx(8.0, abs=2 * sigma_deg)


def test_a_sensor_that_takes_no_sigma_of_its_offset_gets_none(right: tuple[Drive, Robot]) -> None:
    drive, robot = right
    heard = Evidence(runs(drive, robot, 0.0), robot).reference_runs("compass")[0][1]
    off = heard._replace(bias=math.radians(5.0), sure=math.radians(0.4))
    camera: Any = REGISTRY["camera"].Settings
    assert set(biased_against("camera", camera(), off).cures) == {"camera.zero_deg", "camera.sigma_yaw_deg"}
    assert set(biased_against("camera", camera(bearing="absolute"), off).cures) == {"camera.zero_deg"}


def test_an_offset_that_is_too_small_to_be_sure_of_is_still_known(right: tuple[Drive, Robot]) -> None:
    drive, robot = right
    m = drive.measurements["compass"]
    off = replace(drive, measurements={**drive.measurements, "compass": replace(m, z=m.z + math.radians(0.4))})
    found = Evidence(runs(off, robot, 0.0), robot).bias("compass")
    assert found is not None
    assert found.cures["compass.offset_deg"] == pytest.approx(0.4, abs=0.15)
    assert Evidence(runs(drive, robot, 0.0), robot).bias("compass") is None


def test_a_truth_is_no_reference_where_it_has_a_gap_or_another_frame(right: tuple[Drive, Robot]) -> None:
    drive, robot = right
    truth, e = drive.truth, fuse(drive, robot, ())
    assert truth is not None
    assert truth.theta is not None
    kept = (truth.t < 5.0) | (truth.t > 9.0)
    gap = replace(truth, t=truth.t[kept], xy=truth.xy[kept], theta=truth.theta[kept])
    run = as_run(replace(drive, truth=gap), e)
    assert run is not None
    inside = (drive.t > 5.1) & (drive.t < 8.9)
    assert np.isnan(run.estimates.pose[inside]).all()
    assert np.isfinite(run.estimates.pose[(drive.t > 1.0) & (drive.t < 4.9)]).all()
    assert as_run(replace(drive, truth=replace(truth, xy=truth.xy + 2.0)), e) is None
    assert as_run(replace(drive, truth=replace(truth, theta=truth.theta + 1.0)), e) is None
    assert as_run(replace(drive, truth=replace(truth, theta=None)), e) is None


def test_readings_in_a_gap_of_the_truth_are_not_compared(right: tuple[Drive, Robot]) -> None:
    """There the compass is wild: nobody may hear of it."""
    drive, robot = right
    truth, m = drive.truth, drive.measurements["compass"]
    assert truth is not None
    assert truth.theta is not None
    kept = (truth.t < 5.0) | (truth.t > 12.0)
    gap = replace(truth, t=truth.t[kept], xy=truth.xy[kept], theta=truth.theta[kept])
    wild = replace(m, z=m.z + 0.2 * ((m.t > 5.2) & (m.t < 11.8))[:, None])
    off = replace(drive, truth=gap, measurements={**drive.measurements, "compass": wild})
    assert judge(runs(off, robot, 0.0), robot)["compass"]["compass"].verdict != "biased"
