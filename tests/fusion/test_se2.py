"""SE(2) against homogeneous matrices and the matrix exponential."""

import math

import numpy as np
import pytest
from present import present
from scipy.linalg import expm
from scipy.spatial.transform import Rotation
from textbook import numeric_jacobian

from locfuse.fusion import se2
from locfuse.fusion.statistics import jackknife

POSES = np.array(
    [[0.0, 0, 0], [1, 2, 0.3], [-3, 0.5, math.pi], [2, -1, 1e-9 - math.pi], [0.1, 0.2, 1e-9], [5, 5, 3]]
)


def matrix(p: np.ndarray) -> np.ndarray:
    c, s = math.cos(p[2]), math.sin(p[2])
    return np.array([[c, -s, p[0]], [s, c, p[1]], [0, 0, 1]])


@pytest.mark.parametrize("a", POSES)
@pytest.mark.parametrize("b", POSES)
def test_compose_and_inverse_are_matrix_product_and_inverse(a: np.ndarray, b: np.ndarray) -> None:
    np.testing.assert_allclose(matrix(se2.compose(a, b)), matrix(a) @ matrix(b), atol=1e-12)
    np.testing.assert_allclose(matrix(se2.inverse(a)), np.linalg.inv(matrix(a)), atol=1e-12)
    np.testing.assert_allclose(se2.compose(a, se2.between(a, b)), b, atol=1e-12)


def test_one_step_of_plain_floats_is_to_the_bit_that_of_arrays() -> None:
    rng = np.random.default_rng(5)
    for _ in range(300):
        at, a, b = rng.normal(0.0, rng.choice((0.1, 3.0, 50.0)), (3, 3))
        steps = se2.between(a[None], b[None])
        plain = se2.carried(tuple(at.tolist()), tuple(a.tolist()), tuple(b.tolist()))
        assert plain == tuple(se2.chained(at, steps)[0].tolist())
        np.testing.assert_allclose(plain, se2.compose(at, se2.compose(se2.inverse(a), b)), rtol=0.0, atol=1e-10)


@pytest.mark.parametrize("turn", [0.0, 1e-12, 1e-6, 0.5, -2.0, 3.0, math.pi])
def test_exp_is_the_matrix_exponential_and_log_undoes_it(turn: float) -> None:
    twist = np.array([0.7, -0.2, turn])
    generator = np.array([[0, -turn, 0.7], [turn, 0, -0.2], [0, 0, 0]])
    np.testing.assert_allclose(matrix(se2.exp(twist)), expm(generator), atol=1e-12)
    np.testing.assert_allclose(se2.log(se2.exp(twist)), twist, atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, math.pi, -math.pi, 3 * math.pi, 7.0, -7.0, 1e4])
def test_wrap_stays_in_the_half_open_turn(angle: float) -> None:
    assert -math.pi <= se2.wrap(angle) < math.pi
    assert math.isclose(math.cos(se2.wrap(angle)), math.cos(angle), abs_tol=1e-9)
    assert math.isclose(math.sin(se2.wrap(angle)), math.sin(angle), abs_tol=1e-9)
    assert se2.wrap_all(np.array([angle]))[0] == se2.wrap(angle)


def test_transform_moves_points_and_rotations_turn_places_like_the_matrix() -> None:
    pose, points = np.array([1.0, -2.0, 0.7]), np.array([[0.0, 0.0], [1.0, 0.0], [0.3, -4.0]])
    expected = (matrix(pose) @ np.column_stack((points, np.ones(3))).T).T[:, :2]
    np.testing.assert_allclose(se2.transform(np.tile(pose, (3, 1)), points), expected, atol=1e-12)
    np.testing.assert_allclose(se2.transform(pose, points[1]), expected[1], atol=1e-12)
    theta, v = np.array([0.0, 1.0, -3.1, 0.4]), np.random.default_rng(1).normal(size=(4, 2))
    for angle, R, plane, turned in zip(theta, se2.rotation(theta), v, se2.rotated(theta, v), strict=True):
        np.testing.assert_allclose(R, matrix(np.array([0.0, 0.0, angle])), atol=1e-15)
        np.testing.assert_allclose(turned, R[:2, :2] @ plane, atol=1e-15)


def test_steps_one_after_another_are_composed_one_after_another() -> None:
    rng = np.random.default_rng(5)
    start, steps = rng.normal(size=3), rng.normal(size=(30, 3))
    pose = start
    for step, found in zip(steps, se2.chained(start, steps), strict=True):
        pose = se2.compose(pose, step)
        np.testing.assert_allclose(found, pose, atol=1e-12)


def test_the_yaw_of_a_quaternion_of_any_length_is_the_first_of_its_euler_angles() -> None:
    rng = np.random.default_rng(2)
    angles = rng.uniform((-3.1, -1.5, -3.1), (3.1, 1.5, 3.1), (200, 3))  # yaw, pitch, roll
    x, y, z, w = (Rotation.from_euler("ZYX", angles).as_quat() * rng.uniform(0.3, 3.0, (200, 1))).T
    np.testing.assert_allclose(se2.yaw(x, y, z, w), angles[:, 0], atol=1e-12)


@pytest.mark.parametrize("a", POSES)
@pytest.mark.parametrize("b", POSES[1::2])
def test_derivatives_of_between_are_finite_differences(a: np.ndarray, b: np.ndarray) -> None:
    by_a, by_b = se2.between_jacobians(a, b)
    np.testing.assert_allclose(by_a, numeric_jacobian(lambda p: se2.between(p, b), a), atol=1e-8)
    np.testing.assert_allclose(by_b, numeric_jacobian(lambda p: se2.between(a, p), b), atol=1e-8)


@pytest.mark.parametrize("pose", POSES)
def test_derivatives_of_a_bearing_are_finite_differences(pose: np.ndarray) -> None:
    point, mount = (2.5, -1.2), np.array([0.3, -0.2, 0.7])

    def bearing(p: np.ndarray, m: np.ndarray) -> np.ndarray:
        seen = present(se2.sight(tuple(p), point, tuple(m), 0.1))
        return np.array([seen[0]])

    seen = present(se2.sight(tuple(pose), point, tuple(mount), 0.1))
    np.testing.assert_allclose([seen[2]], numeric_jacobian(lambda p: bearing(p, mount), pose), atol=1e-7)
    np.testing.assert_allclose([seen[3]], numeric_jacobian(lambda m: bearing(pose, m), mount), atol=1e-7)


# --- errors of estimates by leaving out one part after the other

VALUES = np.random.default_rng(1).normal(3.0, 2.0, (40, 2))


def test_the_error_of_a_mean_is_the_textbook_s_and_values_that_repeat_count_once() -> None:
    found = jackknife(lambda some: VALUES[some].mean(axis=0), len(VALUES), len(VALUES))
    assert found == pytest.approx(VALUES.std(axis=0, ddof=1) / math.sqrt(len(VALUES)), rel=1e-12)
    repeated = np.repeat(VALUES[:8, 0], 50)
    found = jackknife(lambda some: repeated[some].mean(), len(repeated), 8)
    assert float(found) == pytest.approx(VALUES[:8, 0].std(ddof=1) / math.sqrt(8.0), rel=1e-12)
    assert math.isinf(jackknife(lambda some: None if 0 not in some else 1.0, 40, 8))
