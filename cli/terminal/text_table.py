"""A table of words that fits its width: what is least needed goes first, and no cell is folded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

GAP = "  "
MIN_CELL_WIDTH = 12  # characters of a cell that is cut


@dataclass(frozen=True)
class Column:
    """One column; where all cells are empty it is left out."""

    title: str
    cells: tuple[str, ...]
    right: bool = False  # numbers stand at the right
    short: tuple[str, ...] | None = None  # shorter words for the same
    rank: int = 0  # where the table is too wide the highest goes first; 0 always stays

    @property
    def width(self) -> int:
        """Characters of its widest cell."""
        return max(map(len, (self.title, *self.cells)))

    def lines(self) -> list[str]:
        """Return title and cells, all of one width."""
        pad = str.rjust if self.right else str.ljust
        return [pad(cell, self.width) for cell in (self.title, *self.cells)]


def table(columns: Sequence[Column], width: int | None) -> list[str]:
    """Return the lines of a table of at most `width` characters, the titles first; None: as wide as it likes."""
    fitted = [c for c in columns if any(c.cells)]
    if width is not None:
        fitted = _narrowed(fitted, width)
    return [GAP.join(row).rstrip() for row in zip(*(c.lines() for c in fitted), strict=True)]


def _narrowed(columns: Sequence[Column], width: int) -> list[Column]:
    """Use short words, then leave columns out, then cut the widest cells."""
    kept = list(columns)
    if _width(kept) > width:
        kept = [Column(c.title, c.short, c.right, None, c.rank) if c.short else c for c in kept]
    while _width(kept) > width and any(c.rank for c in kept):
        kept.remove(max(kept, key=lambda c: c.rank))
    while (over := _width(kept) - width) > 0:
        i, widest = max(enumerate(kept), key=lambda entry: entry[1].width)
        if widest.width <= MIN_CELL_WIDTH:
            break
        cut = max(MIN_CELL_WIDTH, widest.width - over)
        kept[i] = Column(widest.title, tuple(_cut(cell, cut) for cell in widest.cells), widest.right)
    return kept


def _width(columns: Sequence[Column]) -> int:
    return sum(c.width for c in columns) + len(GAP) * max(0, len(columns) - 1)


def _cut(cell: str, width: int) -> str:
    """Take out the middle: both ends of a topic's name tell more."""
    if len(cell) <= width:
        return cell
    head = (width - 1) // 2
    return f"{cell[:head]}…{cell[len(cell) - (width - 1 - head) :]}"
