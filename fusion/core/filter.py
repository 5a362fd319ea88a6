"""The filter's equations (eq. 5-7, 10-12 of the paper) for a pose with any number of states beside it.

x (n,) begins with the pose (x, y, theta); P (n, n) is its covariance, of which both halves are kept. Arrays may
have room for more states than there are.
"""

from math import cos, sin, sqrt


def move(x, P, n, ux, uy, turn, qxx, qxy, qxt, qyy, qyt, qtt):
    """Eq. 5-7: move by the relative pose (ux, uy, turn) of covariance Q, in the frame of its start.

    Row x of A is (1, 0, -dy), row y is (0, 1, dx): rows and columns of x and y take that much of theta's.
    """
    c, s = cos(x[2]), sin(x[2])
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
        for k in range(0, m, 4):
            a, b, c, d = V[k, i], V[k + 1, i], V[k + 2, i], V[k + 3, i]
            for j in range(i, n):
                P[i, j] -= a * V[k, j] + b * V[k + 1, j] + c * V[k + 2, j] + d * V[k + 3, j]
        for j in range(i + 1, n):
            P[j, i] = P[i, j]


def consider(x, P, n, V, e, m, kept):
    """The same by Schmidt: states that are `kept` (n,) count, but neither they nor their covariance change."""
    for j in range(n):
        for k in range(0 if kept[j] else m):
            x[j] += V[k, j] * e[k]
    for i in range(n):
        for j in range(i, n):
            if not (kept[i] and kept[j]):
                for k in range(m):
                    P[i, j] -= V[k, i] * V[k, j]
                P[j, i] = P[i, j]


def take_in(x, P, n, at, states, H, R, y, m, V, kept, some):
    """Eq. 10-12 at once: correct by y (m,) = H dx + noise of covariance R. Returns what `whiten` does."""
    greatest = whiten(P, n, at, states, H, R, y, m, V)
    if greatest > 0.0 and some:
        consider(x, P, n, V, y, m, kept)
    elif greatest > 0.0:
        correct(x, P, n, V, y, m)
    return greatest


def swing(P, n, first, dx, dy):
    """Let the uncertainty of the map frame's place follow its correction by (dx, dy) [m] (JointBelief._swing)."""
    for j in range(n):
        P[first, j] -= dy * P[first + 2, j]
        P[first + 1, j] += dx * P[first + 2, j]
    for i in range(n):
        P[i, first] -= dy * P[i, first + 2]
        P[i, first + 1] += dx * P[i, first + 2]
    P[first + 1, first] = P[first, first + 1]
