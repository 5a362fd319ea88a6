"""Pose-graph optimisation of a whole drive: key poses, scan matches, loop closures, all other poses, walls.

choose keys -> edges by wheels and neighbouring scans -> loop closures in rounds -> matches with all earlier visits
-> solve -> interpolate the poses between the keys -> merge the walls that the key scans see

If the filter did not recognise a place at once, its map has the walls there twice. The graph's map has them once.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import msgspec
import numpy as np
from msgspec.structs import replace

from locfuse.fusion import se2
from locfuse.fusion.checks.clocks import clock_lags
from locfuse.fusion.checks.lag import worth_saying
from locfuse.fusion.data import LASER, Array, Drive, Estimates, Ints, MapLine, Measurements, evenly, spaced
from locfuse.fusion.mount import found_mount
from locfuse.fusion.robot import Robot
from locfuse.fusion.scan_matching.match import Clouds, Matches, Targets, clouds_of, match, sources_of
from locfuse.fusion.scan_matching.neighbours import further_scans, good, next_scans
from locfuse.fusion.scan_matching.solve import Edges, Normal, Problem
from locfuse.fusion.statistics import robust_sigma
from locfuse.fusion.wheels.motion import WHEELS

from .closures import KERNEL_WIDTH_FACTORS, Loops, close, recognised, submaps_of
from .odometry import Odometry, OdometryErrors, add_lever_arm, bridged, errors_at_scans, odometry_of
from .others import Others

MIN_KEYS = 10
KEY_DISTANCE_M, KEY_TURN_RAD = 0.5, np.radians(20.0)  # path length or turn between two keys
START_FLOOR_P = np.diag([1e-4**2, 1e-4**2, 1e-5**2])  # m^2, rad^2: least covariance of the start pose
MAX_STRAIGHT_RAD = np.radians(5.0)  # largest turn between two keys that counts as driving straight
SPAN_GAP_S = 30.0  # closures further apart in time are listed separately
MAX_EXTENT_VIEWS = 1.5  # a drive whose extent is at most this many scan ranges needs no loop closure
SAMPLE_SCANS = 20
FAR_SHARE = 0.95  # the range of a scan is this quantile of its points' distances
# the graph is used if the filter's loop error is larger by this factor and offset
MIN_GAIN, MIN_GAIN_M = 1.5, 0.01


class Graph(msgspec.Struct, frozen=True, dict=True):
    """Solved pose graph of a drive: key poses, loop closures, and the data to interpolate all other poses."""

    drive: Drive
    configured_mount: Array  # (3,) laser on the base: x, y [m], yaw [rad]
    mount: Array  # (3,) laser mount used here: the filter's estimate if it has one
    start: GraphStart
    odometry: Odometry  # with added variance for slips and uneven floors
    readings: Ints  # (m,) indices of the key scans among the laser's readings
    x: Array  # (m, 3) key poses in the map
    errors: OdometryErrors  # odometry errors between the key poses
    normal: Normal  # normal equations at the key poses
    loops: Loops
    lag: float  # s, delay of the wheels' clock that was corrected
    wheels: Array | None  # (3,) corrections of both wheel radii and the track; None if not estimated

    @cached_property
    def keys(self) -> Ints:
        """Return the indices of the update times of the key poses, (m,)."""
        return self.drive.instant[LASER][self.readings]

    @property
    def closures(self) -> Edges:
        """Return the loop closures as edges between key poses."""
        return self.loops.edges

    def poses(self) -> tuple[Array, Array]:
        """Return pose (n, 3) and covariance (n, 3, 3) at every update time of the drive."""
        return self._between(self.odometry, np.arange(len(self.drive.t)))

    def at_truth(self) -> tuple[Array | None, Array | None]:
        """Return pose (q, 3) and covariance (q, 3, 3) at the stamps of the ground truth; NaN outside the drive."""
        return self.drive.at_truth(lambda k, u: self._between(self.odometry.grown(k, u, self.wheels), k))

    def _between(self, stamps: Odometry, k: Ints) -> tuple[Array, Array]:
        return bridged(self.odometry, stamps, k, *self._from_start)

    @cached_property
    def _from_start(self) -> tuple[Ints, Array, Array, Array, OdometryErrors]:
        """Return the key poses, after the start pose unless the first key is at the start.

        Returns update times, poses, covariances, covariances with the next key pose, and odometry errors.
        """
        keys, x, (own, after), errors = self.keys, self.x, self.spread, self.errors
        if not keys[0]:
            return keys, x, own, after, errors
        pose, P, cross = self.start.smoothed(x[0], own[0])
        keys, x = np.append(0, keys), np.vstack((pose, x))
        first = OdometryErrors.of_keys(self.odometry, keys[:2], x[:2])
        joined = OdometryErrors.joined(first, replace(errors, a=errors.a + 1))
        return keys, x, np.concatenate((P[None], own)), np.concatenate((cross[None], after)), joined

    @cached_property
    def spread(self) -> tuple[Array, Array]:
        """Return covariances of the key poses (m, 3, 3), and of each key pose with the next one (m - 1, 3, 3)."""
        return self.normal.chain(len(self.x))

    def seen_again(self) -> tuple[Array, Array]:
        """Return the two visit times of each closed loop (m, 2) [s], and the relative poses (m, 3).

        Each relative pose is that of the later visit in the frame of the earlier visit.
        """
        when = self.drive.t[self.keys][np.column_stack((self.closures.i, self.closures.j))]
        order = np.argsort(when[:, 1], kind="stable")
        return when[order], self.closures.z[order]

    def walls(self) -> list[MapLine]:
        """Return the map: walls seen by the key scans, placed at the key poses and merged."""
        seen_from = se2.compose(self.x, se2.compose(self.mount, se2.inverse(self.configured_mount)))
        return straightened(self.drive.measurements[LASER], self.readings, seen_from, self.spread[0])

    def _misfit(self, x: Array) -> float:
        """Return the position error of the loop closures for key poses x (m, 3), rms [m]; 0 without closures."""
        e = self.closures.errors(x)
        return float(np.sqrt((e[:, :2] ** 2).sum(axis=1).mean())) if len(e) else 0.0

    def is_needed(self, filtered: Estimates) -> bool:
        """Return whether to use the graph: the filter was lost, or its poses contradict the loop closures.

        Otherwise the smoother is more accurate than the graph: it uses every line of every scan. The position
        error of the loop closures is compared for the poses of the filter and those of the graph.
        """
        by_filter, by_graph = self._misfit(filtered.pose[self.keys]), self._misfit(self.x)
        return bool(filtered.lost) or by_filter > MIN_GAIN * by_graph + MIN_GAIN_M

    def notes(self, used: bool = True) -> tuple[str, ...]:
        """Return the notes for the user: closed loops with times, undecided loops, whether the graph was used."""
        closed, spans = len(self.closures), list[list[float]]()
        for at in sorted(self.drive.t[self.keys][self.closures.j].tolist()):  # second visits, such as 12-30 s
            if spans and at - spans[-1][1] < SPAN_GAP_S:
                spans[-1][1] = at
            else:
                spans.append([at, at])
        if not closed:
            notes = ["no loop was closed: no place was recognised as seen before"]
        elif not used:
            words = f"the filter's own map holds its {closed} loops together; no loop had to be closed"
            return (f"smoothing: {words}",)
        else:
            when = ", ".join(f"{a:.0f}-{b:.0f} s" if b > a else f"{a:.0f} s" for a, b in spans)
            notes = [f"closed {closed} loops onto places seen before (at {when})"]
        if used and self.lag:
            side = "behind" if self.lag < 0 else "ahead of"
            notes.append(f"the laser's stamps run {abs(self.lag):.2f} s {side} the wheels', which was allowed for")
        if self.loops.undecided:
            n, why = len(self.loops.undecided), "; ".join(sorted(set(self.loops.undecided.values())))
            notes.append(f"{n} possible loops stayed open ({why})")
        return tuple(f"smoothing: {words}" for words in notes)


def whole_drive(
    drive: Drive, robot: Robot, sensors: Sequence[str], filtered: Estimates | None = None
) -> Graph | None:
    """Return the solved graph of a drive with a laser; None without a laser or a place to close a loop.

    From the filter's run `filtered`, the graph uses the recognised places, and the estimates of the wheels and the
    laser mount if there are any.
    """
    m = drive.measurements.get(LASER)
    if m is None or m.points is None or not may_have_loops(drive, robot, sensors):
        return None
    behind, configured = clock_lags({LASER: m}, drive.wheels).get(LASER), m.points.mount
    lag = behind.offset if behind is not None and worth_saying(behind) else 0.0
    # the clock offset is not a state: with a late clock the filter estimates a mount further ahead (speed * lag)
    mount = configured if filtered is None or lag else found_mount(LASER, configured, filtered.blocks)
    estimated = None if filtered is None else filtered.blocks.get(WHEELS)
    wheels = None if estimated is None else estimated[-1]
    odometry = odometry_of(drive, lag, wheels)
    distance, headings = odometry.path_length()[drive.instant[LASER]], odometry.pose[drive.instant[LASER], 2]
    readings = spaced((distance, KEY_DISTANCE_M), (headings, KEY_TURN_RAD))
    if len(readings) < MIN_KEYS:
        return None
    keys = drive.instant[LASER][readings]
    scans = KeyClouds(m, readings, mount)
    if not np.isfinite(scans.clouds.normal[:, 0]).any():
        return None
    # the audits of a lost filter reject correct readings
    audits = None if filtered is None or filtered.lost else filtered.audits
    others = Others(drive, robot, [s for s in sensors if s != LASER], odometry, keys, audits)
    start = GraphStart.of(robot, odometry, int(keys[0]))
    problem = Problem(start.at_first_key, others if others.sensors else None)
    driven = distance[readings]
    wheels_only = wheel_edges(odometry, keys)
    x, edges = sequential(scans.targets, scans.sources, wheels_only, driven, problem)
    straighter = straight_mount(mount, configured, x, wheels_only.z)
    if not np.array_equal(straighter, mount):
        mount, scans = straighter, KeyClouds(m, readings, straighter)
        x, edges = sequential(scans.targets, scans.sources, wheels_only, driven, problem)
    drive = replace(drive, measurements={**drive.measurements, LASER: scans.m})
    scaled = replace(odometry, C=wheels_share(odometry, keys, x) * odometry.C)
    start = GraphStart.of(robot, scaled, int(keys[0]))
    problem.start = start.at_first_key
    maps = submaps_of(scans.clouds, mount[:2], x, driven)
    hints = Edges.none() if filtered is None else recognised(filtered, odometry, keys)
    x, closed, loops = close(x, edges, problem, maps, hints)
    if len(loops.edges):
        closed = Edges.joined(closed, match_revisits(scans.targets, scans.sources, x, driven))
    x, normal = problem.solve(x, closed, KERNEL_WIDTH_FACTORS if len(loops.edges) else (1.0,))
    noisier = odometry.with_slip_noise()
    errors = errors_at_scans(noisier, drive, LASER, readings, scans.clouds, x)
    return Graph(
        drive=drive,
        configured_mount=configured,
        mount=mount,
        start=start,
        odometry=noisier,
        readings=readings,
        x=x,
        errors=errors,
        normal=normal,
        loops=loops,
        lag=lag,
        wheels=wheels,
    )


class KeyClouds:
    """Point clouds of the key scans `readings` (m,) in the base frame, for a laser `mount` (3,)."""

    def __init__(self, m: Measurements, readings: Ints, mount: Array) -> None:
        self.m = replace(m, points=m.points.mounted(mount)) if m.points is not None else m
        self.clouds = clouds_of(self.m, readings)
        self.targets, self.sources = Targets(self.clouds), sources_of(self.clouds)


def straight_mount(found: Array, configured: Array, x: Array, u: Array) -> Array:
    """Return the laser mount (3,): `found`, or with the configured yaw if the robot drives straighter with that.

    Key poses x (m, 3) were computed with the mount `found`; u (m - 1, 3) are the motions between them by wheel
    odometry. A filter with heading drift may estimate a wrong mount yaw; 0.5 degrees of it rotate a whole drive.
    """
    with_yaw = np.array([*found[:2], configured[2]])
    straight = np.abs(u[:, 2]) < MAX_STRAIGHT_RAD
    side = []
    for mount in (found, with_yaw):
        seen = se2.compose(x, se2.compose(found, se2.inverse(mount)))
        side.append(abs(float((_halfway(se2.between(seen[:-1], seen[1:])) - _halfway(u))[straight, 1].sum())))
    return found if side[0] <= side[1] else with_yaw


def _halfway(u: Array) -> Array:
    """Return the translations (n, 2) of motions u (n, 3) in the frame of the mean heading."""
    return se2.rotated(-u[:, 2] / 2.0, u[:, :2])


def may_have_loops(drive: Drive, robot: Robot, sensors: Sequence[str]) -> bool:
    """Return whether a drive may have loops to close: its laser builds a map, larger than one scan shows."""
    m = drive.measurements.get(LASER)
    if LASER not in sensors or m is None or m.points is None or robot.settings(LASER).map != "grow":
        return False
    t = np.linspace(drive.t[0], drive.t[-1], 10 * SAMPLE_SCANS)
    extent = np.hypot(*np.ptp(drive.wheels.relative(np.full(len(t), t[0]), t)[:, :2], axis=0))
    scans = m.points.read(evenly(len(m.t), SAMPLE_SCANS)) if len(m.t) else []
    seen = [np.hypot(*(p - m.points.mount[:2]).T) for p in scans if len(p)]
    return not seen or bool(extent > MAX_EXTENT_VIEWS * np.median([np.quantile(r, FAR_SHARE) for r in seen]))


def wheels_share(odometry: Odometry, keys: Ints, x: Array) -> float:
    """Return the ratio of actual (by scan poses x) to claimed variance of the wheels' turns between keys.

    With an assumed track width the claimed error is 5 degrees per metre; the actual one is below 1 degree. Between
    keys, scans correct the heading. Before the first key only wheel odometry is available, and its heading error
    rotates the whole drive.
    """
    u, C = odometry.between(keys[:-1], keys[1:])
    off = se2.wrap_all((se2.between(x[:-1], x[1:]) - u)[:, 2])
    claimed = float(np.median(C[:, 2, 2]))
    return robust_sigma(off) ** 2 / claimed if claimed > 0.0 else 1.0


class GraphStart(msgspec.Struct, frozen=True):
    """Start pose of the drive, and its prediction by wheel odometry at the first key pose."""

    pose: Array  # (3,) start pose
    P: Array  # (3, 3)
    at_key: Array  # (3,) predicted first key pose
    P_at_key: Array  # (3, 3)
    cross: Array  # (3, 3) covariance of the start pose with the predicted first key pose

    @classmethod
    def of(cls, robot: Robot, odometry: Odometry, key: int) -> GraphStart:
        """Return the configured start pose, predicted to the first key at update time `key`."""
        pose, P = np.array(robot.start.pose), np.diag(robot.start.variances) + START_FLOOR_P
        u, C = odometry.between(np.array([0]), np.array([key]))
        at_key = se2.compose(pose, u[0])
        turn, (x, y) = se2.rotation(pose[2]), at_key[:2] - pose[:2]
        F = se2.lever(-y, x)
        P_at_key: Array = F @ P @ F.T + turn @ add_lever_arm(C, -u[:, 1], u[:, 0])[0] @ turn.T
        return cls(pose, P, at_key, P_at_key, P @ F.T)

    @property
    def at_first_key(self) -> Edges:
        """Return a prior on the first key pose, as an edge of the graph."""
        return Edges.known(0, self.at_key, np.asarray(np.linalg.inv(self.P_at_key), np.float64))

    def smoothed(self, key: Array, P: Array) -> tuple[Array, Array, Array]:
        """Return the start pose smoothed by the first key pose, its covariance, and that of both poses.

        `key` (3,) is the graph's estimate of the first key pose, P (3, 3) its covariance.
        """
        G = self.cross @ np.linalg.inv(self.P_at_key)
        step = key - self.at_key
        step[2] = se2.wrap(float(step[2]))
        return self.pose + G @ step, self.P + G @ (P - self.P_at_key) @ G.T, G @ P


# ---- edges between key poses, by wheel odometry and matches of neighbouring key scans ----

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
MAX_VISITS_AGAIN, MIN_LENGTH_AGAIN_M, MAX_AGAIN_M = 2, 5.0, 2.5


def wheel_edges(odometry: Odometry, instants: Ints) -> Edges:
    """Return graph edges from each key pose to the next by wheel odometry, at update times `instants` (n,)."""
    a = np.arange(len(instants) - 1)
    u, C = odometry.between(instants[:-1], instants[1:])
    Q = add_lever_arm(C, -u[:, 1], u[:, 0]) + WHEEL_FLOOR_P
    aside = SIDEWAYS_SHARE * np.hypot(u[:, 0], u[:, 1])
    Q[:, [0, 1], [0, 1]] += np.square(aside)[:, None]
    edges = Edges.of(a, a + 1, u, np.asarray(np.linalg.inv(Q), np.float64), WHEEL_WIDTH_SIGMAS)
    edges.by[:, 1, 1] = u[:, 0]
    return edges


def edges_from_matches(i: Ints, j: Ints, found: Matches, driven: Array | None = None) -> Edges:
    """Convert matches of scans i and j to graph edges.

    If the path lengths `driven` (n,) [m] are given, the edges allow for a heading drift proportional to them.
    """
    edges = Edges.of(i, j, found.alone, INFORMATION_SHARE * found.information, SCAN_WIDTH_SIGMAS)
    if driven is not None:
        edges.by[:, 2, 0] = driven[j] - driven[i]
    return edges


def sequential(
    targets: Targets, clouds: Clouds, wheels: Edges, driven: Array, problem: Problem
) -> tuple[Array, Edges]:
    """Return the key poses (n, 3) without loop closures, and the graph edges of the wheels and the scans."""
    found = next_scans(targets, wheels.i, clouds, wheels.j, wheels.z, wheels.information)
    reliable = good(found)
    step = np.where(reliable[:, None], found.pose, wheels.z)
    x = se2.compose(problem.start.z[0], se2.chain(step))
    scans = edges_from_matches(wheels.i, wheels.j, found, driven).take(reliable)
    x, _ = problem.solve(x, Edges.joined(wheels, scans), (100.0, 1.0))
    further = []
    for n in NEIGHBOUR_STEPS:
        i, found = further_scans(targets, clouds, x, n, MAX_NEIGHBOUR_M)
        further.append(edges_from_matches(i, i + n, found, driven))
    edges = Edges.joined(wheels, scans, *further)
    x, _ = problem.solve(x, edges, (100.0, 1.0))
    return x, edges


def match_revisits(targets: Targets, clouds: Clouds, x: Array, driven: Array) -> Edges:
    """Match each key scan with nearby key scans of earlier visits, after loop closure (Lu and Milios 1997)."""
    from scipy.spatial import cKDTree

    near = cKDTree(x[:, :2]).query_ball_point(x[:, :2], MAX_AGAIN_M, return_sorted=True)
    pairs = []
    for j, others in enumerate(near):
        i = np.array([k for k in others if driven[j] - driven[k] > MIN_LENGTH_AGAIN_M], dtype=np.int64)
        i = i[np.argsort(np.hypot(*(x[i, :2] - x[j, :2]).T), kind="stable")]
        visits: list[int] = []
        for k in i.tolist():
            apart = all(abs(driven[k] - driven[v]) > MIN_LENGTH_AGAIN_M for v in visits)
            if apart and len(visits) < MAX_VISITS_AGAIN:
                visits.append(k)
        pairs += [(k, j) for k in visits]
    if not pairs:
        return Edges.none()
    i, j = np.array(pairs, dtype=np.int64).T
    guess = se2.between(x[i], x[j])
    prior = np.linalg.inv(np.diag([0.1**2, 0.1**2, np.radians(2.0) ** 2]))
    found = match(targets, i, clouds, j, guess, np.broadcast_to(prior, (len(i), 3, 3)), 0.3)
    return edges_from_matches(i, j, found).take(good(found))


SAME_TURN_RAD, SAME_OFFSET_M, SAME_GAP_M = np.radians(4.0), 0.12, 0.5  # largest differences within one wall
MIN_SIGHTINGS = 3


def straightened(m: Measurements, readings: Ints, x: Array, P: Array) -> list[MapLine]:
    """Return the merged walls seen by readings (n,) from poses x (n, 3) with covariances P (n, 3, 3)."""
    walls = _Walls()
    for k, reading in enumerate(readings.tolist()):
        at = slice(int(m.first[reading]), int(m.first[reading + 1]))
        for z, R, ends in zip(m.z[at], m.covariances(at), m.extra["ends"][at], strict=True):
            walls.add(z, R, ends, x[k], P[k])
    return walls.lines()


class _Walls:
    """Walls merged from their sightings, as mean (rho, beta) weighted by information."""

    def __init__(self) -> None:
        self.middle = np.zeros((0, 2))
        self.beta = np.zeros(0)
        self.span = np.zeros((0, 2))  # along the tangent, from the map's origin
        self.seen: list[list[tuple[float, float, Array]]] = []  # rho, beta, covariance
        self.free: list[Array] = []

    def add(self, z: Array, R: Array, ends: Array, pose: Array, P: Array) -> None:
        """Add a sighting (r, psi) with covariance R and ends [m], seen from a pose with covariance P."""
        beta = float(z[1] + pose[2])
        n, t = np.array([np.cos(beta), np.sin(beta)]), np.array([-np.sin(beta), np.cos(beta)])
        along = float(t @ pose[:2])
        rho, span = float(z[0] + n @ pose[:2]), ends + along
        points = rho * n + span[:, None] * t
        k = self._same(beta, points)
        J = np.array([[n[0], n[1], 0.0], [0.0, 0.0, 1.0]])
        if k is None:
            k = len(self.beta)
            self.beta = np.append(self.beta, beta)
            self.middle = np.vstack((self.middle, points.mean(axis=0)))
            self.span = np.vstack((self.span, span))
            self.seen.append([])
            self.free.append(J @ P @ J.T)
        own, rho_own, beta_own = self.beta[k], rho, beta
        if np.cos(beta - own) < 0.0:
            rho_own, beta_own = -rho, beta + np.pi
        beta_own = own + se2.wrap(beta_own - own)
        self.seen[k].append((rho_own, beta_own, R))
        tangent = np.array([-np.sin(own), np.cos(own)])
        reach = points @ tangent
        self.span[k] = min(self.span[k, 0], reach.min()), max(self.span[k, 1], reach.max())

    def _same(self, beta: float, points: Array) -> int | None:
        """Return the index of the wall that a sighting belongs to; None if it is a new wall."""
        if not len(self.beta):
            return None
        turn = np.abs(se2.wrap_all(beta - self.beta))
        turn = np.minimum(turn, np.pi - turn)
        normal = np.stack((np.cos(self.beta), np.sin(self.beta)), axis=-1)
        tangent = np.stack((-normal[:, 1], normal[:, 0]), axis=-1)
        off = np.abs(((points.mean(axis=0) - self.middle) * normal).sum(axis=1))
        reach = points @ tangent.T  # (2, walls)
        gap = np.maximum(self.span[:, 0] - reach.max(axis=0), reach.min(axis=0) - self.span[:, 1])
        same = (turn < SAME_TURN_RAD) & (off < SAME_OFFSET_M) & (gap < SAME_GAP_M)
        if not same.any():
            return None
        return int(np.where(same, off, np.inf).argmin())

    def lines(self) -> list[MapLine]:
        """Return the walls with at least MIN_SIGHTINGS sightings, each the mean of its sightings."""
        found: list[MapLine] = []
        for k, seen in enumerate(self.seen):
            if len(seen) < MIN_SIGHTINGS:
                continue
            rho, beta, P = _mean(seen)
            ends = (float(self.span[k, 0]), float(self.span[k, 1]))
            if rho < 0.0:
                rho, beta, ends = -rho, beta + np.pi, (-ends[1], -ends[0])
            found.append(MapLine(len(found), rho, se2.wrap(beta), ends, P, len(seen), P + self.free[k]))
        return found


def _mean(seen: list[tuple[float, float, Array]]) -> tuple[float, float, Array]:
    """Return the weighted mean (rho, beta) and its covariance, scaled up if the sightings scatter more."""
    values = np.array([(rho, beta) for rho, beta, _ in seen])
    weights = np.array([np.linalg.inv(R) for _, _, R in seen])
    total = np.linalg.inv(weights.sum(axis=0))
    mean = total @ np.einsum("nij,nj->i", weights, values)
    off = values - mean
    chi2 = float(np.einsum("ni,nij,nj->", off, weights, off)) / max(2 * len(seen) - 2, 1)
    return float(mean[0]), float(mean[1]), total * max(chi2, 1.0)
