"""The quadrature encoder: two square waves a quarter slot apart, counted by a x4 decoder (paper fig. 2).

A rises first when the wheel turns forward, so the four states come in Gray-code order 00, 10, 11, 01.
Each edge is one count; its direction follows from the state before. A decoder that looks too seldom sees
both phases change at once: it cannot know the direction, and reports the transition as missed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from locfuse.fusion.data import Array, Ints

COUNTS_PER_SLOT = 4
MISSED = 2
# STEP[4 * previous + now] with state = 2 A + B
STEP = np.array(
    [
        *(0, -1, +1, MISSED),  # from 00: to 01 backward, to 10 forward
        *(+1, 0, MISSED, -1),  # from 01
        *(-1, MISSED, 0, +1),  # from 10
        *(MISSED, +1, -1, 0),  # from 11
    ],
    dtype=np.int64,
)


class Counted(NamedTuple):
    """The counts of a decoder over phase samples."""

    counts: Ints  # (..., n - 1) count change from sample to sample
    missed: NDArray[np.bool_]  # (..., n - 1) both phases changed: at least two counts are lost


def phases(angle: Array, slots: int) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return the two phases A and B of a disc with `slots` slots at the wheel angles `angle` [rad]."""
    quarter = np.floor(angle * (slots * COUNTS_PER_SLOT / (2 * np.pi))).astype(np.int64) % COUNTS_PER_SLOT
    return (quarter == 1) | (quarter == 2), quarter >= 2


def decode(a: NDArray[np.bool_], b: NDArray[np.bool_]) -> Counted:
    """Decode phase samples (..., n) x4; the last axis is time."""
    state = 2 * a.astype(np.int64) + b
    step = STEP[4 * state[..., :-1] + state[..., 1:]]
    missed = step == MISSED
    return Counted(np.where(missed, 0, step), missed)
