"""The meaning of a report's terms, and the description of sensors."""

from __future__ import annotations

from locfuse.formats.report.glossary import explained, similar
from locfuse.fusion.data import UsageError


def explain(term: str) -> str:
    """Return the meaning of a term or sensor in any case. Raises UsageError for any other word."""
    words = explained(term) or _sensor(term.strip().lower())
    if words is None:
        raise UsageError(f"no such term: {term}. Known: {', '.join(similar(term))}")
    return words


def _sensor(name: str) -> str | None:
    """Return a sensor's messages and measurements, None if it is no sensor."""
    from locfuse.fusion.sensors.registry import REGISTRY

    if name not in REGISTRY:
        return None
    sensor = REGISTRY[name]
    measured = ", ".join(f"{part.name} [{part.unit}]" for part in sensor.components)
    return f"Sensor. Reads {', '.join(sensor.reads)}; measures {measured}. Its settings: docs/settings.md"
