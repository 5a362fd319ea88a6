"""Reports as HTML: report.html, one self-contained page, and the display of a result in a notebook.

The page has first verdicts and main table, then figures, then details. Every number is a <data> element with its
path in report.json (RFC 6901), so that tests can compare both files. Text from logs is escaped by the template.
"""

from __future__ import annotations

import base64
import hashlib
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache, partial
from importlib.resources import files
from typing import TYPE_CHECKING, Any, NamedTuple

from markupsafe import Markup

from locfuse.formats.figures import palette
from locfuse.formats.figures.palette import Trace
from locfuse.formats.figures.panels import Panel, Section
from locfuse.formats.figures.svg import HEIGHT_PX, WIDTH_PX, svg
from locfuse.fusion.data import BASES, REFUSED, Colour

from . import summary as over, tables
from .findings import (
    banner_of,
    fingerprint,
    in_parts,
    notes_of,
    options,
    sentence,
    title_of,
    together,
    unwarned,
    warnings_of,
)
from .glossary import GLOSSARY
from .summary import errors_of
from .table import SIGNS, Path, Piece, Swatches, data, html, html_text, of_words, texts, with_code, written

if TYPE_CHECKING:
    from importlib.resources.abc import Traversable

    from jinja2 import Template

VERDICT_CLASSES = {"helps": "good", "seems to help": "good", "seems to hurt": "bad", "hurts": "bad"}
SIZES = {1: (860, 500), 2: (WIDTH_PX, HEIGHT_PX), 3: (330, 190)}  # columns in the section -> px of a panel
FIRST_SIZE = (620, 470)  # px of the picture of the paths, beside the verdicts
FIRST_SECTION = "trajectories"  # the section whose figure is beside the verdicts
HEADING = re.compile(r'<section id="([\w-]+)">\s*(?:<details>\s*<summary>)?<h2>(.*?)</h2>')
STRIP_WIDTH_PX = 200.0  # px, width of an effect strip


def render(report: Mapping[str, Any], sections: Sequence[Section], sensors: Mapping[str, Colour]) -> str:
    """Return report.html. `sensors`: the colour of every sensor known to locfuse."""
    names, errors = list(report["configurations"]), errors_of(report)
    key, worst = tables.RMSE.key, max(errors.values(), default=0.0)
    # path of each position rmse in report.json -> length of its bar, in % of the largest rmse
    bars: dict[Path, float] = {
        ("configurations", n, key): 100.0 * e / worst for n, e in errors.items() if worst > 0.0
    }
    smoothed = {name for name, values in report["configurations"].items() if values.get("smoothed")}
    traces = palette.traces_in(report)
    swatches = Swatches(palette.colours(traces, sensors), {**palette.SHAPES, **palette.looks_of(traces)})
    drawn = {m.of for s in sections for p in s.panels for m in p.marks}
    shaded = dict.fromkeys(e.kind for s in sections for p in s.panels for e in p.events)
    drawings = [section_drawings(s, swatches) for s in sections]
    page = page_of(
        files(__package__) / "report.html.j2",
        report["locfuse"],
        swatches,
        report=report,
        title=title_of(report),
        base=next((name for name in BASES if name in names), "odometry"),
        fingerprint=fingerprint(report["input"]),
        figures=partial(figure, report),
        tables=tables,
        table=lambda shown, painted=True: Markup(html(shown, swatches if painted else None, bars, smoothed)),
        picture=next((d for d in drawings if d["section"].name == FIRST_SECTION), None),
        sections=[d for d in drawings if d["section"].name not in {"credit", FIRST_SECTION}],
        credit=[d for d in drawings if d["section"].name == "credit"],
        legend=[(name, swatches.slugs[name]) for name in names if name in drawn],
        strips=_strips(report),
        coded=lambda words: Markup(with_code(words)),
        notes=notes_of(report),
        warnings=[(kind, at, f and in_parts(f)) for kind, at, f in warnings_of(report)],
        findings=[in_parts(f) for f in unwarned(report)],
        together=together(report) is not None,
        fixes=options(report.get("fixes") or ()),
        events=[("rejected in a row" if kind == REFUSED else kind, palette.EVENTS[kind]) for kind in shaded],
        glossary=GLOSSARY,
        extras=("truth", "bounds") if report["truth"] else ("bounds",),
    )
    contents = (f'<a href="#{ident}">{words}</a>' for ident, words in HEADING.findall(page))
    return page.replace("<!--contents-->", " ".join(contents), 1)


