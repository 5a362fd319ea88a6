"""Where a map is left, by matching the scans along the way through it: one measurement of the pose in the map.

A small map and the pose in it drift together where few walls are long, or clutter is taken for walls. A chain of
matched scans, in which all that was seen counts, tells the way better. It is taken in where the map is left: the
next map then begins where both say. The variances of the pose have grown before by what no filter counts
(tracker.LESS_SURE), since the lines and the matches are of the same scans.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.chi_square import chi_square
from locfuse.fusion.data import Array, Ints, Measurements, Points
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.mount import Mount
from locfuse.fusion.scan_matching.clouds import clouds_of
from locfuse.fusion.scan_matching.key_scans import key_scans
from locfuse.fusion.scan_matching.match import Matches, Targets, sources_of
from locfuse.fusion.scan_matching.neighbours import by_wheels, good, next_scans
from locfuse.fusion.sensor import Equation, Innovation

from .anchors import Anchors, Edge

MOST_KEYS = 100  # along a way: a map in which the robot stayed longer holds together better than its chain
ENDS = 2  # keys that either end is matched with
GATE = chi_square(0.999, 3)
WIDTHS = (40.0, 4.0)  # sigmas beyond which a match loses its weight, round by round
# rad per metre, 1 sigma: the heading of matched scans drifts with the way, since a laser looks a little down, or
# its angles are not quite what it says. On two real robots it was 0.05 degrees
BEND = np.radians(0.05)
SMALL = 1e-6  # m, rad: step of a numerical derivative


class WayByScans:
    """The way through one map, from the reading with which it began."""

    def __init__(self, m: Measurements, reading: int) -> None:
        self._m, self._began = m, reading

    def end(self, reading: int, origin: Array, mount: Mount | None, belief: JointBelief) -> None:
        """Correct the belief by the matches between the map's first reading and this one.

        `origin` (3,) is the pose in the map with which it began.
        """
        points = self._m.points
        way = None if points is None else way_between(self._m, points, self._began, reading)
        if way is None:
            return
        z, R = told(way)
        equation = compared(z, R, origin, mount, belief)
        S = equation.H @ belief.covariance[np.ix_(equation.columns, equation.columns)] @ equation.H.T + R
        worse = float(equation.y @ np.linalg.solve(S, equation.y)) / 3.0
        if worse > GATE / 3.0:  # both claim too little: the variance factor, as in Anchors.loosen
            belief.loosen(np.arange(3), (worse - 1.0) * np.diagonal(belief.matrix()))
            equation = equation._replace(R=worse * R)
        belief.correct([_innovation(equation)])


class Matched(NamedTuple):
    """n + 1 scans along a way, the first and the last where a map began and ends, and p matches among them."""

    steps: Array  # (n, 3) from scan to scan, by the match or else by the wheels
    i: Ints  # (p,) the earlier scan of a match
    j: Ints  # (p,)
    pose: Array  # (p, 3) scan j seen from scan i
    information: Array  # (p, 3, 3) in the frame of scan i


def way_between(m: Measurements, points: Points, begin: int, end: int) -> Matched | None:
    """Return the way from one reading to another: both, and the key scans between them.

    None where there are few keys, or very many. The two ends are matched with the keys next to them.
    """
    keys = key_scans(m)
    first, last = np.searchsorted(keys.readings, (begin + 1, end)).tolist()
    if not 2 * ENDS <= last - first <= MOST_KEYS:
        return None
    readings = np.concatenate(([begin], keys.readings[first:last], [end]))
    u = points.moved(m.t[readings[:-1]], m.t[readings[1:]])
    steps = np.concatenate((u[:1], keys.steps[first : last - 1], u[-1:]))
    i, j, ends = _ends(m, readings, steps)
    among = keys.among(first, last - 1)
    return Matched(
        steps,
        np.concatenate((keys.i[among] - first + 1, i)),
        np.concatenate((keys.j[among] - first + 1, j)),
        np.concatenate((keys.pose[among], ends.pose)),
        np.concatenate((keys.information[among], ends.information)),
    )


def _ends(m: Measurements, readings: Ints, steps: Array) -> tuple[Ints, Ints, Matches]:
    """Match the first and the last of n + 1 readings with those next to them: which with which, and the matches.

    `steps` (n, 3) lead from each to the next.
    """
    n, beside = len(steps), np.arange(1, ENDS + 1)
    i = np.concatenate((np.zeros(ENDS, np.int64), n - beside))
    j = np.concatenate((beside, np.full(ENDS, n)))
    x = se2.chain(steps)
    guess = se2.between(x[i], x[j])
    some, at = np.unique(np.concatenate((i, j)), return_inverse=True)
    clouds = clouds_of(m, readings[some])
    found = next_scans(Targets(clouds), at[: len(i)], sources_of(clouds), at[len(i) :], guess, by_wheels(guess))
    sure = good(found)
    return i[sure], j[sure], found.take(sure)


def told(way: Matched) -> tuple[Array, Array]:
    """Return the last scan of a way seen from the first, (3,), and its covariance (3, 3), by all matches.

    Matches that contradict the others count less and less (WIDTHS, a Geman-McClure kernel).
    """
    steps, i, j, pose, information = way
    graph = _solved(steps, i, j, pose, information)
    for width in WIDTHS:
        weights = _weights(graph.errors()[1 + len(steps) :], information, width)
        graph = _solved(steps, i, j, pose, weights[:, None, None] * information)
    z, R = graph.relative(0, len(steps))
    bend = _bent(graph.pose) - z
    return z, R + np.outer(bend, bend)


def _solved(steps: Array, i: Ints, j: Ints, pose: Array, information: Array) -> Anchors:
    """Return the keys as anchors, held by steps (n, 3) loosely and by matches (p, 3) of keys j seen from i."""
    graph, loose = Anchors(), np.linalg.inv(by_wheels(steps))
    graph.first(np.zeros(3), np.zeros((3, 3)))
    for n, step in enumerate(steps):
        graph.next(n, step, loose[n])
    for of, to, z, L in zip(i.tolist(), j.tolist(), pose, information, strict=True):
        graph.add(Edge(of, to, z, L))
    graph.solve()
    return graph


def _weights(e: Array, information: Array, width: float) -> Array:
    chi2 = np.einsum("ni,nij,nj->n", e, information, e)
    weights: Array = (width**2 / (width**2 + chi2)) ** 2
    return weights


def _bent(x: Array) -> Array:
    """Return where a way of poses x (n, 3) ends if all its headings drift by BEND from metre to metre."""
    steps = se2.between(x[:-1], x[1:])
    steps[:, 2] += BEND * np.hypot(steps[:, 0], steps[:, 1])
    return np.asarray(se2.compose(x[0], se2.chain(steps)[-1]))


def compared(z: Array, R: Array, origin: Array, mount: Mount | None, belief: JointBelief) -> Equation:
    """Return what a way z (3,) from `origin` by the scans, with covariance R, says of the pose and the mount.

    The scans say it of a base on which the laser sits as told, which may not be as the belief has it.
    """
    free, columns = ([], ()) if mount is None else (list(mount.free), mount.columns(belief))
    place, sits = np.array(belief.pose()), np.zeros(3) if mount is None else np.array(mount.now(belief))
    told = np.zeros(3) if mount is None else np.array(mount.told)

    def way(x: Array) -> Array:
        now = sits.copy()
        now[free] = x[3:]
        aside = se2.compose(now, se2.inverse(told))
        return se2.between(aside, se2.compose(se2.between(origin, x[:3]), aside))

    x = np.append(place, sits[free])
    H = np.stack([(way(x + d) - way(x - d)) / (2.0 * SMALL) for d in SMALL * np.eye(len(x))], axis=-1)
    y = z - way(x)
    y[2] = se2.wrap(float(y[2]))
    return Equation(y, np.array((0, 1, 2, *columns)), H, R)


def _innovation(equation: Equation) -> Innovation:
    y, columns, H, R = (tuple(part.tolist()) for part in equation)
    return Innovation.of_states(y, R, columns, H)
