"""What a report notes about its motion source: void figures, and wheels that could not be used."""

from __future__ import annotations

import shlex
from typing import Any

from .load import Loaded
from .refused_motion import void_all
from .results import log_words
from .wheel_topics import unused_words


def say_motion(report: dict[str, Any], loaded: Loaded) -> None:
    """Add to a report what its reader must know about the motion before any figure."""
    void_all(report, loaded.spoils)
    if words := unused_words(loaded.choice):
        command = shlex.join(("locfuse", "init", *log_words(loaded.log), "-o", "robot.toml"))
        report["headline"] = f"{words}: `{command}` asks for them. {report['headline']}"
