"""Settings: robot.toml merged from the preset, the log, --robot and --set, as tables and as typed values."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
from msgspec.structs import replace

from locfuse.formats.inputs import MAX_ROBOT_TOML, MAX_TEXT_FILE, read_small
from locfuse.formats.logs.file_stream import SUFFIXES
from locfuse.formats.logs.files import Identity
from locfuse.formats.logs.log import Log
from locfuse.formats.report.json_report import SCHEMA_VERSION, made_with
from locfuse.formats.robot import map_files, robot_toml
from locfuse.formats.versions import own
from locfuse.fusion.data import LocfuseError, UsageError
from locfuse.fusion.robot import Preset, Robot, StartSettings, TruthSettings, WheelSettings
from locfuse.fusion.sensors.points import GROW, PointsSettings
from locfuse.fusion.sensors.registry import REGISTRY, SOURCES, of_points

from .settings import ORDERS, PRESETS, Asked, LogOptions

KEY_OPTIONS = ("sensors", "all_subsets", "align", "smooth", "jitter", "reference")  # in a result's key
FILES = "files"  # key of the hashes of the files that settings name
PRESET_TABLES: dict[Preset, dict[str, Any]] = {  # default settings of a preset: all others override them
    "default": {},
    "paper": {"lrf": {"map": "first-scan"}, "camera": {"chain": "paper", "bearing": "absolute"}},
}
PAPER_SENSORS = ("compass", "lrf", "camera")
PAPER_NOTE = (
    "preset paper: the printed equations with the printed noise (delta, R); the sigmas, gates and the map of "
    "robot.toml are not used. See docs/paper.md"
)
ATTACHMENT = "robot.toml"  # name of the log's attachment with settings
UNREADABLE = (
    f"its settings (attachment {ATTACHMENT}) cannot be read: {{}}; its topics and defaults are used instead. Give "
    "settings with --robot FILE; locfuse init LOG -o FILE writes one"
)


def with_files(tables: Mapping[str, Any]) -> dict[str, Any]:
    """Add to settings the SHA-256 of every file that they name (truth, detections, a map); return all.

    Call this before the files are read: if a file changes later, the next run finds another hash.
    """
    settings = {name: value for name, value in tables.items() if name != FILES}
    files = {text: path for text in texts_of(settings) if (path := file_named(text)) is not None}
    found = {text: hashlib.sha256(read_small(path, MAX_TEXT_FILE)).hexdigest() for text, path in files.items()}
    return {**settings, FILES: found} if found else settings


def files_of(tables: Mapping[str, Any]) -> Iterator[tuple[str, str, str]]:
    """Yield (table, key, path) of every setting that names a data file: detections, a map, a topic "x.tum"."""
    for table, keys in tables.items():
        for key, value in keys.items() if isinstance(keys, Mapping) else ():
            for text in texts_of(value):
                a_map = key == "map" and table in of_points() and text != GROW
                if a_map or Path(text).suffix.lower() in SUFFIXES:
                    yield table, key, text


def texts_of(value: Any) -> Iterator[str]:
    """Yield every string in a setting, or in tables of settings."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping | list | tuple):
        for inner in value.values() if isinstance(value, Mapping) else value:
            yield from texts_of(inner)


def file_named(text: str) -> Path | None:
    """Return the path of the existing file that a text names, else None."""
    try:
        path = Path(text).expanduser()
        return path if path.is_file() else None
    except (OSError, ValueError, RuntimeError):  # too long, or with a NUL: not a path
        return None


def key(content: Identity, tables: Mapping[str, Any], asked: Asked) -> str:
    """Return the key of a comparison (SHA-256 over log, settings and options), 64 hexadecimal digits."""
    parts = {
        "content": content._asdict(),
        "settings": tables,
        "asked": {name: getattr(asked, name) for name in KEY_OPTIONS},
        "locfuse": own(),
        "schema_version": SCHEMA_VERSION,
        "made_with": {**made_with(), **SOURCES},
    }
    return hashlib.sha256(msgspec.json.encode(parts, order="deterministic")).hexdigest()


