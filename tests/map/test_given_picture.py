"""A picture of the room, drawn cell by cell here, lies where map_server says: nothing is shifted by half a cell.

By map_server's convention the origin is the lower left corner of the lower left cell, and the first row of the
image is the northernmost. Cells of 20 cm show a shift by half of one at once.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from commands import locfuse
from numpy.typing import NDArray

LOG, ROOM = "rounded_rectangle", (8.0, 6.0)  # m: its walls stand at 0 and there
CELL = 0.2


def solid(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Walls as an architect draws them: black where a cell's middle is outside the room."""
    return (x < 0.0) | (x > ROOM[0]) | (y < 0.0) | (y > ROOM[1])


def hit(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Walls as a mapping program leaves them: black where a wall passes within half a cell of the middle."""
    near = [np.abs(x), np.abs(x - ROOM[0]), np.abs(y), np.abs(y - ROOM[1])]
    return np.asarray(np.min(near, axis=0) < 0.5 * CELL - 1e-9)


def draw(path: Path, walls: NDArray[np.bool_], x: NDArray[np.float64], y: NDArray[np.float64]) -> Path:
    """Write the room as P5 and YAML; x and y are those of the cells' middles, the first row the southernmost."""
    inside = (x > 0.0) & (x < ROOM[0]) & (y > 0.0) & (y < ROOM[1])
    grey = np.where(walls, 0, np.where(inside, 254, 205)).astype(np.uint8)
    rows, columns = grey.shape
    path.with_suffix(".pgm").write_bytes(b"P5 %d %d 255\n" % (columns, rows) + grey[::-1].tobytes())
    origin = [float(x[0, 0]) - 0.5 * CELL, float(y[0, 0]) - 0.5 * CELL, 0.0]
    path.write_text(f"image: {path.stem}.pgm\nresolution: {CELL}\norigin: {origin}\nnegate: 0\n")
    return path


@pytest.mark.parametrize(
    ("wall", "begin"),
    [(solid, (-1.0 + 0.5 * CELL, -2.0 + 0.5 * CELL)), (hit, (-1.0, -2.0))],  # of the lower left cell: its middle
)
def test_a_picture_lies_where_its_origin_says(wall: object, begin: tuple[float, float], tmp_path: Path) -> None:
    """Both draw these walls without any rounding, so that what is left is the laser's own error."""
    x, y = np.meshgrid(begin[0] + CELL * np.arange(60), begin[1] + CELL * np.arange(55))
    assert callable(wall)
    given = draw(tmp_path / "room.yaml", wall(x, y), x, y)
    words = ("--no-advice", "--sensors", "lrf", "-o", tmp_path / "out", "--write", "json,csv")
    done = locfuse("compare", LOG, "--map", given, *words)
    assert done.exit_code == 0, done.stderr
    found = json.loads((tmp_path / "out/report.json").read_text())["configurations"]["lrf"]
    assert found["position_rmse_m"] < 0.1 * CELL
