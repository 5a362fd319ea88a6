"""Maps of map_server: PGM and PNG with their YAML, and what in one line is refused."""

import math
import tracemalloc
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from locfuse.formats.robot import map_image
from locfuse.fusion.data import LocfuseError

YAML = "image: map.pgm\nresolution: 0.1\norigin: [-1.0, 2.0, 0.5]\n"


def drawn(dtype: type = np.uint8) -> NDArray[np.uint8]:
    """Three rows of four pixels: wall in the upper left, unknown in the lower right, free else."""
    top = 255 if dtype is np.uint8 else 65535
    image: NDArray[np.uint8] = np.full((3, 4), top, dtype)
    image[0, 0], image[2, 3] = 0, round(0.5 * top)
    return image


def written(folder: Path, text: str = YAML, data: bytes | None = None, name: str = "map.pgm") -> Path:
    pixels = b"P5\n# by hand\n4 3\n255\n" + drawn().tobytes()
    (folder / name).write_bytes(pixels if data is None else data)
    (folder / "map.yaml").write_text(text)
    return folder / "map.yaml"


def png(pixels: NDArray[Any]) -> bytes:
    return cv2.imencode(".png", pixels)[1].tobytes()


@pytest.mark.parametrize(
    ("text", "data", "name"),
    [
        (YAML, None, "map.pgm"),
        (YAML + "negate: 1\n", b"P5\n4 3\n255\n" + (255 - drawn()).tobytes(), "map.pgm"),
        *((YAML.replace("pgm", "png"), png(drawn(dtype)), "map.png") for dtype in (np.uint8, np.uint16)),
    ],
    ids=["pgm", "negative", "png", "png of 16 bits"],
)
def test_the_last_row_is_the_southernmost_in_every_kind_of_picture(
    tmp_path: Path, text: str, data: bytes | None, name: str
) -> None:
    found = map_image.read(written(tmp_path, text, data, name))
    assert np.argwhere(found.occupied).tolist() == [[2, 0]]
    assert np.argwhere(~found.occupied & ~found.free).tolist() == [[0, 3]]
    assert (found.cell, found.origin.tolist()) == (0.1, [-1.0, 2.0, 0.5])


def test_what_is_transparent_or_grey_as_map_saver_writes_it_is_unknown(tmp_path: Path) -> None:
    clear, grey = np.dstack([drawn()] * 3 + [np.full((3, 4), 255, np.uint8)]), drawn()
    clear[1, 1, 3], grey[1, 1] = 0, 205
    for text, data, name in (
        (YAML.replace("pgm", "png"), png(clear), "map.png"),
        (YAML + "free_thresh: 0.25\n", b"P5\n4 3\n255\n" + grey.tobytes(), "map.pgm"),
    ):
        found = map_image.read(written(tmp_path, text, data, name))
        assert not found.free[1, 1]
        assert not found.occupied[1, 1]


def test_an_occupancy_grid_lies_from_the_lower_left() -> None:
    cells = [0, 0, 100, -1]
    found = map_image.of_message(cells, 2, 2, 0.05, np.zeros(3), "/map")
    assert np.argwhere(found.occupied).tolist() == [[1, 0]]
    assert found.free[0].all()
    assert not found.free[1].any()


@pytest.mark.parametrize(
    ("text", "data", "said"),
    [
        ("image: [", None, "is no YAML"),
        ("- 1\n- 2\n", None, "must say image, resolution and origin"),
        ("resolution: 0.1\norigin: [0, 0, 0]\n", None, "says no image"),
        (YAML.replace("0.1", "soon"), None, "resolution is 'soon', not a number"),
        (YAML.replace("0.1", "-1"), None, "resolution -1 m"),
        (YAML.replace("[-1.0, 2.0, 0.5]", "[1]"), None, "origin is of type list, not"),
        (YAML.replace("0.1", "0x" + "f" * 400), None, "resolution is of type int, not a number below"),
        (YAML.replace("0.1", "!!float ''"), None, "is no YAML"),
        (YAML.replace("map.pgm", "gone.pgm"), None, "gone.pgm"),
        (YAML, b"GIF89a", "is no PGM or PNG"),
        (YAML, b"P5\n4 3\n255\n", "cannot be decoded"),
        (YAML, b"P2\n4 3\n255\n" + b"9" * 30, "cannot be decoded"),
        (YAML, b"P5\n4 3\n255\n\x00", "cannot be decoded"),
        (YAML, b"P5\n9000 9000\n255\n", "81 000 000 cells, more than the cap of 67 108 864"),
        (YAML, b"P5\n4 3\n255\n" + bytes(12), "has no free cell"),
        (YAML, b"P5\n4 3\n255\n" + b"\xff" * 12, "has no wall"),
    ],
)
def test_what_is_no_map_is_refused_in_one_line_and_opencv_prints_none(
    tmp_path: Path, text: str, data: bytes | None, said: str, capfd: Any
) -> None:
    with pytest.raises(LocfuseError, match=said) as problem:
        map_image.read(written(tmp_path, text, data))
    assert "\n" not in str(problem.value)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(("width", "cell", "said"), [(3, 0.05, "no map of 3 x 2"), (2, math.nan, "lies nowhere")])
def test_a_grid_that_cannot_be_is_refused(width: int, cell: float, said: str) -> None:
    with pytest.raises(LocfuseError, match=said):
        map_image.of_message([0, 0, 100, 0], width, 2, cell, np.zeros(3), "/map")


def test_aliases_that_stand_for_a_billion_values_are_refused_at_once(tmp_path: Path) -> None:
    bomb = "a0: &a0 [x,x,x,x,x,x,x,x,x]\n" + "".join(
        f"a{i}: &a{i} [{','.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 10)
    )
    with pytest.raises(LocfuseError, match="YAML aliases") as problem:
        map_image.read(written(tmp_path, bomb + YAML.replace("0.1", "*a9")))
    assert len(str(problem.value)) < 200 + len(str(tmp_path))


def test_a_map_of_300_m_at_5_cm_is_read_in_less_than_300_mib(tmp_path: Path) -> None:
    side = 6000
    pixels = np.full((side, side), 254, np.uint8)
    pixels[100, 200:300] = 0
    given = written(tmp_path, YAML, b"P5\n%d %d\n255\n" % (side, side) + pixels.tobytes())
    tracemalloc.start()
    found = map_image.read(given)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert found.occupied.sum() == 100
    assert found.free.sum() == side**2 - 100
    assert peak < 300 * 2**20
