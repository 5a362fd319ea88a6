"""What a term of a report means, and what a sensor reads."""

from __future__ import annotations

from locfuse.formats.report.glossary import explained, similar
from locfuse.fusion.data import UsageError


def explain(term: str) -> str:
    """Return what a term or a sensor is, whatever its case. Raises UsageError for any other word."""
    words = explained(term) or _sensor(term.strip().lower())
    if words is None:
        raise UsageError(f"no such term: {term}. Known: {', '.join(similar(term))}")
    return words


def _sensor(name: str) -> str | None:
    """Return what a sensor reads and measures, None for what is no sensor."""
    from locfuse.fusion.sensors.registry import REGISTRY

    if name not in REGISTRY:
        return None
    sensor = REGISTRY[name]
    measured = ", ".join(f"{part.name} [{part.unit}]" for part in sensor.components)
    return f"Sensor. Reads {', '.join(sensor.reads)}; measures {measured}. Its settings: docs/settings.md"
