"""The two ways to find a red pole in an omni picture, held to printed equations, to a mirror and to each other."""

import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from msgspec.structs import replace
from numpy.typing import NDArray
from omni_scene import Lens, Picture, Pole, picture, wrapped_deg

from locfuse.fusion.camera import panorama
from locfuse.fusion.camera.detect import Detection, Detector, detect, radial_candidates
from locfuse.fusion.camera.images import coarse_size, decode, image_size
from locfuse.fusion.camera.optics import Optics, angle_of_bearing, bearing, omni_1, paper_omni_1
from locfuse.fusion.camera.panorama import Red, RedCandidate, cap, largest, red_grey, variance

Chain = Callable[[Picture, Optics, Red], list[RedCandidate]]
CHAINS: dict[str, Chain] = {"fast": radial_candidates, "paper": panorama.candidates}
both_chains = pytest.mark.parametrize("chain", CHAINS.values(), ids=CHAINS.keys())
LENS = Lens()
PHOTO_OPTICS = Optics(986.0, 546.0, 235.0, 600.0)


def optics_of(lens: Lens) -> Optics:
    zero = math.radians(lens.zero_deg)
    return Optics(lens.x_c, lens.y_c, lens.inner, lens.outer, 720, zero, lens.clockwise)


def one_error(chain: Chain, shot: Picture, pole: Pole, lens: Lens = LENS) -> float:
    """Error [deg] of the only candidate."""
    (found,) = chain(shot, optics_of(lens), Red())
    return wrapped_deg(math.degrees(float(bearing(np.asarray(found.theta), optics_of(lens)))) - pole.bearing_deg)


def jpeg(shot: Picture, quality: int = 80) -> Picture:
    _, data = cv2.imencode(".jpg", shot, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)


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


def test_a_pixel_is_red_by_its_excess_over_green_and_blue_and_by_its_share() -> None:
    rng = np.random.default_rng(3)
    shot = rng.integers(0, 256, (90, 110, 3), np.uint8)
    red = Red(ratio=0.45, minimum=37.0)
    b, g, r = shot.astype(float).transpose(2, 0, 1)
    excess = np.clip(r - np.maximum(b, g), 0, None)
    expected = np.where((excess >= np.rint(0.45 * r)) & (excess >= 37), excess, 0)
    np.testing.assert_array_equal(panorama.red_grey(shot, red), expected)


def test_lines_come_in_one_shape_from_opencv_4_and_5() -> None:
    lines = np.arange(8, dtype=np.int32)
    for found in (lines.reshape(2, 1, 4), lines.reshape(2, 4)):
        assert panorama._lines(found).tolist() == [[0, 1, 2, 3], [4, 5, 6, 7]]
    assert panorama._lines(None).shape == (0, 4)


def test_the_noise_filter_removes_single_pixels_and_keeps_a_pole() -> None:
    pole = Pole(35.0)
    shot = picture(LENS, pole)
    rng = np.random.default_rng(0)
    noisy = shot.copy()
    x, y = rng.integers(0, LENS.width, 3000), rng.integers(0, LENS.height, 3000)
    noisy[y, x] = rng.integers(0, 2, (3000, 3), np.uint8) * np.uint8(255)
    for chain in CHAINS.values():
        assert abs(one_error(chain, noisy, pole)) < 0.2


@both_chains
@pytest.mark.parametrize(("zero_deg", "clockwise"), [(0.0, False), (90.0, True), (-37.0, False), (180.0, True)])
def test_the_bearing_is_right_whatever_the_mounting(chain: Chain, zero_deg: float, clockwise: bool) -> None:
    lens = Lens(zero_deg=zero_deg, clockwise=clockwise)
    errors = []
    for k in range(9):
        pole = Pole(-179.0 + 40.3 * k, distance=1.0 + 0.6 * k)
        errors.append(one_error(chain, jpeg(picture(lens, pole)), pole, lens))
    assert np.abs(errors).max() < 0.2
    assert np.sqrt(np.mean(np.square(errors))) < 0.1


