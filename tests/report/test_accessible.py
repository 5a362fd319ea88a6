"""Everybody can read the report and the fleet page: contrast, headings, tables, names of drawings (WCAG 2.2)."""

import re
from collections import Counter
from html.parser import HTMLParser
from importlib.resources import files
from pathlib import Path

import pytest
from commands import jobs_here, ok

from locfuse.formats.report.fleet import MAX_TINT_PERCENT

MIN_CONTRAST_RATIO = 4.5  # of text (WCAG 2.2, 1.4.3, level AA)
CSS = (files("locfuse.formats.report") / "report.css").read_text(encoding="utf-8")
ROOTS = re.findall(r":root\{([^}]*)\}", CSS)
THEMES = dict(zip(("light", "dark", "print"), ROOTS, strict=True))
DRAWN = "c"  # the colour of a curve or a swatch: never that of text
INKS = sorted(
    {
        *re.findall(r"[{;]color:var\(--(\w+)\)", CSS),
        *re.findall(r"text\{[^}]*fill:var\(--(\w+)\)", CSS),
        *re.findall(r"\.l\{fill:var\(--(\w+)\)", CSS),
    }
    - {DRAWN}
)
GROUNDS = sorted(set(re.findall(r"background:var\(--(\w+)\)", CSS)) - {DRAWN})
Rgb = tuple[float, ...]


def colours(theme: str) -> dict[str, Rgb]:
    """The variables of a theme that are colours, r, g, b in 0 to 255."""
    found = re.findall(r"--(\w+):#([0-9a-f]+)", THEMES[theme])
    wide = {name: code if len(code) == 6 else "".join(2 * c for c in code) for name, code in found}
    return {name: tuple(float(int(code[i : i + 2], 16)) for i in (0, 2, 4)) for name, code in wide.items()}


def luminance(colour: Rgb) -> float:
    """Relative luminance as WCAG 2.2 defines it."""
    share = [c / 255 for c in colour]
    r, g, b = (s / 12.92 if s <= 0.04045 else ((s + 0.055) / 1.055) ** 2.4 for s in share)
    return 0.2126 * r + 0.7152 * g + 0.0722 * b


def contrast(one: Rgb, other: Rgb) -> float:
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def mixed(colour: Rgb, ground: Rgb, percent: float) -> Rgb:
    """As color-mix(in srgb, colour percent, transparent) looks on the ground."""
    return tuple((percent * c + (100 - percent) * g) / 100 for c, g in zip(colour, ground, strict=True))


def test_the_ratio_is_that_of_known_pairs_and_every_colour_is_found() -> None:
    assert contrast((0.0, 0.0, 0.0), (255.0, 255.0, 255.0)) == pytest.approx(21.0)
    assert contrast((119.0, 119.0, 119.0), (255.0, 255.0, 255.0)) == pytest.approx(
        4.48, abs=0.005
    )  # #777: just fails
    assert {"fg", "muted", "good", "bad"} <= set(INKS)
    assert {"bg", "card"} <= set(GROUNDS)


@pytest.mark.parametrize("theme", THEMES)
def test_every_text_stands_out_from_every_ground(theme: str) -> None:
    of = colours(theme)
    ratios = {(ink, ground): contrast(of[ink], of[ground]) for ink in INKS for ground in GROUNDS}
    assert {pair: round(r, 2) for pair, r in ratios.items() if r < MIN_CONTRAST_RATIO} == {}


@pytest.mark.parametrize("theme", THEMES)
@pytest.mark.parametrize("tint", ["good", "bad"])
def test_figures_stand_out_from_the_strongest_tint_of_their_cell(theme: str, tint: str) -> None:
    of = colours(theme)
    assert contrast(of["fg"], mixed(of[tint], of["bg"], MAX_TINT_PERCENT)) >= MIN_CONTRAST_RATIO


class Outline(HTMLParser):
    """What a screen reader needs: language, headings, header cells, names of drawings."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: Counter[str] = Counter()
        self.lang = ""
        self.headings: list[int] = []
        self.without_name: list[str] = []  # drawings, pictures and boxes
        self.scopes: Counter[str] = Counter()
        self._drawing = ""
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        own = dict(attrs)
        self.tags[tag] += 1
        if tag == "html":
            self.lang = own.get("lang") or ""
        if re.fullmatch("h[1-6]", tag):
            self.headings.append(int(tag[1]))
        if tag == "th":
            self.scopes[own.get("scope") or ""] += 1
        if (tag == "img" and not own.get("alt")) or (tag == "svg" and own.get("role") != "img"):
            self.without_name.append(self.get_starttag_text() or tag)
        if tag == "svg" and not own.get("aria-label"):
            self._drawing = self.get_starttag_text() or tag
        if tag == "title":
            self._drawing = ""

    def handle_endtag(self, tag: str) -> None:
        if tag == "svg" and self._drawing:
            self.without_name.append(self._drawing)
            self._drawing = ""


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    out: Path = tmp_path_factory.mktemp("fleet") / "out"
    words = ("--sensors", "odometry", "--sensors", "all", "-o", out, "--write", "html,json", "-q")
    with jobs_here():
        ok("fleet", "rounded_rectangle", "labyrinth", "--to", "30", *words)
    places = {"fleet": out / "summary.html", "report": out / "rounded_rectangle" / "report.html"}
    return {name: path.read_text(encoding="utf-8") for name, path in places.items()}


@pytest.mark.parametrize("name", ["fleet", "report"])
def test_a_page_has_a_language_headings_in_order_header_cells_and_named_drawings(
    name: str, pages: dict[str, str]
) -> None:
    found = Outline(pages[name])
    assert found.lang == "en"
    assert found.headings.count(1) == 1
    assert found.headings[0] == 1
    steps = zip(found.headings, found.headings[1:], strict=False)
    assert [(a, b) for a, b in steps if b > a + 1] == []
    found = Outline(pages[name])
    assert found.tags["table"] == found.tags["thead"] > 0
    assert found.tags["svg"] > 0
    assert found.scopes[""] == 0
    assert found.scopes["col"] > found.tags["table"]
    assert found.scopes["row"] > found.tags["table"]
    assert found.without_name == []
    lists = re.findall(r"<dl.*?</dl>", pages[name], re.DOTALL)
    assert lists or name == "fleet"
    assert [tag for part in lists for tag in re.findall(r"<(p|h[1-6]|div|span)\b", part)] == []
