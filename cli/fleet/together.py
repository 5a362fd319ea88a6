"""The logs of each robot of a fleet asked together: settings that all of them show are tried on each."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from msgspec.structs import replace

from locfuse.cli.advice.together import ask
from locfuse.formats.fleet.entry import Entry
from locfuse.fusion.checks.together import Look
from locfuse.fusion.checks.tried import Fixes

from .job import Job, JobOutcome


def robots(
    entries: Sequence[Entry], jobs: Mapping[str, Job], run: Callable[[Sequence[Job]], Mapping[str, JobOutcome]]
) -> list[dict[str, Any]]:
    """Return for each robot with several logs what they have in common; logs of unnamed robots count as of one."""
    of: dict[str | None, dict[str, Mapping[str, Any]]] = {}
    for e in entries:
        if e.report.get("measured"):
            of.setdefault(e.robot, {})[e.name] = e.report["measured"]

    def look(names: Sequence[str], sets: Sequence[Fixes]) -> dict[str, Mapping[Fixes, Look]]:
        ended = run([replace(jobs[name], tries=tuple(sets)) for name in names])
        return {name: ended[name].looks for name in names if name in ended}

    return [{"robot": robot, **ask(logs, look)} for robot, logs in of.items() if len(logs) > 1]
