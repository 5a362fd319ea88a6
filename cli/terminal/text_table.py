"""Tables and paragraphs on a terminal, fitted to its width.

Less important columns of a table are left out, and numbers are never cut.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

import msgspec
from msgspec.structs import replace

from locfuse.formats.report.table import Cell, Column, Table, heading, text
from locfuse.formats.visible import visible

MIN_CELL_WIDTH = 12  # characters: a text is not cut to less


class Strip(msgspec.Struct, frozen=True):
    """One column of a table as text: heading, then cells."""

    column: Column
    cells: tuple[str, ...]

    @property
    def width(self) -> int:
        """Characters of the widest cell."""
        return max(map(len, self.cells))


def lines(table: Table, width: int | None, gap: str = "  ") -> list[str]:
    """Return a table's lines of at most `width` characters (None: any), headings first, no empty column."""
    texts = ([visible(_text(c, row[i])) for row in table.rows] for i, c in enumerate(table.columns))
    strips = [Strip(c, (heading(c, brief=True), *cells)) for c, cells in zip(table.columns, texts, strict=True)]
    strips = [s for s in strips if any(s.cells[1:])]
    padded = []
    for s in strips if width is None else _fitted(strips, width, len(gap)):
        pad = str.rjust if s.column.kind == "number" else str.ljust
        padded.append([pad(cell, s.width) for cell in s.cells])
    return [gap.join(row).rstrip() for row in zip(*padded, strict=True)]


def _text(column: Column, cell: Cell) -> str:
    """Return a cell as text; numbers with the few decimals of `brief_form`."""
    number = isinstance(cell.value, int | float) and not isinstance(cell.value, bool)
    return text(replace(column, form=column.brief_form) if number and column.brief_form else column, cell)


def _fitted(strips: Sequence[Strip], width: int, gap: int) -> list[Strip]:
    """Fit columns to `width` characters: shorten words, then leave out less important columns, then cut texts.

    Each step is taken only if the one before is not enough; numbers are never cut. `gap`: characters between
    columns.
    """
    kept = list(strips)

    def too_wide() -> int:
        return sum(s.width for s in kept) + gap * max(0, len(kept) - 1) - width

    if too_wide() > 0:
        shorter = ((s, s.column.shorter or str) for s in kept)
        kept = [replace(s, cells=(s.cells[0], *map(of, s.cells[1:]))) for s, of in shorter]
    while too_wide() > 0 and any(s.column.rank for s in kept):
        kept.remove(max(kept, key=lambda s: s.column.rank))
    while (over := too_wide()) > 0:
        i, widest = max(enumerate(kept), key=lambda entry: (entry[1].column.kind != "number", entry[1].width))
        if widest.width <= MIN_CELL_WIDTH or widest.column.kind == "number":
            break
        to = max(MIN_CELL_WIDTH, widest.width - over)
        head = (to - 1) // 2
        cut = (f"{c[:head]}…{c[len(c) - (to - 1 - head) :]}" if len(c) > to else c for c in widest.cells)
        kept[i] = replace(widest, cells=tuple(cut))  # the middle of long texts is left out
    return kept


def wrapped(head: str, words: str, width: int | None, indent: str | None = None) -> list[str]:
    """Return a paragraph after `head`, wrapped at `width` characters (None: one line)."""
    if width is None:
        return [f"{head}{words}"]
    later = " " * len(head) if indent is None else indent
    return textwrap.wrap(
        words, max(width, 40), initial_indent=head, subsequent_indent=later, break_long_words=False,
        break_on_hyphens=False,
    )  # fmt: skip
