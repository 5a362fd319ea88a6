"""Tables of results, independent of the output format: columns with number formats, rows of values.

A cell may hold the path of its value in report.json, so that a page can name the source of every number.
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
    """A table column: key, heading, unit and number format."""

    key: str  # key of the values in report.json; name of the column for programs
    heading: str
    unit: str = ""
    form: str = "{}"  # str.format of a number: decimals, sign, "{:.2%}" for a share in per cent
    kind: Literal["number", "text", "long", "code"] = "number"  # numbers are right-aligned; long text is folded
    missing: str | None = None  # text of a cell without a value; None: a dash
    brief: str = ""  # the heading on a terminal
    brief_form: str = ""  # number format on a terminal
    shorter: Callable[[str], str] | None = None  # text -> shorter text, for a narrow screen
    scale: float = 1.0  # shown value / stored value: 1000 if metres are shown in mm
    most: float | None = None  # larger numbers are shown as "over 50"
    rank: int = 0  # on a narrow screen, columns of higher rank are left out first; 0: never

    def with_unit(self, value: float | None) -> str:
        """Return a number with its unit: "0.12 m"; "-" for None and NaN."""
        if value is None or not math.isfinite(value):
            return "-"
        return self.number(value) + ("" if self.unit in {"", "°"} else " ") + self.unit

    def number(self, value: float) -> str:
        """Return a number as text in the column's unit, without the unit; "over 50" above `most`."""
        if self.most is not None and value > self.most:
            return f"over {self.most:g}"
        return written(value if self.scale == 1.0 else value * self.scale, self.form)


class Cell(NamedTuple):
    """A table value, and its path in report.json.

    The value is a text, a number, a range (low, high), counts by reason, or None.
    """

    value: Any = None
    at: Path = ()
    link: str = ""  # URL, only on a page and in the first cell of a row
    tint: str = ""  # CSS colour, only on a page


class Piece(NamedTuple):
    """A part of a cell's text; for a number, also its value and its path in report.json."""

    text: str
    value: float | None = None
    at: Path = ()


class Table(msgspec.Struct, frozen=True):
    """A table: columns, and rows with one cell per column."""

    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    label: str = ""  # for screen readers

    def without(self, *keys: str) -> Table:
        """Return the table without the columns with these keys."""
        kept = [i for i, c in enumerate(self.columns) if c.key not in keys]
        rows = tuple(tuple(row[i] for i in kept) for row in self.rows)
        return replace(self, columns=tuple(self.columns[i] for i in kept), rows=rows)

    def once(self) -> Table:
        """Return the table without repetitions in the first column: cells equal to the one above are empty."""
        above = (None, *(row[0].value for row in self.rows))
        pairs = zip(above, self.rows, strict=False)
        rows = tuple(row if row[0].value != last else (Cell(""), *row[1:]) for last, row in pairs)
        return replace(self, rows=rows)


def heading(column: Column, brief: bool = False) -> str:
    """Return a column's heading with its unit: "rmse, mm"."""
    words = (brief and column.brief) or column.heading
    return f"{words}, {column.unit}" if column.unit else words


def texts(*headings: str, left: int = 1) -> tuple[Column, ...]:
    """Return text columns with these headings, the first `left` of them left-aligned."""
    return tuple(Column(h, h, kind="text" if i < left else "number") for i, h in enumerate(headings))


def of_words(columns: tuple[Column, ...], rows: Iterable[Sequence[str | None]]) -> Table:
    """Return a table of text cells."""
    return Table(columns, tuple(tuple(Cell(text) for text in row) for row in rows))


def of_values(columns: Sequence[Column], rows: Iterable[tuple[Mapping[str, Any], Path]], label: str = "") -> Table:
    """Return a table of rows; each row is (column key -> value, path of the row in report.json).

    The path is () if the values are not in report.json.
    """
    cells = (tuple(Cell(values.get(c.key), _below(at, c.key)) for c in columns) for values, at in rows)
    return Table(tuple(columns), tuple(cells), label)


def of_rows(columns: Sequence[Column], rows: Iterable[Mapping[str, Any]]) -> Table:
    """Return a table of rows (column key -> value) without paths in report.json."""
    return of_values(columns, ((row, ()) for row in rows))


def pieces(column: Column, cell: Cell) -> list[Piece]:
    """Return the parts of a cell's text, each number as a separate part; [] if the cell has no value."""
    value, at = cell.value, cell.at
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return []
    if isinstance(value, Mapping):
        counted = [(str(n), n, k, f" {k.replace('_', ' ')}") for k, n in value.items()]
        return _joined([[Piece(number, n, _below(at, k)), Piece(what)] for number, n, k, what in counted], ", ")
    if isinstance(value, list | tuple):
        numbers = [[Piece(column.number(v), v, _below(at, i))] for i, v in enumerate(value)]
        return _joined(numbers, ", " if column.kind == "long" else " – ")
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
    """Return a number formatted by `form`; numbers from 1e5 on as "1.2e+05"; "-0.0" becomes "0.0"."""
    large = isinstance(value, float) and abs(value) >= MIN_EXPONENT_FORM
    text = f"{value:.1e}" if large else form.format(value)
    return text.replace("-", "", 1) if NEGATIVE_ZERO.fullmatch(text) else text


def records(table: Table) -> list[dict[str, Any]]:
    """Return each row as a dict from column key to value, for pandas, polars and other programs."""
    keys = [c.key for c in table.columns]
    return [dict(zip(keys, (cell.value for cell in row), strict=True)) for row in table.rows]
