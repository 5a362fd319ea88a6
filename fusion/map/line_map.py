"""Line map (paper eq. 14): walls as (rho, beta) about an anchor point on each wall, with their extents.

A line is n.(q - a) = rho with n = (cos beta, sin beta) and a fixed anchor a near the wall. With a = 0 this is
the paper's form; with a on the wall itself, an error in beta has no lever arm far from the origin. n points
from where the line was first seen into the wall, so C = rho - n.(p - a) > 0 on the face that was seen.

Data association: a pair (measured line, map line) is a candidate if its Mahalanobis distance passes the chi-square
gate, the robot is on the seen side of the wall, and the segments overlap. A line with two about equally good
candidates is ambiguous and not used. fusion.kernels.sight computes this, with paper eq. 13, 17, 18.

Maintenance of a growing map: lines that were seen too rarely are removed, duplicates are merged. A merge also
closes loops: the equality of two lines is a measurement with noise, which corrects all correlated states.

If the laser's mount (x, y, yaw) is uncertain, a line (r_L, psi_L) in the laser frame is the line psi = psi_L +
yaw, r = r_L + x cos(psi) + y sin(psi) in the base frame. So the derivative of the predicted measurement by the
mount is

    d(r, psi)/d(x, y, yaw) = [[-cos(psi), -sin(psi), x sin(psi) - y cos(psi)], [0, 0, -1]]

at the measured psi, where this is exact. (The predicted psi contains the heading error of the wheels, which is
correlated with their distance error: with it, the estimated y was wrong by k / (2 dtheta), 8 mm.) The derivatives
by pose and line do not depend on the mount.
"""

from __future__ import annotations

import math
from typing import Any

import msgspec
import numpy as np
from msgspec import field

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints, MapLine, Mask
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.ekf.map_frame import Pose
from locfuse.fusion.kernels import sight
from locfuse.fusion.mount import Mount

COLUMN_NAMES = ("ids", "anchor", "lo", "hi", "hits", "column", "value", "P", "seen", "born")
NO_SHARES = np.zeros((0, 2, 0))
RHO_BETA = np.arange(2)  # state columns of a line, relative to its first one
TIDY_EVERY_SCANS = 10  # scans
MIN_HITS = 4
TRIAL_SCANS = 15  # scans within which a new line must be seen MIN_HITS times
# largest differences of duplicates, for any covariance
DOUBLE_ANGLE_RAD, DOUBLE_OFFSET_M = math.radians(8.0), 0.25
MAX_GAP_M = 0.3  # m along the wall between two duplicates
DOUBLE_D2 = 9.2  # chi-square with 2 degrees of freedom at 99 %
FLAT_SIGMAS = np.array([0.005, math.radians(0.2)])  # m, rad: how well two pieces of one flat wall agree


