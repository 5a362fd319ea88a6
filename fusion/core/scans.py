"""A scan against the line map in one go: mount, pairs, matches, verdicts, equation, and what it teaches the map.

All of it is put together of `places`, `pairs` and `match`. What is rare (a scan that hardly fits, a new line) is
only noticed: the loop in Python sees to it (fusion.linemap.at_once).
"""

from math import sqrt

from .doubles import neighbours, worthless
from .match import bends, equation, extend, is_new, judge, lacks, match, matched_share, refuse_alone
from .pairs import gather_mount, gather_walls, pairs
from .places import into_base, moved, shares_into_base
from .rests import only_repeats

# what became of a scan: fits, only repeats others at rest, has no lines, the loop must see to it
MATCHED, REPEATED, NOTHING, HARDLY, AT_REST = 1, 2, 0, -1, -2


def look(b, s, i, w, seat, rule, rest, progress, d):
    """Compare scan i with the map: write its pairs and their fate. Returns what became of it."""
    lines = s.first[i + 1] - s.first[i]
    if lines == 0:
        return NOTHING
    drives = progress.x * progress.x + progress.y * progress.y > rule.rolled * rule.rolled
    if not drives and -rule.turned < progress.theta < rule.turned:
        return REPEATED if only_repeats(s, i, rest) else AT_REST
    put_in_base(b, s, i, seat, d)
    find(b, w, seat, rule, lines, d)
    share = 1.0
    if rule.watched:
        share = matched_share(d.rows, lines, d.fate)
        if not share >= rule.least:
            return HARDLY
    if rule.grows:
        refuse_alone(d.pairs, lines, d.fate, rule.lone_d2, rule.lone_turn, rule.lone_offset)
    if share >= rule.well:
        progress.well = i
    progress.x = progress.y = progress.theta = 0.0
    rest.scans = 0
    return MATCHED


def put_in_base(b, s, i, seat, d):
    """Put the lines of scan i, and what they share, into the base by the mount as the belief has it."""
    begin, lines = s.first[i], s.first[i + 1] - s.first[i]
    for a in range(lines):
        for j in range(7):
            d.raw[a, j] = s.rows[begin + a, j]
    for j in range(3):
        d.place[j] = seat.told[j]
    for j in range(seat.free):
        d.place[seat.which[j]] = b.x[seat.at[j]]
    moved(d.place, seat.told, d.offset)
    for j in range(3):
        s.sights[i, j], s.sights[i, 3 + j] = b.x[j], d.offset[j]
    if seat.free > 0:
        into_base(d.raw, lines, d.offset[0], d.offset[1], d.offset[2], d.seated)
    else:
        for a in range(lines):
            for j in range(7):
                d.seated[a, j] = d.raw[a, j]
    if s.parts > 0:
        at = 2 * s.parts * begin
        shares_into_base(d.raw, lines, s.parts, d.offset[0], d.offset[1], d.offset[2], s.shared, at, d.shared)


def find(b, w, seat, rule, lines, d):
    """Write the pairs of the lines on the desk and their fate; return how many pairs there are."""
    for j in range(3):
        d.pose[j] = b.x[j]
    d.triangle[0], d.triangle[1], d.triangle[2] = b.P[0, 0], b.P[0, 1], b.P[0, 2]
    d.triangle[3], d.triangle[4], d.triangle[5] = b.P[1, 1], b.P[1, 2], b.P[2, 2]
    d.mount[0], d.mount[1] = d.place[0], d.place[1]
    for j in range(seat.free):
        d.mount[2 + j] = seat.which[j]
    gather_mount(b.P, seat.at, seat.free, d.mount)
    limit = max(rule.gate, rule.zone)
    walls = w.fixed
    if w.states:
        gather_walls(b.x, b.P, w.columns, w.anchors, w.places, seat.at, seat.free, d.wall_rows)
        walls = d.walls
    found = pairs(
        d.rows, lines, walls, w.width, w.low, w.high, w.places, w.states, d.pose, d.triangle, d.mount, seat.free,
        rule.max_turn, rule.max_offset, rule.sigmas, limit, d.seen, d.pairs,
    )  # fmt: skip
    match(
        d.pairs, found, d.rows, lines, rule.gate, rule.zone, rule.rival, rule.share, rule.longest, d.fate, d.order
    )
    return found


