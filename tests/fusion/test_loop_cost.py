"""What the filter's loop costs, in calls, not seconds: the same on every machine."""

from __future__ import annotations

import sys

import pytest
from worlds import World

from locfuse.fusion.fuse import fuse
from locfuse.fusion.measure import measure


def calls(world: World, sensors: list[str]) -> tuple[int, int, int]:
    """Calls of any function while a drive is fused, and its instants and lines."""
    robot = world.robot()
    drive = measure(world.streams(), robot)
    fuse(drive, robot, sensors)  # what is computed once is computed
    count = 0

    def tally(_frame: object, event: str, _what: object) -> None:
        nonlocal count
        count += event in ("call", "c_call")

    sys.setprofile(tally)
    try:
        fuse(drive, robot, sensors)
    finally:
        sys.setprofile(None)
    return count, len(drive.t), len(drive.measurements["lrf"].z)


def test_odometry_costs_a_few_calls_per_instant() -> None:
    count, instants, _ = calls(World(), [])
    assert count / instants < 8


@pytest.mark.parametrize(("mode", "most"), [("first-scan", 9), ("grow", 18)])
def test_a_line_costs_a_few_calls(mode: str, most: float) -> None:
    """Instants and compass readings included, and the map frame: the robot moves before its first scan."""
    count, _, lines = calls(World(settings={"lrf": {"map": mode}}), ["compass", "lrf"])
    assert count / lines < most
