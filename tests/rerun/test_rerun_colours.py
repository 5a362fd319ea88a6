"""A colour on the map means one thing."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from locfuse.cli.rerun.scene import palette as shades
from locfuse.formats.figures import palette
from locfuse.formats.figures.palette import Trace
from locfuse.formats.rerun import style
from locfuse.formats.rerun.scene import REJECTED
from locfuse.fusion.sensors.registry import colours

Array = NDArray[np.float64]
APART = 20.0  # in CIELAB, where 2.3 is just noticeable


def lab(rgb: tuple[int, ...]) -> Array:
    """CIE 1976 L*a*b* under D65."""
    c = np.array(rgb[:3]) / 255.0
    linear = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
    to_xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    xyz = to_xyz @ linear / np.array([0.9505, 1.0, 1.089])
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16.0 / 116.0)
    return np.array([116.0 * f[1] - 16.0, 500.0 * (f[0] - f[1]), 200.0 * (f[1] - f[2])])


def web(colour: str) -> tuple[int, ...]:
    return tuple(bytes.fromhex(colour.removeprefix("#")))


def test_nothing_on_the_map_shares_a_colour_with_anything_else() -> None:
    sensors = {name: web(c.dark) for name, c in colours().items()}
    runs = {"odometry": web(palette.ODOMETRY.dark), "all": web(palette.ALL.dark)}
    things = {
        "landmark": style.LANDMARK,
        "wall": style.WALL,
        "wall at first sight": style.FIRST_WALL,
        "scan": style.SCAN,
        "loop closed": style.LOOP,
        **style.GROUPS,
    }
    labs = {name: lab(rgb) for name, rgb in {**sensors, **runs, **things}.items()}
    near = [(a, b) for a, b in combinations(labs, 2) if np.linalg.norm(labs[a] - labs[b]) < APART]
    assert near == []


def test_a_smoothed_result_has_a_shade_of_its_own() -> None:
    for sensors in (("lrf",), ("compass", "lrf", "camera")):
        name = "lrf" if len(sensors) == 1 else "all"
        drawn = shades({name: Trace(name, sensors), f"{name}-smoothed": Trace(name, sensors, smoothed=True)})
        plain, smoothed = (lab(rgb) for rgb in drawn.values())
        assert np.linalg.norm(plain - smoothed) > 20.0
        assert smoothed[0] < plain[0], "darker"


def test_red_is_what_was_refused_and_nothing_else() -> None:
    refused = lab(style.GROUPS[REJECTED])
    others = [style.TRUTH, style.LANDMARK, style.LIMIT, style.LEVEL, *style.FIELDS]
    assert all(np.linalg.norm(lab(rgb) - refused) > 2.0 * APART for rgb in others)
