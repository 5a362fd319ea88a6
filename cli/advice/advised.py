"""What the evaluation of a log found."""

from __future__ import annotations

from dataclasses import dataclass

from locfuse.fusion.advice.search import Advice, Fixes, together


@dataclass(frozen=True)
class Advised:
    """What a log's evaluation found."""

    advice: tuple[Advice, ...] = ()  # what helps first, in the order in which it was found to help
    until: float | None = None  # s: only the beginning of the drive was tried; None: all of it
    fusions: int = 0  # runs of the filter that it cost

    @property
    def fixes(self) -> Fixes:
        """Everything that helps, together."""
        kept: Fixes = ()
        for advice in self.advice:
            kept = together(kept, advice.fixes)
        return kept
