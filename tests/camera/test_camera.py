"""The camera as a sensor: pictures to bearings with every refusal counted, and bearings against the belief."""

import math
import os
import struct
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray
from omni_scene import Lens, Picture, Pole, picture, wrapped_deg
from present import present
from rows import one_by_one, said

import locfuse as api
from locfuse.formats.whole_files import write_results
from locfuse.fusion.camera import detect, images
from locfuse.fusion.camera.images import image_size
from locfuse.fusion.camera.opencv import listened, reports_damage
from locfuse.fusion.checks.preview import preview
from locfuse.fusion.data import VERDICTS, ArrayStream, LocfuseError, Measurements
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.se2 import sight, wrap, wrap_all
from locfuse.fusion.sensors.camera import Camera, CameraSettings

LENS = Lens()
RIMS: dict[str, Any] = {"centre": (LENS.x_c, LENS.y_c), "inner": LENS.inner, "outer": LENS.outer}
SETTINGS = CameraSettings(landmark=(4.0, 1.0), sigma_deg=0.2, **RIMS)
POSES = [(0.0, 0.0, 0.0), (3.0, 2.0, 1.0), (4.0, 3.0, -math.pi / 2), (9.0, 1.0, math.pi)]
POSES += [(4.2, 1.1, -3.0), (3.7, 1.0, 40.0)]
NO_WHEELS: Any = None  # the camera asks nothing of them
MOUNTS = [((0.0, 0.0), 0.0), ((0.1, -0.05), 0.4), ((-0.3, 0.2), 3.1)]


@pytest.mark.parametrize(("gap_px", "objects"), [(1.9, 1), (2.1, 2)])
def test_red_pixels_are_one_object_up_to_a_gap_of_two_pixels(gap_px: float, objects: int) -> None:
    """Along the circle, at any radius; also where the angle wraps."""
    for begin in (0.5, math.pi - 0.03):
        for radius in (50.0, 200.0):
            theta = wrap_all(begin + np.array([0.0, 1.0, 2.0, 2.0 + gap_px, 3.0 + gap_px]) / radius)
            pixels = np.stack((theta, np.full(5, radius), np.ones(5), np.zeros(5)))
            assert len(detect._objects(pixels)) == objects


def coded(shot: NDArray[Any], ending: str = ".jpg") -> bytes:
    return bytes(cv2.imencode(ending, shot)[1].tobytes())


def compressed(*data: bytes, layout: str = "jpeg") -> Any:
    t_ns = 10**18 + np.arange(len(data)) * 10**8
    columns: dict[str, Any] = {"data": list(data), "format": [layout] * len(data)}
    return ArrayStream("/omni", "sensor_msgs/msg/CompressedImage", t_ns, columns)


def raw(shot: Picture, encoding: str, pad: int = 0, short: int = 0) -> Any:
    height, width = shot.shape[:2]
    rows = np.pad(shot.reshape(height, -1), ((0, 0), (0, pad)), constant_values=77)
    data = rows.tobytes()
    numbers = {"width": width, "height": height, "step": rows.shape[1]}
    columns: dict[str, Any] = {name: np.array([value], np.uint32) for name, value in numbers.items()}
    columns |= {"data": [memoryview(data)[: len(data) - short]], "encoding": [encoding]}
    return ArrayStream("/omni", "sensor_msgs/msg/Image", np.array([10**18]), columns)


def measured(stream: Any, settings: CameraSettings = SETTINGS) -> Measurements:
    return Camera().measure(stream, settings, NO_WHEELS, 10**18)


def errors_deg(m: Measurements, *bearings: float) -> list[float]:
    return [wrapped_deg(math.degrees(z) - b) for z, b in zip(m.z[:, 0], bearings, strict=True)]


