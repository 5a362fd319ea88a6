"""Which lines of a growing map are worth a look: those that proved nothing, and two that may be one wall.

Lines are rows (rho, beta, anchor x, y) with their ends `low` and `high` along the wall from the anchor.
"""

from math import cos, sin

from .fit import wrapped


def worthless(hits, born, j, scan, least, trial):
    """Tell whether line j was seen in fewer than `least` scans, `trial` scans after it was born."""
    return hits[j] < least and scan - born[j] > trial and born[j] > 0


def one_wall(rows, low, high, i, j, angle, offset, apart):
    """Tell whether lines i and j may be one wall by where they lie: within angle [rad], offset and apart [m]."""
    turn = rows[j, 1] - rows[i, 1]
    if i == j or turn - turn != 0.0 or not abs(wrapped(turn)) < angle:  # Inf or NaN: there is no such line
        return False
    c, s = cos(rows[i, 1]), sin(rows[i, 1])
    dx, dy = rows[i, 2] - rows[j, 2], rows[i, 3] - rows[j, 3]
    if not abs(rows[j, 0] - (rows[i, 0] + dx * c + dy * s)) <= offset:
        return False
    along = dy * cos(rows[j, 1]) - dx * sin(rows[j, 1])
    return max(low[j], low[i] + along) - min(high[j], high[i] + along) <= apart


def neighbours(rows, low, high, places, i, angle, offset, apart, found):
    """Write which of so many lines line i may be one wall with; return how many."""
    n = 0
    for j in range(places):
        if one_wall(rows, low, high, i, j, angle, offset, apart):
            found[n] = j
            n += 1
    return n
