"""Errors against their claimed covariance, many at once: NEES (Bar-Shalom, Li, Kirubarajan 2001, 5.4.2)."""

from .filter import factor


def nees(e, S, rows, d, least, L, w, out):
    """Write e' S^-1 e / d of errors e (rows, d) whose covariances S (rows, d * d) are regular beyond doubt.

    The smallest eigenvalue of S is at least 1 / trace(S^-1), the largest at most trace(S): their ratio is above
    `least` where that of the bounds is. Room: L (d, d), w (d,).
    """
    for q in range(rows):
        trace = 0.0
        for i in range(d):
            for j in range(d):
                L[i, j] = S[q, d * i + j]
            trace += L[i, i]
        if not factor(L, d) or not inverse_trace(L, d, w) * least * max(trace, least) < 1.0:
            continue
        total = 0.0
        for i in range(d):
            w[i] = e[q, i]
            for j in range(i):
                w[i] -= L[i, j] * w[j]
            w[i] /= L[i, i]
            total += w[i] * w[i]
        out[q] = total / d


def inverse_trace(L, d, w):
    """Return the trace of (L L')^-1: the squares of L^-1, column by column."""
    total = 0.0
    for column in range(d):
        for i in range(column, d):
            w[i] = 1.0 if i == column else 0.0
            for j in range(column, i):
                w[i] -= L[i, j] * w[j]
            w[i] /= L[i, i]
            total += w[i] * w[i]
    return total
