"""Segmentation of scans into walls: cut at gaps, split into straight pieces, merge, leave out corners.

V. Nguyen, A. Martinelli, N. Tomatis, R. Siegwart: "A comparison of line extraction algorithms using 2D laser
rangefinder for indoor mobile robotics", IROS 2005. `lines.extract.LineSettings` has the limits of a wall.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from locfuse.fusion.data import Array, Ints

from .arrays import floats, view, wholes

try:
    import cython
except ImportError:  # Cython is only needed to compile
    from . import uncompiled as cython
if not cython.compiled:
    from math import atan2, pi, tan

    from .uncompiled import cos, sin, sqrt

JOINS_NEVER_CHI2 = 1e300  # cost of merging pieces that must not be merged
GAP_SCORE_M = 1e9  # above every range: a full circle begins after a gap if there is one
MAX_STRAY_BEAMS = 2  # this many beams between two parts may hit another object
MAX_CORNER_BEAMS = 4  # walls meet in a corner if at most this many beams lie between their ends
MAX_CORNER_SHARE = 0.2  # largest share of a wall's length that is left out at a corner
MIN_CORNER_SINE = 0.1  # sine of the least angle of a corner
FAR_M = 1e300
MIN_DIVISOR = 1e-100


class ScanColumns:
    """Scans of one laser: `ranges` (n, b) [m]; ranges within [low, high) are returns.

    `rays`: direction cos, sin and origin x, y [m] of every beam, (n, b) each, or (b,) if equal in all scans.
    growth (n,): largest distance of neighbouring returns on a wall, per range; ring (n,): whether the scan is a
    full circle.
    """

    def __init__(
        self, ranges: Array, rays: tuple[Array, ...], growth: Array, ring: Any, limits: tuple[float, float]
    ) -> None:
        self.ranges = view(ranges)
        self.cosine, self.sine = view(np.atleast_2d(rays[0])), view(np.atleast_2d(rays[1]))
        self.x, self.y = view(np.atleast_2d(rays[2])), view(np.atleast_2d(rays[3]))
        self.moving = rays[0].ndim == 2
        self.growth, self.ring = view(growth), view(ring, "intp")
        self.low, self.high = limits


class Limits:
    """Limits of a wall, from LineSettings."""

    def __init__(self, settings: Any) -> None:
        self.sigma_range, self.sigma_angle = settings.sigma_range, settings.sigma_angle
        self.ratio = max(settings.sigma_angle / settings.sigma_range, MIN_DIVISOR)  # 1/m
        self.variance = settings.sigma_range * settings.sigma_range
        self.min_points, self.min_length = settings.min_points, settings.min_length
        self.max_gap, self.bridge = max(settings.max_gap, MIN_DIVISOR), settings.bridge
        self.split_sigmas, self.split_floor = settings.split_sigmas, settings.split_floor
        self.flatness, self.merge_chi2 = settings.flatness, settings.merge_chi2
        self.grazing = tan(settings.max_incidence)
        self.stray_sigmas, self.corner_sigmas = settings.stray_sigmas, settings.corner_sigmas
        self.max_sigma_psi, self.max_swing = settings.max_sigma_psi, settings.max_swing
        self.max_chi2, self.max_bow, self.max_bend = settings.max_chi2, settings.max_bow, settings.max_bend


class Returns:
    """Laser echoes of one scan, `count` of them in beam order.

    Each has a range [m], the beam's origin o [m] and direction u, the end point (x, y) [m], and a tolerance [m]:
    its largest distance from a straight piece. `closed`: the scan is a full circle without a gap.
    """

    def __init__(self, beams: int) -> None:
        self.ranges, self.tolerance = floats(beams), floats(beams)
        self.ux, self.uy = floats(beams), floats(beams)
        self.ox, self.oy = floats(beams), floats(beams)
        self.x, self.y = floats(beams), floats(beams)
        self.beam = wholes(beams)
        self.count, self.closed = 0, False


class Segments:
    """Straight pieces of a scan, which are merged to parts of walls; the parts are merged to walls.

    Piece i has the returns first[i]:first[i + 1], group i the pieces bounds[i]:bounds[i + 1]. Part j has the
    returns start[j]:stop[j], wall i the parts bounds[i]:bounds[i + 1]. The moments of a piece, part or wall are
    the weighted sums of 1, x, y, xx, xy, yy. linked[i]: i and i + 1 may be merged. Wall i has the line r [m], psi
    [rad]; its line fit uses returns between low and high [m] along the tangent.
    """

    def __init__(self, beams: int) -> None:
        room = beams + 1
        self.run_first, self.first, self.todo = wholes(room), wholes(room), wholes(room + 1, 2)
        self.linked, self.moments = wholes(room), floats(room, 6)
        self.own, self.cost = floats(room), floats(room)
        self.after, self.before, self.best = wholes(room), wholes(room), wholes(room)
        self.bounds, self.start, self.stop = wholes(room), wholes(room), wholes(room)
        self.r, self.psi, self.low, self.high = floats(room), floats(room), floats(room), floats(room)
        self.runs, self.pieces, self.groups, self.parts, self.walls = 0, 0, 0, 0, 0


def find_walls(scans: ScanColumns, scan: int, limits: Limits, returns: Returns, segments: Segments) -> None:
    """Find the walls of a scan and the returns of each wall."""
    growth = scans.growth[scan]
    gather(scans, scan, 0, returns)
    returns.closed = False
    if scans.ring[scan] != 0 and returns.count > 0:
        begin = ring_start(returns, growth, limits.max_gap)
        returns.closed = begin < 0
        gather(scans, scan, returns.beam[-1 - begin if begin < 0 else begin], returns)
    allow(returns, limits)
    cut_at_gaps(returns, growth, limits.max_gap, segments)
    split(returns, segments)
    weigh(returns, limits, segments)
    segments.groups = merge(segments, segments.pieces, limits.merge_chi2)
    long_enough(returns, limits, segments)
    segments.walls = merge(segments, segments.parts, limits.merge_chi2)
    if returns.closed:
        close_ring(returns, limits, segments)
    perpendicular_fit(segments)
    corner_limits(returns, limits, segments)


# ---- returns, runs and straight pieces ----


def gather(scans: ScanColumns, scan: int, begin: int, returns: Returns) -> None:
    """Collect the returns of a scan, beginning at beam `begin`."""
    beams, count, row = scans.ranges.shape[1], 0, scan if scans.moving else 0
    for i in range(beams):
        j = i + begin
        if j >= beams:
            j -= beams
        reading = scans.ranges[scan, j]
        if scans.low <= reading < scans.high:
            returns.ranges[count] = reading
            returns.ux[count] = scans.cosine[row, j]
            returns.uy[count] = scans.sine[row, j]
            returns.ox[count] = scans.x[row, j]
            returns.oy[count] = scans.y[row, j]
            returns.x[count] = scans.x[row, j] + reading * scans.cosine[row, j]
            returns.y[count] = scans.y[row, j] + reading * scans.sine[row, j]
            returns.beam[count] = j
            count += 1
    returns.count = count


def gap(returns: Returns, before: int, i: int, growth: float, max_gap: float) -> float:
    """Return (distance / limit)^2 of two neighbouring returns; a value above 1 is a gap between walls.

    The limit is `max_gap` [m] > 0 or `growth` times the larger range, whichever is larger: the distance of
    neighbouring returns grows with the range and with the angle of incidence.
    """
    dx, dy = returns.x[i] - returns.x[before], returns.y[i] - returns.y[before]
    limit = growth * max(returns.ranges[before], returns.ranges[i])
    limit = max(limit, max_gap)
    return (dx * dx + dy * dy) / (limit * limit)


def ring_start(returns: Returns, growth: float, max_gap: float) -> int:
    """Return the index of the return at which a full-circle scan is cut: the first one after the widest gap.

    Without a gap the circle is closed, and -1 - i is returned, with the index i of the farthest return.
    """
    best, start = 0.0, 0
    for i in range(returns.count):
        jump = gap(returns, i - 1 if i > 0 else returns.count - 1, i, growth, max_gap)
        score = GAP_SCORE_M + jump if jump > 1.0 else returns.ranges[i]
        if score > best:
            best, start = score, i
    return start if best >= GAP_SCORE_M else -1 - start


def cut_at_gaps(returns: Returns, growth: float, max_gap: float, segments: Segments) -> None:
    """Divide the points of a scan into runs without gaps."""
    runs = 0
    for i in range(returns.count):
        if i == 0 or gap(returns, i - 1, i, growth, max_gap) > 1.0:
            segments.run_first[runs] = i
            runs += 1
    segments.run_first[runs] = returns.count
    segments.runs = runs


def allow(returns: Returns, limits: Limits) -> None:
    """Compute the tolerance [m] of every return: its largest distance from a straight piece."""
    least = max(limits.split_floor, MIN_DIVISOR)
    for i in range(returns.count):
        across = limits.sigma_angle * returns.ranges[i]
        noise = limits.split_sigmas * sqrt(across * across + limits.sigma_range * limits.sigma_range)
        returns.tolerance[i] = max(least, noise)


def farthest(returns: Returns, begin: int, end: int) -> int:
    """Return the index in [begin, end) of the point farthest from the chord, relative to its tolerance.

    It is -1 if all points lie within their tolerances. Of equally far points it is the first one.
    """
    if end - begin < 3:
        return -1
    dx, dy = returns.x[end - 1] - returns.x[begin], returns.y[end - 1] - returns.y[begin]
    length = sqrt(dx * dx + dy * dy)
    if length == 0.0:  # one point, or a loop that closes exactly: any direction will do
        length, dy = 1.0, 1.0
    nx, ny = -dy / length, dx / length
    offset = nx * returns.x[begin] + ny * returns.y[begin]
    worst, at = 1.0, -1
    for i in range(begin, end):
        excess = abs(nx * returns.x[i] + ny * returns.y[i] - offset) / returns.tolerance[i]
        if excess > worst:
            worst, at = excess, i
    return at


def split(returns: Returns, segments: Segments) -> None:
    """Split runs (returns between two gaps) into straight pieces; pieces of one run are linked.

    A piece is cut at the point farthest from its chord, if that is beyond its tolerance. The second half begins
    with this point.
    """
    pieces, todo = 0, segments.todo  # halves that are not yet tested
    for run in range(segments.runs):
        todo[0, 0], todo[0, 1] = segments.run_first[run], segments.run_first[run + 1]
        depth = 1
        while depth > 0:
            depth -= 1
            begin, end = todo[depth, 0], todo[depth, 1]
            cut = farthest(returns, begin, end)
            if cut > begin:
                todo[depth, 0], todo[depth, 1] = cut, end
                todo[depth + 1, 0], todo[depth + 1, 1] = begin, cut
                depth += 2
            else:
                segments.first[pieces] = begin
                segments.linked[pieces] = end < segments.run_first[run + 1]
                pieces += 1
    segments.first[pieces] = segments.run_first[segments.runs]
    segments.pieces = pieces


def weigh(returns: Returns, limits: Limits, segments: Segments) -> None:
    """Compute the moments of every piece, with points weighted by 1/variance across the piece's chord."""
    unevenness, m = max(limits.flatness * limits.flatness, MIN_DIVISOR), segments.moments
    for p in range(segments.pieces):
        begin, end = segments.first[p], segments.first[p + 1]
        dx, dy = returns.x[end - 1] - returns.x[begin], returns.y[end - 1] - returns.y[begin]
        length = sqrt(dx * dx + dy * dy)
        if length == 0.0:
            length, dy = 1.0, 1.0
        nx, ny = -dy / length, dx / length
        w = sx = sy = sxx = sxy = syy = 0.0
        for i in range(begin, end):
            x, y, ux, uy = returns.x[i], returns.y[i], returns.ux[i], returns.uy[i]
            along = (nx * ux + ny * uy) * limits.sigma_range
            across = (nx * uy - ny * ux) * returns.ranges[i] * limits.sigma_angle
            weight = 1.0 / (along * along + across * across + unevenness)
            wx, wy = weight * x, weight * y
            w += weight
            sx += wx
            sy += wy
            sxx += wx * x
            sxy += wx * y
            syy += wy * y
        m[p, 0], m[p, 1], m[p, 2], m[p, 3], m[p, 4], m[p, 5] = w, sx, sy, sxx, sxy, syy


