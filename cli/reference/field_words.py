"""The words beside a field: the comment on its line in the source, which says its unit and what it means."""

from __future__ import annotations

import inspect
import re
import tokenize
from collections.abc import Iterator
from io import StringIO
from typing import Any

FIELD = re.compile(r"\s+(\w+)\s*:")


def field_words(kind: type[Any]) -> dict[str, str]:
    """Return field -> comment of a class and the classes it extends; {} for those without source."""
    words: dict[str, str] = {}
    for part in reversed(kind.__mro__):
        if part.__module__.startswith("locfuse."):
            words |= dict(_commented(part))
    return words


def _commented(kind: type[Any]) -> Iterator[tuple[str, str]]:
    """Yield (field, comment) of every annotated line of a class that ends in a comment."""
    try:
        source = inspect.getsource(kind)
    except (OSError, TypeError):  # shipped without its source
        return
    lines = source.splitlines()
    for token in tokenize.generate_tokens(StringIO(source).readline):
        field = FIELD.match(lines[token.start[0] - 1]) if token.type == tokenize.COMMENT else None
        if field is not None and field.end() < token.start[1]:
            yield field[1], token.string.lstrip("# ")
