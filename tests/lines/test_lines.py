"""Line extraction is held to rooms that are known exactly and to a plain recursive split-and-merge."""

import math

import numpy as np
import pytest
from msgspec.structs import replace
from rooms import ARENA, box, pole, poses, ranges, scan, wall_lines

from locfuse.fusion import se2
from locfuse.fusion.data import Array
from locfuse.fusion.lines.extract import Lines, LineSettings, extract_lines

HALF = np.radians(np.linspace(-90.0, 90.0, 361))
CIRCLE = np.radians(np.arange(720) * 0.5 - 180.0)
NOISE = {"30mm_0.25deg": (0.03, math.radians(0.25)), "5mm_0.1deg": (0.005, math.radians(0.1))}
SHARP = LineSettings(sigma_range=0.005, sigma_angle=math.radians(0.1))


def noisy(
    rng: np.random.Generator, at: Array, angles: Array, noise: tuple[float, float], walls: Array = ARENA
) -> Array:
    """Scans (n, b) from poses (n, 3): beams leave at wrong angles and come back with wrong ranges."""
    size = (len(at), len(angles))
    real = angles + rng.normal(0.0, noise[1], size)
    return np.array([scan(walls, p, a) for p, a in zip(at, real, strict=True)]) + rng.normal(0.0, noise[0], size)


def rows(lines: Lines, i: int) -> slice:
    return slice(lines.first[i], lines.first[i + 1])


def errors(lines: Lines, at: Array, sigma: float, walls: Array = ARENA) -> tuple[Array, Array]:
    """Return each line's squared Mahalanobis distance from the nearest wall, and the error itself (m, 2)."""
    nees, error = [], []
    for i, pose in enumerate(at):
        truth = wall_lines(walls, pose)
        for z, R_unit in zip(lines.z[rows(lines, i)], lines.R_unit[rows(lines, i)], strict=True):
            e = z - truth
            e[:, 1] = se2.wrap_all(e[:, 1])
            d2 = np.einsum("qi,ij,qj->q", e, np.linalg.inv(R_unit * sigma**2), e)
            nees.append(d2.min())
            error.append(e[d2.argmin()])
    return np.array(nees), np.array(error)


def nearest(truth: Array, z: Array) -> int:
    """Return which of the walls (q, 2) a line is."""
    return int(np.argmin(np.abs(truth[:, 0] - z[0]) + np.abs(se2.wrap_all(truth[:, 1] - z[1]))))


# --- what is found


def test_a_room_without_noise_is_found_exactly() -> None:
    pose = np.array([0.6, -0.4, 0.3])
    walls = box(-2.0, -3.0, 4.0, 3.0)
    lines = extract_lines(scan(walls, pose, CIRCLE)[None], CIRCLE, SHARP)
    truth = wall_lines(walls, pose)
    assert len(lines.z) == 4
    for z, ends in zip(lines.z, lines.ends, strict=True):
        i = nearest(truth, z)
        assert z[0] == pytest.approx(truth[i, 0], abs=1e-9)
        assert se2.wrap(z[1] - truth[i, 1]) == pytest.approx(0.0, abs=1e-9)
        corners = se2.transform(se2.inverse(pose), walls[i].reshape(2, 2))
        along = np.sort(corners @ [-math.sin(z[1]), math.cos(z[1])])
        assert ends == pytest.approx(along, abs=0.12)  # less the beams near the corners
        assert along[0] <= ends[0] < ends[1] <= along[1]
    assert (lines.chi2 < 1e-12).all()
    assert lines.points.sum() > 650


@pytest.mark.parametrize("noise", NOISE.values(), ids=NOISE.keys())
@pytest.mark.parametrize("angles", [HALF, CIRCLE], ids=["half", "circle"])
def test_walls_in_a_room_with_corners_have_honest_covariances(noise: tuple[float, float], angles: Array) -> None:
    """Splitting, corners, short plates and occlusions included: mean NEES within 95 % bounds of 2, few strays."""
    rng = np.random.default_rng(3)
    at = poses(rng, 160)
    lines = extract_lines(
        noisy(rng, at, angles, noise), angles, LineSettings(sigma_range=noise[0], sigma_angle=noise[1])
    )
    nees, error = errors(lines, at, noise[0])
    assert len(nees) > 4.5 * len(at) * (len(angles) / 361) ** 0.9
    usual = nees[nees < 18.4]  # 99.99 %
    assert len(nees) - len(usual) <= 0.005 * len(nees)
    assert usual.mean() == pytest.approx(2.0, abs=1.96 * 2.0 / math.sqrt(len(usual)))
    sigma = noise[0] * np.sqrt(lines.R_unit[:, [0, 1], [0, 1]])[nees < 18.4]
    assert np.abs((error[nees < 18.4] / sigma).mean(axis=0)).max() < 0.15


