"""Straight walls of laser scans, one scan after another: gaps, split, merge, corners, fit.

Arrays are flat, matrices row by row. Nothing crosses from one scan to another. What counts as a wall:
`lines.settings.LineSettings`.
"""

from math import cos, sin, tan

from .curves import find_curves
from .fit import (
    determinant,
    foot_of,
    is_bent,
    is_vague,
    keep_clear,
    leave_strays,
    misfit_of,
    normal_equations,
    parabola,
    residuals,
    rows_of,
    singular,
    step_psi,
    step_r,
    wrapped,
)
from .pieces import cut_at_gaps, gather, merge, moments, ring_start, split, tolerances
from .walls import close_ring, corner_limits, link_parts, long_enough, perpendicular_fit

MAX_TURN = 1e3  # rad: beyond it the steps went astray
MIN_RATIO = 1e-100  # 1/m, of sigma_angle over sigma_range


def extract(
    floats, wholes, scans, beams, ranges, cos_, sin_, x0, y0, stride, growth, ring, low, high, settings, share,
    slips, counts, hidden, out, loads
):  # fmt: skip
    """Find the lines of `scans` scans of `beams` beams each, and return how many there are.

    `floats` and `wholes` make room for so many numbers. Beam j of scan i starts at (x0, y0) [m] and points along
    (cos_, sin_), row i * stride + j; growth[i] is how far apart neighbours on a wall may be [m per m of range];
    ring[i] says that the scan goes all the way round. Ranges in [low, high) [m] are returns. `settings` are the
    numbers of LineSettings in their order. Written are counts (scans), how many walls were left out as pieces of a
    curve, hidden (scans), out (lines, 11) - r, psi, their covariance over sigma_range^2 (rr, rp, pp), both ends
    along the tangent [m], points, chi2 per degree of freedom, first and last beam - and, with `slips` > 0 pieces
    of the sweep and each beam's `share` (slips, beams) of them, loads (lines, 2, 2, slips): what r and psi owe to
    a turn and a move of 1 in each piece.
    """
    sigma_range, sigma_angle, min_points, min_length = settings[0], settings[1], settings[2], settings[3]
    max_gap, bridge, split_sigmas, split_floor = max(settings[4], 1e-100), settings[6], settings[7], settings[8]
    flatness, merge_chi2, grazing, corner_sigmas = settings[9], settings[10], tan(settings[11]), settings[13]
    d, ux, uy, ox, oy = floats(beams), floats(beams), floats(beams), floats(beams), floats(beams)
    x, y, tolerance = floats(beams), floats(beams), floats(beams)
    e, q, w, sums = floats(beams), floats(beams), floats(beams), floats(9)
    m, own, cost = floats(6 * beams + 6), floats(beams + 1), floats(beams + 1)
    r, psi, near_end, far_end = floats(beams), floats(beams), floats(beams), floats(beams)
    beam, row, run_first, first = wholes(beams), wholes(beams), wholes(beams + 1), wholes(beams + 1)
    todo, linked, after, before = wholes(2 * beams + 4), wholes(beams + 1), wholes(beams + 1), wholes(beams + 1)
    best, groups, start, stop = wholes(beams + 1), wholes(beams + 1), wholes(beams), wholes(beams)
    bounds, curved, joint, gains = wholes(beams + 1), wholes(beams), floats(beams), floats(beams)
    ratio, variance = max(sigma_angle / sigma_range, MIN_RATIO), sigma_range * sigma_range
    lines = 0
    for scan in range(scans):
        counts[scan] = hidden[scan] = 0
        column = scan * stride
        k = gather(ranges, cos_, sin_, x0, y0, scan, column, beams, 0, low, high, d, ux, uy, ox, oy, x, y, beam)
        closed = False
        if ring[scan] != 0 and k > 0:
            begin = ring_start(d, x, y, k, growth[scan], max_gap)
            closed = begin < 0
            begin = beam[-1 - begin] if closed else beam[begin]
            k = gather(
                ranges, cos_, sin_, x0, y0, scan, column, beams, begin, low, high, d, ux, uy, ox, oy, x, y, beam
            )
        tolerances(d, k, sigma_range, sigma_angle, split_sigmas, split_floor, tolerance)
        runs = cut_at_gaps(d, x, y, k, growth[scan], max_gap, run_first)
        pieces = split(x, y, tolerance, runs, run_first, todo, first, linked)
        moments(d, ux, uy, x, y, first, pieces, sigma_range, sigma_angle, flatness, m)
        found = merge(m, pieces, linked, merge_chi2, own, cost, after, before, best, groups)
        parts = long_enough(x, y, first, groups, found, min_points, min_length, m, start, stop)
        link_parts(x, y, start, stop, parts, bridge, max_gap, linked)
        walls = merge(m, parts, linked, merge_chi2, own, cost, after, before, best, bounds)
        if closed:
            walls = close_ring(x, y, k, start, stop, bounds, walls, m, bridge, max_gap, merge_chi2, row)
        perpendicular_fit(m, walls, r, psi)
        corner_limits(
            d, x, y, k, start, stop, bounds, walls, closed, r, psi, sigma_range, sigma_angle, corner_sigmas,
            max_gap, near_end, far_end
        )  # fmt: skip
        find_curves(
            d, ux, uy, ox, oy, x, y, start, stop, bounds, walls, closed, r, psi, ratio, variance, row, e, q, w,
            sums, joint, gains, curved
        )  # fmt: skip
        for wall in range(walls):
            if curved[wall]:
                hidden[scan] += 1
                continue
            n = rows_of(start, stop, bounds[wall], bounds[wall + 1], row)
            flat = r[wall] * grazing
            begin_at, end_at = max(near_end[wall], -flat), min(far_end[wall], flat)
            n = fit(
                d,
                ux,
                uy,
                ox,
                oy,
                row,
                n,
                begin_at,
                end_at,
                e,
                q,
                w,
                sums,
                r[wall],
                psi[wall],
                settings,
                out,
                lines,
            )
            if n > 0:
                out[11 * lines + 9], out[11 * lines + 10] = beam[row[0]], beam[row[n - 1]]
                loadings(
                    row, n, beam, beams, q, w, sums, out[11 * lines + 1], settings, share, slips, loads, lines
                )
                lines += 1
                counts[scan] += 1
    return lines


