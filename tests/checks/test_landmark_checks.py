"""What detections of landmarks say of their own convention, held to drives whose answer is known."""

import math

import numpy as np
import pytest
from msgspec.structs import replace
from rows import readings
from small_drive import drive, path, robot

from locfuse.fusion import se2
from locfuse.fusion.checks.finding import Finding
from locfuse.fusion.checks.landmarks import of_landmarks
from locfuse.fusion.data import Array
from locfuse.fusion.sensors.landmarks import LandmarksSettings

PLACES = np.array([(0.5, 0.5), (7.5, 0.5), (7.5, 5.5), (0.5, 5.5), (4.0, 3.0), (4.0, 0.2)])
AHEAD = 0.2  # m of the detector on the robot


def found(
    scale: float = 1.0, sign: float = 1.0, yaw_deg: float = 0.0, truth: bool = True, few: bool = False
) -> list[Finding]:
    """The findings on detections of the drive's true path, with such ranges, bearings and mount."""
    rng, one = np.random.default_rng(5), drive(5, robot(), truth=truth)
    t, pose = path(1.0)
    at = np.arange(1.0, 4.0 if few else t[-1], 0.5)
    eye = se2.compose(np.stack([np.interp(at, t, c) for c in pose.T], axis=-1), np.array([AHEAD, 0.0, 0.0]))
    rows, ids = [], []
    for i, place in enumerate(PLACES):
        away = place - eye[:, :2]
        bearing = np.arctan2(away[:, 1], away[:, 0]) - eye[:, 2] - math.radians(yaw_deg)
        rows.append(np.stack((sign * se2.wrap_all(bearing), scale * np.hypot(*away.T)), axis=-1))
        ids.append(np.full(len(at), float(i)))
    order = np.argsort(np.tile(at, len(PLACES)), kind="stable")
    z: Array = np.concatenate(rows)[order]
    z += rng.normal(size=z.shape) * [0.01, 0.02 * scale]
    m = readings(np.tile(at, len(PLACES))[order], z, 0.01, id=np.concatenate(ids)[order])
    settings = replace(robot(), sensors={"landmarks": LandmarksSettings(x=AHEAD)})
    return of_landmarks(replace(one, measurements={"landmarks": m}), settings)


@pytest.mark.parametrize("truth", [True, False])
def test_landmarks_that_keep_to_the_conventions_are_not_mentioned(truth: bool) -> None:
    assert found(truth=truth) == []
    assert found(scale=1.02, yaw_deg=1.0, truth=truth) == []
    assert found(sign=-1.0, few=True, truth=truth) == []


@pytest.mark.parametrize("truth", [True, False])
def test_bearings_that_grow_clockwise_and_ranges_in_mm_are_named(truth: bool) -> None:
    by = "the truth's" if truth else "the wheels'"
    (clockwise,) = found(sign=-1.0, truth=truth)
    assert clockwise.severe
    assert clockwise.message == f"its bearings grow clockwise by {by} motion: write them counter-clockwise"
    (unit,) = found(scale=1000.0, truth=truth)
    assert unit.severe
    assert unit.message == f"its ranges are 1000 times what {by} motion says: they look like mm; write metres"


@pytest.mark.parametrize("truth", [True, False])
def test_yaw_and_scale_of_a_detector_are_measured(truth: bool) -> None:
    (yaw,) = found(yaw_deg=20.0, truth=truth)
    assert float(yaw.fixes[0].removeprefix("landmarks.yaw_deg=")) == pytest.approx(20.0, abs=1.5)
    (scale,) = found(scale=1.25, truth=truth)
    assert not scale.fixes
    off = float(scale.message.partition("ranges are ")[2].partition("%")[0])
    assert off == pytest.approx(25.0, abs=3.0)


def test_detections_that_stay_the_same_tell_nothing() -> None:
    one, at = drive(5, robot()), np.arange(1.0, 40.0, 0.5)
    settings = replace(robot(), sensors={"landmarks": LandmarksSettings()})
    for bearing, distance in ((0.0, 0.0), (0.3, 1.0)):
        z = np.tile([bearing, distance], (len(at), 1))
        m = readings(at, z, 0.01, id=np.zeros(len(at)))
        found = of_landmarks(replace(one, measurements={"landmarks": m}), settings)
        assert not any(f.severe for f in found)
