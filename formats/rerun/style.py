"""How lines and points look: archetypes that are sent once and hold at all times, and colours on a dark page."""

from __future__ import annotations

from typing import Any

from locfuse.fusion.data import VERDICTS

from .deferred import rr
from .scene import Rgb

Colour = tuple[int, int, int] | tuple[int, int, int, int]


def on_screen(points: float) -> Any:
    """Return a half width in points of the screen, the same at every zoom."""
    return rr.Radius.ui_points(points)


def lines(colour: Colour, width: float, order: float | None = None) -> rr.LineStrips2D:
    """Return the style of line strips; labels wait for the mouse."""
    return rr.LineStrips2D.from_fields(
        colors=[colour], radii=[on_screen(width)], draw_order=order, show_labels=False
    )


def points(colour: Colour, width: float) -> rr.Points2D:
    """Return the style of points."""
    return rr.Points2D.from_fields(colors=[colour], radii=[on_screen(width)])


TRUTH: Rgb = (244, 245, 247)
FIELDS: tuple[Rgb, ...] = ((240, 165, 40), (80, 165, 235), (215, 110, 190), (150, 120, 240), (60, 190, 190))
LANDMARK: Rgb = (235, 70, 60)
FIRST_WALL: Rgb = (135, 125, 110)
WALL: Rgb = (215, 205, 185)
SCAN: Rgb = (120, 170, 220)
LIMIT: Rgb = (235, 90, 80)
LEVEL: Rgb = (205, 205, 210)

MATCHED, REJECTED, NEW = "matched", "rejected", "new"
GROUPS: dict[str, Rgb] = {MATCHED: (90, 220, 120), REJECTED: (240, 80, 70), NEW: (90, 160, 255)}
GROUP = {"accepted": MATCHED, "repeated": MATCHED, "new": NEW}  # verdict -> group, REJECTED for the others
GROUP_OF = tuple(GROUP.get(v, REJECTED) for v in VERDICTS)

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
