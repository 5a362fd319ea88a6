"""Everything `locfuse info` knows as plain values: the keys of its --json (docs/bags.md)."""

from __future__ import annotations

from typing import Any

from locfuse.cli.choose.topics import types
from locfuse.fusion.doctor.finding import Finding
from locfuse.fusion.sensors.registry import REGISTRY

from .mounts import extrinsics
from .overview import Look


def values(seen: Look) -> dict[str, Any]:
    """Return everything as plain values."""
    span = seen.log.time_span_ns
    return {
        "name": seen.log.name,
        "files": [p.name for p in seen.log.paths],
        "bytes": sum(p.stat().st_size for p in seen.log.paths),
        "duration_s": (span[1] - span[0]) * 1e-9 if span else None,
        "start_ns": span[0] if span else None,
        "messages": sum(f.count for f in seen.facts),
        "checksums": not seen.log.unchecked,
        "topics": {f.topic: f.values() for f in seen.facts},
        "roles": {
            role: {"topics": list(seen.choice.of(role)), "why": seen.choice.why.get(role)}
            for role in seen.choice.topics
        },
        "absent": absent(seen),
        "extrinsics": extrinsics(seen),
        "configurations": configurations(seen),
        "findings": [_finding(f) for f in seen.findings],
        "severe": seen.severe,
    }


def absent(seen: Look) -> dict[str, str]:
    """Return why a role has no topic, or a sensor no use."""
    foreign = {name: f"no topic of type {types(REGISTRY[name].reads)}" for name in sorted(seen.choice.foreign)}
    measured = seen.loaded.drive.absent if seen.loaded is not None else {}
    return {**foreign, **seen.choice.absent, **measured}


def configurations(seen: Look) -> dict[str, str | None]:
    """Return for odometry, each sensor and all of them what is missing, None where nothing is."""
    missing, base = absent(seen), wheels_missing(seen)
    ready = {name: missing.get(name) or base for name in REGISTRY}
    together = None if any(why is None for why in ready.values()) else base or "no sensor beside the wheels"
    return {"odometry": base, **ready, "all": together}


def wheels_missing(seen: Look) -> str | None:
    """Return why nothing can be estimated from this log, None where something can."""
    if seen.loaded is not None:
        return None
    unready = (f.sentence for f in seen.findings if f.severe and f.role in {"wheels", "log"})
    return next(unready, None) or absent(seen).get("wheels", "the log cannot be measured")


def _finding(f: Finding) -> dict[str, Any]:
    return {
        "role": f.role,
        "code": f.code,
        "message": f.sentence,
        "fixes": list(f.fixes),
        "source": f.source or None,
        "severe": f.severe,
    }
