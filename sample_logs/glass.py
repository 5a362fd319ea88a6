"""Glass walls: their panes and posts, and which laser beams a pane returns."""

from __future__ import annotations

import math

import numpy as np

from locfuse.fusion.data import Array

from .building import Building, Glass
from .furniture import CORNERS, closed
from .masonry import ends


def panes(building: Building) -> Array:
    """Return the panes of all glass openings, (g, 4) m, map frame; they reach into the walls beside them."""
    found = []
    for wall in glass_walls(building):
        along = (wall[1] - wall[0]) / np.hypot(*(wall[1] - wall[0]))
        found.append(np.concatenate((wall[0] - building.bow * along, wall[1] + building.bow * along)))
    return np.array(found).reshape(-1, 4)


def posts(building: Building) -> Array:
    """Return the sides of the posts between panes, (4 k, 4) m: solid, square."""
    squares = []
    for begin, end in glass_walls(building):
        n = math.ceil(float(np.hypot(*(end - begin))) / building.glass.post_every)
        middles = [begin + (end - begin) * i / n for i in range(1, n)]
        squares += [building.glass.post * CORNERS + middle for middle in middles]
    return closed(squares)


def glass_walls(building: Building) -> list[Array]:
    """Return both ends of every glass opening, each (2, 2) m, map frame."""
    return [ends(s, o)[0] for s in building.spaces for o in s.openings if o.kind == "glass"]


def returned(distance: Array, pane: Array, direction: Array, glass: Glass, chance: Array) -> Array:
    """Return the distances (n, g) with inf where the pane lets the beam pass.

    Args:
        distance: (n, g) m, of every ray to every pane, inf for a miss.
        pane: (g, 4) m, map frame.
        direction: (n, 2) of the rays, unit length.
        glass: how near to the normal, and how often, a pane returns a beam.
        chance: (n, g) uniform in [0, 1).
    """
    along = pane[:, 2:] - pane[:, :2]
    normal = np.stack((-along[:, 1], along[:, 0]), axis=-1) / np.hypot(along[:, 0], along[:, 1])[:, None]
    steep = np.abs(direction @ normal.T) >= math.cos(math.radians(glass.within_deg))
    return np.where(steep & (chance < glass.returns), distance, np.inf)
