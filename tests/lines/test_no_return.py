"""A range that means "nothing came back" is no wall, whatever range_max says."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from ring_drive import box, scan
from scan_streams import scan_stream

from locfuse.fusion.data import Array, ArrayStream, Measurements
from locfuse.fusion.lines.points import Longest
from locfuse.fusion.robot import WheelSettings
from locfuse.fusion.sensors.lrf import Lrf, LrfSettings, laser_of
from locfuse.fusion.wheels.motion_by_scans import match_scans
from locfuse.fusion.wheels.scan_clouds import STANDING

BEAMS, SCANS, WORD = 120, 60, 8.0  # m; range_max of the scans is 12 m
YARD = np.array(box(-4.0, -3.0, 4.5, 3.5)[:3] + box(1.0, 2.6, 2.2, 3.4))  # a room without its fourth wall
STAMPS = [200_000_000 * i for i in range(SCANS)]


def yard(word: float, step: float = 0.0) -> ArrayStream:
    """Scans along a circle in the yard, in steps of `step` m, with `word` where nothing comes back."""
    rng, rows = np.random.default_rng(5), []
    for i in range(SCANS):
        turn = 0.07 * i
        points = scan(np.array([np.sin(turn), 1.0 - np.cos(turn), turn]), YARD, rng)
        beam = np.round((np.arctan2(points[:, 1], points[:, 0]) + np.pi) * BEAMS / (2.0 * np.pi)).astype(int)
        row = np.full(BEAMS, np.inf)
        row[beam % BEAMS] = np.hypot(*points.T)
        row = np.round(row / step) * step if step else row
        rows.append(np.where(np.isinf(row), word, row))
    return scan_stream(STAMPS, np.stack(rows))


def lines_of(stream: ArrayStream, **settings: Any) -> Measurements:
    return Lrf().measure(stream, LrfSettings(**settings), STANDING, 0)


@pytest.mark.parametrize("step", [0.0, 0.05])
def test_a_word_for_no_return_gives_the_lines_that_nan_gives(step: float) -> None:
    said, right = lines_of(yard(WORD, step)), lines_of(yard(math.nan, step))
    np.testing.assert_array_equal(said.first, right.first)
    np.testing.assert_array_equal(said.z, right.z)
    assert [note for note in said.notes if note not in right.notes] == [said.notes[0]]
    assert "exactly 8 m, the longest: read as no return" in said.notes[0]
    kept = lines_of(yard(WORD, step), range_max=8.0)
    assert kept.first[-1] > right.first[-1] or len(kept.notes) > len(right.notes)  # walls that are none


def test_scans_are_matched_as_if_it_were_no_number() -> None:
    laser = laser_of(LrfSettings())
    said, right = (match_scans(yard(word), laser).reading(WheelSettings(), 0.0) for word in (WORD, math.inf))
    np.testing.assert_array_equal(said.wheels.pose, right.wheels.pose)


@pytest.mark.parametrize("step", [0.0, 0.01, 0.05])
@pytest.mark.parametrize("seed", range(4))
def test_the_longest_range_of_a_room_is_a_wall(step: float, seed: int) -> None:
    """Drives in closed rooms, ranges in whole centimetres too, by a robot that never moves as well."""
    rng = np.random.default_rng(seed)
    for moves in (0.0, 0.05):
        longest = Longest()
        for i in range(SCANS):
            angle = np.linspace(-np.pi, np.pi, BEAMS, endpoint=False) + moves * i
            with np.errstate(divide="ignore"):
                wall = np.minimum(4.0 / np.abs(np.cos(angle)), (3.0 + moves * i) / np.abs(np.sin(angle)))
            noisy = wall + 0.02 * rng.standard_normal(BEAMS)
            row = np.round(noisy / step) * step if step else noisy
            longest.add(row[None], np.array([12.0]))
        assert longest.no_return is None


def test_how_the_log_is_cut_into_blocks_does_not_matter() -> None:
    ranges: Array = np.asarray(yard(WORD).data["ranges"].values).reshape(SCANS, BEAMS)  # type: ignore[union-attr]
    far = np.full(SCANS, 12.0)
    whole, pieces, backwards = Longest(), Longest(), Longest()
    whole.add(ranges, far)
    for i in range(SCANS):
        pieces.add(ranges[i : i + 1], far[:1])
        backwards.add(ranges[-1 - i][None], far[:1])
    assert whole.no_return == pieces.no_return == backwards.no_return == WORD
    assert whole.note == pieces.note == backwards.note
    assert whole.count == int((ranges == WORD).sum())


def test_scans_without_a_beam_or_a_return_say_nothing() -> None:
    longest = Longest()
    longest.add(np.zeros((3, 0)), np.full(3, 12.0))
    longest.add(np.full((3, 40), np.nan), np.full(3, 12.0))
    longest.add(np.full((3, 40), 13.0), np.full(3, 12.0))  # beyond range_max: known to be none
    assert longest.no_return is None
