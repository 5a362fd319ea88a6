"""The line fit is held to SciPy's least squares and to rooms whose shape is known."""

import math
from functools import partial
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
import textbook
from interpreted import interpreted
from rooms import ARENA, poses, ring, scan
from scipy.optimize import least_squares

from locfuse.fusion.data import Array
from locfuse.fusion.kernels.arrays import view
from locfuse.fusion.lines.extract import Lines, LineSettings, extract_lines

core = interpreted("line_fits")
SIGMA_RANGE, SIGMA_ANGLE = 0.03, math.radians(0.25)
WALLS = {  # r [m], psi [rad], from where to where along the tangent [m]
    "head_on": (2.0, 0.3, -1.0, 1.0),
    "off_centre": (2.0, 0.3, 1.0, 4.0),
    "far_off_centre": (1.5, -2.0, -5.0, -2.0),
    "grazing": (0.6, 3.1, 1.5, 4.5),
    "short": (2.0, -3.1, 0.2, 0.9),
}
Wall = tuple[float, float, float, float]


def ranges(r: float, psi: float, angle: Array, ox: Array, oy: Array) -> Array:
    """Distance from (ox, oy) along `angle` to the line: the ray equation, solved for the range."""
    return np.asarray((r - ox * math.cos(psi) - oy * math.sin(psi)) / np.cos(angle - psi))


class Rays(NamedTuple):
    """Beams of one line: range, direction, origin."""

    ranges: Array
    ux: Array
    uy: Array
    ox: Array
    oy: Array


class Fit(NamedTuple):
    """A line, its covariance over that of a range, and the weighted squares that are left."""

    r: float
    psi: float
    R_unit: Array
    misfit: float


def fit(rays: Rays, r: float, psi: float, ratio: float, steps: int = 2) -> Fit:
    """As `fit_wall` does it: Gauss-Newton steps from (r, psi), the last of them with the covariance."""
    n = len(rays.ranges)
    found = core.Fit(n)
    found.row, found.count, found.r, found.psi = np.arange(n), n, r, psi
    returns = SimpleNamespace(**{name: column.tolist() for name, column in rays._asdict().items()})
    for _ in range(steps):
        core.residuals(returns, SimpleNamespace(ratio=ratio), found)
        assert core.solve(found)
        found.r, found.psi = found.r + found.step_r, found.psi + found.step_psi
    information = np.array([[found.sum_w, -found.sum_wq], [-found.sum_wq, found.sum_wqq]])
    return Fit(found.r, found.psi, np.linalg.inv(information), found.rest)


def seen(wall: Wall, side: float | None) -> Rays:
    """A noisy view of a wall: every beam really leaves at a wrong angle, and its range is wrong too."""
    rng, (r, psi, lo, hi) = np.random.default_rng(1), wall
    nominal = psi + np.linspace(math.atan2(lo, r), math.atan2(hi, r), 60)
    t: Array = np.linspace(-0.5, 0.5, 60) * (side is not None)  # the laser drives 10 cm, on a curve to one side
    ox, oy = 0.1 * t, (side or 0.0) * t * t
    real = nominal + rng.normal(0.0, SIGMA_ANGLE, 60)
    d = ranges(r, psi, real, ox, oy) + rng.normal(0.0, SIGMA_RANGE, 60)
    return Rays(d, np.cos(nominal), np.sin(nominal), ox, oy)


