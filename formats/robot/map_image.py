"""Maps of ROS's map_server: a map.yaml with an image (.pgm, .png), or an OccupancyGrid message.

The darkness of a pixel (0 to 1) means a wall above `occupied_thresh`, free space below `free_thresh`, and unknown
between both. The last row of the image is the southernmost.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from locfuse.formats.inputs import MAX_MAP_PICTURE, MAX_ROBOT_TOML, read_small, refuse_above
from locfuse.formats.text import visible
from locfuse.fusion.data import MAX_MAGNITUDE, Array, LocfuseError, Mask

from .ros_yaml import by_yaml

SUFFIXES = (".yaml", ".yml")
PICTURES = (".pgm", ".png")
OCCUPIED_SHARE, FREE_SHARE = 0.65, 0.25  # default thresholds of map_server
UNKNOWN_GREY = 205  # value that map_saver writes for unknown cells, independent of the thresholds
MAX_CELL_M = 10.0
ROWS_AT_ONCE = 256  # rows of an image processed at once: as float64 they take eight times the bytes
UNKNOWN_CELL = -1  # value of an unknown cell in an OccupancyGrid; other values are 0 to 100


class MapImage(NamedTuple):
    """Grid map: masks (rows, columns) of occupied and free cells, southernmost row first; others are unknown."""

    occupied: Mask
    free: Mask
    cell: float  # m
    origin: Array  # (3,) x, y [m], yaw [rad] of the lower left corner, map frame


def read(path: Path) -> MapImage:
    """Return the map of a map.yaml and its image. Raises LocfuseError for missing or invalid values."""
    keys = _keys(path)
    image, origin = keys.get("image"), keys.get("origin")
    if not isinstance(image, str) or not image or "\0" in image:
        raise LocfuseError(f"{path} says no image: a map.yaml names image, resolution and origin")
    numbers = origin if isinstance(origin, list) and len(origin) == 3 else [None]
    if not all(isinstance(v, int | float) and abs(v) < MAX_MAGNITUDE for v in numbers):
        raise LocfuseError(f"{path}: origin is {_described(origin)}, not [x, y, yaw] in m, m, rad")
    file = Path(image) if Path(image).is_absolute() else path.parent / image
    pixels, negate = _pixels(file), bool(_number(keys, "negate", path, 0.0))
    least = _number(keys, "occupied_thresh", path, OCCUPIED_SHARE)
    most = _number(keys, "free_thresh", path, FREE_SHARE)
    occupied, free = np.zeros((2, *pixels.shape[:2]), dtype=bool)
    for row in range(0, len(pixels), ROWS_AT_ONCE):
        some = slice(row, row + ROWS_AT_ONCE)
        dark = _darkness(pixels[some])
        dark = 1.0 - dark if negate else dark
        occupied[some], free[some] = dark > least, dark < most
    cell = _number(keys, "resolution", path)
    if not 0.0 < cell <= MAX_CELL_M:
        raise LocfuseError(f"{path}: resolution {cell:g} m: the side of a cell must be above 0 and at most 10 m")
    return checked(MapImage(occupied[::-1], free[::-1], cell, np.array(numbers, np.float64)), str(path))


def of_message(data: Any, width: int, height: int, cell: float, origin: Array, name: str) -> MapImage:
    """Return the map of an OccupancyGrid: data (width * height,) 0 to 100, unknown -1; `cell` [m]."""
    cells = np.asarray(data).astype(np.int64)
    if width < 1 or height < 1 or len(cells) != width * height:
        raise LocfuseError(f"{name}: {len(cells)} cells are no map of {width} x {height}")
    if not (0.0 < cell <= MAX_CELL_M and np.isfinite(origin).all()):
        raise LocfuseError(f"{name}: a map with cells of {cell:g} m at {origin.tolist()} lies nowhere")
    grid = cells.reshape(height, width)
    known = grid != UNKNOWN_CELL
    occupied, free = known & (grid > 100 * OCCUPIED_SHARE), known & (grid < 100 * FREE_SHARE)
    return checked(MapImage(occupied, free, cell, origin), name)


def checked(found: MapImage, name: str) -> MapImage:
    """Return the map unchanged. Raises LocfuseError if it has no occupied or no free cell."""
    for cells, what in ((found.occupied, "wall"), (found.free, "free cell")):
        if not cells.any():
            raise LocfuseError(f"{name} has no {what}: nothing can be localised in it (negate, thresholds)")
    return found


def _keys(path: Path) -> dict[str, Any]:
    # aliases are refused: 400 bytes with aliases can expand to 10^9 values
    from ruamel.yaml.events import AliasEvent

    text = read_small(path, MAX_ROBOT_TOML)
    if any(isinstance(event, AliasEvent) for event in by_yaml(path, "parse", text)):
        raise LocfuseError(f"{path}: YAML aliases (*name) are not read: write the value itself")
    keys = by_yaml(path, "load", text)
    if not isinstance(keys, dict):
        raise LocfuseError(f"{path} is no YAML of a map: it must say image, resolution and origin")
    return keys


def _number(keys: dict[str, Any], key: str, path: Path, default: float | None = None) -> float:
    value = keys.get(key, default)
    if isinstance(value, bool | int | float) and abs(value) < MAX_MAGNITUDE:
        return float(value)
    raise LocfuseError(f"{path}: {key} is {_described(value)}, not a number below {MAX_MAGNITUDE:g}")


def _described(value: Any) -> str:
    """Return a YAML value for an error message: the first 40 characters of a text, else its type."""
    return repr(visible(value[:40])) if isinstance(value, str) else f"of type {type(value).__name__}"


def _pixels(file: Path) -> NDArray[Any]:
    """Return the pixels of an image, (rows, columns) or (rows, columns, colours)."""
    from locfuse.fusion.camera.opencv import MAX_MAP_PIXELS, cv2, listened

    data = read_small(file, MAX_MAP_PICTURE)
    size = _size(data)
    if size is None:
        raise LocfuseError(f"{file} is no PGM or PNG: maps are read as these")
    refuse_above(str(file), size[0] * size[1], MAX_MAP_PIXELS, "cells")
    try:
        # OpenCV's messages are dropped; a damaged image raises an error below
        pixels, _ = listened(lambda: cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED))
    except cv2.error:
        pixels = None
    if pixels is None or pixels.size == 0:
        raise LocfuseError(f"{file} cannot be decoded: it is cut off or damaged")
    return np.asarray(pixels)


def _darkness(pixels: NDArray[Any]) -> Array:
    """Return the darkness of each pixel, (rows, columns) 0 to 1; 0.5 (unknown) for transparent ones."""
    light = pixels.astype(np.float64) / (255.0 if pixels.dtype == np.uint8 else 65535.0)
    if light.ndim == 2:
        unknown = (pixels == UNKNOWN_GREY) & (pixels.dtype == np.uint8)
        return np.where(unknown, 0.5, 1.0 - light)
    dark = 1.0 - light[:, :, :3].mean(axis=2)
    return np.asarray(np.where(light[:, :, 3] < 0.5, 0.5, dark) if light.shape[2] == 4 else dark)


def _size(data: bytes) -> tuple[int, int] | None:
    """Return width and height [px] from the header of a PGM or PNG; None for other files."""
    if data.startswith(b"\x89PNG\r\n\x1a\n") and len(data) >= 24:
        width, height = struct.unpack(">II", data[16:24])
        return int(width), int(height)
    if data[:2] not in {b"P2", b"P5"}:
        return None
    words: list[bytes] = []
    for line in data[2:4096].split(b"\n"):
        words += line.partition(b"#")[0].split()
        if len(words) >= 2:
            break
    if len(words) < 2 or not all(word.isdigit() and len(word) < 10 for word in words[:2]):
        return None
    return int(words[0]), int(words[1])
