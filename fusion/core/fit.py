"""Weighted fit of one line to the beams that see it: (r, psi), covariance, and whether it is a straight wall.

A line is n.P = r with n = (cos psi, sin psi), r >= 0. A beam starts at o (the laser's own place when the beam
was fired: zero without deskewing), points along u and should return the range p = (r - n.o) / n.u. Its noise acts
along and across the beam, so what is minimised is the sum of (d - p)^2 / v, v = s_d^2 + (s_phi p tan(alpha))^2,
alpha the angle of incidence. Fits of perpendicular distances are a good start, but biased off-centre.
Sums of squares are of residuals over their sigma, times s_d^2 [m^2].
"""

from math import cos, floor, pi, sin, sqrt

HUGE = 1e150  # m: where a beam that runs along the wall would meet it


def rows_of(start, stop, begin, end, row):
    """Write the returns of the parts begin:end, one after another, and how many there are."""
    n = 0
    for part in range(begin, end):
        for i in range(start[part], stop[part]):
            row[n] = i
            n += 1
    return n


def residuals(d, ux, uy, ox, oy, row, n, r, psi, ratio, e, q, w):
    """Write the distances e [m] of n returns from the line (r, psi), their feet q [m], and weights w.

    Times n.u, the range residual d - p is the distance e = (d - p) n.u, and its derivative by (r, psi) is (-1, q),
    q the foot of the *predicted* point: taking the measured one instead is the bias of perpendicular fits.
    w = s_d^2 / var(e), with ratio = s_phi / s_d > 0 [1/m].
    """
    nx, ny = cos(psi), sin(psi)
    for k in range(n):
        i = row[k]
        along, across = nx * ux[i] + ny * uy[i], nx * uy[i] - ny * ux[i]
        reach = r - (nx * ox[i] + ny * oy[i])
        e[k] = d[i] * along - reach
        square = along * along
        foot = reach / along * across if square > 0.0 else HUGE  # also what 1 rad moves the end off the wall
        turn = foot * ratio
        w[k] = 1.0 / (turn * turn + square)
        q[k] = foot + (nx * oy[i] - ny * ox[i])


def keep_clear(row, n, e, q, w, low, high):
    """Keep the returns with feet in [low, high], and return how many they are.

    What stays is decided by the predicted point, never by the measured one: choosing by the noise would bias it.
    """
    kept = 0
    for k in range(n):
        if low <= q[k] <= high:
            row[kept], e[kept], q[kept], w[kept] = row[k], e[k], q[k], w[k]
            kept += 1
    return kept


def leave_strays(row, n, e, q, w, limit, least):
    """Leave out returns that are not of the wall, a pole or a person's leg before it; return how many stay.

    Stray is what has e^2 w > `limit` [m^2]. A few such beams are too few to be cut off as a piece of their own,
    and pull the whole line. A wall that would have fewer than `least` without them keeps them; its misfit shows.
    """
    strays = 0
    for k in range(n):
        if e[k] * e[k] * w[k] > limit:
            strays += 1
    if strays == 0 or n - strays < least:
        return n
    kept = 0
    for k in range(n):
        if not e[k] * e[k] * w[k] > limit:
            row[kept], e[kept], q[kept], w[kept] = row[k], e[k], q[k], w[k]
            kept += 1
    return kept


def normal_equations(n, e, q, w, sums):
    """Write the sums of w, wq, wqq, we, wqe, wee."""
    a = b = c = f = g = ee = 0.0
    for k in range(n):
        wq, we = w[k] * q[k], w[k] * e[k]
        a += w[k]
        b += wq
        c += wq * q[k]
        f += we
        g += wq * e[k]
        ee += we * e[k]
    sums[0], sums[1], sums[2], sums[3], sums[4], sums[5] = a, b, c, f, g, ee


def parabola(n, e, q, w, sums):
    """Write the sums that a parabola adds, wqqq, wqqqq, wqqe, behind those of the normal equations."""
    cubic = quartic = qqe = 0.0
    for k in range(n):
        wqq = w[k] * q[k] * q[k]
        cubic += wqq * q[k]
        quartic += wqq * q[k] * q[k]
        qqe += wqq * e[k]
    sums[6], sums[7], sums[8] = cubic, quartic, qqe


def determinant(sums):
    """Return the determinant of the normal equations."""
    return sums[0] * sums[2] - sums[1] * sums[1]


def singular(sums):
    """Tell whether the beams give no direction: they all meet the line in one point."""
    return not determinant(sums) > 1e-12 * sums[0] * sums[2]


def misfit_of(sums):
    """Return the sum of squares [m^2] that is left after the step."""
    return max(sums[5] - step_r(sums) * sums[3] + step_psi(sums) * sums[4], 0.0)


def step_r(sums):
    """Return how far a Gauss-Newton step moves r [m]."""
    return (sums[2] * sums[3] - sums[1] * sums[4]) / determinant(sums)


def step_psi(sums):
    """Return how far a Gauss-Newton step turns psi [rad]."""
    return (sums[1] * sums[3] - sums[0] * sums[4]) / determinant(sums)


def foot_of(ux, uy, ox, oy, i, r, psi):
    """Return the foot [m] of return i on the line (r, psi): where the beam meets it."""
    nx, ny = cos(psi), sin(psi)
    along, across = nx * ux[i] + ny * uy[i], nx * uy[i] - ny * ux[i]
    reach = r - (nx * ox[i] + ny * oy[i])
    return (reach / along * across if along * along > 0.0 else HUGE) + (nx * oy[i] - ny * ox[i])


def stiffness(sums):
    """Return the weight of q^2 less its part along 1 and q, which the line already has."""
    a, b, c, cubic = sums[0], sums[1], sums[2], sums[6]
    return sums[7] - (c * (c * c - b * cubic) + cubic * (a * cubic - b * c)) / determinant(sums)


def curvature(sums):
    """Return the coefficient [1/m] of the parabola that is left beside the line; 0 where there is none to tell."""
    norm = stiffness(sums)
    return (sums[8] - step_r(sums) * sums[2] + step_psi(sums) * sums[6]) / norm if norm > 0.0 else 0.0


def bend(sums):
    """Return by how much that parabola would lower the sum of squares [m^2]."""
    coefficient = curvature(sums)
    return stiffness(sums) * coefficient * coefficient


def is_bent(sums, extent, variance, max_bend, max_bow):
    """Tell whether a parabola explains so much of the misfit, and is so high, that this is no straight wall.

    `max_bow` is a share of the chord `extent` [m]: k q^2 is k extent^2 / 4 high over it.
    """
    bow = abs(curvature(sums) * extent) / 4.0  # height / chord
    return bend(sums) > max_bend * variance and bow > max_bow


def is_vague(sums, r, variance, max_sigma_psi, max_swing):
    """Tell whether the line is too short for its noise: what is linear no longer is.

    Turning about its middle by sigma(psi) moves the line's foot by `swing` [m]; of r, where psi is known, the
    variance is s_d^2 / sum of w.
    """
    spread = sums[0] / determinant(sums) * variance  # of psi [rad^2]
    swing = 0.5 * r * spread
    return spread > max_sigma_psi * max_sigma_psi or swing > max_swing * sqrt(variance / sums[0])


def wrapped(angle):
    """Return the angle in [-pi, pi)."""
    return (angle + pi) - 2.0 * pi * floor((angle + pi) / (2.0 * pi)) - pi


def folded(angle):
    """Return the angle in [-pi, pi), NaN where it is none."""
    if angle - angle == 0.0:
        return wrapped(angle)
    return angle - angle
