"""Finished drives of `benchmarks.consistency`, kept in a file: a run that was stopped goes on where it was."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

from .consistency_figures import Figures


class Kept:
    """Figures by case and seed: one line of JSON each, written as soon as a drive is judged."""

    def __init__(self, file: Path | None) -> None:
        self._file = file
        self._found: dict[tuple[str, int], Figures] = {}
        for line in file.read_text().splitlines() if file is not None and file.exists() else ():
            case, seed, *figures = json.loads(line)
            self._found[case, seed] = Figures(*figures)

    def figures(self, case: str, seed: int, judge: Callable[[], Figures]) -> Figures:
        """Return the figures of a drive; only one that is not kept is driven."""
        if (case, seed) not in self._found:
            self._found[case, seed] = judge()
            if self._file is not None:
                with self._file.open("a") as out:
                    out.write(json.dumps([case, seed, *self._found[case, seed]]) + "\n")
        return self._found[case, seed]
