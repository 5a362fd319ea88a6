"""Place search: the pose of a scan, or of a small map, in a line map.

Two walls that are not parallel fix a pose. All pairs of seen walls are laid onto all pairs of known ones, and
each pose is scored by the length of wall that it explains. The best one counts only if no different pose explains
nearly as much, and if nothing is seen through walls. A rectangle alone has two such poses (turned by 180 degrees):
then no place is found.

A lost robot looks for one scan (`find_pose`); scans since it was lost rule out places. A robot that comes back
looks for its small map (`find_closure`): the best place is refined by its walls, and several `Looks` must agree.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.kernels import places
from locfuse.fusion.kernels.arrays import view
from locfuse.fusion.scan_matching.solve import chi2_of

from .anchors import Anchors
from .line_map import LineMap
from .scan import Scan
from .slips import Trail
from .small_maps import as_scan
from .way import Way

MIN_HITS = 4  # of a wall that counts
MIN_SKEW_RAD = math.radians(25.0)  # two walls must differ by this much in direction to fix a pose
APART_RAD = math.radians(20.0)  # poses in directions further apart are different
# --- of one scan
LONGEST_WALLS, MAX_MAP_WALLS = 5, 60  # seen walls from which pairs are made; walls of the map, the best seen first
MIN_SHARE, MIN_WALLS = 0.7, 3  # share of the seen length, and walls, that a pose must explain
RIVAL_SHARE = 0.8  # another pose that explains this share of the best one's length makes it ambiguous
APART_M = 0.5  # poses further apart are different
HEADING_SIGMAS, HEADING_SLACK_RAD = 4.0, math.radians(10.0)
MAX_THROUGH_SHARE = 0.15  # of the seen length behind known walls
TRAIL_SLACK = 2.0  # along the trail: wheels drift
# a scan of the trail contradicts a pose from which it sees this share through walls; so many rule the pose out
MAX_AGAINST, AGAINST_SHARE = 3, 0.35
# --- of a small map
MAP_LONGEST_WALLS, MAP_MIN_WALLS = 10, 5  # from which pairs are made; that each of two maps must have
MAX_CHI2, SAME_CHI2 = 16.3, 11.3  # with 3 degrees of freedom at 99.9 % and at 99 %
EXPECTED_P_FACTOR = 4.0  # times the covariance of the expected place: some drives go wrong by more than it claims
SLACK_P = np.diag(np.square((0.3, 0.3, math.radians(4.0))))  # m, rad: by which a pair of walls misses the place
# walls, and m of them, that a place must explain: many, or long ones
MIN_WALLS_M, MIN_LONG_WALLS_M = (5, 6.0), (3, 15.0)
MIN_UNEXPECTED_WALLS_M = (8, 20.0)  # the same where it lies beyond what the covariance of the way allows
NEAR_SIGMA_M = 0.75  # of the expected place, up to which a few long walls are enough
MAP_RIVAL_SHARE, MAP_APART_M, MAP_APART_RAD = 0.75, 0.6, math.radians(15.0)  # of the best one's length; of rivals
MAX_TURNED_RIVALS = 4  # in other directions, beyond which free space is not asked
MAX_MAP_THROUGH_SHARE = 0.08  # of the walls behind walls of the other map, beyond what is so within either map
ROUNDS_M_RAD = (
    (0.3, math.radians(6.0)),
    (0.2, math.radians(4.0)),
    (0.12, math.radians(3.0)),
    (0.12, math.radians(3.0)),
)
FLAT_M, STRAIGHT_RAD = 0.03, math.radians(0.5)  # how well two pieces of one wall agree
MIN_COMMON_M = 0.3  # of a wall that both maps must have seen
MAP_SIGMAS = np.array((0.03, 0.03, math.radians(0.3)))  # m, rad: how well a small map keeps its shape
WEAK_INFORMATION = np.diag((1e-2, 1e-2, 1e-1))  # keeps finite what no wall constrains
# --- of looks
AGREEING_LOOKS, UNKNOWN_LOOKS = 2, 3  # looks that must agree; where the expected place is not known
INSISTING_LOOKS = 5  # looks that agree, after which it is the way between that was worse than it claimed
OPEN_SIGMA_M, OPEN_SIGMA_RAD = 1.5, math.radians(20.0)  # beyond which a place is not known
UNKNOWN_LENGTH_M = 15.0  # of walls that a place must explain where the expected place is not known
ELSEWHERE_M = 2.0  # between places of one map that are not the same


class Places(NamedTuple):
    """Poses that a search tried, and how much each explains."""

    poses: Array  # (h, 3)
    share: Array  # (h,) of the seen length; 0 where it is too little to count
    possible: Array  # (h,) the same were walls longer than known
    best: int


def search(
    scan: Scan,
    walls: Array,
    most: int,
    allowed: Callable[[Array], NDArray[np.bool_]],
    enough: Callable[[Array, Ints], NDArray[np.bool_]],
) -> Places | None:
    """Return poses at which pairs of the scan's `most` longest walls lie on known walls; None for none.

    `allowed` says which poses (h, 3) are possible, `enough` by share (h,) and count of walls which of them count.
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
    """Return poses (h, 3) from pairs of the longest seen walls laid onto pairs of known ones at the same angle."""
    longest = np.argsort(-(scan.ends[:, 1] - scan.ends[:, 0]), kind="stable")[:most]
    pairs = [
        (a, b)
        for a, b in combinations(longest.tolist(), 2)
        if abs(math.sin(scan.z.item(b, 1) - scan.z.item(a, 1))) >= math.sin(MIN_SKEW_RAD)
    ]
    poses, found = np.empty((len(pairs) * len(walls) ** 2, 3)), 0
    rows, out = view(scan.rows), view(poses)
    for a, b in pairs:
        found = places.hypotheses(rows, a, b, walls, found, out)
    return poses[:found]


