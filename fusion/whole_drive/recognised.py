"""Places that the filter recognised on its way: where the search for loops begins.

After a long loop nothing in the graph says where its end lies, and many places would fit. The filter has held its
map against the walls scan by scan until then, and seldom errs. What it says steers the search only: a kernel gives
up what the rest of the graph contradicts, every loop must pass all tests, and the last solve is without it.
"""

from __future__ import annotations

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Estimates, Ints

from .closures import CLOSURE_WIDTH, NARROW_M, NARROW_RAD
from .odometry import Odometry
from .solve import Edges

# of such a place, half of what a match needs no search for: its walls say it better, but the keys lie beside it
SIGMA_M, SIGMA_RAD = 0.5 * NARROW_M, 0.5 * NARROW_RAD


def recognised(filtered: Estimates, odometry: Odometry, keys: Ints) -> Edges:
    """Return the places that a run recognised, as edges between keys; `keys` (m,) are instants of the run."""
    at = np.searchsorted(filtered.t, filtered.loops)
    at = np.minimum(at, len(filtered.t) - 1)
    ends = _nearest(keys, at)
    to_then, _ = odometry.between(keys[ends[:, 0]], at[:, 0])
    from_now, _ = odometry.between(at[:, 1], keys[ends[:, 1]])
    z = se2.compose(se2.compose(to_then, filtered.loop_poses), from_now)
    information = np.diag(1.0 / np.square((SIGMA_M, SIGMA_M, SIGMA_RAD)))
    apart = ends[:, 0] < ends[:, 1]
    found = Edges.of(ends[:, 0], ends[:, 1], z, np.tile(information, (len(z), 1, 1)), CLOSURE_WIDTH)
    return found.take(np.flatnonzero(apart))


def _nearest(keys: Ints, at: Ints) -> Ints:
    """Return which of the rising keys (m,) is nearest to each instant (k, 2)."""
    after = np.clip(np.searchsorted(keys, at), 1, len(keys) - 1)
    nearest: Ints = np.where(at - keys[after - 1] <= keys[after] - at, after - 1, after)
    return nearest
