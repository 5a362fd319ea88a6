r"""Escaping of text from a log: all of it passes here before a terminal, a .md or a .html.

Whoever names a topic or a frame can else set the title of a window, clear the screen, or write over a line. What
acts on the thing that shows it stands for itself instead, as \x1b or \u202e.
"""

from __future__ import annotations

import re

# C0 and C1 controls and DEL; marks that turn the direction of a line (U+061C, U+200E, U+200F, U+202A to U+202E,
# U+2066 to U+2069); U+2028 and U+2029, which end one; U+FEFF; half a surrogate pair, which no encoding can write
_ACTING = r"\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ufeff"
_HALF = r"\ud800-\udfff"
UNSEEN = re.compile(rf"[\x00-\x1f{_ACTING}{_HALF}]")
UNSEEN_IN_JSON = re.compile(rf"[{_ACTING}]")
HALF = re.compile(rf"[{_HALF}]")


def visible(text: str) -> str:
    """Return one line of text without control characters; escaped text is unchanged."""
    return text if text.isascii() and text.isprintable() else UNSEEN.sub(_shown, text)


def visible_lines(text: str) -> str:
    """Return several lines escaped, with our own line ends."""
    return "\n".join(visible(line) for line in text.split("\n"))


def writable(text: str) -> str:
    r"""Return text that UTF-8 can encode: an invalid byte of a file name becomes an escape in letters."""
    return text if text.isascii() else HALF.sub(_shown, text)


def escaped(text: str) -> str:
    """Return JSON or TOML with the same values, without characters that act on a terminal."""
    return text if text.isascii() and "\x7f" not in text else UNSEEN_IN_JSON.sub(_unicode, text)


def _shown(found: re.Match[str]) -> str:
    code = ord(found[0])
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}"


def _unicode(found: re.Match[str]) -> str:
    return f"\\u{ord(found[0]):04x}"
