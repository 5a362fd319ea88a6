"""Spelling suggestions for unknown words."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

SIMILAR = 0.6  # of difflib's ratio: one letter in three may be wrong
MIN_PART, MAX_NAMED = 3, 4  # letters of a part of a word that says something; words named at once


def nearest(word: str, known: Iterable[str]) -> str | None:
    """Return the known word most similar to this one, None without a similar one."""
    by_lower = {one.lower(): one for one in known}
    found = difflib.get_close_matches(word.lower(), by_lower, 1, SIMILAR)
    return by_lower[found[0]] if found else None


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return "did you mean X or Y?" with the words that contain this one, else the most similar; "" for none."""
    known = list(known)
    holding = [one for one in known if len(word) >= MIN_PART and word.lower() in one.lower()][:MAX_NAMED]
    like = nearest(word, known)
    found = holding or ([like] if like else [])
    return f"did you mean {' or '.join(filter(None, (', '.join(found[:-1]), found[-1])))}?" if found else ""
