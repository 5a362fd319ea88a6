"""What the core works on, interpreted: plain objects with the columns of its tables."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

N, FRAME = 14, 4  # states; the first column of the map frame, where there is one
REFUSED, GATE = 1.0, 6.6


def table(**columns: Any) -> Any:
    """Any object that has these."""
    return SimpleNamespace(**columns)


def believed(seed: int, frame: int = -1, kept: tuple[int, ...] = ()) -> Any:
    """A belief of N states, all of which are correlated; some may be considered."""
    rng = np.random.default_rng(seed)
    root = 0.1 * rng.normal(size=(N, N))
    P, chosen = root @ root.T + 1e-3 * np.eye(N), np.isin(np.arange(N), kept)
    return table(x=rng.normal(size=N), P=P, n=N, frame=frame, kept=chosen, some=bool(kept))
