"""Settings of a wall."""

from __future__ import annotations

import math

import msgspec


class LineSettings(msgspec.Struct, frozen=True):
    """Noise of the laser and limits of a wall; the defaults are the paper's laser: 30 mm, 0.25 deg."""

    sigma_range: float = 0.03  # m
    sigma_angle: float = math.radians(0.25)  # rad
    min_points: int = 5  # beams in the fit
    min_length: float = 0.30  # m, before corners are trimmed
    max_gap: float = 0.30  # m between neighbouring beams on one wall ...
    gap_spacings: float = 6.0  # ... or this many beam spacings at that range: a wall seen at 80 degrees
    bridge: float = 0.1  # m, widest shadow across which a line goes on: a stray beam's, not a pole's
    split_sigmas: float = 3.0  # farther from the chord is a corner; what noise cuts, merging joins again
    split_floor: float = 0.02  # m, and never nearer than this
    flatness: float = 0.005  # m by which real walls are not flat: added to the noise where lines are compared
    merge_chi2: float = 20.0  # two pieces are one line below it (2 degrees of freedom, cut where it looked worst)
    max_incidence: float = math.radians(85.0)  # rad; flatter beams are not used: range noise is not linear there
    stray_sigmas: float = 3.3  # a beam farther from its line than this is not of the wall
    corner_sigmas: float = 2.5  # a beam closer to the neighbouring wall than this could belong to either
    max_sigma_psi: float = math.radians(3.0)  # rad; a line known worse is too short for its noise
    max_swing: float = 0.5  # in sigmas: beyond it (r, psi) is not Gaussian, and no covariance is honest
    max_chi2: float = 4.0  # residual chi2 per degree of freedom; more is not a straight wall
    max_bow: float = 0.03  # height of the bow over its chord: more is a column, or two walls ...
    max_bend: float = 12.0  # ... if the bow is not noise: chi2 that a parabola explains (99.95 % of 1 degree)
