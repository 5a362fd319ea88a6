"""Loop closure: finds pairs of submaps that show the same place, in rounds of growing search windows.

A submap is the point cloud of the key scans on a few metres of path. If the relative pose of two submaps is known
well, they are matched directly. Otherwise a correlative search tries all shifts and turns; the Fourier transform
computes all shifts of one turn at once (score: Olson 2009, "Real-time correlative scan matching").

A candidate is accepted if its points fit, if no scan looks through walls of the other submap, if it agrees with
the graph within the covariance, and if it agrees with another candidate at neighbouring submaps. Rejected
candidates are tested again after each solve, since each closed loop reduces the uncertainty of all others.
"""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
from msgspec import field
from numpy.typing import NDArray

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Estimates, Ints, Mask
from locfuse.fusion.scan_matching.match import (
    Clouds,
    Columns,
    Matches,
    Targets,
    match,
    merged,
    sources_of,
    thinned,
)
from locfuse.fusion.scan_matching.solve import Edges, Normal, Problem, chi2_of, relative

from .odometry import Odometry

# path length between two submaps, and of one submap before and after its middle
SPACING_M, HALF_LENGTH_M = 3.0, 3.0
CELL_M, TURN_RAD = 0.25, np.radians(3.0)  # step of the correlative search
REACH_M = 12.0  # points further from the middle are left out
GRID_CELLS = 256  # cells per side of the transform: submap and search window fit without wrapping
MAX_SHIFT_M = 0.5 * GRID_CELLS * CELL_M - 2.0 - REACH_M
APART_M = 1.5  # two peaks further apart are two places
ALIKE_SHARE = 0.93  # if the second peak has this share of the best score, the search is undecided
MIN_LOOP_LENGTH_M = 15.0  # least path length of a loop
MAX_APART_M = 5.0  # between the middles of two submaps that overlap
NARROW_M, NARROW_RAD = 0.35, np.radians(4.0)  # 1 sigma up to which scan matching works without a search
SEARCH_SIGMAS_M = (2.0, 4.0, 8.0, 16.0, 16.0, 16.0)  # 1 sigma of the widest search in each round
MAX_VISITS = 6  # candidates of one submap in a round
MAX_SEARCHES = 100  # correlative searches in a round, smallest windows first
MIN_INLIERS, MIN_OVERLAP, MAX_RMS_M = 0.65, 0.4, 0.05
MAX_THROUGH = 0.05  # largest share of points in space that the other scans saw as free
# free space: number of directions of a view; margin by which a point in free space is nearer than the free range
# (in m, and as share of the range); least number of points for the test
BIN_COUNT, MARGIN_M, MARGIN_SHARE, MIN_POINTS = 360, 0.3, 0.03, 20
PAIRS_AT_ONCE = 2000  # pairs of keys: the points of more take hundreds of MB
MAX_CONDITION = 1e4
MAX_CHI2 = 16.3  # 99.9 % quantile, 3 degrees of freedom
GRAPH_P_FACTOR = 4.0  # the graph's covariance is multiplied by this when a candidate is tested
MOVED_M, MOVED_RAD = 0.05, np.radians(0.5)  # a rejected candidate is tested again if its guess moved this far
NARROWER_SHARE = 0.7  # a search is repeated if its window shrank to this share
CLOSURE_WIDTH_SIGMAS = 4.0  # width of the robust kernel
MIN_KEPT_WEIGHT = 0.3  # a closure with a lower weight after the solve is removed
SUPPORT_M, SUPPORT_RAD = 0.35, np.radians(2.5)  # largest disagreement of two candidates at neighbouring submaps
MAX_SUPPORT_DISTANCE_M = 12.0  # largest path length between neighbouring submaps
# 1 sigma of a place that the filter recognised: half of NARROW_M, since key scans were taken near the place
SIGMA_M, SIGMA_RAD = 0.5 * NARROW_M, 0.5 * NARROW_RAD
KERNEL_WIDTH_FACTORS = (1e4, 1e3, 1e2, 10.0, 1.0)


