"""`locfuse explain`: what a word of a report means."""

from __future__ import annotations

import click

from locfuse.cli.terminal.screen import put, reader_may_leave


@click.command()
@click.argument("term", required=False)
def explain(term: str | None) -> int:
    """Say what TERM of a report or what a sensor is; without TERM, list the terms.

    \b
    locfuse explain ANEES
    locfuse explain drift
    """
    from locfuse.formats.report.glossary import GLOSSARY, explained, similar
    from locfuse.fusion.data import UsageError

    words = None if term is None else explained(term) or _sensor(term)
    if term is not None and words is None:
        raise UsageError(f"no such term: {term}. Known: {', '.join(similar(term))}")
    with reader_may_leave():
        put(words + "\n" if words is not None else "".join(f"{name}: {text}\n" for name, text in GLOSSARY.items()))
    return 0


def _sensor(term: str) -> str | None:
    """Return what a sensor reads and measures, None for what is no sensor."""
    from locfuse.fusion.sensors.registry import REGISTRY

    sensor = REGISTRY.get(term.strip().lower())
    if sensor is None:
        return None
    measured = ", ".join(f"{part.name} [{part.unit}]" for part in sensor.components)
    return f"Sensor. Reads {', '.join(sensor.reads)}; measures {measured}. Its settings: docs/settings.md"
