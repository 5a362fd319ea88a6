"""Arrays as the form of the core that runs wants them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from itertools import chain
from types import ModuleType
from typing import Any, NamedTuple, cast

import numpy as np

from locfuse.fusion.data import Array, Ints

from .form import form


class Room(NamedTuple):
    """NumPy's arrays where the core is compiled, lists where it is interpreted: ten times faster there."""

    functions: Any  # of one file of the core
    floats: Callable[[int], Any]  # room for so many numbers
    wholes: Callable[[int], Any]
    given: Callable[[Array], Any]  # a matrix, row by row
    given_wholes: Callable[[Array], Any]
    flat: Callable[[Sequence[Sequence[float]]], Any]  # rows of plain floats
    listed: Callable[[Any, int], list[float]]  # the first numbers of what the core wrote
    on_arrays: Any  # functions that work on arrays as they lie in memory, in either form

    @classmethod
    def of(cls, source: ModuleType, unit: ModuleType | None) -> Room:
        """Return the room for the compiled unit, or for the source (None)."""
        if unit is None:
            of_lists = _list, lambda n: [0] * n, _listed, _listed, _chained, lambda a, n: a[:n]
            return cls(source, *of_lists, OnViews(source))
        return cls(unit, np.empty, _wholes, _array, _whole_array, _row, lambda a, n: a[:n].tolist(), unit)

    def beside(self, source: ModuleType) -> Room:
        """Return the room of the same form for another file of the core."""
        return _interpreted(source) if isinstance(self.on_arrays, OnViews) else self

    def __deepcopy__(self, memo: object) -> Room:
        """Return the same: whoever copies a belief wants no second core."""
        return self

    @classmethod
    def here(cls, source: ModuleType) -> Room:
        """Return the room for the form that runs in this process."""
        return _here(source)


@cache
def _interpreted(source: ModuleType) -> Room:
    return Room.of(source, None)


@cache
def _here(source: ModuleType) -> Room:
    return Room.of(source, form().functions)


class OnViews:
    """Interpreted functions on the memory of NumPy's arrays, whose own numbers are ten times slower."""

    def __init__(self, source: ModuleType) -> None:
        self._source = source

    def __getattr__(self, name: str) -> Callable[..., Any]:
        """Return a function of the source that takes arrays."""
        function = getattr(self._source, name)
        return lambda *given, **named: function(
            *[_viewed(a) for a in given], **{name: _viewed(a) for name, a in named.items()}
        )


def _viewed(value: Any) -> Any:
    return memoryview(cast("Any", value)) if isinstance(value, np.ndarray) else value


def _list(n: int) -> list[float]:
    return [0.0] * n


def _wholes(n: int) -> Ints:
    return np.empty(n, np.intp)


def _listed(values: Array) -> list[float]:
    numbers: list[float] = values.ravel().tolist()
    return numbers


def _array(values: Array) -> Array:
    return np.ascontiguousarray(values, np.float64).ravel()


def _whole_array(values: Array) -> Ints:
    return np.ascontiguousarray(values, np.intp).ravel()


def _chained(rows: Sequence[Sequence[float]]) -> list[float]:
    return list(chain.from_iterable(rows))


def _row(rows: Sequence[Sequence[float]]) -> Array:
    return np.array(rows, np.float64).ravel()
