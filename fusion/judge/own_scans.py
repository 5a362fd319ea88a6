"""A path judged by its own scans, without truth: do places seen twice agree, and is the map crisp?

Revisit agreement: of the scans at places that the path has been at before, the share of points that lie on what
was seen then. Crispness: in how many cells the points of all scans fall; of two paths of one drive the better one
has fewer. Neither proves a path right: where two paths err alike, both agree with themselves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import msgspec
import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Drive, Estimates, Ints
from locfuse.fusion.mount import found_mount

LASER = "lrf"
STRIDE_M, MAX_SCANS = 0.7, 2000  # way between two scans that are looked at, and how many at most
AGAIN_S, AGAIN_SHORT_S, SHORT_S = 30.0, 8.0, 120.0  # between two visits of a place; in drives shorter than that
NEAR_M, MAX_EARLIER = 3.0, 10  # how near an earlier scan was taken, and how many of them are asked
SAME_M = 0.1  # a point this near to an earlier one agrees
MIN_REVISITS, MIN_OVERLAP = 0.1, 3.0  # share of scans at places seen before; cells of single scans per cell of all
CELL_M = 0.05
DOUBT_M, DOUBT_SHARE = 0.3, 0.0075  # of the way: two paths further apart than both are doubted
MAX_APART_SIGMAS, MIN_APART_M = 3.0, 0.05  # of both claims together; less than this is no contradiction
MAX_CLAIM_RATIO = 1.5  # of the distance to the smoothed path over the claimed standard deviation
BETTER, GOOD = 0.2, 0.7  # by how much agreement must rise, or what it must be, for a path to be the better one


class Distance(msgspec.Struct, frozen=True):
    """The distance between two paths of one drive after rigid alignment (SE(2))."""

    rms: float  # m
    max: float  # m
    t_s: float  # when they are furthest apart

    @classmethod
    def between(cls, t: Array, a: Array, b: Array) -> Distance:
        """Return the distance of the paths a and b (n, 2) [m] at the instants t (n,)."""
        turn, _ = se2.laid_on(a, b)
        p, q = a - a.mean(axis=0), b - b.mean(axis=0)
        off = np.hypot(*(se2.rotated(np.full(len(p), turn), p) - q).T)
        return cls(float(np.sqrt((off**2).mean())), float(off.max()), float(t[off.argmax()]))

    def doubted(self, way: float) -> bool:
        """Return whether the paths differ by more than is plausible for this distance driven [m]."""
        return self.max > max(DOUBT_M, DOUBT_SHARE * way)

    def contradicts(self, a: float, b: float) -> bool:
        """Return whether the paths differ by more than their standard deviations [m] allow."""
        return self.rms > max(MAX_APART_SIGMAS * float(np.hypot(a, b)), MIN_APART_M)


class OwnScans(msgspec.Struct, frozen=True):
    """Scans along a drive that judge every path of it."""

    t: Array  # (k,) s
    instants: Ints  # (k,) of the drive
    points: list[Array]  # each (p, 2) m, in the base frame, deskewed
    mount: Array  # (3,) of the laser on the base, as configured: x, y [m], yaw [rad]

    @classmethod
    def of(cls, drive: Drive) -> OwnScans | None:
        """Return the scans of a drive; None without a laser whose points can be read."""
        m = drive.measurements.get(LASER)
        if m is None or m.points is None or not len(m.t):
            return None
        instants = drive.instant[LASER]
        way = np.cumsum(np.hypot(*drive.motions.u[:, :2].T))[instants]
        stride = max(STRIDE_M, float(way[-1] - way[0]) / MAX_SCANS)
        chosen = np.flatnonzero(np.diff(np.floor(way / stride), prepend=-1.0) > 0)
        return cls(drive.t[instants[chosen]], instants[chosen], list(m.points.read(chosen)), m.points.mount)

    def judge(self, e: Estimates) -> tuple[float | None, int, float]:
        """Return revisit agreement (0 to 1; None without revisits), cells, and how often scans overlap.

        Where a run estimates the laser's mount, its scans are placed by the mount that it found.
        """
        moved = se2.compose(found_mount(LASER, self.mount, e.blocks), se2.inverse(self.mount))
        pose = se2.compose(e.pose[self.instants], moved)
        placed = [
            se2.transform(np.broadcast_to(x, (len(p), 3)), p) for x, p in zip(pose, self.points, strict=True)
        ]
        return self._agreement(pose, placed), *_cells(placed)

    def _agreement(self, pose: Array, placed: list[Array]) -> float | None:
        from scipy.spatial import cKDTree

        again = AGAIN_SHORT_S if self.t[-1] - self.t[0] < SHORT_S else AGAIN_S
        agree = points = visits = 0
        for k, scan in enumerate(placed):
            before = int(np.searchsorted(self.t, self.t[k] - again))
            apart = np.hypot(*(pose[:before, :2] - pose[k, :2]).T)
            near = np.argsort(apart, kind="stable")[:MAX_EARLIER]
            earlier = [placed[j] for j in near[apart[near] < NEAR_M].tolist() if len(placed[j])]
            if not earlier or not len(scan):
                continue
            distance, _ = cKDTree(np.concatenate(earlier)).query(scan, distance_upper_bound=SAME_M)
            agree, points, visits = agree + int(np.isfinite(distance).sum()), points + len(scan), visits + 1
        return agree / points if visits > MIN_REVISITS * len(placed) else None


def _cells(placed: list[Array]) -> tuple[int, float]:
    """Return the number of map cells that hold points, and the mean number of scans per cell."""
    cells = [np.unique(np.floor(p / CELL_M).astype(np.int64) @ (1 << 32, 1)) for p in placed]
    every = len(np.unique(np.concatenate([np.zeros(0, np.int64), *cells])))
    return every, sum(len(c) for c in cells) / max(every, 1)


def are_contradictory(a: Estimates, b: Estimates) -> bool:
    """Return whether estimates at the same instants differ by more than their sigmas: then one is wrong."""
    return Distance.between(a.t, a.pose[:, :2], b.pose[:, :2]).contradicts(_claimed(a), _claimed(b))


def _claimed(e: Estimates) -> float:
    """Return the standard deviation that an estimate claims, rms over the drive [m]."""
    return float(np.sqrt(np.maximum(e.triangles[:, 0] + e.triangles[:, 3], 0.0).mean()))


def is_better(before: float | None, after: float | None) -> bool:
    """Return whether agreement at places seen twice shows that a path is the better one."""
    if before is None or after is None:
        return False
    return after >= before + BETTER or (after >= GOOD and after >= before)


class Own(msgspec.Struct, frozen=True):
    """Figures of one estimate by the drive's own scans."""

    revisit_agreement: float | None
    crispness_cells: int | None
    smoothed: Distance | None = None  # to the same sensors' smoothed path; None where there is none
    smoothed_is_better: bool = False  # as its revisit agreement proves
    claimed_m: float = 0.0  # by the estimate: its standard deviation over the drive, sqrt(P_xx + P_yy)
    contradicted: bool = False  # they lie further apart than both claim

    @property
    def is_overconfident(self) -> bool:
        """Whether the smoothed path lies further away than the estimate's covariance allows."""
        apart = 0.0 if self.smoothed is None else self.smoothed.rms
        return apart > max(MAX_CLAIM_RATIO * self.claimed_m, MIN_APART_M)