@pytest.mark.parametrize("wall", WALLS.values(), ids=WALLS.keys())
@pytest.mark.parametrize("side", [None, 0.4, -0.4])
def test_the_fit_equals_scipy_on_the_ranges(wall: Wall, side: float | None) -> None:
    rays = seen(wall, side)
    angle, ox, oy = np.arctan2(rays.uy, rays.ux), rays.ox, rays.oy

    def sigma(x: Array) -> Array:
        p = ranges(x[0], x[1], angle, ox, oy)
        return np.asarray(np.hypot(SIGMA_RANGE, SIGMA_ANGLE * p * np.tan(angle - x[1])))

    x, s = np.array(wall[:2]), np.ones(60)
    for _ in range(20):  # the weights belong to the solution: iterate until they do
        s = sigma(x)
        solved = least_squares(
            lambda v, s=s: (rays.ranges - ranges(v[0], v[1], angle, ox, oy)) / s,
            x,
            xtol=1e-15,
            ftol=1e-15,
            gtol=1e-15,
        )
        x = solved.x
    found = fit(rays, wall[0], wall[1], SIGMA_ANGLE / SIGMA_RANGE, steps=30)
    assert [found.r, found.psi] == pytest.approx(x.tolist(), abs=1e-8)
    covariance = np.linalg.inv(solved.jac.T @ solved.jac)
    np.testing.assert_allclose(found.R_unit * SIGMA_RANGE**2, covariance, rtol=1e-5)
    assert found.misfit / SIGMA_RANGE**2 == pytest.approx(2.0 * solved.cost, rel=1e-6)
    sigmas = np.sqrt(np.diag(covariance))
    usual = fit(rays, wall[0], wall[1], SIGMA_ANGLE / SIGMA_RANGE)
    assert np.abs([usual.r, usual.psi] - x).tolist() <= (0.05 * sigmas).tolist()


