"""Carried off, slipped, lost: what the guard must notice, and what it must never claim."""

import math
from typing import Any

import numpy as np
import pytest
from bags import real_log
from numpy.typing import NDArray
from worlds import PLATES, ROOM, World

from locfuse.cli.analysis.load import load
from locfuse.cli.analysis.settings import LogOptions
from locfuse.fusion.data import Array, Estimates, Evaluation
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.map.line_map import Association
from locfuse.fusion.map.scan import Scan
from locfuse.fusion.map.slips import (
    DECIDING_SCANS,
    RecentScans,
    Slide,
    continues,
    expected_share,
)
from locfuse.fusion.map.tracker import LineTracker
from locfuse.fusion.se2 import wrap

AT = 12.0  # s


class Carried(World):
    """At AT the robot is somewhere else, at once: its wheels felt nothing."""

    jump: tuple[float, float, float] = (0.7, 0.5, math.radians(40.0))
    seconds: float = 24.0

    def pose(self, t: Array, x0: tuple[float, float, float] | None = None) -> Array:
        before = super().pose(t, x0)
        x, y, a = super().pose(np.array([AT]), x0)[0] + np.array(self.jump)
        after = super().pose(t - AT, (float(x), float(y), float(a)))
        return np.where(t[:, None] < AT, before, after)


def judged(world: World, sensors: list[str]) -> tuple[Estimates, Evaluation]:
    drive, robot = world.measured()
    estimates = fuse(drive, robot, sensors)
    return estimates, evaluate(estimates, drive)


def outside(estimates: Estimates, judged: Evaluation) -> Array:
    """Position errors [m] where the run does not say that it is lost."""
    known = np.ones(len(judged.t), dtype=bool)
    for start, end in (*estimates.lost, (AT - 0.15, AT + 0.15)):  # between two scans nobody can know
        known &= (judged.t < start) | (judged.t > end)
    errors: Array = np.hypot(*judged.deviation[known].T)
    return errors


# nothing is seen through where it is carried nearer: to the map these are new walls before the old ones
JUMPS, NEARER = (
    ((0.7, 0.5, 40.0), (1.5, 1.0, 130.0), (-0.5, -1.0, -90.0)),
    ((2.5, 0.5, 40.0), (1.5, 0.5, -60.0), (-1.0, 0.8, 100.0)),
)


@pytest.mark.parametrize(
    ("jump", "plates", "sensors"),
    [(j, PLATES, s) for s in (["lrf"], ["compass", "lrf"]) for j in JUMPS] + [(j, (), ["lrf"]) for j in NEARER],
)
def test_a_kidnapped_robot_is_never_overconfident(
    jump: tuple[float, float, float], plates: tuple[tuple[float, ...], ...], sensors: list[str]
) -> None:
    world = Carried(jump=(jump[0], jump[1], math.radians(jump[2])), walls=(*ROOM, *plates), seconds=16.0)
    found, figures = judged(world, sensors)
    assert found.lost
    assert AT - 0.15 <= found.lost[0][0] <= AT + 3.0  # from the last scan that fitted
    assert outside(found, figures).max() < 0.1
    assert any("lost" in note for note in found.notes)


def share_by_loops(scan: Scan, before: Scan, step: NDArray[np.float64], slip: float) -> float:
    """The share that is expected, wall by wall and slip by slip."""
    turns = [[wrap(psi - b + step[2]) for _, b in before.z.tolist()] for _, psi in scan.z.tolist()]
    expected = [r - step[0] * math.cos(b) - step[1] * math.sin(b) for r, b in before.z.tolist()]
    length = scan.ends[:, 1] - scan.ends[:, 0]
    best = 0.0
    for slipped in (0.0, *(t for row in turns for t in row if abs(t) < slip)):
        there = []
        for (r, _), row in zip(scan.z.tolist(), turns, strict=True):
            pairs = zip(expected, row, strict=True)
            there.append(any(abs(r - e) < 0.1 and abs(t - slipped) < math.radians(4.0) for e, t in pairs))
        best = max(best, float(length[there].sum()))
    return best / float(length.sum())


