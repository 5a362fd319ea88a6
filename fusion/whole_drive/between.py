"""The scans between two key poses: each is matched with both keys, and wheels and matches are smoothed together.

The keys stay where the graph put them. Between two of them the wheels' error is a random walk of small rigid
motions xi about the key before (see fusion.whole_drive.bridge), known at both ends; every scan says what it is on
the way. Forward and backward over the scans, all spans at once (Rauch, Tung and Striebel 1965).
"""

from __future__ import annotations

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Drive, Ints, Measurements
from locfuse.fusion.scan_matching.clouds import Clouds, clouds_of, merged
from locfuse.fusion.scan_matching.match import Matches, Targets, match, sources_of
from locfuse.fusion.scan_matching.neighbours import good

from .bridge import Fixes, Spans
from .odometry import Odometry, moved

GAP_S = 0.09  # between two scans that are matched: more often says little new
SCANS_AT_ONCE = 1024  # whose points are held before they are thinned
REST_S = 1.0  # a robot at rest for so long before and after a scan is where it was: wheels' stamps may be late
MAX_POINTS = 90  # of one scan that are matched
PRIOR_INFORMATION = np.diag([0.1**-2, 0.1**-2, np.radians(4.0) ** -2])  # holds a match where the walls say nothing
REACH_M = 0.4
ROUND_COUNT = 2  # a scan that fits badly is asked again from where its neighbours say that it is
STEP_P = np.diag(
    [0.002**2, 0.002**2, np.radians(0.1) ** 2]
)  # from scan to scan, even at rest: stamps are not exact
KEY_INFORMATION = np.diag([1e10, 1e10, 1e12])  # 1/m^2, 1/rad^2: information of the next key


def scans_between(
    odometry: Odometry, drive: Drive, sensor: str, readings: Ints, clouds: Clouds, x: Array
) -> Fixes:
    """Return what the wheels miss at the scans between the keys `readings` (m,), whose poses are x (m, 3).

    `clouds` are the keys'.
    """
    m, instants = drive.measurements[sensor], drive.instant[sensor]
    keys = instants[readings]
    ends = Fixes.of_keys(odometry, keys, x)
    chosen = moving_scans(odometry, drive.t, instants, readings)
    if not len(chosen):
        return ends
    k = instants[chosen]
    spans = Spans.of(odometry, odometry.at(k), k, keys)
    targets, sources = Targets(both_ends(clouds, x)), points_of(m, chosen)
    xi, information = np.zeros((len(k), 3)), np.zeros((len(k), 3, 3))
    fixes, asked = ends, np.arange(len(k))
    for _ in range(ROUND_COUNT):
        guess = fixes.at(odometry, k[asked], spans.take(asked))[0]
        u = spans.u[asked]
        prior = np.broadcast_to(PRIOR_INFORMATION, (len(asked), 3, 3))
        found = match(targets, spans.a[asked], sources, asked, se2.compose(guess, u), prior, REACH_M)
        xi[asked], information[asked] = said(found, u, guess)
        fixes = smoothed(odometry, ends, spans.a, k, xi, information)
        asked = np.flatnonzero(information[:, 2, 2] == 0.0)
        if not len(asked):
            break
    return fixes


def moving_scans(odometry: Odometry, t: Array, instants: Ints, readings: Ints) -> Ints:
    """Return the readings between the first and the last key about which the robot moved: positions.

    t (N,) are the stamps of all instants [s].
    """
    way, turned = odometry.way(), np.append(0.0, np.cumsum(np.abs(np.diff(odometry.pose[:, 2]))))
    before = np.searchsorted(t, t[instants] - REST_S)
    after = np.searchsorted(t, t[instants] + REST_S, side="right") - 1
    moved = (way[after] > way[before]) | (turned[after] > turned[before])
    moved[readings], moved[: readings[0]], moved[readings[-1] :] = False, False, False
    chosen, last = [], -np.inf
    for i in np.flatnonzero(moved).tolist():
        if t[instants[i]] - last >= GAP_S:
            chosen.append(i)
            last = t[instants[i]]
    return np.array(chosen, dtype=np.int64)