# ---- merging ----


def misfit(w: float, sx: float, sy: float, sxx: float, sxy: float, syy: float) -> float:
    """Return the weighted sum of squared distances from the best line: the smaller eigenvalue of the scatter."""
    mx, my = sx / w, sy / w
    a, b, c = sxx - sx * mx, sxy - sx * my, syy - sy * my
    half = 0.5 * (a - c)
    return max(0.5 * (a + c) - sqrt(half * half + b * b), 0.0)


def joint_misfit(segments: Segments, i: int, j: int) -> float:
    """Return the misfit of one line fitted to pieces i and j together."""
    m = segments.moments
    w, sx, sy = m[i, 0] + m[j, 0], m[i, 1] + m[j, 1], m[i, 2] + m[j, 2]
    return misfit(w, sx, sy, m[i, 3] + m[j, 3], m[i, 4] + m[j, 4], m[i, 5] + m[j, 5])


def own_misfit(segments: Segments, i: int) -> float:
    """Return the misfit of piece i."""
    m = segments.moments
    return misfit(m[i, 0], m[i, 1], m[i, 2], m[i, 3], m[i, 4], m[i, 5])


def join(segments: Segments, i: int, j: int) -> None:
    """Add the moments of piece j to those of piece i."""
    for q in range(6):
        segments.moments[i, q] += segments.moments[j, q]


