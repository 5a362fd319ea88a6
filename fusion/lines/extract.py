"""Line extraction from laser scans: lines (r, psi), covariance, extent (paper section III, LRF).

A line is x cos(psi) + y sin(psi) = r with r >= 0, in the frame of the scan. If an object hides a part of a wall,
the wall gives two lines. They are joined only if the gap is narrower than `bridge` and than each part, and both
parts are statistically the same line: across wider gaps, parts would be joined in some scans but not in others,
and could not be matched one to one with the map. Beams near a corner that may belong to either wall are not used.
Curved walls give no lines. All scans of a batch are processed at once, by `kernels.segments` and
`kernels.line_fits`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import msgspec
import numpy as np

from locfuse.fusion.data import Array, Ints, totals
from locfuse.fusion.kernels import line_fits, places, segments
from locfuse.fusion.kernels.arrays import view
from locfuse.fusion.sensor import WheelMotion

# a scan's duration is divided into pieces with independent wheel slip: three before its middle, three after it
SWEEP_PIECES = 6
PIECE_EDGES = np.linspace(-0.5, 0.5, SWEEP_PIECES + 1)  # in scan durations, from the middle of the scan
MAX_RANGE_M = 1e6  # larger ranges count as no return
_SCANS_AT_ONCE = 256  # scans processed at once,
_BEAMS_AT_ONCE = 100_000  # or fewer, so that they have at most this many beams: about 300 bytes of memory per beam
_OF_R = np.array((2, 3, 3, 4))
LINE_COLUMNS = 7  # columns of a line in a table, as in kernels.places and kernels.sight


class BeamMotion(NamedTuple):
    """Mount of the laser, in the form for computing how beams move with the base."""

    lever: tuple[float, float]  # m, from the base to the laser, in the laser frame
    ahead: tuple[float, float]  # forward direction of the base in the laser frame


def motion_of(mount: Array) -> BeamMotion:
    """Convert a laser mount x [m], y [m], yaw [rad] to a `BeamMotion`."""
    x, y, yaw = mount.tolist()
    c, s = np.cos(yaw), np.sin(yaw)
    return BeamMotion((c * x + s * y, c * y - s * x), (c, -s))


def shares(beams: int) -> Array:
    """Return the fraction (pieces, beams) of the wheel slip in each piece of a scan that displaces each beam.

    The fraction is from 0 to 1. It is 0 for the middle beam of the scan, since the other beams are deskewed to
    this beam.
    """
    at = np.linspace(-0.5, 0.5, beams)
    low, high = PIECE_EDGES[:-1, None], PIECE_EDGES[1:, None]
    after = np.clip((at - low) * SWEEP_PIECES, 0.0, 1.0)
    before = np.clip((high - at) * SWEEP_PIECES, 0.0, 1.0)
    return np.where(low >= 0.0, after, before)


def noise_of(per_unit: Array, scan: Ints, middle: Array, duration: Array, wheels: WheelMotion) -> Array:
    """Return derivatives G (m, 2, 2 pieces) of lines (r, psi) by the wheel slip in each piece of a scan.

    The slip is in standard deviations: that of the left wheel in all pieces, then that of the right wheel.
    `per_unit` (m, 2, 2, pieces) are derivatives by turn and move (`kernels.line_fits.loadings`). `scan` (m,) is
    the index of each line's scan; middle and duration (n,) [s] are those of the scans.
    """
    slip = np.sqrt(wheels.slips(middle[:, None] + duration[:, None] * PIECE_EDGES))[scan]  # (m, pieces, 2) m
    turn, move = per_unit[:, :, 0] / wheels.track, 0.5 * per_unit[:, :, 1]  # (m, 2, pieces)
    left, right = (move - turn) * slip[:, None, :, 0], (move + turn) * slip[:, None, :, 1]
    return np.concatenate((left, right), axis=2).astype(np.float32)


def in_base(loads: Array, z: Array, mount: Array) -> Array:
    """Convert derivatives of lines (r, psi) from the laser frame to the base frame.

    `loads` (m, 2, ...) are derivatives by any parameters, z (m, 2) the lines, `mount` (3,) is x [m], y [m], yaw
    [rad].
    """
    out = np.empty(loads.shape)
    if loads.size:
        parts = (len(z), 2, -1)
        given, into = view(loads.reshape(parts)), view(out.reshape(parts))
        x, y, yaw = mount.tolist()
        places.shares_into_base(view(z), len(z), x, y, yaw, given, into)
    return out


class LineSettings(msgspec.Struct, frozen=True):
    """Settings of the line extraction: laser noise and limits; defaults: the paper's laser (30 mm, 0.25 deg)."""

    sigma_range: float = 0.03  # m
    sigma_angle: float = math.radians(0.25)  # rad
    min_points: int = 5  # beams in the fit
    min_length: float = 0.30  # m, before corners are trimmed
    max_gap: float = 0.30  # m between neighbouring beams on one wall ...
    gap_spacings: float = 6.0  # ... or this many beam spacings at the range (for a wall seen at 80 degrees)
    bridge: float = 0.1  # m, widest gap within a line: that of a stray beam, but not of a pole
    split_sigmas: float = 3.0  # a point farther from the chord is a corner; splits by noise are merged later
    split_floor: float = 0.02  # m, least distance of a corner from the chord
    flatness: float = 0.005  # m, unevenness of real walls: added to the noise when lines are compared
    # two pieces with a lower chi2 are merged (2 degrees of freedom, split at the worst point)
    merge_chi2: float = 20.0
    # rad; beams at a larger angle are not used: range noise is not linear
    max_incidence: float = math.radians(85.0)
    stray_sigmas: float = 3.3  # a beam farther from its line is not part of the wall
    corner_sigmas: float = 2.5  # a beam closer to the neighbouring wall may belong to either wall
    max_sigma_psi: float = math.radians(3.0)  # rad; lines with a larger standard deviation are too short
    max_swing: float = 0.5  # in sigmas: above it, the error of (r, psi) is not Gaussian
    max_chi2: float = 4.0  # largest residual chi2 per degree of freedom of a straight wall
    max_bow: float = 0.03  # m, largest height of the bow over its chord; more is a column, or two walls ...
    max_bend: float = 12.0  # ... if the bow is significant: chi2 explained by a parabola (99.95 %, 1 dof)


