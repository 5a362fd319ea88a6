"""From a measured log to what is written and said: report, files, exit code."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from locfuse.formats.report import json_report
from locfuse.formats.robot import robot_toml
from locfuse.fusion.data import Evaluation
from locfuse.fusion.robot import Robot

from .load import Loaded

LOSS = 3
REFUSED_SHARE = 0.01  # of a used sensor's readings: more is a loss
# exact repeats, readings before or after the wheels, messages of an arm on the wheels' topic
NOT_A_LOSS = ("repeat", "outside_wheels", "other_joints", "other_bodies", "not_in_map")


def settings_tables(robot: Robot) -> dict[str, Any]:
    """Return the effective settings as robot.toml tables, keys without a value left out."""
    structs = {"wheels": robot.wheels, "start": robot.start, "truth": robot.truth, **robot.sensors}
    tables: dict[str, Any] = {"order": robot.order, "preset": robot.preset}
    for name, struct in structs.items():
        tables[name] = {k: v for k, v in msgspec.to_builtins(struct).items() if v is not None}
    return tables


def robot_file(robot: Robot) -> str:
    """Return the effective settings as robot.toml."""
    return robot_toml.dump(settings_tables(robot))


def build(loaded: Loaded, evaluations: Sequence[Evaluation]) -> dict[str, Any]:
    """Return the report as plain values."""
    from importlib.metadata import version

    return json_report.report(
        loaded.drive,
        evaluations,
        source(loaded),
        settings_tables(loaded.robot),
        version("locfuse"),
    )


def source(loaded: Loaded) -> dict[str, Any]:
    """Return what the input was: names, hash, topics by role, counts, what was lost."""
    log = loaded.log
    return {
        "name": log.name,
        "files": [p.name for p in log.paths],
        "sha256": log.sha256,
        "topics": dict(loaded.choice.topics),
        "messages": {topic: info.count for topic, info in log.topics.items()},
        "losses": log.losses.by_reason(),
    }


def default_folder(name: str) -> Path:
    """Return where results go unless -o says otherwise."""
    return Path("locfuse-out") / name


def loss_lines(loaded: Loaded, used: Sequence[str], strict: bool) -> list[str]:
    """Return in words what was lost: bytes of the file, or too large a share of a used stream's readings."""
    lines = list(loaded.log.losses.lines())
    for stream in ("wheels", *used):
        reasons = loaded.drive.dropped.get(stream, {})
        total = sum(loaded.log.topics[topic].count for topic in loaded.choice.of(stream))
        refused = _refused(reasons)
        if refused > (0 if strict else REFUSED_SHARE * total):
            lines.append(f"{stream}: {refused} of {total} readings refused ({_words(reasons)})")
    return lines


def _refused(reasons: Mapping[str, int]) -> int:
    return sum(count for reason, count in reasons.items() if reason not in NOT_A_LOSS)


def _words(reasons: Mapping[str, int]) -> str:
    return ", ".join(f"{c} {r.replace('_', ' ')}" for r, c in reasons.items() if r not in NOT_A_LOSS)
