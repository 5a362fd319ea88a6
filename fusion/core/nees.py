"""Errors against their claimed covariance, many at once: NEES (Bar-Shalom, Li, Kirubarajan 2001, 5.4.2)."""

from .filter import factor


def nees(e, S, rows, d, least, L, w, out):
    """Write e' S^-1 e / d of errors e (rows, d) whose covariances S (rows, d * d) are not singular.

    One is singular where 1 / tr S^-1 is not above `least` of tr S, or of `least` itself: up to the factor d these
    are its smallest and its largest eigenvalue, however the numbers are ordered. Room: L (d, d), w (d,).
    """
    for q in range(rows):
        whole = 0.0
        for i in range(d):
            for j in range(d):
                L[i, j] = S[q, d * i + j]
            whole += L[i, i]
        if not factor(L, d) or not least * max(whole, least) * of_inverse(L, d, w) < 1.0:
            continue
        for i in range(d):
            w[i] = e[q, i]
        out[q] = squared(L, d, w, 0) / d


def of_inverse(L, d, w):
    """Return tr S^-1 of S = L L': the sum of all squared numbers of L^-1, column by column."""
    trace = 0.0
    for k in range(d):
        for i in range(k, d):
            w[i] = 0.0
        w[k] = 1.0
        trace += squared(L, d, w, k)
    return trace


def squared(L, d, w, first):
    """Write L^-1 w over w (d,), whose numbers before `first` are 0; return the sum of its squares."""
    total = 0.0
    for i in range(first, d):
        for j in range(first, i):
            w[i] -= L[i, j] * w[j]
        w[i] /= L[i, i]
        total += w[i] * w[i]
    return total