class Views(msgspec.Struct, frozen=True):
    """Free range of every key scan in each of BIN_COUNT directions.

    If a scan sees free space where another scan saw a wall, one of the two poses is wrong.
    """

    origin: Array  # (2,) the laser on the base
    depth: Array  # (n, BIN_COUNT) m; NaN without points

    @classmethod
    def of(cls, clouds: Clouds, origin: Array) -> Views:
        """Return the free ranges of scans, from the laser at `origin` (2,) [m] on the base.

        The free range in a direction is the shortest range of its bin and the two bins beside it.
        """
        depth = np.full((len(clouds), BIN_COUNT), np.inf)
        bins, ranges = _polar(clouds.xy - origin)
        np.minimum.at(depth, (clouds.owner, bins), ranges)
        nearest = np.minimum.reduce([np.roll(depth, s, axis=1) for s in (-1, 0, 1)])
        return cls(origin, np.where(np.isfinite(nearest), nearest, np.nan))

    def contradicted(self, clouds: Clouds, i: Ints, j: Ints, pose: Array) -> tuple[Any, Any]:
        """Count for each pair (p,) the points of scan j in the free space of scan i: these contradict the pose.

        Returns this count, and the number of all points of scan j in the view of scan i, (p,) each. `pose` (p, 3)
        is the pose of key j in the frame of key i.
        """
        bad, judged = [], []
        for some in np.array_split(np.arange(len(i)), len(i) // PAIRS_AT_ONCE + 1):
            rows, of = clouds.rows(j[some])
            bins, ranges = _polar(se2.transform(pose[some][of], clouds.xy[rows]) - self.origin)
            seen = self.depth[i[some][of], bins]
            with np.errstate(invalid="ignore"):
                through = ranges < seen * (1.0 - MARGIN_SHARE) - MARGIN_M
            bad.append(np.bincount(of, through, len(some)))
            judged.append(np.bincount(of, np.isfinite(seen), len(some)))
        return np.concatenate(bad), np.concatenate(judged)


def _polar(points: Array) -> tuple[Ints, Array]:
    turns = np.arctan2(points[:, 1], points[:, 0]) / (2.0 * np.pi) % 1.0
    return np.floor(turns * BIN_COUNT).astype(np.int64) % BIN_COUNT, np.hypot(points[:, 0], points[:, 1])


class Submaps(msgspec.Struct, frozen=True):
    """Submaps: each is the points of neighbouring keys, in the frame of the middle one of these keys."""

    middle: Ints  # (s,) index of the middle key
    members: list[Ints]  # indices of the keys of each submap
    clouds: Clouds  # of the s submaps
    keys: Clouds  # of the n single keys
    views: Views  # of the n single keys
    driven: Array  # (n,) m, path length driven until each key


def submaps_of(keys: Clouds, origin: Array, x: Array, driven: Array) -> Submaps:
    """Group keys at poses x (n, 3), with path lengths `driven` (n,) [m], into submaps that overlap by half."""
    middle = np.flatnonzero(np.diff(np.floor(driven / SPACING_M), prepend=-1.0) > 0)
    members = [np.flatnonzero(np.abs(driven - driven[k]) <= HALF_LENGTH_M) for k in middle.tolist()]
    poses = [se2.between(x[k], x[group]) for k, group in zip(middle.tolist(), members, strict=True)]
    return Submaps(middle, members, merged(keys, members, poses), keys, Views.of(keys, origin), driven)


class Peak(msgspec.Struct, frozen=True):
    """Result of a correlative search: the best relative pose of two submaps and its score."""

    pose: Array  # (3,)
    score: float  # share of occupied cells that agree
    second: float  # best score further than APART_M from the best pose
    edge: bool  # whether the best pose lies at the edge of the search window

    @property
    def is_decided(self) -> bool:
        """Return whether the best pose is unique: no other pose has a similar score."""
        return not self.edge and self.second < ALIKE_SHARE * self.score


def correlate(ours: Array, theirs: Array, guess: Array, sigma: Array) -> Peak:
    """Search for the pose of points `theirs` (k, 2) in the frame of `ours` (m, 2), within 3 sigma of `guess`."""
    from scipy.fft import irfft2, rfft2

    target = rfft2(_raster(ours, spread=True))
    half = min(3.0 * float(sigma[2]), np.pi)
    n = int(np.ceil(half / TURN_RAD))
    turns = np.arange(-n, n + 1) * TURN_RAD
    reach = np.minimum(3.0 * np.hypot(sigma[0], sigma[1]) + 2.0 * CELL_M, MAX_SHIFT_M)
    cells = int(reach / CELL_M)
    shift = np.round(guess[:2] / CELL_M).astype(np.int64)
    window = np.arange(-cells, cells + 1)
    rows, columns = (window + shift[1]) % GRID_CELLS, (window + shift[0]) % GRID_CELLS
    scores = np.empty((len(turns), len(window), len(window)), np.float32)
    for n, turn in enumerate(turns.tolist()):
        other = _raster(se2.rotated(np.array(guess[2] + turn), theirs), spread=False)
        total = max(float(other.sum()), 1.0)
        shifted = irfft2(target * np.conj(rfft2(other)), s=(GRID_CELLS, GRID_CELLS))
        scores[n] = shifted[np.ix_(rows, columns)] / total
    k, r, c = (int(i) for i in np.unravel_index(int(scores.argmax()), scores.shape))
    dy, dx = window[r] + shift[1], window[c] + shift[0]
    away = (window[:, None] - window[r]) ** 2 + (window[None, :] - window[c]) ** 2 > (APART_M / CELL_M) ** 2
    elsewhere = scores[:, away]
    second = float(elsewhere.max()) if elsewhere.size else 0.0
    edge = bool(min(r, c) == 0 or max(r, c) == len(window) - 1)
    pose = np.array([dx * CELL_M, dy * CELL_M, guess[2] + turns[k]])
    return Peak(pose, float(scores[k, r, c]), second, edge)


def _raster(points: Array, spread: bool) -> NDArray[np.float32]:
    """Rasterise points (k, 2) [m] to a grid with 1 in occupied cells; with `spread`, 0.5 in neighbouring cells."""
    cells = np.round(points[np.abs(points).max(axis=1) < REACH_M] / CELL_M).astype(np.int64) % GRID_CELLS
    grid = np.zeros((GRID_CELLS, GRID_CELLS), np.float32)
    grid[cells[:, 1], cells[:, 0]] = 1.0
    if spread:
        around = np.maximum.reduce([np.roll(grid, (dy, dx), (0, 1)) for dy in (-1, 0, 1) for dx in (-1, 0, 1)])
        grid = np.maximum(grid, np.float32(0.5) * around)
    return grid


class Loops(msgspec.Struct):
    """State of the loop search: closures found so far, undecided and rejected candidates."""

    edges: Edges = field(default_factory=Edges.none)  # between middle keys
    pair: set[tuple[int, int]] = set()  # pairs of submaps with a closure
    undecided: dict[tuple[int, int], str] = {}  # pair -> reason
    searched: dict[tuple[int, int], float] = {}  # pair -> 1 sigma of the last search [m]
    rejected: dict[tuple[int, int], Array] = {}  # pair -> guess that did not fit
    searches: int = 0


class Candidates(Columns, frozen=True):
    """Pairs of submaps that may show the same place."""

    a: Ints  # (c,) earlier submap
    b: Ints  # (c,) later submap
    guess: Array  # (c, 3) middle key of b in the frame of that of a, by the graph
    P: Array  # (c, 3, 3) covariance of the guess, in the frame of a

    @property
    def sigma(self) -> Array:
        """Return the standard deviations of the guesses (c, 3) [m, m, rad]."""
        return np.sqrt(np.maximum(np.diagonal(self.P, axis1=1, axis2=2), 0.0))


def close(x: Array, edges: Edges, problem: Problem, maps: Submaps, hints: Edges) -> tuple[Array, Edges, Loops]:
    """Search and close loops; return the key poses (n, 3), all edges, and the loops.

    `hints` are edges between keys that guide the search; they are not among the returned edges.
    """
    loops = Loops()
    x, normal = problem.solve(x, Edges.joined(edges, hints), KERNEL_WIDTH_FACTORS if len(hints) else (1.0,))
    hints = hints.take(hints.weights(x) > MIN_KEPT_WEIGHT)
    targets, sources = Targets(thinned(maps.clouds)), sources_of(maps.clouds, 200)
    for wide in SEARCH_SIGMAS_M:
        before = set(loops.pair)
        found = candidates(x, normal, maps, loops)
        known, start = placed(found, maps, wide, loops)
        if len(known.a):
            new = judged(known, start, targets, sources, maps, x, loops)
            trial = Edges.joined(edges, hints, loops.edges, new)
            x, normal = problem.solve(x, trial, KERNEL_WIDTH_FACTORS)
            loops.edges = Edges.joined(loops.edges, new)
            loops.edges = loops.edges.take(loops.edges.weights(x) > MIN_KEPT_WEIGHT)
            index = {int(k): s for s, k in enumerate(maps.middle.tolist())}
            ends = zip(loops.edges.i.tolist(), loops.edges.j.tolist(), strict=True)
            loops.pair = {(index[i], index[j]) for i, j in ends}
        if loops.pair == before and wide == SEARCH_SIGMAS_M[-1]:
            break
    return x, Edges.joined(edges, loops.edges), loops


def candidates(x: Array, normal: Normal, maps: Submaps, loops: Loops) -> Candidates:
    """Return the pairs of submaps without a closure that may overlap according to the graph."""
    middle, driven = maps.middle, maps.driven
    a, b = np.triu_indices(len(middle), 1)
    apart = np.hypot(*(x[middle[b], :2] - x[middle[a], :2]).T)
    closed = np.zeros((len(middle), len(middle)), bool)
    for pair in loops.pair:
        closed[pair] = True
    possible = (apart < 2.0 * MAX_APART_M) & ~closed[a, b]
    possible &= driven[middle[b]] - driven[middle[a]] > MIN_LOOP_LENGTH_M
    a, b, apart = a[possible], b[possible], apart[possible]
    some, at = np.unique(np.concatenate((a, b)), return_inverse=True)
    guess, P = relative(x[middle[some]], normal.joint(middle[some]), at[: len(a)], at[len(a) :])
    sigma = np.sqrt(np.maximum(P[:, 0, 0] + P[:, 1, 1], 0.0))
    likely = apart < MAX_APART_M + np.minimum(2.0 * sigma, MAX_APART_M)
    at = np.flatnonzero(likely)
    at = at[np.lexsort(((apart + sigma)[at], b[at]))]
    nth = np.arange(len(at)) - np.searchsorted(b[at], b[at])  # of each later submap, the nearest ones are kept
    at = np.sort(at[nth < MAX_VISITS])
    return Candidates(a[at], b[at], guess[at], P[at])


def placed(found: Candidates, maps: Submaps, wide: float, loops: Loops) -> tuple[Candidates, Array]:
    """Return the candidates whose relative pose is known well enough for scan matching, and this pose (c, 3)."""
    sigma = found.sigma
    reach = np.hypot(sigma[:, 0], sigma[:, 1])
    narrow = (reach < NARROW_M) & (sigma[:, 2] < NARROW_RAD)
    start, known = found.guess.copy(), narrow.copy()
    pairs = list(zip(found.a.tolist(), found.b.tolist(), strict=True))
    narrower = reach < NARROWER_SHARE * np.array([loops.searched.get(p, np.inf) for p in pairs])
    moved = (_has_moved(loops.rejected.get(p), guess) for p, guess in zip(pairs, found.guess, strict=True))
    known &= np.fromiter(moved, bool)
    searched = np.flatnonzero(~narrow & (reach < wide) & narrower)
    for c in searched[np.argsort(reach[searched], kind="stable")][:MAX_SEARCHES].tolist():
        ours, theirs = (maps.clouds.xy[maps.clouds.rows(one[[c]])[0]] for one in (found.a, found.b))
        peak = correlate(ours, theirs, found.guess[c], sigma[c])
        loops.searches += 1
        pair = pairs[c]
        loops.searched[pair] = float(reach[c])
        if peak.is_decided:
            start[c], known[c] = peak.pose, True
        elif not peak.edge:
            loops.undecided[pair] = "two places fit alike"
    at = np.flatnonzero(known)
    return found.take(at), start[at]


def _has_moved(rejected: Array | None, guess: Array) -> bool:
    """Return whether the guess of a rejected candidate changed enough to test the candidate again."""
    if rejected is None:
        return True
    step = se2.between(rejected, guess)
    return bool(np.hypot(step[0], step[1]) > MOVED_M or abs(se2.wrap(float(step[2]))) > MOVED_RAD)


def judged(
    c: Candidates, start: Array, targets: Targets, sources: Clouds, maps: Submaps, x: Array, loops: Loops
) -> Edges:
    """Test candidates by scan matching; return the accepted ones as edges between the middle keys."""
    loose = np.diag([0.2**2, 0.2**2, np.radians(3.0) ** 2])
    prior = np.asarray(np.linalg.inv(c.P + loose), np.float64)
    found = match(targets, c.a, sources, c.b, start, prior, 1.0)
    fits = (found.inliers > MIN_INLIERS) & (found.overlap > MIN_OVERLAP) & (found.rms < MAX_RMS_M)
    fits &= np.linalg.cond(found.information) < MAX_CONDITION
    S = GRAPH_P_FACTOR * c.P + np.linalg.inv(found.information + 1e-3 * np.eye(3))
    fits &= chi2_of(found.pose, c.guess, S) < MAX_CHI2
    for k in np.flatnonzero(~fits).tolist():
        loops.rejected[int(c.a[k]), int(c.b[k])] = c.guess[k]
    at = np.flatnonzero(fits)
    at = at[through_walls(c.take(at), found.pose[at], maps, x) < MAX_THROUGH]
    c, found = c.take(at), found.take(at)
    supported = support(c, found, maps, x, loops)
    for k in np.flatnonzero(~supported).tolist():
        loops.undecided[int(c.a[k]), int(c.b[k])] = "one look alone"
    c, found = c.take(np.flatnonzero(supported)), found.take(supported)
    for pair in zip(c.a.tolist(), c.b.tolist(), strict=True):
        loops.undecided.pop(pair, None)
    i, j = maps.middle[c.a], maps.middle[c.b]
    return Edges.of(i, j, found.alone, found.information, CLOSURE_WIDTH_SIGMAS)


def through_walls(c: Candidates, pose: Array, maps: Submaps, x: Array) -> Array:
    """Return for candidates at `pose` (c, 3) the share of points of one submap in free space of the other."""
    pair, i, j, relative_poses = [], [], [], []
    for k, (a, b) in enumerate(zip(c.a.tolist(), c.b.tolist(), strict=True)):
        ours, theirs = maps.members[a], maps.members[b]
        at_a, at_b = se2.between(x[maps.middle[a]], x[ours]), se2.between(x[maps.middle[b]], x[theirs])
        at_b = se2.compose(pose[k], at_b)
        nearest = np.hypot(*(at_b[:, None, :2] - at_a[None, :, :2]).transpose(2, 0, 1)).argmin(axis=1)
        pair.append(np.full(2 * len(theirs), k))
        i += [ours[nearest], theirs]
        j += [theirs, ours[nearest]]
        relative_poses += [se2.between(at_a[nearest], at_b), se2.between(at_b, at_a[nearest])]
    if not pair:
        return np.zeros(0)
    of, *which = map(np.concatenate, (pair, i, j, relative_poses))
    bad, seen = maps.views.contradicted(maps.keys, *which)
    total = np.bincount(of, seen, len(c.a))
    share = np.bincount(of, bad, len(c.a)) / np.maximum(total, 1.0)
    return np.where(total < MIN_POINTS, 1.0, share)


def support(c: Candidates, found: Matches, maps: Submaps, x: Array, loops: Loops) -> Mask:
    """Return which candidates (c,) agree with another candidate or a closure at neighbouring submaps."""
    driven, i = maps.driven, np.concatenate((maps.middle[c.a], loops.edges.i))
    j = np.concatenate((maps.middle[c.b], loops.edges.j))
    z = np.concatenate((found.pose, loops.edges.z))
    out = np.zeros(len(c.a), dtype=bool)
    for k in range(len(c.a)):
        near = (i != i[k]) | (j != j[k])
        for end in (i, j):
            near &= np.abs(driven[end] - driven[end[k]]) < MAX_SUPPORT_DISTANCE_M
        others = np.flatnonzero(near)
        if not len(others):
            continue
        to_i, to_j = se2.between(x[i[k]], x[i[others]]), se2.between(x[j[k]], x[j[others]])
        off = se2.between(se2.compose(z[k], to_j), se2.compose(to_i, z[others]))
        agree = np.hypot(off[:, 0], off[:, 1]) < SUPPORT_M
        out[k] = bool((agree & (np.abs(se2.wrap_all(off[:, 2])) < SUPPORT_RAD)).any())
    return out


def recognised(filtered: Estimates, odometry: Odometry, keys: Ints) -> Edges:
    """Return the places that the filter recognised, as edges between the nearest keys (m,).

    These edges guide the search, since many places fit after a long loop. A robust kernel removes edges that
    contradict the others, every closure must still pass all tests, and the last solve is without these edges.
    """
    at = np.minimum(np.searchsorted(filtered.t, filtered.loops), len(filtered.t) - 1)
    ends = _nearest(keys, at)
    to_then, _ = odometry.between(keys[ends[:, 0]], at[:, 0])
    from_now, _ = odometry.between(at[:, 1], keys[ends[:, 1]])
    z = se2.compose(se2.compose(to_then, filtered.loop_poses), from_now)
    information = np.diag(1.0 / np.square((SIGMA_M, SIGMA_M, SIGMA_RAD)))
    found = Edges.of(ends[:, 0], ends[:, 1], z, np.tile(information, (len(z), 1, 1)), CLOSURE_WIDTH_SIGMAS)
    return found.take(ends[:, 0] < ends[:, 1])


def _nearest(keys: Ints, at: Ints) -> Ints:
    """Return the index of the nearest key for each update time `at` (k, 2); `keys` (m,) are increasing."""
    after = np.clip(np.searchsorted(keys, at), 1, len(keys) - 1)
    return np.where(at - keys[after - 1] <= keys[after] - at, after - 1, after)