def random_fit(seed: int) -> tuple[Array, Array, Array, Any]:
    """Distances e [m] from the line at feet q [m] with weights w, and the fit of one step with all its sums."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(4, 40))
    e, q, w = rng.normal(0.0, 0.05, n), rng.uniform(-1.0, 3.0, n), rng.uniform(0.2, 1.0, n)
    e += 0.04 * q * q
    found = core.Fit(n)
    found.count = n
    found.row, found.error, found.foot, found.weight = list(range(n)), e.tolist(), q.tolist(), w.tolist()
    assert core.solve(found)
    core.parabola(found)
    return e, q, w, found


def solved(e: Array, w: Array, *columns: Array) -> tuple[Array, float]:
    """Weighted least squares of e by columns: the coefficients, and what is left of the sum of squares."""
    A = np.column_stack(columns)
    x = np.linalg.lstsq(np.sqrt(w)[:, None] * A, np.sqrt(w) * e, rcond=None)[0]
    return np.asarray(x, np.float64), float(w @ (e - A @ x) ** 2)


@pytest.mark.parametrize("seed", range(10))
def test_a_step_and_what_it_leaves_are_those_of_least_squares(seed: int) -> None:
    """The distance is e - dr + q dpsi; beside a line, a parabola has one coefficient more."""
    e, q, w, sums = random_fit(seed)
    one = np.ones_like(q)
    (r, psi), left = solved(e, w, one, -q)
    assert (sums.step_r, sums.step_psi) == pytest.approx((r, psi))
    assert sums.rest == pytest.approx(left)
    x, bent = solved(e, w, one, -q, q * q)
    assert core.curvature(sums) == pytest.approx(x[2])
    assert core.stiffness(sums) * core.curvature(sums) ** 2 == pytest.approx(left - bent)
    alone = solved(q * q, w, one, q)[1]
    assert core.stiffness(sums) == pytest.approx(alone)


@pytest.mark.parametrize("angle", [0.0, 3.0, -3.0, math.pi, -math.pi, 4.0, -4.0, 9.0, -100.0, 1e4])
def test_an_angle_is_wrapped_into_half_a_turn_to_either_side(angle: float) -> None:
    found = interpreted("places").wrapped(angle)
    assert -math.pi <= found < math.pi
    assert math.sin(found - angle) == pytest.approx(0.0, abs=1e-9)
    assert math.cos(found - angle) == pytest.approx(1.0)


# --- curved walls are no landmarks, straight ones stay: rooms whose shape is known, seen with noise

SCANS = 60
COARSE = LineSettings()
FINE = LineSettings(sigma_range=0.008, sigma_angle=math.radians(0.1))
ANGLES = np.linspace(-math.pi, math.pi, 361, endpoint=False)


def regular(sides: int, side: float) -> Array:
    """A room of `sides` straight walls of `side` [m] each."""
    at = (np.arange(sides) + 0.31) * 2.0 * math.pi / sides
    return ring(0.5 * side / math.sin(math.pi / sides) * np.stack((np.cos(at), np.sin(at)), axis=-1))


def in_circle(radius: float, place: Array, angles: Array) -> Array:
    """Ranges to the wall of a round room, in closed form."""
    along = -(place[0] * np.cos(angles) + place[1] * np.sin(angles))
    return np.asarray(along + np.sqrt(along**2 + radius**2 - place[:2] @ place[:2]))


def lines_of(room: Array | float, laser: LineSettings, reach: float) -> Lines:
    """The lines of noisy scans from places within `reach` [m] of the middle, each turned at random.

    `room`: its walls, or the radius of a round one.
    """
    rng = np.random.default_rng(5)
    turned = ANGLES + rng.uniform(-math.pi, math.pi, (SCANS, 1))
    aimed = turned + rng.normal(0.0, laser.sigma_angle, turned.shape)
    places = np.column_stack((rng.uniform(-reach, reach, (SCANS, 2)), np.zeros(SCANS)))
    see = partial(in_circle, room) if isinstance(room, float) else partial(scan, room)
    d = np.array([see(p, a) for p, a in zip(places, aimed, strict=True)])
    return extract_lines(d + rng.normal(0.0, laser.sigma_range, d.shape), ANGLES, laser)


def curved_share(lines: Lines) -> float:
    """Which share of the walls was left out as curved."""
    return float(lines.curved.sum() / (lines.curved.sum() + len(lines.z)))


@pytest.mark.parametrize("laser", [COARSE, FINE])
@pytest.mark.parametrize("radius", [1.5, 4.0, 8.0])
def test_a_round_room_has_no_straight_wall(radius: float, laser: LineSettings) -> None:
    assert curved_share(lines_of(radius, laser, 0.4 * radius)) > 0.99


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
def test_an_apse_is_left_out_and_walls_that_bend_by_two_centimetres_are_straight(laser: LineSettings) -> None:
    bow = np.linspace(-0.5 * math.pi, 0.5 * math.pi, 200)
    apse = np.stack((3.0 + 2.0 * np.cos(bow), 2.0 * np.sin(bow)), axis=-1)
    room = ring(np.vstack(([[-3.0, 2.0], [-3.0, -2.0]], apse)))  # three straight walls and half a circle
    lines = lines_of(room, laser, 1.0)
    assert len(lines.z) == pytest.approx(3 * SCANS, rel=0.1)
    assert lines.curved.min() >= 2
    along = np.linspace(-3.0, 3.0, 60)
    wall = np.stack((along, 2.0 + 0.02 * np.cos(along * math.pi / 3.0)), axis=-1)
    corners = np.vstack((wall, -wall))
    assert curved_share(lines_of(ring(corners), laser, 1.0)) < 0.02


# --- segments: splitting depth by depth, merging round by round, clusters

segments = interpreted("segments")
HALF = np.radians(np.linspace(-90.0, 90.0, 361))


def end_points(rng: np.random.Generator) -> Array:
    """What a noisy laser makes of a room with plates in it, (361, 2)."""
    real = HALF + rng.normal(0.0, math.radians(0.25), 361)
    d = scan(ARENA, poses(rng, 1)[0], real) + rng.normal(0.0, 0.03, 361)
    return np.stack((d * np.cos(HALF), d * np.sin(HALF)), axis=1)


def returns_of(**columns: Any) -> Any:
    """Returns with these columns; the others are 0."""
    count = len(next(iter(columns.values())))
    returns = segments.Returns(count)
    returns.count = count
    for name, values in columns.items():
        setattr(returns, name, np.asarray(values, np.float64))
    return returns


def split(points: Array, tolerance: Array, runs: list[int]) -> tuple[list[int], list[int]]:
    """Where pieces begin, and which go on in the next."""
    x, y = points.T
    pieces = segments.Segments(len(points))
    pieces.runs = len(runs) - 1
    pieces.run_first[: len(runs)] = view(runs, np.intp)
    segments.split(returns_of(x=x, y=y, tolerance=tolerance), pieces)
    return list(pieces.first[: pieces.pieces + 1]), list(pieces.linked[: pieces.pieces])


@pytest.mark.parametrize("seed", range(20))
def test_splitting_depth_by_depth_equals_the_recursion(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points, tolerance = end_points(rng), rng.uniform(0.03, 0.12, 361)
    first, linked = split(points, tolerance, [0, 361])
    assert first == [*textbook.split(points, tolerance), 361]
    assert linked == [1] * (len(first) - 2) + [0]


def pieces_of(moments: Array, linked: list[int]) -> Any:
    """Pieces with these moments (n, 6)."""
    pieces = segments.Segments(len(moments))
    pieces.moments = np.vstack((moments, np.zeros((1, 6))))
    pieces.linked[: len(moments)] = view(linked, np.intp)
    return pieces


def test_merging_all_good_pairs_of_a_round_at_a_time_is_nearly_always_merging_the_best_pair_first() -> None:
    assert sum(as_best_pair_first(seed) for seed in range(20)) >= 19


def as_best_pair_first(seed: int) -> bool:
    rng = np.random.default_rng(seed)
    points, w = end_points(rng), rng.uniform(500.0, 1500.0, 361)
    starts = np.array(textbook.split(points, np.full(361, 0.08)))
    x, y = points.T
    moments = np.add.reduceat(w * np.stack((1 + 0 * x, x, y, x * x, x * y, y * y)), starts, axis=1)
    n = len(starts)
    pieces = pieces_of(moments.T, [1] * n)
    groups = segments.merge(pieces, n, 20.0)
    bounds = list(pieces.bounds[:groups])
    expected = textbook.merge(points, w, starts.tolist(), 20.0)
    joined = np.add.reduceat(moments, bounds, axis=1)
    np.testing.assert_allclose(pieces.moments[:groups].T, joined, rtol=1e-12)
    alone = textbook.misfit(points[: expected[1]], w[: expected[1]])
    assert segments.own_misfit(pieces, 0) == pytest.approx(alone, abs=1e-6)
    return bool(starts[bounds].tolist() == expected)


def test_what_is_not_linked_is_not_joined() -> None:
    along = np.linspace(0.0, 1.0, 10)
    m = [(5.0, x.sum(), 0.0, (x * x).sum(), 0.0, 0.0) for x in np.split(along, 2)]
    for linked, groups in ((0, 2), (1, 1)):
        assert segments.merge(pieces_of(np.array(m), [linked, 0]), 2, 20.0) == groups


# --- returns, gaps and weights, written out in NumPy


def allowed(d: float, before: float) -> float:
    """How far neighbours on one wall may lie apart: 0.3 m, or a tenth of the farther range."""
    return max(0.3, 0.1 * max(d, before))


@pytest.mark.parametrize("seed", range(8))
def test_runs_end_where_neighbours_lie_farther_apart_than_a_wall_allows(seed: int) -> None:
    rng = np.random.default_rng(seed)
    d = rng.uniform(0.5, 8.0, 40)
    x, y = np.cumsum(rng.choice([0.05, 0.2, 0.45, 0.9], 40)), np.cumsum(rng.choice([0.0, 0.05, -0.4], 40))
    returns, runs = returns_of(ranges=d, x=x, y=y), segments.Segments(40)
    segments.cut_at_gaps(returns, 0.1, 0.3, runs)
    apart = np.hypot(np.diff(x), np.diff(y))
    starts = [0] + [i + 1 for i in range(39) if apart[i] > allowed(d[i], d[i + 1])]
    assert list(runs.run_first[: runs.runs + 1]) == [*starts, 40]
    for i in range(39):
        found = segments.gap(returns, i, i + 1, 0.1, 0.3)
        assert found == pytest.approx((apart[i] / allowed(d[i], d[i + 1])) ** 2)
