"""The output of `locfuse info --json` as plain values (keys: docs/bags.md)."""

from __future__ import annotations

from typing import Any

from locfuse.cli.analysis.topics import types
from locfuse.formats.logs.log import Log
from locfuse.fusion.data import BY_SCANS, ODOMETRY
from locfuse.fusion.sensors.registry import REGISTRY

from .robot_facts import Overview, extrinsics


def listed(log: Log) -> dict[str, dict[str, Any]]:
    """Return type, message count and mean rate [Hz] of each topic, without reading messages."""
    span = log.time_span_ns
    seconds = (span[1] - span[0]) * 1e-9 if span else 0.0
    return {
        name: {
            "type": topic.msgtype,
            "messages": topic.count,
            "rate_hz": (topic.count - 1) / seconds if topic.count > 1 and seconds > 0.0 else None,
        }
        for name, topic in log.topics.items()
    }


def values(overview: Overview) -> dict[str, Any]:
    """Return the result of an inspection as plain values."""
    span = overview.log.time_span_ns
    return {
        "name": overview.log.name,
        "files": [p.name for p in overview.log.paths],
        "bytes": overview.log.identity.size,
        "duration_s": (span[1] - span[0]) * 1e-9 if span else None,
        "start_ns": span[0] if span else None,
        "messages": sum(f.count for f in overview.facts if not f.derived),
        "checksums": not overview.log.unchecked,
        "topics": {f.topic: f.values() for f in overview.facts},
        "roles": {
            role: {"topics": list(overview.choice.of(role)), "why": overview.choice.why.get(role)}
            for role in overview.choice.topics
        },
        "absent": absent(overview),
        "extrinsics": extrinsics(overview),
        "configurations": configurations(overview),
        "findings": [
            {"role": f.role, "code": f.code, "message": f.sentence, "fixes": list(f.fixes)}
            | {"source": f.source or None, "severe": f.severe}
            for f in overview.findings
        ],
        "severe": overview.severe,
    }


def absent(overview: Overview) -> dict[str, str]:
    """Return by role or sensor why it has no topic or cannot be used."""
    foreign = {name: f"no topic of type {types(REGISTRY[name].reads)}" for name in sorted(overview.choice.foreign)}
    measured = overview.loaded.drive.absent if overview.loaded is not None else {}
    return {**foreign, **overview.choice.absent, **measured}


def configurations(overview: Overview) -> dict[str, str | None]:
    """Return the reason why a configuration cannot run (None if it can), for odometry, each sensor and "all"."""
    missing, base = absent(overview), wheels_missing(overview)
    known = [name for name in REGISTRY if name in missing or name in overview.choice.topics]
    ready = {name: missing.get(name) or base for name in known}
    together = None if any(why is None for why in ready.values()) else base or "no sensor beside the wheels"
    by_scans = overview.loaded is not None and overview.loaded.drive.wheels.matched is not None
    return {BY_SCANS if by_scans else ODOMETRY: base, **ready, "all": together}


def wheels_missing(overview: Overview) -> str | None:
    """Return why the robot's motion cannot be estimated from this log; None if it can be estimated."""
    if overview.loaded is not None:
        return None
    unready = (f.sentence for f in overview.findings if f.severe and f.role in {"wheels", "log"})
    return next(unready, None) or absent(overview).get("wheels", "the log cannot be measured")
