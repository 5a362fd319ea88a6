"""Two robots whose laser sits otherwise than their log says: the filter finds what matched scans say too."""

from __future__ import annotations

import math

import numpy as np
import pytest
from bags import real_log

from locfuse.cli.analysis.load import load
from locfuse.cli.analysis.settings import LogOptions
from locfuse.fusion import se2
from locfuse.fusion.data import Drive
from locfuse.fusion.fuse import fuse
from locfuse.fusion.mount import OTHER_MOUNT
from locfuse.fusion.scan_matching.clouds import clouds_of
from locfuse.fusion.scan_matching.match import Targets, match, sources_of

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
    loaded = load([real_log(log)], LogOptions(None, sets, None, False, True))
    assert loaded.robot.settings("lrf").mount[2] == pytest.approx(math.radians(configured), abs=1e-3)
    found = fuse(loaded.drive, loaded.robot, ["lrf"])
    off = math.degrees(found.blocks["lrf_yaw"][-1, 0]) - configured
    by_scans = -math.degrees(direction_of_scans(loaded.drive))
    assert abs(by_scans) > 0.7  # neither mount is what the log says
    assert off == pytest.approx(by_scans, abs=0.35)
    assert any(OTHER_MOUNT in words for words in found.notes)