@pytest.mark.parametrize("slip", [0.0, 0.3])
def test_the_expected_share_is_that_of_every_wall_and_slip_by_itself(slip: float) -> None:
    rng = np.random.default_rng(3)
    for _ in range(40):
        k = int(rng.integers(1, 12))
        walls, ends = rng.uniform((0.5, -3.0), (4.0, 3.0), (k, 2)), np.sort(rng.normal(0.0, 2.0, (k, 2)), axis=1)
        seen = walls + rng.normal(0.0, (0.06, 0.04), (k, 2)) + (0.0, rng.uniform(-0.3, 0.3))
        R, step = np.tile(np.eye(2) * 1e-4, (k, 1, 1)), rng.normal(0.0, 0.05, 3)
        scan, before = Scan.of(seen, R, ends), Scan.of(walls, R, ends)
        assert expected_share(scan, before, step, slip) == pytest.approx(share_by_loops(scan, before, step, slip))


def test_scans_of_two_thousand_walls_need_no_terabytes_to_be_compared() -> None:
    n, turned = 2000, 0.2
    walls = np.random.default_rng(1).uniform((0.5, -3.1), (40.0, 3.1), (n, 2))
    R, ends = np.tile(np.eye(2) * 1e-4, (n, 1, 1)), np.tile((0.0, 1.0), (n, 1))
    before, now = Scan.of(walls, R, ends), Scan.of(walls - (0.0, turned), R, ends)
    assert expected_share(now, before, np.zeros(3), math.radians(30.0)) == 1.0
    assert expected_share(now, before, np.zeros(3)) < 0.7


def test_a_trail_forgets_what_was_seen_while_the_robot_was_carried() -> None:
    """The walls moved by 0.5 m from one scan to the next while the wheels say 0.3 m."""
    R, ends = np.tile(np.eye(2) * 1e-4, (2, 1, 1)), np.array([(0.0, 2.0), (0.0, 2.0)])
    trail = RecentScans()
    for k, wall in enumerate((3.0, 2.7, 2.2, 1.9)):
        trail.note(np.array([0.3 * k, 0.0, 0.0]), Scan.of(np.array([(wall, 0.0), (1.0, 1.57)]), R, ends))
    seen = [step[0] for step, _ in trail.back_from(np.array([0.9, 0.0, 0.0]))]
    assert seen == pytest.approx([0.0, -0.3])


@pytest.mark.parametrize("turn", [90.0, 180.0])
def test_in_a_rectangle_without_a_compass_the_robot_does_not_guess(turn: float) -> None:
    """Turned by 180 degrees about its middle a rectangle is the same: no scan can tell."""
    world = Carried(jump=(-0.5, -1.0, math.radians(turn)), walls=ROOM)
    found, figures = judged(world, ["lrf"])
    assert found.lost[-1][1] == pytest.approx(found.t[-1], abs=0.2)
    assert "several" in " ".join(found.notes)
    assert outside(found, figures).max() < 0.1


@pytest.mark.parametrize("seed", range(3))
def test_an_ordinary_drive_is_never_lost_and_never_slips(seed: int) -> None:
    found, _ = judged(World(seed=seed), ["lrf"])
    assert found.lost == ()
    assert found.notes == ()


@pytest.mark.parametrize("log", ["odometry_in_tf.bag", "pimouse.bag"])
def test_a_real_robot_that_nobody_carries_is_not_lost_where_little_is_seen(log: str) -> None:
    """A depth camera whose few short lines fit at some heading or other, and a small robot between chair legs."""
    loaded = load([real_log(f"strangers/{log}")], LogOptions(quiet=True), only=("lrf",))
    assert fuse(loaded.drive, loaded.robot, ["lrf"]).lost == ()


