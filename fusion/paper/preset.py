"""Choice of the filter by preset: locfuse's filter, or the filter of the paper as printed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from locfuse.fusion.data import Estimates
from locfuse.fusion.robot import Preset

# Default settings of a preset; robot.toml and --set override them.
TABLES: dict[Preset, dict[str, Any]] = {
    "default": {},
    "paper": {"lrf": {"map": "first-scan"}, "camera": {"chain": "paper", "bearing": "absolute"}},
}
PAPER_SENSORS = ("compass", "lrf", "camera")
NOTE = (
    "preset paper: the printed equations with the printed noise (delta, R); the sigmas, gates and the map of "
    "robot.toml are not used. See docs/paper.md"
)


def fuser(preset: Preset) -> Callable[..., Estimates]:
    """Return the function that runs the filter of a preset; its arguments are those of `fusion.fuse.fuse`."""
    if preset == "paper":
        from .filter import fuse_as_printed

        return fuse_as_printed
    from locfuse.fusion.fuse import fuse

    return fuse
