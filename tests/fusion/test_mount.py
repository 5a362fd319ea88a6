"""A laser or camera whose place on the base is uncertain: derivatives by finite differences, honesty by drives."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from bags import real_log
from lock_step import simulated
from textbook import numeric_jacobian

from locfuse.cli.analysis.load import load
from locfuse.cli.analysis.settings import LogOptions
from locfuse.fusion import se2
from locfuse.fusion.data import Drive
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.kernels.sight import Rules
from locfuse.fusion.lines.extract import rows_of
from locfuse.fusion.map.line_map import Association, LineMap, mount_states_of
from locfuse.fusion.map.scan import Scan
from locfuse.fusion.map.tracker import LineTracker
from locfuse.fusion.mount import OTHER_MOUNT, Mount
from locfuse.fusion.scan_matching.clouds import clouds_of
from locfuse.fusion.scan_matching.match import Targets, match, sources_of
from locfuse.fusion.sensors.camera import BearingModel, CameraSettings
from locfuse.fusion.sensors.lrf import LrfSettings

TOLD = (0.2, -0.1, 0.4)  # x, y, yaw of the laser
SIGMAS = ("sigma_x", "sigma_y", "sigma_yaw_deg")
# pose, line (rho, beta about its anchor), anchor: ordinary, C < 0 so that the line is flipped, heading near pi
PLACES = [
    ((1.0, 2.0, 0.3), (0.02, 0.4), (4.0, 3.0)),
    ((4.001, 1.9, -3.0), (0.0, 0.0), (4.0, 2.0)),
    ((0.5, -0.2, math.pi - 1e-7), (-0.1, -math.pi + 1e-7), (-3.0, 0.1)),
]


def laser(*free: int) -> Mount:
    x, y, yaw = TOLD
    sigmas: dict[str, Any] = {SIGMAS[i]: 0.02 for i in free}
    return Mount("lrf", LrfSettings(x=x, y=y, yaw_deg=math.degrees(yaw), **sigmas))


def line_from(pose: Any, line: Any, anchor: Any) -> np.ndarray:
    """(r, psi) of a line (rho, beta) seen from a pose, straight from maths.md."""
    n = np.array([math.cos(line[1]), math.sin(line[1])])
    return np.array([line[0] - (np.array(pose[:2]) - np.array(anchor)) @ n, line[1] - pose[2]])


def in_base(z: np.ndarray, mount: Any) -> np.ndarray:
    """A line as the laser saw it, in the base."""
    psi = z[1] + mount[2]
    return np.array([z[0] + mount[0] * math.cos(psi) + mount[1] * math.sin(psi), psi])


def by_laser(z: np.ndarray, mount: Any) -> np.ndarray:
    """A line in the base, as the laser sees it."""
    return np.array([z[0] - mount[0] * math.cos(z[1]) - mount[1] * math.sin(z[1]), z[1] - mount[2]])


def compared(mount: Mount, belief: JointBelief, lines: LineMap, rows: np.ndarray) -> Association:
    """Lines in the base as the mount was told to be, against a map and without a gate."""
    found = Association(Rules(math.inf, True, False, 2, 3, 4), mount_states_of(mount, belief))
    found.compare(belief, lines, rows)
    return found


@pytest.mark.parametrize(("pose", "line", "anchor"), PLACES[::2])
def test_a_new_line_goes_with_the_mount_that_it_was_seen_by(
    pose: tuple[float, float, float], line: tuple[float, float], anchor: tuple[float, float]
) -> None:
    mount = laser(0, 1, 2)
    belief = JointBelief(pose, (0.0,) * 6, mount.blocks())
    A = np.random.default_rng(2).normal(size=(6, 6))
    before = 1e-3 * A @ A.T
    belief.covariance[:] = before
    model = LineTracker("grow", 0.9999, mount=mount)
    z = line_from(pose, line, anchor)
    C = np.array([[1e-3, 2e-4], [2e-4, 5e-4]])
    seen = compared(mount, belief, model.map, rows_of(z[None], C[None], np.array([[-0.5, 1.5]])))
    model._add(Scan(np.array(seen.rows)[:1]), 0, belief)
    seen_by_laser = by_laser(z, TOLD)
    middle = model.map.anchor[0]

    def born(v: np.ndarray) -> np.ndarray:
        r, psi = in_base(seen_by_laser, v[3:6]) + v[6:]
        n = np.array([math.cos(psi + v[2]), math.sin(psi + v[2])])
        return np.array([r + (v[:2] - middle) @ n, psi + v[2]])

    G = numeric_jacobian(born, np.array([*pose, *TOLD, 0.0, 0.0]))
    full = np.block([[before, np.zeros((6, 2))], [np.zeros((2, 6)), C]])
    np.testing.assert_allclose(belief.covariance[6:, 6:], G @ full @ G.T, atol=1e-8)
    np.testing.assert_allclose(belief.covariance[6:, :6], G[:, :6] @ before, atol=1e-8)


def test_only_what_is_uncertain_is_a_state() -> None:
    assert LineTracker("first-scan", 0.9999, mount=laser()).blocks() == []
    (block,) = BearingModel(CameraSettings(sigma_yaw_deg=2.0), (1.0, 1.0)).blocks()
    assert block.name == "camera_yaw"
    assert block.P[0, 0] == pytest.approx(math.radians(2.0) ** 2)
    with pytest.raises(ValueError, match="sigma_yaw_deg = -1"):
        LrfSettings(sigma_yaw_deg=-1.0)
    with pytest.raises(ValueError, match="absolute"):
        CameraSettings(bearing="absolute", sigma_x=0.1)


OFF = ((0.012, -0.008, 0.6), (-0.009, 0.011, -0.4), (0.004, 0.006, 0.5))  # m, m, deg: about one sigma each
EXACT = tuple(f"lrf.{key}=0" for key in SIGMAS)


def anees(stated: Sequence[str], seeds: Sequence[int]) -> float:
    """Of drives of the paper's robot, whose laser sits at (0.2, 0, 0 deg) and not where the filter is told."""
    found = []
    for seed, (x, y, yaw) in zip(seeds, OFF, strict=True):
        sets = (f"lrf.x={0.2 + x}", f"lrf.y={y}", f"lrf.yaw_deg={yaw}", *stated)
        drive, robot = simulated(seed, robot_sets=sets)
        found.append(evaluate(fuse(drive, robot, ["lrf"]), drive).figures["anees"])
    return float(np.mean(np.array(found, float)))


