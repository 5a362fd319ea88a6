"""One thing about a log that its user should know: in words, with the settings that cure it."""

from __future__ import annotations

import re
from dataclasses import dataclass

SETTING = re.compile(r"--set ([a-z_]+(?:\.[a-z_]+)+=(?:\[[^\]]*\]|\{[^}]*\}|[^\s,;]+))")


@dataclass(frozen=True)
class Oddity:
    """Something odd: harmless, repaired, or such that it would spoil an estimate."""

    code: str  # one word or two, for machines and tests
    stream: str  # the role (wheels, lrf, ...) or topic that it is about
    words: str
    cures: tuple[str, ...] = ()  # "table.key=value", all of them together cure it
    spoils: bool = False  # an estimate made with the settings as they are would be wrong

    @property
    def line(self) -> str:
        """The words, and the options that cure it."""
        return f"{self.stream}: {self.words}" + "".join(f" --set {cure}" for cure in self.cures)


def settings_in(text: str) -> tuple[str, ...]:
    """Return the settings that an error's text tells to try, those with a value to be filled in left out."""
    found = (cure.rstrip(".)") for cure in SETTING.findall(text))
    return tuple(cure for cure in dict.fromkeys(found) if "<" not in cure)
