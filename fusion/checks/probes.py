"""Find better settings from the estimates of filter runs: mount, track, range scale, constant offsets.

A probe is a filter run in which the mount of one sensor and the track are states.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from locfuse.fusion.data import Drive, Estimates
from locfuse.fusion.mount import MAX_PRIOR_SIGMAS, SIGMA_DEG, SIGMA_M, MountedSettings, to_a_tenth_of
from locfuse.fusion.robot import Robot
from locfuse.fusion.se2 import laid_on, wrap
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.wheels.motion import MAX_PRIOR_SIGMAS as MAX_TURNING_SIGMAS, WHEELS

from .finding import Finding
from .laser import range_fix

# codes of the findings: on a mount; on mount or sideways motion of the wheels
MOUNT, DIRECTION = "mount", "direction"
MAX_CREEP_DEG = 1.5  # largest angle between heading and motion by sideways slip: 2 % of the path are 1.1 degrees
DIRECTION_WORDS = (
    "it and the wheels differ by {:.1f}° (1 sigma {:.1g}°) in the direction of driving: its mount, or wheels that "
    "drive sideways. To find out drive 3 m along a line on the floor: if the robot leaves it, it is the wheels"
)
MIN_SIGMAS = 4.0  # standard deviations: smallest difference between estimate and configured value
MIN_EXPLAINED_SHARE = 0.8  # least share of the true path's squares that the laser's path explains: equal shapes
MIN_MOUNT_M, MIN_MOUNT_DEG, MIN_TRACK = 0.004, 0.2, 0.005  # m, degrees, relative: smaller errors are not reported
MIN_SCALE, MIN_TRUTH = 0.002, 50  # relative; readings of the truth
# prior standard deviations of the mount in a probe: wide enough for a rough measurement with a ruler
PROBE_XY_M, PROBE_YAW_DEG = 0.05, 4.0
MOUNT_KEYS = {"x": ("x", 1.0), "y": ("y", 1.0), "yaw": ("yaw_deg", math.degrees(1.0))}


def probe_of(robot: Robot, sensor: str) -> tuple[str, ...]:
    """Return the settings that make a sensor's mount and the track states.

    () for a sensor without a mount, or if its mount is a state already.
    """
    settings = robot.settings(sensor)
    if not hasattr(settings, "sigma_yaw_deg") or settings.sigma_x or settings.sigma_yaw_deg:
        return ()
    sigmas = {"sigma_x": PROBE_XY_M, "sigma_y": PROBE_XY_M, "sigma_yaw_deg": PROBE_YAW_DEG}
    mount = tuple(f"{sensor}.{key}={sigma}" for key, sigma in sigmas.items())
    track = () if robot.wheels.estimate or robot.wheels.track is None else ("wheels.estimate=true",)
    return (*mount, *track)


def of_probe(robot: Robot, sensor: str, e: Estimates, judged: bool) -> Iterator[Finding]:
    """Yield findings on mount and track if a run's estimates differ from the configured values."""
    yield from of_mount(robot, sensor, e, judged, PROBE_XY_M, PROBE_YAW_DEG)
    yield from _track(robot, e, judged)


def of_mount(
    robot: Robot,
    sensor: str,
    e: Estimates,
    judged: bool,
    prior_xy: float = SIGMA_M,
    prior_yaw_deg: float = SIGMA_DEG,
) -> Iterator[Finding]:
    """Yield a finding if the mount that a run estimated differs from the configured one.

    With truth (`judged`), every significant difference counts. Without truth, it must be plausible by the sigmas
    of the mount in the sensor's settings (if 0: `prior_xy` [m] and `prior_yaw_deg`), and larger than usual errors
    of measured mounts. The reason: if all turns are to the left, a clock that is 20 ms late causes a yaw error of
    a third of a degree, and sideways motion of the wheels also seems to be a yaw error. So a yaw error below
    MAX_CREEP_DEG is a finding without a fix.
    """
    fixes, words = [], []
    for part, (key, scale) in MOUNT_KEYS.items():
        name = f"{sensor}_{part}"
        if name not in e.blocks:
            continue
        value, sigma = scale * float(e.blocks[name][-1, 0]), scale * float(e.block_sigmas[name][-1, 0])
        configured = float(getattr(robot.settings(sensor), key))
        stated = getattr(robot.settings(sensor), "sigma_yaw_deg" if part == "yaw" else f"sigma_{part}")
        likely = MAX_PRIOR_SIGMAS * (stated or (prior_yaw_deg if part == "yaw" else prior_xy))
        if not judged and abs(value - configured) > likely:
            return
        in_deg, in_m = (MIN_MOUNT_DEG, MIN_MOUNT_M) if judged else (MAX_CREEP_DEG, SIGMA_M)
        least = in_deg if part == "yaw" else in_m
        off = abs(value - configured)
        if part == "yaw" and max(MIN_SIGMAS * sigma, SIGMA_DEG) < off <= least:
            yield Finding(sensor, DIRECTION, DIRECTION_WORDS.format(off, sigma))
        if off > max(MIN_SIGMAS * sigma, least):
            shown = to_a_tenth_of(sigma, value)
            fixes.append(f"{sensor}.{key}={shown:g}")
            unit = "°" if key == "yaw_deg" else " m"
            words.append(f"{part} is {shown:g}{unit} (± {sigma:.1g}), configured {configured:g}{unit}")
    if fixes:
        yield Finding(sensor, MOUNT, f"the drive shows another mount: {', '.join(words)}", tuple(fixes))


