"""Versions of installed packages."""

from __future__ import annotations


def installed(distribution: str) -> str | None:
    """Return the version of an installed package; None if it is not installed."""
    from importlib import metadata

    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return None


def own() -> str:
    """Return the version of locfuse."""
    return installed("locfuse") or "unknown"
