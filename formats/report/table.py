"""Tables of results (columns with number formats, rows of values), and their output in several formats.

A cell may hold the path of its value in report.json, so that a page can name the source of every number.
"""

from __future__ import annotations

import csv as csv_format
import io
import math
import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import cached_property
from html import escape as _escaped
from typing import Any, Literal, NamedTuple

import msgspec
from msgspec.structs import replace

from locfuse.formats.text import visible, visible_lines
from locfuse.fusion.data import Colour

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


# --- Tables as Markdown, HTML, LaTeX and CSV: text from logs is escaped by the rules of each format, and control
# characters are made visible, except in CSV, which is for programs

ESCAPES = {"\\": "textbackslash", "~": "textasciitilde", "^": "textasciicircum", "°": "textdegree"}
LATEX = str.maketrans({c: f"\\{c}" for c in "&%$#_{}"} | {c: f"\\{name}{{}}" for c, name in ESCAPES.items()})
UNIT, NBSP = re.compile(r" (?=\S{1,2}$)"), "\u00a0"  # the space before the unit at the end of a heading
# verdict on a sensor -> its sign
SIGNS = {"helps": "▲", "seems to help": "△", "no effect seen": "■", "seems to hurt": "▽", "hurts": "▼"}


class Swatches(msgspec.Struct, frozen=True, dict=True):
    """Legend symbols: the colour and shape of each configuration, sensor and role."""

    inks: Mapping[str, Colour]  # name -> its colour
    looks: Mapping[str, str]  # name -> CSS class of its symbol: "dash", "over" or a shape

    @cached_property
    def slugs(self) -> dict[str, str]:
        """CSS class of the colour of each name."""
        return {name: f"k{i}" for i, name in enumerate(self.inks)}

    def of(self, name: str) -> str:
        """Return the legend symbol of a configuration, sensor or role as HTML."""
        classes = " ".join(c for c in ("swatch", self.looks.get(name, ""), self.slugs.get(name, "")) if c)
        return f'<span class="{classes}"></span>'


def markdown(table: Table) -> str:
    """Return the table as Markdown (GitHub's)."""
    rule = "".join("--:|" if c.kind == "number" else "---|" for c in table.columns)
    rows = [[escape(text(c, cell)) for c, cell in zip(table.columns, row, strict=True)] for row in table.rows]
    heads, *lines = ["| " + " | ".join(row) + " |" for row in (map(heading, table.columns), *rows)]
    return "\n".join([heads, f"|{rule}", *lines])


def html(
    table: Table,
    swatches: Swatches | None = None,
    bars: Mapping[Path, float] | None = None,
    tinted: Collection[str] = (),
) -> str:
    """Return the table as HTML, every number as <data> with its path in report.json (RFC 6901).

    `swatches`: legend symbols, shown before each name. `bars`: path of a cell -> length [%] of the bar below its
    value. `tinted`: names of rows with a coloured background.
    """
    classes = ("", *(_class(c, head=True) for c in table.columns[1:]))
    titles = ((own, UNIT.sub(NBSP, html_text(heading(c)))) for own, c in zip(classes, table.columns, strict=True))
    heads = "".join(f'<th scope="col"{own}>{title}</th>' for own, title in titles)
    rows = "".join(_html_row(table.columns, row, swatches, bars or {}, tinted) for row in table.rows)
    label = f' tabindex="0" role="region" aria-label="{html_text(table.label)}"' if table.label else ""
    return (
        f'<div class="scroll"{label}>\n<table>\n<thead><tr>{heads}</tr></thead>\n'
        f"<tbody>\n{rows}</tbody>\n</table>\n</div>"
    )


def _html_row(
    columns: tuple[Column, ...],
    row: tuple[Cell, ...],
    swatches: Swatches | None,
    bars: Mapping[Path, float],
    tinted: Collection[str],
) -> str:
    name, slug = str(row[0].value), ""
    head = html_text(name)
    if swatches is not None:
        slug = swatches.slugs.get(name, "")
        head = f'<span class="name">{swatches.of(name)}{head}</span>'
    if row[0].link:
        head = f'<a href="{row[0].link}">{head}</a>'
    cells = []
    for column, cell in zip(columns[1:], row[1:], strict=True):
        bar = f'<span class="bar {slug}" style="width:{bars[cell.at]:.1f}%"></span>' if cell.at in bars else ""
        tint = f' style="background:{cell.tint}"' if cell.tint else ""
        shown = "".join(html_text(p.text) if p.value is None else data(p) for p in pieces(column, cell))
        if shown:
            shown = f"<code>{shown}</code>" if column.kind == "code" else shown
        elif missing := html_text(text(column, cell, "–")):
            shown = f'<span class="none">{missing}</span>'
        cells.append(f"<td{_class(column)}{tint}>{shown}{bar}</td>")
    kind = ' class="tint"' if name in tinted else ""
    return f'<tr{kind}><th scope="row">{head}</th>{"".join(cells)}</tr>\n'


