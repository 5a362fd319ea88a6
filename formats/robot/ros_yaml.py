"""Parameter files of ROS nodes: a new file with a comment on every line, or new values in an existing one.

In an existing file, only values and the comments of an earlier export change. Other comments, order, quotes and
line ends stay. The YAML parser gives the position of each value. The new text is parsed again and compared with
the intended values.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import msgspec

from locfuse.formats.inputs import MAX_KEYS, MAX_ROBOT_TOML, read_small, refuse_above
from locfuse.formats.text import visible
from locfuse.fusion.data import LocfuseError

from .robot_toml import as_toml, printable

PARAMETERS = "ros__parameters"
BOM = "\ufeff"
MAX_DEPTH = 8  # of nested mappings
UNMAPPED = "cannot be mapped: "
PLAIN_TEXT = re.compile(r"/?[A-Za-z][\w/:.~-]*")  # needs no quotes
RESERVED = {"true", "false", "null", "yes", "no", "on", "off", "y", "n"}  # need quotes
Value = float | bool | str | list[float] | list[bool]


# measured by a command; set by the user; from the log; assumed. An existing file keeps values of the last two
Origin = Literal["found", "set", "kept", "assumed"]
FOUND: Final = "found"
SET: Final = "set"
KEPT: Final = "kept"
ASSUMED: Final = "assumed"
LABELS: dict[Origin, str] = {FOUND: "found: ", SET: "carried over: ", KEPT: "carried over: ", ASSUMED: UNMAPPED}
# a comment that an export wrote
OWN_COMMENT = re.compile(rf"""[^#'"\r\n]*\s(# (?:{"|".join(set(LABELS.values()))})[^\r\n]*)""")


class Setting(msgspec.Struct, frozen=True):
    """One parameter of a node, with the reason for its value."""

    key: str  # "odom0_config"; nested: "encoder.vel_noise"
    value: Value | None  # None: a comment only
    words: str  # source of the value, or reason why there is no value
    origin: Origin = FOUND
    places: tuple[int, ...] = ()  # indices of the values in the list that are set; (): all
    row: int = 0  # number of list values per line; 0: all in one line
    row_words: tuple[str, ...] = ()  # comment of every line of the list

    @property
    def label(self) -> str:
        """Prefix of the comment on this setting: "found: ", "carried over: ", ..."""
        return LABELS[self.origin]

    @property
    def note(self) -> str:
        """The comment of a setting without a value."""
        return f"{self.key}: {UNMAPPED}{printable(self.words)}"

    @property
    def replaces(self) -> bool:
        """Whether the value replaces one in an existing file."""
        return self.value is not None and self.origin in {FOUND, SET}


class NodeSection(NamedTuple):
    """The parameters of one node in a file; keys of nested parameters are joined by dots ("encoder.noise")."""

    name: str
    at: dict[str, Any]  # key -> node of the YAML parser; None for a key that occurs twice
    begin: int  # character offset in the file
    end: int
    shared: frozenset[str]  # keys inside a mapping with a YAML anchor: other places may use them too

    @property
    def values(self) -> dict[str, Any]:
        """Key -> value: number, bool, text, or list of these."""
        return {key: _plain(node) for key, node in self.at.items()}


class RosFile(NamedTuple):
    """The text of a parameter file, and its sections."""

    path: Path
    text: str
    sections: tuple[NodeSection, ...]


# --- a new file


def render(head: str, nodes: Sequence[tuple[str, str, Sequence[Setting]]]) -> str:
    """Return the text of a new parameter file; `nodes` are (name, comment, settings)."""
    lines = [f"# {printable(line)}".rstrip() for line in head.splitlines()]
    for name, words, settings in nodes:
        lines += ["", f"{name}:  # {printable(words)}", f"  {PARAMETERS}:  # as a ROS 2 node reads them"]
        lines += [f"    {line}" for setting in settings for line in _rendered(setting)]
    return "\n".join(lines) + "\n"


def _rendered(setting: Setting) -> Iterator[str]:
    words, label = printable(setting.words), setting.label
    if setting.value is None:
        yield f"# {setting.note}"
        return
    n = setting.row
    if not isinstance(setting.value, list) or not n:
        yield f"{setting.key}: {in_yaml(setting.value)}  # {label}{words}"
        return
    rows = [in_yaml(setting.value[i : i + n])[1:-1] for i in range(0, len(setting.value), n)]
    for i, (row, why) in enumerate(zip(rows, setting.row_words, strict=True)):
        begin = f"{setting.key}: [" if i == 0 else "  "
        yield f"{begin}{row}{']' if i == len(rows) - 1 else ','}  # {label}{printable(why)}"


def in_yaml(value: Value) -> str:
    """Return a value as YAML for ROS; floats always have a dot, because YAML 1.1 reads 1e-09 as text."""
    if isinstance(value, list):
        return f"[{', '.join(in_yaml(v) for v in value)}]"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        bare = PLAIN_TEXT.fullmatch(value) and value.lower() not in RESERVED and not value.endswith(":")
        return value if bare else as_toml(value)  # JSON strings are valid YAML
    mantissa, e, exponent = f"{value:.4g}".partition("e")
    return f"{mantissa if '.' in mantissa else f'{mantissa}.0'}{e}{exponent}"


# --- a file that exists


def read(path: Path) -> RosFile:
    """Return a parameter file. Raises LocfuseError for another file."""
    data = read_small(path, MAX_ROBOT_TOML)
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as problem:
        raise LocfuseError(f"{path}: not a YAML text (byte {problem.start} is not UTF-8)") from None
    return parsed(path, text)


def parsed(path: Path, text: str) -> RosFile:
    """Return the parameter file with this text. Raises LocfuseError for invalid YAML."""
    for number, line in enumerate(text.splitlines(), 1):
        if "\t" in line[: len(line) - len(line.lstrip())]:
            raise LocfuseError(f"{path}: line {number} begins with a tab; indent YAML with spaces")
    return RosFile(path, text, tuple(_sections(_composed(path, text), path)))


def by_yaml(path: Path, method: Literal["load", "compose", "parse"], text: str | bytes) -> Any:
    """Return the result of a method of ruamel.yaml for a text. Raises LocfuseError for invalid YAML."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        found = getattr(YAML(typ="safe", pure=True), method)(text)
        return list(found) if method == "parse" else found
    except (YAMLError, ValueError, LookupError, TypeError, AttributeError, RecursionError) as problem:
        raise LocfuseError(f"{path} is no YAML: {visible(' '.join(str(problem).split())[:160])}") from None


def _composed(path: Path, text: str) -> Any:
    """Return the root node of a YAML text; its positions count characters after the BOM."""
    root = by_yaml(path, "compose", text.removeprefix(BOM))
    if not _is_mapping(root):
        raise LocfuseError(f"{path} is no parameter file of ROS: its top level is not a mapping")
    return root


def _is_mapping(node: Any) -> bool:
    return getattr(node, "id", "") == "mapping"


def _sections(root: Any, path: Path) -> Iterator[NodeSection]:
    """Yield the sections of a file: one for each mapping `ros__parameters`.

    A file without such a mapping (ROS 1) has one section for its top level, and one for each mapping directly in
    it.
    """
    found = list(_below(root, "", False, set()))
    if not found:
        inside = ((key.value, part, _has_anchor(part)) for key, part in root.value if _is_mapping(part))
        found = [("", root, False), *inside]
    for name, mapping, anchored in found:
        at: dict[str, Any] = {}
        shared: set[str] = set()
        for key, node, under in _flat(mapping, "", anchored, 0):
            refuse_above(f"{path}: too many keys", len(at), MAX_KEYS)
            at[key] = None if key in at else node
            shared |= {key} if under else set()
        yield NodeSection(name, at, mapping.start_mark.index, mapping.end_mark.index, frozenset(shared))


def _below(mapping: Any, name: str, anchored: bool, seen: set[int]) -> Iterator[tuple[str, Any, bool]]:
    """Yield (node name, mapping, whether anchored) for each mapping `ros__parameters`, at any depth.

    A mapping is anchored if it, or a mapping around it, has a YAML anchor.
    """
    for key, part in mapping.value:
        if not _is_mapping(part) or id(part) in seen or len(seen) > MAX_KEYS:
            continue
        seen.add(id(part))
        under = anchored or _has_anchor(part)
        if key.value == PARAMETERS:
            yield name, part, under
        elif name.count("/") < MAX_DEPTH:
            yield from _below(part, f"{name}/{key.value}".strip("/"), under, seen)


def _flat(mapping: Any, prefix: str, anchored: bool, depth: int) -> Iterator[tuple[str, Any, bool]]:
    for key, part in mapping.value if depth < MAX_DEPTH else ():
        name = f"{prefix}{key.value}"
        if _is_mapping(part) and key.value != "<<":
            yield from _flat(part, f"{name}.", anchored or _has_anchor(part), depth + 1)
        else:
            yield name, part, anchored


def _has_anchor(node: Any) -> bool:
    return bool(getattr(node, "anchor", None))


def _plain(node: Any) -> Any:
    if node is None or _is_mapping(node):
        return None
    if isinstance(node.value, list):
        return [_plain(part) if isinstance(part.value, str) else None for part in node.value]
    kind = str(node.tag).rpartition(":")[2]
    try:
        if kind in {"int", "float"}:
            number = float(node.value.replace("_", ""))
            return number if math.isfinite(number) else node.value
    except ValueError:  # .nan, .inf, another base than ten
        return node.value
    return node.value.lower() == "true" if kind == "bool" else None if kind == "null" else node.value


def changed(file: RosFile, section: NodeSection, settings: Sequence[Setting]) -> tuple[str, list[Setting]]:
    """Return the text of the file with the new values, and the settings whose key is missing in the section.

    Raises LocfuseError for a value that cannot be replaced.
    """
    spans: dict[tuple[int, int], str] = {}  # (begin, end) in the text -> new text
    absent, wanted = [], section.values
    for setting in settings:
        if not setting.replaces:
            continue
        if setting.key not in section.at:
            absent.append(setting)
            continue
        for place, node, value in _changed_values(file, section, setting):
            # what parsing will give: numbers are rounded to the written digits, a value in quotes is text
            new = value if isinstance(value, bool | str) else float(in_yaml(value))
            new = in_yaml(value).strip('"') if node.style else new
            if _plain(node) != new:
                spans |= _span(file, setting.key, node, value)
            if place is None:
                wanted[setting.key] = new
            else:
                wanted[setting.key][place] = new
            _update_comment(file, setting, place, node, spans)
    if absent and "<<" in section.at:
        raise LocfuseError(f"{file.path}: {section.name} takes keys by << from elsewhere: write its values out")
    _update_notes(file, section, settings, spans)
    text = file.text
    for (begin, end), new in sorted(spans.items(), reverse=True):
        text = text[:begin] + new + text[end:]
    again = list(_sections(_composed(file.path, text), file.path))
    if again[file.sections.index(section)].values != wanted:
        words = "cannot be changed value by value: write one value per key"
        raise LocfuseError(f"{file.path}: {section.name} {words}")
    return text, absent


def _update_comment(
    file: RosFile, setting: Setting, place: int | None, node: Any, spans: dict[tuple[int, int], str]
) -> None:
    """Add the new comment of a value to `spans`, {(begin, end): new text}.

    Only a comment that an earlier export wrote is replaced; a comment by the user is kept.
    """
    if own := OWN_COMMENT.match(file.text, _end(file, node)):
        rows = isinstance(setting.value, list) and setting.row * len(setting.row_words) == len(setting.value)
        alone = rows and place is not None and own.span(1) not in spans  # several rows may share a line
        words = setting.row_words[place // setting.row] if alone and place is not None else setting.words
        spans[own.span(1)] = f"# {setting.label}{printable(words)}"


def _update_notes(
    file: RosFile, section: NodeSection, settings: Sequence[Setting], spans: dict[tuple[int, int], str]
) -> None:
    """Add the new comments of settings without a value to `spans`, {(begin, end): new text}.

    Each new comment replaces one of an earlier export on the same key; a key may have several comments.
    """
    begin: dict[str, int] = {}  # key -> offset from which to search for its next comment
    for key, note in ((setting.key, setting.note) for setting in settings if setting.value is None):
        own = re.compile(rf"^[ \t]*(# {re.escape(key)}: {UNMAPPED}[^\r\n]*)", re.MULTILINE)
        if found := own.search(file.text, begin.get(key, section.begin), section.end + len(BOM)):
            spans[found.span(1)] = f"# {note}"
            begin[key] = found.end()


def _changed_values(
    file: RosFile, section: NodeSection, setting: Setting
) -> Iterator[tuple[int | None, Any, float | bool | str]]:
    """Yield (list index or None, YAML node, new value) of every scalar that a setting changes."""
    node, value = section.at[setting.key], setting.value
    if node is None:
        raise LocfuseError(f"{file.path}: {setting.key} stands twice in {section.name}: keep one of them")
    if setting.key in section.shared or _has_anchor(node):
        words = f"{setting.key} has an anchor or an alias (&, *): write its value out"
        raise LocfuseError(f"{file.path}: {_line(node)}: {words}")
    if not isinstance(value, list):
        if not isinstance(value, float | int | str) or not isinstance(node.value, str):
            raise LocfuseError(f"{file.path}: {_line(node)}: {setting.key} is not a single value")
        yield None, node, value
        return
    if not isinstance(node.value, list) or len(node.value) != len(value):
        raise LocfuseError(f"{file.path}: {_line(node)}: {setting.key} is not a list of {len(value)} values")
    for place in setting.places or range(len(value)):
        yield place, node.value[place], value[place]


def _end(file: RosFile, node: Any) -> int:
    """Return the offset of a value's end in the file's text."""
    return int(node.end_mark.index) + file.text.startswith(BOM)


def _span(file: RosFile, key: str, node: Any, value: float | bool | str) -> dict[tuple[int, int], str]:
    """Return {(begin, end): new text} for a value. Raises LocfuseError if the value in the file is not plain."""
    end = _end(file, node)
    begin = end - (node.end_mark.index - node.start_mark.index)
    if begin == end or not isinstance(node.value, str) or node.style in {"|", ">"} or file.text[begin] in "!&*":
        raise LocfuseError(f"{file.path}: {_line(node)}: {key} has no plain value: write a number there first")
    new = in_yaml(value)
    return {(begin, end): f"{node.style}{new.strip(chr(34))}{node.style}" if node.style else new}


def _line(node: Any) -> str:
    return f"line {node.start_mark.line + 1}"