def distinct(poses: Array) -> Array:
    """Return one of the poses (h, 3) in every cell of half the size within which poses are equal."""
    cells = np.floor(
        np.column_stack((poses[:, :2] / (0.5 * APART_M), se2.wrap_all(poses[:, 2]) / (0.5 * APART_RAD)))
    )
    return poses[np.sort(np.unique(cells, axis=0, return_index=True)[1])]


def explained(poses: Array, scan: Scan, walls: Array, slack: float = 1.0) -> tuple[Array, Array, Ints]:
    """Return for each pose (h,) the explained share of wall length, that of longer walls, and the wall count.

    What is known of a wall grows with what was seen of it: a rival may look at a part not seen yet. `slack`
    widens what counts as the same wall.
    """
    out = np.empty((len(poses), 3))
    if len(poses):
        places.explained(view(scan.rows), walls, view(poses), slack, view(out))
    return out[:, 0], out[:, 1], out[:, 2].astype(np.int64)


def seen_through(scan: Scan, walls: Array, pose: Sequence[float], both: bool = False) -> float:
    """Return the share of the seen wall length that lies behind map walls, from a supposed pose."""
    if len(scan.z) == 0:
        return 0.0
    length = scan.ends[:, 1] - scan.ends[:, 0]
    return float(behind_walls(scan, walls, pose, both) @ length / length.sum())


def behind_walls(scan: Scan, walls: Array, pose: Sequence[float], both: bool = False) -> Array:
    """Return the share of every seen wall (k,) that lies behind map walls, from a supposed pose (3,).

    `both`: walls block the sight from their unseen side too.
    """
    out, (x, y, theta) = np.zeros(len(scan.z)), pose
    if len(walls) and len(out):
        places.behind(view(scan.rows), walls, x, y, theta, both, view(out))
    return out


def walls_of(lines: LineMap, values: Array, known: Ints | None = None) -> Array:
    """Return map lines in the form of kernels.places, (m, COLUMNS): all that were seen often enough, or `known`.

    `values` (J, 2) are rho and beta of the map's lines.
    """
    known = np.flatnonzero(lines.hits >= MIN_HITS) if known is None else known
    walls = np.empty((len(known), places.COLUMNS))
    walls[:, :2], walls[:, 2:4] = values[known], lines.anchor[known]
    walls[:, 4], walls[:, 5] = lines.lo[known], lines.hi[known]
    viewed: Array = view(walls)
    return viewed


