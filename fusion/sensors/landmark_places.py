"""Where detections place their landmarks, and which entries of a map that contradicts."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from locfuse.fusion.chi_square import MAD
from locfuse.fusion.data import Array

from .landmark_geometry import Point
from .points import MIN_JUDGED

MAX_WRONG = 20  # notes on them
WRONG_SIGMAS = 3.0  # of one detection's place: the median of many is much better known than that


def wrong_places(places: Mapping[int, Point], seen_at: Mapping[int, Array]) -> list[str]:
    """Return in words which landmarks stand elsewhere than in the map, by where detections (n, 3) place them.

    A row is x, y and its standard deviation [m]. A landmark is wrong where the median lies further from its entry
    than WRONG_SIGMAS of one detection, and two such are swapped where each lies that near the other's entry.
    """
    median = {key: np.median(rows, axis=0) for key, rows in seen_at.items() if len(rows) >= MIN_JUDGED}
    reach = {key: WRONG_SIGMAS * max(float(v[2]), _scatter(seen_at[key])) for key, v in median.items()}

    def away(key: int, entry: int) -> float:
        return math.hypot(median[key][0] - places[entry][0], median[key][1] - places[entry][1])

    wrong = sorted(key for key in median if away(key, key) > reach[key])
    if len(wrong) > 2 and 2 * len(wrong) > len(median):
        return [f"{len(wrong)} of {len(median)} landmarks are seen elsewhere than in the map: is [start] right?"]
    words, paired = [], set[int]()
    for a in wrong:
        for b in wrong:
            if a < b and away(a, b) < reach[a] and away(b, a) < reach[b]:
                words.append(f"ids {a} and {b} look swapped in the map: each is seen where the other should stand")
                paired |= {a, b}
    for key in wrong:
        if key not in paired:
            x, y, _ = median[key]
            words.append(
                f"id {key} is seen at ({x:.2f}, {y:.2f}) m, {away(key, key):.2f} m from its place in the map "
                f"({len(seen_at[key])} detections)"
            )
    left = len(words) - MAX_WRONG
    return [*words[:MAX_WRONG], f"{left} more notes of this kind"] if left > 0 else words


def _scatter(rows: Array) -> float:
    """Return the robust standard deviation per axis of places (n, 3) [m]."""
    return float(np.median(np.abs(rows[:, :2] - np.median(rows[:, :2], axis=0)), axis=0).max()) / MAD
