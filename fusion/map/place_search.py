"""Place recognition: search for the pose of a scan, or of a submap, in a line map.

Two walls that are not parallel determine a pose. Each pair of seen walls is aligned with each pair of map walls,
and each pose is scored by the length of the walls that match. The best pose is accepted only if no different pose
has a similar score, and if no seen wall lies behind map walls. In a rectangular room two poses (180 degrees apart)
match, so none is accepted.

For a lost robot, one scan is searched (`find_pose`), and earlier scans since it was lost exclude poses. For a
robot that may have returned to a known place, its submap is searched (`find_closure`): the best pose is refined by
the walls, and several candidates (`CandidateRuns`) must agree.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints, Mask
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.kernels import places
from locfuse.fusion.kernels.arrays import view
from locfuse.fusion.scan_matching.solve import chi2_of

from .line_map import MIN_HITS, LineMap
from .scan import Scan
from .slips import RecentScans
from .small_maps import Anchors, FrozenMap, SubmapPath, as_scan

MIN_SKEW_RAD = math.radians(25.0)  # least angle between two walls that determine a pose
APART_RAD = math.radians(20.0)  # poses whose headings differ by more are different
# --- search for one scan
LONGEST_WALLS, MAX_MAP_WALLS = 5, 60  # seen walls from which pairs are made; walls of the map, the best seen first
MIN_SHARE, MIN_WALLS = 0.7, 3  # least matched share of the seen length, least number of matched walls
RIVAL_SHARE = 0.8  # a different pose with this share of the best score makes the search ambiguous
APART_M = 0.5  # poses further apart are different
HEADING_SIGMAS, HEADING_SLACK_RAD = 4.0, math.radians(10.0)  # window around the predicted heading
MAX_THROUGH_SHARE = 0.15  # largest share of the seen length behind map walls
TRAIL_SLACK = 2.0  # factor on tolerances for earlier scans, since wheel odometry drifts
# number of contradicting scans that exclude a pose; least share of length behind map walls of such a scan
MAX_AGAINST, AGAINST_SHARE = 3, 0.35
# --- search for a submap
MAP_LONGEST_WALLS, MAP_MIN_WALLS = 10, 5  # walls from which pairs are made; least number of walls of each submap
MAX_CHI2, SAME_CHI2 = 16.3, 11.3  # with 3 degrees of freedom at 99.9 % and at 99 %
EXPECTED_P_FACTOR = 4.0  # factor on the covariance of the expected pose, which may be overconfident
SLACK_P = np.diag(np.square((0.3, 0.3, math.radians(4.0))))  # m, rad: error of a pose from one pair of walls
# for a closure: least number and total length [m] of matched walls (many short walls, or a few long ones)
MIN_WALLS_M, MIN_LONG_WALLS_M = (5, 6.0), (3, 15.0)
MIN_UNEXPECTED_WALLS_M = (8, 20.0)  # the same for a pose outside the covariance of the expected one
NEAR_SIGMA_M = 0.75  # largest standard deviation of the expected position at which few long walls are enough
# rivals: least share of the best score; least differences of position and heading from the best pose
MAP_RIVAL_SHARE, MAP_APART_M, MAP_APART_RAD = 0.75, 0.6, math.radians(15.0)
MAX_TURNED_RIVALS = 4  # rivals with other headings, up to which free space is tested
# largest share of walls behind walls of the other submap, minus that in the own submap
MAX_MAP_THROUGH_SHARE = 0.08
ROUNDS_M_RAD = (
    (0.3, math.radians(6.0)),
    (0.2, math.radians(4.0)),
    (0.12, math.radians(3.0)),
    (0.12, math.radians(3.0)),
)
FLAT_M, STRAIGHT_RAD = 0.03, math.radians(0.5)  # standard deviation between two pieces of one wall
MIN_COMMON_M = 0.3  # least part of a wall that both submaps have seen
MAP_SIGMAS = np.array((0.03, 0.03, math.radians(0.3)))  # m, rad: standard deviation by distortion of a submap
WEAK_INFORMATION = np.diag((1e-2, 1e-2, 1e-1))  # keeps covariances finite in directions without walls
# --- agreement of candidates
AGREEING_LOOKS, UNKNOWN_LOOKS = 2, 3  # candidates that must agree: with a known, with an unknown expected pose
INSISTING_LOOKS = 5  # agreeing candidates after which the odometry between is considered overconfident instead
OPEN_SIGMA_M, OPEN_SIGMA_RAD = 1.5, math.radians(20.0)  # standard deviations beyond which a pose is unknown
UNKNOWN_LENGTH_M = 15.0  # least length of matched walls with an unknown expected pose
ELSEWHERE_M = 2.0  # distance from which two positions of one submap differ


class Places(NamedTuple):
    """Poses tried in a search, with their scores."""

    poses: Array  # (h, 3)
    share: Array  # (h,) matched share of the seen length; 0 if too few walls match
    possible: Array  # (h,) matched share if map walls may be longer than seen so far
    best: int  # index of the largest share


def search(
    scan: Scan,
    walls: Array,
    most: int,
    allowed: Callable[[Array], Mask],
    enough: Callable[[Array, Ints], Mask],
) -> Places | None:
    """Return poses of a scan in a map, with scores; None if no pose is good enough.

    Each pose aligns two of the `most` longest walls of the scan with map walls. `allowed` selects poses (h, 3)
    before the scoring; `enough` selects poses by matched share (h,) and number of walls (h,).
    """
    poses = hypotheses(scan, walls, most)
    poses = poses[allowed(poses)]
    if not len(poses):
        return None
    share, possible, count = explained(poses, scan, walls)
    share = np.where(enough(share, count), share, 0.0)
    best = int(np.argmax(share))
    return Places(poses, share, possible, best) if share[best] > 0.0 else None


def hypotheses(scan: Scan, walls: Array, most: int = LONGEST_WALLS) -> Array:
    """Return poses (h, 3) that align pairs of the scan's longest walls with map walls at the same angle."""
    longest = np.argsort(-(scan.ends[:, 1] - scan.ends[:, 0]), kind="stable")[:most]
    psi = scan.z[:, 1].tolist()
    pairs = list(combinations(longest.tolist(), 2))
    pairs = [(a, b) for a, b in pairs if abs(math.sin(psi[b] - psi[a])) >= math.sin(MIN_SKEW_RAD)]
    poses, found = np.empty((len(pairs) * len(walls) ** 2, 3)), 0
    rows, out = view(scan.rows), view(poses)
    for a, b in pairs:
        found = places.hypotheses(rows, a, b, walls, found, out)
    return poses[:found]