def find_pose(scan: Scan, lines: LineMap, belief: JointBelief, trail: Trail) -> tuple[float, float, float] | None:
    """Return the only pose (x, y, theta) that explains the scan; None if there is none or several.

    Another one counts as a rival unless scans of the trail contradict it.
    """
    values = lines.values(belief)
    known = np.flatnonzero(lines.hits >= MIN_HITS)
    known = known[np.argsort(-lines.hits[known], kind="stable")][:MAX_MAP_WALLS]
    if len(scan.z) < MIN_WALLS or len(known) < 2:
        return None
    # a compass may have kept the heading while the place was lost
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
    tried = np.vstack((pose, rivals))
    tried = tried[_through_both(tried, scan, all_walls) < MAX_THROUGH_SHARE]
    last = _lasting(tried, trail.back_from(here), walls, all_walls)
    if len(last) != 1 or (last[0] != pose).any():
        return None
    x, y, theta = pose.tolist()
    return x, y, belief.theta + float(se2.wrap_all(np.array(theta - belief.theta)))


def _through_both(poses: Array, scan: Scan, walls: Array) -> Array:
    """Return for each pose (h, 3) the share of the scan that is hidden behind walls of either side."""
    return np.array([seen_through(scan, walls, pose, both=True) for pose in poses.tolist()])


def _lasting(poses: Array, before: Iterable[tuple[Array, Scan]], walls: Array, all_walls: Array) -> Array:
    """Return those poses (h, 3) that few earlier scans contradict; `before`: relative poses (3,) and scans."""
    against = np.zeros(len(poses), dtype=np.int64)
    for step, scan in before:
        if not len(poses):
            break
        then = se2.compose(poses, step)
        _, possible, _ = explained(then, scan, walls, TRAIL_SLACK)
        through = _through_both(then, scan, all_walls)
        against += (possible < RIVAL_SHARE * MIN_SHARE) | (through >= AGAINST_SHARE)
        poses, against = poses[against < MAX_AGAINST], against[against < MAX_AGAINST]
    return poses


class Closure(NamedTuple):
    """The pose of one map's frame in another's."""

    pose: Array  # (3,)
    P: Array  # (3, 3) large in directions that no wall constrains
    length: float  # m of walls that agree
    walls: int


class Here(NamedTuple):
    """A map with its path, in its own frame."""

    lines: LineMap  # none of them is a state
    way: Way


def find_closure(there: Here, here: Here, expected: Array, P: Array) -> Closure | None:
    """Return the pose of map `here` in map `there`; None if no pose fits or several fit.

    `expected` (3,) and P (3, 3) are what is known of it already.
    """
    scan = as_scan(here.lines, MIN_HITS)
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
    if len(others) > MAX_TURNED_RIVALS or not all(contradicted(there, here, pose) for pose in others):
        return None
    found = _refined(places.poses[places.best], scan, there, known, expected, P)
    if found is None or not _enough(found, expected, P) or contradicted(there, here, found.pose):
        return None
    return found._replace(P=found.P + left_open(rivals[~turned]))


def _enough(found: Closure, expected: Array, P: Array) -> bool:
    """Return whether a place explains enough walls; a place far from the expected one must explain more."""
    asked: tuple[tuple[int, float], ...] = (MIN_WALLS_M,)
    if chi2_of(found.pose[None], expected, P + SLACK_P)[0] > MAX_CHI2:
        asked = (MIN_UNEXPECTED_WALLS_M,)
    elif float(P[0, 0] + P[1, 1]) < NEAR_SIGMA_M**2:
        asked = (MIN_WALLS_M, MIN_LONG_WALLS_M)
    return any(found.walls >= n and found.length >= m for n, m in asked)