def _class(column: Column, head: bool = False) -> str:
    kind = "text" if head and column.kind == "long" else column.kind
    return {"number": "", "text": ' class="left"', "code": ' class="left"', "long": ' class="wrap"'}[kind]


def data(piece: Piece) -> str:
    """Return a number as an HTML <data> element, with its full value and its path in report.json.

    Without a path, return only its text, escaped.
    """
    if not piece.at:
        return html_text(piece.text)
    value, place = html_text(repr(piece.value)), html_text(pointer(piece.at))
    return f'<data value="{value}" data-from="{place}">{html_text(piece.text)}</data>'


def pointer(path: Path) -> str:
    """Return a report path as a JSON pointer (RFC 6901): "/configurations/lrf/anees"."""
    return "".join("/" + str(key).replace("~", "~0").replace("/", "~1") for key in path)


def html_text(words: str) -> str:
    """Return a text escaped for HTML, with control characters made visible."""
    return _escaped(visible_lines(words))


def with_code(words: str) -> str:
    """Return a text escaped for HTML; parts between backticks become code."""
    parts = html_text(words).split("`")
    return "".join(f"<code>{part}</code>" if i % 2 else part for i, part in enumerate(parts))


def latex(table: Table) -> str:
    """Return the table as a booktabs tabular."""
    heads = [f"{c.heading} [{c.unit}]" if c.unit else c.heading for c in table.columns]
    rows = [[text(c, cell, "--") for c, cell in zip(table.columns, row, strict=True)] for row in table.rows]
    heads_line, *lines = [" & ".join(map(latex_text, row)) + r" \\" for row in (heads, *rows)]
    sides = "".join("r" if c.kind == "number" else "l" for c in table.columns)
    begin = rf"\begin{{tabular}}{{{sides}}}"
    return "\n".join([begin, r"\toprule", heads_line, r"\midrule", *lines, r"\bottomrule", r"\end{tabular}"])


def latex_text(words: str) -> str:
    """Return a text escaped for LaTeX, in one line."""
    return visible(_one_line(words)).translate(LATEX)


def csv(table: Table) -> str:
    """Return the table as CSV in full precision: column keys as headings, missing values empty."""
    return csv_text([c.key for c in table.columns], (row.values() for row in records(table)))


FORMULA = ("=", "+", "-", "@", "\t", "\r")  # a spreadsheet evaluates cells that begin so; a leading ' prevents it


def csv_text(heads: Iterable[str], rows: Iterable[Iterable[Any]]) -> str:
    """Return rows of values as CSV: numbers in full precision, missing values empty."""
    out = io.StringIO()
    writer = csv_format.writer(out, lineterminator="\n")
    writer.writerow(map(_plain, heads))
    writer.writerows([_plain(value) for value in row] for row in rows)
    return out.getvalue()


def _plain(value: Any) -> str:
    if isinstance(value, float):
        return repr(value) if math.isfinite(value) else ""
    text = "" if value is None else visible(str(value))
    return f"'{text}" if isinstance(value, str) and text.startswith(FORMULA) else text


def escape(words: str) -> str:
    """Return a text escaped for Markdown, in one line."""
    for character in "\\`*_[]<>|":
        words = words.replace(character, "\\" + character)
    return visible(_one_line(words))


def code(words: str) -> str:
    """Return a Markdown code span; its fence has more backticks than any sequence of them in the text."""
    words = visible(_one_line(words)).replace("|", "\\|")
    fence = "`" * (1 + max((len(run) for run in re.findall(r"`+", words)), default=0))
    pad = " " if words.startswith("`") or words.endswith("`") else ""
    return f"{fence}{pad}{words}{pad}{fence}"


def _one_line(words: str) -> str:
    return " ".join(words.split())


MIN_CELL_WIDTH = 12  # characters on a terminal: a text is not cut to less


class Strip(msgspec.Struct, frozen=True):
    """One column of a table as text: heading, then cells."""

    column: Column
    cells: tuple[str, ...]

    @property
    def width(self) -> int:
        """Characters of the widest cell."""
        return max(map(len, self.cells))


def terminal_lines(table: Table, width: int | None, gap: str = "  ") -> list[str]:
    """Return a table's lines of at most `width` characters (None: any), headings first, no empty column.

    Less important columns are left out, and numbers are never cut.
    """
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
