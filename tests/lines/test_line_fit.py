"""The line fit is held to closed forms, to SciPy's least squares and to Monte Carlo."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import least_squares

from locfuse.fusion.data import Array
from locfuse.fusion.lines.fit import Fits, Rays, fitted, improved, misfit, residuals, total_least_squares

NOISE = {"30mm_0.25deg": (0.03, math.radians(0.25)), "5mm_0.1deg": (0.005, math.radians(0.1))}
WALLS = {  # r [m], psi [rad], from where to where along the tangent [m]
    "head_on": (2.0, 0.3, -1.0, 1.0),
    "off_centre": (2.0, 0.3, 1.0, 4.0),
    "far_off_centre": (1.5, -2.0, -5.0, -2.0),
    "grazing": (0.6, 3.1, 1.5, 4.5),
    "short": (2.0, -3.1, 0.2, 0.9),
}
RUNS = 2000
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


def fit(rays: Rays, lines: int, r: float, psi: float, ratio: float, steps: int = 2) -> Fits:
    """As `extract_lines` does it: Gauss-Newton steps from (r, psi), the last of them with the covariance."""
    counts = np.full(lines, len(rays.d) // lines)
    at = np.full(lines, r), np.full(lines, psi)
    for _ in range(steps - 1):
        at = improved(residuals(rays, counts, *at, ratio), counts, *at)
    return fitted(residuals(rays, counts, *at, ratio), counts, *at)


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
    origins = () if side is None else (np.tile(ox, RUNS), np.tile(oy, RUNS))
    return Rays(d.ravel(), np.cos(told), np.sin(told), *origins)


@pytest.mark.parametrize("wall", WALLS.values(), ids=WALLS.keys())
@pytest.mark.parametrize("side", [None, 0.4, -0.4])
def test_a_wall_without_noise_is_found_exactly(wall: Wall, side: float | None) -> None:
    angle = directions(wall, 25)
    ox, oy = (np.zeros(25), np.zeros(25)) if side is None else moving(25, side)
    d = ranges(wall[0], wall[1], angle, ox, oy)
    origins = () if side is None else (ox, oy)
    found = fit(Rays(d, np.cos(angle), np.sin(angle), *origins), 1, wall[0] + 0.02, wall[1] - 0.01, 0.15, steps=6)
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


@pytest.mark.parametrize("noise", NOISE.values(), ids=NOISE.keys())
def test_dropping_the_correlation_would_be_dishonest_off_centre(noise: tuple[float, float]) -> None:
    """The check above is able to fail: without its r-psi term the covariance is far too small."""
    wall = WALLS["far_off_centre"]
    found = fit(simulated(wall, noise, None), RUNS, wall[0], wall[1], noise[1] / noise[0])
    inverse = np.linalg.inv(found.R_unit * noise[0] ** 2)
    error = np.stack((found.r - wall[0], wrapped(found.psi - wall[1])), axis=1)
    assert np.einsum("ni,ni,nii->n", error, error, inverse).mean() > 8.0


@pytest.mark.parametrize("wall", WALLS.values(), ids=WALLS.keys())
def test_residuals_have_the_size_their_sigmas_say(wall: Wall) -> None:
    noise = NOISE["30mm_0.25deg"]
    found = fit(simulated(wall, noise, None), RUNS, wall[0], wall[1], noise[1] / noise[0])
    chi2 = found.misfit / noise[0] ** 2
    assert chi2.mean() == pytest.approx(58.0, rel=0.02)
    assert (found.bend / noise[0] ** 2).mean() == pytest.approx(1.0, abs=0.15)  # one degree of freedom


@pytest.mark.parametrize("wall", WALLS.values(), ids=WALLS.keys())
@pytest.mark.parametrize("side", [None, 0.4])
def test_the_fit_equals_scipy_on_the_ranges(wall: Wall, side: float | None) -> None:
    noise = NOISE["30mm_0.25deg"]
    rays = simulated(wall, noise, side)
    one = Rays(*(a[:60] for a in (rays.d, rays.c, rays.s, rays.ox, rays.oy) if a is not None))
    angle = np.arctan2(one.s, one.c)
    ox, oy = (np.zeros(60), np.zeros(60)) if one.ox is None or one.oy is None else (one.ox, one.oy)

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


def test_lines_fitted_together_are_the_lines_fitted_alone() -> None:
    noise = NOISE["30mm_0.25deg"]
    wall = WALLS["off_centre"]
    rays = simulated(wall, noise, 0.4)
    together = fit(rays, RUNS, *wall[:2], noise[1] / noise[0])
    for i in (0, 1, 7, RUNS - 1):
        alone = fit(rays.take(np.arange(60 * i, 60 * (i + 1))), 1, *wall[:2], noise[1] / noise[0])
        for name in ("r", "psi", "R_unit", "misfit", "bend"):
            assert getattr(alone, name)[0].tobytes() == getattr(together, name)[i].tobytes()


def test_rays_of_no_weight_do_not_count() -> None:
    noise, wall = NOISE["5mm_0.1deg"], WALLS["off_centre"]
    rays = simulated(wall, noise, None).take(np.arange(60))
    used = np.ones(60, bool)
    used[[0, 5, 59]] = False
    rays.d[~used] += 1.0
    start = np.array([wall[0]]), np.array([wall[1]])
    ratio = noise[1] / noise[0]
    seen = residuals(rays, np.array([60]), *start, ratio)
    masked = fitted(seen._replace(w=seen.w * used), np.array([60]), *start)
    fewer = fitted(
        residuals(rays.take(np.flatnonzero(used)), np.array([57]), *start, ratio), np.array([57]), *start
    )
    assert [masked.r[0], masked.psi[0]] == pytest.approx([fewer.r[0], fewer.psi[0]], abs=1e-12)
    np.testing.assert_allclose(masked.R_unit, fewer.R_unit, rtol=1e-9)


def moments(points: Array, weights: Array) -> Array:
    x, y = points.T
    return np.array([(weights * p).sum() for p in (1.0 + 0 * x, x, y, x * x, x * y, y * y)])[:, None]


@pytest.mark.parametrize("psi", [-math.pi, -2.0, -math.pi / 2, 0.0, 1e-9, 1.0, math.pi / 2, 3.0, math.pi])
def test_total_least_squares_equals_the_principal_axis(psi: float) -> None:
    rng = np.random.default_rng(1)
    n, t = np.array([math.cos(psi), math.sin(psi)]), np.array([-math.sin(psi), math.cos(psi)])
    points = 2.0 * n + rng.normal(0, 1, (40, 1)) * t + rng.normal(0, 0.05, (40, 1)) * n
    weights = rng.uniform(0.5, 2.0, 40)
    r, angle, square = total_least_squares(moments(points, weights))
    mean = np.average(points, axis=0, weights=weights)
    values, vectors = np.linalg.eigh((weights[:, None] * (points - mean)).T @ (points - mean))
    normal = vectors[:, 0] * np.sign(vectors[:, 0] @ mean)
    assert [math.cos(angle[0]), math.sin(angle[0])] == pytest.approx(normal.tolist(), abs=1e-9)
    assert r[0] == pytest.approx(normal @ mean, abs=1e-9)
    assert square[0] == pytest.approx(values[0], abs=1e-9)
    assert misfit(moments(points, weights))[0] == square[0]


def test_a_bow_shows_as_bend() -> None:
    """An arc of radius 1.5 m: the parabola beside its chord has the coefficient 1 / (2 radius)."""
    angle = np.linspace(-0.2, 0.2, 60)
    d = 3.0 * np.cos(angle) - np.sqrt(1.5**2 - (3.0 * np.sin(angle)) ** 2)
    found = fit(Rays(d, np.cos(angle), np.sin(angle)), 1, d.min(), 0.0, 0.1)
    assert abs(found.curvature[0]) == pytest.approx(1.0 / 3.0, rel=0.1)
    assert found.bend[0] > 0.9 * found.misfit[0]
