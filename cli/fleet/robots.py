"""Which robot a log is of, by its path, and the settings of that robot."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import msgspec

from locfuse.fusion.data import UsageError

PLACE = "{robot}"  # in --robot: where the name of the robot goes


class Robots(msgspec.Struct, frozen=True):
    """How logs tell their robot, and where its settings are."""

    pattern: re.Pattern[str] | None
    settings: str | None  # the path of --robot, perhaps with {robot} in it

    @classmethod
    def of(cls, pattern: str | None, settings: Path | None) -> Robots:
        """Return it from the words of --robot-from and --robot. Raises UsageError for what cannot be one."""
        path = None if settings is None else str(settings)
        if path is not None and PLACE in path and pattern is None:
            raise UsageError(f"--robot {path}: say how a log's path names its robot with --robot-from REGEX")
        return cls(None if pattern is None else _compiled(pattern), path)

    def name(self, log: Sequence[str]) -> str | None:
        """Return the robot of a log by its path, as given or in full; None where the pattern is not in it."""
        if self.pattern is None:
            return None
        for path in (log[0], Path(log[0]).resolve().as_posix()):
            if found := self.pattern.search(path):
                return found["robot"] if "robot" in self.pattern.groupindex else found[1]
        return None

    def file(self, robot: str | None) -> str | None:
        """Return the robot.toml of a robot. Raises UsageError where there is none."""
        if self.settings is None or PLACE not in self.settings:
            return self.settings
        if robot is None or "/" in robot or robot.startswith("."):
            raise UsageError(f"--robot-from finds no robot in its path, and --robot {self.settings} needs one")
        path = self.settings.replace(PLACE, robot)
        if not Path(path).is_file():
            raise UsageError(f"--robot {self.settings}: {path} is no file")
        return path


def _compiled(pattern: str) -> re.Pattern[str]:
    try:
        compiled = re.compile(pattern)
    except re.error as problem:
        raise UsageError(f"--robot-from {pattern!r}: not a regular expression: {problem}") from None
    if not compiled.groups:
        raise UsageError(
            f"--robot-from {pattern!r}: put the robot's name in a group, such as 'fleet/(?P<robot>[^/]+)/'"
        )
    return compiled
