"""What `locfuse info` prints: tables for people, JSON for machines."""

from __future__ import annotations

from typing import Any

import click

from ..formats import report_json
from ..fusion.sensors.registry import REGISTRY
from .look import Look, extrinsics
from .topic_facts import TopicFacts


def as_json(seen: Look) -> str:
    """Return everything as JSON text."""
    return report_json.encode(values(seen))


def values(seen: Look) -> dict[str, Any]:
    """Return everything as plain values."""
    span = seen.log.time_span_ns
    return {
        "name": seen.log.name,
        "files": [p.name for p in seen.log.paths],
        "bytes": sum(p.stat().st_size for p in seen.log.paths),
        "duration_s": (span[1] - span[0]) * 1e-9 if span else None,
        "start_ns": span[0] if span else None,
        "checksums": not seen.log.unchecked,
        "topics": {f.topic: f.values() for f in seen.facts},
        "roles": {
            role: {"topics": list(seen.choice.of(role)), "why": seen.choice.why.get(role)}
            for role in seen.choice.topics
        },
        "absent": absent(seen),
        "extrinsics": extrinsics(seen),
        "configurations": configurations(seen),
        "oddities": [
            {"code": o.code, "stream": o.stream, "words": o.words, "cures": list(o.cures), "spoils": o.spoils}
            for o in seen.oddities
        ],
    }


def absent(seen: Look) -> dict[str, str]:
    """Return why a role has no topic, or a sensor no use."""
    return {**seen.choice.absent, **(seen.loaded.drive.absent if seen.loaded is not None else {})}


def configurations(seen: Look) -> dict[str, str | None]:
    """Return for odometry and each sensor what is missing, None where nothing is."""
    missing = absent(seen)
    base = None
    if seen.loaded is None:
        base = next((o.words for o in seen.oddities if o.spoils), None) or missing.get(
            "wheels", "it cannot be measured"
        )
    return {"odometry": base, **{name: missing.get(name) or base for name in REGISTRY}}


def show(seen: Look) -> None:
    """Print it for people."""
    facts = values(seen)
    seconds = f"{facts['duration_s']:.1f} s" if facts["duration_s"] is not None else "no messages"
    files = f"{len(facts['files'])} file{'s' if len(facts['files']) > 1 else ''}"
    click.echo(f"{facts['name']}: {seconds}, {files}, {facts['bytes'] / 1e6:.1f} MB")
    _topics(seen)
    click.echo("what reads what")
    for role in seen.choice.topics:
        topics = " and ".join(seen.choice.of(role))
        click.echo(f"  {role:8} {topics} ({seen.choice.why.get(role, '')}){_mount(facts['extrinsics'].get(role))}")
    click.echo("configurations")
    for name, what in facts["configurations"].items():
        click.echo(f"  {name:8} {'ready' if what is None else f'missing: {what}'}")
    _oddities(seen)


def _topics(seen: Look) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for i, title in enumerate(("topic", "type", "messages", "Hz", "gaps", "clock", "frame")):
        table.add_column(title, justify="right" if i in {2, 3, 4} else "left", overflow="fold")
    for f in seen.facts:
        table.add_row(*(Text(cell) for cell in _cells(f)))
    Console().print(table)


def _cells(f: TopicFacts) -> tuple[str, ...]:
    rate = f"{f.rate_hz:.1f}" if f.rate_hz is not None else "-"
    silent = f"{len(f.gaps)}, {max(b - a for a, b in f.gaps):.1f} s" if f.gaps else "-"
    late = f", {f.delay_s * 1e3:.0f} ms late" if f.delay_s is not None and abs(f.delay_s) < 10.0 else ""
    clock = f.problem or (f"{f.clock.partition(';')[0]}{late}")
    return f.topic, f.msgtype.replace("/msg/", "/"), str(f.count), rate, silent, clock, f.frame_id


def _mount(mount: dict[str, Any] | None) -> str:
    if mount is None:
        return ""
    if "mounts" in mount:
        return f", mounts by {mount['by']}"
    parts = [f"{mount[k]:.3g} m" for k in ("x", "y") if k in mount]
    parts += [
        f"{mount[k]:.3g} deg {k.removesuffix('_deg')}"
        for k in ("roll_deg", "pitch_deg", "yaw_deg")
        if mount.get(k)
    ]
    parts += ["upside-down"] if mount.get("flipped") else []
    return f", at {', '.join(parts)} by {mount['by']}" if parts else ""


def _oddities(seen: Look) -> None:
    spoil = [o for o in seen.oddities if o.spoils]
    rest = [o for o in seen.oddities if not o.spoils]
    for title, oddities in (("would spoil an estimate", spoil), ("worth knowing", rest)):
        if oddities:
            click.echo(title)
        for o in oddities:
            click.echo(f"  {o.stream}: {o.words}")
            if o.cures:
                click.echo("    cure: " + " ".join(f"--set {cure}" for cure in o.cures))