def distinct(poses: Array) -> Array:
    """Return one pose (h, 3) per grid cell, whose size is half of APART_M and APART_RAD."""
    headings = se2.wrap_all(poses[:, 2])
    cells = np.floor(np.column_stack((poses[:, :2] / (0.5 * APART_M), headings / (0.5 * APART_RAD))))
    return poses[np.sort(np.unique(cells, axis=0, return_index=True)[1])]


def explained(poses: Array, scan: Scan, walls: Array, slack: float = 1.0) -> tuple[Array, Array, Ints]:
    """Return for each pose (h,): matched share of the scan's wall length, possible share, number of matched walls.

    The possible share is the share that would match if map walls were longer. A map wall may be longer than seen
    so far, so a rival pose may see an unknown part of it. `slack` is a factor on the tolerances.
    """
    out = np.empty((len(poses), 3))
    if len(poses):
        places.explained(view(scan.rows), walls, view(poses), slack, view(out))
    return out[:, 0], out[:, 1], out[:, 2].astype(np.int64)


def seen_through(scan: Scan, walls: Array, pose: Sequence[float], both: bool = False) -> float:
    """Return the share of the scan's wall length that lies behind map walls, for a pose of the robot."""
    if len(scan.z) == 0:
        return 0.0
    length = scan.ends[:, 1] - scan.ends[:, 0]
    return float(behind_walls(scan, walls, pose, both) @ length / length.sum())


def behind_walls(scan: Scan, walls: Array, pose: Sequence[float], both: bool = False) -> Array:
    """Return for each wall of the scan (k,) the share that lies behind map walls, for a pose (3,) of the robot.

    `both`: map walls also occlude from their unseen side.
    """
    out, (x, y, theta) = np.zeros(len(scan.z)), pose
    if len(walls) and len(out):
        places.behind(view(scan.rows), walls, x, y, theta, both, view(out))
    return out


def walls_of(lines: LineMap, values: Array, known: Ints | None = None) -> Array:
    """Return map walls as a table (m, COLUMNS) for kernels.places.

    `values` (J, 2) are (rho, beta) of all map lines; `known` (m,) are the indices of the lines to use, None: those
    seen at least MIN_HITS times.
    """
    known = np.flatnonzero(lines.hits >= MIN_HITS) if known is None else known
    walls = np.empty((len(known), places.LINE_COLUMNS))
    walls[:, :2], walls[:, 2:4] = values[known], lines.anchor[known]
    walls[:, 4], walls[:, 5] = lines.lo[known], lines.hi[known]
    viewed: Array = view(walls)
    return viewed


