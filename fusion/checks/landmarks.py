"""Landmark checks: detections of one landmark from two places, compared with the robot's motion between them.

With the detector at s on the robot, a landmark is seen at s + c o: the detection o = range e^(i bearing), and the
complex error c of scale and direction. If the robot moves by p and turns by w, both detections are of one point if

    o_1 - e^(i w) o_2 = (p - s (1 - e^(i w))) / c

so 1 / c is a slope: its length is the scale of the ranges, its angle the error of the mount's yaw. If the bearings
grow clockwise, the equation holds for the conjugates of o. No map is needed.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Drive, Ints, Measurements
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.landmarks import mounts_of
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.statistics import Plane, jackknife, robust
from locfuse.fusion.truth import body_poses

from .finding import Finding
from .truth import UNIT, UNITS

CLOCKWISE = "clockwise"  # code of the finding on bearings that grow clockwise
MIN_ROLLED_M, MAX_ROLLED_M = 0.3, 1.5  # m that the robot drives between two compared detections
MIN_MOVED_M = 0.2  # m from the detector's first place to the second
MIN_PAIRS, PARTS = 40, 8  # pairs; parts of the jackknife
MIN_TURN_RAD, MIN_TURNS = 0.2, 20  # turn between two detections; pairs with one, to tell mirrored bearings
MAX_MIRRORED_SHARE = 0.7  # largest ratio of median residuals, mirrored to as measured, of mirrored bearings
MIN_YAW_RAD, MIN_SCALE, SIGMAS = math.radians(3.0), 0.05, 4.0  # smallest errors; standard errors
MIN_SLOPE = 1e-6  # of 1 / c
MAX_UNIT_RATIO = 1.5  # largest factor between the observed scale and that of a unit


class Sightings(NamedTuple):
    """k pairs of detections of one landmark, in time order, as complex numbers."""

    seen: Plane  # (k, 2) range e^(i bearing) of the first and the second detection
    turned: Plane  # (k, 2) e^(i angle) from their axes to the robot's axes at the first
    way: Plane  # (k,) m of the detector, same axes

    def slope(self, some: Ints, mirror: bool = False) -> tuple[complex, float]:
        """Return 1 / c by the pairs with these indices, and the median residual; of conjugates with `mirror`."""
        o = (self.seen.conj() if mirror else self.seen)[some] * self.turned[some]
        change, way = o[:, 0] - o[:, 1], self.way[some]
        found = complex(robust(way[:, None], change)[0][0])
        return found, float(np.median(np.abs(change - way * found)))


def sightings(drive: Drive, m: Measurements, robot: Robot) -> Sightings:
    """Return the pairs of detections; the motion between them is that of the truth's poses, else of the wheels."""
    t, ids, truth = np.repeat(m.t, np.diff(m.first)), m.extra["id"], drive.truth
    rolled = drive.wheels.driven(t)
    pairs = [np.zeros((2, 0), np.int64)]
    for one in np.unique(ids):
        rows = np.flatnonzero(ids == one)
        later = np.searchsorted(rolled[rows], rolled[rows] + MIN_ROLLED_M)
        known = later < len(rows)
        pairs.append(np.stack((rows[known], rows[later[known]])))
    both = np.concatenate(pairs, axis=1)
    both = both[:, np.argsort(t[both[0]], kind="stable")]
    inside = rolled[both[1]] - rolled[both[0]] < MAX_ROLLED_M
    if truth is not None:
        inside &= (t[both[0]] >= truth.t[0]) & (t[both[1]] <= truth.t[-1])
    first, second = both[:, inside]
    if truth is not None and truth.theta is not None:
        pose = body_poses(truth, t)
        moved = se2.between(pose[first], pose[second])
    else:
        moved = drive.wheels.relative(t[first], t[second])
    mounts = mounts_of(m, REGISTRY["landmarks"].mount(robot.settings("landmarks")))
    place, yaw = mounts[:, :2] @ (1.0, 1.0j), np.exp(1.0j * mounts[:, 2])
    turn = np.exp(1.0j * moved[:, 2])
    way = moved[:, :2] @ (1.0, 1.0j) - place[first] + turn * place[second]
    seen, far = m.z[:, 1] * np.exp(1.0j * m.z[:, 0]), np.abs(way) > MIN_MOVED_M
    turned = np.stack((yaw[first], turn * yaw[second]), axis=-1)
    return Sightings(np.stack((seen[first], seen[second]), axis=-1)[far], turned[far], way[far])


def of_landmarks(drive: Drive, robot: Robot) -> list[Finding]:
    """Return a finding on mirrored bearings, the unit or scale of the ranges, or the yaw of the detector."""
    m = drive.measurements.get("landmarks")
    if m is None or m.z.shape[1] < 2:
        return []
    pairs, settings = sightings(drive, m, robot), robot.settings("landmarks")
    every = np.arange(len(pairs.way))
    if len(every) < MIN_PAIRS:
        return []
    by = "the wheels' motion" if drive.truth is None or drive.truth.theta is None else "the truth's motion"
    # a straight drive and its mirror image look alike
    turns = np.flatnonzero(np.abs(np.angle(pairs.turned[:, 1] / pairs.turned[:, 0])) > MIN_TURN_RAD)
    if len(turns) >= MIN_TURNS and pairs.slope(turns, True)[1] < MAX_MIRRORED_SHARE * pairs.slope(turns)[1]:
        words = f"its bearings grow clockwise by {by}: write them counter-clockwise"
        return [Finding("landmarks", CLOCKWISE, words, (), True)]
    found, _ = pairs.slope(every)
    if abs(found) < MIN_SLOPE:
        return []  # the detections stay the same while the robot drives
    unit = next((u for f, u in UNITS.items() if 1.0 / MAX_UNIT_RATIO < abs(found) / f < MAX_UNIT_RATIO), None)
    if unit is not None:
        times = f"{float(f'{abs(found):.2g}'):g}"
        words = f"its ranges are {times} times what {by} says: they look like {unit}; write metres"
        return [Finding("landmarks", UNIT, words, (), True)]
    parts = jackknife(lambda some: np.array([pairs.slope(some)[0] / found]).view(np.float64), len(every), PARTS)
    yaw, scale, (scale_sigma, yaw_sigma) = -float(np.angle(found)), abs(found), np.broadcast_to(parts, 2).tolist()
    if abs(yaw) > MIN_YAW_RAD + SIGMAS * yaw_sigma:
        turned = settings.yaw_deg + math.degrees(yaw)
        sigma = f"1 sigma {math.degrees(yaw_sigma):.1f}°"
        words = f"by {by} its yaw is {turned:.1f}° ({sigma}), configured {settings.yaw_deg:g}°"
        return [Finding("landmarks", "yaw", words, (f"landmarks.yaw_deg={turned:.1f}",))]
    if abs(scale - 1.0) > MIN_SCALE + SIGMAS * scale_sigma * scale:
        off = f"{abs(scale - 1.0):.1%} too {'long' if scale > 1.0 else 'short'}"
        return [Finding("landmarks", "range scale", f"its ranges are {off} by {by} (1 sigma {scale_sigma:.1%})")]
    return []
