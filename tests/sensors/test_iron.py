"""Hard and soft iron: drawn ellipses are found again, and what is no ellipse is refused with the reason."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from locfuse.fusion import se2
from locfuse.fusion.data import LocfuseError
from locfuse.fusion.sensors.iron import fit_iron, iron_error_deg, plausible

Array = NDArray[np.float64]
FIELD = 20e-6
CASES = [
    ((0.3e-6, -0.2e-6), (1.01, 0.99, 0.005)),
    ((12e-6, -9e-6), (1.3, 0.8, 0.1)),
    ((45e-6, 30e-6), (0.7, 1.1, -0.2)),  # the centre outside the circle
]


def field(
    hard: tuple[float, ...], soft: tuple[float, ...], angles: Array, noise: float = 0.0, seed: int = 0
) -> Array:
    """What two axes read while the robot has the headings `angles` in a field of 20 uT."""
    gain = np.array([[soft[0], soft[2]], [soft[2], soft[1]]])
    turned = np.stack((np.cos(angles), -np.sin(angles)), axis=-1)
    rng = np.random.default_rng(seed)
    read: Array = FIELD * turned @ gain.T + np.array(hard) + FIELD * noise * rng.normal(size=(len(angles), 2))
    return read


@pytest.mark.parametrize(("hard", "soft"), CASES)
def test_an_ellipse_without_noise_is_found_exactly(hard: tuple[float, ...], soft: tuple[float, ...]) -> None:
    angles = np.linspace(0.0, math.tau, 300)
    iron = fit_iron(field(hard, soft, angles))
    np.testing.assert_allclose(iron.hard, hard, atol=1e-6 * FIELD)
    error = se2.wrap_all(-iron.headings(field(hard, soft, angles)) - angles)
    np.testing.assert_allclose(error, 0.0, atol=1e-6)
    assert np.linalg.det(iron.soft) == pytest.approx(1.0)


@pytest.mark.parametrize(("hard", "soft"), CASES)
def test_the_stated_sigmas_are_those_of_many_draws(hard: tuple[float, ...], soft: tuple[float, ...]) -> None:
    angles = np.linspace(0.0, math.tau, 400)
    found = [fit_iron(field(hard, soft, angles, noise=0.01, seed=s)) for s in range(60)]
    spread = np.std([f.hard for f in found], axis=0)
    np.testing.assert_allclose(np.mean([f.hard_sigma for f in found], axis=0), spread, rtol=0.4)
    spread = np.std([f.soft for f in found], axis=0)
    np.testing.assert_allclose(np.mean([f.soft_sigma for f in found], axis=0), spread, rtol=0.4)


def test_a_motor_that_runs_for_a_fifth_of_the_time_changes_little() -> None:
    angles = np.linspace(0.0, 3 * math.tau, 1500)
    readings = field((3e-6, 2e-6), (1.05, 0.95, 0.02), angles, noise=0.005)
    readings[300:600] += np.array([6e-6, -8e-6])
    iron = fit_iron(readings)
    quiet = np.r_[0:300, 600:1500]
    error = se2.wrap_all(-iron.headings(readings[quiet]) - angles[quiet])
    assert math.degrees(np.sqrt((error**2).mean())) < 1.0


def test_the_error_that_iron_makes_is_its_closed_form_for_a_small_hard_iron() -> None:
    """A centre off by a share q of the field bends headings by q sin: q/sqrt(2) rms."""
    q = 0.05
    assert iron_error_deg(np.array([q, 0.0]), np.eye(2)) == pytest.approx(math.degrees(q / math.sqrt(2)), rel=0.01)


@pytest.mark.parametrize(
    ("angles", "says"),
    [
        (np.linspace(0.0, math.pi, 300), "of 360 degrees"),
        (np.zeros(300), "does not change"),
        (np.linspace(0.0, math.tau, 20), "at least 50"),
    ],
)
def test_what_shows_too_little_of_the_circle_is_refused(angles: Array, says: str) -> None:
    with pytest.raises(LocfuseError, match=says):
        fit_iron(field((1e-6, 0.0), (1.0, 1.0, 0.0), angles))


@pytest.mark.parametrize("seed", range(20))
def test_a_straight_run_shows_no_iron_whatever_its_noise(seed: int) -> None:
    """A cloud of noise about a short arc: the fit runs away, to NaN or to a line."""
    along = np.random.default_rng(seed).normal(0.3, 0.02, 3000)
    with pytest.raises(LocfuseError, match=r"ellipse|of 360 degrees"):
        fit_iron(field((3e-7, -2e-7), (1.0, 1.0, 0.0), along, noise=0.01, seed=seed))


def test_readings_on_no_ellipse_are_refused() -> None:
    noise = np.random.default_rng(1).uniform(-1.0, 1.0, (500, 2))
    with pytest.raises(LocfuseError, match="ellipse"):
        fit_iron(noise)


def test_readings_of_absurd_strength_are_left_out() -> None:
    good = np.column_stack((20e-6 * np.cos(np.arange(200.0)), 20e-6 * np.sin(np.arange(200.0))))
    readings = np.concatenate((good, [[1e200, 0.0], [math.nan, 1.0], [3e-3, 0.0]]))
    assert plausible(readings).tolist() == [True] * 200 + [False] * 3
    assert fit_iron(readings).readings == 200
