"""The robot.toml of `init`: the result of `inspect_log` as lines with comments."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from msgspec.structs import replace

from locfuse.cli.analysis.robot_tables import ATTACHMENT, flat, make_robot, table_types
from locfuse.cli.analysis.settings import LogOptions, set_words
from locfuse.formats.container.url import Place
from locfuse.formats.robot import robot_toml
from locfuse.formats.robot.commented_toml import TomlSection
from locfuse.fusion.checks.clocks import OPEN_CLOCK
from locfuse.fusion.checks.finding import Finding
from locfuse.fusion.checks.laser import OPEN_SCALE
from locfuse.fusion.data import LocfuseError

from .inspect_log import inspect_log
from .known_robots import open_figures, recognise
from .robot_facts import Overview
from .template_tables import Facts, Known, found, lines

MAX_ROUNDS = 4  # a fix may bring out what could not be seen before
MEASURED_CODES = {
    "lag",
    "noise",
    "range scale",
    "track",
    "yaw",
}  # findings whose fix is right even where they change little
GUESS = "guess: "
GUESSED_CODES = {"choice", "unusable", "truth?"}  # nothing was measured: the first that fits


class Draft(NamedTuple):
    """The tables of a robot.toml, and the missing settings."""

    overview: Overview  # with all active fixes
    sections: list[TomlSection]
    missing: list[str]  # keys without which nothing runs, or not their sensor
    guesses: list[str]  # "key=value: why" of choices that the log leaves open
    robot: str = ""  # which known robot gave figures, in words


def draft(
    paths: Sequence[Place],
    how: LogOptions,
    progress: Callable[[str], None] = lambda step: None,
    said: Mapping[str, Mapping[str, Any]] | None = None,
) -> Draft:
    """Inspect a log until no fix changes anything, and return the final settings.

    `said` are tables that another program's configuration gives, by the name of its file.
    """
    words = [word for tables in (said or {}).values() for word in set_words(tables)]
    typed, how = how, replace(how, sets=(*words, *how.sets))
    overview = inspect_log(paths, how, progress)
    given = _given(overview, typed, said or {})
    fixes: dict[str, tuple[str, str]] = {}  # key -> "key=value", why
    robot, shown = "", _fixes(filter(_certain, overview.findings))
    if (known_robot := recognise(overview)) is not None:
        fixes = open_figures(known_robot, overview, {*given, *shown, *found(overview)})
        robot = f"this robot is a {known_robot.name} ({known_robot.sign})" if fixes else ""
        overview = _with(fixes, paths, how, progress) if fixes else overview
    for _ in range(MAX_ROUNDS):
        new = {key: fix for key, fix in _fixes(filter(_certain, overview.findings)).items() if key not in given}
        if new.items() <= fixes.items():
            break
        fixes |= new
        overview = _with(fixes, paths, how, progress)
    known = {**found(overview), **_read(fixes), **given}
    suggested = _read({key: fix for key, fix in _fixes(overview.findings).items() if key not in fixes})
    facts = Facts(overview, known, suggested)
    missing: list[str] = []
    sections = [TomlSection(name, tuple(lines(facts, name, missing))) for name in ("", *table_types())]
    guesses = [f"{fix} ({why.removeprefix(GUESS)})" for fix, why in fixes.values() if why.startswith(GUESS)]
    return Draft(overview, sections, missing, guesses, robot)


def _with(
    fixes: Mapping[str, tuple[str, str]], paths: Sequence[Place], how: LogOptions, progress: Callable[[str], None]
) -> Overview:
    """Inspect the log again under these settings."""
    return inspect_log(paths, replace(how, sets=(*how.sets, *(fix for fix, _ in fixes.values()))), progress)


def _given(overview: Overview, how: LogOptions, said: Mapping[str, Mapping[str, Any]]) -> Known:
    """Return the given settings: the log's attachment, --robot, another program's file, --set."""
    layers: list[tuple[str, Mapping[str, Any]]] = []
    if ATTACHMENT in overview.log.attachments:
        layers.append(
            ("the log's own robot.toml", robot_toml.parse(overview.log.attachments[ATTACHMENT], ATTACHMENT))
        )
    layers += [(file.name, robot_toml.parse(file.read_bytes(), file.name)) for file in how.robots]
    layers += said.items()
    layers.append(("--set", robot_toml.apply_sets(how.sets)))
    merged = flat(overview.tables)
    return {key: (merged[key], f"by {who}") for who, tables in layers for key in flat(tables)}


def _fixes(findings: Iterable[Finding]) -> dict[str, tuple[str, str]]:
    """Return the fixes by key: "key=value", and why."""
    return {fix.partition("=")[0]: (fix, _why(f)) for f in findings for fix in f.fixes if _loads(fix)}


def _certain(f: Finding) -> bool:
    """Whether the log shows that a fix is right, it was chosen already, or it is required."""
    return f.code not in {OPEN_SCALE, OPEN_CLOCK} and (f.severe or f.code in {*MEASURED_CODES, "choice"})


def _why(f: Finding) -> str:
    if f.code == "geometry":
        return f.source or f.message
    return f"{GUESS}{f.sentence}" if f.code in GUESSED_CODES else f"as this log shows: {f.sentence}"


def _loads(fix: str) -> bool:
    """Whether a fix is complete, without a placeholder."""
    try:
        make_robot(robot_toml.apply_sets([fix]))
    except LocfuseError:
        return False
    return True


def _read(fixes: Mapping[str, tuple[str, str]]) -> Known:
    return {key: (flat(robot_toml.apply_sets([fix]))[key], why) for key, (fix, why) in fixes.items()}
