"""robot.toml: parsing, merging of several sources key by key, typed settings and units; and written with comments.

A new file has a comment on every line; in an existing one only values and their comments change.
"""

from __future__ import annotations

import itertools
import json
import math
import re
import textwrap
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args, get_origin, get_type_hints

import msgspec

from locfuse.formats.inputs import MAX_DOTS, MAX_KEY_DEPTH, MAX_KEYS, MAX_ROBOT_TOML, read_small, refuse_above
from locfuse.formats.text import did_you_mean, escaped
from locfuse.fusion.data import LocfuseError, UsageError

BARE_POINT = re.compile(r"^([+-]?)\.(?=\d)")  # .5 is a number for most people, but not for TOML
MAX_LISTED_KEYS = 12  # in an error message
MOUNT_KEYS = ("x", "y", "yaw_deg")  # sensor mount in the base frame; each key has a sigma_<key>
MAX_NUMBER = 1e20  # larger than the range of a 64-bit counter
MIN_NUMBER = 1e-30  # smallest absolute value except 0: its square does not underflow
MAX_METRES = 1e8  # larger than the Earth
Tables = dict[str, Any]


def parse(text: str | bytes, source: str) -> Tables:
    """Return the tables of a robot.toml; `source` is its name in errors."""
    try:
        if isinstance(text, bytes):
            text = text.decode("utf-8")
        # tomllib would need minutes to parse larger texts
        refuse_above(f"{source}: too long", len(text), MAX_ROBOT_TOML, "characters")
        dots = max((line.count(".") for line in text.splitlines()), default=0)
        refuse_above(f"{source}: too many dots in a line", dots, MAX_DOTS)
        tables = tomllib.loads(text.removeprefix("\ufeff"))
    except UnicodeDecodeError as problem:
        raise LocfuseError(f"{source}: not UTF-8 text (byte {problem.start})") from None
    except ValueError as problem:  # from tomllib, and from int() for thousands of digits
        raise LocfuseError(f"{source}: not valid TOML: {' '.join(str(problem).split())}") from None
    except RecursionError:
        raise LocfuseError(f"{source}: not valid TOML: nested too deeply") from None
    _refuse_absurd(tables, source)
    return tables


def merge(*tables: Mapping[str, Any]) -> Tables:
    """Merge tables key by key; a later value replaces an earlier one."""
    merged: Tables = {}
    for layer in tables:
        for key, value in layer.items():
            before = merged.get(key)
            both = isinstance(before, Mapping) and isinstance(value, Mapping)
            merged[key] = merge(before, value) if both and before is not None else value
    return merged


def layered(*tables: Mapping[str, Any]) -> Tables:
    """Merge the settings of several sources for one robot; a later value replaces an earlier one.

    If a later source changes x of a mount but not its sigma, an earlier `sigma_x = 0` (exact) is removed, since it
    no longer holds. The same applies to y and yaw_deg.
    """
    merged: Tables = {}
    for layer in tables:
        kept = {name: _without_outdated_sigmas(table, layer.get(name)) for name, table in merged.items()}
        merged = merge(kept, layer)
    return merged


def _without_outdated_sigmas(before: Any, above: Any) -> Any:
    """Return the table `before` without those sigmas of 0 that no longer hold.

    These are the sigmas of mount values that the later table `above` changes.
    """
    if not (isinstance(before, Mapping) and isinstance(above, Mapping)):
        return before
    moved = (key for key in MOUNT_KEYS if key in above and above[key] != before.get(key, 0.0))
    outdated = {f"sigma_{key}" for key in moved if before.get(f"sigma_{key}") == 0}
    return {key: value for key, value in before.items() if key not in outdated}


