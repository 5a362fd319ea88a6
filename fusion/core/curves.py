"""Walls that bend: pieces that are straight one by one, but follow each other round a curve.

A round wall is cut into chords as long as the laser's noise allows. Each chord alone passes as straight, yet where
it lies depends on where it was cut, and the cuts turn with the robot: no landmark. Its neighbours tell. On a curve
the wall goes on in pieces that turn the same way, by as much as the bow of each piece says. Straight walls that
meet in a blunt corner have no bow.
"""

from math import cos, pi, sin

from .fit import curvature, normal_equations, parabola, residuals, rows_of, singular, stiffness, wrapped
from .walls import distance

LEAST_TURN = 0.08  # rad over the length of a piece, a bow of 1 % of it: what bends less is as good as straight
MOST_TURN = 0.7  # rad from one piece to the next: no curve is cut so coarsely
LEAST_PIECES = 3  # of a curve: two are a blunt corner
SHADOW = 0.6  # m between pieces of one curve: a piece in between may have been too short for a wall
SURE = 4.0  # chi2 that a curve must save over all its pieces (2 sigma: 98 %)
SPARED = 3.0  # chi2 that each piece more is worth: a curve needs no line of its own for it
STRAIGHT = -25.0  # chi2 that a curve saves in a piece which is straight by itself (5 sigma)


def following(walls, closed, i):
    """Return the wall after wall i in the order of the beams, -1: none."""
    if i + 1 < walls:
        return i + 1
    return 0 if closed and walls > 1 else -1


def joints(x, y, start, stop, bounds, walls, closed, psi, joint):
    """Write the curvature [1/m] with which each wall goes on in the next, 0 where it does not; return how many do.

    Positive where psi grows along the tangent (-sin psi, cos psi).
    """
    found = 0
    for i in range(walls):
        joint[i] = 0.0
        j = following(walls, closed, i)
        if j < 0:
            continue
        begin, tail = start[bounds[i]], stop[bounds[i + 1] - 1] - 1
        head, end = start[bounds[j]], stop[bounds[j + 1] - 1] - 1
        gap = distance(x, y, tail, head)
        turn = psi[j] - psi[i]
        if not (gap <= SHADOW and abs(turn) < 3.0 * pi):  # NaN: points at no real place
            continue
        turn = wrapped(turn)
        if abs(turn) > MOST_TURN:
            continue
        way = gap + 0.5 * (distance(x, y, begin, tail) + distance(x, y, head, end))
        ahead = cos(psi[i]) * (y[tail] - y[begin]) - sin(psi[i]) * (x[tail] - x[begin])
        if way > 0.0:
            joint[i] = turn / way if ahead > 0.0 else -turn / way
            found += 1
    return found


def curvature_of(joint, walls, closed, i):
    """Return the curvature [1/m] that the neighbours of wall i give it; 0 where it has none or they disagree."""
    behind = joint[i - 1] if i > 0 else joint[walls - 1] if closed else 0.0
    ahead = joint[i]
    if behind == 0.0 or ahead == 0.0:
        return behind + ahead
    return 0.5 * (behind + ahead) if behind * ahead > 0.0 else 0.0


def gain(d, ux, uy, ox, oy, row, n, r, psi, ratio, variance, bent, e, q, w, sums):
    """Return by how much the chi2 of n returns falls if their wall has the curvature `bent` [1/m], not none."""
    if bent == 0.0:
        return 0.0
    residuals(d, ux, uy, ox, oy, row, n, r, psi, ratio, e, q, w)
    normal_equations(n, e, q, w, sums)
    if singular(sums):
        return 0.0
    parabola(n, e, q, w, sums)
    height = -0.5 * bent  # of the parabola [1/m]: where psi grows, a wall comes nearer beside its middle
    return stiffness(sums) * height * (2.0 * curvature(sums) - height) / variance


def goes_on(joint, gains, walls, closed, i, step, sums):
    """Add to sums[0] the chi2 that a curve saves beyond wall i one way (step 1, -1), to sums[1] its pieces."""
    sign = 0.0
    for _ in range(walls - 1):
        at = i if step > 0 else i - 1 if i > 0 else walls - 1
        i = i + step
        i = 0 if i == walls else walls - 1 if i < 0 else i
        here = joint[at]
        if here == 0.0 or here * sign < 0.0 or gains[i] < STRAIGHT:
            return
        sign = here
        sums[0] += gains[i] + SPARED
        sums[1] += 1.0


def is_piece(joint, gains, walls, closed, i, length, sums):
    """Tell whether wall i of `length` [m] is a piece of a curve of several pieces, which explains them better."""
    bent = curvature_of(joint, walls, closed, i)
    if abs(bent) * length < LEAST_TURN or gains[i] < STRAIGHT:
        return False
    sums[0], sums[1] = gains[i] - SPARED, 1.0
    goes_on(joint, gains, walls, closed, i, 1, sums)
    goes_on(joint, gains, walls, closed, i, -1, sums)
    return sums[1] >= LEAST_PIECES and sums[0] > SURE


def find_curves(
    d, ux, uy, ox, oy, x, y, start, stop, bounds, walls, closed, r, psi, ratio, variance, row, e, q, w, sums,
    joint, gains, curved
):  # fmt: skip
    """Write which walls are pieces of a curve.

    Where most walls of a scan are, another one is straight only if its own returns say so: it may be a piece of
    the same curve whose neighbours are hidden.
    """
    for i in range(walls):
        curved[i] = 0
    if joints(x, y, start, stop, bounds, walls, closed, psi, joint) < LEAST_PIECES - 1:
        return
    for i in range(walls):
        bent = curvature_of(joint, walls, closed, i)
        n = rows_of(start, stop, bounds[i], bounds[i + 1], row)
        gains[i] = gain(d, ux, uy, ox, oy, row, n, r[i], psi[i], ratio, variance, bent, e, q, w, sums)
    found, mean = 0, 0.0
    for i in range(walls):
        length = distance(x, y, start[bounds[i]], stop[bounds[i + 1] - 1] - 1)
        if is_piece(joint, gains, walls, closed, i, length, sums):
            curved[i] = 1
            found += 1
            mean += curvature_of(joint, walls, closed, i)
    for i in range(walls if 2 * found > walls else 0):
        n = rows_of(start, stop, bounds[i], bounds[i + 1], row)
        bent = mean / found
        if gain(d, ux, uy, ox, oy, row, n, r[i], psi[i], ratio, variance, bent, e, q, w, sums) > -SURE:
            curved[i] = 1
