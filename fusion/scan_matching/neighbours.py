"""Matches of consecutive scans, starting from wheel odometry, with a search for wheel slips.

If the robot turns, all scans between two key scans are matched one by one, since consecutive scans show the same
surfaces. After half a metre or half a turn, a point may be matched with a wrong surface.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints, Measurements, Points

from .clouds import Clouds, clouds_of
from .match import Matches, Targets, match, sources_of

MIN_INLIERS, MIN_OVERLAP, MAX_RMS_M = 0.6, 0.3, 0.05
MAX_SIGMA_RAD = np.radians(3.0)  # largest standard deviation of the heading of a reliable match
SLIPS_RAD = np.radians([-30.0, -24.0, -18.0, -12.0, -8.0, -4.0, 4.0, 8.0, 12.0, 18.0, 24.0, 30.0])
SLIP_INLIERS, SLIP_GAIN = 0.75, 0.1  # share of inliers below which a slip is searched; least increase by the slip
STEP_P = np.diag([0.05**2, 0.05**2, np.radians(1.0) ** 2])  # covariance of an initial pose, per step
REACH_M = 0.3  # largest distance of matched points from such an initial pose
# prior information during the search for a slip
LOOSE_INFORMATION = np.diag([0.1**-2, 0.1**-2, np.radians(8.0) ** -2])
# m, rad: standard deviations of wheel odometry between two scans, with slip; added share of the turn
SLIP_M, SLIP_RAD, SLIP_SHARE = 0.1, np.radians(2.0), 0.1


def next_scans(targets: Targets, i: Ints, clouds: Clouds, j: Ints, wheels: Array, information: Array) -> Matches:
    """Match scans j (p,) with scans i, starting from wheel odometry (p, 3); search for a slip if a match is bad.

    `information` (p, 3, 3) is that of the wheel odometry, in the frame of i.
    """
    found = match(targets, i, clouds, j, wheels, information)
    bad = np.flatnonzero(found.inliers < SLIP_INLIERS)
    if not len(bad):
        return found
    again, tries = np.repeat(bad, len(SLIPS_RAD)), np.tile(SLIPS_RAD, len(bad))
    guess = wheels[again] + np.outer(tries, (0.0, 0.0, 1.0))
    slips = match(
        targets, i[again], clouds, j[again], guess, np.broadcast_to(LOOSE_INFORMATION, (len(again), 3, 3))
    )
    score = (slips.inliers * (slips.overlap > MIN_OVERLAP)).reshape(len(bad), -1)
    best = score.argmax(axis=1)
    take = score.max(axis=1) > found.inliers[bad] + SLIP_GAIN
    chosen = np.arange(len(bad)) * len(SLIPS_RAD) + best
    found.put(bad[take], slips.take(chosen[take]))
    return found


def further_scans(targets: Targets, clouds: Clouds, x: Array, n: int, apart: float) -> tuple[Ints, Matches]:
    """Match every scan with the scan n before it, if nearer than `apart` [m]; keep reliable matches.

    Return the indices of the earlier scans, and the matches. `x` (k, 3) are the poses by matches over fewer steps.
    """
    i = np.arange(max(len(x) - n, 0))
    guess = se2.between(x[i], x[i + n])
    near = np.hypot(*guess[:, :2].T) < apart
    i, guess = i[near], guess[near]
    prior = np.broadcast_to(np.linalg.inv(n * STEP_P), (len(i), 3, 3))
    found = match(targets, i, clouds, i + n, guess, prior, REACH_M)
    reliable = good(found)
    return i[reliable], found.take(reliable)


def by_wheels(moved: Array) -> Array:
    """Return the information matrices (n, 3, 3) of wheel odometry for its motions `moved` (n, 3) between scans."""
    information = np.zeros((len(moved), 3, 3))
    information[:, 0, 0] = information[:, 1, 1] = SLIP_M**-2
    information[:, 2, 2] = 1.0 / (SLIP_RAD**2 + (SLIP_SHARE * moved[:, 2]) ** 2)
    return information


def good(found: Matches) -> NDArray[np.bool_]:
    """Return which matches (p,) are reliable, by inliers, overlap, residuals and heading uncertainty."""
    fits = (found.inliers > MIN_INLIERS) & (found.overlap > MIN_OVERLAP) & (found.rms < MAX_RMS_M)
    return np.asarray(fits & (found.information[:, 2, 2] > MAX_SIGMA_RAD**-2))


SCANS_AT_ONCE = 1024  # scans whose points are in memory at once


def scan_by_scan(m: Measurements, points: Points, begin: Ints, end: Ints) -> Array:
    """Return the poses (n, 3) of readings `end` relative to earlier readings `begin`, (n,) indices each.

    All scans in between are matched, each with the next one. If a match is not reliable, wheel odometry gives this
    step.
    """
    counts = end - begin
    first = np.cumsum(counts) - counts
    scans = np.arange(counts.sum()) + np.repeat(begin - first, counts)
    cuts = np.arange(SCANS_AT_ONCE, len(scans), SCANS_AT_ONCE)
    steps = np.concatenate([_scan_after(m, points, part) for part in np.split(scans, cuts)])
    return np.stack([se2.chain(part)[-1] for part in np.split(steps, first[1:])])


def _scan_after(m: Measurements, points: Points, scans: Ints) -> Array:
    """Return the pose (k, 3) of the next scan relative to each scan: by matching, else by the wheels."""
    u = points.moved(m.t[scans], m.t[scans + 1])
    readings, at = np.unique(np.concatenate((scans, scans + 1)), return_inverse=True)
    clouds = clouds_of(m, readings)
    i, j = at[: len(scans)], at[len(scans) :]
    found = match(Targets(clouds), i, sources_of(clouds), j, u, by_wheels(u))
    return np.where(good(found)[:, None], found.pose, u)


def beyond_wheels(m: Measurements, a: int, b: int) -> Array | None:
    """Return the motion from reading a to b by scan matching minus that by the wheels, (3,) m, m, rad.

    In the frame of reading a; None without a reliable match.
    """
    if m.points is None or a < 0:
        return None
    u = m.points.moved(m.t[[a]], m.t[[b]])
    clouds = clouds_of(m, np.array([a, b]))
    found = next_scans(Targets(clouds), np.array([0]), sources_of(clouds), np.array([1]), u, by_wheels(u))
    if not good(found)[0]:
        return None
    more: Array = found.pose[0] - u[0]
    more[2] = se2.wrap(float(more[2]))
    return more
