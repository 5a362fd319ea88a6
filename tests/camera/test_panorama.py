"""The two ways to find a red pole in an omni picture, held to printed equations, to a mirror and to each other."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from omni_scene import Lens, Picture, Pole, picture, wrapped_deg

from locfuse.fusion.camera import panorama, radial
from locfuse.fusion.camera.detect import Detector
from locfuse.fusion.camera.optics import (
    Optics,
    angle_of_bearing,
    bearing,
    omni_1,
    paper_omni_1,
)
from locfuse.fusion.camera.panorama import Candidate, Red

Chain = Callable[[Picture, Optics, Red], list[Candidate]]
CHAINS: dict[str, Chain] = {"fast": radial.candidates, "paper": panorama.candidates}
both_chains = pytest.mark.parametrize("chain", CHAINS.values(), ids=CHAINS.keys())
LENS = Lens()
PHOTO_OPTICS = Optics(986.0, 546.0, 235.0, 600.0)


def optics_of(lens: Lens) -> Optics:
    zero = math.radians(lens.zero_deg)
    return Optics(lens.x_c, lens.y_c, lens.inner, lens.outer, 720, zero, lens.clockwise)


def bearings_deg(found: list[Candidate], lens: Lens = LENS) -> list[float]:
    return [math.degrees(float(bearing(np.asarray(c.theta), optics_of(lens)))) for c in found]


def one_error(chain: Chain, shot: Picture, pole: Pole, lens: Lens = LENS) -> float:
    """Error [deg] of the only candidate."""
    found = bearings_deg(chain(shot, optics_of(lens), Red()), lens)
    assert len(found) == 1, found
    return wrapped_deg(found[0] - pole.bearing_deg)


def jpeg(shot: Picture, quality: int = 80) -> Picture:
    _, data = cv2.imencode(".jpg", shot, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)


# --- equation (1) ---


def test_omni_eq_1_as_printed_is_the_printed_expression() -> None:
    x_p, y_p = np.meshgrid(np.arange(0.0, 720.0, 7.0), np.arange(0.0, 300.0, 11.0))
    x_c = 321.5
    x_0, y_0 = paper_omni_1(x_p, y_p, x_c)
    r, theta = y_p, x_p * 360 / 720
    assert np.array_equal(theta, x_p / 2)
    np.testing.assert_allclose(x_0, x_c + r * np.sin(theta * math.pi / 180), atol=1e-9)
    np.testing.assert_allclose(y_0, x_c + r * np.cos(theta * math.pi / 180), atol=1e-9)


def test_omni_eq_1_corrected_has_both_centres_the_inner_radius_and_any_width() -> None:
    x_p, y_p = np.meshgrid(np.arange(0.0, 1000.0, 7.0), np.arange(0.0, 170.0, 11.0))
    x_0, y_0 = omni_1(x_p, y_p, Optics(321.5, 238.0, 60.0, 230.0, width=1000))
    theta, r = 2 * math.pi * x_p / 1000, 60.0 + y_p
    np.testing.assert_allclose(x_0, 321.5 + r * np.sin(theta), atol=1e-9)
    np.testing.assert_allclose(y_0, 238.0 + r * np.cos(theta), atol=1e-9)


@pytest.mark.parametrize("clockwise", [False, True])
def test_a_bearing_and_its_picture_angle_are_inverse_to_each_other(clockwise: bool) -> None:
    optics = Optics(0, 0, 1, 2, 720, 0.7, clockwise)
    phi = np.linspace(-math.pi, math.pi, 50, endpoint=False)
    np.testing.assert_allclose(bearing(angle_of_bearing(phi, optics), optics), phi, atol=1e-12)


def test_column_0_looks_down_in_the_picture_and_columns_turn_counter_clockwise_on_the_screen() -> None:
    shot = np.zeros((201, 201), np.uint8)
    down, right, up, left = 50, 100, 150, 200
    shot[180, 100], shot[100, 180], shot[20, 100], shot[100, 20] = down, right, up, left
    unrolled = panorama.unwrap(shot, Optics(100, 100, 20, 95))
    seen = [unrolled[60, c] for c in (0, 180, 360, 540)]
    assert seen == [down, right, up, left]


def test_a_panorama_pixel_shows_the_picture_where_eq_1_says() -> None:
    y, x = np.mgrid[:240, :320]
    shot = ((x + 2 * y) / 4).astype(np.uint8)
    optics = Optics(160.3, 119.8, 30, 110, 360)
    unrolled = panorama.unwrap(shot, optics).astype(float)
    y_p, x_p = np.mgrid[: optics.rows, :360].astype(float)
    theta, r = 2 * math.pi * x_p / 360, 30 + y_p
    plane = (160.3 + r * np.sin(theta) + 2 * (119.8 + r * np.cos(theta))) / 4
    assert np.abs(unrolled - plane).max() < 1.5


# --- the steps ---


def test_a_pixel_is_red_by_its_excess_over_green_and_blue_and_by_its_share() -> None:
    rng = np.random.default_rng(3)
    shot = rng.integers(0, 256, (90, 110, 3), np.uint8)
    red = Red(ratio=0.45, minimum=37.0)
    b, g, r = shot.astype(float).transpose(2, 0, 1)
    excess = np.clip(r - np.maximum(b, g), 0, None)
    expected = np.where((excess >= np.rint(0.45 * r)) & (excess >= 37), excess, 0)
    np.testing.assert_array_equal(panorama.red_grey(shot, red), expected)


def test_the_noise_filter_removes_single_pixels_and_keeps_a_pole() -> None:
    pole = Pole(35.0)
    shot = picture(LENS, pole)
    rng = np.random.default_rng(0)
    noisy = shot.copy()
    x, y = rng.integers(0, LENS.width, 3000), rng.integers(0, LENS.height, 3000)
    noisy[y, x] = rng.integers(0, 2, (3000, 3), np.uint8) * np.uint8(255)
    for chain in CHAINS.values():
        assert abs(one_error(chain, noisy, pole)) < 0.2


def test_lines_come_in_one_shape_from_opencv_4_and_5() -> None:
    lines = np.arange(8, dtype=np.int32)
    for found in (lines.reshape(2, 1, 4), lines.reshape(2, 4)):
        assert panorama._lines(found).tolist() == [[0, 1, 2, 3], [4, 5, 6, 7]]
    assert panorama._lines(None).shape == (0, 4)


# --- bearings ---


@both_chains
@pytest.mark.parametrize(("zero_deg", "clockwise"), [(0.0, False), (90.0, True), (-37.0, False), (180.0, True)])
def test_the_bearing_is_that_of_the_pole_whatever_the_mounting(
    chain: Chain, zero_deg: float, clockwise: bool
) -> None:
    lens = Lens(zero_deg=zero_deg, clockwise=clockwise)
    errors = []
    for k in range(9):
        pole = Pole(-179.0 + 40.3 * k, distance=1.0 + 0.6 * k)
        errors.append(one_error(chain, jpeg(picture(lens, pole)), pole, lens))
    assert np.abs(errors).max() < 0.2
    assert np.sqrt(np.mean(np.square(errors))) < 0.1


def test_both_chains_give_the_same_bearing() -> None:
    rng = np.random.default_rng(8)
    for _ in range(25):
        pole = Pole(float(rng.uniform(-180, 180)), float(rng.uniform(0.8, 6.0)), float(rng.uniform(0.03, 0.08)))
        shot = jpeg(picture(LENS, pole))
        fast, paper = (one_error(chain, shot, pole) for chain in CHAINS.values())
        assert abs(fast - paper) < 0.15, pole


@both_chains
@pytest.mark.parametrize("bearing_deg", [-1.0, -0.3, 0.0, 0.2, 0.9, 179.8, 180.0])
def test_a_pole_on_the_panoramas_seam_is_one_pole(chain: Chain, bearing_deg: float) -> None:
    for zero_deg in (0.0, 180.0):
        lens = Lens(zero_deg=zero_deg)
        pole = Pole(bearing_deg, distance=1.5)
        assert abs(one_error(chain, jpeg(picture(lens, pole)), pole, lens)) < 0.2


@both_chains
def test_a_pole_cut_by_the_mirrors_rim_keeps_its_bearing(chain: Chain) -> None:
    lens = Lens(outer=150.0)
    pole = Pole(63.0, distance=1.2, top=2.0)
    assert abs(one_error(chain, jpeg(picture(lens, pole)), pole, lens)) < 0.2


def test_a_pole_cut_slantwise_by_the_pictures_border_keeps_its_bearing() -> None:
    lens = Lens(height=330, y_c=150.0, outer=232.0)
    pole = Pole(130.0, distance=0.8, radius=0.08, top=2.0)
    assert abs(one_error(radial.candidates, jpeg(picture(lens, pole)), pole, lens)) < 0.3


@both_chains
@pytest.mark.parametrize("gain", [0.35, 0.6, 1.3, 1.7])
def test_the_bearing_survives_dim_and_bright_light(chain: Chain, gain: float) -> None:
    pole = Pole(-100.0)
    shot = np.clip(picture(LENS, pole) * gain, 0, 255).astype(np.uint8)
    assert abs(one_error(chain, jpeg(shot), pole)) < 0.15


@both_chains
@pytest.mark.parametrize("quality", [20, 50, 95])
def test_the_bearing_survives_the_jpeg(chain: Chain, quality: int) -> None:
    pole = Pole(12.0, distance=4.0)
    assert abs(one_error(chain, jpeg(picture(LENS, pole), quality), pole)) < 0.25


@both_chains
def test_light_from_one_side_does_not_pull_the_middle_of_a_pole(chain: Chain) -> None:
    pole = Pole(40.0, distance=1.0, radius=0.06)
    shot = picture(LENS, pole).astype(float)
    y, x = np.mgrid[: LENS.height, : LENS.width]
    off = np.degrees(np.arctan2(x - LENS.x_c, y - LENS.y_c)) - 40.0
    shot *= np.clip(1.0 + 0.06 * off, 0.75, 1.25)[..., None]  # bright on its left, dim on its right
    assert abs(one_error(chain, shot.astype(np.uint8), pole)) < 0.25


@both_chains
def test_what_is_red_but_no_upright_line_is_not_a_candidate(chain: Chain) -> None:
    shot = picture(LENS)
    cv2.circle(shot, (420, 300), 14, (30, 30, 200), -1)  # a ball
    cv2.ellipse(shot, (318, 241), (150, 150), 0, 100, 170, (30, 30, 200), 6)  # a level stripe
    assert chain(shot, optics_of(LENS), Red()) == []


@both_chains
def test_no_red_is_no_candidate_and_nothing_but_red_is_none_either(chain: Chain) -> None:
    assert chain(picture(LENS), optics_of(LENS), Red()) == []
    assert chain(picture(LENS, Pole(50.0, colour=(150, 90, 40))), optics_of(LENS), Red()) == []  # blue
    flood = np.full((480, 640, 3), (0, 0, 255), np.uint8)
    assert chain(flood, optics_of(LENS), Red()) == []


@pytest.mark.parametrize("fine", [1, 2], ids=["jagged", "smooth"])
def test_the_variance_tells_how_good_the_bearings_are(fine: int) -> None:
    """Noise, blur and edges as of a cheap camera: the variance may be careful, never careless."""
    rng = np.random.default_rng(11)
    lens = Lens(fine=fine)
    share = []
    for _ in range(25):
        pole = Pole(float(rng.uniform(-180, 180)), float(rng.uniform(1.0, 7.0)))
        light = cv2.GaussianBlur(picture(lens, pole), (0, 0), 0.7) + rng.normal(0, 4, (480, 640, 3))
        shot = jpeg(np.clip(light, 0, 255).astype(np.uint8))
        (found,) = radial.candidates(shot, optics_of(lens), Red())
        error = math.radians(wrapped_deg(math.degrees(found.theta) - pole.bearing_deg))
        share.append(error**2 / found.variance)
    assert 0.02 < np.mean(share) < 1.0


def test_the_printed_geometry_works_where_centre_and_radius_are_as_the_print_supposes() -> None:
    lens = Lens(width=480, height=480, x_c=240.0, y_c=240.0, inner=1.0, outer=230.0)
    pole = Pole(33.0, distance=2.0)
    shot = jpeg(picture(lens, pole))
    (found,) = panorama.candidates(shot, optics_of(lens)._replace(inner=0.0), Red(), printed=True)
    assert abs(wrapped_deg(math.degrees(found.theta) - 33.0)) < 0.2
    # and not where y_c differs from x_c: the reason for the correction
    off = Detector(chain="printed", centre=(LENS.x_c, LENS.y_c), inner=0.0, outer=230.0)
    wrong = [math.degrees(c.theta) for c in off.find(jpeg(picture(LENS, pole))).candidates]
    assert all(abs(wrapped_deg(w - 33.0)) > 2.0 for w in wrong)


# --- a real photograph ---


def photo() -> Picture:
    folder = os.environ.get("LOCFUSE_DATA")
    if not folder:
        pytest.skip("LOCFUSE_DATA is not set: the real omni photograph is not at hand")
    return np.asarray(cv2.imread(str(Path(folder, "omni", "example.jpg"))), np.uint8)


def leaning_deg(unrolled: Picture) -> NDArray[np.float64]:
    """Angles from the vertical of long, roughly upright segments, found by OpenCV's own detector (LSD)."""
    grey = cv2.cvtColor(unrolled, cv2.COLOR_BGR2GRAY)[40:290]  # neither the robot nor the black corners
    ends = cv2.createLineSegmentDetector().detect(np.ascontiguousarray(grey))[0].reshape(-1, 4)
    dx, dy = (ends[:, 2:] - ends[:, :2]).T
    lean = (np.degrees(np.arctan2(dx, dy)) + 90.0) % 180.0 - 90.0
    return np.asarray(lean[(np.hypot(dx, dy) >= 50) & (np.abs(lean) < 25)], float)


def test_uprights_of_a_real_photograph_stand_upright_in_its_panorama() -> None:
    lean = leaning_deg(panorama.unwrap(photo(), PHOTO_OPTICS))
    assert len(lean) >= 20
    assert abs(np.median(lean)) < 0.5
    assert np.median(np.abs(lean)) < 1.0
    assert np.percentile(np.abs(lean), 85) < 2.0


@both_chains
def test_a_pole_painted_into_a_real_photograph_is_the_only_candidate(chain: Chain) -> None:
    shot = photo()
    for degrees in (100.0, -140.0, 171.0):
        painted = shot.copy()
        a = math.radians(degrees)
        ends = [(PHOTO_OPTICS.x_c + r * math.sin(a), PHOTO_OPTICS.y_c + r * math.cos(a)) for r in (330, 480)]
        (x1, y1), (x2, y2) = np.rint(np.array(ends) * 16).astype(int).tolist()
        cv2.line(painted, (x1, y1), (x2, y2), (45, 40, 190), 12, cv2.LINE_AA, shift=4)
        (found,) = chain(jpeg(painted), PHOTO_OPTICS, Red())
        assert abs(wrapped_deg(math.degrees(found.theta) - degrees)) < 0.1