def test_every_picture_is_a_reading_with_one_row_per_candidate() -> None:
    shots = (picture(LENS), picture(LENS, Pole(30.0)), picture(LENS, Pole(80.0, 4.0), Pole(-20.0, 1.2)))
    pictures = compressed(*map(coded, shots))
    foxglove = measured(ArrayStream("/omni", "foxglove.CompressedImage", pictures.t_ns, pictures.data))
    m = measured(pictures, msgspec.structs.replace(SETTINGS, time_offset=-0.5))
    assert m.first.tolist() == [0, 0, 1, 3]
    assert m.absent == 1  # the hidden landmark
    np.testing.assert_allclose(m.t, (-0.5, -0.4, -0.3), atol=1e-9)
    np.testing.assert_allclose(errors_deg(m, 30.0, -20.0, 80.0), 0.0, atol=0.15)
    np.testing.assert_array_equal(foxglove.z, m.z)
    assert m.dropped == {}
    sigma = np.degrees(np.sqrt(m.R[:, 0, 0]))
    assert ((sigma > 0.2) & (sigma < 0.4)).all()
    assert (m.extra["rest"] > 0.0).all()  # what the settings say, and what the pixels add
    np.testing.assert_allclose(m.R[:, 0, 0], math.radians(0.2) ** 2 + m.extra["rest"])


@pytest.mark.parametrize("chain", ["fast", "paper"])
@pytest.mark.parametrize(
    "changes",
    [
        {"time_offset": 0.25},
        {"clockwise": True, "zero_deg": 20.0},
        {"sigma_deg": 0.9, "x": 0.3, "gate": 0.9},
        {"bearing": "absolute"},
    ],
)
def test_no_picture_is_looked_at_again_for_what_it_does_not_show(chain: Any, changes: dict[str, Any]) -> None:
    """A clock, a direction, a sigma, a mount: the same measurements to the bit as from the pictures."""
    stream = compressed(*map(coded, (picture(LENS), picture(LENS, Pole(30.0), Pole(-80.0, 2.0)))), b"no picture")
    settings = msgspec.structs.replace(SETTINGS, chain=chain)
    other = msgspec.structs.replace(settings, **changes)
    again, fresh = Camera().again(measured(stream, settings), other, 10**18), measured(stream, other)
    assert again is not None
    assert again.dropped == fresh.dropped == {"unreadable": 1}
    for name in ("t", "first", "z", "R"):
        np.testing.assert_array_equal(getattr(again, name), getattr(fresh, name))
    for name, column in fresh.extra.items():
        np.testing.assert_array_equal(again.extra[name], column)


@pytest.mark.parametrize(
    "changes", [{"red_ratio": 0.5}, {"centre": (LENS.x_c + 2.0, LENS.y_c)}, {"swapped": True}, {"landmark": None}]
)
def test_what_changes_how_a_picture_is_seen_needs_the_pictures_again(changes: dict[str, Any]) -> None:
    before = measured(compressed(coded(picture(LENS, Pole(30.0)))))
    assert Camera().again(before, msgspec.structs.replace(SETTINGS, **changes), 10**18) is None


@pytest.mark.parametrize("chain", ["fast", "paper"])
def test_a_png_a_raw_picture_and_a_swapped_jpeg_give_the_same_bearing(chain: Any) -> None:
    settings = msgspec.structs.replace(SETTINGS, chain=chain)
    shot = picture(LENS, Pole(-130.0))
    rgb, one = shot[..., ::-1], np.full((480, 640, 1), 255, np.uint8)
    streams = [
        compressed(coded(shot, ".png"), layout="png"),
        compressed(coded(shot, ".png"), layout="bgr8; png compressed bgr8"),
        compressed(coded(rgb, ".png"), layout="rgb8; png compressed rgb8"),
        raw(shot, "bgr8"),
        raw(rgb, "rgb8", pad=11),
        raw(np.dstack((shot, one)), "bgra8", pad=4),
        raw(np.dstack((rgb, one)), "rgba8"),
    ]
    found = [measured(stream, settings).z for stream in streams]
    for z in found:
        np.testing.assert_array_equal(z, found[0])