def merged_tables(log: Log, how: LogOptions) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the settings as tables (preset < log < --robot < --set), and the source of each key, as "--set"."""
    layers = given_layers(how)
    if (own_tables := attached(log, quiet=bool(how.robots))) is not None:
        layers = {"robot.toml in the log": _of_log(log, own_tables, layers), **layers}
    tables = robot_toml.layered(*layers.values())
    tables.setdefault("preset", "default")
    sources = {key: who for who, above in layers.items() for key in flat(above)}
    return robot_toml.merge(PRESET_TABLES[tables["preset"]], tables), sources


def given_layers(how: LogOptions, more: Sequence[str] = ()) -> dict[str, dict[str, Any]]:
    """Return the user's settings as {"--robot": tables, "--set": tables}; `more`: additional words of --set.

    --set overrides --robot. Raises LocfuseError for invalid settings.
    """
    files = [_checked(read_small(file, MAX_ROBOT_TOML), str(file)) for file in how.robots]
    sets = set_tables((*how.sets, *more))
    sets |= {key: word for key, word in (("order", how.order), ("preset", how.preset)) if word}
    return {**({"--robot": robot_toml.merge(*files)} if files else {}), "--set": sets}


def given_tables(how: LogOptions, more: Sequence[str] = ()) -> dict[str, Any]:
    """Return the user's settings, time window and hashes of named files, on which a result's key depends."""
    window = {name: bound for name, bound in (("from", how.begin), ("to", how.end)) if bound is not None}
    return with_files(robot_toml.layered(*given_layers(how, more).values(), window))


def attached(log: Log, quiet: bool = True) -> dict[str, Any] | None:
    """Return the settings attached to the log; None if there are none, or if they cannot be read.

    A wrong checksum is recorded as a loss of the log; unless `quiet`, so are settings that cannot be read.
    """
    try:
        text = log.attachments.get(ATTACHMENT)
        tables = None if text is None else _checked(text, "")
    except LocfuseError as e:
        if not quiet:
            log.losses.add_settings(str(log.paths[0]), UNREADABLE.format(str(e).removeprefix(": ")))
        return None
    unread = UNREADABLE.format("wrong checksum")
    log.losses.explain_settings(f"attachment {ATTACHMENT!r} fails its checksum", unread)
    return tables


def _of_log(log: Log, tables: dict[str, Any], above: Mapping[str, dict[str, Any]]) -> dict[str, Any]:
    """Return the settings attached to the log, with file names relative to the log's folder.

    A log from elsewhere must not read other files of the user: raises LocfuseError for a file outside the log's
    folder, unless --robot or --set gives the same key.
    """
    given = {key for others in above.values() for key in flat(others)}
    for table, key, text in list(files_of(tables)):
        if f"{table}.{key}" in given or log.recorded(text):
            continue
        path, folder = Path(text), log.paths[0].parent
        plain = not (path.is_absolute() or ".." in path.parts or text.startswith("~") or "\0" in text)
        if not (plain and isinstance(folder, Path) and (folder / path).resolve().is_relative_to(folder.resolve())):
            words = (
                f"{log.name}: attachment {ATTACHMENT}: {table}.{key} names the file {text!r}: a log may name only"
            )
            hint = f"give {table}.{key} in a file of your own: --robot FILE"
            raise LocfuseError(f"{words} files in its own folder, by a path without '..'", hint=hint)
        place = str(folder / text)
        before = tables[table][key]
        now = place if isinstance(before, str) else [place if one == text else one for one in before]
        tables = robot_toml.merge(tables, {table: {key: now}})
    return tables


def flat(tables: Mapping[str, Any]) -> dict[str, Any]:
    """Return {"wheels": {"radius": 1}} as {"wheels.radius": 1}; top-level keys keep their names."""
    found: dict[str, Any] = {}
    for name, table in tables.items():
        found |= {f"{name}.{k}": v for k, v in table.items()} if isinstance(table, Mapping) else {name: table}
    return found


def set_tables(words: Sequence[str]) -> dict[str, Any]:
    """Return the words of --set as tables. Raises UsageError for an unknown key or an invalid value."""
    try:
        sets = robot_toml.apply_sets(words)
        make_robot(sets)
    except LocfuseError as e:
        raise UsageError(e.message, role=e.role, fixes=e.fixes, hint=e.hint) from None
    return sets


def named_by_hand(sets: Sequence[str]) -> set[str]:
    """Return the tables whose topic is set by --set."""
    tables = robot_toml.apply_sets(sets).items()
    return {table for table, keys in tables if isinstance(keys, dict) and ("topic" in keys or "topics" in keys)}


def _checked(data: bytes, source: str) -> dict[str, Any]:
    """Parse a robot.toml and check its keys; errors start with its name."""
    tables = robot_toml.parse(data, source)
    try:
        make_robot(tables)
    except LocfuseError as e:
        raise LocfuseError(f"{source}: {e}") from None
    return tables


def table_types() -> dict[str, type[msgspec.Struct]]:
    """Return the type of each table of robot.toml: wheels, start, truth, then every sensor."""
    sensors = {name: sensor.Settings for name, sensor in REGISTRY.items()}
    return {"wheels": WheelSettings, "start": StartSettings, "truth": TruthSettings, **sensors}


def make_robot(tables: Mapping[str, Any]) -> Robot:
    """Convert tables to typed settings; an unknown key is an error with the most similar name."""
    top = {"order": "auto", "preset": "default", **tables}
    tables = {name: table for name, table in tables.items() if name not in {"order", "preset"}}
    for word, known in (("order", ORDERS), ("preset", PRESETS)):
        if top[word] not in known:
            raise LocfuseError(f"{word} = {top[word]!r}; choose from {', '.join(known)}")
    types = table_types()
    found: dict[str, Any] = {name: kind() for name, kind in types.items()} | robot_toml.convert(tables, types)
    return Robot(
        wheels=found["wheels"],
        start=found["start"],
        truth=found["truth"],
        sensors={name: found[name] for name in REGISTRY},
        order=top["order"],
        preset=top["preset"],
        start_given="start" in tables,
    )


def with_point_maps(robot: Robot) -> Robot:
    """Return the robot with the maps of landmarks and anchors read from the files in its settings."""
    read = {}
    for name, settings in robot.sensors.items():
        if not isinstance(settings, PointsSettings) or not isinstance(settings.map, str) or settings.grows:
            continue
        path = Path(settings.map).expanduser()
        if not path.is_file():
            raise LocfuseError(f"no such file: {path}", role=name, hint=f"{name}.map names a .csv of id, x, y")
        read[name] = msgspec.structs.replace(settings, map=map_files.read_landmarks(path))
    return replace(robot, sensors={**robot.sensors, **read})
