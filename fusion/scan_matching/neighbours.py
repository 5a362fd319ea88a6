"""Matches of consecutive scans, starting from wheel odometry, with a search for wheel slips; key scans of a drive.

If the robot turns between two key scans, all scans between them are matched, each with the next one, since
consecutive scans show the same surfaces. After half a metre or half a turn, a point may be matched with a wrong
surface.
"""

from __future__ import annotations

from weakref import WeakKeyDictionary

import msgspec
import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints, Mask, Measurements, Points, spaced, totals

from .match import Clouds, Matches, Targets, clouds_of, match, sources_of
from .solve import Edges

MIN_INLIERS, MIN_OVERLAP, MAX_RMS_M = 0.6, 0.3, 0.05
MAX_SIGMA_RAD = np.radians(3.0)  # largest standard deviation of the heading of a reliable match
SLIPS_RAD = np.radians([-30.0, -24.0, -18.0, -12.0, -8.0, -4.0, 4.0, 8.0, 12.0, 18.0, 24.0, 30.0])
SLIP_INLIERS, SLIP_GAIN = 0.75, 0.1  # a slip is searched below this share of inliers; least increase by the slip
STEP_P = np.diag([0.05**2, 0.05**2, np.radians(1.0) ** 2])  # covariance of an initial pose, per step between scans
REACH_M = 0.3  # largest distance of matched points at such an initial pose
# prior information during the search for a slip
LOOSE_INFORMATION = np.diag([0.1**-2, 0.1**-2, np.radians(8.0) ** -2])
# standard deviations of wheel odometry between two scans, with slip: m; rad; share of the turn, added to rad
SLIP_M, SLIP_RAD, SLIP_SHARE = 0.1, np.radians(2.0), 0.1


def next_scans(targets: Targets, i: Ints, clouds: Clouds, j: Ints, wheels: Array, information: Array) -> Matches:
    """Match scans j (p,) with scans i, starting from wheel odometry (p, 3); if a match is bad, search for a slip.

    `information` (p, 3, 3) is that of the wheel odometry, in the frame of i.
    """
    found = match(targets, i, clouds, j, wheels, information)
    bad = np.flatnonzero(found.inliers < SLIP_INLIERS)
    if not len(bad):
        return found
    again, tries = np.repeat(bad, len(SLIPS_RAD)), np.tile(SLIPS_RAD, len(bad))
    guess = wheels[again] + np.outer(tries, (0.0, 0.0, 1.0))
    prior = np.broadcast_to(LOOSE_INFORMATION, (len(again), 3, 3))
    slips = match(targets, i[again], clouds, j[again], guess, prior)
    score = (slips.inliers * (slips.overlap > MIN_OVERLAP)).reshape(len(bad), -1)
    best = score.argmax(axis=1)
    take = score.max(axis=1) > found.inliers[bad] + SLIP_GAIN
    chosen = np.arange(len(bad)) * len(SLIPS_RAD) + best
    found.put(bad[take], slips.take(chosen[take]))
    return found


