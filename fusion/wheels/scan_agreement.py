"""Agreement of a motion with a laser: the share of a scan's points that lie on the scan one second before.

Pairs of scans are chosen from the whole log. A motion converts the later scan of each pair to the frame of the
earlier one; a point within 10 cm of a point of the earlier scan agrees. The mean share of agreeing points, s, is
computed for the motion by the wheels, for a robot at rest, and for the motion by matching the scans.

A reversed motion is equivalent to a laser turned by 180 degrees, and a motion with the opposite turns to an
upside-down laser. So s is the maximum over four directions of the laser, each also mirrored, and the directions
in which the laser moved by scan matching. With a single wall every motion along it agrees.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from itertools import chain
from typing import Any

import msgspec
import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints, Stream
from locfuse.fusion.lines.points import ScanPoints
from locfuse.fusion.lines.scans import SCAN_FIELDS, Laser
from locfuse.fusion.scan_matching.match import FLOOR_RAD, Clouds, Targets, few, match, sources_of
from locfuse.fusion.statistics import robust_sigma
from locfuse.fusion.streams import seconds

from .motion_by_scans import STANDING
from .read import WheelReading

PAIR_COUNT, MIN_MOVING = 60, 20  # number of pairs; with so many moving pairs, pairs at rest are not used
PAIR_S, MAX_PAIR_S = 1.0, 3.0  # s, wanted and largest time between the scans of a pair
MOVES_M, MOVES_RAD = 0.05, np.radians(3.0)  # least motion of a moving pair
NEAR_M = 0.1  # largest distance of an agreeing point from a point of the earlier scan
LATER_POINTS, SURFACE_POINTS = 90, 360  # of the later and of the earlier scan
MATCHED_POINTS = 40  # of a scan between both
SEARCH_STRIDE = 4  # every fourth point is used while clock and mount are searched
# laser parameters of the search: turn [rad] and mirroring relative to the mount, lag [s] of the clock, x and y
# offset [m] from the configured mount
AS_CONFIGURED, LAG, AHEAD, ASIDE = np.zeros(5), *np.eye(5)[2:]
TURNS = np.array([(turn, side, 0, 0, 0) for side in (0, 1) for turn in np.radians([0.0, 90.0, 180.0, -90.0])])
LAGS_S, FINER_S = np.linspace(-0.5, 0.5, 11), np.array([-0.05, 0.05])  # of the laser's clock
MAX_FAR_LAG_S, FAR_STEP_S = 60.0, 0.1  # s: larger lags, found by the turns of the pairs
MIN_FAR_CORRELATION, MAX_NEAR_CORRELATION = 0.8, 0.5  # of the turns, at a far lag; at those in LAGS_S
OFFSETS_M = np.array([-0.3, -0.2, -0.1, 0.1, 0.2, 0.3])
STEP_S = 0.2  # s between matched scans within a pair
STEP_PRIOR = np.diag([0.2**-2, 0.2**-2, np.radians(12.0) ** -2])  # weak prior of a step
BETWEEN_PRIOR = np.diag([0.1**-2, 0.1**-2, np.radians(4.0) ** -2])  # prior of a pair after its steps were matched
STEP_REACH_M, REACH_M = 0.6, 0.3
LANE_M = 1e4  # offset between two scans in the common search tree


class ScanPairs(msgspec.Struct, frozen=True, dict=True):
    """Pairs of scans of one laser, to measure how well motions agree with it.

    The agreement s of a motion is the share of the later scan's points that lie on the earlier scan.
    """

    stream: Stream
    laser: Laser
    t: Array  # (n,) s of all scans, since the first
    first: Ints  # (p,) index of the earlier scan of each pair
    later: Ints  # (p,) index of the later scan
    surface: list[Array]  # p of (k, 2) m: points of the earlier scan, in the laser's frame
    points: list[Array]  # p of (k, 2) m: points of the later scan

    @property
    def judge(self) -> bool:
        """Return whether the share s of agreeing points can be computed: earlier and later scans have points."""
        return any(len(p) for p in self.points) and any(len(p) for p in self.surface)

    def share(self, moved: Array, stride: int = 1) -> float:
        """Return the share s of the later scan's points that lie on the earlier scan, as the mean over the pairs.

        `moved` (p, 3) are laser poses at the later scan in the frame of the earlier one. Every `stride`-th point
        is used.
        """
        points = [p[::stride] for p in self.points]
        counts = [len(p) for p in points]
        lane = np.repeat(np.arange(len(counts)), counts)
        at = se2.transform(moved[lane], np.concatenate(points))
        places = np.column_stack((at, LANE_M * lane))
        distance, _ = self._tree.query(places, distance_upper_bound=NEAR_M, workers=1)
        near = np.bincount(lane, np.isfinite(distance), len(counts))
        seen = np.array(counts) > 0
        return float(np.mean(near[seen] / np.array(counts)[seen]))

    @cached_property
    def still(self) -> float:
        """The share s of agreeing points that would result if the robot did not move."""
        return self.share(np.zeros((len(self.first), 3)))

    def of(self, motion: WheelReading) -> float:
        """Return the share s of scan points that agree with a wheel motion.

        The laser's direction, mirroring, clock and position are chosen so that s is largest.
        """
        return self.share(self._by(motion, self._best_laser(motion)))

    def misfit(self, motion: WheelReading) -> float:
        """Return the median difference [sigmas] between the turns by a wheel motion and by scan matching."""
        how = self._best_laser(motion)
        off = se2.wrap_all(self._by(motion, how)[:, 2] - self._poses[:, 2])
        begin, end = self._within(motion, how[2])
        variance = motion.wheels.between(begin, end).Q[:, 2, 2] + FLOOR_RAD**2
        return robust_sigma(off / np.sqrt(variance))

    def _best_laser(self, motion: WheelReading) -> Array:
        """Search for the laser's turn [rad], mirroring, lag [s] and offsets [m] with the largest share s."""
        best: Array = AS_CONFIGURED + self._far_lag(motion) * LAG
        share = self.share(self._by(motion, best), SEARCH_STRIDE)
        lags, offsets = ((LAGS_S, LAG), (FINER_S, LAG)), ((OFFSETS_M, AHEAD), (OFFSETS_M, ASIDE))
        turns = np.concatenate((TURNS, self._turns_by_matching(motion, best)))
        for steps in (turns, *(sizes[:, None] * part for sizes, part in (*lags, *offsets))):
            tries = [best + step for step in steps if step.any()]
            shares = [self.share(self._by(motion, one), SEARCH_STRIDE) for one in tries]
            if shares and max(shares) > share:
                share, best = max(shares), tries[int(np.argmax(shares))]
        return best

    def _turns_by_matching(self, motion: WheelReading, how: Array) -> Array:
        """Return the laser's turns (2, 5), plain and mirrored, that best align a motion's ways with the scans.

        The ways are complex numbers [m] in the laser's frame; the phase of their product is their angle.
        """
        own, (x, y) = self._by(motion, how), self._poses[:, :2].T
        way = own[:, 0] + 1j * own[:, 1]
        turns = np.angle([np.vdot(x + 1j * y, way), np.vdot(x - 1j * y, way)])
        return np.array([(turn, side, 0, 0, 0) for side, turn in enumerate(turns.tolist())])

    def _far_lag(self, motion: WheelReading) -> float:
        """Return the lag [s] at which the motion turns as by scan matching, if that is a far one; else 0."""
        lags = np.arange(-MAX_FAR_LAG_S, MAX_FAR_LAG_S, FAR_STEP_S)
        ends = self._within(motion, lags[:, None])
        begin, end = (motion.wheels.heading(t.ravel()).reshape(len(lags), -1) for t in ends)
        turned, own = end - begin, self._poses[:, 2] - self._poses[:, 2].mean()
        turned -= turned.mean(axis=1, keepdims=True)
        lengths = np.sqrt((turned**2).sum(axis=1) * float(own @ own))
        fits = np.abs(np.divide(turned @ own, lengths, out=np.zeros(len(lags)), where=lengths > 0.0))
        near, best = float(fits[np.abs(lags) <= LAGS_S[-1]].max()), int(np.argmax(fits))
        return float(lags[best]) if fits[best] > MIN_FAR_CORRELATION and near < MAX_NEAR_CORRELATION else 0.0

    def of_path(self, motion: WheelReading) -> float:
        """Return the share of scan points that fit the other scan of a pair, for a motion by matching these scans.

        Clock and mount of the laser are used as configured, without a search.
        """
        return self.share(self._by(motion, AS_CONFIGURED))

    def matched(self) -> float:
        """Return the share s of agreeing points for the motion found by matching the two scans of each pair."""
        return self.share(self._poses)

    @cached_property
    def _poses(self) -> Array:
        """Return the laser's motion over each pair (p, 3) by scan matching: in short steps, then directly."""
        chains = []
        for i, j in zip(self.first.tolist(), self.later.tolist(), strict=True):  # scans STEP_S apart
            wanted = np.searchsorted(self.t, np.arange(self.t[i], self.t[j] - 0.5 * STEP_S, STEP_S))
            chains.append(np.unique(np.append(np.clip(wanted, i, j - 1), j)))
        rows, at = np.unique(np.concatenate(chains), return_inverse=True)
        clouds = Clouds.of_scans(_points(self.stream, self.laser, rows, LATER_POINTS * 2), np.zeros(2))
        targets, sources = Targets(clouds), sources_of(clouds, MATCHED_POINTS)
        ends = np.cumsum([len(chain) for chain in chains])
        step = np.setdiff1d(np.arange(len(at) - 1), ends - 1)
        i, j, start = at[step], at[step + 1], np.zeros((len(step), 3))
        prior = np.broadcast_to(STEP_PRIOR, (len(step), 3, 3))
        found = match(targets, i, sources, j, start, prior, STEP_REACH_M).pose
        moved = np.stack([se2.chain(part)[-1] for part in np.split(found, ends[:-1] - np.arange(1, len(chains)))])
        i, j = at[ends - [len(chain) for chain in chains]], at[ends - 1]
        prior = np.broadcast_to(BETWEEN_PRIOR, (len(i), 3, 3))
        return max(moved, match(targets, i, sources, j, moved, prior, REACH_M).pose, key=self.share)

    @cached_property
    def _tree(self) -> Any:
        from scipy.spatial import cKDTree

        counts = [len(p) for p in self.surface]
        lane = np.repeat(np.arange(len(counts)), counts)
        return cKDTree(np.column_stack((np.concatenate(self.surface), LANE_M * lane)))

    def _by(self, motion: WheelReading, how: Array) -> Array:
        """Return the laser's motion over each pair (p, 3) by a wheel motion, for laser parameters `how` (4,)."""
        turn, mirrored, lag, ahead, aside = how.tolist()
        mount = self.laser.mount + np.array([ahead, aside, turn])
        body = motion.wheels.relative(*self._within(motion, lag))
        laser = np.broadcast_to(mount, body.shape)
        moved = se2.between(laser, se2.compose(body, laser))
        return moved * [1.0, -1.0, -1.0] if mirrored else moved

    def _within(self, motion: WheelReading, lag: float | Array) -> tuple[Array, Array]:
        """Return begin and end time of each pair (..., p) on the clock of a motion, limited to its range."""
        return _times(self.stream, motion, self.t[self.first] + lag, self.t[self.later] + lag)


