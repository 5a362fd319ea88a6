"""A table of results: columns with formats, and rows of values, for every medium.

A cell may say where its value lies in report.json, so that a page can name the source of every number.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Literal, NamedTuple

import msgspec
from msgspec.structs import replace

NEGATIVE_ZERO = re.compile(r"-0(\.0*)?%?")
MIN_EXPONENT_FORM = 1e5
Path = tuple[str | int, ...]


class Column(msgspec.Struct, frozen=True):
    """One column. Its unit is in the heading; if units differ by row, in each cell."""

    key: str  # of its values in report.json, and of the column for programs
    heading: str
    unit: str = ""
    form: str = "{}"  # str.format of a number: decimals, sign, "{:.2%}" for a share in per cent
    kind: Literal["number", "text", "long", "code"] = "number"  # numbers stand at the right; long text is folded
    missing: str | None = None  # what a cell without a value says; None: the medium's dash
    brief: str = ""  # the heading on a terminal
    brief_form: str = ""  # a number on a terminal
    shorter: Callable[[str], str] | None = None  # shorter words for the same, for a narrow screen
    scale: float = 1.0  # units per unit of the value: 1000 where metres are shown in mm
    most: float | None = None  # a larger number says nothing more: "over 50"
    rank: int = 0  # on a screen that is too narrow the highest is left out first; 0 always stays

    def with_unit(self, value: float | None) -> str:
        """Return a number and its unit; a dash without a value."""
        if value is None or not math.isfinite(value):
            return "-"
        return self.number(value) + ("" if self.unit in {"", "°"} else " ") + self.unit

    def number(self, value: float) -> str:
        """Return a number in the column's unit, without the unit; "over 50" if larger values mean nothing more."""
        if self.most is not None and value > self.most:
            return f"over {self.most:g}"
        return written(value if self.scale == 1.0 else value * self.scale, self.form)


class Cell(NamedTuple):
    """One value of a table: text, number, range (low, high), counts by reason, or None; and its report path."""

    value: Any = None
    at: Path = ()
    link: str = ""  # on a page, of the first cell of a row
    tint: str = ""  # on a page, a CSS colour


class Piece(NamedTuple):
    """A part of a cell's text; a number keeps its value and path."""

    text: str
    value: float | None = None
    at: Path = ()


class Table(msgspec.Struct, frozen=True):
    """Columns, and a row of as many cells for each line."""

    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    label: str = ""  # what it shows, for who cannot see it

    def without(self, *keys: str) -> Table:
        """Return the table without some columns."""
        kept = [i for i, c in enumerate(self.columns) if c.key not in keys]
        rows = tuple(tuple(row[i] for i in kept) for row in self.rows)
        return replace(self, columns=tuple(self.columns[i] for i in kept), rows=rows)

    def once(self) -> Table:
        """Return the table with the first cell of a row empty if it repeats the row above."""
        above = (None, *(row[0].value for row in self.rows))
        rows = (
            row if row[0].value != last else (Cell(""), *row[1:])
            for last, row in zip(above, self.rows, strict=False)
        )
        return replace(self, rows=tuple(rows))


def heading(column: Column, brief: bool = False) -> str:
    """Return a column's heading with its unit: "rmse, mm"."""
    words = (brief and column.brief) or column.heading
    return f"{words}, {column.unit}" if column.unit else words


def texts(*headings: str, left: int = 1) -> tuple[Column, ...]:
    """Return columns of ready text, the first `left` of them left-aligned."""
    return tuple(Column(h, h, kind="text" if i < left else "number") for i, h in enumerate(headings))


def of_words(columns: tuple[Column, ...], rows: Iterable[Sequence[str | None]]) -> Table:
    """Return a table of ready text."""
    return Table(columns, tuple(tuple(Cell(text) for text in row) for row in rows))


def of_values(columns: Sequence[Column], rows: Iterable[tuple[Mapping[str, Any], Path]], label: str = "") -> Table:
    """Return a table of rows (values by key, path in report.json); the path is () for values not in it."""
    return Table(
        tuple(columns),
        tuple(tuple(Cell(values.get(c.key), _below(at, c.key)) for c in columns) for values, at in rows),
        label,
    )


def of_rows(columns: Sequence[Column], rows: Iterable[Mapping[str, Any]]) -> Table:
    """Return a table of rows (values by key) that are not part of report.json."""
    return of_values(columns, ((row, ()) for row in rows))


def pieces(column: Column, cell: Cell) -> list[Piece]:
    """Return a cell's text in parts, each number by itself; empty without a value."""
    value, at = cell.value, cell.at
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return []
    if isinstance(value, Mapping):
        counted = [(str(n), n, k, f" {k.replace('_', ' ')}") for k, n in value.items()]
        return _joined([[Piece(said, n, _below(at, k)), Piece(what)] for said, n, k, what in counted], ", ")
    if isinstance(value, list | tuple):
        return _joined(
            [[Piece(column.number(v), v, _below(at, i))] for i, v in enumerate(value)],
            ", " if column.kind == "long" else " – ",
        )
    if isinstance(value, int | float) and not isinstance(value, bool):
        return [Piece(column.number(value), value, at)]
    return [Piece(str(value))]


def _below(at: Path, key: str | int) -> Path:
    return (*at, key) if at else ()


def _joined(parts: Sequence[Sequence[Piece]], separator: str) -> list[Piece]:
    return [p for i, part in enumerate(parts) for p in ([Piece(separator), *part] if i else part)]


def text(column: Column, cell: Cell, dash: str = "-") -> str:
    """Return a cell as text without its unit."""
    found = "".join(p.text for p in pieces(column, cell))
    missing = dash if column.missing is None else column.missing
    return found if found or cell.value == "" else missing


def written(value: float, form: str) -> str:
    """Format a figure; very large ones as powers of ten (the ANEES of the printed filter)."""
    large = isinstance(value, float) and abs(value) >= MIN_EXPONENT_FORM
    text = f"{value:.1e}" if large else form.format(value)
    return text.replace("-", "", 1) if NEGATIVE_ZERO.fullmatch(text) else text


def records(table: Table) -> list[dict[str, Any]]:
    """Return the rows by their columns' keys with plain values: for pandas, polars and other programs."""
    keys = [c.key for c in table.columns]
    return [dict(zip(keys, (cell.value for cell in row), strict=True)) for row in table.rows]