@both_chains
@pytest.mark.parametrize("bearing_deg", [-1.0, -0.3, 0.0, 0.2, 0.9, 179.8, 180.0])
def test_a_pole_on_the_panoramas_seam_is_one_pole(chain: Chain, bearing_deg: float) -> None:
    for zero_deg in (0.0, 180.0):
        lens = Lens(zero_deg=zero_deg)
        pole = Pole(bearing_deg, distance=1.5)
        assert abs(one_error(chain, jpeg(picture(lens, pole)), pole, lens)) < 0.2


NEAR = Pole(130.0, distance=0.8, radius=0.08, top=2.0)
CUT, RIM = Lens(height=330, y_c=150.0, outer=232.0), Lens(outer=150.0)


@both_chains
@pytest.mark.parametrize(
    ("lens", "pole", "gain", "quality", "most_deg"),
    [
        (RIM, Pole(63.0, distance=1.2, top=2.0), 1.0, 80, 0.2),  # cut by the mirror's rim
        (CUT, NEAR, 1.0, 80, 0.3),  # cut slantwise by the picture's border
        *((LENS, Pole(-100.0), gain, 80, 0.15) for gain in (0.35, 0.6, 1.3, 1.7)),  # dim and bright light
        *((LENS, Pole(12.0, distance=4.0), 1.0, quality, 0.25) for quality in (20, 50, 95)),
    ],
)
def test_the_bearing_survives_edges_light_and_jpeg(
    chain: Chain, lens: Lens, pole: Pole, gain: float, quality: int, most_deg: float
) -> None:
    if lens is CUT:  # the paper's chain sees nothing beyond the border
        chain = radial_candidates
    shot = np.clip(picture(lens, pole) * gain, 0, 255).astype(np.uint8)
    assert abs(one_error(chain, jpeg(shot, quality), pole, lens)) < most_deg


@both_chains
def test_light_from_one_side_does_not_pull_the_middle_of_a_pole(chain: Chain) -> None:
    pole = Pole(40.0, distance=1.0, radius=0.06)
    shot = picture(LENS, pole).astype(float)
    y, x = np.mgrid[: LENS.height, : LENS.width]
    off = np.degrees(np.arctan2(x - LENS.x_c, y - LENS.y_c)) - 40.0
    shot *= np.clip(1.0 + 0.06 * off, 0.75, 1.25)[..., None]  # bright on its left, dim on its right
    assert abs(one_error(chain, shot.astype(np.uint8), pole)) < 0.25


@both_chains
def test_what_is_not_red_all_red_or_no_upright_line_is_no_candidate(chain: Chain) -> None:
    shot = picture(LENS)
    cv2.circle(shot, (420, 300), 14, (30, 30, 200), -1)  # a ball
    cv2.ellipse(shot, (318, 241), (150, 150), 0, 100, 170, (30, 30, 200), 6)  # a level stripe
    assert chain(shot, optics_of(LENS), Red()) == []
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
        (found,) = radial_candidates(shot, optics_of(lens), Red())
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


# --- red things in a picture: the fast way agrees with OpenCV's median of the whole picture

GAP_PX = 2.0
RED = Red(length=4.0)


def bars(seed: int, things: int, noise: float, shape: tuple[int, int], optics: Optics) -> NDArray[np.uint8]:
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


def by_arrays(shot: NDArray[np.uint8], optics: Optics, red: Red) -> list[RedCandidate]:
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
        found.append(RedCandidate(middle, variance(middle, radius, length, width), len(p), length, width, radius))
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
    shot = bars(seed, things, noise, (h, w), optics)
    found = radial_candidates(shot, optics, RED)
    other = by_arrays(shot, optics, RED)
    assert len(found) == len(other)
    here, there = np.array(found).reshape(-1, 6), np.array(other).reshape(-1, 6)
    turns = np.round((here[:, 0] - there[:, 0]) / math.tau)  # straight ahead: 0 or 2 pi by rounding
    here[:, 0] -= math.tau * turns
    np.testing.assert_allclose(here, there, rtol=1e-9, atol=1e-15)


def test_a_thing_across_the_angle_pi_is_one() -> None:
    optics = Optics(39.5, 29.5, 5.0, 29.0)
    shot = np.full((60, 80, 3), 100, np.uint8)
    shot[5:20, 38:42] = (0, 0, 200)  # straight up: from -pi to pi
    (found,) = radial_candidates(shot, optics, RED)
    assert abs(found.theta - math.pi) < 1e-9
    assert found.pixels == 60 - 4  # the corners are no median of their neighbours


