"""What a report says of the motion that was used: wheels that cannot be used first, scans by their name."""

from __future__ import annotations

import shlex
from typing import Any

from locfuse.fusion.data import BY_SCANS, ODOMETRY

from .load import Loaded
from .refused_motion import void_all
from .results import log_words
from .wheel_topics import unused_words


def say_motion(report: dict[str, Any], loaded: Loaded) -> None:
    """Put into a finished report what its reader must know of the motion before any figure."""
    if loaded.matched is not None:
        _call_scans_by_their_name(report)
    void_all(report, loaded.spoils)
    if words := unused_words(loaded.choice):
        command = shlex.join(("locfuse", "init", *log_words(loaded.log), "-o", "robot.toml"))
        report["headline"] = f"{words}: `{command}` asks for them. {report['headline']}"


def _call_scans_by_their_name(report: dict[str, Any]) -> None:
    """Say "scan matching" where words speak of the odometry that the sensors are compared with."""
    for verdict in (report.get("verdicts") or {}).values():
        verdict["words"] = verdict["words"].replace(ODOMETRY, BY_SCANS)
    said = report["headline"].replace(ODOMETRY, BY_SCANS)
    report["headline"] = said.replace(ODOMETRY.capitalize(), BY_SCANS.capitalize())
    if report.get("reference"):
        report["reference"]["words"] = report["reference"]["words"].replace(ODOMETRY, BY_SCANS)