def apply_sets(sets: Sequence[str]) -> Tables:
    """Convert --set arguments, ["lrf.topic=/scan", "wheels.radius=0.03"], to tables; values are TOML or text."""
    tables: Tables = {}
    for text in sets:
        path, equals, value = text.partition("=")
        keys = [key.strip() for key in path.split(".", MAX_KEY_DEPTH)]
        if not equals or not all(keys):
            raise UsageError(f"--set {text}: write it as table.key=value, such as wheels.radius=0.033")
        table = tables
        for key in keys[:-1]:
            table = table.setdefault(key, {})
            if not isinstance(table, dict):
                raise UsageError(f"--set {text}: {key} was set to a value before")
        table[keys[-1]] = _value(value.strip())
    try:
        _refuse_absurd(tables, "--set")
    except LocfuseError as problem:
        raise UsageError(problem.message, role=problem.role, fixes=problem.fixes, hint=problem.hint) from None
    return tables


def as_set(key: str, value: Any) -> str:
    """Return a setting as an argument of --set: ("lrf.topic", "/scan") -> 'lrf.topic="/scan"'.

    Raises UsageError for a value that TOML cannot express.
    """
    import tomli_w

    plain = value.tolist() if hasattr(value, "tolist") else value  # NumPy's numbers and arrays
    try:
        lines = tomli_w.dumps({"value": plain}).removeprefix("value = ").splitlines()
    except (TypeError, ValueError):
        kinds = "a number, a text, a list, true or false"
        raise UsageError(f"{key} = {_shown(value)}: robot.toml has no such value, but {kinds}") from None
    return f"{key}={''.join(line.strip() for line in lines)}"


def _value(text: str) -> Any:
    try:
        parsed = tomllib.loads("value = " + BARE_POINT.sub(r"\g<1>0.", text))
    except (ValueError, RecursionError):
        return text
    return parsed["value"] if parsed.keys() == {"value"} else text


def _refuse_absurd(tables: Mapping[str, Any], source: str) -> None:
    """Raise LocfuseError for impossible numbers, too many keys and too deeply nested tables."""
    waiting: list[tuple[str, Any]] = [("", tables)]
    for path, value in waiting:  # the list grows in the loop
        _refuse_number(value, source, path)
        children: Iterable[tuple[Any, Any]] = ()
        if isinstance(value, Mapping):
            children = value.items()
        elif isinstance(value, list):
            children = enumerate(value)
        waiting += [(f"{path}.{key}" if path else str(key), child) for key, child in children]
        refuse_above(f"{source}: too many keys", len(waiting), MAX_KEYS)
        if children:
            refuse_above(f"{source}: tables in tables", path.count(".") + 1, MAX_KEY_DEPTH, "deep")


def _refuse_number(value: Any, source: str, path: str) -> None:
    if isinstance(value, float) and not math.isfinite(value):
        raise LocfuseError(f"{source}: {path} = {value}: a finite number is needed")
    if isinstance(value, int | float) and abs(value) > MAX_NUMBER:
        words = f"no number of a robot is larger than {MAX_NUMBER:g}"
        raise LocfuseError(f"{source}: {path} = {_shown(value)}: {words}")
    if isinstance(value, float) and 0.0 < abs(value) < MIN_NUMBER:
        words = f"no number of a robot but 0 is smaller than {MIN_NUMBER:g}"
        raise LocfuseError(f"{source}: {path} = {_shown(value)}: {words}")


def convert(tables: Mapping[str, Any], types: Mapping[str, Any]) -> dict[str, Any]:
    """Convert each table or top-level value to its type; `types` maps names to types.

    Raises LocfuseError: with key path and value, or for an unknown key with the most similar known key.
    """
    converted: dict[str, Any] = {}
    for name, table in tables.items():
        if name not in types:
            having = [t for t, kind in types.items() if name in getattr(kind, "__struct_encode_fields__", ())]
            raise LocfuseError(_unknown(name, "", list(types), [f"{table}.{name}" for table in having]))
        kind = types[name]
        if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
            _check_table(name, table, kind)
        try:
            converted[name] = msgspec.convert(table, kind)
        except msgspec.ValidationError as problem:
            raise LocfuseError(_mismatch(name, table, kind, str(problem))) from None
    return converted


