"""Values by name, such as estimates by configuration: a name that is not there gets an error with the nearest."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping
from typing import TypeVar

from locfuse.fusion.data import UsageError

V = TypeVar("V")


class UnknownNameError(UsageError, KeyError):
    """No value has this name. A KeyError too, as every mapping's, and yet one readable line."""

    __str__ = Exception.__str__


class Named(Mapping[str, V]):
    """A read-only mapping; `what` says what its values are."""

    def __init__(self, what: str, values: Mapping[str, V]) -> None:
        self._what, self._values = what, dict(values)

    def __getitem__(self, name: str) -> V:
        """Return a value. Raises UnknownNameError."""
        if name in self._values:
            return self._values[name]
        near = difflib.get_close_matches(str(name), self._values, 1)
        hint = f"; did you mean {near[0]}?" if near else "."
        known = ", ".join(self._values) or "none"
        raise UnknownNameError(f"no {self._what} {name!r} in this result{hint} There are: {known}")

    def __iter__(self) -> Iterator[str]:
        """Yield the names in order."""
        return iter(self._values)

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self._values)

    def __repr__(self) -> str:
        """Return the names: values are long columns."""
        return f"<{len(self)} by {self._what}: {', '.join(self)}>"

    def _ipython_key_completions_(self) -> list[str]:
        """Return the names for `result.estimates["<TAB>`."""
        return list(self)