class LineMap(msgspec.Struct):
    """Map of J lines, one array per property.

    If a line is a state, its (rho, beta) is in the belief, from column `column` on. If it is frozen, its
    (rho, beta) is in `value`.
    """

    ids: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    anchor: Array = field(default_factory=lambda: np.zeros((0, 2)))
    lo: Array = field(default_factory=lambda: np.zeros(0))  # m along the tangent from the anchor
    hi: Array = field(default_factory=lambda: np.zeros(0))
    hits: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    column: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))  # -1: frozen
    value: Array = field(default_factory=lambda: np.zeros((0, 2)))  # (rho, beta) of frozen lines
    P: Array = field(default_factory=lambda: np.zeros((0, 2, 2)))  # of frozen lines
    seen: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))  # number of the last matched scan
    born: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))  # number of the first scan
    next_id: int = 0
    _table: sight.WallColumns | None = None  # kernel's view of the arrays
    _shown: tuple[Any, ...] = ()  # arrays from which `_table` was built

    def __len__(self) -> int:
        """Return the number of lines."""
        return len(self.ids)

    def values(self, belief: JointBelief) -> Array:
        """Return (rho, beta) of all lines, (J, 2)."""
        if len(self) == 0 or self.column[0] < 0:
            return self.value
        return np.column_stack((belief.state[self.column], belief.state[self.column + 1]))

    def covariances(self, belief: JointBelief) -> Array:
        """Return the covariances of (rho, beta) of all lines, (J, 2, 2)."""
        if len(self) == 0 or self.column[0] < 0:
            return self.P
        at = np.column_stack((self.column, self.column + 1))
        return belief.covariance[at[:, :, None], at[:, None, :]]

    def table(self) -> sight.WallColumns:
        """Return the table of the lines for the kernel; it shares the map's arrays, so it shows their changes.

        It is built anew after an array was replaced.
        """
        shown = self._shown
        if self._table is not None and shown[0] is self.column and shown[1] is self.hits and shown[2] is self.seen:
            return self._table
        states = len(self) > 0 and bool(self.column[0] >= 0)
        fixed = np.zeros((0 if states else len(self), sight.WALL_COLUMNS))
        if not states:
            fixed[:, :2], fixed[:, 2:4] = self.value, self.anchor
            fixed[:, 4:7] = self.P.reshape(-1, 4)[:, (0, 1, 3)]
        table = sight.WallColumns(self.column, self.anchor, self.lo, self.hi, fixed, states)
        table.count(self.hits, self.seen, self.born, self.ids)
        self._shown, self._table = (self.column, self.hits, self.seen), table
        return table

    def append(
        self, anchor: Array, value: Array, P: Array, column: int, ends: tuple[float, float], scan: int
    ) -> int:
        """Add a line and return its id."""
        line, self.next_id = self.next_id, self.next_id + 1
        self.ids = np.append(self.ids, line)
        self.anchor = np.vstack((self.anchor, anchor))
        self.lo, self.hi = np.append(self.lo, ends[0]), np.append(self.hi, ends[1])
        self.hits, self.column = np.append(self.hits, 1), np.append(self.column, column)
        self.value = np.vstack((self.value, value))
        self.P = np.concatenate((self.P, P[None]))
        self.seen, self.born = np.append(self.seen, scan), np.append(self.born, scan)
        return line

    def raise_variances(
        self, belief: JointBelief, least: Array, most: Array | None = None, which: Ints | slice = np.s_[:]
    ) -> None:
        """Raise the variances [m^2, rad^2] of the lines `which` to `least` (2,), but by at most `most` (2,)."""
        at = self.states(which)
        added = least - belief.covariance.diagonal()[at].reshape(-1, 2)
        added = (added if most is None else np.minimum(added, most)).ravel()
        (lacking,) = (added > 0.0).nonzero()
        if len(lacking):
            belief.add_variance(at[lacking], added[lacking])

    def drop(self, gone: Ints) -> Ints:
        """Remove the lines with indices `gone` (k,); return the state columns that become free."""
        keep = np.setdiff1d(np.arange(len(self)), gone)
        freed = self.column[gone]
        freed = np.sort(np.concatenate((freed[freed >= 0], freed[freed >= 0] + 1)))
        for name in COLUMN_NAMES:
            setattr(self, name, getattr(self, name)[keep])
        self.column = self.column - np.searchsorted(freed, self.column)
        return freed

    def states(self, which: Ints | slice) -> Ints:
        """Return the state columns of the lines `which` (k,): rho and beta line by line, (2k,)."""
        return (self.column[which][:, None] + RHO_BETA).reshape(-1)

    def lines(self, belief: JointBelief) -> list[MapLine]:
        """Return all lines in the map frame, as (rho, beta) about its origin (paper's form)."""
        values, P, frame = self.values(belief), self.covariances(belief), belief.frame_pose()
        if frame is None:
            return [self._in_map(j, values[j], P[j]) for j in range(len(self))]
        return [self._in_map(j, values[j], P[j], frame, self._joint(j, P[j], belief)) for j in range(len(self))]

    def lines_in_map(self, frame: Array, P: Array) -> list[MapLine]:
        """Return the frozen lines in the map frame; their local frame has the pose `frame` (3,), covariance P."""
        x, y, theta = map(float, frame)
        joints = np.zeros((len(self), 5, 5))
        joints[:, :2, :2], joints[:, 2:, 2:] = self.P, P
        return [self._in_map(j, self.value[j], self.P[j], (x, y, theta), joints[j]) for j in range(len(self))]

    def _in_map(
        self, j: int, value: Array, P: Array, frame: Pose | None = None, joint: Array | None = None
    ) -> MapLine:
        """Return line j, with `value` (rho, beta) of covariance P (2, 2), about the origin of the map.

        About the map's origin, rho becomes rho + n.a, with the normal n = (c, s) and the anchor point a: a turn of
        the line moves it by dn.a = a_y c - a_x s. `frame` is the pose (X, Y, Th) of the local frame in the map,
        `joint` (5, 5) the covariance of (rho, beta, X, Y, Th), which gives P_free. The anchor point moves with X
        and Y, and turns with Th about (X, Y).
        """
        rho, beta, (ax, ay) = float(value[0]), float(value[1]), self.anchor[j].tolist()
        if frame is not None:
            beta = se2.wrap(beta + frame[2])
            ax, ay = se2.transform(np.array(frame), self.anchor[j]).tolist()
        c, s = math.cos(beta), math.sin(beta)
        along = ay * c - ax * s
        G = np.array([[1.0, along], [0.0, 1.0]])
        ends = (float(self.lo[j]) + along, float(self.hi[j]) + along)
        P_free = None
        if frame is not None and joint is not None:
            by_turn = along + (ax - frame[0]) * s - (ay - frame[1]) * c
            P_free = se2.propagated(np.array([[1.0, along, c, s, by_turn], [0.0, 1.0, 0.0, 0.0, 1.0]]), joint)
        rho += ax * c + ay * s
        return MapLine(int(self.ids[j]), rho, beta, ends, G @ P @ G.T, int(self.hits[j]), P_free)

    def _joint(self, j: int, P: Array, belief: JointBelief) -> Array:
        """Return the joint covariance (5, 5) of (rho, beta) of line j and the local frame's pose."""
        out = np.zeros((5, 5))
        out[:2, :2], out[2:, 2:] = P, belief.frame_covariance()
        if belief.framed and self.column[j] >= 0:
            own, frame = self.column[j] + RHO_BETA, belief.frame + np.arange(3)
            out[:2, 2:] = belief.covariance[np.ix_(own, frame)]
            out[2:, :2] = out[:2, 2:].T
        return out


