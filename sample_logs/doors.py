"""Open doors: the leaves that stand in a room."""

from __future__ import annotations

import math

import numpy as np

from locfuse.fusion.data import Array

from .building import Building
from .masonry import ends


def leaves(building: Building) -> Array:
    """Return the open leaves of doors, (k, 4) m, map frame: hinged at the lower end, on the face of the space."""
    found = []
    for space in building.spaces:
        for opening in (o for o in space.openings if o.kind == "door" and o.leaf_deg):
            (low, high), inward = ends(space, opening)
            hinge = low + building.wall / 2 * inward
            closed_leaf, angle = high - low, math.radians(opening.leaf_deg)
            tip = hinge + math.cos(angle) * closed_leaf + math.sin(angle) * opening.width * inward
            found.append(np.concatenate((hinge, tip)))
    return np.array(found).reshape(-1, 4)
