"""Data association of a scan with the line map: candidate pairs, matches, verdicts, rows, map updates.

The predicted measurement of the map line (rho, beta) about the anchor a, from p = (x, y), theta, is (r, psi):
psi = beta - theta, r = rho - n.(p - a), n = (cos beta, sin beta) (paper eq. 17, 18); or the same line as
(-r, psi + pi), whichever is nearer to the measured one. Its derivatives (eq. 13) are

    by the pose [[-cos beta, -sin beta, 0], [0, 0, -1]], by the line [[1, u], [0, 1]], u = dr/dbeta,
    by the laser's mount (x_m, y_m, yaw) [[-cos psi, -sin psi, x_m sin psi - y_m cos psi], [0, 0, -1]].

The last one is evaluated at the measured psi, where it is exact. The predicted psi has the wheels' heading error,
which is correlated with their distance error (fusion.map.line_map). Pose, line and mount may be correlated states.
"""

from __future__ import annotations

from typing import Any

from .arrays import floats, memory, wholes

try:
    import cython
except ImportError:  # Cython is only needed to compile
    from . import uncompiled as cython
if not cython.compiled:
    from math import log, pi

    from .ekf import State
    from .places import into_base, moved, shares_into_base, wrapped
    from .uncompiled import cos, sin, sqrt

if not cython.compiled:  # compiled, these are constants of the .pxd
    # columns of a measured line: r, psi, R00, R01, R11, and both ends along the tangent
    R_LINE, PSI_LINE, R00_LINE, R01_LINE, R11_LINE, BEGIN_LINE, END_LINE = range(7)
    # columns of a map line: rho, beta, anchor, covariance of (rho, beta), covariances of rho and of beta with the
    # pose's x, y, theta; from WALL on: covariances of rho, then of beta, with the mount's free states
    RHO, BETA, ANCHOR_X, ANCHOR_Y, P_RR, P_RB, P_BB, X_RHO, X_BETA, Y_RHO, Y_BETA, T_RHO, T_BETA, WALL = range(14)
    # columns of a pair: measured line, map line, innovation of r and psi, R, S, squared Mahalanobis distance,
    # score (this distance + ln det S), ends of the measured line along the map line, length of their overlap, cos
    # and sin of beta, u, and the measured psi (predicted psi + innovation, not wrapped)
    LINE_OF, WALL_OF, OFFSET, TURN, R00, R01, R11, S00, S01, S11 = range(10)
    D2, SCORE, BEGIN, END, OVERLAP, COS, SIN, LEVER, PSI, PAIR = range(10, 20)
WALL_COLUMNS = 13  # of a map line without a mount
RESERVE_FACTOR = 1.5  # arrays are allocated for this multiple of the present number of lines

MAX_PAIR_ANGLE_RAD = 25.0 * (pi / 180.0)  # largest difference in psi of a pair
MAX_PAIR_OFFSET_M = 1.0  # largest difference in r of a pair
PAIR_SIGMAS = 6.0  # sigmas of the pose, added to both limits
FACE_SIGMAS = 3.0  # the robot must be on the seen side of a wall, up to this many sigmas
MAX_ANGLE_RAD = 1e9  # a larger angle is not valid
NOWHERE_M = 1e300
RIVAL_SCORE = 6.0  # difference from the best score up to which a candidate is a rival (chi-square, 2 dof: 95 %)
NEAR_D2 = 60.0  # a measured line within this squared distance of a map line is not a new line
MIN_OVERLAP_SHARE, MAX_LENGTH_M = 0.3, 0.5  # least overlap, as share of the measured length or of 0.5 m if shorter
COMMON_M = 0.05  # part of a map line that two measured lines may both match
# if only one line of a scan matches, no other line confirms the match: these limits are narrower
LONE_D2, LONE_TURN_RAD, LONE_OFFSET_M = 5.0, 3.0 * (pi / 180.0), 0.15