def test_a_sharp_scanner_sees_every_plate_that_shows_a_side() -> None:
    pose = np.array([4.0, 3.0, 0.0])
    d = noisy(np.random.default_rng(0), pose[None], CIRCLE, NOISE["5mm_0.1deg"])
    truth = wall_lines(ARENA, pose)
    seen = {nearest(truth, z) for z in extract_lines(d, CIRCLE, SHARP).z}
    assert seen == set(range(8)) - {6}  # plate 6 is seen edge-on from here


@pytest.mark.parametrize("angles", [HALF, CIRCLE], ids=["half", "circle"])
@pytest.mark.parametrize("deskewed", [False, True])
def test_a_scan_has_the_same_lines_alone_and_in_any_batch(angles: Array, deskewed: bool) -> None:
    rng = np.random.default_rng(5)
    d = noisy(rng, poses(rng, 300), angles, NOISE["30mm_0.25deg"])
    d[rng.uniform(size=d.shape) < 0.1] = np.inf
    d[17] = np.nan
    offsets = rng.normal(0.0, 0.02, (*d.shape, 3)) if deskewed else None
    own = np.broadcast_to(angles, d.shape) if deskewed else angles
    together = extract_lines(d, own, offsets=offsets)
    for i in (0, 16, 17, 18, 255, 256, 257, 299):
        one = slice(i, i + 1)
        moved = None if offsets is None else offsets[one]
        alone = extract_lines(d[one], own[one] if deskewed else own, offsets=moved)
        assert alone.first[1] == together.first[i + 1] - together.first[i]
        for name in ("z", "R_unit", "ends", "points", "chi2", "span"):
            assert getattr(alone, name).tobytes() == getattr(together, name)[rows(together, i)].tobytes()
    again = extract_lines(d, own, offsets=offsets)
    for name in Lines.__struct_fields__:
        assert getattr(together, name).tobytes() == getattr(again, name).tobytes()


# --- one wall or two


def facing(walls: list[tuple[float, float, float, float]], noise: float = 0.005, angles: Array = HALF) -> Lines:
    """What a laser at the origin, looking along x, makes of some walls."""
    rng = np.random.default_rng(2)
    d = scan(np.array(walls, float), np.zeros(3), angles) + rng.normal(0.0, noise, len(angles))
    return extract_lines(d[None], angles, replace(SHARP, sigma_range=noise))


@pytest.mark.parametrize(
    ("walls", "distances"),
    [
        ([(2.0, -2.0, 2.0, -0.5), (2.0, 0.5, 2.0, 2.0)], [2.0, 2.0]),  # a doorway
        ([(2.0, -2.0, 2.0, -0.5), (2.0, 0.5, 2.0, 2.0), (4.0, -3.0, 4.0, 3.0)], [2.0, 2.0, 4.0]),
        ([(3.0, -2.0, 3.0, 2.0), (1.5, -0.4, 1.5, 0.4)], [1.5, 3.0, 3.0]),  # a wall behind a box
    ],
)
def test_a_gap_separates_walls(walls: list[tuple[float, float, float, float]], distances: list[float]) -> None:
    assert sorted(facing(walls).z[:, 0].tolist()) == pytest.approx(distances, abs=0.005)


def test_a_wall_behind_a_pole_is_two_lines_and_the_pole_is_none() -> None:
    lines = facing([(3.0, -2.0, 3.0, 2.0), *map(tuple, pole(1.5, 0.0, 0.08))])
    assert lines.z[:, 0].tolist() == pytest.approx([3.0, 3.0], abs=0.005)
    assert lines.ends.ravel() == pytest.approx([-2.0, -0.16, 0.16, 2.0], abs=0.05)


@pytest.mark.parametrize("bridge", [0.0, 0.5])
def test_a_shadow_narrower_than_the_bridge_does_not_end_a_line(bridge: float) -> None:
    d = scan(np.concatenate(([(3.0, -2.0, 3.0, 2.0)], pole(1.5, 0.0, 0.08))), np.zeros(3), HALF)
    lines = extract_lines(d[None], HALF, replace(SHARP, bridge=bridge))
    assert len(lines.z) == (2 if bridge == 0.0 else 1)
    if bridge > 0.0:
        assert lines.ends[0] == pytest.approx([-2.0, 2.0], abs=0.05)
        assert lines.span[0, 1] - lines.span[0, 0] > lines.points[0]


def test_one_beam_that_hits_something_else_does_not_end_a_line() -> None:
    d = scan(np.array([(3.0, -2.0, 3.0, 2.0)]), np.zeros(3), HALF)
    d[180] = 1.0
    lines = extract_lines(d[None], HALF, SHARP)
    assert lines.ends.tolist() == [pytest.approx([-2.0, 2.0], abs=0.05)]
    assert lines.points[0] == lines.span[0, 1] - lines.span[0, 0]


def lines_of_pole(distance: float, radius: float, noise: float) -> int:
    """How many lines fifty scans of a round pole have."""
    rng = np.random.default_rng(4)
    seen = scan(pole(distance, 0.2, radius), np.zeros(3), CIRCLE) + rng.normal(0.0, noise, (50, 720))
    return len(extract_lines(seen, CIRCLE, replace(SHARP, sigma_range=noise)).z)


