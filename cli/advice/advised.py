"""What the evaluation of a log found."""

from __future__ import annotations

import msgspec

from locfuse.fusion.checks.tried import Advice, Fixes, together


class Advised(msgspec.Struct, frozen=True):
    """What a log's evaluation found."""

    advice: tuple[Advice, ...] = ()  # what helps first, in the order in which it was found to help
    fusions: int = 0  # runs of the filter that it cost

    @property
    def fixes(self) -> Fixes:
        """Everything that helps, together."""
        kept: Fixes = ()
        for advice in self.advice:
            kept = together(kept, advice.fixes)
        return kept
