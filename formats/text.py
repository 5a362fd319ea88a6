r"""Text for a reader: control characters are escaped, and unknown words get spelling suggestions.

Control characters in the name of a topic or frame could set the title of a terminal, clear the screen, or
overwrite a line. They are shown as \x1b or \u202e instead.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable

# C0 and C1 controls and DEL; text direction (U+061C, U+200E, U+200F, U+202A to U+202E, U+2066 to U+2069);
# line ends U+2028 and U+2029; U+FEFF; half a surrogate pair, which UTF-8 cannot encode
_ACTING = r"\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ufeff"
_HALF = r"\ud800-\udfff"
UNSEEN = re.compile(rf"[\x00-\x1f{_ACTING}{_HALF}]")
UNSEEN_IN_JSON = re.compile(rf"[{_ACTING}]")
HALF = re.compile(rf"[{_HALF}]")


def visible(text: str) -> str:
    """Return one line of text with control characters escaped; escaped text is unchanged."""
    return text if text.isascii() and text.isprintable() else UNSEEN.sub(_shown, text)


def visible_lines(text: str) -> str:
    """Return text with control characters escaped in every line."""
    return "\n".join(visible(line) for line in text.split("\n"))


def writable(text: str) -> str:
    """Return text that UTF-8 can encode: half a surrogate pair (from an invalid file name) is escaped."""
    return text if text.isascii() else HALF.sub(_shown, text)


def escaped(text: str) -> str:
    """Return JSON or TOML text with equal values, but without characters that a terminal would interpret."""
    if text.isascii() and "\x7f" not in text:
        return text
    return UNSEEN_IN_JSON.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def _shown(found: re.Match[str]) -> str:
    code = ord(found[0])
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}"


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
