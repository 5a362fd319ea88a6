"""Styles of lines and points on a dark page, and a legend of the colours.

One colour means one thing: what was refused is red and nothing else is.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import rerun as rr

from .recorder import TimelineRecorder, part
from .scene import MATCHED, NEW, REJECTED, RerunScene, Rgb

Colour = tuple[int, int, int] | tuple[int, int, int, int]


def on_screen(points: float) -> Any:
    """Return a half width in points of the screen, the same at every zoom."""
    return rr.Radius.ui_points(points)


def lines(colour: Colour, width: float, order: float | None = None) -> rr.LineStrips2D:
    """Return the style of line strips, with labels on hover."""
    return rr.LineStrips2D.from_fields(
        colors=[colour], radii=[on_screen(width)], draw_order=order, show_labels=False
    )


def points(colour: Colour, width: float) -> rr.Points2D:
    """Return the style of points."""
    return rr.Points2D.from_fields(colors=[colour], radii=[on_screen(width)])


TRUTH: Rgb = (244, 245, 247)
FIELDS: tuple[Rgb, ...] = ((240, 165, 40), (80, 165, 235), (215, 110, 190), (150, 120, 240), (60, 190, 190))
LANDMARK: Rgb = (255, 60, 230)
FIRST_WALL: Rgb = (120, 80, 40)
WALL: Rgb = (225, 205, 150)
SCAN: Rgb = (110, 165, 200)
LIMIT: Rgb = (255, 235, 60)
LEVEL: Rgb = (205, 205, 210)
LOOP: Rgb = (235, 210, 255)

GROUPS: dict[str, Rgb] = {MATCHED: (40, 185, 50), REJECTED: (240, 60, 50), NEW: (0, 225, 235)}

# states of one reading on the gate timeline, the worst last: a stretch that is drawn as one shows its worst
STATES: dict[str, Rgb] = {
    "accepted": (60, 150, 85),
    "new": (70, 125, 205),
    "absent": (95, 95, 100),
    "partly": (200, 165, 60),
    "rejected": (205, 70, 60),
}


def faded(colour: Rgb, alpha: int) -> tuple[int, int, int, int]:
    """Return the colour with this opacity (0..255)."""
    return (*colour, alpha)


LEGEND = "legend"
COLUMNS, CELL = 7, 4.0  # words in a row, and their distance in heights of a row


def legend_entries(scene: RerunScene) -> Iterator[tuple[str, Rgb]]:
    """Yield (words, colour) of everything on the map, configurations first."""
    for e in scene.estimates:
        yield e.name, scene.colour(e.name)
    if scene.drive.truth is not None:
        yield "truth", TRUTH
    if any(e.audits for e in scene.estimates):
        yield "matched", GROUPS[MATCHED]
        yield "refused", GROUPS[REJECTED]
        yield "new", GROUPS[NEW]
    if any(e.final_map for e in scene.estimates):
        yield "wall", WALL
        yield "wall at first sight", FIRST_WALL
    if any(len(e.loops) for e in scene.estimates):
        yield "loop closed", LOOP
    if scene.scans is not None:
        yield "scan", SCAN
    if any(sight.landmark is not None for sight in scene.sights.values()):
        yield "landmark", LANDMARK


def legend_bounds(scene: RerunScene) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the least and greatest corner of the strip."""
    rows = -(-len(list(legend_entries(scene))) // COLUMNS)
    return (-0.5 * CELL, -0.2), ((COLUMNS - 0.5) * CELL, rows - 0.1)


def draw_legend(to: TimelineRecorder, scene: RerunScene) -> None:
    """Send the text of each entry in its colour."""
    for i, (words, colour) in enumerate(legend_entries(scene)):
        row, column = divmod(i, COLUMNS)
        words_at = rr.Points2D([[column * CELL, float(row)]], labels=[words], show_labels=True)
        to.static(f"{LEGEND}/{part(words)}", words_at, points(colour, 3.0))
