"""Colours of what is drawn beside the configurations, on a dark page."""

from __future__ import annotations

from locfuse.fusion.data import VERDICTS

from .rerun_scene import Rgb

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
GROUP_OF = tuple(MATCHED if v == "accepted" else NEW if v == "new" else REJECTED for v in VERDICTS)

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
