"""State of the filter, with its inner loops: predict (paper eq. 5-7) and correct (eq. 10-12).

The mean (n,) begins with the pose: x [m], y [m], theta [rad, not wrapped]. P (n, n) is the covariance of all
states, stored as a full symmetric matrix. `fusion.ekf.belief` owns the arrays, which may be larger than n.

The measurement equation of one update time is y = H dx + noise with covariance R. `compare` (or kernels.sight)
writes its rows to one sparse table: row k has the derivatives H[k, :count[k]] by the states at[k, :count[k]]. Rows
that pass the gate are queued, and `correct_queued` uses all queued rows at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from .arrays import floats, memory

try:
    import cython
except ImportError:  # Cython is only needed to compile
    from . import uncompiled as cython
if not cython.compiled:
    from math import exp

    from .uncompiled import cos, sin, sqrt

ACCEPTED, GATE = 0, 1  # verdicts, as in fusion.data.VERDICTS
NAN, INFINITE = float("nan"), float("inf")
MAX_NUMBERS = 8  # components of one measurement
MIN_KEPT_SHARE = 1e-14  # a correction leaves at least this share of a variance; a smaller rest is a rounding error


class Steps:
    """Wheel motions between update times: step k is the motion that ends at update time k."""

    def __init__(self, u: Any, Q: Any, dt: Any, J: Any) -> None:
        """Use motions u (s, 3) [m, m, rad], Q (s, 9), dt (s,) [s], J (s, 3 p) = du/d(wheel parameters) by rows."""
        self.u, self.Q = memory(u), memory(Q)
        self.dt, self.J = memory(dt), memory(J)

    def of(self, k: int) -> tuple[float, float, float]:
        """Return the relative motion x, y [m], theta [rad] of step k."""
        return self.u[k, 0], self.u[k, 1], self.u[k, 2]

    def noise_of(self, k: int) -> tuple[list[float], list[float]]:
        """Return noise Q (9,) and derivative J (3 p,) of step k."""
        return [self.Q[k, j] for j in range(9)], [self.J[k, j] for j in range(self.J.shape[1])]

    def dt_of(self, k: int) -> float:
        """Return the duration of step k [s]."""
        return self.dt[k]


class TrackColumns:
    """Record of the pose, its covariance and some states, one row per update."""

    def __init__(self, pose: Any, triangle: Any, values: Any, states: Any) -> None:
        """Record in pose (n, 3), triangle (n, 6) of P, values (n, 2 b): means, then variances, of b `states`."""
        self.pose, self.triangle, self.values = memory(pose), memory(triangle), memory(values)
        self.states = memory(states)


class Innovation:
    """One measurement compared with its prediction: y = z - h(x), NIS, and its rows in the state's table.

    `row`: row of Measurements.z (-1: a constraint on states, not a measurement). `verdict`: index into VERDICTS.
    `landmark`: id of the map feature, -1 for none. `nis` = y' S^-1 y; `threshold`: limit of the gate. y (d,), and
    sigma (d,), the square roots of the diagonal of S. `first`: its first row in the table (-1: there was no
    prediction); `numbers` = d.
    """

    def __init__(
        self, row: int, verdict: int, landmark: int, nis: float, threshold: float, y: Any, sigma: Any
    ) -> None:  # fmt: skip
        self.row, self.verdict, self.landmark, self.nis, self.threshold = row, verdict, landmark, nis, threshold
        self.y, self.sigma, self.first, self.numbers = y, sigma, -1, 0

    @staticmethod
    def unpredicted(row: int, verdict: int, d: int, threshold: float) -> Innovation:
        """Return the record of a measurement (d components) without a prediction: NIS, y and sigma are NaN."""
        none = (NAN,) * d
        return Innovation(row, verdict, -1, NAN, threshold, none, none)


class State:
    """Mean and covariance of the filter, and the rows of the measurement equations of one update.

    There are `n` states. The map frame's states begin at column `frame`, the wheel parameters at column `wheels`;
    -1 if they are not states. `written` is the number of rows in the table, `queued` the number of rows that will
    correct the state. `keeps`: some states are considered (corrections do not change their values).
    """

    def __init__(self) -> None:
        self.n, self.frame, self.wheels = 3, -1, -1
        self.written = self.queued = self.drifting = 0
        self.keeps = False

    # ---- the arrays, which fusion.ekf.belief owns ----

    def hold(self, mean: Any, P: Any, kept: Any) -> None:
        """Use arrays for mean (size,) and P (size, size); `kept` (size,) marks considered states."""
        self.mean, self.P, self.kept = memory(mean), memory(P), memory(kept)

    def hold_rows(self, at: Any, H: Any, count: Any, y: Any, R: Any, queue: Any) -> None:
        """Use arrays for m rows: at and H (m, states per row); count, y and queue (m,); R (m, m).

        Also allocate the work arrays V (m + 4, size), S (m, m), e (m,), small (16, 16).
        """
        self.row_at, self.row_H, self.row_count = memory(at), memory(H), memory(count)
        self.row_y, self.row_R, self.queued_rows = memory(y), memory(R), memory(queue)
        m = len(y)
        self.V, self.S, self.e = floats(m + 4, self.mean.shape[0]), floats(m, m), floats(m)
        self.small = floats(16, 16)

    def drift(self, columns: Any, variances: Any) -> None:
        """Set process noise: the states in `columns` (k,) get the `variances` (k,) per second."""
        self.drifting = len(columns)
        self.drift_at, self.drift_by = memory(columns), memory(variances)

    def more_rows(self, rows: int) -> None:
        """Increase the capacity to at least this many rows."""
        raise NotImplementedError

    def not_positive(self, greatest: float) -> None:
        """Raise an error: an innovation covariance, with largest variance `greatest`, is not positive definite."""
        raise NotImplementedError

    # ---- predict ----

    def move(self, steps: Steps, k: int) -> None:
        """Eq. 5-7: predict the state over step k. Its noise Q is in the frame of the pose at its start.

        Row x of A (eq. 7) is (1, 0, -dy), row y is (0, 1, dx). So A P A' adds -dy times the row and column of
        theta to those of x, and dx times them to those of y. With wheel parameters z the motion is u + J z.
        """
        n = self.n
        ux, uy, turn = steps.u[k, 0], steps.u[k, 1], steps.u[k, 2]
        c, s = cos(self.mean[2]), sin(self.mean[2])
        states = steps.J.shape[1] // 3 if self.wheels >= 0 else 0
        for i in range(states):
            by = self.mean[self.wheels + i]
            ux += steps.J[k, i] * by
            uy += steps.J[k, states + i] * by
            turn += steps.J[k, 2 * states + i] * by
        dx, dy = c * ux - s * uy, s * ux + c * uy  # eq. 5
        self.mean[0] += dx
        self.mean[1] += dy
        self.mean[2] += turn
        for j in range(n):  # eq. 6, A P A' with A of eq. 7
            self.P[0, j] -= dy * self.P[2, j]
            self.P[1, j] += dx * self.P[2, j]
        for i in range(n):
            self.P[i, 0] -= dy * self.P[i, 2]
            self.P[i, 1] += dx * self.P[i, 2]
        qxx, qxy, qxt, qyy = steps.Q[k, 0], steps.Q[k, 1], steps.Q[k, 2], steps.Q[k, 4]
        qyt, qtt = steps.Q[k, 5], steps.Q[k, 8]
        cc, cs, ss = c * c, c * s, s * s  # eq. 6, W Q W'
        self.P[0, 0] += cc * qxx - 2.0 * cs * qxy + ss * qyy
        self.P[1, 1] += ss * qxx + 2.0 * cs * qxy + cc * qyy
        self.P[2, 2] += qtt
        self.P[0, 1] += cs * (qxx - qyy) + (cc - ss) * qxy
        self.P[0, 2] += c * qxt - s * qyt
        self.P[1, 2] += s * qxt + c * qyt
        for i in range(states):  # A has a column W J for each wheel parameter
            at, by_x, by_y = self.wheels + i, steps.J[k, i], steps.J[k, states + i]
            by_turn = steps.J[k, 2 * states + i]
            dx, dy = c * by_x - s * by_y, s * by_x + c * by_y
            for j in range(n):
                self.P[0, j] += dx * self.P[at, j]
                self.P[1, j] += dy * self.P[at, j]
                self.P[2, j] += by_turn * self.P[at, j]
            for j in range(n):
                self.P[j, 0] += dx * self.P[j, at]
                self.P[j, 1] += dy * self.P[j, at]
                self.P[j, 2] += by_turn * self.P[j, at]
        self.P[1, 0], self.P[2, 0], self.P[2, 1] = self.P[0, 1], self.P[0, 2], self.P[1, 2]
        for i in range(self.drifting):
            self.P[self.drift_at[i], self.drift_at[i]] += self.drift_by[i] * steps.dt[k]

    # ---- compare ----

    def compare(
        self, row: int, y: Sequence[float], H: Any, R: Any, threshold: float, columns: Any = (), H_block: Any = (),
        in_map: bool = False,
    ) -> Innovation:  # fmt: skip
        """Write the rows of a measurement; compute S = H P H' + R and NIS = y' S^-1 y.

        See fusion.sensor.Belief.compare. `in_map`: H (d, 3) is by the pose in the map, else by the local pose.
        """
        d, states, first = len(y), len(columns), self.written
        self.room_for(d, states)
        for a in range(d):
            self.write_row(first + a, H[a], columns, H_block[a] if states > 0 else (), in_map)
            noise = R[a]
            for j in range(first):
                self.row_R[first + a, j] = 0.0
            for j in range(a + 1):
                self.row_R[first + a, first + j] = noise[j]
            self.row_y[first + a] = y[a]
        self.written = first + d
        found = Innovation.__new__(Innovation)
        found.row, found.landmark, found.threshold, found.y = row, -1, threshold, y
        found.first, found.numbers = first, d
        found.nis = self.judge(first, d)
        found.sigma = tuple([sqrt(max(self.small[MAX_NUMBERS, a], 0.0)) for a in range(d)])
        found.verdict = ACCEPTED if found.nis <= threshold else GATE
        return found

    def write_row(self, k: int, H: Any, columns: Any, H_block: Any, in_map: bool) -> None:
        """Write row k: the derivatives H (3,) by the pose, and H_block (c,) by the states in `columns` (c,)."""
        by_x, by_y, by_theta = H
        w = self.derive(k, by_x, by_y, by_theta, in_map)
        for j in range(len(columns)):
            w = self.put(k, w, columns[j], H_block[j])
        if in_map and self.frame >= 0:
            w = self.derive_frame(k, w, by_x, by_y, by_theta)
        self.row_count[k] = w

    def room_for(self, rows: int, columns: int) -> None:
        """Increase the capacity by this many rows, if needed; raise ValueError for too many rows or states."""
        if rows > MAX_NUMBERS or columns + 6 > self.row_H.shape[1]:
            raise ValueError(f"{rows} numbers that depend on {columns} states beside the pose are too many")
        if self.written + rows + 1 > self.row_y.shape[0]:
            self.more_rows(self.written + rows + 1)

    def put(self, k: int, w: int, column: int, h: float) -> int:
        """Write the derivative h by the state in `column` to entry w of row k if h is not 0; return the next w."""
        if h == 0.0:
            return w
        self.row_at[k, w], self.row_H[k, w] = column, h
        return w + 1

    def derive(self, k: int, by_x: float, by_y: float, by_theta: float, in_map: bool) -> int:
        """Write the derivative of row k by the local pose; return the number of entries of the row.

        It is H_q = H J_q, with the derivative H = (`by_x`, `by_y`, `by_theta`) by the pose in the map.
        """
        if in_map and self.frame >= 0 and (by_x != 0.0 or by_y != 0.0):
            turn = self.mean[self.frame + 2]
            c, s = cos(turn), sin(turn)
            by_x, by_y = c * by_x + s * by_y, c * by_y - s * by_x
        return self.put(k, self.put(k, self.put(k, 0, 0, by_x), 1, by_y), 2, by_theta)

    def derive_frame(self, k: int, w: int, by_x: float, by_y: float, by_theta: float) -> int:
        """Write H_G = H J_G, row k's derivative by the map frame, from entry w on; return the next w."""
        G = self.frame
        if by_x != 0.0 or by_y != 0.0:  # else H is by the heading only, and the frame's position has no effect
            c, s = cos(self.mean[G + 2]), sin(self.mean[G + 2])
            rx, ry = c * self.mean[0] - s * self.mean[1], s * self.mean[0] + c * self.mean[1]
            w = self.put(k, self.put(k, w, G, by_x), G + 1, by_y)
            by_theta = by_y * rx - by_x * ry + by_theta
        return self.put(k, w, G + 2, by_theta)

    def covariance_of(self, a: int, b: int) -> float:
        """Return H_a P H_b' of rows a and b."""
        total = 0.0
        for j in range(self.row_count[b]):
            v, at = 0.0, self.row_at[b, j]
            for i in range(self.row_count[a]):
                v += self.row_H[a, i] * self.P[self.row_at[a, i], at]
            total += self.row_H[b, j] * v
        return total

    def judge(self, first: int, d: int) -> float:
        """Return the joint NIS of the d rows from `first` on, and write the factors of S = L D L' to `small`.

        The diagonal of S is written to row MAX_NUMBERS of `small`. The NIS is NaN if S is not finite.
        """
        total, nis = 0.0, 0.0
        greatest = 0.0
        for a in range(d):
            for b in range(a + 1):
                self.small[a, b] = self.covariance_of(first + a, first + b)
            if d == 1 and self.small[0, 0] < 0.0:
                self.small[0, 0] = 0.0  # it is negative only by rounding
            for b in range(a + 1):
                self.small[a, b] += self.row_R[first + a, first + b]
            self.small[MAX_NUMBERS, a] = self.small[a, a]
            self.small[MAX_NUMBERS + 1, a] = self.row_y[first + a]
            total += self.small[a, a]
            greatest = max(greatest, self.small[a, a])
        if not total * total < INFINITE:
            return NAN
        for i in range(d):
            if not self.small[i, i] > 0.0:
                self.not_positive(-greatest)
            v = self.small[MAX_NUMBERS + 1, i]
            nis += v * v / self.small[i, i]
            for j in range(i + 1, d):
                share = self.small[j, i] / self.small[i, i]
                self.small[MAX_NUMBERS + 1, j] -= share * v
                for k in range(i + 1, j + 1):
                    self.small[j, k] -= share * self.small[k, i]
        return nis

    def variance(self, H: Any, columns: Any = (), H_block: Any = (), in_map: bool = False) -> float:
        """Return the variance H P H' of a scalar: H (3,) is by the pose, H_block (c,) by the states `columns`."""
        self.room_for(1, len(columns))
        self.write_row(self.written, H, columns, H_block, in_map)
        return max(self.covariance_of(self.written, self.written), 0.0)

    # ---- correct ----

    def begin(self) -> None:
        """Start an update without rows."""
        self.written = self.queued = 0

    def queue_rows(self, first: int, rows: int) -> None:
        """Queue rows for the correction of the state."""
        for k in range(rows):
            self.queued_rows[self.queued + k] = first + k
        self.queued += rows

    def add_row_noise(self, k: int, variance: float) -> None:
        """Add a variance to the noise of row k."""
        self.row_R[k, k] += variance

    def whiten(self, begin: int, end: int) -> float:
        """Write V = L^-1 H P and e = L^-1 y of the queued rows begin:end, with S = H P H' + R = L L'.

        The elements of e are independent with unit variance, and V' L^-1 is the gain of eq. 10. Returns the
        largest variance in S; it is negated if S is not positive definite.
        """
        n, m = self.n, end - begin
        greatest = self.project(begin, m)
        if not self.factor(m):
            return -greatest
        for k in range(m):
            for i in range(k):
                lower = self.S[k, i]
                self.e[k] -= lower * self.e[i]
                for j in range(n):
                    self.V[k, j] -= lower * self.V[i, j]
            root = self.S[k, k]
            self.e[k] /= root
            for j in range(n):
                self.V[k, j] /= root
        return greatest

    def project(self, begin: int, m: int) -> float:
        """Write V = H P, e = y, and the lower half of S = V H' + R; return the largest variance in S."""
        n, greatest = self.n, 0.0
        for k in range(m):
            q = self.queued_rows[begin + k]
            self.e[k] = self.row_y[q]
            for j in range(n):
                self.V[k, j] = 0.0
            for j in range(k + 1):
                r = self.queued_rows[begin + j]
                self.S[k, j] = self.row_R[q, r] if q >= r else self.row_R[r, q]
            for i in range(self.row_count[q]):
                h, row = self.row_H[q, i], self.row_at[q, i]
                for j in range(n):
                    self.V[k, j] += h * self.P[row, j]
            for i in range(self.row_count[q]):
                h, row = self.row_H[q, i], self.row_at[q, i]
                for j in range(k + 1):
                    self.S[k, j] += h * self.V[j, row]
            greatest = max(greatest, self.S[k, k])
        return greatest

    def factor(self, m: int) -> bool:
        """Write the Cholesky factor L of S (m, m) over its lower half; return whether S is positive definite."""
        for k in range(m):
            for j in range(k):
                for i in range(j):
                    self.S[k, j] -= self.S[k, i] * self.S[j, i]
                self.S[k, j] /= self.S[j, j]
                self.S[k, k] -= self.S[k, j] * self.S[k, j]
            if not self.S[k, k] > 0.0:
                return False
            self.S[k, k] = sqrt(self.S[k, k])
        return True

    def correct_queued(self) -> None:
        """Correct the state with all queued rows (eq. 10-12), and adapt the covariance of the map frame.

        Then (`frame_x`, `frame_y`) [m] is the correction of the map frame's position (`turn_frame`).
        """
        m, G = self.queued, self.frame
        greatest = self.whiten(0, m)
        if not greatest > 0.0:
            self.not_positive(greatest)
        self.frame_x = self.frame_y = 0.0
        if G >= 0:
            self.frame_x, self.frame_y = -self.mean[G], -self.mean[G + 1]
        if self.keeps:
            self.correct_some(m)
        else:
            self.correct_all(m)
        if G >= 0:
            self.frame_x, self.frame_y = self.frame_x + self.mean[G], self.frame_y + self.mean[G + 1]
            if self.frame_x != 0.0 or self.frame_y != 0.0:
                self.turn_frame(self.frame_x, self.frame_y)

    def correct_all(self, m: int) -> None:
        """Eq. 11, mean <- mean + V' e, and eq. 12, P <- P - V' V, with m rows.

        Four rows are used at a time, to load P from memory less often; V is padded with zero rows.
        """
        n = self.n
        for k in range(m, m + 3):
            for j in range(n):
                self.V[k, j] = 0.0
        for k in range(m):
            for j in range(n):
                self.mean[j] += self.V[k, j] * self.e[k]
        for i in range(n):
            least = MIN_KEPT_SHARE * self.P[i, i]
            for k in range(0, m, 4):  # Cython makes a C loop only if the step is a literal
                a, b, c, d = self.V[k, i], self.V[k + 1, i], self.V[k + 2, i], self.V[k + 3, i]
                for j in range(i, n):
                    self.P[i, j] -= (
                        a * self.V[k, j] + b * self.V[k + 1, j] + c * self.V[k + 2, j] + d * self.V[k + 3, j]
                    )
            self.mirror(i, i, least)

    def correct_some(self, m: int) -> None:
        """Correct with m rows while considered states keep their values (Schmidt-Kalman)."""
        n = self.n
        for j in range(n):
            for k in range(0 if self.kept[j] else m):
                self.mean[j] += self.V[k, j] * self.e[k]
        for i in range(n):
            if self.kept[i]:
                continue  # its covariances with the other states are written in their rows
            least = MIN_KEPT_SHARE * self.P[i, i]
            for k in range(m):
                a = self.V[k, i]
                for j in range(n):
                    if j >= i or self.kept[j]:
                        self.P[i, j] -= a * self.V[k, j]
            self.mirror(i, 0, least)

    def mirror(self, i: int, first: int, least: float) -> None:
        """Copy row i of P to column i from element `first` on; the variance becomes at least `least`."""
        if self.P[i, i] < least:
            self.P[i, i] = least
        for j in range(first, self.n):
            self.P[j, i] = self.P[i, j]

    def fit(self, rows: int) -> float:
        """Return the joint NIS y' S^-1 y of the `rows` rows that `whiten` processed last."""
        nis = 0.0
        for k in range(rows):
            nis += self.e[k] * self.e[k]
        return nis

    def turn_frame(self, dx: float, dy: float) -> None:
        """Rotate the covariance of the map frame after its correction by (dx, dy) [m].

        A rotation of map and poses about the map's origin is not observable. Its effect on the frame's position
        is proportional to this position, so after the correction rows x, y += (-dy, dx) row Th.
        """
        G, n = self.frame, self.n
        for j in range(n):
            self.P[G, j] -= dy * self.P[G + 2, j]
            self.P[G + 1, j] += dx * self.P[G + 2, j]
        for i in range(n):
            self.P[i, G] -= dy * self.P[i, G + 2]
            self.P[i, G + 1] += dx * self.P[i, G + 2]
        self.P[G + 1, G] = self.P[G, G + 1]

    # ---- clone and look ----

    def copy_pose(self, column: int) -> None:
        """Copy the pose with its covariances to the states from `column` on (cloning)."""
        n = self.n
        for i in range(3):
            self.mean[column + i] = self.mean[i]
            for j in range(n):
                self.P[column + i, j] = self.P[i, j]
        for i in range(n):
            for j in range(3):
                self.P[i, column + j] = self.P[i, j]

    def replace(self, columns: Any, values: Any, G: Any) -> None:
        """Replace states (k,) by `values`, and P by T P T'; T is the identity, with G (k, k) for these states."""
        k, first = len(columns), self.written
        self.room_for(k, k)  # T is written after the rows of the measurement equation
        for a in range(k):
            by = G[a]
            for b in range(k):
                self.row_at[first + a, b], self.row_H[first + a, b] = columns[b], by[b]
        self.turn_rows(first, k)
        for a in range(k):
            self.mean[self.row_at[first, a]] = values[a]

    def turn_rows(self, first: int, k: int) -> None:
        """Apply P <- T P T': T is the identity matrix with k rows replaced by the table's rows from `first` on."""
        n = self.n
        for i in range(n):
            for a in range(k):
                self.V[a, i] = 0.0
                for b in range(k):
                    self.V[a, i] += self.row_H[first + a, b] * self.P[self.row_at[first, b], i]
        for i in range(n):
            for a in range(k):
                self.P[self.row_at[first, a], i] = self.V[a, i]
        for i in range(n):
            for a in range(k):
                self.e[a] = 0.0
                for b in range(k):
                    self.e[a] += self.row_H[first + a, b] * self.P[i, self.row_at[first, b]]
            for a in range(k):
                self.P[i, self.row_at[first, a]] = self.e[a]

    @property
    def x(self) -> float:
        """Return the x coordinate of the local pose [m]."""
        return self.mean[0]

    @property
    def y(self) -> float:
        """Return the y coordinate of the local pose [m]."""
        return self.mean[1]

    @property
    def theta(self) -> float:
        """Return the heading of the local pose [rad], not wrapped."""
        return self.mean[2]

    def value(self, column: int) -> float:
        """Return the state in a column."""
        return self.mean[column]

    def pose(self) -> tuple[float, float, float]:
        """Return the local pose x, y [m], theta [rad]."""
        return self.mean[0], self.mean[1], self.mean[2]

    def pose_in_map(self) -> tuple[float, float, float]:
        """Return the pose in the map x, y [m], theta [rad, not wrapped]."""
        G = self.frame
        if G < 0:
            return self.mean[0], self.mean[1], self.mean[2]
        c, s = cos(self.mean[G + 2]), sin(self.mean[G + 2])
        x, y = (
            self.mean[G] + c * self.mean[0] - s * self.mean[1],
            self.mean[G + 1] + s * self.mean[0] + c * self.mean[1],
        )
        return x, y, self.mean[2] + self.mean[G + 2]

    def note(self, k: int, track: TrackColumns) -> None:
        """Write row k of a track: the pose in the map, its covariance, and the recorded states.

        The covariance is by the chain rule, from the rows of x, y, theta in the map. A large heading variance of
        the map frame also spreads the position along its lever r from that frame: bent(P[Th, Th]) r r'.
        """
        first, at, n, G = self.written, 0, track.states.shape[0], self.frame
        x, y, theta, rx, ry = self.mean[0], self.mean[1], self.mean[2], 0.0, 0.0
        if G >= 0:
            c, s = cos(self.mean[G + 2]), sin(self.mean[G + 2])
            rx, ry = c * x - s * y, s * x + c * y
            x, y, theta = self.mean[G] + rx, self.mean[G + 1] + ry, theta + self.mean[G + 2]
        track.pose[k, 0], track.pose[k, 1], track.pose[k, 2] = x, y, theta
        self.room_for(3, 0)
        for a in range(3):
            by_x, by_y, by_theta = float(a == 0), float(a == 1), float(a == 2)
            w = self.derive(first + a, by_x, by_y, by_theta, True)
            self.row_count[first + a] = self.derive_frame(first + a, w, by_x, by_y, by_theta) if G >= 0 else w
        for a in range(3):
            for b in range(a, 3):
                track.triangle[k, at] = self.covariance_of(first + a, first + b)
                at += 1
        if G >= 0:
            e = bent(self.P[G + 2, G + 2])
            track.triangle[k, 0] += e * rx * rx
            track.triangle[k, 1] += e * rx * ry
            track.triangle[k, 3] += e * ry * ry
        for j in range(n):
            track.values[k, j] = self.mean[track.states[j]]
            track.values[k, n + j] = self.P[track.states[j], track.states[j]]


def bent(tt: float) -> float:
    """Return the variance along a lever of length 1, caused by the heading variance tt [rad^2] (second order).

    With a Gaussian heading error a, the end of the lever is at cos(a) along it:
    E (cos a - 1)^2 = 1 - 2 exp(-tt / 2) + (1 + exp(-2 tt)) / 2. For small tt this is 3/4 tt^2.
    """
    if tt > 1e-3:
        return 1.0 - 2.0 * exp(-0.5 * tt) + 0.5 * (1.0 + exp(-2.0 * tt))
    return 0.75 * tt * tt