def find_pose(
    scan: Scan, lines: LineMap, belief: JointBelief, trail: RecentScans
) -> tuple[float, float, float] | None:
    """Return the pose (x, y, theta) of a scan in the map; None if no pose or several match.

    Other matching poses are excluded if earlier scans of the trail contradict them.
    """
    values = lines.values(belief)
    known = np.flatnonzero(lines.hits >= MIN_HITS)
    known = known[np.argsort(-lines.hits[known], kind="stable")][:MAX_MAP_WALLS]
    if len(scan.z) < MIN_WALLS or len(known) < 2:
        return None
    # a compass may know the heading of a lost robot
    slack = HEADING_SIGMAS * math.sqrt(max(float(belief.matrix()[2, 2]), 0.0)) + HEADING_SLACK_RAD
    walls, all_walls = walls_of(lines, values, known), walls_of(lines, values)
    found = search(
        scan,
        walls,
        LONGEST_WALLS,
        lambda poses: np.abs(se2.wrap_all(poses[:, 2] - belief.theta)) <= slack,
        lambda share, count: (share >= MIN_SHARE) & (count >= MIN_WALLS),
    )
    if found is None:
        return None
    poses, share, possible, best = found
    pose = poses[best]
    apart = np.hypot(*(poses[:, :2] - pose[:2]).T) > APART_M
    apart |= np.abs(se2.wrap_all(poses[:, 2] - pose[2])) > APART_RAD
    rivals = distinct(poses[apart & (possible >= RIVAL_SHARE * share[best])])
    here = np.array([belief.x, belief.y, belief.theta])
    matching = np.vstack((pose, rivals))
    matching = matching[_occluded_share(matching, scan, all_walls) < MAX_THROUGH_SHARE]
    matching = _consistent(matching, trail.back_from(here), walls, all_walls)
    if len(matching) != 1 or (matching[0] != pose).any():
        return None
    x, y, theta = pose.tolist()
    return x, y, belief.theta + float(se2.wrap_all(np.array(theta - belief.theta)))


def _occluded_share(poses: Array, scan: Scan, walls: Array) -> Array:
    """Return for each pose (h, 3) the share of the scan's wall length behind map walls, seen from any side."""
    return np.array([seen_through(scan, walls, pose, both=True) for pose in poses.tolist()])


def _consistent(poses: Array, before: Iterable[tuple[Array, Scan]], walls: Array, all_walls: Array) -> Array:
    """Return the poses (of h candidate poses (h, 3) for the present scan) that earlier scans do not contradict.

    `before` yields the earlier scans, each with its pose (3,) relative to the present scan. A candidate is dropped
    once MAX_AGAINST scans contradict it.
    """
    against = np.zeros(len(poses), dtype=np.int64)
    for step, scan in before:
        if not len(poses):
            break
        then = se2.compose(poses, step)
        _, possible, _ = explained(then, scan, walls, TRAIL_SLACK)
        through = _occluded_share(then, scan, all_walls)
        against += (possible < RIVAL_SHARE * MIN_SHARE) | (through >= AGAINST_SHARE)
        poses, against = poses[against < MAX_AGAINST], against[against < MAX_AGAINST]
    return poses


class Closure(NamedTuple):
    """Pose of one submap in another, by the walls of both."""

    pose: Array  # (3,)
    P: Array  # (3, 3) large in directions without walls
    length: float  # m, length of matched walls
    walls: int  # number of matched walls


def find_closure(there: FrozenMap, here: FrozenMap, expected: Array, P: Array) -> Closure | None:
    """Return the pose of submap `here` in submap `there`; None if no pose or several match.

    `expected` (3,) is the expected pose with covariance P (3, 3).
    """
    scan = as_scan(here.lines)
    known = np.flatnonzero(there.lines.hits >= MIN_HITS)
    if min(len(scan.z), len(known)) < MAP_MIN_WALLS:
        return None
    total = float((scan.ends[:, 1] - scan.ends[:, 0]).sum())
    places = search(
        scan,
        walls_of(there.lines, there.lines.value),
        MAP_LONGEST_WALLS,
        lambda poses: chi2_of(poses, expected, EXPECTED_P_FACTOR * P + SLACK_P) <= MAX_CHI2,
        lambda share, count: (share * total >= 0.5 * MIN_WALLS_M[1]) & (count >= 3),
    )
    if places is None:
        return None
    alike = places.poses[places.share > MAP_RIVAL_SHARE * places.share[places.best]]
    rivals = alike - places.poses[places.best]
    turned = np.abs(se2.wrap_all(rivals[:, 2])) > MAP_APART_RAD
    others = distinct(alike[turned])
    if len(others) > MAX_TURNED_RIVALS or not all(is_contradicted(there, here, pose) for pose in others):
        return None
    found = _refined(places.poses[places.best], scan, there, known, expected, P)
    if found is None or not _has_enough_walls(found, expected, P) or is_contradicted(there, here, found.pose):
        return None
    return found._replace(P=found.P + rival_spread(rivals[~turned]))