def state(b, s, i, w, seat, rule, d):
    """Judge the lines of scan i, and write the equation of those that match; return how many these are."""
    lines = s.first[i + 1] - s.first[i]
    accepted = judge(
        d.pairs, d.fate, lines, w.ids, rule.unmatched, rule.ambiguous, rule.new, s.first[i], s.verdict, s.landmark,
        s.told,
    )  # fmt: skip
    numbers, width = 2 * accepted, columns_of(accepted, seat, rule)
    for a in range(numbers):
        for j in range(width):
            d.H[a, j] = 0.0
        for j in range(numbers):
            d.R[a, j] = 0.0
    equation(
        d.pairs, d.fate, 0, lines, w.columns, rule.joint, d.mount, seat.free, seat.at, d.rows, d.shared,
        s.parts if rule.joint else 0, d.at, d.H, d.G, d.R, d.y,
    )  # fmt: skip
    return accepted


def columns_of(accepted, seat, rule):
    """Return how many columns the equation of so many matches has."""
    return 3 + seat.free + (2 * accepted if rule.joint else 0)


def teach(b, s, i, w, rule, rest, way, progress, d):
    """Teach the map what scan i showed, if it drives; tell whether the loop has to go on with it."""
    lines = s.first[i + 1] - s.first[i]
    for j in range(3):
        s.sights[i, 6 + j] = b.x[j]
    if rest.scans > 0 or not rule.teaches:
        return False
    progress.number += 1
    extend(d.pairs, d.fate, lines, w.low, w.high, w.hits, w.seen, progress.number)
    if not rule.joint:
        return False
    if rule.uneven > 0.0 or rule.uneven_turn > 0.0:
        bending = bends(
            b.P, d.pairs, d.fate, lines, w.columns, rule.uneven, rule.uneven_turn, rule.bend, rule.bend_turn,
            d.loose, d.missing,
        )  # fmt: skip
        loosen(b.P, d.loose, d.missing, bending)
    if rule.grows and new_lines(d.fate, lines) > 0:
        return True
    if rule.grows and progress.number % rule.tidy == 0 and untidy(b.x, w, rule, progress.number, d):
        return True
    if rule.floor > 0.0 or rule.floor_turn > 0.0:
        lacking = lacks(b.P, w.columns, w.places, rule.floor, rule.floor_turn, d.loose, d.missing)
        loosen(b.P, d.loose, d.missing, lacking)
    return way.follows and goes_far(b, w, way)


def new_lines(fate, lines):
    """Return how many lines of a scan the map lacks."""
    found = 0
    for i in range(lines):
        if is_new(fate, lines, i):
            found += 1
    return found


def untidy(x, w, rule, scan, d):
    """Tell whether a line proved worthless by now, or one that was seen lately may be one wall with another."""
    for j in range(w.places):
        d.wall_rows[j, 0], d.wall_rows[j, 1] = x[w.columns[j]], x[w.columns[j] + 1]
        d.wall_rows[j, 2], d.wall_rows[j, 3] = w.anchors[j, 0], w.anchors[j, 1]
    for j in range(w.places):
        if worthless(w.hits, w.born, j, scan, rule.hits, rule.trial):
            return True
        beside = 0
        if scan - w.seen[j] <= rule.trial:
            beside = neighbours(
                d.wall_rows, w.low, w.high, w.places, j, rule.double_turn, rule.double_offset, rule.double_apart,
                d.loose,
            )  # fmt: skip
        if beside > 0:
            return True
    return False


def loosen(P, columns, variance, k):
    """Add variance (k,) to so many distinct states."""
    for j in range(k):
        P[columns[j], columns[j]] += variance[j]


def goes_far(b, w, way):
    """Follow the way to where the robot is now, and tell whether it is far enough for anything."""
    x, y = b.x[0], b.x[1]
    way.length += sqrt((x - way.x) * (x - way.x) + (y - way.y) * (y - way.y))
    way.x, way.y = x, y
    x, y = x - way.origin_x, y - way.origin_y
    return way.length >= way.ask_at or w.places > way.most or sqrt(x * x + y * y) > way.reach
