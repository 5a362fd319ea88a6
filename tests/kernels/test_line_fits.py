"""The line fit is held to closed forms, to SciPy's least squares and to Monte Carlo."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
from interpreted import interpreted
from scipy.optimize import least_squares

from locfuse.fusion.data import Array
from locfuse.fusion.lines.extract import Lines, LineSettings, extract_lines

core, segments = interpreted("line_fits"), interpreted("segments")
NOISE = {"30mm_0.25deg": (0.03, math.radians(0.25)), "5mm_0.1deg": (0.005, math.radians(0.1))}
WALLS = {  # r [m], psi [rad], from where to where along the tangent [m]
    "head_on": (2.0, 0.3, -1.0, 1.0),
    "off_centre": (2.0, 0.3, 1.0, 4.0),
    "far_off_centre": (1.5, -2.0, -5.0, -2.0),
    "grazing": (0.6, 3.1, 1.5, 4.5),
    "short": (2.0, -3.1, 0.2, 0.9),
}
RUNS = 500
Wall = tuple[float, float, float, float]


def directions(wall: Wall, beams: int) -> Array:
    """Beam angles, evenly spaced, that a sensor at the origin sends to a wall."""
    r, psi, lo, hi = wall
    return psi + np.linspace(math.atan2(lo, r), math.atan2(hi, r), beams)


def ranges(r: float, psi: float, angle: Array, ox: Array, oy: Array) -> Array:
    """Distance from (ox, oy) along `angle` to the line: the ray equation, solved for the range."""
    return np.asarray((r - ox * math.cos(psi) - oy * math.sin(psi)) / np.cos(angle - psi))


def moving(beams: int, side: float) -> tuple[Array, Array]:
    """Beam origins of a laser that drives 10 cm during one scan, on a curve to one side."""
    t = np.linspace(-0.5, 0.5, beams)
    return 0.1 * t, side * t * t


class Rays(NamedTuple):
    """Beams of all lines, one line after another: range, direction, origin."""

    d: Array
    c: Array
    s: Array
    ox: Array
    oy: Array

    def take(self, rows: slice | Array) -> Rays:
        return Rays(*(column[rows] for column in self))


class Fits(NamedTuple):
    """A value per line."""

    r: Array
    psi: Array
    R_unit: Array
    misfit: Array
    bend: Array
    curvature: Array


def fit(rays: Rays, lines: int, r: float, psi: float, ratio: float, steps: int = 2) -> Fits:
    """As `fit_wall` does it: Gauss-Newton steps from (r, psi), the last of them with the covariance."""
    n = len(rays.d) // lines
    found = [one_line(rays.take(slice(n * i, n * i + n)), r, psi, ratio, steps) for i in range(lines)]
    return Fits(*(np.array(column) for column in zip(*found, strict=True)))


def one_line(
    rays: Rays, r: float, psi: float, ratio: float, steps: int, used: list[int] | None = None
) -> tuple[float, float, list[list[float]], float, float, float]:
    rows = np.arange(len(rays.d)) if used is None else used
    found = core.Fit(len(rows))
    found.row, found.count, found.r, found.psi = rows, len(rows), r, psi
    for _ in range(steps):
        core.residuals(returns_of(rays), SimpleNamespace(ratio=ratio), found)
        core.normal_equations(found)
        core.parabola(found)
        core.take_step(found)
    det = core.determinant(found)
    R_unit = [[found.sum_wqq / det, found.sum_wq / det], [found.sum_wq / det, found.sum_w / det]]
    return found.r, found.psi, R_unit, core.misfit_of(found), core.bend(found), core.curvature(found)


def returns_of(rays: Rays) -> Any:
    """The rays as the kernel takes them."""
    d, c, s, ox, oy = (column.tolist() for column in rays)
    return SimpleNamespace(ranges=d, ux=c, uy=s, ox=ox, oy=oy)


def fit_of(row: Any, e: Any, q: Any, w: Any) -> Any:
    """Returns in the fit: their distances e [m] from the line, feet q [m] and weights w."""
    found = core.Fit(len(row))
    found.count = len(row)
    found.row, found.error, found.foot, found.weight = list(row), list(e), list(q), list(w)
    return found


def wrapped(angle: Array) -> Array:
    return np.asarray(np.arctan2(np.sin(angle), np.cos(angle)))


def simulated(wall: Wall, noise: tuple[float, float], side: float | None) -> Rays:
    """RUNS noisy views of one wall: every beam really leaves at a wrong angle, and its range is wrong too."""
    rng = np.random.default_rng(1)
    nominal = directions(wall, 60)
    ox, oy = (np.zeros(60), np.zeros(60)) if side is None else moving(60, side)
    size = (RUNS, 60)
    real = nominal + rng.normal(0.0, noise[1], size)
    d = ranges(wall[0], wall[1], real, ox, oy) + rng.normal(0.0, noise[0], size)
    told = np.tile(nominal, RUNS)
    return Rays(d.ravel(), np.cos(told), np.sin(told), np.tile(ox, RUNS), np.tile(oy, RUNS))


@pytest.mark.parametrize("wall", WALLS.values(), ids=WALLS.keys())
@pytest.mark.parametrize("side", [None, 0.4, -0.4])
def test_a_wall_without_noise_is_found_exactly(wall: Wall, side: float | None) -> None:
    angle = directions(wall, 25)
    ox, oy = (np.zeros(25), np.zeros(25)) if side is None else moving(25, side)
    d = ranges(wall[0], wall[1], angle, ox, oy)
    found = fit(Rays(d, np.cos(angle), np.sin(angle), ox, oy), 1, wall[0] + 0.02, wall[1] - 0.01, 0.15, steps=6)
    assert found.r[0] == pytest.approx(wall[0], abs=1e-12)
    assert wrapped(found.psi - wall[1])[0] == pytest.approx(0.0, abs=1e-12)
    assert found.misfit[0] == pytest.approx(0.0, abs=1e-20)


@pytest.mark.parametrize("wall", WALLS.values(), ids=WALLS.keys())
@pytest.mark.parametrize("noise", NOISE.values(), ids=NOISE.keys())
@pytest.mark.parametrize("side", [None, 0.4])
def test_the_covariance_is_honest(wall: Wall, noise: tuple[float, float], side: float | None) -> None:
    """Normalised squared error of (r, psi): chi-square, 2 degrees; its mean within 95 % bounds of 2."""
    found = fit(simulated(wall, noise, side), RUNS, wall[0], wall[1], noise[1] / noise[0])
    error = np.stack((found.r - wall[0], wrapped(found.psi - wall[1])), axis=1)
    inverse = np.linalg.inv(found.R_unit * noise[0] ** 2)
    nees = np.einsum("ni,nij,nj->n", error, inverse, error)
    assert nees.mean() == pytest.approx(2.0, abs=1.96 * 2.0 / math.sqrt(RUNS))
    assert (nees > 13.8).mean() < 0.005  # 0.1 % expected


@pytest.mark.parametrize("wall", WALLS.values(), ids=WALLS.keys())
@pytest.mark.parametrize("side", [None, 0.4])
def test_the_fit_equals_scipy_on_the_ranges(wall: Wall, side: float | None) -> None:
    noise = NOISE["30mm_0.25deg"]
    rays = simulated(wall, noise, side)
    one = rays.take(slice(60))
    angle, ox, oy = np.arctan2(one.s, one.c), one.ox, one.oy

    def sigma(x: Array) -> Array:
        p = ranges(x[0], x[1], angle, ox, oy)
        return np.asarray(np.hypot(noise[0], noise[1] * p * np.tan(angle - x[1])))

    x, s = np.array(wall[:2]), np.ones(60)
    for _ in range(20):  # the weights belong to the solution: iterate until they do
        s = sigma(x)
        solved = least_squares(
            lambda v, s=s: (one.d - ranges(v[0], v[1], angle, ox, oy)) / s, x, xtol=1e-15, ftol=1e-15, gtol=1e-15
        )
        x = solved.x
    found = fit(one, 1, wall[0], wall[1], noise[1] / noise[0], steps=30)
    assert [found.r[0], found.psi[0]] == pytest.approx(x.tolist(), abs=1e-8)
    covariance = np.linalg.inv(solved.jac.T @ solved.jac)
    np.testing.assert_allclose(found.R_unit[0] * noise[0] ** 2, covariance, rtol=1e-5)
    assert found.misfit[0] / noise[0] ** 2 == pytest.approx(2.0 * solved.cost, rel=1e-6)
    sigmas = np.sqrt(np.diag(covariance))
    usual = fit(one, 1, wall[0], wall[1], noise[1] / noise[0])
    assert np.abs([usual.r[0], usual.psi[0]] - x).tolist() <= (0.05 * sigmas).tolist()


def random_fit(seed: int) -> tuple[Array, Array, Array, Any]:
    """Distances e [m] at feet q [m] with weights w, and the fit of one step."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(4, 40))
    e, q, w = rng.normal(0.0, 0.05, n), rng.uniform(-1.0, 3.0, n), rng.uniform(0.2, 1.0, n)
    e += 0.04 * q * q
    return e, q, w, summed(e, q, w)