def _check_table(name: str, table: Any, kind: type[msgspec.Struct]) -> None:
    if not isinstance(table, Mapping):
        raise LocfuseError(f"{name} = {_shown(table)}: {name} is a table: write [{name}] and its keys below")
    known = kind.__struct_encode_fields__
    for key, value in table.items():
        if key not in known:
            raise LocfuseError(_unknown(key, name, known))
        if unit_of(name, key) in WITH_METRES:
            _refuse_far(f"{name}.{key}", value)


def _refuse_far(path: str, value: Any) -> None:
    """Raise LocfuseError for lengths [m] above MAX_METRES, also in lists or tables."""
    if isinstance(value, Mapping | list):
        for one in value.values() if isinstance(value, Mapping) else value:
            _refuse_far(path, one)
    elif isinstance(value, int | float) and abs(value) > MAX_METRES:
        raise LocfuseError(f"{path} = {_shown(value)}: it is in metres, and may be {MAX_METRES:g} at most")


def _unknown(key: str, table: str, known: Sequence[str], paths: Sequence[str] = ()) -> str:
    what = f"unknown key {table}.{key}" if table else f"unknown table or key {key}"
    hint = f"did you mean {' or '.join(paths)}?" if paths else did_you_mean(key, known)
    listed = f"known: {', '.join(known)}" if len(known) <= MAX_LISTED_KEYS or not hint else ""
    return f"{what}; {' '.join(part for part in (hint, listed) if part)}"


def _mismatch(name: str, table: Any, kind: Any, problem: str) -> str:
    """Return a readable form of an error of msgspec.

    "... - at `$.radius`" becomes "wheels.radius = 'big': must be a number, in metres".
    """
    reason, _, where = problem.partition(" - at `$")
    path = where.rstrip("`")
    if not path and isinstance(table, Mapping):  # the table's own check failed: its message is complete
        return f"{name}: {reason.removeprefix(name).lstrip('.: ')}"
    value = table
    for key in path.replace("[", ".").replace("]", "").split(".")[1:]:
        try:
            value = value[int(key)] if isinstance(value, list) else value[key]
        except (KeyError, ValueError, IndexError, TypeError):
            return f"{name}{path}: {_plain(reason)}"
    key = path.split("[")[0].lstrip(".")
    if reason.startswith("Invalid enum value") and (words := _choices(kind, key)):
        return f"{name}{path} = {_shown(value)}: {words}"
    return f"{name}{path} = {_shown(value)}: {_needed(name, key, reason)}"


def _choices(kind: Any, key: str) -> str:
    """Return the allowed values of a key as a sentence; "" for a key that allows any text or number."""
    hint = get_type_hints(kind).get(key) if isinstance(kind, type) else None
    kinds = get_args(hint) if get_origin(hint) is not Literal else (hint,)
    words = ", ".join(repr(word) for one in kinds if get_origin(one) is Literal for word in get_args(one))
    return words and (f"must be a number >= 0.0, or {words}" if float in kinds else f"choose from {words}")


def _needed(table: str, key: str, reason: str) -> str:
    """Return the requirement that a value violates, e.g. "must be a number, in metres".

    `reason` is the message of msgspec. If it is not about a number, return it in plain words.
    """
    unit = unit_of(table, key)
    unit = UNIT_IN_WORDS.get(unit, unit)
    found = re.match(r"Expected `(int|float)(?: \| null)?`( [<>]=? [-\d.e+]+)?", reason)
    if not found:
        return _plain(reason)
    kind = "a whole number" if found[1] == "int" else "a number"
    return f"must be {kind}{found[2] or ''}{f', in {unit}' if unit else ''}"


def _plain(reason: str) -> str:
    return reason[:1].lower() + reason[1:].replace("`", "")