def beyond_prior(robot: Robot, sensor: str, e: Estimates) -> bool:
    """Return whether a run's estimate of the mount is significantly outside its configured sigmas.

    Such an estimate is biased towards the configured mount: a run with larger sigmas shows the true one.
    """
    settings = robot.settings(sensor)
    if not isinstance(settings, MountedSettings):
        return False
    for part, configured, prior in zip(MOUNT_KEYS, settings.mount, settings.sigmas(True), strict=True):
        name = f"{sensor}_{part}"
        if name in e.blocks:
            off, sigma = abs(float(e.blocks[name][-1, 0]) - configured), float(e.block_sigmas[name][-1, 0])
            if off > max(MIN_SIGMAS * sigma, MAX_PRIOR_SIGMAS * prior):
                return True
    return False


def _track(robot: Robot, e: Estimates, judged: bool) -> Iterator[Finding]:
    if WHEELS not in e.blocks or robot.wheels.track is None or robot.wheels.estimate:
        return
    right, left, turning = e.blocks[WHEELS][-1].tolist()
    if not judged and abs(turning) > MAX_TURNING_SIGMAS * robot.wheels.sigma_track:
        return  # a single slip in a turn may cause this
    # the track that, with the configured radius, gives the same turns as the states
    off = 1.0 / (1.0 + 0.5 * (right + left) - turning) - 1.0
    by = np.array([-0.5, -0.5, 1.0]) * (1.0 + off) ** 2
    sigma = math.sqrt(float((by**2 * e.block_sigmas[WHEELS][-1] ** 2).sum()))
    if abs(off) > max(MIN_SIGMAS * sigma, MIN_TRACK):
        track = robot.wheels.track * (1.0 + off)
        words = f"the drive shows a track of {track:.4g} m, configured {robot.wheels.track:g} m"
        yield Finding("wheels", "track", words, (f"wheels.track={track:.4g}",))


def of_scale(robot: Robot, e: Estimates, drive: Drive) -> Iterator[Finding]:
    """Yield a finding if the path of a run with only the laser is larger or smaller than the truth's path."""
    scale = path_scale(e, drive)
    if scale is None or abs(scale - 1.0) < MIN_SCALE:
        return
    words = f"its trajectory is {1.0 / scale:.4f} times as large as the truth's"
    yield Finding("lrf", "way", words, range_fix(robot, scale))


def path_scale(e: Estimates, drive: Drive) -> float | None:
    """Return size of the true path / size of a laser-only run's path; None without truth or if the shapes differ.

    The size of the path follows the laser's distance scale, since walls determine it.
    """
    if drive.truth is None or e.truth_pose is None:
        return None
    found = np.isfinite(e.truth_pose[:, 0]) & np.isfinite(drive.truth.xy[:, 0])
    if found.sum() < MIN_TRUTH:
        return None
    own, truth = e.truth_pose[found, :2], drive.truth.xy[found]
    _, scale = laid_on(own, truth)
    explained = scale**2 * float(own.var(axis=0).sum())
    return None if explained < MIN_EXPLAINED_SHARE * float(truth.var(axis=0).sum()) else scale


def of_offsets(robot: Robot, e: Estimates) -> Iterator[Finding]:
    """Yield findings with constant offsets that a run estimated, for use as settings."""
    for sensor in e.sensors:
        bias: Any = REGISTRY[sensor].bias
        name = f"{sensor}_offset"
        if bias is None or not bias.estimated or getattr(robot.settings(sensor), bias.key) is not None:
            continue
        if name not in e.blocks or REGISTRY[sensor].drift_key is None:
            continue
        if float(getattr(robot.settings(sensor), REGISTRY[sensor].drift_key or "")) > 0.0:
            continue  # a drifting offset is not constant
        scale = REGISTRY[sensor].components[0].scale
        value, sigma = scale * float(e.blocks[name][-1, 0]), scale * float(e.block_sigmas[name][-1, 0])
        value = math.degrees(wrap(math.radians(value)))
        words = f"its offset is estimated on every drive, here {value:.2f}° (± {sigma:.1g})"
        yield Finding(sensor, "offset", words, (f"{sensor}.{bias.key}={value:.2f}",))
