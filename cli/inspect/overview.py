"""Everything that `info` and `init` found in a log, as values."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from locfuse.cli.choose.topics import Choice
from locfuse.cli.pipeline.load import Loaded
from locfuse.formats.log.log import Log
from locfuse.formats.robot.transforms import StaticTransforms
from locfuse.fusion.doctor.finding import Finding
from locfuse.fusion.robot import Robot

from . import robot_facts
from .topics import TopicFacts


@dataclass
class Look:
    """What was seen."""

    log: Log
    tables: dict[str, Any]  # robot.toml as merged, before mounts
    choice: Choice
    facts: list[TopicFacts]
    transforms: StaticTransforms
    robot: Robot  # with mounts where the log could be measured
    loaded: Loaded | None = None
    hints: robot_facts.Hints = field(default_factory=robot_facts.Hints)
    findings: list[Finding] = field(default_factory=list)

    @property
    def severe(self) -> bool:
        """Whether an estimate would be wrong, or bytes are lost."""
        return any(f.severe for f in self.findings)
