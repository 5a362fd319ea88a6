"""Line transformations between frames, and scoring of poses by the lines that match.

A line (r, psi) in the frame of a laser at l = (x, y), yaw is r_b = r + l.n(psi_b), psi_b = psi + yaw in the base
frame. The Jacobian is [[1, u], [0, 1]] with u = l.t(psi_b) and the tangent t = (-sin, cos). If r_b < 0, the base
is beyond the line: then the line becomes (-r_b, psi_b + pi), and its ends and the r-psi covariance change sign.
"""

from __future__ import annotations

from locfuse.fusion.data import Array

try:
    import cython
except ImportError:  # Cython is only needed to compile
    from . import uncompiled as cython
if not cython.compiled:
    from math import pi

    from .uncompiled import cos, floor, sin, sqrt

SAME_ANGLE_RAD, SAME_OFFSET_M = 5.0 * (pi / 180.0), 0.25  # largest differences of a seen wall and its map wall
MIN_OVERLAP_SHARE = 0.6  # least share of a seen wall's length that overlaps its map wall
SIGHT_LINES = 5  # number of sight lines to points of a seen wall
MIN_BEHIND_M = 0.3  # least distance of a hidden point behind a map wall
MIN_FROM_END_M = 0.2  # a map wall does not count as blocking nearer to its ends
MIN_GRAZING_SINE = 0.1  # sine of the least angle between a sight line and a map wall that blocks it


if not cython.compiled:
    # columns of a line: r [m], psi [rad], covariance (columns 2 to 4), both ends along its tangent [m]
    R, PSI, BEGIN, END = 0, 1, 5, 6
    # columns of a map line: rho [m], beta [rad], anchor x, y [m], both ends [m], normal vector
    RHO, BETA, X, Y, LOW, HIGH, NX, NY = range(8)
LINE_COLUMNS = 8  # of a map line; `face` writes the last two


def wrapped(angle: float) -> float:
    """Return an angle wrapped to [-pi, pi); NaN stays NaN."""
    return (angle + pi) - 2.0 * pi * floor((angle + pi) / (2.0 * pi)) - pi


# ---- from one mount to another ----


def into_base(rows: Array, lines: int, x: float, y: float, yaw: float, out: Array) -> None:
    """Convert lines `rows` (lines, 7) from the frame of a laser at x, y [m], yaw [rad] to the base frame.

    A row has r, psi, R00, R01, R11, and both ends.
    """
    for i in range(lines):
        psi = rows[i, PSI] + yaw
        if psi - psi != 0.0:  # psi is Inf or NaN
            for j in range(7):
                out[i, j] = psi - psi
            continue
        c, s = cos(psi), sin(psi)
        r, u = rows[i, R] + x * c + y * s, y * c - x * s
        cross, begin, end = rows[i, 3] + u * rows[i, 4], rows[i, BEGIN] + u, rows[i, END] + u
        out[i, 2], out[i, 4] = rows[i, 2] + u * (rows[i, 3] + cross), rows[i, 4]
        if r < 0.0:
            r, psi, cross, begin, end = -r, psi + pi, -cross, -begin, -end
        out[i, R], out[i, PSI], out[i, 3] = r, wrapped(psi), cross
        out[i, BEGIN], out[i, END] = min(begin, end), max(begin, end)


def moved(place: Array, configured: Array, out: Array) -> None:
    """Compute the motion x, y [m], yaw [rad] in the base frame that takes mount `configured` to mount `place`."""
    turn = place[2] - configured[2]
    c, s = cos(turn), sin(turn)
    out[0], out[1], out[2] = (
        place[0] - c * configured[0] + s * configured[1],
        place[1] - s * configured[0] - c * configured[1],
        turn,
    )


def shares_into_base(rows: Array, lines: int, x: float, y: float, yaw: float, shared: Array, out: Array) -> None:
    """Convert the errors of (r, psi) that all lines of a scan share, (lines, 2, parts), to the base frame."""
    for i in range(lines):
        psi = rows[i, PSI] + yaw
        c, s = cos(psi), sin(psi)
        r, u = rows[i, R] + x * c + y * s, y * c - x * s
        for k in range(shared.shape[2]):
            turn = shared[i, 1, k]
            move = shared[i, 0, k] + u * turn
            out[i, 0, k], out[i, 1, k] = -move if r < 0.0 else move, turn


# ---- scores of poses from which a scan may have been taken ----


def face(walls: Array) -> None:
    """Write the normal vectors of map lines to their last two columns."""
    for j in range(walls.shape[0]):
        walls[j, NX], walls[j, NY] = cos(walls[j, BETA]), sin(walls[j, BETA])


