"""The simulated world: the robot, its scenarios, and the logs it recorded, all exactly known."""

from __future__ import annotations

from pathlib import Path

from locfuse.fusion.data import UsageError

HERE = Path(__file__).parent


def names() -> list[str]:
    """Return the names of the logs that come with the package."""
    return sorted(f.stem for f in HERE.glob("*.mcap"))


def path(name: str) -> Path:
    """Return the path of a shipped log. Raises UsageError for an unknown name."""
    if name not in names():
        raise UsageError(f"no sample log {name}: there are {', '.join(names())}")
    return HERE / f"{name}.mcap"
