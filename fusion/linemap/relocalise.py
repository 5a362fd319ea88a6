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

from .line_map import LineMap
from .scan import Scan
from .scan_history import Trail

LONGEST = 5  # seen walls from which pairs are made
MAX_MAP_LINES = 60  # map lines that are considered, the best seen first
MIN_HITS = 4
SKEW = math.radians(25.0)  # two walls must differ by this much in direction to fix a pose
SAME_ANGLE, SAME_OFFSET = math.radians(5.0), 0.25  # a seen wall is a known one within these
EXPLAINED, LINES = 0.7, 3  # share of the seen length, and walls, that a pose must explain
RIVAL = 0.8  # another pose that explains this share of the best one's length makes it ambiguous
APART, TURNED = 0.5, math.radians(20.0)  # m, rad: poses further apart are different
HEADING_SIGMAS, HEADING_SLACK = 4.0, math.radians(10.0)
SAMPLES = 5  # points along a seen wall at which sight lines are tested
BEHIND = 0.3  # m by which a point must lie behind a known wall
MARGIN = 0.2  # m at either end of a known wall that is not trusted to block the sight
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
    return float((behind_walls(scan, lines, values, (x, y, theta), both) * length).sum() / length.sum())


def behind_walls(
    scan: Scan, lines: LineMap, values: Array, pose: tuple[float, float, float], both: bool = False
) -> Array:
    """Return the share of every seen wall (k,) that lies behind known walls, from a supposed pose.

    `values` (J, 2) are rho and beta of the map's lines; `both`: walls block the sight from their unseen side too.
    """
    x, y, theta = pose
    known = np.flatnonzero(lines.hits >= MIN_HITS)
    if len(known) == 0 or len(scan.z) == 0:
        return np.zeros(len(scan.z))
    points = _points(scan)  # (k * SAMPLES, 2) base frame
    distance = np.hypot(points[:, 0], points[:, 1])
    bearing = np.arctan2(points[:, 1], points[:, 0]) + theta
    values = values[known]
    d = np.stack((np.cos(bearing), np.sin(bearing)), axis=-1)
    n = np.stack((np.cos(values[:, 1]), np.sin(values[:, 1])), axis=-1)
    offset = np.array([x, y]) - lines.anchor[known]
    with np.errstate(divide="ignore", invalid="ignore"):
        range_ = (values[:, 0] - (offset * n).sum(axis=1)) / (d @ n.T)
    tangent = np.stack((-n[:, 1], n[:, 0]), axis=-1)
    along = (offset * tangent).sum(axis=1) + range_ * (d @ tangent.T)
    facing = np.abs(d @ n.T) if both else d @ n.T
    blocks = (range_ > 0) & (range_ < distance[:, None] - BEHIND) & (facing > 0.1)
    blocks &= (along > lines.lo[known] + MARGIN) & (along < lines.hi[known] - MARGIN)
    behind: Array = blocks.any(axis=1).reshape(-1, SAMPLES).mean(axis=1)
    return behind


def _points(scan: Scan) -> Array:
    share = (np.arange(SAMPLES) + 0.5) / SAMPLES
    along = scan.ends[:, :1] + share * (scan.ends[:, 1:] - scan.ends[:, :1])
    c, s = np.cos(scan.z[:, 1:]), np.sin(scan.z[:, 1:])
    r = scan.z[:, :1]
    return np.stack((r * c - along * s, r * s + along * c), axis=-1).reshape(-1, 2)


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
    rivals = _distinct(poses[apart & (possible >= RIVAL * share[best])])
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
    beta, n = values[known, 1], np.stack((np.cos(values[known, 1]), np.sin(values[known, 1])), axis=-1)
    rho = values[known, 0] + (lines.anchor[known] * n).sum(axis=1)
    cosine, sine = n @ n.T, np.outer(n[:, 0], n[:, 1]) - np.outer(n[:, 1], n[:, 0])  # of beta[k] - beta[j]
    found = [np.zeros((0, 3))]
    for a, b in combinations(longest.tolist(), 2):
        between = float(se2.wrap_all(scan.z[b, 1] - scan.z[a, 1]))
        if abs(math.sin(between)) < math.sin(SKEW):
            continue
        j, k = np.nonzero(math.cos(between) * cosine + math.sin(between) * sine > math.cos(SAME_ANGLE))
        slack = 0.5 * se2.wrap_all(beta[k] - beta[j] - between)
        theta = se2.wrap_all(beta[j] - scan.z[a, 1] + slack)
        det = sine[j, k]
        p, q = rho[j] - scan.z[a, 0], rho[k] - scan.z[b, 0]
        x, y = (p * n[k, 1] - q * n[j, 1]) / det, (n[j, 0] * q - n[k, 0] * p) / det
        found.append(np.stack((x, y, theta), axis=-1))
    return np.concatenate(found)


def _distinct(poses: Array) -> Array:
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
    length = scan.ends[:, 1] - scan.ends[:, 0]
    share, possible, count = np.zeros(len(poses)), np.zeros(len(poses)), np.zeros(len(poses), dtype=np.int64)
    for at in range(0, len(poses), 512):
        x, y, theta = (poses[at : at + 512, i, None, None] for i in range(3))
        rho, beta = values[known, 0], values[known, 1]
        c, s = np.cos(beta), np.sin(beta)
        dx, dy = x - lines.anchor[known, 0], y - lines.anchor[known, 1]
        turn = se2.wrap_all(scan.z[:, 1, None] + theta - beta)
        offset = scan.z[:, 0, None] - (rho - dx * c - dy * s)
        along = c * dy - s * dx
        lo, hi = scan.ends[:, :1] + along, scan.ends[:, 1:] + along
        overlap = np.minimum(hi, lines.hi[known]) - np.maximum(lo, lines.lo[known])
        same = (np.abs(turn) < slack * SAME_ANGLE) & (np.abs(offset) < slack * SAME_OFFSET)
        possible[at : at + 512] = (same.any(axis=2) * length).sum(axis=1) / length.sum()
        seen = (same & (overlap > 0.6 * length[:, None])).any(axis=2)
        share[at : at + 512] = (seen * length).sum(axis=1) / length.sum()
        count[at : at + 512] = seen.sum(axis=1)
    return share, possible, count