def merge(segments: Segments, count: int, limit: float) -> int:
    """Merge neighbouring pieces that are statistically one line; return the number of groups.

    Two pieces are one line if a common fit increases the misfit by less than `limit` (likelihood ratio, chi-square
    with 2 degrees of freedom). In each round, all pairs that cost less than both neighbouring pairs are merged.
    Afterwards, the first rows of `moments` are those of the groups. Row `count` of the work arrays is a dummy.
    """
    own, cost = segments.own, segments.cost
    after, before = segments.after, segments.before
    for i in range(count):
        own[i], cost[i] = own_misfit(segments, i), JOINS_NEVER_CHI2
        after[i], before[i] = i + 1, i - 1 if i > 0 else count
    cost[count], after[count], before[count] = JOINS_NEVER_CHI2, count, count
    for i in range(count - 1):
        if segments.linked[i]:
            cost[i] = joint_misfit(segments, i, i + 1) - own[i] - own[i + 1]
    chosen = cheapest(segments, count, limit)
    while chosen > 0:
        join_pairs(segments, chosen)
        for q in range(chosen):
            renew_cost(segments, before[segments.best[q]])
            renew_cost(segments, segments.best[q])
        chosen = cheapest(segments, count, limit)
    return compact(segments, count)


def cheapest(segments: Segments, count: int, limit: float) -> int:
    """Write to `segments.best` the first pieces of the pairs to merge in this round; return their number.

    These pairs cost less than `limit` and less than both neighbouring pairs.
    """
    chosen, cost = 0, segments.cost
    for i in range(count):
        if cost[i] < limit and cost[i] < cost[segments.before[i]] and cost[i] <= cost[segments.after[i]]:
            segments.best[chosen] = i
            chosen += 1
    return chosen


