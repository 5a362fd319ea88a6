"""Units of the numbers in robot.toml, determined by the key or its ending."""

from __future__ import annotations

import tomllib
from importlib.resources import files

TABLE = tomllib.loads((files(__package__) / "units.toml").read_text(encoding="utf-8"))
UNIT_OF_PATH: dict[str, str] = {path: unit for unit, paths in TABLE["paths"].items() for path in paths}
SECONDS, METRES = frozenset(TABLE["seconds"]), frozenset(TABLE["metres"])
WITH_METRES = {"m", "m, m, °", "m, m, °, °"}
WORDS = {"m": "metres", "°": "degrees", "s": "seconds", "px": "pixels", "m/s": "metres per second"}


def of(table: str, key: str) -> str:
    """Return the unit of a key's value: "m"; "" without one."""
    if (path := f"{table}.{key}") in UNIT_OF_PATH:
        return UNIT_OF_PATH[path]
    return "°" if key.endswith("_deg") else "s" if key in SECONDS else "m" if key in METRES else ""


def in_words(table: str, key: str) -> str:
    """Return the unit of a key's value in words: "metres"; "" without one."""
    unit = of(table, key)
    return WORDS.get(unit, unit)
