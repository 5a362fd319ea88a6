"""Errors against their claimed covariance, many at once: NEES (Bar-Shalom, Li, Kirubarajan 2001, 5.4.2)."""

from .filter import factor


def nees(e, S, rows, d, least, L, w, out):
    """Write e' S^-1 e / d of errors e (rows, d) whose covariances S (rows, d * d) are not singular.

    One is singular where a pivot of S = L L' is not above `least` of its largest variance, or of `least` itself.
    Room: L (d, d), w (d,).
    """
    for q in range(rows):
        largest = least
        for i in range(d):
            for j in range(d):
                L[i, j] = S[q, d * i + j]
            largest = max(largest, L[i, i])
        if not factor(L, d) or not pivot(L, d) > least * largest:
            continue
        total = 0.0
        for i in range(d):
            w[i] = e[q, i]
            for j in range(i):
                w[i] -= L[i, j] * w[j]
            w[i] /= L[i, i]
            total += w[i] * w[i]
        out[q] = total / d


def pivot(L, d):
    """Return the smallest pivot of S = L L'."""
    smallest = L[0, 0]
    for i in range(1, d):
        smallest = min(smallest, L[i, i])
    return smallest * smallest
