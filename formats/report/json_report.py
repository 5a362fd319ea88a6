"""report.json and run.json, the interface for other programs.

Values are in SI units, with the unit in the key, unless the key says otherwise (`_deg`); null: there is no value.
"""

from __future__ import annotations

import math
import platform
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
from msgspec.structs import asdict

from locfuse.formats.text import escaped, writable
from locfuse.formats.versions import installed
from locfuse.fusion.data import Drive, Evaluation, LocfuseError
from locfuse.fusion.kernels.built import how

SCHEMA_VERSION = 1  # of report.json and run.json; locfuse 0.1 wrote none

OPENCV = "opencv-python-headless opencv-python opencv-contrib-python-headless opencv-contrib-python"
LIBRARIES = {"numpy": ["numpy"], "opencv": OPENCV.split()}  # library -> names of its packages (distributions)


def report(
    drive: Drive,
    evaluations: Sequence[Evaluation],
    source: Mapping[str, Any],
    settings: Mapping[str, Any],
    version: str,
) -> dict[str, Any]:
    """Return the content of report.json as plain values, before verdicts and findings are added."""
    judged = evaluations[0] if evaluations and len(evaluations[0].t) else None
    truth = drive.truth and {
        "topic": drive.truth.topic,
        "stamps": len(drive.truth.t),
        "used": 0 if judged is None else len(judged.t),
        "heading": drive.truth.theta is not None,
        "distance_m": None if judged is None else float(judged.distance[-1]),
    }
    return {
        "schema_version": SCHEMA_VERSION,
        "locfuse": version,
        "made_with": made_with(),
        "input": {**source, "dropped": {k: dict(v) for k, v in drive.dropped.items() if v}},
        "configurations": {
            e.name: {
                "configuration": e.configuration,
                **e.figures,
                "align": e.align,
                "reference": None,  # errors are estimate - truth
                "smoothed": e.smoothed,
                "rates_hz": dict(e.rates),
                "lost": [list(interval) for interval in e.lost],
                "lost_share": e.lost_share,
                "notes": list(e.notes),
                "sensors": {name: asdict(s) for name, s in e.sensors.items()},
            }
            for e in evaluations
        },
        "truth": truth,
        "absent": drive.absent,
        "notes": list(drive.notes),
        "settings": dict(settings),
    }


def same_input(a: Mapping[str, Any], b: Mapping[str, Any]) -> bool:
    """Return whether two inputs are the same log: equal SHA-256 if both have one, else equal identity."""
    both = next((k for k in ("sha256", "identity") if a.get(k) is not None and b.get(k) is not None), None)
    return both is not None and bool(a[both] == b[both])


def made_with() -> dict[str, str | None]:
    """Return the versions of Python, CPU, NumPy, OpenCV and kernels, which affect the last digits of results."""
    found: dict[str, str | None] = {"python": platform.python_version(), "machine": platform.machine()}
    for name, distributions in LIBRARIES.items():
        found[name] = next((v for d in distributions if (v := installed(d)) is not None), None)
    return {**found, "core": how()}


def encode(value: Mapping[str, Any]) -> str:
    """Return indented JSON; NaN and infinity become null, control characters are escaped."""
    return escaped(msgspec.json.format(msgspec.json.encode(_finite(value)), indent=2).decode()) + "\n"


def plain(report: Mapping[str, Any]) -> dict[str, Any]:
    """Return the report as JSON would store it: lists for tuples, None for NaN and infinity."""
    values: dict[str, Any] = _finite(report)
    return values


def readable(report: Mapping[str, Any], source: str) -> dict[str, Any]:
    """Return the report if its schema_version can be read; else raise LocfuseError, which names `source`.

    Values that are not a report raise KeyError, TypeError or AttributeError.
    """
    version, writer = report.get("schema_version", 0), report["locfuse"]
    if version != SCHEMA_VERSION:
        raise LocfuseError(
            f"{source}: schema_version {version}, written by locfuse {writer}; this locfuse reads "
            f"{SCHEMA_VERSION}. Update locfuse, or make the report again with: locfuse compare LOG -o DIR"
        )
    return dict(report)


def _finite(value: Any) -> Any:
    """Return a value with None in place of NaN and infinity, and with strings that UTF-8 can encode.

    Values inside tables and lists are replaced too, at any depth.
    """
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {writable(str(k)): _finite(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(v) for v in value]
    return writable(value) if isinstance(value, str) else value
