"""Spelling suggestions for unknown words."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

MIN_SIMILARITY = 0.6  # of difflib's ratio: about one letter in three may differ
MIN_PART, MAX_NAMED = 3, 4  # least letters of a word to search for in others; most words in a suggestion


def nearest(word: str, known: Iterable[str]) -> str | None:
    """Return the most similar known word; None if no word is similar."""
    by_lower = {one.lower(): one for one in known}
    found = difflib.get_close_matches(word.lower(), by_lower, 1, MIN_SIMILARITY)
    return by_lower[found[0]] if found else None


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return "did you mean X or Y?" with the known words that contain `word`; "" if none is similar.

    If no known word contains `word`, X is the most similar one.
    """
    known = list(known)
    holding = [one for one in known if len(word) >= MIN_PART and word.lower() in one.lower()][:MAX_NAMED]
    like = nearest(word, known)
    found = holding or ([like] if like else [])
    return f"did you mean {' or '.join(filter(None, (', '.join(found[:-1]), found[-1])))}?" if found else ""