def _shown(value: Any) -> str:
    try:
        text = repr(value)
    except ValueError:  # Python's limit for the digits of an integer
        return "an integer of more than 4300 digits"
    return text if len(text) <= 60 else text[:57] + "..."


def dump(tables: Mapping[str, Any]) -> str:
    """Return tables as TOML, with floats in full precision, and without keys whose value is None."""
    import tomli_w

    _refuse_absurd(dict(tables), "robot.toml")
    return escaped(tomli_w.dumps(_without_none(tables)))


def _without_none(tables: Mapping[str, Any]) -> Tables:
    kept = {key: value for key, value in tables.items() if value is not None}
    return {key: _without_none(value) if isinstance(value, Mapping) else value for key, value in kept.items()}


_UNITS = tomllib.loads((files(__package__) / "units.toml").read_text(encoding="utf-8"))
UNIT_OF_PATH: dict[str, str] = {path: unit for unit, paths in _UNITS["paths"].items() for path in paths}
SECONDS, METRES = frozenset(_UNITS["seconds"]), frozenset(_UNITS["metres"])
WITH_METRES = {"m", "m, m, °", "m, m, °, °"}
UNIT_IN_WORDS = {"m": "metres", "°": "degrees", "s": "seconds", "px": "pixels", "m/s": "metres per second"}


def unit_of(table: str, key: str) -> str:
    """Return the unit of a key's value: "m"; "" without one."""
    if (path := f"{table}.{key}") in UNIT_OF_PATH:
        return UNIT_OF_PATH[path]
    return "°" if key.endswith("_deg") else "s" if key in SECONDS else "m" if key in METRES else ""


MAX_LINE_CHARACTERS = 100
WRAPPER = textwrap.TextWrapper(MAX_LINE_CHARACTERS - 2, break_long_words=False, break_on_hyphens=False)


class TomlLine(NamedTuple):
    """One key with its value and a comment."""

    key: str
    value: Any  # None: blank, to be filled in
    words: str = ""  # the comment: source of the value, or how to find the value
    holds: bool = True  # False: the line is commented out


class TomlSection(NamedTuple):
    """One table of a TOML file; the name "" is for keys above all tables."""

    name: str
    lines: tuple[TomlLine, ...]


def render(head: str, sections: Sequence[TomlSection], foot: str = "") -> str:
    """Return a commented TOML file; a table without active lines is commented out as a whole."""
    parts = [comment(head), *("\n".join(_section(section)) for section in sections if section.lines)]
    return "\n\n".join([*parts, comment(foot)] if foot else parts) + "\n"


def comment(text: str) -> str:
    """Return the text as wrapped comment lines; a paragraph that begins with a space is not wrapped."""
    lines: list[str] = []
    for paragraph in text.splitlines():
        plain = printable(paragraph)
        lines += [plain] if plain[:1] == " " else WRAPPER.wrap(plain) or [""]
    return "\n".join(f"# {line}".rstrip() for line in lines)


def as_toml(plain: Any) -> str:
    """Return a value (number, text, list or table) as TOML on one line."""
    if isinstance(plain, Mapping):
        return "{ " + ", ".join(f"{as_toml(str(k))} = {as_toml(v)}" for k, v in plain.items()) + " }"
    if isinstance(plain, list | tuple):
        return "[" + ", ".join(map(as_toml, plain)) + "]"
    return escaped(json.dumps(plain, ensure_ascii=False))


def printable(text: str) -> str:
    """Return text with unprintable characters (line ends, control characters) replaced by "?"."""
    return "".join(c if c.isprintable() else "?" for c in text)


