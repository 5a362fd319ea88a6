"""The filter's equations (eq. 5-7, 10-12 of the paper) for a pose with any number of states beside it.

x (n,) begins with the pose (x, y, theta); P (n, n) is its covariance, of which both halves are kept. Arrays may
have room for more states than there are.
"""

from math import cos, exp, sin, sqrt

AT_ONCE = 4  # rows of a correction that `correct` takes together
ROUNDING = 1e-14  # a correction leaves at least this share of a variance: below is only rounding
FINE = 1.0  # returned where no correction failed: only its sign is read


def move(x, P, n, ux, uy, turn, qxx, qxy, qxt, qyy, qyt, qtt, J, k, first, states):
    """Eq. 5-7: move by the relative pose (ux, uy, turn) of covariance Q, in the frame of its start.

    Row x of A is (1, 0, -dy), row y is (0, 1, dx): rows and columns of x and y take that much of theta's. So many
    `states` z, from column `first` on, correct the motion, which is u + J z with row k of J (3, states).
    """
    c = s = x[2] - x[2]  # NaN where there is no heading
    if c == 0.0:
        c, s = cos(x[2]), sin(x[2])
    for i in range(states):
        by = x[first + i]
        ux += J[k, i] * by
        uy += J[k, states + i] * by
        turn += J[k, 2 * states + i] * by
    dx, dy = c * ux - s * uy, s * ux + c * uy  # eq. 5
    x[0] += dx
    x[1] += dy
    x[2] += turn
    for j in range(n):  # eq. 6, A P A' with A of eq. 7
        P[0, j] -= dy * P[2, j]
        P[1, j] += dx * P[2, j]
    for i in range(n):
        P[i, 0] -= dy * P[i, 2]
        P[i, 1] += dx * P[i, 2]
    cc, cs, ss = c * c, c * s, s * s  # eq. 6, W Q W'
    P[0, 0] += cc * qxx - 2.0 * cs * qxy + ss * qyy
    P[1, 1] += ss * qxx + 2.0 * cs * qxy + cc * qyy
    P[2, 2] += qtt
    P[0, 1] += cs * (qxx - qyy) + (cc - ss) * qxy
    P[0, 2] += c * qxt - s * qyt
    P[1, 2] += s * qxt + c * qyt
    for i in range(states):  # A has a column W J for each of them
        at, by_x, by_y, by_turn = first + i, J[k, i], J[k, states + i], J[k, 2 * states + i]
        dx, dy = c * by_x - s * by_y, s * by_x + c * by_y
        for j in range(n):
            P[0, j] += dx * P[at, j]
            P[1, j] += dy * P[at, j]
            P[2, j] += by_turn * P[at, j]
        for j in range(n):
            P[j, 0] += dx * P[j, at]
            P[j, 1] += dy * P[j, at]
            P[j, 2] += by_turn * P[j, at]
    P[1, 0], P[2, 0], P[2, 1] = P[0, 1], P[0, 2], P[1, 2]


def whiten(P, n, at, states, H, S, y, m, V):
    """Write V (m, n) and over y (m,): with S = H P H' + R = L L', V = L^-1 H P and e = L^-1 y.

    H (m, states) are derivatives by the states `at` (states,). S (m, m) is given as R; L is written over it. The
    parts of e are independent and of unit variance, and V' L^-1 is the gain of eq. 10. Returns the greatest
    variance in S, with a minus where S is not positive.
    """
    greatest = projected(P, n, at, states, H, S, m, V)
    if not factor(S, m):
        return -greatest
    for k in range(m):
        for i in range(k):
            lower = S[k, i]
            y[k] -= lower * y[i]
            for j in range(n):
                V[k, j] -= lower * V[i, j]
        root = S[k, k]
        y[k] /= root
        for j in range(n):
            V[k, j] /= root
    return greatest


