"""What `init` writes: everything `look` found out of a log, as lines of a robot.toml with their words."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from locfuse.cli.pipeline.load import ATTACHMENT, make_robot, table_types
from locfuse.cli.pipeline.settings import LogOptions
from locfuse.formats.robot import robot_toml
from locfuse.formats.robot.commented_toml import Section
from locfuse.fusion.data import LocfuseError
from locfuse.fusion.doctor.finding import Oddity

from .inspect_log import look
from .overview import Look
from .template_tables import Facts, Known, found, lines

ROUNDS = 4  # a cure may bring out what could not be seen before
MEASURED = {"lag", "range scale", "track", "yaw"}  # oddities whose cure is right even where they spoil little
CHOICES = {"choice", "unusable", "truth?"}  # nothing was measured: the first that fits


class Draft(NamedTuple):
    """The tables of a robot.toml, and what is missing."""

    seen: Look  # with all cures that are in force
    sections: list[Section]
    missing: list[str]  # keys without which nothing runs, or not their sensor


def draft(paths: Sequence[Path], how: LogOptions, progress: Callable[[str], None] = lambda step: None) -> Draft:
    """Look at a log until no cure changes anything, and write down what was found."""
    seen = look(paths, how, progress)
    said = _told(seen, how)
    cures: dict[str, tuple[str, str]] = {}  # key -> "key=value", why
    for _ in range(ROUNDS):
        new = {key: cure for key, cure in _cures(filter(_certain, seen.oddities)).items() if key not in said}
        if new.items() <= cures.items():
            break
        cures |= new
        seen = look(paths, replace(how, sets=(*how.sets, *(cure for cure, _ in cures.values()))), progress)
    known = {**found(seen), **_read(cures), **said}
    suggested = _read({key: cure for key, cure in _cures(seen.oddities).items() if key not in cures})
    facts = Facts(seen, known, suggested)
    missing: list[str] = []
    sections = [Section(name, tuple(lines(facts, name, missing))) for name in ("", *table_types())]
    return Draft(seen, sections, missing)


def _told(seen: Look, how: LogOptions) -> Known:
    """Return what somebody said already: the log's attachment, --robot, --set."""
    layers: list[tuple[str, Mapping[str, Any]]] = []
    if ATTACHMENT in seen.log.attachments:
        layers.append(("the log's own robot.toml", robot_toml.parse(seen.log.attachments[ATTACHMENT], ATTACHMENT)))
    if how.robot is not None:
        layers.append((how.robot.name, robot_toml.parse(how.robot.read_bytes(), how.robot.name)))
    layers.append(("--set", robot_toml.apply_sets(how.sets)))
    merged = _flat(seen.tables)
    return {key: (merged[key], f"by {who}") for who, tables in layers for key in _flat(tables)}


def _flat(tables: Mapping[str, Any]) -> dict[str, Any]:
    """Return {"wheels": {"radius": 1}} as {"wheels.radius": 1}."""
    flat: dict[str, Any] = {}
    for name, table in tables.items():
        flat |= {f"{name}.{k}": v for k, v in table.items()} if isinstance(table, Mapping) else {name: table}
    return flat


def _cures(oddities: Iterable[Oddity]) -> dict[str, tuple[str, str]]:
    """Return the cures of what is odd by key: "key=value", and why."""
    return {cure.partition("=")[0]: (cure, _why(o)) for o in oddities for cure in o.cures if _loads(cure)}


def _certain(o: Oddity) -> bool:
    """Whether the log itself shows that a cure is right, or nothing runs without it."""
    return o.spoils or o.code in MEASURED


def _why(o: Oddity) -> str:
    if o.code == "geometry":
        return o.words.rpartition("; ")[2]  # who told the numbers
    return f"guess: {o.words}" if o.code in CHOICES else f"as this log shows: {o.words}"


def _loads(cure: str) -> bool:
    """Whether a cure can be written as it stands, with nothing left to be filled in."""
    try:
        make_robot(robot_toml.apply_sets([cure]))
    except LocfuseError:
        return False
    return True


def _read(cures: Mapping[str, tuple[str, str]]) -> Known:
    return {key: (_flat(robot_toml.apply_sets([cure]))[key], why) for key, (cure, why) in cures.items()}
