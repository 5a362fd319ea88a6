"""A map of landmarks: a .csv with the header id, x and y [m, map frame]."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from locfuse.formats.caps import MAX_MAP_FILE
from locfuse.formats.inputs import csv_table
from locfuse.fusion.data import MAX_MAGNITUDE, LocfuseError


def read(path: Path) -> dict[str, tuple[float, float]]:
    """Return id -> x, y [m, map frame]. Raises LocfuseError with the line of an invalid value or repeated id."""
    names, rows = csv_table(path, MAX_MAP_FILE)
    missing = [name for name in ("id", "x", "y") if name not in names]
    if missing:
        raise LocfuseError(f"{path}: its first line names no column {missing[0]}; id, x and y are read")
    found: dict[str, tuple[float, float]] = {}
    lines: dict[str, int] = {}
    for number, row in rows:
        try:
            key, x, y = (row[names.index(name)].strip() for name in ("id", "x", "y"))
            ident, place = str(int(key)), (float(x), float(y))
        except (ValueError, IndexError):
            raise LocfuseError(f"{path}: line {number} is not id, x, y: {','.join(row)[:60]!r}") from None
        if not all(abs(one) < MAX_MAGNITUDE for one in place):
            raise LocfuseError(f"{path}: line {number}: a landmark stands somewhere: x and y must be finite")
        if ident in found:
            raise LocfuseError(f"{path}: id {ident} occurs twice (lines {lines[ident]} and {number})")
        found[ident], lines[ident] = place, number
    if not found:
        raise LocfuseError(f"{path} holds no landmarks")
    return found


def encode(points: Iterable[tuple[int, float, float]]) -> str:
    """Return landmarks (id, x, y [m, map frame]) as the text of a map file."""
    return "id,x,y\n" + "".join(f"{ident},{x!r},{y!r}\n" for ident, x, y in points)
