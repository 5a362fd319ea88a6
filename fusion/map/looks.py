"""Looks from the map at hand at the frozen ones: a loop is closed only where several looks tell the same place."""

from __future__ import annotations

import math

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array

from .anchors import Anchors
from .closing import Closure

SAME = 11.3  # chi-square with 3 degrees of freedom at 99 %, within which two looks tell the same place
AGREEING, UNKNOWN = 2, 3  # looks that must agree; where nothing tells where the map lies
INSISTING = 5  # looks that agree, after which it is the way between that was worse than it claimed
OPEN_XY, OPEN_THETA = 1.5, math.radians(20.0)  # m, rad: standard deviations beyond which a place is not known
LONG = 15.0  # m of walls that a place must explain where nothing else tells it
ELSEWHERE = 2.0  # m between places of one map that are not the same


class Looks:
    """What was found of the map at hand in each frozen map, one look after another."""

    def __init__(self) -> None:
        self._found: dict[int, tuple[Closure, int]] = {}  # anchor -> the last look, how many agree with it

    def count(self, anchor: int) -> int:
        """Return how many looks agree on where the map lies in that of an anchor."""
        return self._found[anchor][1] if anchor in self._found else 0

    def agree(self, anchor: int, found: Closure | None, unknown: bool, anchors: Anchors) -> bool:
        """Take in a look at the map of an anchor, and return whether it may close a loop.

        Where nothing else tells where the map at hand lies, more is asked: long walls, one more look, and that it
        is not seen in another map at another place.
        """
        if found is None or (unknown and found.length < LONG):
            self._found.pop(anchor, None)
            return False
        before, looks = self._found.get(anchor, (found, 0))
        self._found[anchor] = found, looks + 1 if _same(before, found) else 1
        if not unknown:
            return self.count(anchor) >= AGREEING
        return self.count(anchor) >= UNKNOWN and not self._rivalled(anchor, anchors)

    def _rivalled(self, anchor: int, anchors: Anchors) -> bool:
        """Return whether the map at hand may also lie elsewhere, by what was seen of it in other maps."""
        places = {k: se2.compose(anchors.pose[k], found.pose) for k, (found, _) in self._found.items()}
        x, y, _ = places[anchor].tolist()
        return any(math.hypot(place[0] - x, place[1] - y) > ELSEWHERE for place in places.values())


def _same(one: Closure, other: Closure) -> bool:
    """Return whether two looks tell the same place, by what each leaves open."""
    step = other.pose - one.pose
    step[2] = se2.wrap(float(step[2]))
    return bool(step @ np.linalg.solve(one.P + other.P, step) < SAME)


def is_open(P: Array) -> bool:
    """Return whether a relative pose of covariance P (3, 3) is not known, as where a lost robot began a map."""
    return float(P[0, 0] + P[1, 1]) > OPEN_XY**2 or float(P[2, 2]) > OPEN_THETA**2