def _section(section: TomlSection) -> Iterator[str]:
    if section.name:
        yield f"[{section.name}]" if any(line.holds for line in section.lines) else f"# [{section.name}]"
    for words, group in itertools.groupby(section.lines, key=lambda line: line.words):
        pairs = [(line, "" if line.value is None else f" {as_toml(line.value)}") for line in group]
        lines = [f"{'' if line.holds else '# '}{line.key} ={value}" for line, value in pairs]
        beside = f"{lines[0]}  # {printable(words)}"
        if not words:
            yield from lines
        elif len(lines) == 1 and len(beside) <= MAX_LINE_CHARACTERS:
            yield beside
        else:
            yield from (comment(words), *lines)


# --- New values in an existing robot.toml; its comments, order and all else stay unchanged
# Values over several lines, and tables not written as [table], cannot be replaced line by line. So the new text is
# parsed again and compared with the merged tables.

HEADING = re.compile(r"\s*(#\s*)?\[\s*([\w-]+)\s*\]\s*(#.*)?$")
BASIC, LITERAL = r'"(?:[^"\\]|\\.)*"', r"'[^']*'"
COMMENT = re.compile(rf"((?:{BASIC}|{LITERAL}|[^#\"'])*?)(\s*#.*)?$")


def text_of(robot: Path | None) -> str:
    """Return the text of a robot.toml; "" without one."""
    return "" if robot is None else read_small(robot, MAX_ROBOT_TOML).decode("utf-8", "replace")


def updated(text: str, changes: Mapping[str, Any], who: str) -> str:
    """Return the text of a robot.toml with changed keys; new keys are added at the end of their tables.

    A commented-out key becomes active in its place. `who` is the comment of an added key. Raises LocfuseError if
    the text cannot be changed line by line.
    """
    wanted = merge(parse(text, "robot.toml"), changes)
    lines = text.splitlines()
    for table, values in changes.items():
        inside = values if isinstance(values, Mapping) else {table: values}
        lines = _in_table(lines, table if isinstance(values, Mapping) else "", inside, who)
    result = "\n".join(lines) + "\n"
    if parse(result, "robot.toml") != wanted:
        raise LocfuseError(
            "robot.toml is written in a way that cannot be changed line by line: write its tables as [table], and "
            "each value on one line"
        )
    return result


def _in_table(lines: list[str], table: str, values: Mapping[str, Any], who: str) -> list[str]:
    """Return the lines with new values in one table; "" is the part above all tables."""
    start, end = _bounds(lines, table)
    if start is None:
        return [*lines, *([""] if lines and lines[-1] else []), f"[{table}]", *_added(values, who)]
    body, missing = lines[start:end], dict(values)
    active = {found[1] for line in body if (found := re.match(r"\s*([\w-]+)\s*=", line))}
    for i, line in enumerate(body):
        found = re.match(r"\s*(?:#\s*)?([\w-]+)\s*=(.*)$", line)
        if found and found[1] in missing and (not line.lstrip().startswith("#") or found[1] not in active):
            comment = COMMENT.match(found[2])
            body[i] = f"{found[1]} = {as_toml(missing.pop(found[1]))}{(comment and comment[2]) or ''}"
    if table:  # activate a commented-out heading
        lines[start - 1] = re.sub(r"^\s*#\s*", "", lines[start - 1])
    while body and not body[-1].strip():
        body.pop()
        end -= 1
    return [*lines[:start], *body, *_added(missing, who), *lines[end:]]


def _bounds(lines: list[str], table: str) -> tuple[int | None, int]:
    """Return the indices of the first line and the end of a table; (None, number of lines) without the table."""
    heads = [(i, m[2], bool(m[1])) for i, line in enumerate(lines) if (m := HEADING.match(line))]
    if not table:
        return 0, heads[0][0] if heads else len(lines)
    for hidden in (False, True):
        for n, (i, name, commented) in enumerate(heads):
            if name == table and commented == hidden:
                return i + 1, heads[n + 1][0] if n + 1 < len(heads) else len(lines)
    return None, len(lines)


def _added(values: Mapping[str, Any], who: str) -> list[str]:
    return [f"{key} = {as_toml(value)}  # {who}" for key, value in values.items()]
