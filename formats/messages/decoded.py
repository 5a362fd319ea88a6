"""What a decoder of messages gives, whatever the encoding."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from locfuse.fusion.data import Column, Ints

from .schema import Record


class Decoded(NamedTuple):
    """The messages of one channel in one batch, as columns of those that could be read."""

    good: NDArray[np.bool_]  # (k,) which of the messages are rows
    columns: dict[str, Column]
    bad: Counter[str]  # reason -> messages that are not


class MessageDecoder(Protocol):
    """Columns out of the messages of one type. Which messages are good must not depend on the fields."""

    message: Record
    fast: int  # messages decoded together with others
    general: int  # messages decoded by themselves

    def decode(self, data: NDArray[np.uint8], start: Ints, length: Ints, fields: Sequence[str]) -> Decoded:
        """Return the fields of the messages that lie at data[start[i] : start[i] + length[i]]."""