# --- pictures at half size: only where the JPEG holds no more colour, and then the bearing stays what it was

BEARINGS_DEG = np.arange(-175.0, 180.0, 22.3)


def coded(shot: NDArray[Any], sampling: int = cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420, progressive: int = 0) -> bytes:
    options = [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, sampling, cv2.IMWRITE_JPEG_PROGRESSIVE, progressive]
    return bytes(cv2.imencode(".jpg", shot, options)[1].tobytes())


def detector_of(lens: Lens) -> Detector:
    mounted: dict[str, Any] = {"zero": math.radians(lens.zero_deg), "clockwise": lens.clockwise}
    return Detector(centre=(lens.x_c, lens.y_c), inner=lens.inner, outer=lens.outer, **mounted)


def whole(data: bytes, detector: Detector) -> Detection:
    shot = decode((data, "jpeg"))
    assert not isinstance(shot, str)
    return detector.find(shot)


def seen(data: bytes, detector: Detector) -> Detection:
    found = detect((data, "jpeg"), detector)
    assert not isinstance(found, str)
    return found


@pytest.mark.parametrize(
    ("sampling", "coarse"),
    [
        (cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420, True),
        (cv2.IMWRITE_JPEG_SAMPLING_FACTOR_422, True),
        (cv2.IMWRITE_JPEG_SAMPLING_FACTOR_411, True),
        (cv2.IMWRITE_JPEG_SAMPLING_FACTOR_440, False),  # half as high only: the columns are all there
        (cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444, False),
    ],
)
def test_coarse_colour_is_read_from_the_frame_header(sampling: int, coarse: bool) -> None:
    shot = picture(LENS, Pole(20.0))
    for progressive in (0, 1):
        data = coded(shot, sampling, progressive)
        assert (coarse_size((data, "jpeg")) is not None) is coarse
        assert image_size(memoryview(data)) == (LENS.width, LENS.height)


def test_what_is_no_colour_jpeg_has_no_coarse_colour() -> None:
    shot = picture(LENS, Pole(20.0))
    data = coded(shot)
    grey, png = coded(shot[..., 0]), bytes(cv2.imencode(".png", shot)[1].tobytes())
    for other in (grey, png, b"", b"\xff\xd8", *(data[:end] for end in range(0, 200, 7))):
        assert coarse_size((other, "jpeg")) is None  # nor has what was cut short
    assert coarse_size((shot.tobytes(), LENS.width, LENS.height, "bgr8", 3 * LENS.width)) is None


@pytest.mark.parametrize("lens", [LENS, replace(LENS, x_c=319.0, y_c=240.0, width=641, clockwise=True)])
def test_the_bearing_is_that_of_the_whole_picture_and_right(lens: Lens) -> None:
    detector, apart, errors = detector_of(lens), [], []
    for angle in BEARINGS_DEG.tolist():
        data = coded(picture(lens, Pole(angle)))
        (a,), (b,) = whole(data, detector).candidates, seen(data, detector).candidates
        sign = -1.0 if lens.clockwise else 1.0
        apart.append(wrapped_deg(math.degrees(a.theta - b.theta)))
        errors.append(wrapped_deg(sign * math.degrees(b.theta) - angle) / math.degrees(b.variance**0.5))
        # nothing else changes by more than the edges' pixels
        assert b.length == pytest.approx(a.length, abs=4.0)
        assert b.radius == pytest.approx(a.radius, abs=2.0)
        assert b.pixels == pytest.approx(a.pixels, rel=0.25)
        assert b.width == pytest.approx(a.width, rel=0.25)
    assert np.sqrt(np.mean(np.square(apart))) < 0.05  # deg
    assert np.abs(errors).max() < 3.0  # of its own sigma


def test_a_jpeg_with_all_its_colour_is_looked_at_whole_and_its_size_is_reported() -> None:
    data, detector = coded(picture(LENS, Pole(77.0)), cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444), detector_of(LENS)
    assert seen(data, detector) == whole(data, detector)
    lens = replace(LENS, width=641, height=479)  # odd: half of it is rounded up
    found = seen(coded(picture(lens, Pole(10.0))), detector_of(lens))
    assert found.shape == (479, 641)
    assert found.optics == detector_of(lens).optics((479, 641))
