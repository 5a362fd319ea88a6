"""Left and right exchanged, on a robot without a sensor that turns: a truth of points shows it."""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec.structs import replace

from locfuse.cli.session.session import load
from locfuse.fusion.checks.finding import Finding
from locfuse.fusion.checks.turning import of_turning
from locfuse.sample_logs.load import load as scenario_of
from locfuse.sample_logs.record import on_truth, write_log

WHEELS_ALONE = ("compass.enabled=false", "camera.enabled=false", "lrf.enabled=false")


def found(log: Path, *sets: str, headings: bool) -> list[Finding]:
    loaded = load(log, sets=sets).loaded
    truth = loaded.drive.truth
    assert truth is not None
    drive = loaded.drive if headings else replace(loaded.drive, truth=replace(truth, theta=None))
    return of_turning(drive, loaded.robot, {}, {"wheels": loaded.stream("wheels")})


@pytest.mark.parametrize("headings", [False, True])
def test_exchanged_wheels_are_named_by_their_joints_and_right_ones_are_not(tmp_path: Path, headings: bool) -> None:
    log = tmp_path / "wheels.mcap"
    write_log(scenario_of("rounded_rectangle", WHEELS_ALONE), 3000, on_truth, log)
    assert found(log, headings=headings) == []
    joints = load(log).loaded.stream("wheels").columns("name")["name"][0]
    left, right = (next(j for j in joints if side in j) for side in ("left", "right"))
    exchanged = (f"wheels.left={right}", f"wheels.right={left}")
    (one,) = found(log, *exchanged, headings=headings)
    assert (one.code, one.severe) == ("swapped", True)
    assert set(one.fixes) == {f"wheels.left={left}", f"wheels.right={right}"}
