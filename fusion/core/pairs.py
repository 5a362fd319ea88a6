"""Which map lines may a measured line be? Candidate pairs with innovation and covariance (paper eq. 13, 17, 18).

The robot at p = (x, y), theta should see the map line (rho, beta) about the anchor a as (r, psi): psi = beta -
theta, r = rho - n.(p - a), n = (cos beta, sin beta); or as (-r, psi + pi), whichever is nearer. Derivatives are

    by the pose [[-cos beta, -sin beta, 0], [0, 0, -1]], by the line [[1, u], [0, 1]], u = dr/dbeta,
    by the laser's mount (x_m, y_m, yaw) [[-cos psi, -sin psi, x_m sin psi - y_m cos psi], [0, 0, -1]],

the last at the measured psi (linemap.laser_mount). Pose, line and mount are correlated where they are states.
"""

from math import cos, log, pi, sin, sqrt

from .fit import wrapped

WALL = 13  # columns of a map line: rho, beta, anchor x, y, its covariance as 00, 01, 11, and those of x, y, theta
# with rho and beta (xr, xb, yr, yb, tr, tb); behind them those of rho, then beta, with the mount's free states
PAIR = 19  # columns: line, wall, y (2), R and S as 00, 01, 11, d2, score, low, high, overlap, cos, sin, u, psi
FACE_SIGMAS = 3.0  # by which the robot may stand behind the face that it sees
MAX_ANGLE = 1e9  # rad: beyond it no angle is one
NOWHERE = 1e300  # m


def gather_walls(x, P, columns, anchors, places, at, free, walls):
    """Write the lines that are states from `columns` (places,) on, about their anchors (places, 2), as `walls`.

    `at` (free,) are the columns of the mount's free states.
    """
    for j in range(places):
        rho = columns[j]
        beta = rho + 1
        walls[j, 0], walls[j, 1], walls[j, 2], walls[j, 3] = x[rho], x[beta], anchors[j, 0], anchors[j, 1]
        walls[j, 4], walls[j, 5], walls[j, 6] = P[rho, rho], P[rho, beta], P[beta, beta]
        for i in range(3):
            walls[j, 7 + 2 * i], walls[j, 8 + 2 * i] = P[i, rho], P[i, beta]
        for i in range(free):
            walls[j, WALL + i], walls[j, WALL + free + i] = P[rho, at[i]], P[beta, at[i]]


def gather_mount(P, at, free, mount):
    """Write the covariances of x, y, theta with the mount's free states, and their own, as `pairs` wants them."""
    for i in range(free):
        for j in range(3):
            mount[2 + free + free * j + i] = P[j, at[i]]
        for j in range(free):
            mount[2 + 4 * free + free * i + j] = P[at[i], at[j]]


def predict(walls, width, places, pose, seen):
    """Write what the robot should see of the map lines, seen (places, 4): r, psi, and cos, sin of beta."""
    for j in range(places):
        w = width * j
        psi = walls[w + 1] - pose[2]
        if abs(psi) < MAX_ANGLE:
            c, s = cos(walls[w + 1]), sin(walls[w + 1])
            seen[4 * j] = walls[w] - (pose[0] - walls[w + 2]) * c - (pose[1] - walls[w + 3]) * s
            seen[4 * j + 1], seen[4 * j + 2], seen[4 * j + 3] = psi, c, s
        else:
            seen[4 * j] = NOWHERE


def pairs(
    rows, lines, walls, width, low, high, places, states, pose, P, mount, free, max_turn, max_offset, sigmas,
    limit, seen, out
):  # fmt: skip
    """Write the pairs on the right face whose squared distance is at most `limit`; return how many there are.

    `rows` (lines, 7) are measured: r, psi, R as 00, 01, 11, and both ends. low, high (places,) are the ends of the
    map lines `walls` (places, width). `states` says that they are part of the state; where they are not, their own
    covariance counts as noise. `pose` is x, y, theta, and P its covariance's triangle. `mount` is x_m, y_m, then
    of its `free` states which of x, y, yaw they are, the covariances of x, y, theta with them, and their own.
    Pairs farther apart than max_turn [rad] or max_offset [m], and so many sigmas of the pose, are not looked at;
    `seen` (places, 4) is room.
    """
    max_turn += sigmas * sqrt(max(P[5], 0.0))
    max_offset += sigmas * sqrt(max(P[0] + P[3], 0.0))
    predict(walls, width, places, pose, seen)
    found = 0
    for i in range(lines):
        r, psi = rows[7 * i], rows[7 * i + 1]
        for j in range(places if abs(psi) < MAX_ANGLE else 0):
            distance = seen[4 * j]
            if not (-max_offset < r - distance < max_offset or -max_offset < r + distance < max_offset):
                continue
            turn, side = wrapped(psi - seen[4 * j + 1]), 1.0
            if abs(turn) > 0.5 * pi:
                turn, side = turn - pi if turn > 0.0 else turn + pi, -1.0
            offset = side * r - distance
            if abs(turn) < max_turn and abs(offset) < max_offset:
                at = PAIR * found
                out[at], out[at + 1], out[at + 2], out[at + 3] = i, j, offset, turn
                spread(rows, i, walls, width, j, states, pose, P, mount, free, side, seen, out, at)
                if fits(distance, limit, out, at):
                    extent(rows, i, walls, width, j, pose, side, low, high, out, at)
                    found += 1
    return found