class WallColumns:
    """Line map as arrays (J,), shared with fusion.map.LineMap."""

    def __init__(self, columns: Any, anchors: Any, low: Any, high: Any, fixed: Any, states: bool) -> None:
        """Use arrays: first state columns (J,), anchors (J, 2) [m], ends along the tangents (J,) [m].

        `fixed` (J, WALL) are the columns of lines that are not states; `states`: whether lines are states.
        """
        self.columns, self.anchors = memory(columns), memory(anchors)
        self.low, self.high, self.fixed = memory(low), memory(high), memory(fixed)
        self.states, self.places = states, len(columns)

    def count(self, hits: Any, seen: Any, born: Any, ids: Any) -> None:
        """Use arrays (J,) for every line: number of matched scans, last and first matched scan, id."""
        self.hits, self.seen = memory(hits), memory(seen)
        self.born, self.ids = memory(born), memory(ids)


class MountStates:
    """Configured mount of the laser, and the state columns of its estimated parts (of x, y, yaw)."""

    def __init__(self, configured: Any, which: Any, columns: Any) -> None:
        """Use the `configured` mount (3,) [m, m, rad]; its parts `which` (f,) are states in `columns` (f,)."""
        self.configured, self.which, self.columns = memory(configured), memory(which), memory(columns)
        self.free = len(which)


class Rules:
    """Settings of the association: gate, whether lines are states, whether the map grows, and verdicts."""

    def __init__(self, gate: float, states: bool, grows: bool, unmatched: int, ambiguous: int, new: int) -> None:
        self.gate, self.states, self.grows = gate, states, grows
        self.unmatched, self.ambiguous, self.new = unmatched, ambiguous, new


class AuditColumns:
    """Record of all measurements as columns (rows,) (fusion.ekf.record)."""

    def __init__(self, instant: Any, row: Any, verdict: Any, landmark: Any) -> None:
        self.instant, self.row = memory(instant), memory(row)
        self.verdict, self.landmark = memory(verdict), memory(landmark)

    def judged(self, nis: Any, threshold: Any, y: Any, sigma: Any) -> None:
        """Set the columns nis, threshold (rows,), y and sigma (rows, d)."""
        self.nis, self.threshold = memory(nis), memory(threshold)
        self.y, self.sigma = memory(y), memory(sigma)


