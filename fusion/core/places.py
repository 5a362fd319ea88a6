"""Lines from another place: what a sensor elsewhere would see, and which places a scan may have been taken from.

From the laser to the base, or from one mount to another, exact:
r_b = r + l.n(psi_b), psi_b = psi + yaw for a laser at l = (x, y), Jacobian [[1, u], [0, 1]] with
u = l.t(psi_b), t the tangent (-sin, cos). Where r_b < 0 the base stands beyond the line: (r, psi), the ends, and
the sign of the r-psi covariance turn over.
"""

from math import cos, pi, sin, sqrt

from .fit import wrapped

KNOWN = 6  # columns of a map line: rho, beta, anchor x, y, and both ends


def into_base(rows, lines, x, y, yaw, out):
    """Write the lines `rows` (lines, 7: r, psi, R as 00, 01, 11, both ends) of a laser at x, y [m], yaw [rad]."""
    for i in range(lines):
        psi = rows[i, 1] + yaw
        if psi - psi != 0.0:  # Inf or NaN: there is no such line
            for j in range(7):
                out[i, j] = psi - psi
            continue
        c, s = cos(psi), sin(psi)
        r, u = rows[i, 0] + x * c + y * s, y * c - x * s
        cross, begin, end = rows[i, 3] + u * rows[i, 4], rows[i, 5] + u, rows[i, 6] + u
        out[i, 2], out[i, 4] = rows[i, 2] + u * (rows[i, 3] + cross), rows[i, 4]
        if r < 0.0:
            r, psi, cross, begin, end = -r, psi + pi, -cross, -begin, -end
        out[i, 0], out[i, 1], out[i, 3] = r, wrapped(psi), cross
        out[i, 5], out[i, 6] = min(begin, end), max(begin, end)


def moved(place, told, out):
    """Write what leads from the base by the mount `told` to that by the one at `place`: x, y [m], yaw [rad]."""
    turn = place[2] - told[2]
    c = s = turn - turn
    if c == 0.0:
        c, s = cos(turn), sin(turn)
    out[0], out[1], out[2] = place[0] - c * told[0] + s * told[1], place[1] - s * told[0] - c * told[1], turn


def shares_into_base(rows, lines, parts, x, y, yaw, shared, first, out):
    """Write unit errors (lines, 2, parts), flat, of r and psi of the lines as `into_base` moves these.

    They stand in `shared` from number `first` on.
    """
    for i in range(lines):
        psi = rows[i, 1] + yaw
        c = s = psi - psi
        if c == 0.0:
            c, s = cos(psi), sin(psi)
        r, u = rows[i, 0] + x * c + y * s, y * c - x * s
        of_r = 2 * parts * i
        of_psi = of_r + parts
        for k in range(parts):
            turn = shared[first + of_psi + k]
            moves = shared[first + of_r + k] + u * turn
            out[of_r + k], out[of_psi + k] = -moves if r < 0.0 else moves, turn


def behind(rows, lines, samples, walls, m, x, y, theta, both, near, margin, grazing, normal, out):
    """Write which share of every measured line lies behind map lines `walls` (m, 6), from a pose.

    `rows` (lines, 7) are r, psi, R as 00, 01, 11, and both ends. A point of a line - there are so many `samples` -
    lies behind where the sight line meets a wall more than `near` [m] before it, more than `margin` [m] from the
    wall's ends, and at more than `grazing` (sine of the angle), on the face that was seen or on `both`. `normal`
    (m, 2) is room.
    """
    normals(walls, m, normal)
    ahead_x, ahead_y = cos(theta), sin(theta)
    for i in range(lines):
        c, s, hidden = cos(rows[i, 1]), sin(rows[i, 1]), 0.0  # a float: C divides whole numbers without rest
        for k in range(samples):
            along = rows[i, 5] + (k + 0.5) / samples * (rows[i, 6] - rows[i, 5])
            px, py = rows[i, 0] * c - along * s, rows[i, 0] * s + along * c
            distance = sqrt(px * px + py * py)
            if distance > near:
                dx, dy = (ahead_x * px - ahead_y * py) / distance, (ahead_y * px + ahead_x * py) / distance
                if blocked(walls, m, normal, x, y, dx, dy, distance - near, both, margin, grazing):
                    hidden += 1.0
        out[i] = hidden / samples


