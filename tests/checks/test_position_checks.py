"""What the truth says of positions, poses and speeds by other programs, held to drives whose answer is known."""

import math
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace
from present import present
from rows import readings
from small_drive import drive, path, robot

from locfuse.fusion import se2
from locfuse.fusion.checks.clocks import differences
from locfuse.fusion.checks.finding import Finding
from locfuse.fusion.checks.positions import of_antenna, of_claims, of_east, of_positions, with_fixes_as_truth
from locfuse.fusion.checks.truth import metre
from locfuse.fusion.data import Array, Drive
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.gps import GpsSettings
from locfuse.fusion.sensors.pose import PoseSettings
from locfuse.fusion.sensors.twist import TwistSettings

FRAME = np.array([3.0, -2.0, math.radians(-25.0)])  # the map in the frame of the other program
SETTINGS: dict[str, Any] = {"gps": GpsSettings, "pose": PoseSettings, "twist": TwistSettings}


def seen(
    sensor: str,
    body: tuple[float, float, float] = (0.0, 0.0, 0.0),
    late: float = 0.0,
    times: Any = 1.0,
    sigma: float = 0.01,
    frame: Array = FRAME,
    **settings: Any,
) -> tuple[Drive, Robot]:
    """A drive with readings of a sensor on `body`, each number multiplied by `times`; its robot."""
    t, pose = path(1.0)
    at = np.arange(2.0, t[-1] - 2.0, 0.2)
    t, pose = at + late, np.stack([np.interp(at, t, c) for c in pose.T], axis=-1)
    rng = np.random.default_rng(2)
    z = se2.compose(frame, se2.compose(pose, np.array(body)))
    z += sigma * rng.normal(size=z.shape)
    extra = {"drifts": np.zeros(len(t)), "has_covariance": np.zeros(len(t))}
    if sensor == "twist":
        moved = se2.log(se2.between(pose[:-1], pose[1:]))[:, [0, 2]]
        z = np.concatenate((np.zeros((1, 2)), moved.cumsum(axis=0)))
        extra["piece"] = np.zeros(len(t))
    m = readings(t, (z if sensor != "gps" else z[:, :2]) * times, 0.01, **extra)
    one = replace(drive(5, robot()), measurements={sensor: m})
    return one, replace(robot(), sensors={sensor: SETTINGS[sensor](**settings)})


def told(found: list[Finding]) -> dict[str, float]:
    """The values of all fixes, by key."""
    return {k: float(v) for f in found for k, _, v in (fix.partition("=") for fix in f.fixes)}


@pytest.mark.parametrize("sensor", ["gps", "pose", "twist"])
def test_a_sensor_that_says_what_is_true_is_not_mentioned(sensor: str) -> None:
    one, settings = seen(sensor)
    assert of_positions(one, settings) == []
    assert of_claims(one, settings) == []
    assert sensor != "gps" or of_antenna(one, settings, ()) is None
    assert of_positions(replace(one, truth=None), settings) == []


@pytest.mark.parametrize("sensor", ["gps", "pose"])
def test_a_mirrored_path_and_one_of_another_size_are_named(sensor: str) -> None:
    d = 2 if sensor == "gps" else 3
    (mirrored,) = of_positions(*seen(sensor, times=np.array([1.0, -1.0, -1.0])[:d]))
    assert mirrored.severe
    assert "a mirror image of the truth's" in mirrored.message
    (larger,) = of_positions(*seen(sensor, times=np.array([1.1, 1.1, 1.0])[:d]))
    assert larger.message == "its path is 1.1 times as large as the truth's"


def test_fixes_in_radians_are_named() -> None:
    (radians,) = of_positions(*seen("gps", times=math.radians(1.0), sigma=0.0))
    assert radians.message.endswith("it looks like radians; write degrees")


@pytest.mark.parametrize("late", [0.0, 0.4])
@pytest.mark.parametrize("sensor", ["gps", "pose"])
def test_the_clock_and_the_antenna_are_told_apart(sensor: str, late: float) -> None:
    one, settings = seen(sensor, body=(0.3, -0.2, 0.0), late=late)
    places = one.measurements[sensor].z * [1.0, 1.0, 0.0][: 2 if sensor == "gps" else 3]  # no headings
    positions = replace(one.measurements[sensor], z=places)
    lag = differences(replace(one, measurements={sensor: positions}), settings)[sensor, "truth"]
    assert lag.offset == pytest.approx(-late, abs=0.03)
    if sensor == "gps" and not late:
        finding, rival = present(of_antenna(one, settings, ()))
        assert rival == ()
        values = told([finding, *of_east(one, settings)])
        assert values == pytest.approx({"gps.x": 0.3, "gps.y": -0.2, "gps.east_deg": 25.0}, abs=0.01)