def summed(e: Array, q: Array, w: Array) -> Any:
    """The fit with all its sums."""
    found = fit_of(range(len(e)), e.tolist(), q.tolist(), w.tolist())
    core.normal_equations(found)
    core.parabola(found)
    return found


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
    assert (core.step_r(sums), core.step_psi(sums)) == pytest.approx((r, psi))
    assert core.misfit_of(sums) == pytest.approx(left)
    x, bent = solved(e, w, one, -q, q * q)
    assert core.curvature(sums) == pytest.approx(x[2])
    assert core.bend(sums) == pytest.approx(left - bent)
    alone = solved(q * q, w, one, q)[1]
    assert core.stiffness(sums) == pytest.approx(alone)


@pytest.mark.parametrize("seed", range(10))
def test_the_foot_and_the_distance_of_a_return_are_those_of_the_ray_and_the_line(seed: int) -> None:
    rng = np.random.default_rng(seed)
    r, psi, ratio = rng.uniform(0.5, 3.0), rng.uniform(-3.0, 3.0), 0.15
    n, t = np.array([math.cos(psi), math.sin(psi)]), np.array([-math.sin(psi), math.cos(psi)])
    angle = psi + rng.uniform(-1.2, 1.2, 5)
    u, o, d = (
        np.column_stack((np.cos(angle), np.sin(angle))),
        rng.normal(0.0, 0.3, (5, 2)),
        rng.uniform(1.0, 4.0, 5),
    )
    returns = returns_of(Rays(d, *u.T, *o.T))
    found = fit_of(range(5), [0.0] * 5, [0.0] * 5, [0.0] * 5)
    found.r, found.psi = r, psi
    core.residuals(returns, SimpleNamespace(ratio=ratio), found)
    e, q, w = found.error, found.foot, found.weight
    for i in range(5):
        p, foot = np.linalg.solve(np.column_stack((u[i], -t)), r * n - o[i])  # the ray o + p u meets r n + foot t
        assert q[i] == pytest.approx(foot)
        assert core.foot_of(returns, i, r, psi) == pytest.approx(foot)
        assert e[i] == pytest.approx(n @ (o[i] + d[i] * u[i]) - r)
        cosine = float(n @ u[i])
        across = ratio * p * math.sqrt(1.0 - cosine**2)  # what s_phi moves the end along the normal, over s_d
        assert w[i] == pytest.approx(1.0 / (across**2 + cosine**2))


@pytest.mark.parametrize("angle", [0.0, 3.0, -3.0, math.pi, -math.pi, 4.0, -4.0, 9.0, -100.0, 1e4])
def test_an_angle_is_wrapped_into_half_a_turn_to_either_side(angle: float) -> None:
    found = interpreted("angles").wrapped(angle)
    assert -math.pi <= found < math.pi
    assert math.sin(found - angle) == pytest.approx(0.0, abs=1e-9)
    assert math.cos(found - angle) == pytest.approx(1.0)


# --- curved walls are no landmarks, straight ones stay: rooms whose shape is known, seen with noise

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
