"""Matching two scans: the pose between them is found; what the walls do not say is left to the prior."""

import numpy as np
import pytest
from ring_drive import box, scan, walls
from scipy.optimize import least_squares

from locfuse.fusion import se2
from locfuse.fusion.data import Array, LocfuseError
from locfuse.fusion.scan_matching.match import CELL_M, Clouds, Targets, match, normals, sources_of, thinned
from locfuse.fusion.scan_matching.solve import Edges, Normal, Problem
from locfuse.fusion.whole_drive.closures import Views, correlate

LOOSE = np.diag([1.0 / 0.3**2, 1.0 / 0.3**2, 1.0 / np.radians(10.0) ** 2])[None]


def clouds(*scans: Array) -> Clouds:
    first = np.concatenate(([0], np.cumsum([len(s) for s in scans])))
    xy, owner = np.concatenate(scans), np.repeat(np.arange(len(scans)), np.diff(first))
    return Clouds(first, xy, normals(xy, owner, np.zeros(2)))


def two(segments: Array, a: Array, b: Array, seed: int = 0) -> Clouds:
    rng = np.random.default_rng(seed)
    return clouds(scan(a, segments, rng), scan(b, segments, rng))


def matched(c: Clouds, guess: Array, prior: Array = LOOSE):  # type: ignore[no-untyped-def]
    return match(Targets(c), np.array([0]), sources_of(c), np.array([1]), guess[None], prior)


@pytest.mark.parametrize("step", [(0.4, 0.0, 0.0), (0.3, 0.1, 0.3), (0.0, 0.0, -0.35), (-0.4, 0.0, 0.1)])
def test_the_pose_between_two_scans_is_found(step: tuple[float, float, float]) -> None:
    a = np.array([2.0, 0.1, 3.0])  # near the wrap at pi
    c = two(walls(alike=False), a, se2.compose(a, np.array(step)))
    found = matched(c, np.array(step) + np.array([0.1, -0.08, np.radians(3.0)]))
    error = found.pose[0] - step
    assert np.hypot(error[0], error[1]) < 0.02
    assert abs(np.degrees(error[2])) < 0.5
    assert found.inliers[0] > 0.9
    assert found.rms[0] < 0.03


def test_along_a_corridor_without_ends_the_prior_holds() -> None:
    corridor = np.array([(-50.0, -1.0, 50.0, -1.0), (-50.0, 1.0, 50.0, 1.0)])
    a, step = np.zeros(3), np.array([0.5, 0.0, 0.0])
    c = two(corridor, a, step)
    guess = np.array([0.45, 0.1, 0.05])
    found = matched(c, guess)
    assert abs(found.pose[0, 0] - guess[0]) < 0.02, "nothing but the prior says how far it went"
    assert abs(found.alone[0, 0] - guess[0]) < 0.02
    assert abs(found.pose[0, 1]) < 0.02
    weak = np.linalg.eigvalsh(found.information[0][:2, :2])
    assert weak[0] < 0.02 * weak[1]


def test_a_strong_prior_pulls_the_pose_but_not_what_the_points_say_alone() -> None:
    step, off = np.array([0.4, 0.0, 0.1]), np.array([0.05, -0.05, np.radians(2.0)])
    c = two(walls(alike=False), np.zeros(3), step)
    prior = np.diag([0.03**-2, 0.03**-2, np.radians(0.5) ** -2])[None]
    found, free = matched(c, step + off, prior), matched(c, step + off, 1e-6 * prior)
    pulled = np.abs(found.pose[0] - free.pose[0]).max()
    assert pulled > 0.01
    assert np.abs(found.alone[0] - free.pose[0]).max() < 0.3 * pulled


def test_the_other_side_of_a_wall_is_not_the_wall() -> None:
    """Through a door: before it the robot sees one face of the wall, behind it the other, 0.15 m further on."""
    sides = [(-50.0, y, 50.0, y) for y in (-3.0, 3.0)]
    faces = [(x, s * 0.6, x, s * 3.0) for x in (-0.075, 0.075) for s in (-1.0, 1.0)]
    frame = [(-0.075, y, 0.075, y) for y in (-0.6, 0.6)]
    before, step = np.array([-1.5, 0.0, 0.0]), np.array([3.0, 0.05, 0.02])
    c = two(np.array([*sides, *faces, *frame]), before, se2.compose(before, step))
    found = matched(c, step)
    assert abs(found.pose[0, 0] - step[0]) < 0.02


