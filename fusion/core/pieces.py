"""From returns to straight pieces: runs that no gap cuts are split, and neighbours that are one line are merged.

V. Nguyen, A. Martinelli, N. Tomatis, R. Siegwart: "A comparison of line extraction algorithms using 2D laser
rangefinder for indoor mobile robotics", IROS 2005. Pieces are given by `first` (p + 1): piece i owns the points
first[i]:first[i + 1]. Moments of a piece are six numbers, the weighted sums of 1, x, y, xx, xy, yy.
"""

from math import sqrt

NONE = 1e300  # the cost of joining what must not be joined
GAP = 1e9  # above every range [m]: beams behind a gap come before beams without one


def gather(ranges, cos, sin, x0, y0, scan, column, beams, begin, low, high, d, ux, uy, ox, oy, x, y, beam):
    """Gather the returns of scan number `scan`, from beam `begin` once round; return how many there are.

    A return is a range [m] in [low, high). Beam j starts at (x0, y0)[column + j] and points along (cos, sin).
    Written are range d [m], direction u, origin o [m], end point (x, y) [m] and which beam it is.
    """
    k = 0
    for i in range(beams):
        j = i + begin
        if j >= beams:
            j -= beams
        reading = ranges[scan * beams + j]
        if low <= reading < high:
            d[k] = reading
            ux[k] = cos[column + j]
            uy[k] = sin[column + j]
            ox[k] = x0[column + j]
            oy[k] = y0[column + j]
            x[k] = ox[k] + reading * ux[k]
            y[k] = oy[k] + reading * uy[k]
            beam[k] = j
            k += 1
    return k


def gap(dx, dy, d, before, growth, max_gap):
    """Return the squared distance of two neighbouring end points in units of what one wall allows.

    That is `max_gap` [m] > 0, or `growth` times the larger range: beam spacings grow with the range and, on a wall
    seen flat, with the angle of incidence.
    """
    limit = growth * (d if d > before else before)
    if limit < max_gap:
        limit = max_gap
    return (dx * dx + dy * dy) / (limit * limit)


def ring_start(d, x, y, k, growth, max_gap):
    """Return which return of a scan of the whole circle is its best first one.

    The one behind the widest gap; where there is none, the farthest, and then -1 - it: the ring is closed.
    """
    best = 0.0
    start = 0
    for i in range(k):
        before = i - 1 if i > 0 else k - 1
        jump = gap(x[i] - x[before], y[i] - y[before], d[i], d[before], growth, max_gap)
        score = GAP + jump if jump > 1.0 else d[i]
        if score > best:
            best = score
            start = i
    return start if best >= GAP else -1 - start


def cut_at_gaps(d, x, y, k, growth, max_gap, first):
    """Write where runs of neighbouring returns begin, `first` (runs + 1), and return how many there are."""
    runs = 0
    for i in range(k):
        if i == 0 or gap(x[i] - x[i - 1], y[i] - y[i - 1], d[i], d[i - 1], growth, max_gap) > 1.0:
            first[runs] = i
            runs += 1
    first[runs] = k
    return runs


def tolerances(d, k, sigma_range, sigma_angle, sigmas, floor, tolerance):
    """Write how far a return at range d [m] may lie off a straight piece [m], whatever the piece's direction."""
    least = max(floor, 1e-100)
    for i in range(k):
        across = sigma_angle * d[i]
        noise = sigmas * sqrt(across * across + sigma_range * sigma_range)
        tolerance[i] = noise if noise > least else least


def farthest(x, y, tolerance, begin, end):
    """Return the point that is farthest off the chord from `begin` to the last before `end`, in tolerances.

    -1 where every point lies within its tolerance [m]. The earliest of equals.
    """
    if end - begin < 3:
        return -1
    dx, dy = x[end - 1] - x[begin], y[end - 1] - y[begin]
    length = sqrt(dx * dx + dy * dy)
    if length == 0.0:  # one point, or a loop that closes exactly: any direction will do
        length, dy = 1.0, 1.0
    nx, ny = -dy / length, dx / length
    offset = nx * x[begin] + ny * y[begin]
    worst, at = 1.0, -1
    for i in range(begin, end):
        excess = abs(nx * x[i] + ny * y[i] - offset) / tolerance[i]
        if excess > worst:
            worst, at = excess, i
    return at


def split(x, y, tolerance, runs, run_first, todo, first, linked):
    """Cut runs of points into straight pieces and return how many; write `first`, and `linked`.

    A piece with a point off its chord is cut there; that point starts the second half. linked[i]: pieces i and
    i + 1 are of one run. `todo` (2, points) holds the halves that are still to be looked at.
    """
    pieces = 0
    for run in range(runs):
        todo[0], todo[1] = run_first[run], run_first[run + 1]
        depth = 1
        while depth > 0:
            depth -= 1
            begin, end = todo[2 * depth], todo[2 * depth + 1]
            cut = farthest(x, y, tolerance, begin, end)
            if cut > begin:
                todo[2 * depth], todo[2 * depth + 1] = cut, end
                todo[2 * depth + 2], todo[2 * depth + 3] = begin, cut
                depth += 2
            else:
                first[pieces] = begin
                linked[pieces] = end < run_first[run + 1]
                pieces += 1
    first[pieces] = run_first[runs]
    return pieces