def further_scans(targets: Targets, clouds: Clouds, x: Array, n: int, apart: float) -> tuple[Ints, Matches]:
    """Match every scan with the n-th scan before it, if nearer than `apart` [m]; keep reliable matches.

    Return the indices of the earlier scans, and the matches. `x` (k, 3) are poses from matches over fewer steps.
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
    """Return the information matrices (n, 3, 3) of wheel odometry for motions `moved` (n, 3) between scans."""
    information = np.zeros((len(moved), 3, 3))
    information[:, 0, 0] = information[:, 1, 1] = SLIP_M**-2
    information[:, 2, 2] = 1.0 / (SLIP_RAD**2 + (SLIP_SHARE * moved[:, 2]) ** 2)
    return information


def good(found: Matches) -> Mask:
    """Return flags (p,) of the reliable matches, by inliers, overlap, residuals and heading uncertainty."""
    fits = (found.inliers > MIN_INLIERS) & (found.overlap > MIN_OVERLAP) & (found.rms < MAX_RMS_M)
    return np.asarray(fits & (found.information[:, 2, 2] > MAX_SIGMA_RAD**-2))


SCANS_AT_ONCE = 1024  # scans whose points are in memory at once


def scan_by_scan(m: Measurements, points: Points, begin: Ints, end: Ints) -> Array:
    """Return the poses (n, 3) of readings `end` relative to earlier readings `begin`, (n,) indices each.

    All scans in between are matched, each with the next one. For a step without a reliable match, wheel odometry
    is used.
    """
    counts = end - begin
    first, steps = np.cumsum(counts) - counts, []
    every = np.arange(counts.sum()) + np.repeat(begin - first, counts)
    for scans in np.split(every, np.arange(SCANS_AT_ONCE, len(every), SCANS_AT_ONCE)):
        u = points.moved(m.t[scans], m.t[scans + 1])
        readings, at = np.unique(np.concatenate((scans, scans + 1)), return_inverse=True)
        clouds = clouds_of(m, readings)
        i, j = at[: len(scans)], at[len(scans) :]
        found = match(Targets(clouds), i, sources_of(clouds), j, u, by_wheels(u))
        steps.append(np.where(good(found)[:, None], found.pose, u))
    return np.stack([se2.chain(part)[-1] for part in np.split(np.concatenate(steps), first[1:])])


_beyond: WeakKeyDictionary[Points, dict[tuple[int, int, float, float], Array | None]] = WeakKeyDictionary()


def beyond_wheels(m: Measurements, a: int, b: int) -> Array | None:
    """Return the motion from reading a to b by scan matching, minus that by the wheels, (3,) m, m, rad.

    It is in the frame of reading a; None without a reliable match. All runs share the result, since it depends on
    no pose.
    """
    if m.points is None or a < 0:
        return None
    known, key = _beyond.setdefault(m.points, {}), (a, b, float(m.t[a]), float(m.t[b]))
    if key not in known:
        u, clouds = m.points.moved(m.t[[a]], m.t[[b]]), clouds_of(m, np.array([a, b]))
        found = next_scans(Targets(clouds), np.array([0]), sources_of(clouds), np.array([1]), u, by_wheels(u))
        known[key] = se2.difference(found.pose, u)[0] if good(found)[0] else None
    return known[key]


# ---- key scans along a drive, and their matches with earlier key scans, computed once for all runs ----
#
# A match depends only on its two scans and the wheel odometry between them. So a causal filter at key b may use
# all matches between keys up to b.

STRIDE_M, TURN_RAD = 0.5, np.radians(30.0)  # path length or turn from one key to the next
MATCH_WIDTH = 4.0  # sigmas, width of the robust kernel
FURTHER_STEPS = (2, 4)  # a key is matched with the next key and with the keys this many steps later
MAX_APART_M = 6.0  # largest distance of matched keys
MAX_TURN_RAD = np.radians(10.0)  # if the turns between two keys sum to more, all scans between are matched

_matched: WeakKeyDictionary[Points, KeyScans] = WeakKeyDictionary()


class KeyScans(msgspec.Struct, frozen=True):
    """Key scans (n) of a laser, and the matches among them."""

    t: Array  # (all readings,) s
    readings: Ints  # (n,) indices of the keys among the readings, increasing
    steps: Array  # (n - 1, 3) motion from key to key: by the match, the scans between, or the wheels
    matches: Edges  # between keys


def key_scans(m: Measurements) -> KeyScans:
    """Return the key scans among a laser's readings; they are computed once and cached."""
    points = m.points
    assert points is not None
    known = _matched.get(points)
    if known is not None and np.array_equal(known.t, m.t):
        return known
    u = points.moved(m.t[:-1], m.t[1:])
    distance = totals(np.hypot(*u[:, :2].T))
    heading = totals(u[:, 2])
    readings = spaced((distance, STRIDE_M), (heading, TURN_RAD))
    clouds = clouds_of(m, readings)
    targets, sources = Targets(clouds), sources_of(clouds)
    turned = totals(np.abs(u[:, 2]))
    i, matches, steps = _next(m, points, readings, np.diff(turned[readings]) > MAX_TURN_RAD, targets, sources)
    x = se2.chain(steps)
    found = [(i, matches), *(further_scans(targets, sources, x, n, MAX_APART_M) for n in FURTHER_STEPS)]
    i = np.concatenate([i for i, _ in found])
    j = i + np.repeat((1, *FURTHER_STEPS), [len(i) for i, _ in found])
    all_of = Matches.joined(*(matches for _, matches in found))
    edges = Edges.of(i, j, all_of.pose, all_of.information, MATCH_WIDTH)
    known = _matched[points] = KeyScans(m.t, readings, steps, edges)
    return known


def _next(
    m: Measurements, points: Points, readings: Ints, turns: Mask, targets: Targets, sources: Clouds
) -> tuple[Ints, Matches, Array]:
    """Match every key with the next one; return indices of matched keys, matches, and all motions (n - 1, 3).

    If the robot turns (`turns` (n - 1,)), or two keys do not match directly, the scans between them are matched.
    """
    steps = points.moved(m.t[readings[:-1]], m.t[readings[1:]])
    i = np.flatnonzero(np.hypot(*steps[:, :2].T) < MAX_APART_M)
    matches = match(targets, i, sources, i + 1, steps[i], by_wheels(steps[i]))
    doubtful = np.flatnonzero(turns[i] | ~good(matches) | (matches.inliers < SLIP_INLIERS))
    if len(doubtful):
        k = i[doubtful]
        steps[k] = scan_by_scan(m, points, readings[k], readings[k + 1])
        prior = np.broadcast_to(np.linalg.inv(STEP_P), (len(k), 3, 3))
        again = match(targets, k, sources, k + 1, steps[k], prior, REACH_M)
        matches.put(doubtful, again)
    reliable = good(matches)
    steps[i[reliable]] = matches.pose[reliable]
    return i[reliable], matches.take(reliable), steps
