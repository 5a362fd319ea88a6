"""What the filter's loop costs, in calls of Python functions, not seconds: the same on every machine."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import pytest
from worlds import World

from locfuse.fusion.fuse import Filter
from locfuse.fusion.instants import due_readings, steps_of
from locfuse.fusion.measure import measure


def calls(world: World, sensors: list[str], due: list[str]) -> float:
    """Calls of an instant at which these sensors have a reading each: the median of half a drive."""
    robot = world.robot()
    drive = measure(world.streams(), robot)
    run, steps = Filter(robot, sensors, instants=len(drive.t)), steps_of(drive)
    found: list[int] = []
    count = 0

    def tally(_frame: Any, event: str, _what: Any) -> None:
        nonlocal count
        count += event == "call"

    for k, readings in enumerate(due_readings(drive, sensors)):
        count = 0
        sys.setprofile(tally)
        try:
            run.advance(k, steps, readings, drive.measurements)
        finally:
            sys.setprofile(None)
        if [sensor for sensor, _ in readings] == due and 2 * k > len(drive.t):
            found.append(count)
    assert len(found) > 50
    return float(np.median(found))


def test_a_motion_costs_three_calls() -> None:
    """The loop, the belief and the record; all equations are compiled."""
    assert calls(World(), [], []) <= 3


def test_a_heading_costs_fewer_than_twenty_calls() -> None:
    assert calls(World(), ["compass"], ["compass"]) <= 17


@pytest.mark.parametrize(("mode", "most"), [("first-scan", 28), ("refine", 32), ("grow", 43)])
def test_a_scan_costs_at_most_so_many_calls_however_many_lines_it_has(mode: str, most: float) -> None:
    assert calls(World(settings={"lrf": {"map": mode}}), ["compass", "lrf"], ["lrf"]) <= most
