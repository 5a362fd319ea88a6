"""Scenario files: found by name or path, merged with their `base`, changed by settings, validated."""

from __future__ import annotations

import difflib
import re
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, get_args

import msgspec
import tomli_w

from locfuse.formats.robot.robot_toml import apply_sets
from locfuse.fusion.data import LocfuseError, UsageError

from . import HERE
from .scenario import Scenario
from .table import ScenarioTable


def names() -> list[str]:
    """Return the names of the scenarios in the package."""
    return sorted(f.stem for f in HERE.glob("*.toml"))


def load(name: str, settings: Iterable[str] = ()) -> Scenario:
    """Return the scenario of a TOML file or of a name, with `table.key=value` settings applied.

    Raises:
        LocfuseError: the file is not a scenario; the message has the wrong key and the most similar one.
        UsageError: no such scenario, or a setting that does not fit.
    """
    tables = _tables(name)
    convert(tables, name, LocfuseError)
    for setting in settings:
        tables = merge(tables, apply_sets([setting]))
    return convert(tables, f"{name} with --set", UsageError)


def dumps(scenario: Scenario) -> str:
    """Return a scenario as TOML with all keys."""
    return tomli_w.dumps(_without_none(msgspec.to_builtins(scenario)))


def merge(tables: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Return `tables` updated recursively with `above`; a table that changes its `kind` is replaced as a whole."""
    merged = dict(tables)
    for key, value in above.items():
        old = merged.get(key)
        merged[key] = value
        if isinstance(old, Mapping) and isinstance(value, Mapping):
            other_kind = value.get("kind", old.get("kind")) != old.get("kind")
            merged[key] = value if other_kind else merge(old, value)
    return merged


def _tables(name: str) -> dict[str, Any]:
    path = Path(name)
    if not path.is_file() and name not in names():
        near = difflib.get_close_matches(name, names(), 1)
        hint = f"did you mean {near[0]}?" if near else f"shipped ones: {', '.join(names())}"
        raise UsageError(f"no scenario {name}: neither a file nor a name; {hint}")
    try:
        text = (path if path.is_file() else HERE / f"{name}.toml").read_text(encoding="utf-8")
        tables = tomllib.loads(text)
    except (OSError, UnicodeDecodeError) as error:
        raise LocfuseError(f"{name} cannot be read as a scenario: {error}") from error
    except tomllib.TOMLDecodeError as error:
        raise LocfuseError(f"{name} is not TOML: {error}") from error
    base = tables.pop("base", None)
    return tables if base is None else merge(_tables(str(base)), tables)


def convert(tables: Mapping[str, Any], where: str, kind: type[LocfuseError]) -> Scenario:
    """Convert tables to a Scenario. Raises `kind`, an error that names the wrong key and the most similar one."""
    try:
        return msgspec.convert(tables, Scenario)
    except msgspec.ValidationError as error:
        raise kind(f"{where}: {_explain(str(error))}") from error


UNKNOWN = re.compile(r"unknown field `(?P<key>[^`]*)`(?: - at `\$(?P<path>[^`]*)`)?")
BAD_KIND = re.compile(r"Invalid value '(?P<key>[^']*)' - at `\$(?P<path>[^`]*)\.kind`")


def _explain(error: str) -> str:
    if found := UNKNOWN.search(error):
        known = {name for table in _tables_at(found["path"] or "") for name in table.__struct_fields__}
        what = f"no key {found['key']} in {(found['path'] or '.')[1:] or 'a scenario'}"
    elif found := BAD_KIND.search(error):
        known = {str(table.__struct_config__.tag) for table in _tables_at(found["path"])}
        what = f"no kind {found['key']} of {found['path'][1:]}"
    else:
        return error[:1].lower() + error[1:].replace("`$.", "`")
    near = difflib.get_close_matches(found["key"], known, 1)
    return f"{what}; {f'did you mean {near[0]}?' if near else 'known: ' + ', '.join(sorted(known))}"


def _tables_at(path: str) -> list[type[ScenarioTable]]:
    """Return the types of table possible at a path of a msgspec error, such as `.faults[0]`."""
    found: list[type[ScenarioTable]] = [Scenario]
    for step in filter(None, path.replace("[...]", "").split(".")):
        name = re.sub(r"\[\d+\]", "", step)
        types = [f.type for table in found for f in msgspec.structs.fields(table) if f.name == name]
        found = [table for t in types for table in _structs(t)]
    return found


def _structs(of: Any) -> list[type[ScenarioTable]]:
    if isinstance(of, type) and issubclass(of, ScenarioTable):
        return [of]
    return [table for part in get_args(of) for table in _structs(part)]


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _without_none(v) for k, v in value.items() if v is not None}
    return [_without_none(v) for v in value] if isinstance(value, list | tuple) else value
