"""Finding a pose on a line map from one scan: every pair of seen walls against every pair of known ones.

Two walls that are not parallel fix a pose. Each such pose is scored by how much of the scan it explains and
refused where the scan sees through walls; a pose counts only if no other, different one explains nearly as much,
now and along the trail since the robot was lost. A rectangle alone has two (turned by 180 degrees): then nothing
is returned, and the robot stays lost.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.kernels import places
from locfuse.fusion.kernels.arrays import view

from .line_map import LineMap
from .scan import Scan
from .scan_history import Trail

LONGEST = 5  # seen walls from which pairs are made
MAX_MAP_LINES = 60  # map lines that are considered, the best seen first
MIN_HITS = 4
SKEW = math.radians(25.0)  # two walls must differ by this much in direction to fix a pose
EXPLAINED, LINES = 0.7, 3  # share of the seen length, and walls, that a pose must explain
RIVAL = 0.8  # another pose that explains this share of the best one's length makes it ambiguous
APART, TURNED = 0.5, math.radians(20.0)  # m, rad: poses further apart are different
HEADING_SIGMAS, HEADING_SLACK = 4.0, math.radians(10.0)
TOO_MUCH_THROUGH = 0.15
DRIFTED = 2.0  # slack along the trail: wheels drift
OFTEN, CONTRADICTS = 3, 0.35  # scans of the trail that make a pose none; share seen through by which one does


def seen_through(
    scan: Scan, lines: LineMap, values: Array, x: float, y: float, theta: float, both: bool = False
) -> float:
    """Return the share of the seen wall length that lies behind known walls, from a supposed pose."""
    if len(scan.z) == 0:
        return 0.0
    length = scan.ends[:, 1] - scan.ends[:, 0]
    return float(behind_walls(scan, lines, values, (x, y, theta), both) @ length / length.sum())


def behind_walls(
    scan: Scan, lines: LineMap, values: Array, pose: tuple[float, float, float], both: bool = False
) -> Array:
    """Return the share of every seen wall (k,) that lies behind known walls, from a supposed pose.

    `values` (J, 2) are rho and beta of the map's lines; `both`: walls block the sight from their unseen side too.
    """
    known = np.flatnonzero(lines.hits >= MIN_HITS)
    out = np.zeros(len(scan.z))
    if len(known) and len(out):
        places.behind(view(scan.rows), _walls(lines, values, known), *pose, both, view(out))
    return out


def _walls(lines: LineMap, values: Array, known: Ints) -> Array:
    """Return map lines as kernels.places wants them, (m, COLUMNS)."""
    walls = np.empty((len(known), places.COLUMNS))
    walls[:, :2], walls[:, 2:4] = values[known], lines.anchor[known]
    walls[:, 4], walls[:, 5] = lines.lo[known], lines.hi[known]
    viewed: Array = view(walls)
    return viewed


def find_pose(scan: Scan, lines: LineMap, belief: JointBelief, trail: Trail) -> tuple[float, float, float] | None:
    """Return the only pose (x, y, theta) that explains the scan, None where there is none or several.

    Another one counts as a rival unless scans of the trail contradict it.
    """
    values = lines.values(belief)
    known = np.flatnonzero(lines.hits >= MIN_HITS)
    known = known[np.argsort(-lines.hits[known], kind="stable")][:MAX_MAP_LINES]
    if len(scan.z) < LINES or len(known) < 2:
        return None
    poses = hypotheses(scan, lines, values, known)
    poses = poses[_heading_fits(poses[:, 2], belief)]
    if len(poses) == 0:
        return None
    share, possible, count = explained(poses, scan, lines, values, known)
    share = np.where((share >= EXPLAINED) & (count >= LINES), share, 0.0)
    best = int(np.argmax(share))
    if share[best] <= 0.0:
        return None
    pose = poses[best]
    apart = np.hypot(*(poses[:, :2] - pose[:2]).T) > APART
    apart |= np.abs(se2.wrap_all(poses[:, 2] - pose[2])) > TURNED
    rivals = distinct(poses[apart & (possible >= RIVAL * share[best])])
    here = np.array([belief.x, belief.y, belief.theta])
    stand = _standing(np.vstack((pose, rivals)), scan, lines, values)
    last = _lasting(stand, trail.back_from(here), lines, values, known)
    if len(last) != 1 or (last[0] != pose).any():
        return None
    x, y, theta = pose.tolist()
    return x, y, belief.theta + float(se2.wrap_all(np.array(theta - belief.theta)))


def _standing(poses: Array, scan: Scan, lines: LineMap, values: Array) -> Array:
    """Return the poses (h, 3) from which the scan does not see through known walls, from whatever side."""
    through = [seen_through(scan, lines, values, x, y, theta, both=True) for x, y, theta in poses.tolist()]
    return np.asarray(poses[np.array(through) < TOO_MUCH_THROUGH], np.float64)


def _lasting(
    poses: Array, before: Iterable[tuple[Array, Scan]], lines: LineMap, values: Array, known: Ints
) -> Array:
    """Return the poses (h, 3) that earlier scans, each from (3,) as seen from here, contradict less than OFTEN."""
    against = np.zeros(len(poses), dtype=np.int64)
    for step, scan in before:
        if not len(poses):
            break
        then = se2.compose(poses, step)
        _, possible, _ = explained(then, scan, lines, values, known, DRIFTED)
        through = [seen_through(scan, lines, values, x, y, theta, both=True) for x, y, theta in then.tolist()]
        against += (possible < RIVAL * EXPLAINED) | (np.array(through) >= CONTRADICTS)
        poses, against = poses[against < OFTEN], against[against < OFTEN]
    return poses


def _heading_fits(theta: Array, belief: JointBelief) -> NDArray[np.bool_]:
    """Return which headings the belief allows: a compass may have kept it while the place was lost."""
    slack = HEADING_SIGMAS * math.sqrt(max(float(belief.matrix()[2, 2]), 0.0)) + HEADING_SLACK
    return np.asarray(np.abs(se2.wrap_all(theta - belief.theta)) <= slack)


def hypotheses(scan: Scan, lines: LineMap, values: Array, known: Ints, most: int = LONGEST) -> Array:
    """Return poses (h, 3) from pairs of the longest seen walls laid onto pairs of known ones at the same angle."""
    longest = np.argsort(-(scan.ends[:, 1] - scan.ends[:, 0]), kind="stable")[:most]
    pairs = [
        (a, b)
        for a, b in combinations(longest.tolist(), 2)
        if abs(math.sin(scan.z.item(b, 1) - scan.z.item(a, 1))) >= math.sin(SKEW)
    ]
    poses, found = np.empty((len(pairs) * len(known) ** 2, 3)), 0
    rows, walls, out = view(scan.rows), _walls(lines, values, known), view(poses)
    for a, b in pairs:
        found = places.hypotheses(rows, a, b, walls, found, out)
    return poses[:found]


def distinct(poses: Array) -> Array:
    """Return one of the poses (h, 3) in every cell of half the size within which poses count as the same."""
    cells = np.floor(np.column_stack((poses[:, :2] / (0.5 * APART), se2.wrap_all(poses[:, 2]) / (0.5 * TURNED))))
    return poses[np.sort(np.unique(cells, axis=0, return_index=True)[1])]


def explained(
    poses: Array, scan: Scan, lines: LineMap, values: Array, known: Ints, slack: float = 1.0
) -> tuple[Array, Array, Ints]:
    """Return (h,) each: share of the seen length explained, the same were walls longer than known, and walls.

    What is known of a wall grows with what was seen of it: a rival may look at a part that nobody saw yet. `slack`
    widens what counts as the same wall.
    """
    out = np.empty((len(poses), 3))
    if len(poses):
        places.explained(view(scan.rows), _walls(lines, values, known), view(poses), slack, view(out))
    return out[:, 0], out[:, 1], out[:, 2].astype(np.int64)
