"""What the user chose, on the command line or in Python: how to read a log, and which outputs to write.

Every command imports this for its options, so NumPy is imported inside the functions that need what needs it.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

PathLike = str | os.PathLike[str]
Sets = Mapping[str, Any] | Iterable[str]  # {"lrf.topic": "/scan"}, or as typed: ["lrf.topic=/scan"]
Progress = Callable[[str], None]  # is given the name of the current step
MAX_REFERENCE_INSTANTS = 2400  # of a drive whose reference is solved unasked: four minutes of a 10 Hz laser
OF_COMPARISON = ("html", "md", "json", "tum", "csv", "tex")  # kinds of output
OF_RUN = ("tum", "csv", "json")
PRESETS = ("default", "paper")
ORDERS = ("auto", "stamp", "recorded")


def silent(step: str) -> None:
    """Show no progress."""


class LogOptions(msgspec.Struct, frozen=True):
    """How to read a log."""

    robot: Path | None
    sets: tuple[str, ...]
    order: str | None
    strict: bool
    quiet: bool
    preset: str | None = None
    begin: float | None = None  # s since the first wheel reading: only what comes later is used
    end: float | None = None  # s: only what comes earlier
    hash_all: bool = False  # hash every byte of the log for the report
    over: tuple[Path, ...] = ()  # more robot.toml files, merged over `robot`, later ones over earlier ones

    @property
    def robot_files(self) -> tuple[Path, ...]:
        """Every robot.toml in the order in which they are merged."""
        return () if self.robot is None else (self.robot, *self.over)


class MapOptions(msgspec.Struct, frozen=True):
    """Which map the laser is given, and where the map that it made goes."""

    given: Path | None
    save: Path | None

    def check(self, sensors: tuple[str, ...]) -> None:
        """Raise UsageError where maps are asked of a run without a laser."""
        from locfuse.fusion.data import UsageError

        asked = "--map" if self.given is not None else "--save-map" if self.save is not None else None
        if (
            asked == "--save-map"
            and "landmarks" in sensors
            and self.save is not None
            and self.save.suffix == ".csv"
        ):
            return
        if asked and "lrf" not in sensors:
            raise UsageError(f"{asked}: only the laser has a map; add lrf to --sensors")


def log_options(robot: PathLike | None, sets: Sets | None, order: str | None, preset: str | None) -> LogOptions:
    """Return the options of a log as Python gives them. Raises UsageError for what cannot be one."""
    from locfuse.fusion.data import UsageError

    for what, word, known in (("order", order, ORDERS), ("preset", preset, PRESETS)):
        if word is not None:
            one_of(word, known, what)
    file = None if robot is None else path_of(robot)
    if file is not None and not file.is_file():
        raise UsageError(f"robot: {file} is no file; make one with: locfuse init LOG > robot.toml")
    return LogOptions(file, set_words(sets), order, strict=False, quiet=True, preset=preset)


def set_words(sets: Sets | None) -> tuple[str, ...]:
    """Return settings as the words of --set: {"lrf.x": 0.2} is "lrf.x=0.2"."""
    if sets is None:
        return ()
    if isinstance(sets, Mapping):
        return tuple(word for key, value in sets.items() for word in _words(key, value))
    return (sets,) if isinstance(sets, str) else tuple(sets)


def _words(key: str, value: Any) -> list[str]:
    """Return one setting, or those of a table."""
    from locfuse.formats.robot.robot_toml import as_set

    if isinstance(value, Mapping):
        return [word for below, inner in value.items() for word in _words(f"{key}.{below}", inner)]
    return [as_set(key, os.fspath(value) if isinstance(value, os.PathLike) else value)]


def path_of(path: PathLike) -> Path:
    """Return a path with ~ as the user's home, which the shell replaces on a command line."""
    return Path(path).expanduser()


def words_of(log: PathLike | Sequence[PathLike]) -> list[str]:
    """Return one log, or the parts of one, as the words of a command line. Raises UsageError for none."""
    from locfuse.formats.container.url import is_url
    from locfuse.fusion.data import UsageError

    parts = [log] if isinstance(log, str | os.PathLike) else list(log)
    if not parts:
        raise UsageError("which log? An empty list names none")
    return [part if isinstance(part, str) and is_url(part) else str(path_of(part)) for part in parts]


def one_of(word: str, known: Sequence[str], what: str) -> str:
    """Return a word as it is. Raises UsageError for one that is not known."""
    from locfuse.fusion.data import UsageError

    if word not in known:
        raise UsageError(f"{what} = {word!r}: choose from {', '.join(known)}")
    return word


def chosen(
    kinds: str | Iterable[str] | None, known: Sequence[str], what: str = "--write: unknown output"
) -> set[str]:
    """Return kinds of output ("json,tum", or a list), None for all. Raises UsageError for an unknown one."""
    from locfuse.fusion.data import UsageError

    if kinds is None:
        return set(known)
    names = {name.strip() for name in (kinds.split(",") if isinstance(kinds, str) else kinds) if name.strip()}
    if unknown := sorted(names - set(known)):
        raise UsageError(f"{what} {unknown[0]!r}; choose from {', '.join(known)}")
    return names