def normals(walls, m, normal):
    """Write the directions (m, 2) in which map lines face."""
    for j in range(m):
        normal[j, 0], normal[j, 1] = cos(walls[j, 1]), sin(walls[j, 1])


def blocked(walls, m, normal, x, y, dx, dy, reach, both, margin, grazing):
    """Tell whether a wall stands within `reach` [m] of (x, y) in the direction (dx, dy)."""
    for j in range(m):
        c, s = normal[j, 0], normal[j, 1]
        facing = dx * c + dy * s
        if facing > grazing or (both and facing < -grazing):
            to_x, to_y = x - walls[j, 2], y - walls[j, 3]
            distance = (walls[j, 0] - (to_x * c + to_y * s)) / facing
            along = to_y * c - to_x * s + distance * (dy * c - dx * s)
            if 0.0 < distance < reach and walls[j, 4] + margin < along < walls[j, 5] - margin:
                return True
    return False


def explained(poses, h, rows, lines, walls, m, angle, offset, overlap, normal, out):
    """Write what map lines explain of a scan from every pose, out (h, 3).

    These are the share of the measured length, the share were the map lines longer than known, and how many lines.
    A line is the same as a map line within `angle` [rad] and `offset` [m]; it is explained where both overlap by
    more than the share `overlap` of its length. `rows` and `walls` are as in `behind`; `normal` (m, 2) is room.
    """
    normals(walls, m, normal)
    total = 0.0
    for i in range(lines):
        total += rows[i, 6] - rows[i, 5]
    for p in range(h):
        share, possible, count = 0.0, 0.0, 0
        for i in range(lines):
            length = rows[i, 6] - rows[i, 5]
            kind = likeness(poses, p, rows, i, walls, m, angle, offset, overlap * length, normal)
            if kind > 0:
                possible += length
            if kind > 1:
                share += length
                count += 1
        out[p, 0], out[p, 1], out[p, 2] = share / total, possible / total, count


def likeness(poses, p, rows, i, walls, m, angle, offset, least, normal):
    """Return 2 where a map line explains line i from pose p, 1 where it would if it were longer, else 0."""
    kind = 0
    for j in range(m):
        c, s = normal[j, 0], normal[j, 1]
        dx, dy = poses[p, 0] - walls[j, 2], poses[p, 1] - walls[j, 3]
        away = rows[i, 0] - (walls[j, 0] - dx * c - dy * s)
        if -offset < away < offset and abs(wrapped(rows[i, 1] + poses[p, 2] - walls[j, 1])) < angle:
            along = c * dy - s * dx
            kind = max(kind, 1)
            if min(rows[i, 6] + along, walls[j, 5]) - max(rows[i, 5] + along, walls[j, 4]) > least:
                return 2
    return kind


def hypotheses(rows, a, b, walls, m, parallel, normal, found, poses):
    """Add the poses from which lines a and b are two map lines at the same angle to `found`; return how many.

    The pair's angle may differ from theirs by less than that of the cosine `parallel`, and half of what it differs
    by is the pose's. `normal` (m, 2) is room, and poses (found + m m, 3) hold those that were found before.
    """
    normals(walls, m, normal)
    between = wrapped(rows[b, 1] - rows[a, 1])
    c, s = cos(between), sin(between)
    for j in range(m):
        for k in range(m):
            cosine = normal[j, 0] * normal[k, 0] + normal[j, 1] * normal[k, 1]
            sine = normal[j, 0] * normal[k, 1] - normal[j, 1] * normal[k, 0]
            if c * cosine + s * sine > parallel:
                slack = 0.5 * wrapped(walls[k, 1] - walls[j, 1] - between)
                p, q = against(walls, j, normal) - rows[a, 0], against(walls, k, normal) - rows[b, 0]
                poses[found, 0] = (p * normal[k, 1] - q * normal[j, 1]) / sine
                poses[found, 1] = (normal[j, 0] * q - normal[k, 0] * p) / sine
                poses[found, 2] = wrapped(walls[j, 1] - rows[a, 1] + slack)
                found += 1
    return found


def against(walls, j, normal):
    """Return the distance of a map line from the map's origin [m]."""
    return walls[j, 0] + (walls[j, 2] * normal[j, 0] + walls[j, 3] * normal[j, 1])