def projected(P, n, at, states, H, S, m, V):
    """Write V = H P (m, n), add V H' to the lower half of S (m, m), and return the greatest variance in S."""
    greatest = 0.0
    for k in range(m):
        for j in range(n):
            V[k, j] = 0.0
        for i in range(states):
            h, row = H[k, i], at[i]
            if h != 0.0:
                for j in range(n):
                    V[k, j] += h * P[row, j]
        for i in range(states):
            h, row = H[k, i], at[i]
            if h != 0.0:
                for j in range(k + 1):
                    S[k, j] += h * V[j, row]
        greatest = max(greatest, S[k, k])
    return greatest


def factor(S, m):
    """Write L with L L' = S over the lower half of S (m, m) (Cholesky); tell whether S is positive."""
    for k in range(m):
        for j in range(k):
            for i in range(j):
                S[k, j] -= S[k, i] * S[j, i]
            S[k, j] /= S[j, j]
            S[k, k] -= S[k, j] * S[k, j]
        if not S[k, k] > 0.0:
            return False
        S[k, k] = sqrt(S[k, k])
    return True


def correct(x, P, n, V, e, m):
    """Eq. 11, x <- x + V' e, and eq. 12, P <- P - V' V; behind its m rows V has up to three of zeros.

    Four rows at a time, so that P is fetched from memory a quarter as often.
    """
    for k in range(m):
        for j in range(n):
            x[j] += V[k, j] * e[k]
    for i in range(n):
        least = ROUNDING * P[i, i]
        for k in range(0, m, 4):
            a, b, c, d = V[k, i], V[k + 1, i], V[k + 2, i], V[k + 3, i]
            for j in range(i, n):
                P[i, j] -= a * V[k, j] + b * V[k + 1, j] + c * V[k + 2, j] + d * V[k + 3, j]
        mirror(P, i, i, n, least)


def consider(x, P, n, V, e, m, kept):
    """The same by Schmidt: states that are `kept` (n,) count, but neither they nor their covariance change."""
    for j in range(n):
        for k in range(0 if kept[j] else m):
            x[j] += V[k, j] * e[k]
    for i in range(n):
        if kept[i]:
            continue  # its part of the others' rows is written there
        least = ROUNDING * P[i, i]
        for k in range(m):
            a = V[k, i]
            for j in range(n):
                if j >= i or kept[j]:
                    P[i, j] -= a * V[k, j]
        mirror(P, i, 0, n, least)


def mirror(P, i, first, n, least):
    """Let column i be what row i is from column `first` on, and variance i at least `least`."""
    if P[i, i] < least:
        P[i, i] = least
    for j in range(first, n):
        P[j, i] = P[i, j]


def take_in(x, P, n, at, states, H, R, y, m, V, kept, some):
    """Eq. 10-12 at once: correct by y (m,) = H dx + noise of covariance R. Returns what `whiten` does."""
    greatest = whiten(P, n, at, states, H, R, y, m, V)
    if greatest > 0.0 and some:
        consider(x, P, n, V, y, m, kept)
    elif greatest > 0.0:
        correct(x, P, n, V, y, m)
    return greatest


