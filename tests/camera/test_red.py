"""Red things in a picture: the fast way agrees with OpenCV's median of the whole picture."""

from __future__ import annotations

import math

import cv2
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from locfuse.fusion.camera import radial
from locfuse.fusion.camera.optics import Optics
from locfuse.fusion.camera.panorama import Candidate, Red, cap, largest, red_grey, variance

GAP_PX = 2.0
RED = Red(length=4.0)


def picture(seed: int, things: int, noise: float, shape: tuple[int, int], optics: Optics) -> NDArray[np.uint8]:
    """A grey picture with red radial bars of any width, brightness and length, and single red pixels."""
    rng, (h, w) = np.random.default_rng(seed), shape
    shot = rng.integers(90, 140, (h, w, 3)).astype(np.uint8)
    y, x = np.mgrid[:h, :w]
    theta, r = np.arctan2(x - optics.x_c, y - optics.y_c), np.hypot(x - optics.x_c, y - optics.y_c)
    for _ in range(things):
        middle, half = rng.uniform(-math.pi, math.pi), rng.uniform(0.02, 0.2)
        near, far = np.sort(rng.uniform(0.0, 1.2 * optics.outer, 2))
        off = np.abs((theta - middle + math.pi) % math.tau - math.pi)
        shot[(off < half) & (r >= near) & (r <= far)] = (20, 20, rng.integers(60, 255))
    lone = rng.random(shape) < noise
    shot[lone] = (0, 0, 250)
    return shot


def by_arrays(shot: NDArray[np.uint8], optics: Optics, red: Red) -> list[Candidate]:
    """The same with OpenCV's median and NumPy's sorting, of the whole picture."""
    y, x = np.mgrid[: shot.shape[0], : shot.shape[1]]
    square = (x - optics.x_c) ** 2 + (y - optics.y_c) ** 2
    inside = (square >= optics.inner**2) & (square <= optics.outer**2)
    grey = np.where(inside, red_grey(shot, red), 0).astype(np.uint8)
    j, i = np.nonzero(np.minimum(grey, cv2.medianBlur(grey, 3)))
    theta, r, weight = np.arctan2(i - optics.x_c, j - optics.y_c), np.sqrt(square[j, i]), grey[j, i].astype(float)
    order = np.argsort(theta, kind="stable")
    gap = np.diff(theta[order]) * (r[order][1:] + r[order][:-1]) * 0.5 > GAP_PX
    parts = np.split(order, np.flatnonzero(gap) + 1) if len(order) else []
    if len(parts) > 1:
        a, b = parts[-1][-1], parts[0][0]
        if (theta[b] + math.tau - theta[a]) * (r[a] + r[b]) * 0.5 <= GAP_PX:
            parts[0] = np.concatenate((parts.pop(), parts[0]))
    edge = (i == 0) | (j == 0) | (i == shot.shape[1] - 1) | (j == shot.shape[0] - 1)
    found = []
    for part in parts:
        if len(part) < red.length or len(order) < red.length:
            continue
        cut = r[part[edge[part]]]
        p = part[r[part] < cut.min() - 1.0] if len(cut) else part
        if not len(p):
            continue
        angle, w = np.where(theta[p] < theta[p[0]], theta[p] + math.tau, theta[p]), weight[p]
        w = np.minimum(w, cap(w))
        middle = float((w * angle).sum() / w.sum()) % math.tau
        length = float(len(np.unique((r[p] - r[p].min()).astype(int))))
        radius = 0.5 * float(r[p].min() + r[p].max())
        width = len(p) / (length * radius)
        found.append(Candidate(middle, variance(middle, radius, length, width), len(p), length, width, radius))
    return largest(found, red)


@settings(deadline=None, max_examples=60)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(0, 9),
    st.sampled_from([0.0, 0.002, 0.05, 0.6]),
    st.sampled_from(
        [(60, 80, 39.5, 29.5, 5.0, 29.0), (48, 48, 23.0, 20.0, 0.0, 40.0), (3, 90, 44.0, 1.0, 2.0, 60.0)]
    ),
)
def test_things_are_the_same_by_whole_arrays(
    seed: int, things: int, noise: float, view: tuple[int, int, float, float, float, float]
) -> None:
    """With the mirror inside the picture, cut by its edges, and a picture of three rows."""
    h, w, x, y, inner, outer = view
    optics = Optics(x, y, inner, outer)
    shot = picture(seed, things, noise, (h, w), optics)
    found = radial.candidates(shot, optics, RED)
    other = by_arrays(shot, optics, RED)
    assert len(found) == len(other)
    here, there = np.array(found).reshape(-1, 6), np.array(other).reshape(-1, 6)
    here[:, 0] -= math.tau * np.round(
        (here[:, 0] - there[:, 0]) / math.tau
    )  # straight ahead: 0 or 2 pi by rounding
    np.testing.assert_allclose(here, there, rtol=1e-9, atol=1e-15)


def test_a_thing_across_the_angle_pi_is_one() -> None:
    optics = Optics(39.5, 29.5, 5.0, 29.0)
    shot = np.full((60, 80, 3), 100, np.uint8)
    shot[5:20, 38:42] = (0, 0, 200)  # straight up: from -pi to pi
    (found,) = radial.candidates(shot, optics, RED)
    assert abs(found.theta - math.pi) < 1e-9
    assert found.pixels == 60 - 4  # the corners are no median of their neighbours
