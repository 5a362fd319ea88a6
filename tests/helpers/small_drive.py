"""A drive made of numbers: a robot that rounds a rectangle in a room, with the truth known exactly.

No files, no scans, no images: wheels, headings and wall lines are drawn here, so that tests of the report see a
whole drive in milliseconds and every noise is what its setting says.
"""

import math
from typing import Any, cast

import numpy as np
from msgspec.structs import replace
from pose_streams import pose_stream
from rows import readings

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Drive, Measurements, Stream
from locfuse.fusion.measure import cut
from locfuse.fusion.robot import Robot, StartSettings, WheelSettings
from locfuse.fusion.sensors.compass import CompassSettings
from locfuse.fusion.sensors.lrf import LrfSettings
from locfuse.fusion.truth import read_truth
from locfuse.fusion.wheels.motion import Wheels

ROOM = (  # rho [m], beta [rad], start of the wall along its tangent [m], length [m]
    (0.0, -math.pi / 2, 0.0, 8.0),
    (8.0, 0.0, 0.0, 6.0),
    (6.0, math.pi / 2, -8.0, 8.0),
    (0.0, math.pi, -6.0, 6.0),
)
START = (2.0, 1.5, 0.0)
TRACK, SPEED, NOISE = 0.6, 0.3, 4e-4


def path(laps: float, rate: float = 50.0) -> tuple[Array, Array]:
    """True poses (n, 3) on a 4 m x 2 m rounded rectangle, and their times."""
    sides = [(4.0, 0.0), (0.6 * math.pi / 2, math.pi / 2), (2.0, 0.0), (0.6 * math.pi / 2, math.pi / 2)] * 2
    steps = []
    for length, turn in sides * math.ceil(laps):
        n = max(1, round(length / SPEED * rate))
        steps.append(np.tile((length / n, 0.0, turn / n), (n, 1)))
    twist = np.concatenate(steps)[: int(laps * rate * 52.5)]
    pose = [np.array(START)]
    for step in se2.exp(twist):
        pose.append(se2.compose(pose[-1], step))
    return np.arange(len(pose)) / rate, np.array(pose)


def robot(compass: dict[str, Any] | None = None, lrf: dict[str, Any] | None = None, **wheels: Any) -> Robot:
    """The description of the robot, true unless changed."""
    x, y, theta = START
    return Robot(
        wheels=WheelSettings(radius=0.05, track=TRACK, noise=NOISE, **wheels),
        start=StartSettings(x=x, y=y, theta_deg=math.degrees(theta)),
        sensors={
            "compass": CompassSettings(**{"sigma_deg": 1.0, **(compass or {})}),
            "lrf": LrfSettings(**{"map": "refine", **(lrf or {})}),
        },
        start_given=True,
    )


def drive(
    seed: int,
    robot: Robot,
    sensors: tuple[str, ...] = ("compass", "lrf"),
    laps: float = 1.0,
    compass_noise_deg: float = 1.0,
    compass_bias_deg: float = 0.0,
    truth: bool = True,
    scans: float = 5.0,
    headings: float = 10.0,
) -> Drive:
    """Draw one drive."""
    rng = np.random.default_rng(seed)
    t, pose = path(laps)
    wheels = _wheels(t, pose, rng)
    measurements: dict[str, Measurements] = {}
    if "compass" in sensors:
        at = np.arange(0.013, t[-1], 1.0 / headings)
        z = _at(at, t, pose)[:, 2] + np.radians(compass_bias_deg + compass_noise_deg * rng.normal(size=len(at)))
        sigma = math.radians(robot.settings("compass").sigma_deg)
        measurements["compass"] = readings(at, se2.wrap_all(z)[:, None], sigma, strength=np.ones(len(at)))
    if "lrf" in sensors:
        at = np.arange(0.031, t[-1], 1.0 / scans)
        measurements["lrf"] = _walls(at, _at(at, t, pose), robot.settings("lrf"), rng)
    absent = {s: "no topic of its type" for s in ("compass", "lrf") if s not in measurements}
    epoch_ns, read, dropped = 1_700_000_000_000_000_000, None, {"wheels": dict[str, int]()}
    if truth:
        rows = slice(1, None, 5)  # 10 Hz
        stream = pose_stream("/ground_truth", epoch_ns + np.rint(t[rows] * 1e9).astype(np.int64), pose[rows])
        read, dropped["truth"] = read_truth(cast("Stream", stream), robot.truth, epoch_ns)
    return Drive(
        epoch_ns=epoch_ns,
        measurements=measurements,
        absent=absent,
        truth=read,
        dropped=dropped,
        wheels=wheels,
        **cut(wheels, robot, measurements, read),
    )


def _at(at: Array, t: Array, pose: Array) -> Array:
    return np.stack([np.interp(at, t, column) for column in pose.T], axis=-1)


def _wheels(t: Array, pose: Array, rng: np.random.Generator) -> Wheels:
    """What the encoders say: the true way plus noise of variance NOISE per metre of either wheel."""
    twist = se2.log(se2.between(pose[:-1], pose[1:]))
    sides = np.stack((twist[:, 0] - 0.5 * TRACK * twist[:, 2], twist[:, 0] + 0.5 * TRACK * twist[:, 2]), axis=-1)
    rolled = sides + np.sqrt(NOISE * np.abs(sides)) * rng.normal(size=sides.shape)
    left, right = (np.concatenate(([0.0], np.cumsum(column))) for column in rolled.T)
    return Wheels.from_wheels(t, left, right, TRACK, NOISE)


def _walls(t: Array, pose: Array, settings: LrfSettings, rng: np.random.Generator) -> Measurements:
    """The four walls of the room as (r, psi) from every pose, in full length."""
    sigma = np.array([0.005, math.radians(0.2)])
    z, ends = [], []
    for x, y, theta in pose.tolist():
        for rho, beta, low, length in ROOM:
            z.append((rho - x * math.cos(beta) - y * math.sin(beta), beta - theta))
            along = y * math.cos(beta) - x * math.sin(beta)
            ends.append((low - along, low + length - along))
    values = np.array(z) + sigma * rng.normal(size=(len(z), 2))
    values[:, 1] = se2.wrap_all(values[:, 1])
    return Measurements(
        t=t,
        first=np.arange(len(t) + 1) * len(ROOM),
        z=values,
        R_unit=np.tile(np.diag(sigma**2) / settings.sigma_range**2, (len(z), 1, 1)),
        scale=settings.sigma_range,
        floor=np.zeros((2, 2)),
        extra={"ends": np.array(ends)},
    )


def without(drive: Drive, *sensors: str) -> Drive:
    """The same drive without some sensors' measurements."""
    kept = {s: m for s, m in drive.measurements.items() if s not in sensors}
    return replace(drive, measurements=kept, instant={s: drive.instant[s] for s in kept})