def test_a_laser_that_sits_elsewhere_makes_the_filter_overconfident_only_where_its_mount_is_called_exact() -> None:
    """benchmarks.mounts draws the mount in many drives; here are three."""
    seeds = range(1000, 1003)
    assert anees(EXACT, seeds) > 10.0
    assert 0.4 < anees((), seeds) < 1.5


def test_the_mount_of_a_laser_is_known_to_a_centimetre_and_half_a_degree_unless_configured() -> None:
    tells = Mount("lrf", LrfSettings(sigma_y=0.0, sigma_yaw_deg=2.0), observable=True)
    assert {block.name: math.sqrt(block.P[0, 0]) for block in tells.blocks()} == pytest.approx(
        {"lrf_x": 0.01, "lrf_yaw": math.radians(2.0)}
    )
    assert Mount("lrf", LrfSettings(), observable=False).blocks() == []


# --- two robots whose laser sits otherwise than their log says: the filter finds what matched scans say too

WAY_M, STRAIGHT_RAD = 0.4, math.radians(4.0)  # that lie between two scans, and how far the robot may have turned
LOOSE = np.diag([1e-2, 1e-2, 1e-1])  # information of the wheels' guess: next to none
MOST = 60  # pairs of scans: enough for a median


def direction_of_scans(drive: Drive) -> float:
    """By how much scans say that the robot drives to the left of where its wheels say, the median [rad].

    No map, no filter, no lines: points of two scans along a straight way are laid upon each other. A laser that is
    turned by less than it is configured sees the robot drive so far to the left.
    """
    m, wheels = drive.measurements["lrf"], drive.wheels
    within = np.flatnonzero((m.t >= wheels.t[0]) & (m.t <= wheels.t[-1]))
    t, heading = m.t[within], wheels.heading(m.t[within])
    driven = np.append(0.0, np.cumsum(np.hypot(*wheels.relative(t[:-1], t[1:])[:, :2].T)))
    ends = np.searchsorted(driven, driven + WAY_M)
    there = [(a, b) for a, b in enumerate(ends.tolist()) if b < len(t)]
    pairs = [(a, b) for a, b in there if np.ptp(heading[a : b + 1]) < STRAIGHT_RAD]
    i, j = np.array(pairs)[:: max(1, len(pairs) // MOST)].T
    used = np.union1d(i, j)
    clouds = clouds_of(m, within[used])
    by_wheels = wheels.relative(t[i], t[j])
    priors = np.broadcast_to(LOOSE, (len(i), 3, 3))
    found = match(
        Targets(clouds), np.searchsorted(used, i), sources_of(clouds), np.searchsorted(used, j), by_wheels, priors
    )
    good = (found.inliers > 0.8) & (found.overlap > 0.3)
    assert good.sum() > 20
    scans, by_wheels = found.pose[good], by_wheels[good]
    left = [np.arctan2(u[:, 1], u[:, 0]) - 0.5 * u[:, 2] for u in (scans, by_wheels)]  # of the middle of the way
    return float(np.median(se2.wrap_all(left[0] - left[1])))


@pytest.mark.parametrize(
    ("log", "sets", "configured"),
    [
        ("turtlebot4/tb4_mcap.mcap", ("lrf.time_offset=-0.17",), 90.0),
        ("strangers/pimouse.bag", ("lrf.time_offset=-0.16", "lrf.range_scale=0.93"), 0.0),
    ],
)
def test_a_laser_is_found_turned_as_matched_scans_say(log: str, sets: tuple[str, ...], configured: float) -> None:
    loaded = load([real_log(log)], LogOptions(sets=sets, quiet=True))
    assert loaded.robot.settings("lrf").mount[2] == pytest.approx(math.radians(configured), abs=1e-3)
    found = fuse(loaded.drive, loaded.robot, ["lrf"])
    off = math.degrees(found.blocks["lrf_yaw"][-1, 0]) - configured
    by_scans = -math.degrees(direction_of_scans(loaded.drive))
    assert abs(by_scans) > 0.7  # neither mount is what the log says
    assert off == pytest.approx(by_scans, abs=0.35)
    assert any(OTHER_MOUNT in words for words in found.notes)
