"""Versions of distributions that are installed."""

from __future__ import annotations


def installed(distribution: str) -> str | None:
    """Return the version of a distribution, None if it is not installed."""
    from importlib import metadata

    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return None


def own() -> str:
    """Return the version of locfuse."""
    return installed("locfuse") or "unknown"
