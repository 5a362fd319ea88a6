"""Curved walls are no landmarks, straight ones stay: rooms whose shape is known, seen with noise."""

from __future__ import annotations

import math

import numpy as np
import pytest

from locfuse.fusion.data import Array
from locfuse.fusion.lines.extract import Lines, LineSettings, extract_lines

SCANS = 60
COARSE = LineSettings()
FINE = LineSettings(sigma_range=0.008, sigma_angle=math.radians(0.1))
ANGLES = np.linspace(-math.pi, math.pi, 361, endpoint=False)


def ring(corners: Array) -> Array:
    """Segments (n, 4) round a closed way through corners (n, 2)."""
    return np.hstack((corners, np.roll(corners, -1, axis=0)))


def regular(sides: int, side: float) -> Array:
    """A room of `sides` straight walls of `side` [m] each."""
    at = (np.arange(sides) + 0.31) * 2.0 * math.pi / sides
    return ring(0.5 * side / math.sin(math.pi / sides) * np.stack((np.cos(at), np.sin(at)), axis=-1))


def circle(radius: float) -> Array:
    """A round room; between its 1500 corners it leaves the circle by less than 0.1 mm."""
    return regular(1500, 2.0 * radius * math.sin(math.pi / 1500))


def look(segments: Array, place: Array, angles: Array) -> Array:
    """Range along each angle from a place (2,), to the nearest segment; inf where there is none."""
    u = np.stack((np.cos(angles), np.sin(angles)), axis=-1)[:, None]
    a, along = segments[:, :2] - place, segments[:, 2:] - segments[:, :2]
    det = u[..., 0] * along[:, 1] - u[..., 1] * along[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        d = (a[:, 0] * along[:, 1] - a[:, 1] * along[:, 0]) / det
        s = (a[:, 0] * u[..., 1] - a[:, 1] * u[..., 0]) / det
    nearest: Array = np.where((s >= 0.0) & (s < 1.0) & (d > 0.0), d, np.inf).min(axis=1)
    return nearest


def lines_of(segments: Array, laser: LineSettings, reach: float) -> Lines:
    """The lines of noisy scans from places within `reach` [m] of the middle, each turned at random."""
    rng = np.random.default_rng(5)
    turned = ANGLES + rng.uniform(-math.pi, math.pi, (SCANS, 1))
    aimed = turned + rng.normal(0.0, laser.sigma_angle, turned.shape)
    places = rng.uniform(-reach, reach, (SCANS, 2))
    d = np.array([look(segments, p, a) for p, a in zip(places, aimed, strict=True)])
    return extract_lines(d + rng.normal(0.0, laser.sigma_range, d.shape), ANGLES, laser)


def curved_share(lines: Lines) -> float:
    """Which share of the walls was left out as curved."""
    return float(lines.curved.sum() / (lines.curved.sum() + len(lines.z)))


@pytest.mark.parametrize("laser", [COARSE, FINE])
@pytest.mark.parametrize("radius", [1.5, 4.0, 8.0])
def test_a_round_room_has_no_straight_wall(radius: float, laser: LineSettings) -> None:
    assert curved_share(lines_of(circle(radius), laser, 0.4 * radius)) > 0.99


@pytest.mark.parametrize("laser", [COARSE, FINE])
@pytest.mark.parametrize(("sides", "side"), [(4, 4.0), (6, 2.0), (8, 2.0), (12, 1.5), (16, 2.0)])
def test_straight_walls_round_a_room_are_no_curve(sides: int, side: float, laser: LineSettings) -> None:
    lines = lines_of(regular(sides, side), laser, 0.3 * side)
    assert curved_share(lines) < 0.03
    assert len(lines.z) > 0.9 * sides * SCANS


@pytest.mark.parametrize("laser", [COARSE, FINE])
@pytest.mark.parametrize("turn_deg", [6.0, 12.0, 25.0, 40.0])
def test_two_straight_walls_that_meet_in_a_blunt_corner_stay(turn_deg: float, laser: LineSettings) -> None:
    turn = math.radians(turn_deg)
    tip = np.array([[0.0, 2.0]])
    ends = tip + 3.0 * np.array([[-1.0, 0.0], [math.cos(turn), -math.sin(turn)]])
    lines = lines_of(np.hstack((np.repeat(tip, 2, axis=0), ends)), laser, 0.8)
    assert curved_share(lines) < 0.02
    assert len(lines.z) > 1.5 * SCANS


@pytest.mark.parametrize("laser", [COARSE, FINE])
def test_an_apse_is_left_out_and_the_straight_walls_beside_it_stay(laser: LineSettings) -> None:
    bow = np.linspace(-0.5 * math.pi, 0.5 * math.pi, 200)
    apse = np.stack((3.0 + 2.0 * np.cos(bow), 2.0 * np.sin(bow)), axis=-1)
    room = ring(np.vstack(([[-3.0, 2.0], [-3.0, -2.0]], apse)))  # three straight walls and half a circle
    lines = lines_of(room, laser, 1.0)
    assert len(lines.z) == pytest.approx(3 * SCANS, rel=0.1)
    assert lines.curved.min() >= 2


@pytest.mark.parametrize("laser", [COARSE, FINE])
def test_walls_that_bend_by_two_centimetres_are_straight_enough(laser: LineSettings) -> None:
    along = np.linspace(-3.0, 3.0, 60)
    wall = np.stack((along, 2.0 + 0.02 * np.cos(along * math.pi / 3.0)), axis=-1)
    corners = np.vstack((wall, -wall))
    assert curved_share(lines_of(ring(corners), laser, 1.0)) < 0.02
