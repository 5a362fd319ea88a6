"""The circles of an omni picture are found where they were drawn, and nowhere else."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from locfuse.fusion.checks.pictures import of_rims
from locfuse.fusion.sensors.camera import CameraSettings

SIZE_PX = 320


def pictures(centre: tuple[float, float], inner: float, outer: float) -> list[NDArray[np.uint8]]:
    """Return noisy pictures: dark without and in the middle, between them a scene that changes."""
    rng = np.random.default_rng(7)
    y, x = np.mgrid[:SIZE_PX, :SIZE_PX]
    r = np.hypot(x - centre[0], y - centre[1])
    ring = (r >= inner) & (r <= outer)
    made = []
    for _ in range(6):
        scene = 120.0 + 60.0 * np.sin(np.arctan2(y - centre[1], x - centre[0]) * 3.0 + rng.uniform(0.0, 6.0))
        grey = np.where(ring, scene, 12.0) + rng.normal(0.0, 3.0, r.shape)
        made.append(np.repeat(np.clip(grey, 0, 255).astype(np.uint8)[:, :, None], 3, axis=2))
    return made


def test_both_circles_are_found_to_a_pixel() -> None:
    (finding,) = of_rims(pictures((166.4, 153.7), 40.0, 140.0), CameraSettings())
    values = dict(fix.removeprefix("camera.").split("=") for fix in finding.fixes)
    x, y = (float(v) for v in values["centre"].strip("[]").split(","))
    assert (x, y) == pytest.approx((166.4, 153.7), abs=0.5)
    assert float(values["outer"]) == pytest.approx(140.0, abs=1.0)
    assert float(values["inner"]) == pytest.approx(40.0, abs=1.0)


def test_a_calibration_that_fits_is_left_alone() -> None:
    right = CameraSettings(centre=(166.4, 153.7), inner=40.0, outer=140.0)
    assert of_rims(pictures((166.4, 153.7), 40.0, 140.0), right) == []


def test_pictures_without_a_circle_say_nothing() -> None:
    rng = np.random.default_rng(3)
    noise = [rng.integers(0, 255, (SIZE_PX, SIZE_PX, 3), np.uint8) for _ in range(6)]
    assert of_rims(noise, CameraSettings()) == []
    stripes = np.zeros((SIZE_PX, SIZE_PX, 3), np.uint8)
    stripes[:, 60:260] = 200
    assert of_rims([stripes] * 6, CameraSettings()) == []