PAPER_LASER = LineSettings()


class Lines(msgspec.Struct, frozen=True):
    """Lines of n scans, in the order of scans, and within a scan in the order of beams."""

    first: Ints  # (n + 1,) scan i has the lines first[i]:first[i + 1]
    z: Array  # (m, 2) r [m] >= 0, psi [rad] in [-pi, pi), in the scan's frame
    R_unit: Array  # (m, 2, 2) covariance / sigma_range^2: depends on sigma_angle / sigma_range only
    ends: Array  # (m, 2) extent along the tangent (-sin psi, cos psi), lo < hi [m]
    points: Ints  # (m,) number of beams in the fit
    chi2: Array  # (m,) residual chi2 per degree of freedom
    span: Ints  # (m, 2) first and last beam in the fit; first > last if the line crosses beam 0
    # (m, 2, 2, pieces) derivatives of (r, psi) by the turn and move of the robot in each piece of the scan
    sweep: Array
    curved: Ints  # (n,) number of walls left out as curved


class RawScans(NamedTuple):
    """Ranges and angles of several scans of one laser."""

    ranges: Array  # (n, b) m; NaN, Inf and 0 are no return
    angles: Array  # (b,) or (n, b) rad, increasing or decreasing
    offsets: Array | None  # (n, b, 3) laser pose of each beam in the scan's frame; None: at the origin

    def take(self, rows: slice) -> RawScans:
        """Return the scans in a slice."""
        angles = self.angles if self.angles.ndim == 1 else self.angles[rows]
        offsets = None if self.offsets is None else self.offsets[rows]
        return self._replace(ranges=self.ranges[rows], angles=angles, offsets=offsets)

    def spacing(self) -> Array:
        """Return the angle between neighbouring beams [rad] of each scan, (n,)."""
        n, b = self.ranges.shape
        if b < 2:
            return np.zeros(n)
        spread = np.abs(self.angles[..., -1] - self.angles[..., 0]) / (b - 1)
        return np.broadcast_to(spread, (n,))

    def rays(self) -> tuple[Array, Array, Array, Array]:
        """Return direction (cos, sin) and origin x, y [m] of every beam.

        Each is (n, b), or (b,) if it is equal in all scans.
        """
        angles = self.angles
        if self.offsets is not None:
            x, y, turn = self.offsets.transpose(2, 0, 1)
            return np.cos(angles + turn), np.sin(angles + turn), x, y
        if angles.ndim == 2 and len(angles) and (angles == angles[0]).all():
            angles = angles[0]  # one sine per angle instead of one per beam
        return np.cos(angles), np.sin(angles), np.zeros(angles.shape), np.zeros(angles.shape)


