"""The world we can know exactly: the simulated robot, its scenarios, and the logs it recorded."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

from locfuse.fusion.data import UsageError


def names() -> list[str]:
    """Return the names of the logs that come with the package."""
    files = resources.files(__package__).iterdir()
    return sorted(f.name.removesuffix(".mcap") for f in files if f.name.endswith(".mcap"))


def path(name: str) -> Path:
    """Return where a shipped log lies. Raises UsageError for a name there is not."""
    if name not in names():
        raise UsageError(f"no sample log {name}: there are {', '.join(names())}")
    return Path(str(resources.files(__package__).joinpath(f"{name}.mcap")))
