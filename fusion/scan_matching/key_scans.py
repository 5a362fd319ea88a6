"""Key scans along a drive, and matches with earlier key scans, computed once for all runs.

A match depends only on its two scans and the wheel odometry between them. So a causal filter at key b may use all
matches between keys up to b.
"""

from __future__ import annotations

from weakref import WeakKeyDictionary

import msgspec
import numpy as np
from numpy.typing import NDArray

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints, Measurements, Points, spaced

from .clouds import Clouds, clouds_of
from .match import Matches, Targets, match, sources_of
from .neighbours import REACH_M, SLIP_INLIERS, STEP_P, by_wheels, further_scans, good, scan_by_scan
from .solve import Edges

STRIDE_M, TURN_RAD = 0.5, np.radians(30.0)  # path length or turn between two keys
MATCH_WIDTH = 4.0  # sigmas, width of the robust kernel
FURTHER_STEPS = (2, 4)  # a key is matched with the next key and with the keys this many steps later
MAX_APART_M = 6.0  # largest distance of matched keys
MAX_TURN_RAD = np.radians(10.0)  # if the turns between two keys sum up to more, all scans between them are matched

_matched: WeakKeyDictionary[Points, KeyScans] = WeakKeyDictionary()


class KeyScans(msgspec.Struct, frozen=True):
    """Key scans (n) of a laser, and the matches among them."""

    t: Array  # (all readings,) s
    readings: Ints  # (n,) indices of the keys among the readings, increasing
    steps: Array  # (n - 1, 3) motion from key to key, by the match, else by the scans between, else by the wheels
    matches: Edges  # between keys


def key_scans(m: Measurements) -> KeyScans:
    """Return the key scans of a laser's readings; computed at the first call and cached."""
    assert m.points is not None
    known = _matched.get(m.points)
    if known is None or not np.array_equal(known.t, m.t):
        known = _matched[m.points] = _match_keys(m, m.points)
    return known


def _match_keys(m: Measurements, points: Points) -> KeyScans:
    u = points.moved(m.t[:-1], m.t[1:])
    way = np.append(0.0, np.cumsum(np.hypot(*u[:, :2].T)))
    heading = np.append(0.0, np.cumsum(u[:, 2]))
    readings = spaced((way, STRIDE_M), (heading, TURN_RAD))
    clouds = clouds_of(m, readings)
    targets, sources = Targets(clouds), sources_of(clouds)
    turned = np.append(0.0, np.cumsum(np.abs(u[:, 2])))
    i, matches, steps = _next(m, points, readings, np.diff(turned[readings]) > MAX_TURN_RAD, targets, sources)
    x = se2.chain(steps)
    found = [(i, matches), *(further_scans(targets, sources, x, n, MAX_APART_M) for n in FURTHER_STEPS)]
    i = np.concatenate([i for i, _ in found])
    j = i + np.repeat((1, *FURTHER_STEPS), [len(i) for i, _ in found])
    all_of = Matches.joined(*(matches for _, matches in found))
    return KeyScans(m.t, readings, steps, Edges.of(i, j, all_of.pose, all_of.information, MATCH_WIDTH))


def _next(
    m: Measurements, points: Points, readings: Ints, turns: NDArray[np.bool_], targets: Targets, sources: Clouds
) -> tuple[Ints, Matches, Array]:
    """Match every key with the next one; return indices of matched keys, matches, and all motions (n - 1, 3).

    If the robot `turns` (n - 1,), or two keys do not match directly, the scans between them are matched.
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
