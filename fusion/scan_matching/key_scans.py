"""Key scans along a drive, and how each lies to those before it: matched once, however many runs ask.

A match knows its two scans and the wheels between them, nothing else: a filter that has come to key b may use all
matches among the keys up to b.
"""

from __future__ import annotations

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints, Measurements, Points

from .clouds import clouds_of
from .match import Matches, Targets, match, sources_of
from .neighbours import good, next_scans

STRIDE_M, TURN_RAD = 0.5, np.radians(30.0)  # between two keys
STEPS = (1, 2, 4)  # keys back that a key is matched with
MAX_APART_M = 6.0
REACH_M = 0.3
BY_WHEELS = np.diag([0.1**-2, 0.1**-2, np.radians(2.0) ** -2])  # information of their way from key to key: slips
BY_MATCHES = np.diag([0.05**-2, 0.05**-2, np.radians(1.0) ** -2])  # per step, of a guess that matches led to

_matched: WeakKeyDictionary[Points, KeyScans] = WeakKeyDictionary()


@dataclass(frozen=True)
class KeyScans:
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
    found: list[tuple[Ints, Ints, Matches]] = []
    for n in STEPS:
        i = np.arange(max(len(readings) - n, 0))
        x = se2.chain(steps)
        guess = se2.between(x[i], x[i + n])
        near = np.hypot(*guess[:, :2].T) < MAX_APART_M
        i, guess = i[near], guess[near]
        prior = BY_WHEELS if n == 1 else BY_MATCHES / n
        prior = np.broadcast_to(prior, (len(i), 3, 3))
        if n == 1:
            matches = next_scans(targets, i, sources, i + n, guess, prior)
        else:
            matches = match(targets, i, sources, i + n, guess, prior, REACH_M)
        sure = good(matches)
        if n == 1:
            steps[i[sure]] = matches.pose[sure]
        found.append((i[sure], i[sure] + n, matches.take(sure)))
    all_of = Matches.joined([matches for _, _, matches in found])
    i, j = (np.concatenate([pair[side] for pair in found]) for side in (0, 1))
    return KeyScans(m.t, readings, steps, i, j, all_of.pose, all_of.information)