def page_of(template: Traversable, version: str, swatches: Swatches, script: bool = True, **values: Any) -> str:
    """Return a self-contained HTML page: the rendered template with its style sheet, script and colours."""
    folder = files(__package__)
    code = compact((folder / "report.js").read_text(encoding="utf-8")) if script else ""
    page = _compiled(template.read_text(encoding="utf-8")).render(
        values,
        version=version,
        script=Markup(code),
        script_hash=hash_of(code),
        style=Markup(style_sheet((folder / "report.css").read_text(encoding="utf-8"), swatches)),
        swatch=lambda name: Markup(swatches.of(name)),
        slugs=swatches.slugs,
        signs=SIGNS,
        tones=VERDICT_CLASSES,
    )
    return page.strip() + "\n"


@cache
def _compiled(source: str) -> Template:
    """Return a compiled template. It is cached, since compiling takes as long as rendering a page."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    loader, how = PackageLoader(__package__, ""), StrictUndefined
    environment = Environment(loader=loader, autoescape=True, undefined=how, trim_blocks=True, lstrip_blocks=True)
    return environment.from_string(source)


def figure(report: Mapping[str, Any], path: Sequence[str | int], form: str = "{}") -> Markup:
    """Return the value at a JSON path of a report as an HTML <data> element. null and NaN become a dash."""
    value: Any = report
    for key in path:
        value = value[key]
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return Markup('<span class="none">–</span>')
    return Markup(data(Piece(written(value, form), value, tuple(path))))


def style_sheet(css: str, swatches: Swatches) -> str:
    """Return the style sheet with a CSS colour variable per name, for light and dark pages."""
    slugs = swatches.slugs
    light = "".join(f"--{slugs[r]}:{c.light};" for r, c in swatches.inks.items())
    dark = "".join(f"--{slugs[r]}:{c.dark};" for r, c in swatches.inks.items())
    uses = "".join(f".{s}{{--c:var(--{s})}}" for s in slugs.values())
    hides = "".join(f":root:has(#show-{s}:not(:checked)) .fig .{s}{{display:none}}" for s in slugs.values())
    return css.replace("/*light*/", light).replace("/*dark*/", dark) + uses + f"@media screen{{{hides}}}"


def compact(source: str) -> str:
    """Return JavaScript without comments and indents, and without line ends and spaces outside strings."""
    lines = (line.strip() for line in source.splitlines())
    parts = re.split(r"""("[^"]*"|`[^`]*`)""", "".join(line for line in lines if not line.startswith("//")))
    return "".join(p if i % 2 else re.sub(r" *([-=+*/<>?:,;{}()&|!]) *", r"\1", p) for i, p in enumerate(parts))


def hash_of(script: str) -> str:
    """Return the Content-Security-Policy hash of this script.

    With it, browsers run no other script of the page.
    """
    return base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()


def section_drawings(section: Section, swatches: Swatches) -> dict[str, Any]:
    """Return template values of a section: its panels drawn as SVG, by row, and its legend."""
    width, height = FIRST_SIZE if section.name == FIRST_SECTION else SIZES[section.columns]
    idents = (f"{section.name}-{i}" for i in range(len(section.panels)))  # they contain no text from a log
    named = zip(section.panels, idents, strict=True)
    drawn = [(p, Markup(svg(p, ident, swatches.slugs, width, height, swatches.looks))) for p, ident in named]
    per_row = section.columns if section.rows else max(1, len(drawn))
    rows = [drawn[i : i + per_row] for i in range(0, len(drawn), per_row)]
    keys = {k: p.legend.get(k, "rejected" if k == "gate" else k) for p in section.panels for k in p.keys}
    # the keys of a colour scale come first, in order
    scale = {k: keys.pop(k) for k in sorted(keys) if k.startswith("level ")}
    return {"section": section, "rows": rows, "keys": scale | keys}


