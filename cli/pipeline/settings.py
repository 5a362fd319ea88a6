"""How to read a log, as the user said it: the options that every command shares."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class LogOptions:
    """How to read a log."""

    robot: Path | None
    sets: tuple[str, ...]
    order: str | None
    strict: bool
    quiet: bool
    preset: str | None = None