def fit(d, ux, uy, ox, oy, row, n, begin, end, e, q, w, sums, r, psi, settings, out, line):
    """Fit a line to the returns `row` (n), from (r, psi); return how many are in it, 0 where it is no wall.

    Two Gauss-Newton steps. What lies outside the feet [begin, end] [m] leaves before the first, strays before the
    second.
    """
    ratio, least = max(settings[1] / settings[0], MIN_RATIO), max(settings[2], 3.0)
    stray = settings[12] * settings[12] * settings[0] * settings[0]
    residuals(d, ux, uy, ox, oy, row, n, r, psi, ratio, e, q, w)
    n = keep_clear(row, n, e, q, w, begin, end)
    normal_equations(n, e, q, w, sums)
    if n < least or singular(sums):
        return 0
    r, psi = r + step_r(sums), psi + step_psi(sums)
    if not abs(psi) < MAX_TURN:
        return 0
    residuals(d, ux, uy, ox, oy, row, n, r, psi, ratio, e, q, w)
    n = leave_strays(row, n, e, q, w, stray, least)
    normal_equations(n, e, q, w, sums)
    parabola(n, e, q, w, sums)
    return n if finish(ux, uy, ox, oy, row, n, sums, r, psi, settings, out, line) else 0


def finish(ux, uy, ox, oy, row, n, sums, r, psi, settings, out, line):
    """Take the last step, and write the line if it is a straight wall, known well enough to be of use."""
    max_sigma_psi, max_swing, max_chi2 = settings[14], settings[15], settings[16]
    max_bow, max_bend, variance = settings[17], settings[18], settings[0] * settings[0]
    if singular(sums):
        return False
    chi2 = misfit_of(sums) / variance / max(n - 2, 1)
    det = determinant(sums)
    r, psi = r + step_r(sums), psi + step_psi(sums)
    if not (r > 0.0 and abs(psi) < MAX_TURN and chi2 <= max_chi2):
        return False
    begin, end = foot_of(ux, uy, ox, oy, row[0], r, psi), foot_of(ux, uy, ox, oy, row[n - 1], r, psi)
    if is_bent(sums, end - begin, variance, max_bend, max_bow):
        return False
    if is_vague(sums, r, variance, max_sigma_psi, max_swing):
        return False
    at = 11 * line
    out[at], out[at + 1] = r, wrapped(psi)
    out[at + 2], out[at + 3], out[at + 4] = sums[2] / det, sums[1] / det, sums[0] / det
    out[at + 5], out[at + 6], out[at + 7], out[at + 8] = min(begin, end), max(begin, end), n, chi2
    return True


def loadings(row, n, beam, beams, q, w, sums, psi, motion, share, slips, loads, line):
    """Write what (r, psi) of a line owe to a turn [rad] and a move [m] of 1 in each piece of the sweep.

    A beam's end moves across its line by lever - q per radian and by n.ahead per metre; the fit passes that on.
    `motion`: behind the settings stand the lever [m] from the base to the laser and the base's forward direction,
    both in the laser's axes.
    """
    nx, ny, lever_x, lever_y = cos(psi), sin(psi), motion[19], motion[20]
    across, along = ny * lever_x - nx * lever_y, nx * motion[21] + ny * motion[22]
    a, b, c, det = sums[0], sums[1], sums[2], determinant(sums)
    for piece in range(slips):
        s = sq = sqq = 0.0
        for k in range(n):
            part = share[piece * beams + beam[row[k]]]
            if part != 0.0:
                part *= w[k]
                s += part
                sq += part * q[k]
                sqq += part * q[k] * q[k]
        turned, turned_q = across * s - sq, across * sq - sqq
        moved, moved_q = along * s, along * sq
        at = 4 * slips * line + piece
        loads[at] = (c * turned - b * turned_q) / det
        loads[at + slips] = (c * moved - b * moved_q) / det
        loads[at + 2 * slips] = (b * turned - a * turned_q) / det
        loads[at + 3 * slips] = (b * moved - a * moved_q) / det
