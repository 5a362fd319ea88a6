"""Map files that locfuse writes and reads: walls as editable JSON, landmarks as a .csv.

Every wall is stored with its two ends; the robot saw it from the left of the direction `from` -> `to`.
`covariance` is that of (offset [m], direction [rad]): the offset of the wall at its middle, along the normal, and
its direction. Both are nearly uncorrelated. The .csv has the header id, x and y [m, map frame].
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np

from locfuse.formats.inputs import MAX_MAP_FILE, csv_table, read_small
from locfuse.formats.text import visible, writable
from locfuse.fusion.data import MAX_MAGNITUDE, Array, LocfuseError, MapLine

FORMAT, VERSION = "locfuse line map", 1
Point = tuple[float, float]


class Wall(msgspec.Struct, forbid_unknown_fields=True, rename={"start": "from", "end": "to"}):
    """One line of the map as stored in the file."""

    id: int
    start: Point  # m, map frame
    end: Point
    covariance: tuple[Point, Point] = ((1e-4, 0.0), (0.0, 1e-5))  # m^2, m rad, rad^2
    hits: int = 0  # number of scans with this line


class _File(msgspec.Struct, forbid_unknown_fields=True):
    format: Literal["locfuse line map"]
    version: int
    lines: list[Wall]
    made_from: str = ""


def encode_lines(lines: Sequence[MapLine], made_from: str = "") -> str:
    """Return the text of a map file: indented JSON, one wall per line."""
    walls = (msgspec.json.encode(_wall(line)).decode() for line in lines)
    head = {"format": FORMAT, "version": VERSION, "made_from": writable(made_from)}
    start = msgspec.json.encode(head).decode()[:-1]
    body = ",\n  ".join(walls)
    return f'{start},\n "lines": [\n  {body}\n ]}}\n'


def read_lines(path: Path) -> list[MapLine]:
    """Return the lines of a map file. Raises LocfuseError for another file or invalid values."""
    return decode_lines(read_small(path, MAX_MAP_FILE), str(path))


def decode_lines(text: bytes | str, name: str) -> list[MapLine]:
    """Return the lines of a map file from its text; `name` is the name of the file in errors."""
    try:
        file = msgspec.json.decode(text, type=_File)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as problem:
        fix = "Write one with: locfuse run LOG --save-map FILE"
        raise LocfuseError(f"{name} is not a line map: {visible(str(problem))}. {fix}") from None
    if file.version != VERSION:
        raise LocfuseError(f"{name} is a line map of version {file.version}; this locfuse reads version {VERSION}")
    if not file.lines:
        raise LocfuseError(f"{name} holds no lines: nothing can be localised in it")
    return [_line(wall, f"{name}: wall {wall.id}") for wall in file.lines]


def _wall(line: MapLine) -> Wall:
    c, s = math.cos(line.beta), math.sin(line.beta)
    a, b = ((line.rho * c - t * s, line.rho * s + t * c) for t in line.ends)
    G = _jacobian_at_middle(line.ends)
    (p, q), (_, r) = (G @ line.P @ G.T).tolist()
    return Wall(line.id, a, b, ((p, q), (q, r)), line.hits)


def _jacobian_at_middle(ends: tuple[float, float]) -> Array:
    """Return d(offset at the middle of the wall, beta) / d(rho, beta), (2, 2), for a fixed middle."""
    return np.array([[1.0, -0.5 * (ends[0] + ends[1])], [0.0, 1.0]])


def _line(wall: Wall, where: str) -> MapLine:
    dx, dy = wall.end[0] - wall.start[0], wall.end[1] - wall.start[1]
    length = math.hypot(dx, dy)
    P = np.array(wall.covariance)
    if not (math.isfinite(length) and length > 0.0):
        raise LocfuseError(f"{where} has no length: its ends are {wall.start} and {wall.end}")
    if not np.isfinite(P).all() or abs(P[0, 1] - P[1, 0]) > 1e-12 or np.linalg.eigvalsh(P)[0] < 0.0:
        raise LocfuseError(f"{where} has a covariance that is not symmetric and positive: {P.tolist()}")
    c, s = dy / length, -dx / length  # the normal points to the right of from -> to
    rho, beta = c * wall.start[0] + s * wall.start[1], math.atan2(s, c)
    low, high = (-s * x + c * y for x, y in (wall.start, wall.end))
    G = np.linalg.inv(_jacobian_at_middle((low, high)))
    return MapLine(wall.id, rho, beta, (low, high), G @ P @ G.T, wall.hits)


def read_landmarks(path: Path) -> dict[str, tuple[float, float]]:
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


def encode_landmarks(points: Iterable[tuple[int, float, float]]) -> str:
    """Return landmarks (id, x, y [m, map frame]) as the text of a map file."""
    return "id,x,y\n" + "".join(f"{ident},{x!r},{y!r}\n" for ident, x, y in points)
