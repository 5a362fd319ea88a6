"""Deeds of benchmarks/fuzz_directed.py on what a drive is located by: given maps and detections of landmarks.

Each is healthy in most of its parts, so that what is odd reaches deep: walls stand where the laser sees them,
landmarks where they are detected. Sizes go up to the caps and a little beyond.
"""

from __future__ import annotations

import json
from dataclasses import replace
from random import Random
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from benchmarks.fuzz_damage import NUMBERS, damaged
from benchmarks.fuzz_parsers import TARGETS, mutated
from benchmarks.loop_drive import Loop, walls

if TYPE_CHECKING:
    from benchmarks.fuzz_directed import Draft

CELL, CORNER = 0.05, -0.5  # m of a healthy map: the side of a cell, x and y of the picture's lower left corner
ROWS = (10, 100, 1000, 5000, 20_000)  # detections in a file
ODD_TIMES = ("0", "nan", "inf", "-1e30", "1700000001.0", "1700000001000000000", "9e18", "1e15", "1600000000", "x")
ODD_IDS = ("-1", "0", "1.5", "9007199254740991", "9007199254740993", "1e15", "1e400", "nan", "", "x", "7")
ODD_NUMBERS = (*map(str, NUMBERS), "1e-300", "2.0")


def map_pictures(rng: Random, case: Draft) -> Draft:
    """Give a map as a picture: of the room, of small cells, of noise; cut off, lying, or with odd words beside."""
    sides = (1, 2, 33, 200, 200, 200, 700, 2000, *((5800, 8192, 8200) if rng.random() < 0.1 else ()))
    width = rng.choice(sides)
    cells = _drawn(rng, width, width if rng.random() < 0.7 else min(rng.choice(sides), 2**26 // width + 1))
    name, picture = _encoded(rng, cells)
    if rng.random() < 0.2:
        picture = damaged(rng, picture)[0]
    words = ("--map", "{here}/map.yaml", *rng.choice(((), ("--set", f"start.sigma_xy={rng.choice((0.5, 5))}"))))
    return _commanded(case, words, {name: picture, "map.yaml": _map_yaml(rng, name).encode("utf-8", "replace")})


def _drawn(rng: Random, width: int, height: int) -> Any:
    """Return grey cells (height, width): 0 a wall, 254 free, 205 unknown."""
    noise, deed = np.random.default_rng(rng.randrange(2**32)), rng.randrange(9)
    if deed <= 3:
        cells = np.full((height, width), 254, np.uint8)
        for x0, y0, x1, y1 in ((walls(12) - CORNER) / CELL).round().astype(int).tolist():
            cv2.line(cells, (x0, height - 1 - y0), (x1, height - 1 - y1), 0)
        salt = rng.choice((0.0, 0.0, 1e-4, 0.01, 0.1))
        return np.where(noise.random((height, width), np.float32) < salt, 0, cells).astype(np.uint8)
    if deed <= 5:
        step = rng.choice((1, 1, 2, 3, 7))
        rows, columns = np.arange(height) // step % 2, np.arange(width) // step % rng.choice((1, 2))
        return ((rows[:, None] ^ columns) * 254).astype(np.uint8)
    if deed == 6:
        return np.full((height, width), rng.choice((0, 1, 127, 205, 254, 255)), np.uint8)
    return noise.integers(0, 256, (height, width), np.uint8)


def _encoded(rng: Random, cells: Any) -> tuple[str, bytes]:
    """Return the name and the bytes of a picture."""
    height, width = cells.shape
    small, deed = cells.size < 10**6, rng.randrange(8)
    if deed <= 2:
        return "m.pgm", b"P5\n# made\n%d %d\n%d\n" % (
            width,
            height,
            rng.choice((255, 255, 255, 255, 1, 0)),
        ) + cells.tobytes()
    if deed == 3 and small:
        return "m.pgm", b"P2 %d %d 255\n" % (width, height) + " ".join(map(str, cells.ravel().tolist())).encode()
    if deed == 4 and small:
        return "m.pgm", b"P5 %d %d 65535\n" % (width, height) + (cells.astype(">u2") * 257).tobytes()
    if deed == 5 and small:
        cells = np.dstack([cells] * rng.choice((3, 4)))
    elif deed == 6:
        cells = cells.astype(np.uint16) * 257
    return "m.png", cv2.imencode(".png", cells)[1].tobytes()


def _map_yaml(rng: Random, name: str) -> str:
    odd = (*map(str, NUMBERS),
           ".nan", "-.inf", "1e-9", "0.001", "10", "11", "true", "text", "", "[1, 2]", "{a: 1}",
           "0x10", "1:30", "9" * 5000, "*a", "&a [*a]", "!!python/name:os.system", "2020-01-01", "[[0, 0, 0]]",
           "[1e9, -1e9, 3]", "[0, 0, .inf]", "[0.2, 0.1, 0.7]", '"\\e[2J"')  # fmt: skip
    keys = {"image": name, "resolution": f"{CELL}", "origin": f"[{CORNER}, {CORNER}, 0]", "negate": "0",
            "occupied_thresh": "0.65", "free_thresh": "0.196"}  # fmt: skip
    if rng.random() < 0.3:
        for key in rng.sample(sorted(keys), rng.choice((1, 1, 2))):
            files = ("/dev/zero", "map.yaml", ".", "../x", "nothing.png", *odd)
            keys[key] = rng.choice(files if key == "image" else odd)
    text = "".join(f"{key}: {value}\n" for key, value in keys.items())
    if rng.random() < 0.03:
        text = "a0: &a0 [x,x,x,x,x,x,x,x,x]\n" + text
        text = "".join(f"a{i}: &a{i} [{','.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 10)) + text
    if rng.random() < 0.15:
        colons = text.replace(": ", ":")
        return rng.choice((text * 2, colons, "[" * 3000, f"{text}? ", "- " * 999, f"{text}\t", f"%YAML 9\n{text}"))
    return damaged(rng, text.encode())[0].decode("utf-8", "replace") if rng.random() < 0.1 else text


def line_maps(rng: Random, case: Draft) -> Draft:
    """Give a line map of few or very many walls, some of which are odd."""
    odd, count = rng.choice((0.0, 0.02, 0.5)), rng.choice((1, 8, 12, 12, 64, 1000, 10_000))
    ends = walls(12).tolist() if count == 12 else []
    ends += [[rng.uniform(-20, 20) for _ in range(4)] for _ in range(count - len(ends))]

    def number(usual: float) -> float:
        return rng.choice((0.0, 1e308, 1e-310, 1e30, -1e9, 1e6, -1.0)) if rng.random() < odd else usual

    lines = [
        {"id": rng.choice((0, -1, 2**63 - 1, i)) if rng.random() < odd else i,
         "from": [number(x0), number(y0)], "to": [number(x1), number(y1)], "hits": rng.choice((0, 5, -1)),
         "covariance": [[number(1e-4), 0.0], [0.0, number(1e-5)]]}
        for i, (x0, y0, x1, y1) in enumerate(ends)
    ]  # fmt: skip
    text = json.dumps({"format": "locfuse line map", "version": 1, "lines": lines}).encode()
    text = damaged(rng, text)[0] if rng.random() < 0.15 else text
    return _commanded(case, ("--map", "{here}/map.json"), {"map.json": text})


def detection_files(rng: Random, case: Draft) -> Draft:
    """Give detections.csv: many lines and ids, one column of which is odd; with a map of landmarks, or none."""
    noise, count = np.random.default_rng(rng.randrange(2**32)), rng.choice(ROWS)
    known = max(rng.choice((1, 5, count // 200, count // 20, count)), 1)
    places = noise.uniform((-1.0, -1.0), (9.0, 7.0), (known, 2))
    together = rng.choice((1, 1, 5, 50))
    t = np.sort(noise.uniform(0.0, 2.4, count // together + 1)).repeat(together)[:count]
    which = noise.integers(0, known, count)
    pose = Loop().pose(t)
    dx, dy = (places[which] - pose[:, :2]).T
    bearings = np.arctan2(dy, dx) - pose[:, 2]
    stamps = case.spoken[0].message.log_time * 1e-9 + t
    columns = [[f"{v:.9f}" for v in stamps], [f"{i}" for i in which]]
    columns += [[f"{v:.4f}" for v in numbers] for numbers in (np.hypot(dx, dy), bearings)]
    column, odd = rng.choice(list(zip(columns, (ODD_TIMES, ODD_IDS, ODD_NUMBERS, ODD_NUMBERS), strict=True)))
    share = rng.choice((0.0, 0.01, 0.5, 1.0))
    column[:] = [rng.choice(odd) if rng.random() < share else value for value in column]
    rows = [",".join(row) + "\n" for row in zip(*columns, strict=True)]
    files = {"d.csv": ("t,id,range,bearing\n" + "".join(rows)).encode()}
    words = ["--set", "landmarks.file={here}/d.csv"]
    if rng.random() < 0.5:
        lines = [f"{i},{x},{y}\n" for i, (x, y) in enumerate(places.tolist())]
        healthy = ("id,x,y\n" + "".join(lines)).encode()
        files["m.csv"] = rng.choice(
            (healthy, healthy, damaged(rng, healthy)[0], mutated(TARGETS["landmarks"], rng))
        )
        words += ["--set", "landmarks.map={here}/m.csv"]
    return case.more(tuple(words), files)


def _commanded(case: Draft, words: tuple[str, ...], files: dict[str, bytes]) -> Draft:
    """Return the case with a map, by a command that takes one."""
    command = case.command if case.command[0] in {"run", "compare"} else ("run",)
    return replace(case, command=command).more(words, files)


DEEDS = (map_pictures, line_maps, detection_files)