def test_the_body_of_poses_is_found_and_their_frame() -> None:
    one, settings = seen("pose", body=(0.4, 0.1, math.radians(20.0)), sigma=0.002, x=0.1)
    found = of_positions(one, settings)
    # what it says is of the body as configured, so the rest is turned into its axes
    x, y = 0.4 + 0.1 * math.cos(math.radians(20.0)), 0.1 + 0.1 * math.sin(math.radians(20.0))
    assert told(found) == pytest.approx({"pose.x": x, "pose.y": y, "pose.yaw_deg": 20.0}, abs=0.02)
    one, settings = seen("pose")
    in_map = replace(settings, sensors={"pose": PoseSettings(frame="map")})
    (frame,) = of_positions(one, in_map)
    assert frame.fixes == ("pose.frame=own",)


@pytest.mark.parametrize(
    ("times", "words"),
    [
        ([-1.0, 1.0], "its forward speeds are -1 times those of the {}: they have the other sign"),
        ([1.0, -1.0], "its turning rates are -1 times those of the {}: they have the other sign"),
        ([1000.0, 1.0], "its forward speeds are 1e+03 times those of the {}: they look like mm/s"),
        ([3.6, 1.0], "its forward speeds are 3.6 times those of the {}: they look like km/h"),
        ([1.0, math.degrees(1.0)], "its turning rates are 57.3 times those of the {}: they look like degrees/s"),
        ([1.2, 1.0], "its forward speeds are 1.2 times those of the {}"),
    ],
)
def test_speeds_of_another_unit_sign_or_scale_are_named(times: list[float], words: str) -> None:
    one, settings = seen("twist", times=times)
    (by_truth,) = of_positions(one, settings)
    assert by_truth.severe
    assert by_truth.message.partition(":")[0] == words.format("truth").partition(":")[0]
    by_wheels = of_positions(replace(one, truth=None), settings)
    assert len(by_wheels) == (times[0] != 1.2)  # of a scale without another sign or unit either may be wrong


def test_positions_that_are_less_exact_than_claimed_get_their_sigma() -> None:
    one, settings = seen("gps", sigma=0.3)
    tight = replace(settings, sensors={"gps": GpsSettings(sigma=0.05)})
    (claim,) = of_claims(one, tight)
    assert told([claim])["gps.sigma"] == pytest.approx(0.3, rel=0.1)
    m = one.measurements["gps"]
    receiver = replace(one, measurements={"gps": replace(m, R_unit=4.0 * m.R_unit, scale=0.01)})
    (claim,) = of_claims(receiver, settings)
    assert claim.fixes[0] == "gps.covariance=sigma"
    assert "its messages claim 0.02 m" in claim.message


def test_fixes_that_scatter_more_than_claimed_are_named_without_truth() -> None:
    one, settings = seen("gps", sigma=0.3)
    tight = replace(settings, sensors={"gps": GpsSettings(sigma=0.05)})
    (claim,) = of_claims(replace(one, truth=None), tight)
    assert told([claim])["gps.sigma"] == pytest.approx(0.3, rel=0.2)
    assert "from one to the next its positions are wrong by" in claim.message
    m, rng = one.measurements["gps"], np.random.default_rng(3)
    drifts = replace(m, z=seen("gps")[0].measurements["gps"].z + 0.1 * rng.normal(size=m.z.shape).cumsum(axis=0))
    assert of_claims(replace(one, truth=None, measurements={"gps": drifts}), tight) == []


def test_fixes_that_step_aside_for_a_while_are_named() -> None:
    one, settings = seen("gps")
    m = one.measurements["gps"]
    aside = m.z + np.where((m.t > 20.0) & (m.t < 30.0), 0.6, 0.0)[:, None]
    one = replace(one, truth=None, measurements={"gps": replace(m, z=aside)})
    (found,) = of_positions(one, settings)
    assert "its fixes step aside by 0.8" in found.message
    assert "at 20.0 s" in found.message or "at 20.2 s" in found.message


def test_fixes_show_the_scale_of_the_wheels_without_truth() -> None:
    for times, sigma in ((1.1, 0.01), (1.0, 0.01), (1.0, 0.5)):  # errors of fixes make steps longer
        one, settings = seen("gps", (0.3, -0.2, 0.0), times=times, sigma=sigma)
        settings = replace(settings, sensors={"gps": GpsSettings(sigma=0.01, x=0.3, y=-0.2)})
        factor, found = metre(with_fixes_as_truth(replace(one, truth=None), settings), settings)
        assert factor == pytest.approx(times, abs=0.015)
        assert ["by the fixes of the GPS" in f.message for f in found] == [True] * (times != 1.0)
