"""A series of slips is none: the first was a mistake, as walls from before it show, or the robot is carried."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from worlds import World

from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.map.line_map import Association
from locfuse.fusion.map.scan import Scan
from locfuse.fusion.map.slips import CARRIED, Series, after_slip, continues
from locfuse.fusion.map.tracker import LineTracker
from locfuse.fusion.measure import measure

FALSE_TURN = math.radians(-8.0)


def test_a_series_that_began_with_a_mistake_is_taken_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """A slip is made up at 8 s, three more follow from it; the wheels were right all the time."""
    made_up: list[float] = []
    true_share = Association.share

    def wrong(scan: Scan, lines: Any, belief: Any, again: Any) -> Any:
        if len(made_up) >= CARRIED:
            return after_slip(scan, lines, belief, again)
        made_up.append(belief.theta)
        belief.shift(FALSE_TURN, 0.03**2, math.radians(1.5) ** 2)
        return again()

    def share(found: Any) -> float:
        return 0.1 if now[0] > 8.0 and len(made_up) < CARRIED else true_share(found)

    def innovations(tracker: LineTracker, m: Any, i: int, belief: Any) -> Any:
        now[0] = float(m.t[i])
        return asked(tracker, m, i, belief)

    now, asked = [0.0], LineTracker.innovations
    monkeypatch.setattr("locfuse.fusion.map.guard.after_slip", wrong)
    monkeypatch.setattr(Association, "share", share)
    monkeypatch.setattr(LineTracker, "innovations", innovations)
    world = World(seconds=16.0)
    drive = measure(world.streams(), world.robot())
    found = fuse(drive, world.robot(), ["lrf"])
    assert len(made_up) == CARRIED
    assert not found.lost
    judged = evaluate(found, drive)
    late = judged.t > 10.0
    assert np.hypot(*judged.deviation[late].T).max() < 0.1


def test_a_series_goes_on_only_while_its_slips_follow_each_other() -> None:
    scan = Scan.of(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 2)))
    series, pose = Series(), (1.0, 2.0, 0.5)
    for k in range(CARRIED - 1):
        assert not series.goes_on((0.5 * k, pose, scan), (), pose)
    assert not series.goes_on((60.0, pose, scan), (), pose)  # a slip a minute later begins another one
    assert [series.goes_on((60.1 + 0.1 * k, pose, scan), (), pose) for k in range(CARRIED - 1)] == [
        *(False,) * (CARRIED - 2),
        True,
    ]
    assert series.begun == 60.0


def test_without_a_series_the_robot_is_where_it_was_before_and_the_wheels_took_it() -> None:
    """The first slip found it at (1, 2, 90 deg); the wheels went 1 m ahead and turned by 30 degrees since."""
    scan = Scan.of(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 2)))
    series = Series()
    series.goes_on((0.0, (5.0, 5.0, 0.0), scan), (), (1.0, 2.0, math.pi / 2))
    found = series.undone((0.4, (6.0, 5.0, math.radians(30.0)), scan))
    np.testing.assert_allclose(found, (1.0, 3.0, math.radians(120.0)), atol=1e-12)


def test_walls_continue_where_the_wheels_expect_them_and_not_elsewhere() -> None:
    walls = np.array([[2.0, 0.0], [1.0, math.pi / 2], [3.0, -math.pi / 2]])
    ends = np.tile([-1.0, 1.0], (3, 1))
    before = (0.0, (0.0, 0.0, 0.0), Scan.of(walls, np.zeros((3, 2, 2)), ends))
    ahead = Scan.of(walls - [[0.5, 0.0], [0.0, 0.0], [0.0, 0.0]], np.zeros((3, 2, 2)), ends)
    assert continues([before], (0.1, (0.5, 0.0, 0.0), ahead), slip=0.0)
    turned = Scan.of(walls - [0.0, math.radians(10.0)], np.zeros((3, 2, 2)), ends)
    assert not continues([before], (0.1, (0.0, 0.0, 0.0), turned), slip=0.0)
    assert continues([before], (0.1, (0.0, 0.0, 0.0), turned), slip=math.radians(15.0))