def join_pairs(segments: Segments, chosen: int) -> None:
    """Merge the chosen pieces with the next ones."""
    for q in range(chosen):
        i = segments.best[q]
        gone = segments.after[i]
        join(segments, i, gone)
        segments.own[i] = own_misfit(segments, i)
        segments.cost[i], segments.cost[gone] = segments.cost[gone], JOINS_NEVER_CHI2
        segments.after[i] = segments.after[gone]
        segments.before[segments.after[i]] = i


def renew_cost(segments: Segments, i: int) -> None:
    """Update the cost of merging piece i with the next one, if these may be merged."""
    if segments.cost[i] < JOINS_NEVER_CHI2:
        j = segments.after[i]
        segments.cost[i] = joint_misfit(segments, i, j) - segments.own[i] - segments.own[j]


def compact(segments: Segments, count: int) -> int:
    """Move the moments of groups (merged pieces) to the front, write their first pieces to `bounds`.

    Return the number of groups.
    """
    groups = i = 0
    while i < count:
        segments.bounds[groups] = i
        for q in range(6):
            segments.moments[groups, q] = segments.moments[i, q]
        groups += 1
        i = segments.after[i]
    segments.bounds[groups] = count
    return groups


# ---- walls ----


def distance(returns: Returns, i: int, j: int) -> float:
    """Return the distance between returns i and j [m]."""
    dx, dy = returns.x[j] - returns.x[i], returns.y[j] - returns.y[i]
    return sqrt(dx * dx + dy * dy)