def spread(rows, i, walls, width, j, states, pose, P, mount, free, side, seen, out, at):
    """Write R and S = H P H' + R of a pair, cos, sin, u, and the measured psi as it is predicted: not wrapped."""
    w, c, s = width * j, seen[4 * j + 2], seen[4 * j + 3]
    u = (pose[0] - walls[w + 2]) * s - (pose[1] - walls[w + 3]) * c
    r00, r01, r11 = rows[7 * i + 2], side * rows[7 * i + 3], rows[7 * i + 4]
    m01, m11 = walls[w + 5], walls[w + 6]
    edge = m01 + u * m11
    l00 = walls[w + 4] + u * (m01 + edge)
    by_rho, by_beta = -c * walls[w + 7] - s * walls[w + 9], -c * walls[w + 8] - s * walls[w + 10]
    turn_rho, turn_beta = -walls[w + 11], -walls[w + 12]
    s00 = c * c * P[0] + 2.0 * c * s * P[1] + s * s * P[3] + l00 + 2.0 * (by_rho + u * by_beta)
    s01 = c * P[2] + s * P[4] + edge + by_beta + turn_rho + u * turn_beta
    s11 = P[5] + m11 + 2.0 * turn_beta
    out[at + 4], out[at + 5], out[at + 6] = r00, r01, r11
    if not states:
        out[at + 4], out[at + 5], out[at + 6] = r00 + l00, r01 + edge, r11 + m11
    out[at + 7], out[at + 8], out[at + 9] = s00 + r00, s01 + r01, s11 + r11
    out[at + 15], out[at + 16], out[at + 17] = c, s, u
    out[at + 18] = seen[4 * j + 1] + out[at + 3]
    if free > 0:
        seat(walls, w + WALL, mount, free, out, at)


def seat(walls, w, mount, free, out, at):
    """Add to S what an uncertain mount brings; walls[w:] are its covariances with the map line."""
    c, s, u = out[at + 15], out[at + 16], out[at + 17]
    c_psi, s_psi = cos(out[at + 18]), sin(out[at + 18])
    pose, own = 2 + free, 2 + 4 * free  # where the covariances with the pose and of the mount begin
    for a in range(free):
        r, turn = lever(mount, a, c_psi, s_psi), -1.0 if mount[2 + a] == 2.0 else 0.0
        shared_r = -c * mount[pose + a] - s * mount[pose + free + a] + walls[w + a] + u * walls[w + free + a]
        shared_turn = -mount[pose + 2 * free + a] + walls[w + free + a]
        out[at + 7] += 2.0 * shared_r * r
        out[at + 8] += shared_r * turn + shared_turn * r
        out[at + 9] += 2.0 * shared_turn * turn
        for b in range(free):
            variance = mount[own + a * free + b]
            out[at + 7] += r * variance * lever(mount, b, c_psi, s_psi)
            if mount[2 + b] == 2.0:
                out[at + 8] -= r * variance
                out[at + 9] -= turn * variance


def lever(mount, a, c, s):
    """Return by how much the r of a line depends on free state `a` of the mount; c, s of the line's psi."""
    if mount[2 + a] == 2.0:
        return mount[0] * s - mount[1] * c
    return -c if mount[2 + a] == 0.0 else -s


def fits(distance, limit, out, at):
    """Write squared distance (eq. 13) and score of a pair; tell whether the right face is seen, near enough."""
    offset, turn, s00, s01, s11 = out[at + 2], out[at + 3], out[at + 7], out[at + 8], out[at + 9]
    det = s00 * s11 - s01 * s01
    if not (det > 0.0 and s00 > 0.0):  # no float holds it
        return False
    d2 = (s11 * offset * offset - 2.0 * s01 * offset * turn + s00 * turn * turn) / det
    out[at + 10], out[at + 11] = d2, d2 + log(det)
    return d2 <= limit and distance > -FACE_SIGMAS * sqrt(s00)


def extent(rows, i, walls, width, j, pose, side, low, high, out, at):
    """Write where the measured segment lies along the map line [m], and by how much both overlap."""
    w, begin, end = width * j, rows[7 * i + 5], rows[7 * i + 6]
    along = (pose[1] - walls[w + 3]) * out[at + 15] - (pose[0] - walls[w + 2]) * out[at + 16]
    out[at + 12], out[at + 13] = along + begin, along + end
    if side < 0.0:
        out[at + 12], out[at + 13] = along - end, along - begin
    out[at + 14] = min(out[at + 13], high[j]) - max(out[at + 12], low[j])
