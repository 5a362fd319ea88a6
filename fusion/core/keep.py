"""What a scan teaches lines that the map has: how far they reach, and that none is known better than its floor."""

from .match import whole
from .pairs import PAIR


def extend(pairs, fate, lines, low, high, hits, seen, scan):
    """Let the map lines that were matched reach as far as the measured ones, and count them as seen in `scan`."""
    for i in range(lines):
        if fate[i] >= 0:
            at = PAIR * fate[i]
            j = whole(pairs[at + 1])
            low[j], high[j] = min(low[j], pairs[at + 12]), max(high[j], pairs[at + 13])
            hits[j] += 1
            seen[j] = scan


def lacks(P, columns, places, rho, beta, at, missing):
    """Write which states of the lines at `columns` (places,) vary by less than rho and beta, and by how much.

    First all offsets, then all angles. Returns how many there are.
    """
    found = 0
    for k in range(2):
        floor = beta if k else rho
        for i in range(places):
            j = columns[i] + k
            if floor - P[j, j] > 0.0:
                at[found], missing[found] = j, floor - P[j, j]
                found += 1
    return found
