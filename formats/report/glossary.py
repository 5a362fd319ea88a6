"""Glossary of a report: shown at the end of report.html, and by `locfuse explain TERM`."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Mapping, Sequence
from importlib.resources import files

GLOSSARY: Mapping[str, str] = tomllib.loads((files(__package__) / "glossary.toml").read_text(encoding="utf-8"))


def explained(term: str) -> str | None:
    """Return the explanation of a term such as "anees" (upper or lower case); None for an unknown term."""
    wanted = term.strip().lower()
    by_lower = {name.lower(): words for name, words in GLOSSARY.items()}
    return next((words for name, words in by_lower.items() if wanted in {name, *_names(name)}), None)


def similar(term: str) -> Sequence[str]:
    """Return glossary terms with similar spelling; all terms if none is similar."""
    known = {name.lower(): name for names in GLOSSARY for name in _names(names)}
    return [known[name] for name in difflib.get_close_matches(term.lower(), known, n=3)] or [*known.values()]


def _names(entry: str) -> list[str]:
    return entry.split(", ")
