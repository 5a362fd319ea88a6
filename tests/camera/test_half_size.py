"""Pictures at half size: only where the JPEG holds no more colour, and then the bearing stays what it was."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
import pytest
from msgspec.structs import replace
from numpy.typing import NDArray
from omni_scene import Lens, Pole, picture, wrapped_deg

from locfuse.fusion.camera.detect import MIN_HALF_RADIUS_PX, Detection, Detector, detect
from locfuse.fusion.camera.images import coarse_size, decode, image_size

LENS = Lens()
BEARINGS_DEG = np.arange(-175.0, 180.0, 22.3)


def coded(shot: NDArray[Any], sampling: int = cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420, progressive: int = 0) -> bytes:
    options = [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, sampling, cv2.IMWRITE_JPEG_PROGRESSIVE, progressive]
    return bytes(cv2.imencode(".jpg", shot, options)[1].tobytes())


def detector_of(lens: Lens) -> Detector:
    return Detector(
        centre=(lens.x_c, lens.y_c),
        inner=lens.inner,
        outer=lens.outer,
        zero=math.radians(lens.zero_deg),
        clockwise=lens.clockwise,
    )


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
    for bearing in BEARINGS_DEG:
        data = coded(picture(lens, Pole(float(bearing))))
        (a,), (b,) = whole(data, detector).candidates, seen(data, detector).candidates
        sign = -1.0 if lens.clockwise else 1.0
        apart.append(wrapped_deg(math.degrees(a.theta - b.theta)))
        errors.append(wrapped_deg(sign * math.degrees(b.theta) - float(bearing)) / math.degrees(b.variance**0.5))
        # nothing else changes by more than the edges' pixels
        assert b.length == pytest.approx(a.length, abs=4.0)
        assert b.radius == pytest.approx(a.radius, abs=2.0)
        assert b.pixels == pytest.approx(a.pixels, rel=0.25)
        assert b.width == pytest.approx(a.width, rel=0.25)
    assert np.sqrt(np.mean(np.square(apart))) < 0.05  # deg
    assert np.abs(errors).max() < 3.0  # of its own sigma


def test_half_is_for_the_fast_chain_on_mirrors_that_are_large_enough() -> None:
    shape = (LENS.height, LENS.width)
    assert detector_of(LENS).is_half_enough(shape)
    assert not replace(detector_of(LENS), chain="paper").is_half_enough(shape)
    assert not replace(detector_of(LENS), outer=MIN_HALF_RADIUS_PX - 1.0).is_half_enough(shape)


def test_a_jpeg_with_all_its_colour_is_looked_at_whole() -> None:
    data, detector = coded(picture(LENS, Pole(77.0)), cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444), detector_of(LENS)
    assert seen(data, detector) == whole(data, detector)


def test_the_size_that_is_reported_is_that_of_the_whole_picture() -> None:
    lens = replace(LENS, width=641, height=479)  # odd: half of it is rounded up
    found = seen(coded(picture(lens, Pole(10.0))), detector_of(lens))
    assert found.shape == (479, 641)
    assert found.optics == detector_of(lens).optics((479, 641))