def about_middle(line: MapLine) -> tuple[Array, float, Array]:
    """Return the middle (2,) of a line, half its length [m], and the covariance (2, 2) about the middle."""
    c, s = math.cos(line.beta), math.sin(line.beta)
    along, half = 0.5 * (line.ends[0] + line.ends[1]), 0.5 * (line.ends[1] - line.ends[0])
    G = np.array([[1.0, -along], [0.0, 1.0]])
    return np.array([line.rho * c - along * s, line.rho * s + along * c]), half, G @ line.P @ G.T


class Association(sight.SightLines):
    """Data association of one scan with the map: the map line of each measured line, or why there is none."""

    def compare(self, belief: JointBelief, lines: LineMap, rows: Array, shared: Array = NO_SHARES) -> float:
        """Match the lines `rows` (n, 7) of a scan with the map; return the matched share of their length.

        The lines are in the base frame by the configured mount. `shared` (n, 2, s) are their correlated errors
        (lines.sweep).
        """
        return self.look(belief, lines.table(), rows, shared)


def associate(
    rows: Array, lines: LineMap, belief: JointBelief, like: Association, shared: Array = NO_SHARES
) -> Association:
    """Associate the lines `rows` (n, 7) of a scan with the map lines, at the belief's present state.

    The rules and the laser mount are those of the association `like`. `shared` (n, 2, s) are the correlated errors
    of the lines.
    """
    found = Association(like.rules, like.mount_states)
    found.compare(belief, lines, rows, shared)
    return found


# ---- tidying ----


def prune(lines: LineMap, belief: JointBelief, scan: int) -> None:
    """Remove lines that were rarely seen in TRIAL_SCANS scans: people, poles, bad fits."""
    rare = (lines.hits < MIN_HITS) & (scan - lines.born > TRIAL_SCANS) & (lines.born > 0)
    if rare.any():
        belief.remove(lines.drop(np.flatnonzero(rare)))


def merge_doubles(lines: LineMap, belief: JointBelief, scan: int, uneven: Array) -> None:
    """Merge recently seen lines with lines that are the same wall, within their covariances.

    `uneven` (2,) is the variance [m^2, rad^2] of one piece of an uneven wall. The difference of two pieces has
    twice this variance.
    """
    R = np.diag(np.maximum(FLAT_SIGMAS**2, 2.0 * uneven))
    recent = np.flatnonzero(scan - lines.seen <= TRIAL_SCANS)[::-1]
    while len(recent):
        near = _near(lines, lines.values(belief), recent)
        recent, near = recent[near.any(axis=1)], near[near.any(axis=1)]
        doubles = (_double_of(lines, belief, j, i, R) for j, i in zip(recent.tolist(), near, strict=True))
        found = next(((j, i) for j, i in zip(recent.tolist(), doubles, strict=True) if i is not None), None)
        if found is None:
            return
        i, gone = sorted(found)  # the equality of both corrects the state; line i keeps the extent of both
        y, H, lo, hi = _difference(lines, lines.values(belief), i, gone)
        belief.know(y.tolist(), R.tolist(), lines.states(np.array([i, gone])).tolist(), H.tolist())
        lines.lo[i], lines.hi[i] = min(lines.lo[i], lo), max(lines.hi[i], hi)
        lines.hits[i] += lines.hits[gone]
        lines.seen[i] = max(lines.seen[i], lines.seen[gone])
        lines.born[i] = min(lines.born[i], lines.born[gone])
        belief.remove(lines.drop(np.array([gone])))
        recent = recent[recent < found[0]]


