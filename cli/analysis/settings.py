"""Options, from the command line or Python: how to read a log, what to compute, what to write.

Every command imports this module, so modules that import NumPy are imported inside functions.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import product
from math import prod
from pathlib import Path
from typing import Any, TypedDict

import msgspec
from msgspec.structs import replace

PathLike = str | os.PathLike[str]
Sets = Mapping[str, Any] | Iterable[str]  # {"lrf.topic": "/scan"}, or as typed: ["lrf.topic=/scan"]
Progress = Callable[[str], None]  # called with the name of the current step
MAX_REFERENCE_INSTANTS = 2400  # longest drive [update times] with a reference by default: 4 min at 10 Hz
OF_COMPARISON = ("html", "md", "json", "tum", "csv", "tex")  # kinds of output
OF_RUN = ("tum", "csv", "json")
DEFAULT_OUTPUTS = ("html", "json", "tum")  # robot.toml and fixes.toml are always written
EXPORTS = {  # formats of other tools
    "mcap": "ROS 2 messages, with layouts for Foxglove and PlotJuggler",
    "log": "these and every message of the log",
    "kitti": "",
    "tum": "",
    "tum-cov": "with covariance",
    "csv": "with covariance",
}
PRESETS = ("default", "paper")
ORDERS = ("auto", "stamp", "recorded")
MAX_JITTERED_RUNS = 1000
MAX_CELLS = 1000  # combinations of a sweep
BETWEEN_VALUES = re.compile(r",(?![^\[{]*[\]}])")  # a comma that is not inside a list or a table
UNFIT_FOR_FOLDER = re.compile(r"[\s/\\]")  # in the name of a folder


def silent(step: str) -> None:
    """Ignore a progress step."""


def _misuse(words: str) -> Exception:
    """Return the UsageError for options or arguments that cannot be used."""
    from locfuse.fusion.data import UsageError

    return UsageError(words)


class LogOptions(msgspec.Struct, frozen=True):
    """Options for reading a log."""

    robots: tuple[Path, ...] = ()  # robot.toml files; later ones override earlier ones
    sets: tuple[str, ...] = ()
    order: str | None = None
    strict: bool = False
    quiet: bool = False
    preset: str | None = None
    begin: float | None = None  # s since the first wheel reading: earlier readings are not used
    end: float | None = None  # s: later readings are not used
    beside_hole: bool = False  # begin and end are not from the user: they leave out a hole in the log
    hash_all: bool = False  # hash every byte of the log for the report
    given_map: Path | None = None  # a map in which the laser localises

    @property
    def words(self) -> list[str]:
        """The words of --robot and --set, as typed."""
        robot = [word for file in self.robots for word in ("--robot", str(file))]
        return [*robot, *(word for setting in self.sets for word in ("--set", setting))]


class Choices(TypedDict, total=False):
    """Keyword arguments of `Session.compare`, with the types of the fields of `Asked`."""

    all_subsets: bool
    align: str
    smooth: bool | None
    jitter: int
    reference: bool | None
    advice: bool
    estimates: Mapping[str, str]
    audits: bool


class Asked(msgspec.Struct, frozen=True):
    """Options of a comparison: configurations, how they are judged, and extra outputs."""

    sensors: tuple[str, ...] = ()  # one --sensors per configuration; (): the default ones
    all_subsets: bool = False
    align: str = "none"
    smooth: bool | None = None  # None: configurations with the laser that can be smoothed
    jitter: int = 0  # runs
    reference: bool | None = None  # a reference replaces a missing truth; None: if the drive is short enough
    advice: bool = True  # fixes are tried
    estimates: Mapping[str, str] = {}  # of other programs: name -> topic or file
    audits: bool = True  # innovation and gate decision of every measurement are kept

    def of_each(self) -> Asked:
        """Return the options for each of many logs: without advice and references, smoothed only if asked.

        Raises UsageError for options that need a single drive.
        """
        for name, source in self.estimates.items():
            raise _misuse(f"--estimate {name}={source}: it is of one drive: compare one log at a time")
        if self.jitter:
            raise _misuse(f"--jitter {self.jitter}: several logs say by themselves what is chance; give one log")
        if self.reference:
            raise _misuse("--reference: it is of one drive: compare one log at a time")
        return replace(self, smooth=bool(self.smooth), reference=False, advice=False, audits=False)


class GateOptions(msgspec.Struct, frozen=True):
    """Options of gates (--fail-if, --baseline, --tolerance), as typed."""

    fail_if: tuple[str, ...] = ()
    baseline: Path | None = None
    tolerance: str = "5%"


class FleetOptions(msgspec.Struct, frozen=True):
    """Options for many logs, in addition to those for a single log."""

    jobs: int = 1  # that run at the same time
    max_failures: int | None = None
    again: bool = False
    each: tuple[str, ...] = ()  # folders
    robot_from: str | None = None
    sweep: tuple[str, ...] = ()  # as typed: "lrf.sigma_range=0.01,0.03"
    cluster: str | None = None

    @property
    def asked(self) -> bool:
        """Whether any option of fleets is given (such as --sweep), so that even a single log is run as a fleet."""
        return bool(self.each or self.robot_from or self.sweep or self.again or self.cluster)


class Outputs(msgspec.Struct, frozen=True):
    """Options for output: kinds of files, formats, folders, and display."""

    out: Path | None = None  # folder; None: locfuse-out/<log name>
    overwrite: bool = False
    write: frozenset[str] = frozenset()  # kinds of output
    export: frozenset[str] = frozenset()  # formats of other tools
    figures: Path | None = None  # folder
    audit: Path | None = None  # .csv
    save_map: Path | None = None
    as_json: bool = False  # the report on stdout
    open: bool = False  # the page in the browser
    verbose: bool = False  # notes and the table of sensors are printed
    rerun: bool = False  # the drive is shown in Rerun
    rerun_save: Path | None = None  # .rrd

    @property
    def recorded(self) -> bool:
        """Whether the drive is recorded for Rerun (else Rerun is not imported)."""
        return self.rerun or self.rerun_save is not None


def log_options(robot: PathLike | None, sets: Sets | None, order: str | None, preset: str | None) -> LogOptions:
    """Return the options for reading a log from Python values. Raises UsageError for invalid ones."""
    for what, word, known in (("order", order, ORDERS), ("preset", preset, PRESETS)):
        if word is not None:
            one_of(word, known, what)
    file = None if robot is None else path_of(robot)
    if file is not None and not file.is_file():
        raise _misuse(f"robot: {file} is no file; make one with: locfuse init LOG > robot.toml")
    return LogOptions(() if file is None else (file,), set_words(sets), order, quiet=True, preset=preset)


def set_words(sets: Sets | None) -> tuple[str, ...]:
    """Return settings as the words of --set: {"lrf.x": 0.2} is "lrf.x=0.2"."""
    if sets is None:
        return ()
    if isinstance(sets, Mapping):
        return tuple(word for key, value in sets.items() for word in _words(key, value))
    return (sets,) if isinstance(sets, str) else tuple(sets)


def _words(key: str, value: Any) -> list[str]:
    """Return the words of --set for one key, or for each key of a table."""
    from locfuse.formats.robot.robot_toml import as_set

    if isinstance(value, Mapping):
        return [word for below, inner in value.items() for word in _words(f"{key}.{below}", inner)]
    return [as_set(key, os.fspath(value) if isinstance(value, os.PathLike) else value)]


def path_of(path: PathLike) -> Path:
    """Return a path with ~ replaced by the user's home (on a command line the shell does this)."""
    return Path(path).expanduser()