def left_open(rivals: Array) -> Array:
    """Return the covariance (3, 3) of the best pose that includes rivals (n, 3), which fit equally well.

    Along a corridor there are many; across it and in heading they agree.
    """
    apart = rivals[np.hypot(*rivals[:, :2].T) > MAP_APART_M, :2]
    P = np.zeros((3, 3))
    if len(apart):
        P[:2, :2] = apart.T @ apart * (np.square(apart).sum(axis=1).max() / np.square(apart).sum())
    return P


def contradicted(there: Here, here: Here, pose: Array) -> bool:
    """Return whether scans of either map see through walls of the other, more than through walls of their own map.

    What is known of a wall reaches over its doors, so that a little is seen through any.
    """
    ours, theirs = walls_of(here.lines, here.lines.value), walls_of(there.lines, there.lines.value)
    across = _through(here.way, pose, theirs) + _through(there.way, se2.inverse(pose), ours)
    within = _through(here.way, np.zeros(3), ours) + _through(there.way, np.zeros(3), theirs)
    return 0.5 * (across - within) > MAX_MAP_THROUGH_SHARE


def _through(way: Way, frame: Array, walls: Array) -> float:
    """Return the mean share of a path's scans that is hidden behind walls, with the path's frame at `frame`."""
    if not way.sights:
        return 0.0
    seen = (seen_through(s.scan, walls, se2.compose(frame, s.pose).tolist()) for s in way.sights)
    return float(np.mean(list(seen)))


def _refined(pose: Array, scan: Scan, there: Here, known: Ints, expected: Array, P: Array) -> Closure | None:
    """Align the walls of the scan with those of the map: Gauss-Newton over pairs that are the same wall."""
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
    x: Array, scan: Scan, there: Here, known: Ints, near: float, turned: float
) -> tuple[Array, Array, Array, Array]:
    """Return J (2p, 3), residuals (2p,), weights (2p,) of p pairs of walls, and the lengths (p,) they share."""
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


class Looks:
    """Candidate poses of the present map in each frozen map, in order of time."""

    def __init__(self) -> None:
        self._found: dict[int, tuple[Closure, int]] = {}  # anchor -> the last look, how many agree with it

    def count(self, anchor: int) -> int:
        """Return the number of candidates that agree on the map's pose in an anchor's map."""
        return self._found[anchor][1] if anchor in self._found else 0

    def agree(self, anchor: int, found: Closure | None, unknown: bool, anchors: Anchors) -> bool:
        """Add a candidate in the map of an anchor, and return whether it may close a loop.

        Where the place of the map at hand is not known, more is asked: long walls, one more look, and that it
        is not seen in another map at another place.
        """
        if found is None or (unknown and found.length < UNKNOWN_LENGTH_M):
            self._found.pop(anchor, None)
            return False
        before, looks = self._found.get(anchor, (found, 0))
        self._found[anchor] = found, looks + 1 if _same(before, found) else 1
        if not unknown:
            return self.count(anchor) >= AGREEING_LOOKS
        return self.count(anchor) >= UNKNOWN_LOOKS and not self._rivalled(anchor, anchors)

    def _rivalled(self, anchor: int, anchors: Anchors) -> bool:
        """Return whether candidates in other maps show that the present map may also lie elsewhere."""
        places = {k: se2.compose(anchors.pose[k], found.pose) for k, (found, _) in self._found.items()}
        x, y, _ = places[anchor].tolist()
        return any(math.hypot(place[0] - x, place[1] - y) > ELSEWHERE_M for place in places.values())


def _same(one: Closure, other: Closure) -> bool:
    """Return whether two candidates agree on a pose, within their covariances."""
    return bool(chi2_of(other.pose[None], one.pose, one.P + other.P)[0] < SAME_CHI2)


def is_open(P: Array) -> bool:
    """Return whether a relative pose of covariance P (3, 3) is unknown, as after a lost robot began a map."""
    return float(P[0, 0] + P[1, 1]) > OPEN_SIGMA_M**2 or float(P[2, 2]) > OPEN_SIGMA_RAD**2