def _strips(report: Mapping[str, Any]) -> dict[str, dict[str, float | str]]:
    """Return sensor -> x positions [px] of the marks in its effect strip (log scale); {} without credit.

    The marks are both ends of the interval, the value, and "none" (no effect).
    """
    credit = report.get("credit")
    if not credit:
        return {}
    judged = {s: v for s, v in credit["sensors"].items() if report["verdicts"][s]["verdict"] != "no verdict"}
    kinds = {s: [k for k in ("credit", "alone", "leave_one_out") if v[k] is not None] for s, v in judged.items()}
    effects = {s: (found[0], judged[s][found[0]]) for s, found in kinds.items() if found}
    effects = {s: (kind, e) for s, (kind, e) in effects.items() if None not in (e["low"], e["high"], e["factor"])}
    ln = [math.log(max(e[k], 1e-6)) for _, e in effects.values() for k in ("low", "high", "factor")]
    low, high = max(-5.0, min([*ln, -0.2])), min(7.0, max([*ln, 0.2]))

    def px(factor: float) -> float:
        share = (math.log(max(factor, 1e-6)) - low) / (high - low)
        return round(4.0 + (STRIP_WIDTH_PX - 8.0) * min(1.0, max(0.0, share)), 1)

    return {
        s: {"kind": kind, "low": px(e["low"]), "high": px(e["high"]), "value": px(e["factor"]), "none": px(1.0)}
        for s, (kind, e) in effects.items()
    }


NOTEBOOK_SIZE_PX = 640, 420  # of the figure of the paths


class NotebookFigure(NamedTuple):
    """A figure of the report for display in a notebook, by `_repr_svg_`."""

    panel: Panel
    traces: Mapping[str, Trace]
    sensors: Mapping[str, Colour]

    def _repr_svg_(self) -> str:
        """Return the figure as an SVG document with its own style sheet for light and dark notebooks."""
        swatches = Swatches(palette.colours(self.traces, self.sensors), palette.looks_of(self.traces))
        css = (files(__package__) / "report.css").read_text(encoding="utf-8").splitlines()
        of_figures = [line for line in css if line.startswith((":root", "@media (prefers", ".fig"))]
        style = style_sheet("".join(of_figures), swatches).replace("<", "\\3c ")
        drawn = svg(self.panel, "paths", swatches.slugs, *NOTEBOOK_SIZE_PX, swatches.looks)
        opening = f'<svg xmlns="http://www.w3.org/2000/svg" font-family="sans-serif" width="{NOTEBOOK_SIZE_PX[0]}"'
        return f"{opening}{drawn.removeprefix('<svg')}".replace("<title", f"<style>{style}</style><title", 1)

    def html(self) -> str:
        """Return the image as HTML, isolated from the notebook's styles, with a legend below it."""
        data = base64.b64encode(self._repr_svg_().encode()).decode()
        inks = palette.colours(self.traces, self.sensors)
        names = " ".join(
            f'<span style="color:{inks[name].light}">&#9632;</span> {html_text(name)}' for name in self.traces
        )
        source = f"data:image/svg+xml;base64,{data}"
        return f'<p>{names}</p><img alt="{html_text(self.panel.summary)}" src="{source}">'


def notebook_report(report: Mapping[str, Any], spoken: Callable[[str], str] = str) -> str:
    """Return headline, findings, verdicts and main table as HTML; text from the log is escaped.

    `spoken` rewrites command-line options in sentences, for example as Python arguments.
    """
    lines = [*banner_of(report), *map(sentence, unwarned(report)), *filter(None, [together(report)])]
    findings = "".join(f"<li>{html_text(spoken(line))}</li>" for line in lines)
    head = f"<p><b>{html_text(spoken(report.get('headline') or ''))}</b></p>"
    head += f"<ul>{findings}</ul>" if findings else ""
    return head + _verdict_lines(report.get("verdicts", {})) + html(tables.configurations(report))


def table_and_notes(titles: Sequence[str], rows: Iterable[Sequence[str]], notes: Iterable[str]) -> str:
    """Return an HTML table of text cells with a list of notes below it."""
    below = "".join(f"<li>{html_text(note)}</li>" for note in notes)
    return html(of_words(texts(*titles), rows)) + (f"<ul>{below}</ul>" if below else "")


def notebook_summary(summary: Mapping[str, Any]) -> str:
    """Return a summary over several logs as HTML: headline, verdicts, table of configurations."""
    head = f"<p>{html_text(over.headline(summary))}</p>"
    return head + _verdict_lines(summary["verdicts"]) + html(over.table(summary))


def _verdict_lines(found: Mapping[str, Mapping[str, Any]]) -> str:
    texts = [map(html_text, (sensor, v["verdict"], v["words"])) for sensor, v in found.items()]
    return "".join("<p><b>{} {}.</b> {}</p>".format(*text) for text in texts)