def test_no_match_fits_where_the_walls_are_others() -> None:
    rng = np.random.default_rng(1)
    here = scan(np.zeros(3), np.array(box(-2.0, -1.5, 3.0, 2.0)), rng)
    there = scan(np.zeros(3), np.array([*box(-4.0, -4.0, 4.0, 5.0), *box(1.0, 1.0, 1.8, 1.8)]), rng)
    found = matched(clouds(here, there), np.zeros(3))
    assert found.inliers[0] * found.overlap[0] < 0.5


def test_correlation_finds_a_shift_of_metres_and_says_where_two_places_fit() -> None:
    rng = np.random.default_rng(2)
    ours = scan(np.array([4.0, 0.0, 0.0]), walls(alike=False), rng)
    pose = np.array([-1.6, 0.2, 0.2])
    theirs = scan(se2.compose(np.array([4.0, 0.0, 0.0]), pose), walls(alike=False), rng)
    peak = correlate(ours, theirs, pose + np.array([1.2, -0.8, 0.15]), np.array([0.8, 0.8, 0.1]))
    assert np.hypot(*(peak.pose - pose)[:2]) < 0.4
    assert peak.is_decided
    tooth = np.linspace(-1.0, 1.0, 30)
    comb = np.concatenate([np.stack((np.full(30, x), tooth), axis=-1) for x in range(-6, 7, 2)])
    assert not correlate(comb, comb[60:150], np.array([0.3, 0.0, 0.0]), np.array([1.5, 0.3, 0.05])).is_decided


def test_looking_through_a_wall_is_a_contradiction() -> None:
    a, b = np.zeros(3), np.array([0.5, 0.0, 0.1])
    c = two(walls(alike=False), a, b)
    views = Views.of(c, np.zeros(2))
    right, seen = views.contradicted(c, np.array([0]), np.array([1]), b[None])
    assert right[0] / seen[0] < 0.02
    wrong, seen = views.contradicted(c, np.array([0]), np.array([1]), np.array([[0.5, 0.0, 1.5]]))
    assert wrong[0] / seen[0] > 0.1


def test_a_cloud_of_many_scans_is_thinned_to_one_point_in_each_square() -> None:
    one = np.column_stack((np.linspace(0.0, 2.0, 81), np.full(81, 1.01)))
    both = clouds(np.vstack((one, one + 0.001)), one + np.array((0.0, 1.0)))
    thin = thinned(both)
    assert len(thin) == 2
    for k in range(2):
        kept = thin.xy[thin.first[k] : thin.first[k + 1]]
        squares = np.floor(kept / CELL_M)
        assert len(np.unique(squares, axis=0)) == len(kept)
        own = both.xy[both.first[k] : both.first[k + 1]]
        surfaces = own[np.isfinite(both.normal[both.first[k] : both.first[k + 1], 0])]
        assert len(kept) == len(np.unique(np.floor(surfaces / CELL_M), axis=0)), "no square lost its only point"


def test_the_surfaces_of_a_scan_are_those_of_it_alone() -> None:
    rng = np.random.default_rng(5)
    coarse = np.column_stack((np.linspace(-4.0, 4.0, 17), np.full(17, 3.0)))  # 0.5 m apart
    fine = np.column_stack((np.linspace(-2.0, 2.0, 400), 2.0 + 0.001 * rng.normal(size=400)))
    origin = np.zeros(2)
    alone = [normals(xy, np.zeros(len(xy), np.int64), origin) for xy in (coarse, fine)]
    together = normals(np.concatenate((coarse, fine)), np.repeat([0, 1], [17, 400]), origin)
    np.testing.assert_array_equal(together, np.concatenate(alone))
    assert np.isfinite(together).all()
    assert normals(coarse[:1], np.zeros(1, np.int64), origin).shape == (1, 2)


# --- sparse least squares over key poses, against dense least squares; robust kernels against a wrong closure

N = 12
START = Edges.known(0, np.array([1.0, -2.0, 0.5]), np.diag([1e6, 1e6, 1e6]))
GRADUATIONS = (1e4, 1e3, 1e2, 10.0, 1.0)


def ring(rng: np.random.Generator, noise: float) -> tuple[Array, Edges]:
    """Poses round a circle, and what is measured from each to the next two and of the last from the first."""
    angle = 2.0 * np.pi * np.arange(N) / N
    truth = np.stack((5.0 * np.cos(angle), 5.0 * np.sin(angle), angle + np.pi / 2.0), axis=-1)
    truth = se2.compose(START.z[0], se2.between(truth[:1], truth))
    i = np.concatenate((np.arange(N - 1), np.arange(N - 2), [0]))
    j = np.concatenate((np.arange(N - 1) + 1, np.arange(N - 2) + 2, [N - 1]))
    z = se2.between(truth[i], truth[j]) + noise * rng.normal(size=(len(i), 3))
    information = np.array([np.diag(rng.uniform(100.0, 900.0, 3)) for _ in i])
    return truth, Edges.of(i, j, z, information, np.inf)


