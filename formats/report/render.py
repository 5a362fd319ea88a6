"""Tables as Markdown, HTML, LaTeX and CSV; text from logs is escaped by the rules of each format.

Control characters are made visible in all formats except CSV, which is for programs.
"""

from __future__ import annotations

import csv as csv_format
import io
import math
import re
from collections.abc import Collection, Iterable, Mapping
from functools import cached_property
from html import escape as _escaped
from typing import Any

import msgspec

from locfuse.formats.figures.svg import slugs_of
from locfuse.formats.visible import visible, visible_lines
from locfuse.fusion.data import Colour

from .table import Cell, Column, Path, Piece, Table, heading, pieces, records, text

LATEX = {
    "\\": r"\textbackslash{}",
    "&": r"\&",
    "%": r"\%",
    "$": r"\$",
    "#": r"\#",
    "_": r"\_",
    "{": r"\{",
    "}": r"\}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "°": r"\textdegree{}",
}
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
        return slugs_of(list(self.inks))

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
        cells.append(f"<td{_class(column)}{tint}>{_html_cell(column, cell)}{bar}</td>")
    kind = ' class="tint"' if name in tinted else ""
    return f'<tr{kind}><th scope="row">{head}</th>{"".join(cells)}</tr>\n'


def _class(column: Column, head: bool = False) -> str:
    kind = "text" if head and column.kind == "long" else column.kind
    return {"number": "", "text": ' class="left"', "code": ' class="left"', "long": ' class="wrap"'}[kind]


def _html_cell(column: Column, cell: Cell) -> str:
    found = pieces(column, cell)
    if not found:
        missing = html_text(text(column, cell, "–"))
        return f'<span class="none">{missing}</span>' if missing else ""
    written = "".join(html_text(p.text) if p.value is None else data(p) for p in found)
    return f"<code>{written}</code>" if column.kind == "code" else written


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
    return "".join(LATEX.get(character, character) for character in visible(_one_line(words)))


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
