"""A finding: one fact about a log for its user, with the settings that fix it."""

from __future__ import annotations

from typing import NamedTuple

import msgspec

from locfuse.fusion.data import LocfuseError


class Least(NamedTuple):
    """Limits below which an error is not reported."""

    error: float  # relative
    sigmas: float  # standard errors that it must exceed as well


class Finding(msgspec.Struct, frozen=True):
    """Finding on a log: a harmless peculiarity, a repaired fault, or an error that makes estimates wrong."""

    role: str  # wheels, a sensor, truth, log, file, or a topic
    code: str  # one word or two, for machines and tests
    message: str
    fixes: tuple[str, ...] = ()  # "table.key=value": all of them together are the fix
    severe: bool = False  # whether estimates with the present settings would be wrong
    source: str = ""  # where the values of the fixes come from, if not from the drive
    hint: str = ""  # what to try next, for a caller that does not print the fixes

    @property
    def sentence(self) -> str:
        """Message with source and hint."""
        return f"{self._whole} {self.hint}" if self.hint else self._whole

    @property
    def brief(self) -> str:
        """Message with source, for a caller that prints the fixes separately."""
        return self._whole.rstrip(".:;?") if self.hint else self._whole

    @property
    def _whole(self) -> str:
        return f"{self.message}; {self.source}" if self.source else self.message

    @property
    def line(self) -> str:
        """The whole finding in one line, with the command-line options that fix it."""
        return f"{self.role}: {self.sentence}" + "".join(f" --set {fix}" for fix in self.fixes)


def of_error(error: LocfuseError, role: str, code: str) -> Finding:
    """Return a severe finding on the sensor or stream `role`, with the message, fixes and hint of an error."""
    message = error.message if error.role in {role, ""} else f"{error.role}: {error.message}"
    return Finding(role, code, message, error.fixes, severe=True, hint=error.hint)
