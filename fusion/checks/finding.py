"""A finding: one thing about a log that its user should know, with the settings that fix it."""

from __future__ import annotations

from typing import NamedTuple

import msgspec

from locfuse.fusion.data import LocfuseError


class Least(NamedTuple):
    """Limits below which an error is not reported."""

    error: float  # relative
    sigmas: float  # standard errors that it must exceed besides


class Finding(msgspec.Struct, frozen=True):
    """Something unusual: harmless, repaired, or an error that would make an estimate wrong."""

    role: str  # what it is about: wheels, a sensor, truth, log, file, or a topic
    code: str  # one word or two, for machines and tests
    message: str
    fixes: tuple[str, ...] = ()  # "table.key=value", all of them together fix it
    severe: bool = False  # an estimate made with the settings as they are would be wrong
    source: str = ""  # who states the values of the fixes, where that is not the drive itself
    hint: str = ""  # what to try next, for a place that does not print the fixes

    @property
    def sentence(self) -> str:
        """The message with its source and hint."""
        return f"{self._whole} {self.hint}" if self.hint else self._whole

    @property
    def brief(self) -> str:
        """The message and its source without the hint, for a place that prints the fixes itself."""
        return self._whole.rstrip(".:;?") if self.hint else self._whole

    @property
    def _whole(self) -> str:
        return f"{self.message}; {self.source}" if self.source else self.message

    @property
    def line(self) -> str:
        """The whole finding in one line, with the options that fix it."""
        return f"{self.role}: {self.sentence}" + "".join(f" --set {fix}" for fix in self.fixes)


def of_error(error: LocfuseError, role: str, code: str, severe: bool = True) -> Finding:
    """Return the finding of a role that an error makes; the message names another role if the error does."""
    message = error.message if error.role in {role, ""} else f"{error.role}: {error.message}"
    return Finding(role, code, message, error.fixes, severe, hint=error.hint)
