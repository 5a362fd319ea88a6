"""The world we can know exactly: the simulated robot, its scenarios, and the logs it recorded."""

from __future__ import annotations

from pathlib import Path

from locfuse.fusion.data import UsageError

HERE = Path(__file__).parent


def names() -> list[str]:
    """Return the names of the logs that come with the package."""
    return sorted(f.stem for f in HERE.glob("*.mcap"))


def path(name: str) -> Path:
    """Return where a shipped log lies. Raises UsageError for a name there is not."""
    if name not in names():
        raise UsageError(f"no sample log {name}: there are {', '.join(names())}")
    return HERE / f"{name}.mcap"
