"""Everything that `info` and `init` found in a log, as values."""

from __future__ import annotations

from typing import Any

import msgspec
from msgspec import field

from locfuse.cli.analysis.load import Loaded
from locfuse.cli.analysis.topics import Choice
from locfuse.formats.logs.log import Log
from locfuse.formats.robot.transforms import StaticTransforms
from locfuse.fusion.checks.finding import Finding
from locfuse.fusion.robot import Robot

from .robot_facts import RobotFacts
from .topics import TopicFacts


class Overview(msgspec.Struct):
    """A log as it is found: topics, roles, mounts, clocks, findings."""

    log: Log
    tables: dict[str, Any]  # robot.toml as merged, before mounts
    choice: Choice
    facts: list[TopicFacts]
    transforms: StaticTransforms
    robot: Robot  # with mounts where the log could be measured
    loaded: Loaded | None = None
    robot_facts: RobotFacts = field(default_factory=RobotFacts)
    findings: list[Finding] = field(default_factory=list)

    @property
    def severe(self) -> bool:
        """Whether an estimate would be wrong, or bytes are lost."""
        return any(f.severe for f in self.findings)