def _near(lines: LineMap, values: Array, which: Ints) -> Mask:
    """Return which lines (J,) may be the same wall as the lines `which` (k,), by their positions, (k, J)."""
    rho, beta, x, y = np.concatenate((values, lines.anchor), axis=1).T
    own = which[:, None]
    with np.errstate(invalid="ignore"):  # an infinite angle gives NaN, which is near none
        c, s = np.cos(beta[own]), np.sin(beta[own])
        dx, dy = x[own] - x, y[own] - y
        along = dy * np.cos(beta) - dx * np.sin(beta)
        apart = np.maximum(lines.lo, lines.lo[own] + along) - np.minimum(lines.hi, lines.hi[own] + along)
        near = np.abs(se2.wrap_all(beta - beta[own])) < DOUBLE_ANGLE_RAD
        near &= np.abs(rho - (rho[own] + dx * c + dy * s)) <= DOUBLE_OFFSET_M
    return np.asarray(near & (apart <= MAX_GAP_M) & (own != np.arange(len(lines))))


def _double_of(lines: LineMap, belief: JointBelief, j: int, near: Mask, R: Array) -> int | None:
    """Return which of the lines `near` (J,) is most likely the same wall as line j; None if none is."""
    values = lines.values(belief)
    best, found = DOUBLE_D2, None
    for i in np.flatnonzero(near).tolist():
        y, H, _, _ = _difference(lines, values, i, j)
        columns = lines.states(np.array([i, j]))
        S = H @ belief.covariance[np.ix_(columns, columns)] @ H.T + R
        d2 = float(y @ np.linalg.solve(S, y))
        if d2 < best:
            best, found = d2, i
    return found


def _difference(lines: LineMap, values: Array, i: int, j: int) -> tuple[Array, Array, float, float]:
    """Compare lines i and j about i's anchor point: return y (2,), H (2, 4), and both ends of j along i [m].

    y = line i - line j in (rho, beta); H is the Jacobian of line j - line i by (rho, beta) of i and of j.
    """
    rho, beta = values[j]
    c, s = math.cos(beta), math.sin(beta)
    ax, ay = lines.anchor[j] - lines.anchor[i]
    turn = se2.wrap(float(values[i, 1] - beta))
    y = np.array([values[i, 0] - (rho + ax * c + ay * s), turn])
    H = np.array([[-1.0, 0.0, 1.0, ay * c - ax * s], [0.0, -1.0, 0.0, 1.0]])
    along = ay * math.cos(values[i, 1]) - ax * math.sin(values[i, 1])
    return y, H, float(lines.lo[j] + along), float(lines.hi[j] + along)


# ---- the mount of the laser ----


def mount_states_of(mount: Mount | None, belief: JointBelief) -> sight.MountStates:
    """Return the laser mount for the kernel: configured x [m], y [m], yaw [rad], and which of them are states.

    Without a mount (None), all are 0 and none is a state.
    """
    if mount is None:
        return sight.MountStates(np.zeros(3), np.zeros(0, np.intp), np.zeros(0, np.intp))
    columns = np.array(mount.columns(belief), np.intp)
    return sight.MountStates(np.array(mount.configured, np.float64), np.array(mount.free, np.intp), columns)


def line_by_mount(mount: Mount, belief: JointBelief, psi: float) -> Array:
    """Return the derivative (2, f) of a line with normal angle psi [rad, base frame] by the f mount states."""
    x, y, _ = mount.now(belief)
    c, s = math.cos(psi), math.sin(psi)
    whole = np.array(((-c, -s, x * s - y * c), (0.0, 0.0, -1.0)))
    return whole[:, list(mount.free)]