def extract_lines(
    ranges: Array,
    angles: Array,
    settings: LineSettings = PAPER_LASER,
    offsets: Array | None = None,
    motion: BeamMotion | None = None,
) -> Lines:
    """Extract straight walls from `ranges` (n, b) [m] at `angles` (b,) or (n, b) [rad].

    `offsets` (n, b, 3) are the laser poses (x [m], y [m], theta [rad]) of the beams in the frame of their scan,
    for deskewing. `motion` is needed for the derivatives by wheel slip (Lines.sweep). NaN, Inf and 0 mean no
    return. Angles increase or decrease; in a full-circle scan, a wall may extend across beam 0. The result of a
    scan does not depend on other scans.
    """
    scans = RawScans(ranges, angles, offsets)
    batch = min(_SCANS_AT_ONCE, max(_BEAMS_AT_ONCE // max(ranges.shape[1], 1), 1))
    blocks = (slice(i, i + batch) for i in range(0, max(len(ranges), 1), batch))
    parts = [lines_of(scans.take(rows), settings, motion) for rows in blocks]
    return _joined(parts)


def rows_of(z: Array, R: Array, ends: Array) -> Array:
    """Return lines as a table (k, 7): r, psi, R_00, R_01, R_11, and both ends [m] along the line.

    z (k, 2) are (r, psi), R (k, 2, 2) their covariances, `ends` (k, 2) [m].
    """
    rows = np.empty((len(z), LINE_COLUMNS))
    rows[:, :2], rows[:, 5:] = z, ends
    rows[:, 2], rows[:, 3], rows[:, 4] = R[:, 0, 0], R[:, 0, 1], R[:, 1, 1]
    return rows


def of_rows(rows: Array) -> tuple[Array, Array, Array]:
    """Return (z, R, ends) of a table of lines (k, 7)."""
    return rows[:, :2], rows.take(_OF_R, axis=1).reshape(-1, 2, 2), rows[:, 5:]


def rows_in_base(rows: Array, x: float, y: float, yaw: float) -> Array:
    """Convert a table of lines (k, 7) from a laser mounted at (x [m], y [m], yaw [rad]) to the base frame."""
    out = np.empty((len(rows), LINE_COLUMNS))
    places.into_base(view(rows), len(rows), x, y, yaw, view(out))
    return out


def lines_of(scans: RawScans, settings: LineSettings, motion: BeamMotion | None) -> Lines:
    """Extract the lines of one batch of scans."""
    spacing, beams = scans.spacing(), scans.ranges.shape[1]
    limits = float(np.finfo(float).tiny), MAX_RANGE_M
    ring = spacing * (beams + 0.5) > 2.0 * math.pi
    given = segments.ScanColumns(scans.ranges, scans.rays(), settings.gap_spacings * spacing, ring, limits)
    share = np.zeros((0, beams)) if motion is None else shares(beams)
    sweep = line_fits.Sweep(share, *(motion or BeamMotion((0.0, 0.0), (0.0, 0.0))))
    found = line_fits.find_lines(given, segments.Limits(settings), sweep)
    n = found.count
    R, points, span = np.asarray(found.R)[:n], np.asarray(found.points)[:n], np.asarray(found.span)[:n]
    return Lines(
        first=totals(found.counts).astype(np.int64),
        z=np.asarray(found.z)[:n],
        R_unit=R[:, (0, 1, 1, 2)].reshape(n, 2, 2),
        ends=np.asarray(found.ends)[:n],
        points=points.astype(np.int64),
        chi2=np.asarray(found.chi2)[:n],
        span=span.astype(np.int64),
        sweep=np.asarray(found.sweep)[:n].reshape(n, 2, 2, len(share)),
        curved=np.asarray(found.curved).astype(np.int64),
    )


def _joined(parts: list[Lines]) -> Lines:
    """Join the lines of all batches."""
    columns = {name: np.concatenate([getattr(part, name) for part in parts]) for name in Lines.__struct_fields__}
    counts = np.concatenate([np.diff(part.first) for part in parts])
    return Lines(**(columns | {"first": totals(counts)}))
