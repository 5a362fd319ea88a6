"""Rerun's archetypes and views, written down now and made later.

Who draws a recording still holds the drive and all its estimates, and Rerun's import takes as much memory again.
So drawing notes which archetype is made of which values, and `made` makes them when the estimates are gone.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple

__all__ = ["Call", "Name", "made", "rr", "rrb"]


class Name:
    """A module of Rerun or something in it; to call it notes the call."""

    def __init__(self, module: str, *parts: str) -> None:
        self._module, self._parts = module, parts

    def __getattr__(self, part: str) -> Name:
        """Return what has this name in it."""
        return Name(self._module, *self._parts, part)

    def __call__(self, *args: Any, **named: Any) -> Call:
        """Note a call with these arguments, which may be noted ones themselves."""
        return Call(self, args, named)

    def found(self) -> Any:
        """Return it. Imports Rerun."""
        found: Any = import_module(self._module)
        for part in self._parts:
            found = getattr(found, part)
        return found


class Call(NamedTuple):
    """A call of something in Rerun."""

    of: Name
    args: tuple[Any, ...]
    named: dict[str, Any]


if TYPE_CHECKING:  # types are checked as if it were Rerun itself
    import rerun as rr
    import rerun.blueprint as rrb
else:
    rr, rrb = Name("rerun"), Name("rerun.blueprint")


def made(value: Any) -> Any:
    """Return what was written down, made; lists, tuples and dicts hold such things too."""
    if isinstance(value, Name):
        return value.found()
    if isinstance(value, Call):
        return made(value.of)(*made(value.args), **made(value.named))
    if isinstance(value, dict):
        return {key: made(one) for key, one in value.items()}
    if type(value) in {list, tuple}:
        return type(value)(made(one) for one in value)
    return value
