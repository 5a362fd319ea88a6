"""Matches of scans with the next ones, from the wheels' motion; where wheels slipped, the slip is searched.

Where the robot turns, all scans between two are matched one with the next: shortly after one another they show the
same surfaces. Half a metre or half a turn later something else may be taken for them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints, Measurements, Points

from .clouds import Clouds, clouds_of
from .match import Matches, Targets, match, sources_of

MIN_INLIERS, MIN_OVERLAP, MAX_RMS_M = 0.6, 0.3, 0.05
MAX_SIGMA_RAD = np.radians(3.0)  # of the heading among the walls: known worse, a match is none
SLIPS_RAD = np.radians([-30.0, -24.0, -18.0, -12.0, -8.0, -4.0, 4.0, 8.0, 12.0, 18.0, 24.0, 30.0])
SLIP_INLIERS, SLIP_GAIN = 0.75, 0.1  # where fewer points fit a slip is looked for; it must let so many more fit
STEP_P = np.diag([0.05**2, 0.05**2, np.radians(1.0) ** 2])  # variances of a guess, per step that it goes over
REACH_M = 0.3  # of a match from such a guess
LOOSE_INFORMATION = np.diag([0.1**-2, 0.1**-2, np.radians(8.0) ** -2])  # the wheels' prior while one is looked for
# m, rad: standard deviations of the wheels' way from scan to scan, for they slip; the share of a turn that adds
SLIP_M, SLIP_RAD, SLIP_SHARE = 0.1, np.radians(2.0), 0.1


def next_scans(targets: Targets, i: Ints, clouds: Clouds, j: Ints, wheels: Array, information: Array) -> Matches:
    """Match scans j (p,) with scans i from the wheels' motions (p, 3); search for a slip if that fits badly.

    `information` (p, 3, 3) is that of the motions, in the frame of i.
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
    """Match every scan with the n-th before it if closer than `apart` [m]; return earlier scans and matches.

    `x` (k, 3) are the poses that shorter steps led to. Only matches that are to be believed are returned.
    """
    i = np.arange(max(len(x) - n, 0))
    guess = se2.between(x[i], x[i + n])
    near = np.hypot(*guess[:, :2].T) < apart
    i, guess = i[near], guess[near]
    prior = np.broadcast_to(np.linalg.inv(n * STEP_P), (len(i), 3, 3))
    found = match(targets, i, clouds, i + n, guess, prior, REACH_M)
    sure = good(found)
    return i[sure], found.take(sure)


def by_wheels(moved: Array) -> Array:
    """Return the information (n, 3, 3) of motions (n, 3) by the wheels from scan to scan."""
    information = np.zeros((len(moved), 3, 3))
    information[:, 0, 0] = information[:, 1, 1] = SLIP_M**-2
    information[:, 2, 2] = 1.0 / (SLIP_RAD**2 + (SLIP_SHARE * moved[:, 2]) ** 2)
    return information


def good(found: Matches) -> NDArray[np.bool_]:
    """Return which matches are reliable, (p,)."""
    fits = (found.inliers > MIN_INLIERS) & (found.overlap > MIN_OVERLAP) & (found.rms < MAX_RMS_M)
    return np.asarray(fits & (found.information[:, 2, 2] > MAX_SIGMA_RAD**-2))


SCANS_AT_ONCE = 1024  # whose points are held


def scan_by_scan(m: Measurements, points: Points, begin: Ints, end: Ints) -> Array:
    """Return readings `end` (n,) relative to earlier readings `begin`, (n, 3).

    Where a match on the way is not good, the step is that of the wheels.
    """
    counts = end - begin
    first = np.cumsum(counts) - counts
    scans = np.arange(counts.sum()) + np.repeat(begin - first, counts)
    cuts = np.arange(SCANS_AT_ONCE, len(scans), SCANS_AT_ONCE)
    steps = np.concatenate([_scan_after(m, points, part) for part in np.split(scans, cuts)])
    return np.stack([se2.chain(part)[-1] for part in np.split(steps, first[1:])])


def _scan_after(m: Measurements, points: Points, scans: Ints) -> Array:
    """Return the pose of each scan's next scan relative to it, (k, 3): matched, else by the wheels."""
    u = points.moved(m.t[scans], m.t[scans + 1])
    readings, at = np.unique(np.concatenate((scans, scans + 1)), return_inverse=True)
    clouds = clouds_of(m, readings)
    i, j = at[: len(scans)], at[len(scans) :]
    found = match(Targets(clouds), i, sources_of(clouds), j, u, by_wheels(u))
    return np.where(good(found)[:, None], found.pose, u)


def turned_beyond_wheels(m: Measurements, a: int, b: int) -> float | None:
    """Return the turn from reading a to b by scan matching, minus the turn by the wheels [rad].

    None where they do not match.
    """
    if m.points is None or a < 0:
        return None
    u = m.points.moved(m.t[[a]], m.t[[b]])
    clouds = clouds_of(m, np.array([a, b]))
    found = next_scans(Targets(clouds), np.array([0]), sources_of(clouds), np.array([1]), u, by_wheels(u))
    return se2.wrap(float(found.pose[0, 2] - u[0, 2])) if good(found)[0] else None