def test_a_slip_of_a_wheel_is_found_and_turned_back() -> None:
    """The wheels say a turn of 12 degrees that never was; the lines say where the robot looks."""

    class Slipped(World):
        def pose(self, t: Array, x0: tuple[float, float, float] | None = None) -> Array:
            out = super().pose(t, x0)
            if x0 is None:
                x, y, a = super().pose(np.array([8.0]))[0]
                turned = super().pose(t - 8.0, (float(x), float(y), float(a) + math.radians(12.0)))
                out = np.where(t[:, None] < 8.0, out, turned)
            return out

    found, figures = judged(Slipped(seconds=14.0), ["lrf"])
    after = figures.t > 8.2
    assert np.hypot(*figures.deviation[after].T).max() < 0.05
    assert found.notes == ("lrf: 1 wheel slip recovered by the lines of the map",)


@pytest.mark.parametrize("begin", [4.0, 7.0])
def test_a_slip_of_both_wheels_ahead_is_found_and_taken_back(begin: float) -> None:
    """The wheels roll on for a second, 0.5 m, in which the robot stands."""

    class Spinning(World):
        def pose(self, t: Array, x0: tuple[float, float, float] | None = None) -> Array:
            return super().pose(np.where(t < begin, t, np.maximum(begin, t - 1.0)), x0)

    found, figures = judged(Spinning(seconds=10.0, turning=0.0, speed=0.5, sigma_range=0.01), ["lrf"])
    after = figures.t > begin + 1.5
    assert np.hypot(*figures.deviation[after].T).max() < 0.05
    assert found.notes == ("lrf: 1 wheel slip recovered by the lines of the map",)
    (slip,) = found.jumps
    assert slip.step == pytest.approx((-0.5, 0.0, 0.0), abs=0.1)


def test_only_slips_that_follow_each_other_one_way_are_a_slip_ahead() -> None:
    """0.1 m three times is 0.3 m and then 0.1 m a scan; a scan without it, or a step back, begins anew."""
    slide, ahead = Slide(), np.array([0.1, 0.01, 0.0])
    assert [slide.add(ahead, line) for line in (5, 6)] == [None, None]
    off, first_line = slide.add(ahead, 7) or pytest.fail("three in a row are sure")
    assert off == pytest.approx([0.3, 0.03])
    assert first_line == 5
    off, first_line = slide.add(ahead, 9) or pytest.fail("it goes on")
    assert off == pytest.approx([0.1, 0.01])
    assert first_line == 7
    assert slide.add(-ahead, 9) is None  # not ahead and back at once
    assert slide.add(-ahead, 9) is None
    slide.reset()
    assert not slide.has_begun
    assert [slide.add(-ahead, 9) for _ in range(DECIDING_SCANS - 1)] == [None] * (DECIDING_SCANS - 1)


# --- a slip turns the pose only where the next scans and matched scans confirm it; a carried robot slips for ever

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
    drive, robot = World(seconds=16.0).measured()
    found = fuse(drive, robot, ["lrf"])
    assert made_up
    assert not found.lost
    assert not found.slips
    judged = evaluate(found, drive)
    assert np.hypot(*judged.deviation.T).max() < 0.1


def test_walls_continue_where_the_wheels_expect_them_and_not_elsewhere() -> None:
    walls = np.array([[2.0, 0.0], [1.0, math.pi / 2], [3.0, -math.pi / 2]])
    ends = np.tile([-1.0, 1.0], (3, 1))
    before = (0.0, (0.0, 0.0, 0.0), Scan.of(walls, np.zeros((3, 2, 2)), ends))
    ahead = Scan.of(walls - [[0.5, 0.0], [0.0, 0.0], [0.0, 0.0]], np.zeros((3, 2, 2)), ends)
    assert continues([before], (0.1, (0.5, 0.0, 0.0), ahead), slip=0.0)
    turned = Scan.of(walls - [0.0, math.radians(10.0)], np.zeros((3, 2, 2)), ends)
    assert not continues([before], (0.1, (0.0, 0.0, 0.0), turned), slip=0.0)
    assert continues([before], (0.1, (0.0, 0.0, 0.0), turned), slip=math.radians(15.0))
