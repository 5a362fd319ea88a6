"""From straight pieces to walls: long enough, joined across narrow shadows, and what of them lies in corners.

A wall is made of parts: wall i owns the parts bounds[i]:bounds[i + 1], part j the returns start[j]:stop[j].
"""

from math import atan2, cos, pi, sin, sqrt

from .pieces import join, joint_misfit, own_misfit

MAX_STRAY_BEAMS = 2  # beams that hit something else and do not end a line: strays
MAX_CORNER_BEAMS = 4  # walls whose facing ends are this many beams apart meet in a corner
MAX_CORNER_SHARE = 0.2  # of a wall's length may be left out at either end
MIN_CORNER_SINE = 0.1  # of the least angle that is a corner
FAR = 1e300  # m


def distance(x, y, i, j):
    """Return the distance between the end points of returns i and j [m]."""
    dx, dy = x[j] - x[i], y[j] - y[i]
    return sqrt(dx * dx + dy * dy)


def long_enough(x, y, first, bounds, groups, min_points, min_length, m, start, stop):
    """Write the parts that have the points and the length of a wall, and return how many there are."""
    parts = 0
    for g in range(groups):
        begin, end = first[bounds[g]], first[bounds[g + 1]]
        if end - begin >= min_points and distance(x, y, begin, end - 1) >= min_length:
            start[parts], stop[parts] = begin, end
            for q in range(6):
                m[6 * parts + q] = m[6 * g + q]
            parts += 1
    return parts


def near(x, y, head, tail, next_head, next_tail, between, bridge, max_gap):
    """Tell whether one line may go on in the next part of its scan, given both parts' first and last returns.

    It may if next to no beams are `between` them, or if they are closer than `bridge` [m] and than both lengths.
    """
    open_way = distance(x, y, tail, next_head)
    shorter = min(distance(x, y, head, tail), distance(x, y, next_head, next_tail))
    return open_way <= min(shorter, bridge) or (between <= MAX_STRAY_BEAMS and open_way <= max_gap)


def link_parts(x, y, start, stop, parts, bridge, max_gap, linked):
    """Write which neighbouring parts may be one wall left and right of what stands before it."""
    for i in range(parts - 1):
        between = start[i + 1] - stop[i]
        linked[i] = near(x, y, start[i], stop[i] - 1, start[i + 1], stop[i + 1] - 1, between, bridge, max_gap)


def close_ring(x, y, k, start, stop, bounds, walls, m, bridge, max_gap, limit, room):
    """Join the first and the last wall of a closed ring of k returns if they are one; return how many stay."""
    last = walls - 1
    if last < 1:
        return walls
    head, tail = start[bounds[last]], stop[bounds[walls] - 1] - 1
    next_head, next_tail = start[0], stop[bounds[1] - 1] - 1
    if not near(x, y, head, tail, next_head, next_tail, next_head + k - tail - 1, bridge, max_gap):
        return walls
    if joint_misfit(m, last, 0) - own_misfit(m, last) - own_misfit(m, 0) >= limit:
        return walls
    join(m, last, 0)
    for q in range(6 * last):
        m[q] = m[q + 6]
    parts, moved = bounds[walls], bounds[1]
    rotate(start, parts, moved, room)  # the parts of the first wall go behind those of the last
    rotate(stop, parts, moved, room)
    for i in range(1, walls):
        bounds[i - 1] = bounds[i] - moved
    bounds[last] = parts
    return last


def rotate(values, n, by, room):
    """Move the first `by` of n values behind the others."""
    for i in range(n):
        room[i] = values[i]
    for i in range(n):
        values[i] = room[i + by if i + by < n else i + by - n]


def perpendicular_fit(m, walls, r, psi):
    """Write the lines nearest to the walls' weighted points, r [m] >= 0 and psi [rad].

    S. Pfister, S. Roumeliotis, J. Burdick: "Weighted line fitting algorithms for mobile robot map building and
    efficient data representation", ICRA 2003: psi from the scatter about the weighted mean, in closed form.
    """
    for i in range(walls):
        w, sx, sy = m[6 * i], m[6 * i + 1], m[6 * i + 2]
        mx, my = sx / w, sy / w
        a, b, c = m[6 * i + 3] - sx * mx, m[6 * i + 4] - sx * my, m[6 * i + 5] - sy * my
        angle = 0.5 * atan2(-2.0 * b, c - a)
        offset = mx * cos(angle) + my * sin(angle)
        r[i], psi[i] = abs(offset), angle + pi if offset < 0.0 else angle


def corner_limits(
    d, x, y, k, start, stop, bounds, walls, closed, r, psi, sigma_range, sigma_angle, sigmas, max_gap, low, high
):
    """Write the feet [m] along each wall's tangent between which its returns are its own.

    Near a corner the noise decides which wall a beam is counted to, so those beams are biased, and at the end of a
    wall they turn it most. A corner is where the next wall begins within a few beams and `max_gap` [m]; behind the
    last wall of a closed ring of k returns comes the first.
    """
    for i in range(walls):
        low[i], high[i] = -FAR, FAR
    for i in range(walls if closed else walls - 1):
        j = i + 1 if i + 1 < walls else 0
        tail, head = stop[bounds[i + 1] - 1] - 1, start[bounds[j]]
        apart = head - tail if head >= tail else head - tail + k
        sine = sin(psi[j] - psi[i])
        if apart > MAX_CORNER_BEAMS or distance(x, y, tail, head) > max_gap or abs(sine) <= MIN_CORNER_SINE:
            continue
        cosine = cos(psi[j] - psi[i])
        across = sigma_angle * d[tail]
        margin = sigmas * sqrt(across * across + sigma_range * sigma_range) / abs(sine)
        other = stop[bounds[j + 1] - 1] - 1
        limit_end(x, y, start[bounds[i]], tail, psi[i], (r[j] - r[i] * cosine) / sine, margin, i, low, high)
        limit_begin(x, y, head, other, psi[j], (r[j] * cosine - r[i]) / sine, margin, j, low, high)


def limit_end(x, y, head, tail, psi, corner, margin, i, low, high):
    """Leave out the end of wall i near a corner at the foot `corner` [m], but not too much of it."""
    tx, ty = -sin(psi), cos(psi)
    begin, end = tx * x[head] + ty * y[head], tx * x[tail] + ty * y[tail]
    share = MAX_CORNER_SHARE * abs(end - begin)
    if end >= begin:
        high[i] = max(corner - margin, end - share)
    else:
        low[i] = -max(-corner - margin, -end - share)


def limit_begin(x, y, head, tail, psi, corner, margin, i, low, high):
    """Leave out the beginning of wall i near a corner at the foot `corner` [m], but not too much of it."""
    tx, ty = -sin(psi), cos(psi)
    begin, end = tx * x[head] + ty * y[head], tx * x[tail] + ty * y[tail]
    share = MAX_CORNER_SHARE * abs(end - begin)
    if end >= begin:
        low[i] = min(corner + margin, begin + share)
    else:
        high[i] = -min(-corner + margin, -begin + share)
