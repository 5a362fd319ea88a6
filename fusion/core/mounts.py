"""Lines as a sensor at another place sees them: from the laser to the base, or from one mount to another.

Exact: r_b = r + l.n(psi_b), psi_b = psi + yaw for a laser at l = (x, y), Jacobian [[1, u], [0, 1]] with
u = l.t(psi_b), t the tangent (-sin, cos). Where r_b < 0 the base stands beyond the line: (r, psi), the ends, and
the sign of the r-psi covariance turn over.
"""

from math import cos, pi, sin

from .fit import wrapped


def into_base(rows, lines, x, y, yaw, out):
    """Write the lines `rows` (lines, 7: r, psi, R as 00, 01, 11, both ends) of a laser at x, y [m], yaw [rad]."""
    for i in range(lines):
        psi = rows[i, 1] + yaw
        if psi - psi != 0.0:  # Inf or NaN: there is no such line
            for j in range(7):
                out[i, j] = psi - psi
            continue
        c, s = cos(psi), sin(psi)
        r, u, side = rows[i, 0] + x * c + y * s, y * c - x * s, 1.0
        if r < 0.0:
            side, psi = -1.0, psi + pi
        cross = rows[i, 3] + u * rows[i, 4]
        begin, end = (rows[i, 5] + u) * side, (rows[i, 6] + u) * side
        out[i, 0], out[i, 1] = r * side, wrapped(psi)
        out[i, 2], out[i, 3], out[i, 4] = rows[i, 2] + u * (rows[i, 3] + cross), cross * side, rows[i, 4]
        out[i, 5], out[i, 6] = min(begin, end), max(begin, end)
