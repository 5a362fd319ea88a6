"""Key poses without loop closures: wheel odometry and matches of neighbouring key scans."""

from __future__ import annotations

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints
from locfuse.fusion.scan_matching.clouds import Clouds
from locfuse.fusion.scan_matching.match import Matches, Targets, match
from locfuse.fusion.scan_matching.neighbours import further_scans, good, next_scans
from locfuse.fusion.scan_matching.solve import Edges, Problem

from .odometry import Odometry, by_lever

WHEEL_FLOOR_P = np.diag([0.005**2, 0.005**2, np.radians(0.3) ** 2])  # m^2, rad^2: added for uneven floors
# sideways error per distance: with a mount yaw error of 2 degrees, the laser measures sideways motion
SIDEWAYS_SHARE = 0.04
WHEEL_WIDTH_SIGMAS = 3.0  # width of the robust kernel: wheel slips are outliers
SCAN_WIDTH_SIGMAS = 4.0
NEIGHBOUR_STEPS = (2, 3, 5, 8)  # a key is matched with the next key and with the keys this many steps later
MAX_NEIGHBOUR_M = 5.0
# factor on the information of matches: errors of neighbouring scans are correlated
INFORMATION_SHARE = 0.5
# matches of a key with earlier visits: their number, least path length between them, largest distance
MAX_VISITS_AGAIN, MIN_WAY_M, MAX_AGAIN_M = 2, 5.0, 2.5


def wheel_edges(odometry: Odometry, instants: Ints) -> Edges:
    """Return graph edges from each key pose to the next by wheel odometry, at update times `instants` (n,)."""
    a = np.arange(len(instants) - 1)
    u, C = odometry.between(instants[:-1], instants[1:])
    Q = by_lever(C, -u[:, 1], u[:, 0]) + WHEEL_FLOOR_P
    aside = SIDEWAYS_SHARE * np.hypot(u[:, 0], u[:, 1])
    Q[:, [0, 1], [0, 1]] += np.square(aside)[:, None]
    edges = Edges.of(a, a + 1, u, np.asarray(np.linalg.inv(Q), np.float64), WHEEL_WIDTH_SIGMAS)
    edges.by[:, 1, 1] = u[:, 0]
    return edges


def edges_of(i: Ints, j: Ints, found: Matches, way: Array | None = None) -> Edges:
    """Convert matches of scans i and j to graph edges.

    If the path lengths `way` (n,) [m] are given, the edges allow for a heading drift proportional to path length.
    """
    edges = Edges.of(i, j, found.alone, INFORMATION_SHARE * found.information, SCAN_WIDTH_SIGMAS)
    if way is not None:
        edges.by[:, 2, 0] = way[j] - way[i]
    return edges


def sequential(
    targets: Targets, clouds: Clouds, wheels: Edges, way: Array, problem: Problem
) -> tuple[Array, Edges]:
    """Return the key poses (n, 3) without loop closures, and the graph edges of the wheels and the scans."""
    found = next_scans(targets, wheels.i, clouds, wheels.j, wheels.z, wheels.information)
    reliable = good(found)
    step = np.where(reliable[:, None], found.pose, wheels.z)
    x = se2.compose(problem.start.z[0], se2.chain(step))
    scans = edges_of(wheels.i, wheels.j, found, way).take(reliable)
    x, _ = problem.solve(x, Edges.joined(wheels, scans), (100.0, 1.0))
    further = []
    for n in NEIGHBOUR_STEPS:
        i, found = further_scans(targets, clouds, x, n, MAX_NEIGHBOUR_M)
        further.append(edges_of(i, i + n, found, way))
    edges = Edges.joined(wheels, scans, *further)
    x, _ = problem.solve(x, edges, (100.0, 1.0))
    return x, edges


def again(targets: Targets, clouds: Clouds, x: Array, way: Array) -> Edges:
    """Match each key scan with nearby key scans of earlier visits, after loop closure (Lu and Milios 1997)."""
    from scipy.spatial import cKDTree

    near = cKDTree(x[:, :2]).query_ball_point(x[:, :2], MAX_AGAIN_M, return_sorted=True)
    pairs = []
    for j, others in enumerate(near):
        i = np.array([k for k in others if way[j] - way[k] > MIN_WAY_M], dtype=np.int64)
        i = i[np.argsort(np.hypot(*(x[i, :2] - x[j, :2]).T), kind="stable")]
        visits: list[int] = []
        for k in i.tolist():
            if len(visits) < MAX_VISITS_AGAIN and all(abs(way[k] - way[v]) > MIN_WAY_M for v in visits):
                visits.append(k)
        pairs += [(k, j) for k in visits]
    if not pairs:
        return Edges.none()
    i, j = np.array(pairs, dtype=np.int64).T
    guess = se2.between(x[i], x[j])
    prior = np.linalg.inv(np.diag([0.1**2, 0.1**2, np.radians(2.0) ** 2]))
    found = match(targets, i, clouds, j, guess, np.broadcast_to(prior, (len(i), 3, 3)), 0.3)
    return edges_of(i, j, found).take(good(found))
