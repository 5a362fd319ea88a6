"""A slip turns the pose only where the next scans and matched scans confirm it; a carried robot slips for ever."""

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
from locfuse.fusion.map.slips import DECIDING_SCANS, MIN_GAIN, SURE_GAIN, Suspicion, agree, continues
from locfuse.fusion.map.tracker import LineTracker
from locfuse.fusion.measure import measure

FALSE_TURN = math.radians(-8.0)


def test_a_slip_that_nothing_but_one_scan_asks_for_does_not_turn_the_pose(monkeypatch: pytest.MonkeyPatch) -> None:
    """At 8 s one scan matches nowhere but at a false heading; the wheels were right all the time."""
    true_share, asked = Association.share, LineTracker.innovations
    now, made_up = [0.0], []

    def wrong(*_: Any) -> float:
        made_up.append(now[0])
        return FALSE_TURN

    def share(found: Any) -> float:
        return 0.1 if now[0] > 8.0 and not made_up else true_share(found)

    def innovations(tracker: LineTracker, m: Any, i: int, belief: Any) -> Any:
        now[0] = float(m.t[i])
        return asked(tracker, m, i, belief)

    monkeypatch.setattr("locfuse.fusion.map.guard.slip_turn", wrong)
    monkeypatch.setattr(Association, "share", share)
    monkeypatch.setattr(LineTracker, "innovations", innovations)
    world = World(seconds=16.0)
    drive = measure(world.streams(), world.robot())
    found = fuse(drive, world.robot(), ["lrf"])
    assert made_up
    assert not found.lost
    assert not found.slips
    judged = evaluate(found, drive)
    assert np.hypot(*judged.deviation.T).max() < 0.1


def test_a_slip_waits_for_scans_and_needs_less_of_them_where_matched_scans_agree() -> None:
    suspicion = Suspicion(math.radians(10.0))
    for _ in range(DECIDING_SCANS):
        assert not suspicion.decided
        suspicion.look(0.1, 0.1 + 0.5 * (MIN_GAIN + SURE_GAIN))
    assert suspicion.decided
    assert suspicion.confirmed(0.5 * (MIN_GAIN + SURE_GAIN), by_scans=True)
    assert not suspicion.confirmed(0.5 * (MIN_GAIN + SURE_GAIN), by_scans=False)
    assert not suspicion.confirmed(0.0, by_scans=True)  # the last scan does not ask for it any more
    assert Suspicion.waits(math.radians(-10.0))
    assert not Suspicion.waits(math.radians(2.0))


def test_scans_agree_on_a_turn_that_is_nearly_the_same_also_across_half_a_turn() -> None:
    assert agree(math.radians(179.0), math.radians(-179.0))
    assert not agree(math.radians(5.0), math.radians(-5.0))
    assert not agree(None, 0.0)


def test_walls_continue_where_the_wheels_expect_them_and_not_elsewhere() -> None:
    walls = np.array([[2.0, 0.0], [1.0, math.pi / 2], [3.0, -math.pi / 2]])
    ends = np.tile([-1.0, 1.0], (3, 1))
    before = (0.0, (0.0, 0.0, 0.0), Scan.of(walls, np.zeros((3, 2, 2)), ends))
    ahead = Scan.of(walls - [[0.5, 0.0], [0.0, 0.0], [0.0, 0.0]], np.zeros((3, 2, 2)), ends)
    assert continues([before], (0.1, (0.5, 0.0, 0.0), ahead), slip=0.0)
    turned = Scan.of(walls - [0.0, math.radians(10.0)], np.zeros((3, 2, 2)), ends)
    assert not continues([before], (0.1, (0.0, 0.0, 0.0), turned), slip=0.0)
    assert continues([before], (0.1, (0.0, 0.0, 0.0), turned), slip=math.radians(15.0))
