"""Key scans along a drive, and how each lies to those before it: matched once, however many runs ask.

A match knows its two scans and the wheels between them, nothing else: a filter that has come to key b may use all
matches among the keys up to b.
"""

from __future__ import annotations

from weakref import WeakKeyDictionary

import msgspec
import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints, Measurements, Points

from .clouds import clouds_of
from .match import Matches, Targets, sources_of
from .neighbours import further_scans, good, next_scans

STRIDE_M, TURN_RAD = 0.5, np.radians(30.0)  # between two keys
FURTHER_STEPS = (2, 4)  # keys further on that a key is matched with, beside the next one
MAX_APART_M = 6.0
BY_WHEELS = np.diag([0.1**-2, 0.1**-2, np.radians(2.0) ** -2])  # information of their way from key to key: slips

_matched: WeakKeyDictionary[Points, KeyScans] = WeakKeyDictionary()


class KeyScans(msgspec.Struct, frozen=True):
    """n keys and p matches among them."""

    t: Array  # (all readings,) s, when they were taken
    readings: Ints  # (n,) which of them are keys, increasing
    steps: Array  # (n - 1, 3) from key to key, by the match or else by the wheels
    i: Ints  # (p,) the earlier key of a match
    j: Ints  # (p,)
    pose: Array  # (p, 3) key j seen from key i
    information: Array  # (p, 3, 3) in the frame of key i

    def among(self, first: int, last: int) -> Ints:
        """Return which matches are among the keys from `first` to `last`."""
        return np.flatnonzero((self.i >= first) & (self.j <= last))

    def at(self, reading: int) -> int | None:
        """Return which key a reading is, None where it is none."""
        k = int(np.searchsorted(self.readings, reading))
        return k if k < len(self.readings) and self.readings[k] == reading else None


def key_scans(m: Measurements) -> KeyScans:
    """Return the key scans of a laser's readings, matched at the first call."""
    assert m.points is not None
    known = _matched.get(m.points)
    if known is None or not np.array_equal(known.t, m.t):
        known = _matched[m.points] = _made(m, m.points)
    return known


def spaced(way: Array, heading: Array, stride: float, turn: float) -> Ints:
    """Return which of n poses come `stride` [m] of way or `turn` [rad] after the one before."""
    chosen, last_way, last_heading = [], -np.inf, 0.0
    for k, (s, theta) in enumerate(zip(way.tolist(), heading.tolist(), strict=True)):
        if s - last_way >= stride or abs(theta - last_heading) >= turn:
            chosen.append(k)
            last_way, last_heading = s, theta
    return np.array(chosen, dtype=np.int64)


def _made(m: Measurements, points: Points) -> KeyScans:
    by_wheels = points.moved(m.t[:-1], m.t[1:])
    way = np.append(0.0, np.cumsum(np.hypot(*by_wheels[:, :2].T)))
    heading = np.append(0.0, np.cumsum(by_wheels[:, 2]))
    readings = spaced(way, heading, STRIDE_M, TURN_RAD)
    clouds = clouds_of(m, readings)
    targets, sources = Targets(clouds), sources_of(clouds)
    steps = points.moved(m.t[readings[:-1]], m.t[readings[1:]])
    i = np.arange(len(steps))
    near = np.hypot(*steps[:, :2].T) < MAX_APART_M
    i, guess = i[near], steps[near]
    prior = np.broadcast_to(BY_WHEELS, (len(i), 3, 3))
    matches = next_scans(targets, i, sources, i + 1, guess, prior)
    sure = good(matches)
    i, matches = i[sure], matches.take(sure)
    steps[i] = matches.pose
    x = se2.chain(steps)
    found = [(i, matches), *(further_scans(targets, sources, x, n, MAX_APART_M) for n in FURTHER_STEPS)]
    i = np.concatenate([i for i, _ in found])
    j = i + np.repeat((1, *FURTHER_STEPS), [len(i) for i, _ in found])
    all_of = Matches.joined([matches for _, matches in found])
    return KeyScans(m.t, readings, steps, i, j, all_of.pose, all_of.information)