def test_a_pictures_size_is_read_from_its_header() -> None:
    shot = np.zeros((37, 91, 3), np.uint8)
    progressive = cv2.imencode(".jpg", shot, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes()
    for data in (coded(shot), coded(shot, ".png"), progressive):
        assert image_size(memoryview(data)) == (91, 37)
        for end in range(len(data) - 12):
            assert image_size(memoryview(data[:end])) is None  # truncated
    thumbnail = b"\xff\xe1" + struct.pack(">H", 2 + 40) + coded(np.zeros((8, 8, 3), np.uint8))[:40]
    assert image_size(memoryview(coded(shot)[:2] + thumbnail + coded(shot)[2:])) == (91, 37)
    for other in (coded(shot, ".bmp"), b"", b"\xff\xd8" + b"\xff" * 50, b"\xff\xd8\xff\xe0\x00\x00"):
        assert image_size(memoryview(other)) is None


def test_what_is_no_picture_is_dropped_and_counted_by_reason(capfd: pytest.CaptureFixture[str]) -> None:
    shot = picture(LENS, Pole(30.0))
    good, grey = coded(shot), coded(shot[..., 1])
    at = good.index(b"\xff\xc0") + 5
    bomb = good[:at] + struct.pack(">HH", 20000, 20000) + good[at + 4 :]  # it claims 20000 x 20000 pixels
    m = measured(compressed(good, b"", good[: len(good) // 2], b"no picture at all", bomb, grey, good))
    assert m.dropped == {"unreadable": 3, "too_large": 1, "no_colour": 1}
    assert capfd.readouterr().err == ""  # OpenCV's decoders have nothing to say beside
    assert len(m.t) == 2
    np.testing.assert_allclose(m.t, (0.0, 0.6), atol=1e-9)


@pytest.mark.parametrize(
    ("encoding", "short", "reason"),
    [("mono8", 0, "no_colour"), ("bayer_rggb8", 0, "unknown_encoding"), ("bgr8", 1, "too_short")],
)
def test_a_raw_picture_that_cannot_be_used_is_refused(encoding: str, short: int, reason: str) -> None:
    shot = picture(LENS, Pole(30.0))
    m = measured(raw(shot[..., 0] if encoding != "bgr8" else shot, encoding, short=short))
    assert (m.dropped, len(m.t), m.z.shape, m.R.shape) == ({reason: 1}, 0, (0, 1), (0, 1, 1))


@pytest.mark.parametrize(
    ("width", "height", "step"), [(0, 480, 1920), (640, 480, 0), (2**31, 2**31, 4), (640, 480, 9)]
)
def test_a_raw_pictures_header_is_not_believed(width: int, height: int, step: int) -> None:
    stream = raw(picture(LENS), "bgr8")
    lie = {"width": np.array([width]), "height": np.array([height]), "step": np.array([step])}
    m = measured(ArrayStream("/omni", stream.msgtype, stream.t_ns, {**stream.data, **lie}))
    assert sum(m.dropped.values()) == 1


def test_pictures_of_another_size_have_another_calibration_and_are_not_used() -> None:
    shot = picture(LENS, Pole(30.0))
    small = cv2.resize(shot, (320, 240))
    m = measured(compressed(coded(small), coded(shot), coded(shot), coded(small), coded(shot)))
    assert m.dropped == {"other_size": 2}
    np.testing.assert_allclose(m.t, (0.1, 0.2, 0.4), atol=1e-9)
    np.testing.assert_allclose(errors_deg(m, 30.0, 30.0, 30.0), 0.0, atol=0.15)


def test_without_a_landmark_the_error_names_the_key_and_the_command() -> None:
    with pytest.raises(LocfuseError, match=r"camera\.landmark.*locfuse info LOG --preview DIR"):
        measured(compressed(b""), CameraSettings())
    with pytest.raises(LocfuseError, match=r"camera\.landmark"):
        Camera().model(CameraSettings())


@pytest.mark.parametrize(
    ("table", "word"),
    [
        ({"inner": 100.0, "outer": 80.0}, "outer"),
        ({"inner": -1.0}, "inner"),
        ({"outer": 1e9}, "at most"),
        ({"width": 3}, "width"),
        ({"width": 10**7}, "width"),
        ({"sigma_deg": 0.0}, "sigma_deg"),
        ({"landmark": [math.nan, 0.0]}, "finite"),
        ({"chain": "quick"}, "quick"),
        ({"centr": [1.0, 2.0]}, "centr"),
    ],
)
def test_impossible_settings_are_refused_where_the_table_is_read(table: dict[str, Any], word: str) -> None:
    with pytest.raises(msgspec.ValidationError, match=word):
        msgspec.convert(table, CameraSettings)


def test_the_camera_page_explains_every_key_with_its_default() -> None:
    page = (Path(__file__).parents[2] / "docs" / "camera.md").read_text()
    rows = [line for line in page.splitlines() if line.startswith("| `")]
    for field in msgspec.structs.fields(CameraSettings):
        (row,) = [r for r in rows if f"`{field.name}`" in r.split("|")[1]]
        if isinstance(field.default, float | str) and field.name not in {"x", "y", "yaw_deg"}:
            shown = f"{field.default:g}" if isinstance(field.default, float) else field.default
            assert row.split("|")[2].strip(" `") == shown, field.name


@pytest.mark.parametrize(("lever", "yaw"), MOUNTS)
def test_the_bearing_is_the_landmark_seen_from_the_cameras_frame(lever: tuple[float, float], yaw: float) -> None:
    for x, y, theta in POSES:
        to_map = np.array([[math.cos(theta), -math.sin(theta)], [math.sin(theta), math.cos(theta)]])
        eye = np.array([x, y]) + to_map @ np.array(lever)
        turn = theta + yaw
        to_camera = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
        seen = to_camera @ (np.array([4.0, 1.0]) - eye)
        predicted = present(sight((x, y, theta), (4.0, 1.0), (*lever, yaw), 0.05))
        assert wrap(predicted[0] - math.atan2(seen[1], seen[0])) == pytest.approx(0.0, abs=1e-12)


def readings(*pictures: tuple[float, ...], sigma: float = 0.005) -> Measurements:
    z = np.array([b for p in pictures for b in p], np.float64).reshape(-1, 1)
    first = np.concatenate(([0], np.cumsum([len(p) for p in pictures], dtype=np.int64)))
    ones = np.ones((len(z), 1, 1))
    return Measurements(np.arange(len(pictures)) * np.float64(0.1), first, z, ones, sigma, np.zeros((1, 1)))


def belief(x: float, y: float, theta: float, sigma_xy: float = 0.02, sigma_theta: float = 0.02) -> JointBelief:
    return JointBelief((x, y, theta), (sigma_xy**2, 0.0, 0.0, sigma_xy**2, 0.0, sigma_theta**2))


@pytest.mark.parametrize(
    "expected",
    [
        {0.9: "unmatched", 0.01: "accepted"},  # the landmark, and a wrong red thing
        {0.01: "accepted"},
        {0.9: "gate"},  # a wrong red thing alone
        {0.9: "gate", -1.2: "unmatched"},
        {0.02: "ambiguous", -0.015: "ambiguous", 2.0: "unmatched"},  # two that fit: neither is used
        {},
    ],
)
def test_the_gate_tells_the_landmark_from_wrong_red_things(expected: dict[float, str]) -> None:
    """Of one picture, seen from the origin; the landmark stands at (4, 0)."""
    model, bearings = Camera().model(CameraSettings(landmark=(4.0, 0.0))), tuple(expected)
    seen = one_by_one(model.innovations(readings(bearings), 0, belief(0.0, 0.0, 0.0)))
    assert {bearings[s.row]: VERDICTS[s.verdict] for s in seen} == expected


def test_the_innovation_is_wrapped_and_inside_the_landmark_there_is_none() -> None:
    model = Camera().model(CameraSettings(landmark=(4.0, 0.0)))
    (seen,) = one_by_one(model.innovations(readings((math.pi - 0.001,)), 0, belief(8.0, 0.0, 0.002)))
    assert seen.y[0] == pytest.approx(0.001)  # pi - 0.001 against -pi + ... : behind, slightly left
    assert VERDICTS[seen.verdict] == "accepted"
    model = Camera().model(CameraSettings(landmark=(4.0, 0.0), x=0.1))
    assert model.innovations(readings((0.0,)), 0, belief(3.9, 0.01, 0.0)) == []


@pytest.mark.parametrize("distance", [0.15, 0.4, 2.0])
def test_near_the_landmark_the_innovation_is_as_large_as_predicted(distance: float) -> None:
    """Bearings of poses drawn from the belief: mean NIS 1 far away, not above it where h(x) bends."""
    rng = np.random.default_rng(2)
    sigma_xy, sigma_theta, noise = 0.04, 0.02, 0.005
    now = belief(4.0 - distance, 0.0, 0.0, sigma_xy, sigma_theta)
    model = Camera().model(CameraSettings(landmark=(4.0, 0.0), gate=1.0))
    off = rng.normal(size=(4000, 3)) * (sigma_xy, sigma_xy, sigma_theta)
    true = np.arctan2(-off[:, 1], distance - off[:, 0]) - off[:, 2] + noise * rng.normal(size=4000)
    m = readings(*((z,) for z in wrap_all(true).tolist()), sigma=noise)
    nis = [one_by_one(model.innovations(m, i, now))[0].nis for i in range(4000)]
    assert 0.85 < np.mean(nis) < 1.12
    if distance == 2.0:
        assert np.mean(nis) > 0.95


def test_the_papers_orientation_is_the_landmarks_first_direction_minus_its_bearing() -> None:
    settings = CameraSettings(landmark=(3.0, 4.0), bearing="absolute", yaw_deg=10.0, gate=1.0)
    model = Camera().model(settings)
    m = readings((0.2,), (0.1, 2.0), ())
    gamma = [math.atan2(4.0 + 1.5, 3.0 - 0.5) - (z + math.radians(10.0)) for z in (0.2, 0.1)]
    there, here = belief(0.5, -1.5, 0.5), belief(1.0, 1.0, 0.6)
    (first,) = one_by_one(model.innovations(m, 0, there))
    (second,) = one_by_one(model.innovations(m, 1, here))  # the robot has moved: the print does not know
    assert first.y[0] == pytest.approx(gamma[0] - 0.5)
    assert second.y[0] == pytest.approx(gamma[1] - 0.6)
    assert said(first, there).H.tolist() == said(second, here).H.tolist() == [[0.0, 0.0, 1.0]]  # eq. 13
    assert model.innovations(m, 2, belief(0.0, 0.0, 0.5)) == []


def test_a_preview_shows_pictures_evenly_spread_with_what_was_found(tmp_path: Path) -> None:
    shots = [coded(picture(LENS, Pole(10.0 * k)), ".png") for k in range(7)]
    shown = preview(compressed(*shots, layout="png"), SETTINGS, count=3)
    assert [p.row for p in shown] == [0, 3, 6]
    for p in shown:
        np.testing.assert_allclose(p.bearings_deg, (10.0 * p.row,), atol=0.15)
        np.testing.assert_array_equal(p.raw, picture(LENS, Pole(10.0 * p.row)))
        assert set(np.unique(p.mask)) == {0, 255}
        assert p.panorama.shape == (173, 720, 3)
        assert (p.detection != p.raw).any()
    (plain,) = preview(compressed(coded(picture(LENS))), CameraSettings(), count=4)  # no landmark, no calibration
    assert plain.row == 0
    files = shown[1].named()
    assert list(files) == [f"000003-{k}.png" for k in ("raw", "mask", "panorama", "detection")]
    write_results(tmp_path / "a" / "b", files)
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "a" / "b" / "000003-raw.png")), shown[1].raw)
    assert sorted(p.name for p in (tmp_path / "a" / "b").iterdir()) == sorted(files)


def in_fresh_python(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.strip()


def test_opencv_is_imported_only_for_a_picture_and_with_its_pixel_cap() -> None:
    modules = "sys, locfuse.fusion.sensors.registry, locfuse.fusion.fuse, locfuse.fusion.measure"
    assert in_fresh_python(f"import {modules}; print('cv2' in sys.modules)") == "False"
    cap = "os.environ['OPENCV_IO_MAX_IMAGE_PIXELS'] == str(MAX_MAP_PIXELS)"
    code = "from locfuse.fusion.camera.opencv import MAX_MAP_PIXELS, cv2; import os"
    assert in_fresh_python(f"{code}; print({cap}, cv2.getNumThreads())") == "True 1"


@pytest.mark.parametrize("name", ["rounded_rectangle", "rounded_triangle"])
def test_bearings_of_the_clean_sample_logs_are_within_a_fifth_of_a_degree_of_the_truth(name: str) -> None:
    fast, paper = (sample_errors_deg(name, chain) for chain in ("fast", "paper"))
    assert np.sqrt(np.mean(fast**2)) < 0.2
    assert np.abs(fast).max() < 1.0  # no gross error
    assert np.abs(fast - paper).max() < 0.25  # the fast chain looks at half the size: the colour has no more


def sample_errors_deg(name: str, chain: str) -> NDArray[np.float64]:
    """Error of the bearing in every picture of a shipped log, by the simulator's truth, [deg]."""
    drive = api.load(name, sets={"camera.chain": chain}).drive
    m, truth = drive.measurements["camera"], drive.truth
    assert truth is not None
    assert (np.diff(m.first) == 1).all()
    x, y, theta = (np.interp(m.t, truth.t, c) for c in (*truth.xy.T, np.unwrap(present(truth.theta))))
    eye_x, eye_y = x + 0.1 * np.cos(theta), y + 0.1 * np.sin(theta)  # as the scenarios have it
    direction = np.arctan2(5.5 - eye_y, 7.9 - eye_x)
    return np.asarray(np.degrees(wrap_all(m.z[:, 0] - (direction - theta))), float)


# --- what libjpeg says of damage reaches us and not the terminal

GREEN = np.full((200, 300, 3), (40, 160, 60), np.uint8)


def jpeg(seed: int = 0) -> bytes:
    noise = np.random.default_rng(seed).integers(0, 40, GREEN.shape, np.uint8)
    return bytes(cv2.imencode(".jpg", GREEN + noise)[1])


def dented(data: bytes) -> bytes:
    middle = len(data) // 2
    return data[:middle] + data[middle + 40 :]


def cut(data: bytes) -> bytes:
    return data[: len(data) // 2] + b"\xff\xd9"


@pytest.mark.parametrize("damage", [dented, cut])
def test_a_damaged_picture_is_not_whole_and_the_terminal_stays_quiet(
    damage: Callable[[bytes], bytes], capfd: pytest.CaptureFixture[str]
) -> None:
    assert images.compressed(damage(jpeg()), "jpeg") == images.NOT_WHOLE
    assert capfd.readouterr().err == ""


def test_bytes_behind_the_picture_are_no_damage_and_only_words_about_it_count(
    capfd: pytest.CaptureFixture[str],
) -> None:
    """Some cameras pad the data in front of the end mark."""
    whole = jpeg()
    padded = whole[:-2] + b"\x00\x01\x02" + whole[-2:]
    found = images.compressed(padded, "jpeg")
    assert not isinstance(found, str)
    np.testing.assert_array_equal(found, images.compressed(whole, "jpeg"))
    assert capfd.readouterr().err == ""
    assert reports_damage(b"Corrupt JPEG data: premature end of data segment\n")
    assert not reports_damage(b"Corrupt JPEG data: 3 extraneous bytes before marker 0xd9\n")
    assert reports_damage(b"Corrupt JPEG data: 900 extraneous bytes before marker 0xd9\n")
    assert not reports_damage(b"some other thread's words\n")


def test_in_many_threads_the_damaged_one_is_found_and_no_other() -> None:
    """Cut in two, so that libjpeg hears of each; some dents it steps over in silence."""
    pictures = [cut(jpeg(i)) if i % 7 == 3 else jpeg(i) for i in range(60)]
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda data: images.compressed(data, "jpeg"), pictures))
    bad = [i for i, one in enumerate(found) if isinstance(one, str)]
    assert bad == [i for i in range(60) if i % 7 == 3]


def test_stderr_is_where_it_was_after_an_error(capfd: pytest.CaptureFixture[str]) -> None:
    def fails() -> None:
        os.write(2, b"a library's words\n")
        raise ValueError("no picture")

    with pytest.raises(ValueError, match="no picture"):
        listened(fails)
    os.write(2, b"ours\n")
    assert capfd.readouterr().err == "ours\n"