def started(edges: Edges) -> Array:
    x = np.tile(START.z[0], (N, 1))
    for k in range(N - 1):
        x[k + 1] = se2.compose(x[k], edges.z[k])
    return x


def test_poses_and_covariances_equal_dense_least_squares() -> None:
    _, edges = ring(np.random.default_rng(1), 0.05)
    x, normal = Problem(START).solve(started(edges), edges)
    roots = np.linalg.cholesky(edges.information)

    def residuals(flat: Array) -> Array:
        poses = flat.reshape(-1, 3)
        e = np.einsum("nji,nj->ni", roots, edges.errors(poses)).ravel()
        return np.concatenate((e, 1e3 * (poses[0] - START.z[0])))

    book = least_squares(residuals, started(edges).ravel(), xtol=1e-15, ftol=1e-15, gtol=1e-12)
    np.testing.assert_allclose(x, book.x.reshape(-1, 3), atol=2e-5)
    P, after = normal.chain(N)
    dense = np.linalg.inv(book.jac.T @ book.jac).reshape(N, 3, N, 3)
    for k in range(N):
        np.testing.assert_allclose(P[k], dense[k, :, k, :], rtol=2e-3, atol=1e-9)
    np.testing.assert_allclose(after[3], dense[3, :, 4, :], rtol=2e-3, atol=1e-9)


def test_poses_that_no_match_fixes_are_refused_and_negative_information_gives_no_covariance() -> None:
    _, edges = ring(np.random.default_rng(3), 0.05)
    x, _ = Problem(START).solve(started(edges), edges)
    normal = Normal(x, np.zeros(2), edges, -np.ones(len(edges)), [], 0)
    with pytest.raises(LocfuseError, match="variance is not positive"):
        normal.chain(N)
    with pytest.raises(LocfuseError, match=f"do not fix the {N} poses .*singular"):
        Normal(started(edges), np.zeros(2), edges, np.zeros(len(edges)), [], 0)


def test_jacobians_equal_finite_differences() -> None:
    truth, edges = ring(np.random.default_rng(3), 0.1)
    A, B = edges.jacobians(truth)
    for of_i, J in ((True, A), (False, B)):
        for c in range(3):
            moved = [truth.copy(), truth.copy()]
            for sign, x in zip((1e-6, -1e-6), moved, strict=True):
                x[edges.i[4] if of_i else edges.j[4], c] += sign
            numeric = (edges.errors(moved[0])[4] - edges.errors(moved[1])[4]) / 2e-6
            np.testing.assert_allclose(J[4, :, c], numeric, atol=1e-6)


def test_a_wrong_closure_among_right_ones_is_given_up() -> None:
    truth, edges = ring(np.random.default_rng(4), 0.01)
    i, j, a, b = (np.array(k) for k in ([2, 3, 1], [8, 9, 7], [1, 2], [9, 10]))
    wrong = Edges.of(i, j, np.array([[0.5, 0.2, 0.1]] * 3), edges.information[:3], 4.0)
    right = Edges.of(a, b, se2.between(truth[a], truth[b]), edges.information[:2], 4.0)
    all_edges = Edges.joined(edges, right, wrong)
    x, _ = Problem(START).solve(started(edges), all_edges, GRADUATIONS)
    weights = all_edges.weights(x)
    assert (weights[-3:] < 0.05).all()
    assert (weights[-5:-3] > 0.8).all()
    assert np.hypot(*(x - truth)[:, :2].T).max() < 0.1


def test_a_heading_that_drifts_with_the_way_is_found_and_taken_out() -> None:
    truth, edges = ring(np.random.default_rng(5), 0.0)
    edges.by[:-1, 2, 0] = 2.6 * (edges.j - edges.i)[:-1]
    edges.information[:] *= 1e6
    drift = 0.002
    edges.z[:] += edges.by @ np.array([drift, 0.0])
    problem = Problem(START)
    x, normal = problem.solve(started(edges), edges)
    assert isinstance(normal, Normal)
    assert abs(problem.systematic[0] - drift) < 2e-4
    assert np.hypot(*(x - truth)[:, :2].T).max() < 0.02
