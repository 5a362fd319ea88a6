"""The word that somebody probably meant."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

SIMILAR = 0.6  # of difflib's ratio: one letter in three may be wrong


def nearest(word: str, known: Iterable[str]) -> str | None:
    """Return the known word most like this one, None where none is like it."""
    by_lower = {one.lower(): one for one in known}
    found = difflib.get_close_matches(word.lower(), by_lower, 1, SIMILAR)
    return by_lower[found[0]] if found else None


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return "did you mean X?", or "" where nothing is like it."""
    found = nearest(word, known)
    return f"did you mean {found}?" if found else ""