def judged_by_scans(
    drive: Drive, estimates: Sequence[Estimates], smoothed: Mapping[str, Estimates]
) -> dict[str, Own]:
    """Return the figures by the laser's scans for estimates at the instants of a drive, by name.

    `smoothed` are the smoothed estimates of those that have one, by the name of the estimate that they smooth.
    """
    scans = OwnScans.of(drive)
    if scans is None or not len(scans.t):
        return {}
    every = {e.name: e for e in (*estimates, *(whole for whole in smoothed.values() if LASER in whole.sensors))}
    judged = {name: scans.judge(e) for name, e in every.items()}
    enough = max((judged[e.name][2] for e in estimates), default=0.0) >= MIN_OVERLAP
    found = {}
    for e in estimates:
        agreement, hit, _ = judged[e.name]
        cells = hit if enough else None
        whole = smoothed.get(e.name) if LASER in e.sensors else None
        if whole is None:
            found[e.name] = Own(agreement, cells)
            continue
        apart = Distance.between(e.t, e.pose[:, :2], whole.pose[:, :2])
        better, claimed = is_better(agreement, judged[whole.name][0]), _claimed(e)
        found[e.name] = Own(
            agreement, cells, apart, better, claimed, contradicted=apart.contradicts(claimed, _claimed(whole))
        )
    return found