def _has_enough_walls(found: Closure, expected: Array, P: Array) -> bool:
    """Return whether enough walls match; a pose far from the expected one needs more walls."""
    least: tuple[tuple[int, float], ...] = (MIN_WALLS_M,)
    if chi2_of(found.pose[None], expected, P + SLACK_P)[0] > MAX_CHI2:
        least = (MIN_UNEXPECTED_WALLS_M,)
    elif float(P[0, 0] + P[1, 1]) < NEAR_SIGMA_M**2:
        least = (MIN_WALLS_M, MIN_LONG_WALLS_M)
    return any(found.walls >= n and found.length >= m for n, m in least)


def rival_spread(rivals: Array) -> Array:
    """Return the covariance (3, 3) of the best pose's position [m^2] caused by other, equally good poses.

    `rivals` (n, 3) are the offsets of these poses from the best one. In a corridor they differ only in the
    position along it.
    """
    apart = rivals[np.hypot(*rivals[:, :2].T) > MAP_APART_M, :2]
    P = np.zeros((3, 3))
    if len(apart):
        P[:2, :2] = apart.T @ apart * (np.square(apart).sum(axis=1).max() / np.square(apart).sum())
    return P


def is_contradicted(there: FrozenMap, here: FrozenMap, pose: Array) -> bool:
    """Return whether scans of one submap see through walls of the other submap.

    They must see through these walls more than through walls of their own submap: map walls extend over their
    doors, so scans see through all walls a little.
    """
    ours, theirs = walls_of(here.lines, here.lines.value), walls_of(there.lines, there.lines.value)
    across = _mean_occluded(here.path, pose, theirs) + _mean_occluded(there.path, se2.inverse(pose), ours)
    within = _mean_occluded(here.path, np.zeros(3), ours) + _mean_occluded(there.path, np.zeros(3), theirs)
    return 0.5 * (across - within) > MAX_MAP_THROUGH_SHARE


def _mean_occluded(path: SubmapPath, frame: Array, walls: Array) -> float:
    """Return the mean share of wall length behind `walls`, of scans along a path with frame pose `frame` (3,)."""
    if not path.sights:
        return 0.0
    seen = (seen_through(s.scan, walls, se2.compose(frame, s.pose).tolist()) for s in path.sights)
    return float(np.mean(list(seen)))


def _refined(pose: Array, scan: Scan, there: FrozenMap, known: Ints, expected: Array, P: Array) -> Closure | None:
    """Refine the pose of a scan in a map: Gauss-Newton over pairs of equal walls, with a prior."""
    prior = np.linalg.inv(P + np.diag((1e-6, 1e-6, 1e-8)))
    x = pose.copy()
    x[2] = expected[2] + se2.wrap(float(x[2] - expected[2]))
    for near, turned in ROUNDS_M_RAD:
        J, e, W, lengths = _same_walls(x, scan, there, known, near, turned)
        if not len(lengths):
            return None
        data = J.T @ (W[:, None] * J)
        x = x - np.linalg.solve(data + prior, J.T @ (W * e) + prior @ (x - expected))
    weak = data + WEAK_INFORMATION
    z = x - np.linalg.solve(weak, J.T @ (W * e))  # by the walls alone
    spread = np.asarray(np.linalg.inv(weak), np.float64) + np.diag(np.square(MAP_SIGMAS))
    return Closure(z, spread, float(lengths.sum()), len(lengths))


