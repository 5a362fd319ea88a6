"""Weighted line fit to the returns of a wall: (r, psi), covariance, and test for straightness.

A line is n.P = r with n = (cos psi, sin psi), r >= 0. A beam starts at o, the position of the laser at its time
(zero without deskewing), and has the direction u. Its predicted range is p = (r - n.o) / n.u. With the measured
range d, the sum of (d - p)^2 / v is minimised. v = s_d^2 + (s_phi p tan(alpha))^2 is the variance by the noise of
range and beam angle, with the angle of incidence alpha. The start values are from a fit of perpendicular
distances, which alone would be biased. Weighted sums of squares are multiplied by s_d^2, so their unit is m^2.

A round wall is cut into chords, as long as the laser's noise allows. Each chord passes the test of straightness,
but its position depends on the cuts, which change with the robot's pose. So a chord is no landmark. Its neighbours
show that it is one: on a curve, neighbouring pieces turn in the same direction, and the bow of each piece (its
height over the chord) fits these turns. Straight walls that meet in a blunt corner have no bow.
"""

from __future__ import annotations

from locfuse.fusion.data import Array

from .arrays import floats, view, wholes

try:
    import cython
except ImportError:  # Cython is only needed to compile
    from . import uncompiled as cython
if not cython.compiled:
    from .places import wrapped
    from .segments import Limits, Returns, ScanColumns, Segments, distance, find_walls, head_of, tail_of
    from .uncompiled import cos, sin, sqrt

FAR_FOOT_M = 1e150  # position on the wall assumed for a beam parallel to it
MAX_PSI_RAD = 1e3  # a fit with a larger psi has diverged
MIN_CURVE_TURN_RAD = 0.08  # least turn of a curve over the length of one piece: a bow of 1 % of the length
MAX_JOINT_TURN_RAD = 0.7  # largest turn of a curve between two pieces
MIN_CURVE_PIECES = 3  # two pieces may be a blunt corner
MAX_SHADOW_M = 0.6  # largest gap between two pieces of a curve: a piece in it may have been too short for a wall
MIN_CURVE_GAIN_CHI2 = 4.0  # least chi2 that a curve saves over all its pieces (2 sigma: 98 %)
SPARED_PIECE_CHI2 = 3.0  # bonus for each further piece: a curve needs no line of its own for it
MIN_PIECE_GAIN_CHI2 = -25.0  # where a curve saves less, the piece is straight (5 sigma)


class Fit:
    """Least-squares fit of a line (r, psi) to the `count` returns of one wall, with its weighted sums.

    The k-th return has index row[k], distance e = error[k] [m] from the line, position q = foot[k] [m] along it,
    and weight w = weight[k]. `sum_wqe` is the sum of w q e over all returns, and so on. `det` is the determinant
    of the normal equations, `step_r` and `step_psi` are the Gauss-Newton step; `rest` [m^2] is left after it.
    """

    def __init__(self, beams: int) -> None:
        self.row, self.error, self.foot, self.weight = wholes(beams), floats(beams), floats(beams), floats(beams)
        self.count, self.r, self.psi = 0, 0.0, 0.0
        self.sum_w, self.sum_wq, self.sum_wqq = 0.0, 0.0, 0.0
        self.sum_we, self.sum_wqe, self.sum_wee = 0.0, 0.0, 0.0
        self.sum_wqqq, self.sum_wqqqq, self.sum_wqqe = 0.0, 0.0, 0.0
        self.det, self.step_r, self.step_psi, self.rest = 0.0, 0.0, 0.0, 0.0


class Curves:
    """Work arrays to find curved walls: curvature [1/m] between neighbours, chi2 gain and result for each wall."""

    def __init__(self, beams: int) -> None:
        self.joint, self.gains, self.curved = floats(beams), floats(beams), wholes(beams)
        self.saved, self.pieces = 0.0, 0.0  # chi2 that one curve saves, and number of its pieces


class Sweep:
    """Motion of the base during a scan, in pieces of time.

    `share` (pieces, beams) is the share of a piece's motion that moves each beam. The lever [m] from the base to
    the laser and the base's forward direction are in the laser's axes.
    """

    def __init__(self, share: Array, lever: tuple[float, float], ahead: tuple[float, float]) -> None:
        self.share, self.pieces = view(share), len(share)
        self.lever_x, self.lever_y = lever
        self.ahead_x, self.ahead_y = ahead


