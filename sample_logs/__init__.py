"""Simulation of a robot with known truth: scenarios, simulator, and sample logs."""

from __future__ import annotations

from pathlib import Path

from locfuse.fusion.data import UsageError

HERE = Path(__file__).parent


def names() -> list[str]:
    """Return the names of the sample logs in the package."""
    return sorted(f.stem for f in HERE.glob("*.mcap"))


def path(name: str) -> Path:
    """Return the path of a sample log. Raises UsageError for an unknown name."""
    if name not in names():
        raise UsageError(f"no sample log {name}: there are {', '.join(names())}")
    return HERE / f"{name}.mcap"
