"""Many instants at once are what instant by instant is, whatever lies on the way."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from worlds import World

from locfuse.fusion.coast import Stretches
from locfuse.fusion.core.form import form
from locfuse.fusion.core.room import Room
from locfuse.fusion.data import VERDICTS, Drive, Estimates, LocfuseError
from locfuse.fusion.fuse import Filter, fuse
from locfuse.fusion.instants import due_readings, steps_of
from locfuse.fusion.measure import measure
from locfuse.fusion.robot import Robot, StartSettings

DRIFTING = {"compass": {"offset_drift_deg": 0.2}}
KNOWN = {"compass": {"offset_deg": math.degrees(0.7)}}


def drive_of(settings: Mapping[str, Any]) -> tuple[Drive, Robot]:
    world = World(seconds=8.0, settings=dict(settings))
    robot = replace(world.robot(), start=StartSettings(x=1.5, y=1.5, sigma_xy=0.1, sigma_theta_deg=5.0))
    return measure(world.streams(), robot), robot


def instant_by_instant(drive: Drive, robot: Robot, sensors: Sequence[str]) -> Estimates:
    run = Filter(robot, sensors)
    for k, (step, due) in enumerate(zip(steps_of(drive), due_readings(drive, sensors), strict=True)):
        run.advance(k, step, due, drive.measurements)
    return run.estimates(drive, "the loop")


def assert_same(a: Estimates, b: Estimates) -> None:
    np.testing.assert_allclose(a.pose, b.pose, atol=1e-11)
    np.testing.assert_allclose(a.triangles, b.triangles, rtol=1e-9, atol=1e-15)
    for name in a.blocks:
        np.testing.assert_allclose(a.blocks[name], b.blocks[name], atol=1e-11)
        np.testing.assert_allclose(a.block_sigmas[name], b.block_sigmas[name], rtol=1e-9)
    for name, audit in a.audits.items():
        other = b.audits[name]
        for column in ("instant", "row", "verdict", "landmark", "threshold"):
            np.testing.assert_array_equal(getattr(audit, column), getattr(other, column), column)
        for column in ("nis", "y", "sigma"):
            np.testing.assert_allclose(getattr(audit, column), getattr(other, column), rtol=1e-7, atol=1e-12)


@pytest.mark.parametrize("settings", [{}, KNOWN, DRIFTING], ids=["estimated", "known", "drifting"])
@pytest.mark.parametrize("sensors", [(), ("compass",), ("compass", "lrf"), ("lrf",)])
def test_a_drive_in_stretches_is_the_drive_instant_by_instant(
    settings: Mapping[str, Any], sensors: tuple[str, ...]
) -> None:
    drive, robot = drive_of(settings)
    assert_same(fuse(drive, robot, sensors), instant_by_instant(drive, robot, sensors))


def test_a_heading_beyond_its_gate_and_one_in_a_disturbed_field_correct_nothing() -> None:
    drive, robot = drive_of(KNOWN)
    m = drive.measurements["compass"]
    z, strength = m.z.copy(), m.extra["strength"].copy()
    z[[20, 41]] += 2.0
    strength[[30, 41]] = 3.0
    drive.measurements["compass"] = replace(m, z=z, extra={**m.extra, "strength": strength})
    run = fuse(drive, robot, ["compass"])
    verdicts = run.audits["compass"].verdict
    assert [VERDICTS[v] for v in verdicts[[20, 30, 41]]] == ["gate", "disturbed", "disturbed"]
    assert (np.delete(verdicts, [20, 30, 41]) == 0).all()
    assert_same(run, instant_by_instant(drive, robot, ["compass"]))


def test_two_headings_at_one_instant_share_one_prior() -> None:
    drive, robot = drive_of({})
    when = drive.instant["compass"].copy()
    when[25] = when[24]
    drive.instant["compass"] = when
    assert_same(fuse(drive, robot, ["compass"]), instant_by_instant(drive, robot, ["compass"]))


def test_what_the_core_does_not_know_is_left_to_the_loop() -> None:
    """Wheel parameters as states, refused readings that are kept with more noise, readings that only listen."""
    for settings, sensors in (
        ({"wheels": {"estimate": True}}, ["compass", "lrf"]),
        ({"compass": {"outliers": "inflate"}}, ["compass"]),
        ({"lrf": {"map": "consider"}}, ["compass", "lrf"]),
    ):
        drive, robot = drive_of(settings)
        assert_same(fuse(drive, robot, sensors), instant_by_instant(drive, robot, sensors))
    drive, robot = drive_of({})
    every = {"compass": np.ones(len(drive.measurements["compass"].z), np.bool_)}
    heard = fuse(drive, robot, ["lrf"], listen=every)
    np.testing.assert_array_equal(heard.pose, fuse(drive, robot, ["lrf"]).pose)


@pytest.mark.skipif(form().functions is None, reason="the core is not compiled")
def test_both_forms_of_the_core_give_the_same_to_the_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    drive, robot = drive_of(DRIFTING)
    compiled = fuse(drive, robot, ["compass", "lrf"])
    monkeypatch.setattr("locfuse.fusion.core.room._here", lambda source: Room.of(source, None))
    interpreted = fuse(drive, robot, ["compass", "lrf"])
    for a, b in ((compiled.pose, interpreted.pose), (compiled.triangles, interpreted.triangles)):
        assert a.tobytes() == b.tobytes()
    for name, audit in compiled.audits.items():
        for column in ("verdict", "landmark", "nis", "y", "sigma", "joint"):
            assert getattr(audit, column).tobytes() == getattr(interpreted.audits[name], column).tobytes()


def test_a_variance_that_rounding_ate_is_one_line() -> None:
    drive, robot = drive_of(KNOWN)
    m = drive.measurements["compass"]
    drive.measurements["compass"] = replace(m, R_unit=np.full_like(m.R_unit, -1.0))
    with pytest.raises(LocfuseError, match="span too many powers of ten"):
        fuse(drive, robot, ["compass"])


def test_stretches_end_where_a_scan_is_due() -> None:
    drive, robot = drive_of({})
    run = Filter(robot, ["compass", "lrf"])
    on = Stretches(drive, run.models, run.belief)
    scans = drive.instant["lrf"].tolist()
    assert on.until(0) == scans[0]
    assert on.until(scans[0] + 1) == scans[1]
    assert on.until(scans[-1] + 1) == len(drive.t)