@pytest.mark.parametrize("noise", [0.005, 0.01, 0.03])
@pytest.mark.parametrize("radius", [0.05, 0.1, 0.15])
@pytest.mark.parametrize("distance", [0.5, 1.0, 2.0, 3.0])
def test_round_poles_are_not_lines(noise: float, radius: float, distance: float) -> None:
    assert lines_of_pole(distance, radius, noise) <= 1
    assert lines_of_pole(2.0, 0.4, 0.005) == 0  # nor is a column


def test_a_wall_seen_flat_keeps_its_evenly_spaced_beams() -> None:
    """At 78 degrees neighbouring beams are 30 cm apart: no gap, for the spacing grows with the range."""
    lines = facing([(1.0, 0.8, 6.0, 0.8)], angles=np.radians(np.linspace(-90.0, 90.0, 181)))
    assert len(lines.z) == 1
    assert lines.z[0] == pytest.approx([0.8, math.pi / 2], abs=0.02)
    assert lines.ends[0, 0] < -4.5 or lines.ends[0, 1] > 4.5


def test_beams_that_graze_the_wall_are_left_out() -> None:
    lines = facing([(0.2, 0.15, 6.0, 0.15)], angles=np.radians(np.linspace(-90.0, 90.0, 1441)))
    assert len(lines.z) == 1
    assert np.abs(lines.ends).max() <= 0.15 * math.tan(math.radians(85.0)) + 0.02


def test_single_beams_off_the_wall_do_not_pull_it() -> None:
    """Four sigmas: too near to be cut off as a piece of its own, too far to be of the wall."""
    rng = np.random.default_rng(14)
    d = scan(np.array([(3.0, -2.0, 3.0, 2.0)]), np.zeros(3), HALF) + rng.normal(0.0, 0.03, 361)
    stray, gone = d.copy(), d.copy()
    at = [130, 180, 235]
    stray[at] = (3.0 - 0.12) / np.cos(HALF[at])
    gone[at] = np.nan
    found, expected = extract_lines(np.stack((stray, gone)), HALF).z
    assert found == pytest.approx(expected, abs=1e-4)  # 2e-3 with them


# --- scanners


def test_a_wall_across_the_first_beam_is_one_line() -> None:
    rng = np.random.default_rng(6)
    for walls, pieces in ((box(-2.0, -1.5, 3.0, 2.0), 4), (np.array([(-2.0, -1.5, -2.0, 2.0)]), 1)):
        d = scan(walls, np.zeros(3), CIRCLE) + rng.normal(0.0, 0.005, 720)
        lines = extract_lines(d[None], CIRCLE, SHARP)
        assert len(lines.z) == pieces
        back = nearest(lines.z, np.array([2.0, math.pi]))
        assert lines.ends[back] == pytest.approx([-2.0, 1.5], abs=0.05)
        assert lines.span[back, 0] > lines.span[back, 1]


@pytest.mark.parametrize("angle", [0.0, -1.57])
def test_beams_that_all_look_the_same_way_see_no_line(angle: float) -> None:
    """An angle_increment of 0: a damaged message, or a driver that never set it."""
    ranges = np.stack([np.linspace(2.0, 2.4, 61), np.linspace(2.0, 9.0, 61), np.full(61, 3.0)])
    with np.errstate(all="ignore"):
        lines = extract_lines(ranges, np.full(61, angle), SHARP)
    assert lines.first[-1] == 0


def test_a_laser_that_moves_while_it_scans_is_deskewed() -> None:
    """Each beam leaves from its own place; seen from the middle of the scan the walls are where they are."""
    rng, noise = np.random.default_rng(10), NOISE["5mm_0.1deg"]
    at = poses(rng, 120, clearance=0.5)
    share = np.linspace(-0.5, 0.5, 361)
    offsets = np.stack((0.12 * share, 0.01 * share, 0.15 * share), axis=1)  # 12 cm and 8.6 degrees in a scan
    d = np.empty((120, 361))
    for i, pose in enumerate(at):
        beam = se2.compose(pose, offsets)
        d[i] = ranges(ARENA, beam[:, :2], beam[:, 2] + HALF + rng.normal(0.0, noise[1], 361))
    d += rng.normal(0.0, noise[0], d.shape)
    lines = extract_lines(d, HALF, SHARP, np.broadcast_to(offsets, (120, 361, 3)))
    nees, _ = errors(lines, at, noise[0])
    assert len(nees) > 500
    assert nees.mean() == pytest.approx(2.0, abs=1.96 * 2.0 / math.sqrt(len(nees)))
    skewed, _ = errors(extract_lines(d, HALF, SHARP), at, noise[0])
    assert np.median(skewed) > 50.0


# --- what is no return


def test_noise_alone_gives_next_to_no_lines() -> None:
    rng = np.random.default_rng(12)
    lines = extract_lines(rng.uniform(0.1, 10.0, (200, 361)), HALF)
    assert len(lines.z) < 10
