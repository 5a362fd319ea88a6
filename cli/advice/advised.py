"""The result of evaluating a log."""

from __future__ import annotations

import msgspec

from locfuse.fusion.checks.tried import Advice, Fixes, together


class Advised(msgspec.Struct, frozen=True):
    """The result of a log's evaluation."""

    advice: tuple[Advice, ...] = ()  # what helps first, in the order in which it was found to help
    fusions: int = 0  # runs of the filter that it cost

    @property
    def fixes(self) -> Fixes:
        """All helpful fixes together."""
        kept: Fixes = ()
        for advice in self.advice:
            kept = together(kept, advice.fixes)
        return kept