def words_of(log: PathLike | Sequence[PathLike]) -> list[str]:
    """Return the paths of one log or of its parts as command-line words. Raises UsageError for an empty list."""
    from locfuse.formats.container.file_bytes import is_url

    parts = [log] if isinstance(log, str | os.PathLike) else list(log)
    if not parts:
        raise _misuse("which log? An empty list names none")
    return [part if isinstance(part, str) and is_url(part) else str(path_of(part)) for part in parts]


def one_of(word: str, known: Sequence[str], what: str) -> str:
    """Return a word if it is known. Raises UsageError for an unknown one."""
    if word not in known:
        raise _misuse(f"{what} = {word!r}: choose from {', '.join(known)}")
    return word


def check_jitter(runs: int) -> int:
    """Return the number of jittered runs. Raises UsageError unless it is in 0..MAX_JITTERED_RUNS."""
    if not 0 <= runs <= MAX_JITTERED_RUNS:
        raise _misuse(f"--jitter {runs}: give a number of runs from 1 to {MAX_JITTERED_RUNS}")
    return runs


def by_default(known: Sequence[str]) -> list[str]:
    """Return the kinds among `known` that are written by default; all of `known` if it has no html."""
    return [kind for kind in known if kind in DEFAULT_OUTPUTS or "html" not in known]


def chosen(
    kinds: str | Iterable[str] | None, known: Sequence[str], what: str = "--write: unknown output"
) -> set[str]:
    """Return kinds of output from "json,tum", "all" or a list; the default ones for None.

    Raises UsageError for an unknown one.
    """
    if kinds is None:
        return set(by_default(known))
    names = {name.strip() for name in (kinds.split(",") if isinstance(kinds, str) else kinds) if name.strip()}
    if "all" in names:
        return set(known)
    if unknown := sorted(names - set(known)):
        raise _misuse(f"{what} {unknown[0]!r}; choose from {', '.join(known)}")
    return names


def swept(words: Sequence[str]) -> dict[str, list[str]]:
    """Return the values of --sweep by key, as words of --set: "a.x=1,2" gives {"a.x": ["a.x=1", "a.x=2"]}."""
    found: dict[str, list[str]] = {}
    for word in words:
        key, equals, values = word.partition("=")
        if not equals or not key.strip() or not values.strip():
            raise _misuse(f'--sweep {word!r}: write it like "lrf.sigma_range=0.01,0.03,0.1"')
        if key.strip() in found:
            raise _misuse(f"--sweep {key.strip()} is given twice: name all its values in one")
        parts = [value.strip() for value in BETWEEN_VALUES.split(values)]
        found[key.strip()] = [f"{key.strip()}={value}" for value in parts if value]
    return found


def cells(sets: Mapping[str, Sequence[str]]) -> dict[str, tuple[str, ...]]:
    """Return the words of --set for every combination of swept values, by the combination's name.

    Raises UsageError for more than MAX_CELLS, and for a value that cannot be part of a folder's name.
    """
    for word in (word for words in sets.values() for word in words):
        if UNFIT_FOR_FOLDER.search(word):
            raise _misuse(f"--sweep {word!r}: a value with blanks or slashes cannot name a folder")
    count = prod(len(words) for words in sets.values())
    if count > MAX_CELLS:
        raise _misuse(f"--sweep: {count} combinations, more than {MAX_CELLS}; sweep fewer values")
    return {" ".join(combination): combination for combination in product(*sets.values())}
