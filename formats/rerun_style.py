"""How lines and points look, as archetypes that are sent once and hold at all times."""

from __future__ import annotations

from typing import Any

from .rerun_later import rr

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