def head_of(segments: Segments, wall: int) -> int:
    """Return the index of the first return of a wall."""
    return segments.start[segments.bounds[wall]]


def tail_of(segments: Segments, wall: int) -> int:
    """Return the index of the last return of a wall."""
    return segments.stop[segments.bounds[wall + 1] - 1] - 1


def long_enough(returns: Returns, limits: Limits, segments: Segments) -> None:
    """Keep parts with enough points and length; link neighbours that may be one partly hidden wall."""
    parts, start, stop = 0, segments.start, segments.stop
    for g in range(segments.groups):
        begin, end = segments.first[segments.bounds[g]], segments.first[segments.bounds[g + 1]]
        if end - begin >= limits.min_points and distance(returns, begin, end - 1) >= limits.min_length:
            start[parts], stop[parts] = begin, end
            for q in range(6):
                segments.moments[parts, q] = segments.moments[g, q]
            parts += 1
    segments.parts = parts
    for i in range(parts - 1):
        between = start[i + 1] - stop[i]
        segments.linked[i] = near(returns, limits, start[i], stop[i] - 1, start[i + 1], stop[i + 1] - 1, between)


def near(
    returns: Returns, limits: Limits, head: int, tail: int, next_head: int, next_tail: int, between: int
) -> bool:
    """Return whether the gap between two parts is small enough for one line.

    The gap must be shorter than `limits.bridge` [m] and than both parts. If at most MAX_STRAY_BEAMS beams are
    `between` the parts, a gap shorter than `limits.max_gap` [m] is small enough too.
    """
    gap = distance(returns, tail, next_head)
    shorter = min(distance(returns, head, tail), distance(returns, next_head, next_tail))
    return gap <= min(shorter, limits.bridge) or (between <= MAX_STRAY_BEAMS and gap <= limits.max_gap)


def close_ring(returns: Returns, limits: Limits, segments: Segments) -> None:
    """Merge the first and the last wall of a full-circle scan if they are one wall."""
    last, bounds, m = segments.walls - 1, segments.bounds, segments.moments
    if last < 1:
        return
    head, tail = head_of(segments, last), tail_of(segments, last)
    next_head, next_tail = head_of(segments, 0), tail_of(segments, 0)
    between = next_head + returns.count - tail - 1
    if not near(returns, limits, head, tail, next_head, next_tail, between):
        return
    if joint_misfit(segments, last, 0) - own_misfit(segments, last) - own_misfit(segments, 0) >= limits.merge_chi2:
        return
    join(segments, last, 0)
    for i in range(last):
        for q in range(6):
            m[i, q] = m[i + 1, q]
    parts, moved = bounds[segments.walls], bounds[1]
    rotate(segments.start, parts, moved, segments.best)  # move the parts of the first wall after those of the last
    rotate(segments.stop, parts, moved, segments.best)
    for i in range(1, segments.walls):
        bounds[i - 1] = bounds[i] - moved
    bounds[last] = parts
    segments.walls = last