class FoundLines:
    """Lines of n scans, as columns of `lines.extract.Lines`: `count` lines so far, at most `most`.

    R has the columns rr, rp, pp of the covariance / sigma_range^2. `sweep` (most, 4, pieces) has the derivatives
    dr/dturn, dr/dmove, dpsi/dturn, dpsi/dmove.
    """

    def __init__(self, scans: int, most: int, pieces: int) -> None:
        self.counts, self.curved, self.count = wholes(scans), wholes(scans), 0
        self.z, self.R, self.ends, self.chi2 = floats(most, 2), floats(most, 3), floats(most, 2), floats(most)
        self.points, self.span, self.sweep = wholes(most), wholes(most, 2), floats(most, 4, pieces)


def find_lines(scans: ScanColumns, limits: Limits, sweep: Sweep) -> FoundLines:
    """Return the lines of all scans; the scans are independent."""
    number, beams = scans.ranges.shape[0], scans.ranges.shape[1]
    found = FoundLines(number, number * (beams // 3), sweep.pieces)  # no line of fewer beams
    returns, segments, fit, curves = Returns(beams), Segments(beams), Fit(beams), Curves(beams)
    for scan in range(number):
        before = found.count
        find_walls(scans, scan, limits, returns, segments)
        find_curves(returns, limits, segments, fit, curves)
        for wall in range(segments.walls):
            if curves.curved[wall]:
                found.curved[scan] += 1
                continue
            rows_of(segments, wall, fit)
            if fit_wall(returns, limits, segments, wall, fit, found):
                loadings(returns, fit, sweep, found)
                found.count += 1
        found.counts[scan] = found.count - before
    return found


def fit_wall(returns: Returns, limits: Limits, segments: Segments, wall: int, fit: Fit, found: FoundLines) -> bool:
    """Fit a line to the returns of a wall in two Gauss-Newton steps, and write it; return whether it is valid.

    Before the first step, returns outside the wall's limits and at grazing incidence are left out; before the
    second step, stray returns. The limits apply to the predicted point of a beam, not to the measured one: a
    choice that depends on the noise would bias the line.
    """
    least = max(limits.min_points, 3.0)
    stray = limits.stray_sigmas * limits.stray_sigmas * limits.sigma_range * limits.sigma_range
    fit.r, fit.psi = segments.r[wall], segments.psi[wall]
    flat = fit.r * limits.grazing
    residuals(returns, limits, fit)
    low, high, kept = max(segments.low[wall], -flat), min(segments.high[wall], flat), 0
    for k in range(fit.count):
        if low <= fit.foot[k] <= high:
            keep(fit, k, kept)
            kept += 1
    fit.count = kept
    if fit.count < least or not solve(fit):
        return False
    fit.r += fit.step_r
    fit.psi += fit.step_psi
    if not abs(fit.psi) < MAX_PSI_RAD:
        return False
    residuals(returns, limits, fit)
    leave_strays(fit, stray, least)
    parabola(fit)
    return finish(returns, limits, fit, found)


def finish(returns: Returns, limits: Limits, fit: Fit, found: FoundLines) -> bool:
    """Take the last Gauss-Newton step and write the line; return False for a bent wall or an uncertain line.

    A wall is bent if a parabola explains much of the misfit, and its height over the chord is above `max_bow`. A
    line is uncertain if sigma(psi) is above `max_sigma_psi`, or if the second-order error of r by a turn of
    sigma(psi) is above `max_swing` times the sigma(r) at exact psi.
    """
    if not solve(fit):
        return False
    line, det = found.count, fit.det
    chi2 = fit.rest / limits.variance / max(fit.count - 2, 1)
    fit.r += fit.step_r
    fit.psi += fit.step_psi
    if not (fit.r > 0.0 and abs(fit.psi) < MAX_PSI_RAD and chi2 <= limits.max_chi2):
        return False
    first, last = fit.row[0], fit.row[fit.count - 1]
    begin, end = foot_of(returns, first, fit.r, fit.psi), foot_of(returns, last, fit.r, fit.psi)
    bend = curvature(fit)
    gained, bow = stiffness(fit) * bend * bend, abs(bend * (end - begin)) / 4.0  # [m^2], height / chord
    if gained > limits.max_bend * limits.variance and bow > limits.max_bow:
        return False
    spread = fit.sum_w / det * limits.variance  # of psi [rad^2]
    most = limits.max_swing * sqrt(limits.variance / fit.sum_w)
    if spread > limits.max_sigma_psi * limits.max_sigma_psi or 0.5 * fit.r * spread > most:
        return False
    found.z[line, 0], found.z[line, 1] = fit.r, wrapped(fit.psi)
    found.R[line, 0], found.R[line, 1], found.R[line, 2] = fit.sum_wqq / det, fit.sum_wq / det, fit.sum_w / det
    found.ends[line, 0], found.ends[line, 1] = min(begin, end), max(begin, end)
    found.points[line], found.chi2[line] = fit.count, chi2
    found.span[line, 0], found.span[line, 1] = returns.beam[first], returns.beam[last]
    return True


def loadings(returns: Returns, fit: Fit, sweep: Sweep, found: FoundLines) -> None:
    """Write the derivatives of a line's (r, psi) by the base's turn [rad] and move [m] in each piece of the sweep.

    Perpendicular to the line, a beam's end moves by lever - q per radian and by n.ahead per metre. The fitted line
    moves by the weighted least-squares mean of that.
    """
    line = found.count
    nx, ny = cos(found.z[line, 1]), sin(found.z[line, 1])
    across = ny * sweep.lever_x - nx * sweep.lever_y
    along = nx * sweep.ahead_x + ny * sweep.ahead_y
    a, b, c, det = fit.sum_w, fit.sum_wq, fit.sum_wqq, fit.det
    for piece in range(sweep.pieces):
        s = sq = sqq = 0.0
        for k in range(fit.count):
            share = sweep.share[piece, returns.beam[fit.row[k]]]
            if share != 0.0:
                part = share * fit.weight[k]
                s += part
                sq += part * fit.foot[k]
                sqq += part * fit.foot[k] * fit.foot[k]
        turned, turned_q = across * s - sq, across * sq - sqq
        moved, moved_q = along * s, along * sq
        found.sweep[line, 0, piece] = (c * turned - b * turned_q) / det
        found.sweep[line, 1, piece] = (c * moved - b * moved_q) / det
        found.sweep[line, 2, piece] = (b * turned - a * turned_q) / det
        found.sweep[line, 3, piece] = (b * moved - a * moved_q) / det


# ---- the fit of one line ----


def rows_of(segments: Segments, wall: int, fit: Fit) -> None:
    """Collect the returns of all parts of a wall."""
    count = 0
    for part in range(segments.bounds[wall], segments.bounds[wall + 1]):
        for i in range(segments.start[part], segments.stop[part]):
            fit.row[count] = i
            count += 1
    fit.count = count


def residuals(returns: Returns, limits: Limits, fit: Fit) -> None:
    """Compute distances e [m] of the returns from the line (r, psi), positions q [m] along it, weights w.

    e = (d - p) n.u is the range residual times n.u; its derivative by (r, psi) is (-1, q). q is the position of
    the *predicted* point: that of the measured point would bias the fit, as in fits of perpendicular distances. w
    = s_d^2 / var(e) follows from the ratio s_phi / s_d > 0 [1/m].
    """
    nx, ny, r, ratio = cos(fit.psi), sin(fit.psi), fit.r, limits.ratio
    for k in range(fit.count):
        i = fit.row[k]
        ux, uy, ox, oy = returns.ux[i], returns.uy[i], returns.ox[i], returns.oy[i]
        along, across = nx * ux + ny * uy, nx * uy - ny * ux
        reach = r - (nx * ox + ny * oy)
        fit.error[k] = returns.ranges[i] * along - reach
        square = along * along
        foot = reach / along * across if square > 0.0 else FAR_FOOT_M  # also what 1 rad moves the end off the wall
        turn = foot * ratio
        fit.weight[k] = 1.0 / (turn * turn + square)
        fit.foot[k] = foot + (nx * oy - ny * ox)


def keep(fit: Fit, k: int, kept: int) -> None:
    """Copy return k of the fit to index `kept` (the number of returns that were kept before)."""
    fit.row[kept], fit.error[kept] = fit.row[k], fit.error[k]
    fit.foot[kept], fit.weight[kept] = fit.foot[k], fit.weight[k]


def leave_strays(fit: Fit, limit: float, least: float) -> None:
    """Leave out stray returns, such as those of a pole: e^2 w > `limit` [m^2].

    They are too few for a line of their own, and would bias this line. If fewer than `least` returns would remain,
    all are kept.
    """
    strays = kept = 0
    for k in range(fit.count):
        if fit.error[k] * fit.error[k] * fit.weight[k] > limit:
            strays += 1
    if strays == 0 or fit.count - strays < least:
        return
    for k in range(fit.count):
        if not fit.error[k] * fit.error[k] * fit.weight[k] > limit:
            keep(fit, k, kept)
            kept += 1
    fit.count = kept


def solve(fit: Fit) -> bool:
    """Compute the weighted sums and the Gauss-Newton step of a line fit; return whether there is a step.

    There is none if all beams meet the line in one point, so that its direction is undefined.
    """
    a = b = c = f = g = ee = 0.0
    for k in range(fit.count):
        e, q, w = fit.error[k], fit.foot[k], fit.weight[k]
        wq, we = w * q, w * e
        a += w
        b += wq
        c += wq * q
        f += we
        g += wq * e
        ee += we * e
    fit.sum_w, fit.sum_wq, fit.sum_wqq, fit.sum_we, fit.sum_wqe, fit.sum_wee = a, b, c, f, g, ee
    fit.det = a * c - b * b
    if not fit.det > 1e-12 * a * c:
        return False
    fit.step_r, fit.step_psi = (c * f - b * g) / fit.det, (b * f - a * g) / fit.det
    fit.rest = max(ee - fit.step_r * f + fit.step_psi * g, 0.0)
    return True


def parabola(fit: Fit) -> None:
    """Compute the additional sums for a parabola: wqqq, wqqqq, wqqe."""
    cubic = quartic = qqe = 0.0
    for k in range(fit.count):
        q = fit.foot[k]
        wqq = fit.weight[k] * q * q
        cubic += wqq * q
        quartic += wqq * q * q
        qqe += wqq * fit.error[k]
    fit.sum_wqqq, fit.sum_wqqqq, fit.sum_wqqe = cubic, quartic, qqe


def foot_of(returns: Returns, i: int, r: float, psi: float) -> float:
    """Return the position [m] along the line (r, psi) at which the beam of return i meets it."""
    nx, ny, ux, uy = cos(psi), sin(psi), returns.ux[i], returns.uy[i]
    along, across = nx * ux + ny * uy, nx * uy - ny * ux
    reach = r - (nx * returns.ox[i] + ny * returns.oy[i])
    foot = reach / along * across if along * along > 0.0 else FAR_FOOT_M
    return foot + (nx * returns.oy[i] - ny * returns.ox[i])


def stiffness(fit: Fit) -> float:
    """Return the information of the parabola's coefficient: weighted sum of squares of q^2 minus its line fit."""
    a, b, c, cubic = fit.sum_w, fit.sum_wq, fit.sum_wqq, fit.sum_wqqq
    return fit.sum_wqqqq - (c * (c * c - b * cubic) + cubic * (a * cubic - b * c)) / fit.det


def curvature(fit: Fit) -> float:
    """Return the coefficient [1/m] of a parabola fitted in addition to the line; 0 if singular."""
    norm = stiffness(fit)
    left = fit.sum_wqqe - fit.step_r * fit.sum_wqq + fit.step_psi * fit.sum_wqqq
    return left / norm if norm > 0.0 else 0.0


# ---- curves ----


def find_curves(returns: Returns, limits: Limits, segments: Segments, fit: Fit, curves: Curves) -> None:
    """Mark the walls that are pieces of a curve.

    If most walls of a scan are such pieces, every other wall is marked too, unless its own returns show that it is
    straight: it may be a piece of the same curve with hidden neighbours.
    """
    walls, closed = segments.walls, returns.closed
    for i in range(walls):
        curves.curved[i] = 0
    if joints(returns, segments, curves) < MIN_CURVE_PIECES - 1:
        return
    for i in range(walls):
        bent = curvature_of(curves, walls, closed, i)
        curves.gains[i] = gain(returns, limits, segments, i, fit, bent)
    found, mean = 0, 0.0
    for i in range(walls):
        length = distance(returns, head_of(segments, i), tail_of(segments, i))
        if is_piece(curves, walls, closed, i, length):
            curves.curved[i] = 1
            found += 1
            mean += curvature_of(curves, walls, closed, i)
    if 2 * found > walls:
        for i in range(walls):
            if gain(returns, limits, segments, i, fit, mean / found) > -MIN_CURVE_GAIN_CHI2:
                curves.curved[i] = 1


def joints(returns: Returns, segments: Segments, curves: Curves) -> int:
    """Compute the curvature [1/m] between neighbouring walls; return the number of joints.

    The curvature is positive if psi grows along the tangent (-sin psi, cos psi), and 0 if the walls do not join.
    """
    found, psi = 0, segments.psi
    for i in range(segments.walls):
        curves.joint[i] = 0.0
        if i + 1 == segments.walls and not (returns.closed and i > 0):
            continue
        j = i + 1 if i + 1 < segments.walls else 0  # the next wall in the order of the beams
        begin, tail = head_of(segments, i), tail_of(segments, i)
        head, end = head_of(segments, j), tail_of(segments, j)
        shadow = distance(returns, tail, head)
        turn = wrapped(psi[j] - psi[i])
        if not (shadow <= MAX_SHADOW_M and abs(turn) <= MAX_JOINT_TURN_RAD):  # also if the points are NaN
            continue
        length = shadow + 0.5 * (distance(returns, begin, tail) + distance(returns, head, end))
        ahead = cos(psi[i]) * (returns.y[tail] - returns.y[begin])
        ahead -= sin(psi[i]) * (returns.x[tail] - returns.x[begin])
        if length > 0.0:
            curves.joint[i] = turn / length if ahead > 0.0 else -turn / length
            found += 1
    return found


def curvature_of(curves: Curves, walls: int, closed: bool, i: int) -> float:
    """Return the curvature [1/m] of wall i from both neighbours; 0 without neighbours or if these disagree."""
    behind = curves.joint[i - 1] if i > 0 else curves.joint[walls - 1] if closed else 0.0
    ahead = curves.joint[i]
    if behind == 0.0 or ahead == 0.0:
        return behind + ahead
    return 0.5 * (behind + ahead) if behind * ahead > 0.0 else 0.0


def gain(returns: Returns, limits: Limits, segments: Segments, wall: int, fit: Fit, bent: float) -> float:
    """Return the decrease of a wall's chi2 if its curvature is `bent` [1/m] instead of 0."""
    if bent == 0.0:
        return 0.0
    rows_of(segments, wall, fit)
    fit.r, fit.psi = segments.r[wall], segments.psi[wall]
    residuals(returns, limits, fit)
    if not solve(fit):
        return 0.0
    parabola(fit)
    height = -0.5 * bent  # coefficient of the parabola [1/m]; with positive curvature the ends are nearer
    return stiffness(fit) * height * (2.0 * curvature(fit) - height) / limits.variance


def goes_on(curves: Curves, walls: int, i: int, step: int) -> None:
    """Follow a curve from wall i in direction `step` (1 or -1); sum the chi2 gains, and count its pieces."""
    sign = 0.0
    for _ in range(walls - 1):
        at = i if step > 0 else i - 1 if i > 0 else walls - 1
        i = i + step
        i = 0 if i == walls else walls - 1 if i < 0 else i
        here = curves.joint[at]
        if here == 0.0 or here * sign < 0.0 or curves.gains[i] < MIN_PIECE_GAIN_CHI2:
            return
        sign = here
        curves.saved += curves.gains[i] + SPARED_PIECE_CHI2
        curves.pieces += 1.0


def is_piece(curves: Curves, walls: int, closed: bool, i: int, length: float) -> bool:
    """Return whether wall i of `length` [m] is a piece of a curve that fits better than several straight walls."""
    bent = curvature_of(curves, walls, closed, i)
    if abs(bent) * length < MIN_CURVE_TURN_RAD or curves.gains[i] < MIN_PIECE_GAIN_CHI2:
        return False
    curves.saved, curves.pieces = curves.gains[i] - SPARED_PIECE_CHI2, 1.0
    goes_on(curves, walls, i, 1)
    goes_on(curves, walls, i, -1)
    return curves.pieces >= MIN_CURVE_PIECES and curves.saved > MIN_CURVE_GAIN_CHI2