class SightLines:
    """Lines of one scan, associated with the map; `row` is the first one's row in Measurements.z."""

    def __init__(self, rules: Rules, mount_states: MountStates) -> None:
        self.rules, self.mount_states = rules, mount_states
        self.lines = self.accepted = self.numbers = self.found = self.row = 0
        self.first = self.parts = 0
        self.room_lines = self.room_walls = -1
        self.mount, self.place, self.offset = floats(6, 3), floats(3), floats(3)

    def make_room(self, lines: int, places: int, parts: int) -> None:
        """Allocate arrays for at least this number of measured lines, map lines and shared errors."""
        n = self.room_lines = max(self.room_lines, int(RESERVE_FACTOR * lines) + 1)
        walls = self.room_walls = max(self.room_walls, int(RESERVE_FACTOR * places) + 1)
        self.rows, self.order = floats(n, 7), wholes(n)
        self.match, self.best, self.rival, self.near = wholes(n), wholes(n), wholes(n), wholes(n)
        self.pairs, self.seen = floats(n * walls, PAIR), floats(walls, 4)
        self.wall_rows = floats(walls, WALL + 2 * self.mount_states.free)
        self.shared, self.G = floats(n, 2, parts), floats(2 * n, parts)

    # ---- a scan ----

    def look(self, state: State, walls: WallColumns, rows: Any, shared: Any) -> float:
        """Associate measured lines `rows` (n, 7) with the map; return the matched share of their length.

        The lines are in the base frame by the configured mount. `shared` (n, 2, parts) is the effect on (r, psi)
        of errors that all lines share, per sigma.
        """
        self.walls, self.lines = walls, rows.shape[0]
        self.parts = shared.shape[2]
        if self.lines > self.room_lines or walls.places > self.room_walls or self.parts > self.shared.shape[2]:
            self.make_room(self.lines, walls.places, self.parts)
        self.put_in_base(state, rows, shared)
        self.gather(state)
        self.found = self.find_pairs(state)
        self.associate()
        return self.share()

    def put_in_base(self, state: State, rows: Any, shared: Any) -> None:
        """Convert the lines and their shared errors to the base frame by the estimated mount."""
        mount_states, n = self.mount_states, self.lines
        for j in range(3):
            self.place[j] = mount_states.configured[j]
        for j in range(mount_states.free):
            self.place[mount_states.which[j]] = state.mean[mount_states.columns[j]]
        moved(self.place, mount_states.configured, self.offset)
        if mount_states.free > 0:
            x, y, yaw = self.offset[0], self.offset[1], self.offset[2]
            into_base(rows, n, x, y, yaw, self.rows)
            shares_into_base(rows, n, x, y, yaw, shared, self.shared)
            return
        for i in range(n):
            for j in range(7):
                self.rows[i, j] = rows[i, j]
            for j in range(2):
                for k in range(self.parts):
                    self.shared[i, j, k] = shared[i, j, k]

    def gather(self, state: State) -> None:
        """Collect the map lines with their covariances, and the covariance of the mount."""
        walls, mount_states, P, row = self.walls, self.mount_states, state.P, self.wall_rows
        free = mount_states.free
        for a in range(free):
            for i in range(3):
                self.mount[i, a] = P[i, mount_states.columns[a]]
            for b in range(free):
                self.mount[3 + a, b] = P[mount_states.columns[a], mount_states.columns[b]]
        for j in range(walls.places):
            if not walls.states:
                for i in range(WALL):
                    row[j, i] = walls.fixed[j, i]
                for i in range(2 * free):
                    row[j, WALL + i] = 0.0
                continue
            rho = walls.columns[j]
            beta = rho + 1
            row[j, RHO], row[j, BETA] = state.mean[rho], state.mean[beta]
            row[j, ANCHOR_X], row[j, ANCHOR_Y] = walls.anchors[j, 0], walls.anchors[j, 1]
            row[j, P_RR], row[j, P_RB], row[j, P_BB] = P[rho, rho], P[rho, beta], P[beta, beta]
            for i in range(3):
                row[j, X_RHO + 2 * i], row[j, X_BETA + 2 * i] = P[i, rho], P[i, beta]
            for a in range(free):
                row[j, WALL + a], row[j, WALL + free + a] = (
                    P[rho, mount_states.columns[a]],
                    P[beta, mount_states.columns[a]],
                )

    def predict(self, x: float, y: float, theta: float) -> None:
        """Eq. 17, 18: compute the map lines in the robot's frame: r, psi, cos and sin of beta, (J, 4)."""
        row = self.wall_rows
        for j in range(self.walls.places):
            psi = row[j, BETA] - theta
            if abs(psi) < MAX_ANGLE_RAD:
                c, s = cos(row[j, BETA]), sin(row[j, BETA])
                self.seen[j, 0] = row[j, RHO] - (x - row[j, ANCHOR_X]) * c - (y - row[j, ANCHOR_Y]) * s
                self.seen[j, 1], self.seen[j, 2], self.seen[j, 3] = psi, c, s
            else:
                self.seen[j, 0] = NOWHERE_M

    def find_pairs(self, state: State) -> int:
        """Find pairs of measured and map lines that face the robot and are near; return their number."""
        limit = max(self.rules.gate, NEAR_D2)
        max_turn = MAX_PAIR_ANGLE_RAD + PAIR_SIGMAS * sqrt(max(state.P[2, 2], 0.0))
        max_offset = MAX_PAIR_OFFSET_M + PAIR_SIGMAS * sqrt(max(state.P[0, 0] + state.P[1, 1], 0.0))
        self.predict(state.mean[0], state.mean[1], state.mean[2])
        p = 0
        for i in range(self.lines):
            r, psi = self.rows[i, R_LINE], self.rows[i, PSI_LINE]
            for j in range(self.walls.places if abs(psi) < MAX_ANGLE_RAD else 0):
                distance = self.seen[j, 0]
                if not (-max_offset < r - distance < max_offset or -max_offset < r + distance < max_offset):
                    continue
                turn, side = wrapped(psi - self.seen[j, 1]), 1.0
                if abs(turn) > 0.5 * pi:
                    turn, side = turn - pi if turn > 0.0 else turn + pi, -1.0
                offset = side * r - distance
                if abs(turn) < max_turn and abs(offset) < max_offset:
                    self.pairs[p, LINE_OF], self.pairs[p, WALL_OF] = i, j
                    self.pairs[p, OFFSET], self.pairs[p, TURN] = offset, turn
                    self.spread(state, p, i, j, side)
                    if self.fits(p, distance, limit):
                        self.extent(p, i, j, side, state.mean[0], state.mean[1])
                        p += 1
        return p

    def spread(self, state: State, p: int, i: int, j: int, side: float) -> None:
        """Write R, S = H P H' + R, cos, sin, lever u [m] and unwrapped psi of pair p: line i, map line j."""
        c, s, P, pairs, row = self.seen[j, 2], self.seen[j, 3], state.P, self.pairs, self.wall_rows
        u = (state.mean[0] - row[j, ANCHOR_X]) * s - (state.mean[1] - row[j, ANCHOR_Y]) * c
        r00, r01, r11 = self.rows[i, R00_LINE], side * self.rows[i, R01_LINE], self.rows[i, R11_LINE]
        m01, m11 = row[j, P_RB], row[j, P_BB]
        edge = m01 + u * m11
        l00 = row[j, P_RR] + u * (m01 + edge)
        by_rho = -c * row[j, X_RHO] - s * row[j, Y_RHO]
        by_beta = -c * row[j, X_BETA] - s * row[j, Y_BETA]
        turn_rho, turn_beta = -row[j, T_RHO], -row[j, T_BETA]
        s00 = c * c * P[0, 0] + 2.0 * c * s * P[0, 1] + s * s * P[1, 1] + l00 + 2.0 * (by_rho + u * by_beta)
        s01 = c * P[0, 2] + s * P[1, 2] + edge + by_beta + turn_rho + u * turn_beta
        s11 = P[2, 2] + m11 + 2.0 * turn_beta
        pairs[p, R00], pairs[p, R01], pairs[p, R11] = r00, r01, r11
        if not self.walls.states:
            pairs[p, R00], pairs[p, R01], pairs[p, R11] = r00 + l00, r01 + edge, r11 + m11
        pairs[p, S00], pairs[p, S01], pairs[p, S11] = s00 + r00, s01 + r01, s11 + r11
        pairs[p, COS], pairs[p, SIN], pairs[p, LEVER] = c, s, u
        pairs[p, PSI] = self.seen[j, 1] + pairs[p, TURN]
        if self.mount_states.free > 0:
            self.spread_mount(p, j)

    def spread_mount(self, p: int, j: int) -> None:
        """Add the covariance of the estimated mount to S of pair p."""
        free, pairs, mount, row = self.mount_states.free, self.pairs, self.mount, self.wall_rows
        c, s, u = pairs[p, COS], pairs[p, SIN], pairs[p, LEVER]
        c_psi, s_psi = cos(pairs[p, PSI]), sin(pairs[p, PSI])
        for a in range(free):
            r, turn = self.lever(a, c_psi, s_psi), -1.0 if self.mount_states.which[a] == 2 else 0.0
            with_beta = row[j, WALL + free + a]
            shared_r = -c * mount[0, a] - s * mount[1, a] + row[j, WALL + a] + u * with_beta
            shared_turn = -mount[2, a] + with_beta
            pairs[p, S00] += 2.0 * shared_r * r
            pairs[p, S01] += shared_r * turn + shared_turn * r
            pairs[p, S11] += 2.0 * shared_turn * turn
            for b in range(free):
                variance = mount[3 + a, b]
                pairs[p, S00] += r * variance * self.lever(b, c_psi, s_psi)
                if self.mount_states.which[b] == 2:
                    pairs[p, S01] -= r * variance
                    pairs[p, S11] -= turn * variance

    def lever(self, a: int, c: float, s: float) -> float:
        """Return the derivative of a line's r by mount state `a`; c, s are cos and sin of the line's psi."""
        if self.mount_states.which[a] == 2:
            return self.place[0] * s - self.place[1] * c
        return -c if self.mount_states.which[a] == 0 else -s

    def fits(self, p: int, distance: float, limit: float) -> bool:
        """Compute squared distance and score of pair p; return whether the line faces the robot and is near."""
        pairs = self.pairs
        offset, turn = pairs[p, OFFSET], pairs[p, TURN]
        s00, s01, s11 = pairs[p, S00], pairs[p, S01], pairs[p, S11]
        det = s00 * s11 - s01 * s01
        if not (det > 0.0 and s00 > 0.0):  # det is too small for a float, or NaN
            return False
        d2 = (s11 * offset * offset - 2.0 * s01 * offset * turn + s00 * turn * turn) / det
        self.pairs[p, D2], self.pairs[p, SCORE] = d2, d2 + log(det)
        return d2 <= limit and distance > -FACE_SIGMAS * sqrt(s00)

    def extent(self, p: int, i: int, j: int, side: float, x: float, y: float) -> None:
        """Compute the ends of the measured line along the map line [m], and the length of their overlap [m]."""
        pairs, row = self.pairs, self.wall_rows
        begin, end = self.rows[i, BEGIN_LINE], self.rows[i, END_LINE]
        along = (y - row[j, ANCHOR_Y]) * pairs[p, COS] - (x - row[j, ANCHOR_X]) * pairs[p, SIN]
        pairs[p, BEGIN], pairs[p, END] = along + begin, along + end
        if side < 0.0:
            pairs[p, BEGIN], pairs[p, END] = along - end, along - begin
        pairs[p, OVERLAP] = min(pairs[p, END], self.walls.high[j]) - max(pairs[p, BEGIN], self.walls.low[j])

    # ---- association ----

    def associate(self) -> None:
        """Find the match and the best other pair of every line (-1: none); mark ambiguous lines and near lines.

        A pair may be a match if it is within the gate and overlaps enough; the match is the one with the best
        score. A line is ambiguous if a second such pair is worse by less than RIVAL_SCORE. A line is near if it
        overlaps a map line within the squared distance NEAR_D2.
        """
        for i in range(self.lines):
            self.match[i], self.best[i], self.rival[i], self.near[i] = -1, -1, 0, 0
        for p in range(self.found):
            self.try_pair(p, int(self.pairs[p, LINE_OF]))
        for p in range(self.found):
            i = int(self.pairs[p, LINE_OF])
            m = self.match[i]
            near = m >= 0 and m != p and self.pairs[p, SCORE] - self.pairs[m, SCORE] < RIVAL_SCORE
            if near and self.fits_well(p, i):
                self.rival[i] = 1
        self.claim()
        for i in range(self.lines):
            if self.rival[i] > 0:
                self.match[i] = -1

    def try_pair(self, p: int, i: int) -> None:
        """Store pair p if its score is the best so far for line i: as match if possible, else as best pair."""
        if self.pairs[p, OVERLAP] > 0.0 and self.pairs[p, D2] <= NEAR_D2:
            self.near[i] = 1
        if self.fits_well(p, i):
            if self.match[i] < 0 or self.pairs[p, SCORE] < self.pairs[self.match[i], SCORE]:
                self.match[i] = p
        elif self.best[i] < 0 or self.pairs[p, SCORE] < self.pairs[self.best[i], SCORE]:
            self.best[i] = p

    def claim(self) -> None:
        """Accept matches so that only the measured line with the best score matches each part of a map line.

        Other measured lines that match the same part are marked as ambiguous.
        """
        claims = 0
        for i in range(self.lines):
            if self.match[i] < 0:
                continue
            self.best[i] = self.match[i]
            k = claims
            while k > 0 and self.pairs[self.match[self.order[k - 1]], SCORE] > self.pairs[self.match[i], SCORE]:
                self.order[k] = self.order[k - 1]
                k -= 1
            self.order[k] = i
            claims += 1
        kept = 0
        for k in range(claims):
            i, j = self.order[k], 0
            while j < kept and not self.overlap(self.match[i], self.match[self.order[j]]):
                j += 1
            if j < kept:
                self.rival[i] = 1
            else:
                self.order[kept] = i
                kept += 1

    def overlap(self, p: int, q: int) -> bool:
        """Return whether two pairs use the same part of a map line."""
        common = min(self.pairs[p, END], self.pairs[q, END]) - max(self.pairs[p, BEGIN], self.pairs[q, BEGIN])
        return self.pairs[p, WALL_OF] == self.pairs[q, WALL_OF] and common > COMMON_M

    def fits_well(self, p: int, i: int) -> bool:
        """Return whether pair p of measured line i may be a match, by distance and overlap."""
        length = min(self.rows[i, END_LINE] - self.rows[i, BEGIN_LINE], MAX_LENGTH_M)
        return self.pairs[p, D2] <= self.rules.gate and self.pairs[p, OVERLAP] > MIN_OVERLAP_SHARE * length

    def share(self) -> float:
        """Return the matched share of the measured length; 1 if the length is 0."""
        total = matched = 0.0
        for i in range(self.lines):
            length = self.rows[i, END_LINE] - self.rows[i, BEGIN_LINE]
            total += length
            if self.match[i] >= 0:
                matched += length
        return matched / total if total > 0.0 else 1.0

    def matches(self) -> int:
        """Return the number of matched lines."""
        n = 0
        for i in range(self.lines):
            if self.match[i] >= 0:
                n += 1
        return n

    def refuse_alone(self) -> None:
        """Reject the only match of a scan with other lines, unless the match is nearly perfect."""
        alone = -1
        for i in range(self.lines):
            if self.match[i] >= 0:
                if alone >= 0:
                    return
                alone = i
        if alone < 0 or self.lines < 2:
            return
        p = self.match[alone]
        turn, offset = abs(self.pairs[p, TURN]), abs(self.pairs[p, OFFSET])
        if self.pairs[p, D2] > LONE_D2 or turn > LONE_TURN_RAD or offset > LONE_OFFSET_M:
            self.match[alone] = -1

    def new(self) -> list[int]:
        """Return the indices of the lines to add to the map: unmatched, and near no map line."""
        return [i for i in range(self.lines) if self.is_new(i)]

    def rows_used(self) -> list[int]:
        """Return the rows of Measurements.z that hold the matched lines of this scan."""
        return [self.row + i for i in range(self.lines) if self.match[i] >= 0]

    def is_new(self, i: int) -> bool:
        """Return whether line i is unmatched and near no map line."""
        return self.match[i] < 0 and not self.near[i]

    # ---- rows of the measurement equation, and the audit ----

    def state_rows(self, state: State) -> int:
        """Write the rows of all matched lines to the state's table (eq. 13); return the number of these lines."""
        self.first = state.written
        self.accepted = self.matches()
        self.numbers = 2 * self.accepted
        if self.first + self.numbers + 1 > state.row_y.shape[0]:
            state.more_rows(self.first + self.numbers + 1)
        for i in range(self.lines):
            if self.match[i] >= 0:
                self.state_line(state, i, self.match[i])
        return self.accepted

    def state_line(self, state: State, i: int, p: int) -> None:
        """Write the two rows of matched line i with pair p."""
        mount_states, a = self.mount_states, state.written
        b = a + 1
        state.row_y[a], state.row_y[b] = self.pairs[p, OFFSET], self.pairs[p, TURN]
        w = state.put(a, state.put(a, 0, 0, -self.pairs[p, COS]), 1, -self.pairs[p, SIN])
        v = state.put(b, 0, 2, -1.0)
        if mount_states.free > 0:
            c_psi, s_psi = cos(self.pairs[p, PSI]), sin(self.pairs[p, PSI])
            for j in range(mount_states.free):
                w = state.put(a, w, mount_states.columns[j], self.lever(j, c_psi, s_psi))
                if mount_states.which[j] == 2:
                    v = state.put(b, v, mount_states.columns[j], -1.0)
        if self.rules.states:
            j = int(self.pairs[p, WALL_OF])
            rho = self.walls.columns[j]
            w = state.put(a, state.put(a, w, rho, 1.0), rho + 1, self.pairs[p, LEVER])
            v = state.put(b, v, rho + 1, 1.0)
        state.row_count[a], state.row_count[b] = w, v
        for j in range(a):
            state.row_R[a, j] = state.row_R[b, j] = 0.0
        state.row_R[a, a], state.row_R[b, a] = self.pairs[p, R00], self.pairs[p, R01]
        state.row_R[b, b] = self.pairs[p, R11]
        if self.parts > 0 and self.rules.states:
            self.share_noise(state, i, p, a - self.first)
        state.written = b + 1

    def share_noise(self, state: State, i: int, p: int, a: int) -> None:
        """Add to R the covariance of shared errors between line i (rows a, a + 1) and earlier lines.

        For a line that is compared as (-r, psi + pi), the shared error of r changes its sign.
        """
        first = self.first
        side = 1.0 if cos(self.pairs[p, PSI] - self.rows[i, PSI_LINE]) > 0.0 else -1.0
        for k in range(self.parts):
            self.G[a, k], self.G[a + 1, k] = side * self.shared[i, 0, k], self.shared[i, 1, k]
        for m in range(a, a + 2):
            for j in range(a):
                for k in range(self.parts):
                    state.row_R[first + m, first + j] += self.G[m, k] * self.G[j, k]

    def write(self, out: AuditColumns, at: int, instant: int) -> None:
        """Write the verdicts on all lines to the audit, from its row `at` on, for the update time `instant`."""
        rules, nan = self.rules, float("nan")
        for i in range(self.lines):
            k, p = at + i, self.best[i]
            out.instant[k], out.row[k], out.threshold[k] = instant, self.row + i, rules.gate
            if p < 0 or self.is_new(i):
                out.verdict[k], out.landmark[k] = rules.unmatched if self.near[i] else rules.new, -1
                out.nis[k] = out.y[k, 0] = out.y[k, 1] = out.sigma[k, 0] = out.sigma[k, 1] = nan
                continue
            j = int(self.pairs[p, WALL_OF])
            out.verdict[k], out.landmark[k] = 0, self.walls.ids[j]
            if self.match[i] < 0:
                out.verdict[k] = rules.ambiguous if self.rival[i] else rules.unmatched
            out.nis[k], out.y[k, 0], out.y[k, 1] = self.pairs[p, D2], self.pairs[p, OFFSET], self.pairs[p, TURN]
            out.sigma[k, 0], out.sigma[k, 1] = sqrt(self.pairs[p, S00]), sqrt(self.pairs[p, S11])

    # ---- map update ----

    def extend(self, scan: int) -> None:
        """Extend matched map lines to the ends of the measured lines, and count this scan as a hit."""
        walls = self.walls
        for i in range(self.lines):
            p = self.match[i]
            if p >= 0:
                j = int(self.pairs[p, WALL_OF])
                walls.low[j] = min(walls.low[j], self.pairs[p, BEGIN])
                walls.high[j] = max(walls.high[j], self.pairs[p, END])
                walls.hits[j] += 1
                walls.seen[j] = scan