def rotate(values: Ints, count: int, by: int, room: Ints) -> None:
    """Rotate the first `count` values by `by` places to the left, in place; `room` (count,) is a work array."""
    for i in range(count):
        room[i] = values[i]
    for i in range(count):
        values[i] = room[i + by if i + by < count else i + by - count]


def perpendicular_fit(segments: Segments) -> None:
    """Fit a line to each wall by least squares of perpendicular distances: r [m] >= 0 and psi [rad].

    S. Pfister, S. Roumeliotis, J. Burdick: "Weighted line fitting algorithms for mobile robot map building and
    efficient data representation", ICRA 2003: psi from the scatter about the weighted mean, in closed form.
    """
    m = segments.moments
    for i in range(segments.walls):
        mx, my = m[i, 1] / m[i, 0], m[i, 2] / m[i, 0]
        a, b, c = m[i, 3] - m[i, 1] * mx, m[i, 4] - m[i, 1] * my, m[i, 5] - m[i, 2] * my
        angle = 0.5 * atan2(-2.0 * b, c - a)
        offset = mx * cos(angle) + my * sin(angle)
        segments.r[i], segments.psi[i] = abs(offset), angle + pi if offset < 0.0 else angle


def corner_limits(returns: Returns, limits: Limits, segments: Segments) -> None:
    """Compute limits [m] along each wall: returns near a corner are not used.

    Near a corner, the noise decides to which wall a beam is assigned. These beams bias the line, mostly its
    direction, since they are at its end. A corner is where the next wall begins within MAX_CORNER_BEAMS and
    `max_gap` [m]. On a closed circle, the first wall follows the last one.
    """
    walls, r, psi = segments.walls, segments.r, segments.psi
    for i in range(walls):
        segments.low[i], segments.high[i] = -FAR_M, FAR_M
    for i in range(walls if returns.closed else walls - 1):
        j = i + 1 if i + 1 < walls else 0
        tail, head = tail_of(segments, i), head_of(segments, j)
        apart = head - tail if head >= tail else head - tail + returns.count
        sine = sin(psi[j] - psi[i])
        if apart > MAX_CORNER_BEAMS or abs(sine) <= MIN_CORNER_SINE:
            continue
        if distance(returns, tail, head) > limits.max_gap:
            continue
        cosine = cos(psi[j] - psi[i])
        across = limits.sigma_angle * returns.ranges[tail]
        sigma = sqrt(across * across + limits.sigma_range * limits.sigma_range)
        margin = limits.corner_sigmas * sigma / abs(sine)
        corner, own = (r[j] - r[i] * cosine) / sine, (r[j] * cosine - r[i]) / sine  # positions on walls i and j
        limit_by_corner(returns, segments, i, tail, head_of(segments, i), corner, margin)
        limit_by_corner(returns, segments, j, head, tail_of(segments, j), own, margin)


def limit_by_corner(
    returns: Returns, segments: Segments, wall: int, end: int, other: int, corner: float, margin: float
) -> None:
    """Limit a wall to `margin` [m] before a corner at position `corner` [m]; at most MAX_CORNER_SHARE is left out.

    `end` is the index of the wall's last return at the corner, `other` that at the other end.
    """
    here, there = along(returns, end, segments.psi[wall]), along(returns, other, segments.psi[wall])
    share = MAX_CORNER_SHARE * abs(there - here)
    if here > there:
        segments.high[wall] = max(corner - margin, here - share)
    else:
        segments.low[wall] = min(corner + margin, here + share)


def along(returns: Returns, i: int, psi: float) -> float:
    """Return the coordinate [m] of a return along the tangent of a line with normal angle psi."""
    return -sin(psi) * returns.x[i] + cos(psi) * returns.y[i]