def locate(x, P, first, out):
    """Write pose and covariance triangle (9,), seen from the map where its frame G begins at column `first` >= 0.

    p = G o q has the covariance J_q P J_q' + J_q C J_G' + J_G C' J_q' + J_G P_G J_G' + bent r r', C = cov(q, G),
    with the derivatives of map_frame.
    """
    if first < 0:
        out[0], out[1], out[2] = x[0], x[1], x[2]
        out[3], out[4], out[5], out[6], out[7], out[8] = P[0, 0], P[0, 1], P[0, 2], P[1, 1], P[1, 2], P[2, 2]
        return
    a, b, t = first, first + 1, first + 2
    c = s = x[t] - x[t]
    if c == 0.0:
        c, s = cos(x[t]), sin(x[t])
    rx, ry = c * x[0] - s * x[1], s * x[0] + c * x[1]
    out[0], out[1], out[2] = x[a] + c * x[0] - s * x[1], x[b] + s * x[0] + c * x[1], x[t] + x[2]
    cc, cs, ss, e = c * c, c * s, s * s, bent(P[t, t])
    # J_q C, then times J_G': the columns of x and y take -ry and rx times the column of Th
    at, bt, tt = c * P[0, t] - s * P[1, t], s * P[0, t] + c * P[1, t], P[2, t]
    ax, ay = c * P[0, a] - s * P[1, a] - ry * at, c * P[0, b] - s * P[1, b] + rx * at
    bx, by = s * P[0, a] + c * P[1, a] - ry * bt, s * P[0, b] + c * P[1, b] + rx * bt
    tx, ty = P[2, a] - ry * tt, P[2, b] + rx * tt
    gxt, gyt, gtt = P[a, t], P[b, t], P[t, t]
    out[3] = cc * P[0, 0] - 2.0 * cs * P[0, 1] + ss * P[1, 1] + 2.0 * ax
    out[3] += P[a, a] - 2.0 * ry * gxt + ry * ry * gtt + e * rx * rx
    out[4] = cs * (P[0, 0] - P[1, 1]) + (cc - ss) * P[0, 1] + ay + bx
    out[4] += P[a, b] + rx * gxt - ry * gyt - rx * ry * gtt + e * rx * ry
    out[5] = c * P[0, 2] - s * P[1, 2] + at + tx + gxt - ry * gtt
    out[6] = ss * P[0, 0] + 2.0 * cs * P[0, 1] + cc * P[1, 1] + 2.0 * by
    out[6] += P[b, b] + 2.0 * rx * gyt + rx * rx * gtt + e * ry * ry
    out[7] = s * P[0, 2] + c * P[1, 2] + bt + ty + gyt + rx * gtt
    out[8] = P[2, 2] + 2.0 * tt + gtt


def by_local(x, first, by_x, by_y, by_theta, row):
    """Write the derivative by the local pose q and the map frame G of what has this one by the pose in the map.

    The chain rule of map_frame: H_q = H J_q, H_G = H J_G. Returns how many numbers these are. Without a frame,
    `first` < 0, the pose is that in the map.
    """
    if first < 0:
        row[0], row[1], row[2] = by_x, by_y, by_theta
        return 3
    turn = x[first + 2]
    c = s = turn - turn
    if c == 0.0:
        c, s = cos(turn), sin(turn)
    rx, ry = c * x[0] - s * x[1], s * x[0] + c * x[1]
    row[0], row[1], row[2] = c * by_x + s * by_y, c * by_y - s * by_x, by_theta
    row[3], row[4], row[5] = by_x, by_y, by_y * rx - by_x * ry + by_theta
    return 6


def bent(tt):
    """Return by how much a heading of variance tt [rad^2] spreads a lever r along r itself, per r^2.

    To first order a heading moves the end of a lever across it only. With a Gaussian angle a the end is at cos(a)
    along the lever: E (cos a - 1)^2 = 1 - 2 exp(-tt / 2) + (1 + exp(-2 tt)) / 2. That is 3/4 tt^2 for small
    tt, and nothing at half a degree.
    """
    if tt > 1e-3:
        return 1.0 - 2.0 * exp(-0.5 * tt) + 0.5 * (1.0 + exp(-2.0 * tt))
    return 0.75 * tt * tt


def swing(P, n, first, dx, dy):
    """Let the uncertainty of the map frame's place follow its correction by (dx, dy) [m] (JointBelief._swing)."""
    for j in range(n):
        P[first, j] -= dy * P[first + 2, j]
        P[first + 1, j] += dx * P[first + 2, j]
    for i in range(n):
        P[i, first] -= dy * P[i, first + 2]
        P[i, first + 1] += dx * P[i, first + 2]
    P[first + 1, first] = P[first, first + 1]


def keep_pose(x, P, n, column):
    """Let three states be the pose as it is now (a clone)."""
    for i in range(3):
        x[column + i] = x[i]
        for j in range(n):
            P[column + i, j] = P[i, j]
    for i in range(n):
        for j in range(3):
            P[i, column + j] = P[i, j]


def keep_heading(x, P, n, column, behind):
    """Let a state be the heading as it is now, less `behind` [rad] (a clone: Roumeliotis, Burdick 2002)."""
    x[column] = x[2] - behind
    for j in range(n):
        P[column, j] = P[2, j]
    for i in range(n):
        P[i, column] = P[i, 2]
    P[column, column] = P[2, 2]
