"""Scans of a robot at rest: which lines of one repeat those of the first, and how far off these they are in sum.

Whether a scan counts is decided in fusion.linemap.standing; the core takes those that only repeat.
"""

from .fit import wrapped

NEVER = 1e300


def repeats(rows, begin, lines, rest, same):
    """Write for each of the `lines` (7 columns) from row `begin` on the one that it repeats, same (lines,), or -1.

    Both are each other's nearest, within the squared distance `near`, and have a `share` of the longer in common.
    """
    for j in range(rest.known):
        rest.least[j] = NEVER
    for i in range(lines):
        same[i] = nearest_of(rows, begin + i, i, rest)
    for i in range(lines):
        if same[i] >= 0 and rest.best[same[i]] != i:
            same[i] = -1


def nearest_of(rows, a, i, rest):
    """Return the nearest of the lines at rest to row a, which is line i of its scan; -1 where none is near."""
    found, nearest = -1, rest.near
    det = rows[a, 2] * rows[a, 4] - rows[a, 3] * rows[a, 3]
    for j in range(rest.known):
        common = min(rows[a, 6], rest.lines[j, 3]) - max(rows[a, 5], rest.lines[j, 2])
        longer = max(rows[a, 6] - rows[a, 5], rest.lines[j, 3] - rest.lines[j, 2])
        if not (common > rest.share * longer and det > 0.0):
            continue
        r, psi = rows[a, 0] - rest.lines[j, 0], wrapped(rows[a, 1] - rest.lines[j, 1])
        d2 = (rows[a, 4] * r * r - 2.0 * rows[a, 3] * r * psi + rows[a, 2] * psi * psi) / (2.0 * det)
        if d2 < nearest:
            found, nearest = j, d2
        if d2 < rest.least[j]:
            rest.best[j], rest.least[j] = i, d2
    return found


def add_repeated(rows, begin, lines, rest, same):
    """Add to the sums by how much lines are off those that they repeat; each repeats one."""
    for i in range(lines):
        j = same[i]
        rest.sums[j, 0] += rows[begin + i, 0] - rest.lines[j, 0]
        rest.sums[j, 1] += wrapped(rows[begin + i, 1] - rest.lines[j, 1])
        rest.counts[j] += 1
    rest.scans += 1


def counts(scans):
    """Tell whether the last of so many scans at rest counts: the 1st, 2nd, 4th, 8th ..."""
    return (scans & (scans - 1)) == 0


def only_repeats(s, i, rest):
    """Tell whether scan i shows nothing else than lines at rest, and is none that counts: then it is taken."""
    begin, lines = s.first[i], s.first[i + 1] - s.first[i]
    if rest.scans < 2 or counts(rest.scans + 1):
        return False
    repeats(s.rows, begin, lines, rest, rest.same)
    for a in range(lines):
        if rest.same[a] < 0:
            return False
    add_repeated(s.rows, begin, lines, rest, rest.same)
    for a in range(lines):
        s.verdict[begin + a], s.landmark[begin + a] = rest.repeated, -1
    rest.taken += 1
    return True
