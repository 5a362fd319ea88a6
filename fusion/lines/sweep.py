"""Noise of deskewing: wheels slip during a scan, and the beams are placed by the wheels.

Between the middle of the sweep and a beam either wheel errs by a random walk w of variance k |rolled| (the k of
wheels.noise), so that the beam is turned about the base by (w_right - w_left) / L and moved ahead by their mean.
Along a straight way that is 2 k |v| / L^2 [rad^2/s] for the time from the middle. All lines of a scan share these
errors, so they are kept as loadings: a line (r, psi) errs by the sum over wheels and pieces of the sweep of G w,
with w of unit variance, and lines i, j are correlated by G_i G_j'.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from locfuse.fusion.data import Array, Ints
from locfuse.fusion.kernels import places
from locfuse.fusion.kernels.arrays import view
from locfuse.fusion.sensor import WheelMotion

SWEEP_PIECES = 6  # of a sweep, in each of which either wheel slips once: three before its middle and three after
PIECE_EDGES = np.linspace(-0.5, 0.5, SWEEP_PIECES + 1)  # of the pieces, in sweeps from its middle


class Motion(NamedTuple):
    """Motion of a scan's beams with the base: numbers of the laser's mount."""

    lever: tuple[float, float]  # m, from the base to the laser, in the laser's axes
    ahead: tuple[float, float]  # the base's forward direction in the laser's axes


def motion_of(mount: Array) -> Motion:
    """Return how the beams of a laser mounted at x [m], y [m], yaw [rad] move when the base does."""
    x, y, yaw = mount.tolist()
    c, s = np.cos(yaw), np.sin(yaw)
    return Motion((c * x + s * y, c * y - s * x), (c, -s))


def shares(beams: int) -> Array:
    """Return the share of each piece's wheel slip in each beam, (pieces, beams), from the middle on."""
    at = np.linspace(-0.5, 0.5, beams)
    low, high = PIECE_EDGES[:-1, None], PIECE_EDGES[1:, None]
    after = np.clip((at - low) * SWEEP_PIECES, 0.0, 1.0)
    before = np.clip((high - at) * SWEEP_PIECES, 0.0, 1.0)
    return np.where(low >= 0.0, after, before)


def noise_of(per_unit: Array, scan: Ints, middle: Array, duration: Array, wheels: WheelMotion) -> Array:
    """Return the loadings G (m, 2, 2 pieces) of lines on the slips of both wheels in every piece of the sweep.

    `per_unit` (m, 2, 2, pieces) by `kernels.line_fits.loadings`; scan (m,) says whose the lines are;
    middle, duration (n,) [s].
    """
    slip = np.sqrt(wheels.slips(middle[:, None] + duration[:, None] * PIECE_EDGES))[scan]  # (m, pieces, 2) m
    turn, move = per_unit[:, :, 0] / wheels.track, 0.5 * per_unit[:, :, 1]  # (m, 2, pieces)
    left, right = (move - turn) * slip[:, None, :, 0], (move + turn) * slip[:, None, :, 1]
    G: Array = np.concatenate((left, right), axis=2).astype(np.float32)
    return G


def in_base(loads: Array, z: Array, mount: Array) -> Array:
    """Return loadings (m, 2, ...) of the laser's lines z (m, 2) in the base frame, by `kernels.places`."""
    out = np.empty(loads.shape)
    if loads.size:
        parts = (len(z), 2, -1)
        given, into = view(loads.reshape(parts)), view(out.reshape(parts))
        x, y, yaw = mount.tolist()
        places.shares_into_base(view(z), len(z), x, y, yaw, given, 0, into)
    return out