def moments(d, ux, uy, x, y, first, pieces, sigma_range, sigma_angle, flatness, m):
    """Write every piece's moments m (pieces, 6), its points weighted by 1/variance across the piece's chord."""
    unevenness = max(flatness * flatness, 1e-100)
    for p in range(pieces):
        begin, end = first[p], first[p + 1]
        dx, dy = x[end - 1] - x[begin], y[end - 1] - y[begin]
        length = sqrt(dx * dx + dy * dy)
        if length == 0.0:
            length, dy = 1.0, 1.0
        nx, ny = -dy / length, dx / length
        w = sx = sy = sxx = sxy = syy = 0.0
        for i in range(begin, end):
            along = (nx * ux[i] + ny * uy[i]) * sigma_range
            across = (nx * uy[i] - ny * ux[i]) * d[i] * sigma_angle
            weight = 1.0 / (along * along + across * across + unevenness)
            wx, wy = weight * x[i], weight * y[i]
            w += weight
            sx += wx
            sy += wy
            sxx += wx * x[i]
            sxy += wx * y[i]
            syy += wy * y[i]
        m[6 * p], m[6 * p + 1], m[6 * p + 2] = w, sx, sy
        m[6 * p + 3], m[6 * p + 4], m[6 * p + 5] = sxx, sxy, syy


def misfit(w, sx, sy, sxx, sxy, syy):
    """Return the weighted sum of squared distances from the nearest line: the scatter's smaller eigenvalue."""
    mx, my = sx / w, sy / w
    a, b, c = sxx - sx * mx, sxy - sx * my, syy - sy * my
    half = 0.5 * (a - c)
    return max(0.5 * (a + c) - sqrt(half * half + b * b), 0.0)


def joint_misfit(m, i, j):
    """Return the misfit of pieces i and j as one line."""
    i, j = 6 * i, 6 * j
    return misfit(
        m[i] + m[j],
        m[i + 1] + m[j + 1],
        m[i + 2] + m[j + 2],
        m[i + 3] + m[j + 3],
        m[i + 4] + m[j + 4],
        m[i + 5] + m[j + 5],
    )


def join(m, i, j):
    """Add the moments of piece j to those of piece i."""
    for q in range(6):
        m[6 * i + q] += m[6 * j + q]


def own_misfit(m, i):
    """Return the misfit of piece i."""
    i = 6 * i
    return misfit(m[i], m[i + 1], m[i + 2], m[i + 3], m[i + 4], m[i + 5])


def merge(m, pieces, linked, limit, own, cost, after, before, best, bounds):
    """Join neighbouring pieces that are statistically one line; return how many groups there are.

    Two pieces are one line if fitting them as one raises the misfit by less than `limit`: a likelihood ratio,
    chi-square with 2 degrees of freedom. Pairs that cost less than both neighbouring pairs go first, all of them
    at a time. linked[i]: pieces i and i + 1 may be joined. Group i owns the pieces bounds[i]:bounds[i + 1]; its
    moments stand in row i of m. The other arrays are room to work in, (pieces + 1): the last row is no piece.
    """
    for i in range(pieces):
        own[i], after[i], before[i], cost[i] = own_misfit(m, i), i + 1, i - 1 if i > 0 else pieces, NONE
    cost[pieces], after[pieces], before[pieces] = NONE, pieces, pieces
    for i in range(pieces - 1):
        if linked[i]:
            cost[i] = joint_misfit(m, i, i + 1) - own[i] - own[i + 1]
    chosen = cheapest(cost, after, before, pieces, limit, best)
    while chosen > 0:
        join_pairs(m, own, cost, after, before, best, chosen)
        for q in range(chosen):
            renew_cost(m, own, cost, after, before[best[q]])
            renew_cost(m, own, cost, after, best[q])
        chosen = cheapest(cost, after, before, pieces, limit, best)
    return compact(m, after, pieces, bounds)


def cheapest(cost, after, before, pieces, limit, best):
    """Write into `best` which pairs are to be joined now, by their first pieces; return how many."""
    chosen = 0
    for i in range(pieces):
        if cost[i] < limit and cost[i] < cost[before[i]] and cost[i] <= cost[after[i]]:
            best[chosen] = i
            chosen += 1
    return chosen


def join_pairs(m, own, cost, after, before, best, chosen):
    """Join the chosen pieces with those after them."""
    for q in range(chosen):
        i = best[q]
        gone = after[i]
        join(m, i, gone)
        own[i] = own_misfit(m, i)
        cost[i], cost[gone] = cost[gone], NONE
        after[i] = after[gone]
        before[after[i]] = i


def renew_cost(m, own, cost, after, i):
    """Work out anew what it costs to join piece i with the one after it, if that is allowed at all."""
    if cost[i] < NONE:
        cost[i] = joint_misfit(m, i, after[i]) - own[i] - own[after[i]]


def compact(m, after, pieces, bounds):
    """Move the moments of the groups to the front, write `bounds`, and return how many groups there are."""
    groups = i = 0
    while i < pieces:
        bounds[groups] = i
        for q in range(6):
            m[6 * groups + q] = m[6 * i + q]
        groups += 1
        i = after[i]
    bounds[groups] = pieces
    return groups
