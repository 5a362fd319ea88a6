"""Display of a report in a notebook, as HTML: headline, findings, verdicts, table, and a figure of the paths."""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib.resources import files
from typing import Any, NamedTuple

from locfuse.formats.figures import palette
from locfuse.formats.figures.palette import Trace
from locfuse.formats.figures.panels import Panel
from locfuse.formats.figures.svg import svg
from locfuse.fusion.data import Colour

from . import summary as over
from .findings import banner_of, sentence, together, unwarned
from .html import style_sheet
from .table import Swatches, html, html_text, of_words, texts
from .tables import configurations

WIDTH_PX, HEIGHT_PX = 640, 420  # px of the figure of the paths


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
        drawn = svg(self.panel, "paths", swatches.slugs, WIDTH_PX, HEIGHT_PX, swatches.looks)
        opening = f'<svg xmlns="http://www.w3.org/2000/svg" font-family="sans-serif" width="{WIDTH_PX}"'
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


def render(report: Mapping[str, Any], spoken: Callable[[str], str] = str) -> str:
    """Return headline, findings, verdicts and main table as HTML; text from the log is escaped.

    `spoken` rewrites command-line options in sentences, for example as Python arguments.
    """
    lines = [*banner_of(report), *map(sentence, unwarned(report)), *filter(None, [together(report)])]
    findings = "".join(f"<li>{html_text(spoken(line))}</li>" for line in lines)
    head = f"<p><b>{html_text(spoken(report.get('headline') or ''))}</b></p>"
    head += f"<ul>{findings}</ul>" if findings else ""
    return head + _verdicts(report.get("verdicts", {})) + html(configurations(report))


def table_and_notes(titles: Sequence[str], rows: Iterable[Sequence[str]], notes: Iterable[str]) -> str:
    """Return an HTML table of text cells with a list of notes below it."""
    below = "".join(f"<li>{html_text(note)}</li>" for note in notes)
    return html(of_words(texts(*titles), rows)) + (f"<ul>{below}</ul>" if below else "")


def render_summary(summary: Mapping[str, Any]) -> str:
    """Return a summary over several logs as HTML: headline, verdicts, table of configurations."""
    head = f"<p>{html_text(over.headline(summary))}</p>"
    return head + _verdicts(summary["verdicts"]) + html(over.table(summary))


def _verdicts(found: Mapping[str, Mapping[str, Any]]) -> str:
    texts = [map(html_text, (sensor, v["verdict"], v["words"])) for sensor, v in found.items()]
    return "".join("<p><b>{} {}.</b> {}</p>".format(*text) for text in texts)
