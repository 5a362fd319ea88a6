"""The range that a driver writes for no return, if that is not NaN, not Inf and not beyond range_max.

Many drivers write one fixed range, such as 50 m, and say range_max = 80 m. Read as walls, these beams draw an arc
round the robot that goes with it. Ranges of a wall scatter: hardly two of the longest are the same number.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from locfuse.fusion.data import Array

from .scans import Laser

T = TypeVar("T")

MIN_REPEATS = 20  # of the longest range of a log: fewer may be chance, and draw nothing
NEAR = 0.99  # of the longest range: where the ranges of the same wall would lie
CROWD = 3  # times as many readings of the longest range itself as near it: no wall is so exact


class Longest:
    """The longest range of a stream of scans, and how often it is read."""

    def __init__(self) -> None:
        self.value = 0.0  # m
        self.count = 0  # of readings of exactly this
        self._near = 0  # of readings up to a hundredth shorter
        self._read = 0

    def add(self, ranges: Array, far: Array) -> None:
        """Count the ranges (k, b) [m] of k scans that lie within range_max `far` (k,) [m]."""
        if not ranges.size:
            return
        self._read += ranges.size
        longest = float(ranges.max())
        if not longest <= far.min():  # NaN, Inf, or ranges beyond range_max: no wall is there
            ranges = np.where(ranges <= far[:, None], ranges, 0.0)
            longest = float(ranges.max())
        if longest < NEAR * self.value or longest <= 0.0:
            return
        if longest > self.value:
            self._near = self._near + self.count if self.value >= NEAR * longest else 0
            self.value, self.count = longest, 0
        equal = int(np.count_nonzero(ranges == self.value))
        self.count += equal
        self._near += int(np.count_nonzero(ranges >= NEAR * self.value)) - equal

    @property
    def no_return(self) -> float | None:
        """The range [m] that means no return; None if the longest range is a wall's."""
        repeated = self.count >= MIN_REPEATS and self.count > CROWD * self._near
        return self.value if repeated else None

    @property
    def note(self) -> str:
        """The note on ranges that were read as no return."""
        share = self.count / self._read
        return (
            f"{share:.{0 if share > 0.02 else 1}%} of its ranges are exactly {self.value:g} m, the longest: "
            f"read as no return (to keep them: --set lrf.range_max={np.ceil(self.value):g})"
        )


def left_out(laser: Laser, read: Callable[[Laser, Longest], T]) -> tuple[T, Laser, tuple[str, ...]]:
    """Read scans, and again without the range that means no return if there is one; with the laser and a note.

    Not where `laser` says how far it sees: then the user has decided. `read` shows all ranges to what it is given.
    """
    longest = Longest()
    found = read(laser, longest)
    if laser.range_max is not None or longest.no_return is None:
        return found, laser, ()
    laser = laser._replace(range_max=float(np.nextafter(longest.no_return, 0.0)))
    return read(laser, Longest()), laser, (longest.note,)