def behind(rows: Array, walls: Array, x: float, y: float, theta: float, both: bool, out: Array) -> None:
    """Compute the share of each line (k, 7) that is hidden behind map lines `walls` (m, 8), seen from a pose.

    A point of a line is hidden if its sight line meets a wall clearly before the point, away from the wall's ends
    and not at grazing incidence. A wall hides points on the seen side only, or with `both` on both sides.
    """
    face(walls)
    ahead_x, ahead_y = cos(theta), sin(theta)
    for i in range(rows.shape[0]):
        c, s, hidden = cos(rows[i, PSI]), sin(rows[i, PSI]), 0.0  # float, since C rounds the ratio of integers
        for k in range(SIGHT_LINES):
            along = rows[i, BEGIN] + (k + 0.5) / SIGHT_LINES * (rows[i, END] - rows[i, BEGIN])
            px, py = rows[i, R] * c - along * s, rows[i, R] * s + along * c
            distance = sqrt(px * px + py * py)
            if distance > MIN_BEHIND_M:
                dx, dy = (ahead_x * px - ahead_y * py) / distance, (ahead_y * px + ahead_x * py) / distance
                if blocked(walls, x, y, dx, dy, distance - MIN_BEHIND_M, both):
                    hidden += 1.0
        out[i] = hidden / SIGHT_LINES


def blocked(walls: Array, x: float, y: float, dx: float, dy: float, reach: float, both: bool) -> bool:
    """Return whether a wall blocks the sight from (x, y) in the direction (dx, dy) within `reach` [m]."""
    for j in range(walls.shape[0]):
        c, s = walls[j, NX], walls[j, NY]
        facing = dx * c + dy * s
        if facing > MIN_GRAZING_SINE or (both and facing < -MIN_GRAZING_SINE):
            to_x, to_y = x - walls[j, X], y - walls[j, Y]
            distance = (walls[j, RHO] - (to_x * c + to_y * s)) / facing
            along = to_y * c - to_x * s + distance * (dy * c - dx * s)
            if 0.0 < distance < reach and walls[j, LOW] + MIN_FROM_END_M < along < walls[j, HIGH] - MIN_FROM_END_M:
                return True
    return False


def explained(rows: Array, walls: Array, poses: Array, slack: float, out: Array) -> None:
    """Write to `out` (h, 3) how well a scan's lines (k, 7) match map lines (m, 8), for each of the poses (h, 3).

    Columns of `out`: matched share of the scan's line length, the same if map lines were longer than known, number
    of matched lines. A line matches a map line if both overlap and differ by less than `slack` times the limits.
    """
    face(walls)
    total = 0.0
    for i in range(rows.shape[0]):
        total += rows[i, END] - rows[i, BEGIN]
    for p in range(poses.shape[0]):
        share, possible, count = 0.0, 0.0, 0
        for i in range(rows.shape[0]):
            length = rows[i, END] - rows[i, BEGIN]
            kind = likeness(rows, walls, i, poses[p, 0], poses[p, 1], poses[p, 2], slack)
            if kind > 0:
                possible += length
            if kind > 1:
                share += length
                count += 1
        out[p, 0], out[p, 1], out[p, 2] = share / total, possible / total, count


def likeness(rows: Array, walls: Array, i: int, x: float, y: float, theta: float, slack: float) -> int:
    """Return 2 if line i of a scan matches a map line, 1 if it would match a longer map line, else 0."""
    kind, angle, offset = 0, slack * SAME_ANGLE_RAD, slack * SAME_OFFSET_M
    least = MIN_OVERLAP_SHARE * (rows[i, END] - rows[i, BEGIN])
    for j in range(walls.shape[0]):
        c, s = walls[j, NX], walls[j, NY]
        dx, dy = x - walls[j, X], y - walls[j, Y]
        away = rows[i, R] - (walls[j, RHO] - dx * c - dy * s)
        if -offset < away < offset and abs(wrapped(rows[i, PSI] + theta - walls[j, BETA])) < angle:
            along, kind = c * dy - s * dx, 1
            if min(rows[i, END] + along, walls[j, HIGH]) - max(rows[i, BEGIN] + along, walls[j, LOW]) > least:
                return 2
    return kind


def hypotheses(rows: Array, a: int, b: int, walls: Array, found: int, poses: Array) -> int:
    """Append poses that align lines a and b with two map lines at the same angle; return the number of poses.

    The angle between the lines may differ from that between the map lines by SAME_ANGLE_RAD; half of this
    difference is added to the heading. `poses` has room for m^2 poses of m map lines after the first `found` ones.
    """
    face(walls)
    between = wrapped(rows[b, PSI] - rows[a, PSI])
    c, s, parallel = cos(between), sin(between), cos(SAME_ANGLE_RAD)
    for j in range(walls.shape[0]):
        for k in range(walls.shape[0]):
            cosine = walls[j, NX] * walls[k, NX] + walls[j, NY] * walls[k, NY]
            sine = walls[j, NX] * walls[k, NY] - walls[j, NY] * walls[k, NX]
            if c * cosine + s * sine > parallel:
                slack = 0.5 * wrapped(walls[k, BETA] - walls[j, BETA] - between)
                p, q = from_origin(walls, j) - rows[a, R], from_origin(walls, k) - rows[b, R]
                poses[found, 0] = (p * walls[k, NY] - q * walls[j, NY]) / sine
                poses[found, 1] = (walls[j, NX] * q - walls[k, NX] * p) / sine
                poses[found, 2] = wrapped(walls[j, BETA] - rows[a, PSI] + slack)
                found += 1
    return found


def from_origin(walls: Array, j: int) -> float:
    """Return the distance of a map line from the origin [m]."""
    return walls[j, RHO] + (walls[j, X] * walls[j, NX] + walls[j, Y] * walls[j, NY])
