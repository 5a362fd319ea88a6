"""The key of a result: equal for equal input, settings, configurations and version, so that nothing is run twice.

It is known before a log is opened: settings that the log itself carries are part of its content.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec

from locfuse.formats.caps import MAX_TEXT_FILE
from locfuse.formats.inputs import read_small
from locfuse.formats.logs.file_stream import SUFFIXES
from locfuse.formats.logs.files import Identity
from locfuse.formats.report.json_report import SCHEMA_VERSION, made_with
from locfuse.formats.versions import own
from locfuse.fusion.sensors.points import GROW
from locfuse.fusion.sensors.registry import SOURCES, of_points

from .settings import Asked

# what figures depend on, in the order in which it is hashed
Keyed = msgspec.defstruct("Keyed", ("sensors", "all_subsets", "align", "smooth", "jitter", "reference"))
FILES = "files"  # beside the settings: the files that they name -> the hash of their content


def with_files(tables: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings with the hash of every text file in them: a truth, detections, a map.

    Take it before the files are read: one that changes in between then has another hash at the next run.
    """
    settings = {name: value for name, value in tables.items() if name != FILES}
    found = {text: digest for text in texts_of(settings) if (digest := _digest(text)) is not None}
    return {**settings, FILES: found} if found else settings


def files_of(tables: Mapping[str, Any]) -> Iterator[tuple[str, str, str]]:
    """Yield table, key and text of every setting that is a text file: detections, a map, a topic "x.tum"."""
    for table, keys in tables.items():
        for key, value in keys.items() if isinstance(keys, Mapping) else ():
            for text in texts_of(value):
                a_map = key == "map" and table in of_points() and text != GROW
                if a_map or Path(text).suffix.lower() in SUFFIXES:
                    yield table, key, text


def texts_of(value: Any) -> Iterator[str]:
    """Yield every text of a setting, or of tables of settings."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        for inner in value.values():
            yield from texts_of(inner)
    elif isinstance(value, list | tuple):
        for inner in value:
            yield from texts_of(inner)


def _digest(text: str) -> str | None:
    """Return the hash of a setting's file, None for a setting without one."""
    try:
        path = Path(text).expanduser()
        if not path.is_file():
            return None
    except (OSError, ValueError, RuntimeError):  # too long, or a NUL in it: no path
        return None
    return hashlib.sha256(read_small(path, MAX_TEXT_FILE)).hexdigest()


def key(content: Identity, tables: Mapping[str, Any], asked: Asked) -> str:
    """Return the key of a comparison: 64 hexadecimal digits."""
    parts = {
        "content": content._asdict(),
        "settings": tables,
        "asked": msgspec.convert(asked, Keyed, from_attributes=True),
        "locfuse": own(),
        "schema_version": SCHEMA_VERSION,
        "made_with": {**made_with(), **SOURCES},
    }
    return hashlib.sha256(msgspec.json.encode(parts, order="deterministic")).hexdigest()
