"""What ranges and detections of known points say of their map, held to drives whose answer is known."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from msgspec.structs import replace
from present import present
from rows import readings
from small_drive import drive, path, robot

from locfuse.fusion import se2
from locfuse.fusion.checks.clocks import differences
from locfuse.fusion.checks.finding import Finding
from locfuse.fusion.checks.points import of_points
from locfuse.fusion.data import Array, Drive
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.camera import CameraSettings
from locfuse.fusion.sensors.landmarks import LandmarksSettings
from locfuse.fusion.sensors.ranges import RangesSettings

PLACES = np.array([(0.5, 0.5), (7.0, 0.2), (7.5, 5.5), (0.2, 4.5)])
Places = Callable[[Array], Array]


def seen(
    sensor: str, told: Places, late: float = 0.0, scale: float = 1.0, longer: float = 0.0
) -> tuple[Drive, Robot]:
    """A drive with ranges to (or detections of) all points, and a robot whose map has them where `told` says."""
    rng, one = np.random.default_rng(5), drive(5, robot())
    t, pose = path(1.0)
    at = np.arange(1.0, t[-1] - 1.0, 0.25)
    now = np.stack([np.interp(at, t, c) for c in pose.T], axis=-1)
    away = PLACES[:, None] - now[None, :, :2]
    far = scale * np.hypot(*away.transpose(2, 0, 1)) + 0.02 * rng.normal(size=away.shape[:2])
    far[2] += longer
    bearing = np.arctan2(away[..., 1], away[..., 0]) - now[:, 2] + 0.01 * rng.normal(size=far.shape)
    z = far[..., None] if sensor == "ranges" else np.stack((se2.wrap_all(bearing), far), axis=-1)
    ids = np.repeat(np.arange(4.0), len(at)).reshape(4, -1)
    rows = z.transpose(1, 0, 2).reshape(-1, z.shape[-1]), ids.T.ravel()
    m = readings(np.repeat(at + late, 4), rows[0], 0.05, id=rows[1])
    places = {str(i): (x, y) for i, (x, y) in enumerate(told(PLACES).tolist())}
    settings = {"ranges": RangesSettings, "landmarks": LandmarksSettings}[sensor](map=places)
    return replace(one, measurements={sensor: m}), replace(robot(), sensors={sensor: settings})


def found(sensor: str, told: Places = lambda a: a, **faults: float) -> list[Finding]:
    """The findings on such a drive."""
    return of_points(*seen(sensor, told, **faults))


def turned(a: Array) -> Array:
    return se2.transform(np.array([1.0, -2.0, math.radians(30.0)]), a)


@pytest.mark.parametrize("sensor", ["ranges", "landmarks"])
def test_a_map_that_is_right_is_not_mentioned(sensor: str) -> None:
    one, settings = seen(sensor, lambda a: a + 0.03)
    assert of_points(one, settings) == []
    assert of_points(replace(one, truth=None), settings) == []
    grown = replace(settings.settings(sensor), map=None)
    assert of_points(one, replace(settings, sensors={sensor: grown})) == []


@pytest.mark.parametrize("sensor", ["ranges", "landmarks"])
@pytest.mark.parametrize(
    ("told", "words"),
    [
        (lambda a: a[[1, 0, 2, 3]], "ids are exchanged in the map, by the truth: 0 and 1"),
        (lambda a: a[[1, 2, 0, 3]], "0 stands where the map has 2, 1 stands where the map has 0"),
        (turned, "its map is turned by -30°"),
        (lambda a: a * [1.0, -1.0], "its map is mirrored (an axis has the other sign, or x and y are exchanged)"),
        (lambda a: a + np.outer([0.0, 1.0, 0.0, 0.0], [0.0, 0.6]), "id 1 stands at (7.0"),
        (lambda a: a * [[1.0, 1.0], [1.0, 1.3], [1.2, 1.0], [1.4, 1.6]], "by the truth id 2"),
    ],
)
def test_what_is_wrong_with_a_map_is_named(sensor: str, told: Places, words: str) -> None:
    (wrong,) = found(sensor, told)
    assert wrong.severe
    assert words in wrong.message
    assert wrong.fixes == ((f"{sensor}.ignore=[1]",) if words.startswith("id 1 ") else wrong.fixes)


def test_a_turned_detector_and_a_map_in_other_units_are_named() -> None:
    one, settings = seen("landmarks", lambda a: a)
    m = one.measurements["landmarks"]
    turned = replace(m, z=m.z - [math.radians(8.0), 0.3])  # and ranges with an offset, which the filter estimates
    (yaw,) = of_points(replace(one, measurements={"landmarks": turned}), settings)
    assert float(yaw.fixes[0].removeprefix("landmarks.yaw_deg=")) == pytest.approx(8.0, abs=0.5)
    assert of_points(replace(one, measurements={"landmarks": replace(m, z=m.z - [0.0, -0.3])}), settings) == []
    (size,) = found("landmarks", lambda a: 100.0 * a)
    assert size.message.startswith("by the truth its map is 100 times as large, turned by 0°")


def test_one_anchor_with_longer_ranges_and_ranges_of_another_scale_are_named() -> None:
    (longer,) = found("ranges", longer=0.5)
    assert longer.message == "by the truth the ranges of id 2 are 0.50 m longer than those of the others"
    assert longer.fixes == ("ranges.ignore=[2]",)
    one, settings = seen("ranges", lambda a: a)
    m = one.measurements["ranges"]
    assert of_points(replace(one, measurements={"ranges": replace(m, z=m.z + 0.4)}), settings) == []
    (scale,) = found("ranges", scale=1.1)
    assert float(scale.message.partition("ranges are ")[2].partition("%")[0]) == pytest.approx(10.0, abs=0.5)
    assert not scale.fixes


@pytest.mark.parametrize("sensor", ["ranges", "landmarks"])
def test_a_point_that_repeats_one_value_is_left_out(sensor: str) -> None:
    one, settings = seen(sensor, lambda a: a)
    m = one.measurements[sensor]
    z = np.where((m.extra["id"] == 3.0)[:, None], m.z[3], m.z)
    (same,) = of_points(replace(one, measurements={sensor: replace(m, z=z)}), settings)
    assert same.message.endswith("readings of id 3 are the same, while the robot drives")
    assert same.fixes == (f"{sensor}.ignore=[3]",)


@pytest.mark.parametrize("sensor", ["ranges", "landmarks"])
@pytest.mark.parametrize("late", [0.0, 0.5, 12.0])
def test_the_clock_of_ranges_and_landmarks_is_measured_by_the_truth(sensor: str, late: float) -> None:
    one, settings = seen(sensor, lambda a: a, late=late)
    lag = differences(one, settings)[sensor, "truth"]
    assert lag.offset == pytest.approx(-late, abs=max(0.03, 3.0 * lag.sigma))
    assert lag.sigma < (0.06 if late < 1.0 else 0.3)
    if sensor == "ranges":  # their antenna has no direction
        positions = replace(one, truth=replace(present(one.truth), theta=None))
        assert differences(positions, settings)[sensor, "truth"].offset == pytest.approx(-late, abs=0.1)


@pytest.mark.parametrize("late", [0.0, 0.2])
def test_the_clock_of_a_camera_is_measured_by_the_truth(late: float) -> None:
    """Its zero direction may be wrong by any angle."""
    one, settings = seen("landmarks", lambda a: a, late=late)
    m = one.measurements["landmarks"]
    first = m.extra["id"] == 0.0
    z: Array = se2.wrap_all(m.z[first, :1] + 0.7)
    pictures = replace(one, measurements={"camera": readings(np.unique(m.t), z, 0.01)})
    camera = replace(settings, sensors={"camera": CameraSettings(landmark=(0.5, 0.5))})
    assert differences(pictures, camera)["camera", "truth"].offset == pytest.approx(-late, abs=0.02)