def scan_pairs(stream: Stream, laser: Laser, motions: Sequence[WheelReading]) -> ScanPairs | None:
    """Choose up to PAIR_COUNT pairs of scans, about 1 s apart, from the whole log; None without a usable pair.

    A pair is moving if the robot moves between its two scans according to one of `motions` or more. Only moving
    pairs are chosen, but if there are fewer than MIN_MOVING, pairs at rest are chosen too.
    """
    t = seconds(stream.t_ns, stream.t_ns[0]) if len(stream.t_ns) else np.zeros(0)
    later = np.searchsorted(t, t + PAIR_S - 1e-3)
    first = np.flatnonzero(later < len(t))
    later = later[first]
    near = t[later] - t[first] <= MAX_PAIR_S
    first, later = first[near], later[near]
    if not len(first):
        return None
    moves = np.zeros(len(first), dtype=bool)
    for motion in motions:
        u = motion.wheels.relative(*_times(stream, motion, t[first], t[later]))
        moves |= (np.hypot(u[:, 0], u[:, 1]) > MOVES_M) | (np.abs(u[:, 2]) > MOVES_RAD)
    of = np.flatnonzero(moves) if moves.sum() >= MIN_MOVING else np.arange(len(first))
    chosen = of[np.unique(np.linspace(0, len(of) - 1, min(PAIR_COUNT, len(of))).astype(np.int64))]
    first, later = first[chosen], later[chosen]
    both = np.concatenate((first, later))
    rows, at = np.unique(np.concatenate((both, np.maximum(both - 1, 0))), return_inverse=True)
    found = _points(stream, laser, rows, SURFACE_POINTS)
    surface, points, *before = ([found[k] for k in part.tolist()] for part in np.split(at, 4))
    # scans equal to the one before are not used: the scan is older than its stamp, or the robot is at rest
    seen = zip(both.tolist(), (*surface, *points), chain(*before), strict=True)
    new = np.array([row == 0 or not np.array_equal(scan, last) for row, scan, last in seen])
    used = np.flatnonzero(new.reshape(2, -1).all(axis=0)).tolist()
    if not used:
        return None
    surface = [surface[k] for k in used]
    points = [points[k][:: max(1, len(points[k]) // LATER_POINTS)] for k in used]
    return ScanPairs(stream, laser, t, first[used], later[used], surface, points)


def _times(stream: Stream, motion: WheelReading, t_from: Array, t_to: Array) -> tuple[Array, Array]:
    """Convert begin and end times (p,) [s since the first scan] to a motion's clock, limited to its range."""
    shift = (int(stream.t_ns[0]) - motion.epoch_ns) * 1e-9
    begin, end = (np.clip(t + shift, motion.wheels.t[0], motion.wheels.t[-1]) for t in (t_from, t_to))
    return begin, end


def _points(stream: Stream, laser: Laser, rows: Ints, most: int) -> list[Array]:
    """Return points (k, 2) [m] for each of the scans `rows`, in the laser's frame and in the order of beams.

    Of a scan with more than `most` points, only every second, third, ... is returned.
    """
    plain = laser._replace(mount=np.zeros(3), deskew=False)
    scans = ScanPoints(stream, SCAN_FIELDS, np.zeros(len(stream.t_ns)), plain, STANDING, rows)
    return [few(points, np.zeros(2), most) for points in scans.read(np.arange(len(rows)))]