def points_of(m: Measurements, chosen: Ints) -> Clouds:
    """Return the points of these readings that are matched, read in parts so that few whole scans are held."""
    cuts = np.arange(SCANS_AT_ONCE, len(chosen), SCANS_AT_ONCE)
    parts = [sources_of(clouds_of(m, part), MAX_POINTS) for part in np.split(chosen, cuts)]
    counts = np.concatenate([np.diff(part.first) for part in parts])
    first = np.concatenate(([0], np.cumsum(counts)))
    return Clouds(
        first, np.concatenate([part.xy for part in parts]), np.concatenate([part.normal for part in parts])
    )


def both_ends(clouds: Clouds, x: Array) -> Clouds:
    """Return for every key but the last its points and those of the next one, in its frame."""
    a = np.arange(len(x) - 1)
    steps = se2.between(x[:-1], x[1:])
    return merged(
        clouds, [np.array([k, k + 1]) for k in a.tolist()], [np.vstack((np.zeros(3), step)) for step in steps]
    )


def said(found: Matches, u: Array, guess: Array) -> tuple[Array, Array]:
    """Return the matches as errors xi (n, 3) of the wheels' ways u (n, 3), and their information (n, 3, 3)."""
    xi = se2.compose(found.pose, se2.inverse(u))
    xi[:, 2] = guess[:, 2] + se2.wrap_all(xi[:, 2] - guess[:, 2])
    L = np.broadcast_to(np.eye(3), (len(u), 3, 3)).copy()
    L[:, 0, 2], L[:, 1, 2] = -u[:, 1], u[:, 0]
    return xi, np.where(good(found)[:, None, None], L.transpose(0, 2, 1) @ found.information @ L, 0.0)


def smoothed(odometry: Odometry, ends: Fixes, a: Ints, k: Ints, xi: Array, information: Array) -> Fixes:
    """Return smoothed poses of the keys and of the scans at instants k (n,), each between keys a (n,) and a + 1.

    xi (n, 3) with `information` (n, 3, 3) is what each scan says.
    """
    order = np.lexsort((np.concatenate((ends.instant, k)), np.concatenate((ends.a, a))))
    a, k = np.concatenate((ends.a, a))[order], np.concatenate((ends.instant, k))[order]
    z = np.concatenate((ends.xi, xi))[order]
    L = np.concatenate((np.broadcast_to(KEY_INFORMATION, (len(ends.a), 3, 3)), information))[order]
    starts = np.flatnonzero(np.diff(a, prepend=-1))
    home = se2.inverse(odometry.pose[k[starts]])[np.searchsorted(a[starts], a)]
    Q = moved(np.diff(odometry.C[k], axis=0, prepend=odometry.C[k[:1]]), home) + STEP_P
    lengths = np.diff(np.append(starts, len(a)))
    mean, V = z.copy(), np.zeros((len(a), 3, 3))
    for step in range(1, int(lengths.max())):
        at = starts[lengths > step] + step
        ahead = V[at - 1] + Q[at]
        V[at] = _symmetric(np.linalg.solve(np.eye(3) + ahead @ L[at], ahead))
        gain = V[at] @ L[at]
        mean[at] = mean[at - 1] + np.einsum("nij,nj->ni", gain, z[at] - mean[at - 1])
    for step in range(int(lengths.max()) - 2, 0, -1):
        at = starts[lengths > step + 1] + step
        ahead = V[at] + Q[at + 1]
        G = V[at] @ np.linalg.inv(ahead)
        mean[at] += np.einsum("nij,nj->ni", G, mean[at + 1] - mean[at])
        V[at] = _symmetric(V[at] + G @ (V[at + 1] - ahead) @ G.transpose(0, 2, 1))
    return Fixes(a, k, mean, V)


def _symmetric(P: Array) -> Array:
    return 0.5 * (P + P.transpose(0, 2, 1))