def _same_walls(
    x: Array, scan: Scan, there: FrozenMap, known: Ints, near: float, turned: float
) -> tuple[Array, Array, Array, Array]:
    """Return Jacobian (2p, 3) by the pose x, residuals and weights (2p,) of p walls seen in scan and map.

    Also return the length (p,) [m] by which the two walls of a pair overlap.
    """
    lines, values = there.lines, there.lines.value[known]
    beta = values[:, 1]
    c, s = np.cos(beta), np.sin(beta)
    cb, sb = np.cos(scan.z[:, 1] + x[2]), np.sin(scan.z[:, 1] + x[2])
    foot = x[:2] + scan.z[:, :1] * np.stack((cb, sb), axis=-1)  # (k, 2)
    tangent = np.stack((-sb, cb), axis=-1)
    ends = foot[:, None] + scan.ends[:, :, None] * tangent[:, None]  # (k, 2, 2)
    away = ends[:, None] - lines.anchor[known][None, :, None]  # (k, J, 2, 2)
    along = away[..., 1] * c[:, None] - away[..., 0] * s[:, None]  # (k, J, 2)
    lo = np.maximum(along.min(axis=2), lines.lo[known])
    hi = np.minimum(along.max(axis=2), lines.hi[known])
    middle = 0.5 * (lo + hi)
    turn = se2.wrap_all(scan.z[:, 1, None] + x[2] - beta)
    across = away[..., 0] * c[:, None] + away[..., 1] * s[:, None] - values[:, 0, None]  # (k, J, 2) of both ends
    run = along[..., 1] - along[..., 0]
    share = (middle - along[..., 0]) / np.where(np.abs(run) > 1e-9, run, 1e-9)
    offset = across[..., 0] + share * (across[..., 1] - across[..., 0])
    fits = (hi - lo > MIN_COMMON_M) & (np.abs(turn) < turned) & (np.abs(offset) < near)
    cost = np.where(fits, np.square(offset / near) + np.square(turn / turned), np.inf)
    k = np.flatnonzero(np.isfinite(cost).any(axis=1))
    j = np.argmin(cost[k], axis=1)
    point = ends[k, 0] + share[k, j, None] * (ends[k, 1] - ends[k, 0])
    arm = point - x[:2]
    length = hi[k, j] - lo[k, j]
    own, other = scan.R[k], lines.P[known][j]
    J = np.zeros((2 * len(k), 3))
    J[::2, 0], J[::2, 1], J[::2, 2] = c[j], s[j], -c[j] * arm[:, 1] + s[j] * arm[:, 0]
    J[1::2, 2] = 1.0
    e = np.stack((offset[k, j], turn[k, j]), axis=-1).reshape(-1)
    straight = STRAIGHT_RAD**2 + 12.0 * np.square(0.01 / length) + own[:, 1, 1] + other[:, 1, 1]
    W = 1.0 / np.stack((FLAT_M**2 + other[:, 0, 0], straight), axis=-1).reshape(-1)
    return J, e, W, length


class CandidateRuns:
    """Latest loop-closure candidate in each frozen submap, and how many consecutive candidates there agree.

    A candidate is the pose of the present submap in the frozen one; the latest one is stored.
    """

    def __init__(self) -> None:
        self._found: dict[int, tuple[Closure, int]] = {}  # anchor -> last candidate, number of agreeing ones

    def count(self, anchor: int) -> int:
        """Return how many candidates for a loop closure with the submap of this anchor agree with each other."""
        return self._found[anchor][1] if anchor in self._found else 0

    def add(self, anchor: int, found: Closure | None, unknown: bool, anchors: Anchors) -> bool:
        """Add a candidate in the submap of an anchor (None: not found); return whether to close the loop.

        If the pose of the present submap is `unknown`, the conditions are stricter: longer walls, one more
        agreeing candidate, and no candidate at another position in another submap.
        """
        if found is None or (unknown and found.length < UNKNOWN_LENGTH_M):
            self._found.pop(anchor, None)
            return False
        before, looks = self._found.get(anchor, (found, 0))
        is_same = chi2_of(found.pose[None], before.pose, before.P + found.P)[0] < SAME_CHI2
        self._found[anchor] = found, looks + 1 if is_same else 1
        if not unknown:
            return self.count(anchor) >= AGREEING_LOOKS
        places = {k: se2.compose(anchors.pose[k], found.pose) for k, (found, _) in self._found.items()}
        x, y, _ = places[anchor].tolist()
        rival = any(math.hypot(place[0] - x, place[1] - y) > ELSEWHERE_M for place in places.values())
        return self.count(anchor) >= UNKNOWN_LOOKS and not rival


def is_unknown(P: Array) -> bool:
    """Return whether a relative pose with covariance P (3, 3) counts as unknown."""
    return float(P[0, 0] + P[1, 1]) > OPEN_SIGMA_M**2 or float(P[2, 2]) > OPEN_SIGMA_RAD**2
