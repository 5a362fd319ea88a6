"""The page: complete, offline, escaped, the same numbers as report.json, the same bytes twice, small."""

import json
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import small_scene
from commands import ok

from locfuse.formats.figures.sections import sections
from locfuse.formats.report import html as report_html, markdown, tables
from locfuse.formats.report.findings import banner_of, in_parts, notes_of, options
from locfuse.formats.report.glossary import GLOSSARY
from locfuse.fusion.sensors.registry import colours

SENSORS = colours()
EVIL = '/<script>alert(1)</script>"onload=x|`*_\\'
VOID = {"meta", "input", "br"}
# numbers that are words: what a column, a bound or a rule is called
PHRASES = (
    r"95\s%( bounds| intervals| from)?",
    r"drift /\d+\sm",
    r"[23] sigma",
    r"\b1 is right",
    r"1 it grows",
    r"\(rmse\)",
    r"NIS near 1",
    r"Above 1:|1 is right",
    r"^(below|above) [\d.]+ mm$|^[\d.]+ to [\d.]+ mm$",  # keys of a scale of colours
    r"^every 10 seconds$",  # of spots
)


@dataclass
class Page(HTMLParser):
    """What a reader of the page sees outside its drawings, and every figure with its place in report.json."""

    figures: list[tuple[str, str, str]] = field(default_factory=list)  # (pointer, value, text)
    words: list[str] = field(default_factory=list)
    attributes: list[tuple[str, str]] = field(default_factory=list)
    tags: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__init__()
        self._open: list[tuple[str, dict[str, str]]] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        own = {k: v or "" for k, v in attrs}
        self.tags.append(tag)
        self.attributes += list(own.items())
        if tag not in VOID:
            self._open.append((tag, own))

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += [(k, v or "") for k, v in attrs]

    def handle_endtag(self, tag: str) -> None:
        while self._open and self._open.pop()[0] != tag:
            pass

    def handle_data(self, data: str) -> None:
        tags = [tag for tag, _ in self._open]
        if not data.strip() or ({"style", "title", "script"} & set(tags) and "svg" not in tags):
            return
        if tags and tags[-1] == "data":
            own = self._open[-1][1]
            self.figures.append((own["data-from"], own["value"], data))
        elif "svg" not in tags:
            self.words.append(" ".join(data.split()))


def read(html: str) -> Page:
    page = Page()
    page.feed(html)
    return page


def at(report: Any, pointer: str) -> Any:
    for key in pointer.split("/")[1:]:
        name = key.replace("~1", "/").replace("~0", "~")
        report = report[int(name)] if isinstance(report, list) else report[name]
    return report


def strings(value: Any) -> Iterator[str]:
    """Every key and every text of a report."""
    if isinstance(value, Mapping):
        for k, v in value.items():
            yield k
            yield from strings(v)
    elif isinstance(value, list):
        for v in value:
            yield from strings(v)
    elif isinstance(value, str):
        yield value


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("report") / "out"
    words = ("--all-subsets", "--sensors", "lrf@2Hz", "--write", "all", "--to", "30")
    ok("compare", "rounded_rectangle", *words, "-o", out)
    return out


@pytest.fixture(scope="module")
def page(compared: Path) -> Page:
    return read((compared / "report.html").read_text())


@pytest.fixture(scope="module")
def report(compared: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((compared / "report.json").read_text())
    return found


def test_every_figure_on_the_page_is_the_one_in_report_json(page: Page, report: dict[str, Any]) -> None:
    assert len(page.figures) > 200
    for pointer, value, text in page.figures:
        expected = at(report, pointer)
        assert float(value) == expected, pointer
        number = re.search(r"[-+−]?\d+(\.\d+)?(e[-+]\d+)?", text)
        assert number is not None, (pointer, text)
        shown = float(number[0].replace("−", "-"))
        lengths = (1.0, 1000.0) if pointer.endswith("_m") else (1.0,)  # a table is in m or in mm
        scale = 100.0 if "%" in text else min(lengths, key=lambda s: abs(shown - s * expected))
        digits = len((number[1] or ".")[1:])
        tolerance = 0.5001 * 10.0**-digits if "e" not in number[0] else abs(shown) * 1e-2
        tolerance = max(tolerance, abs(shown) * 5e-3 if "credit" in pointer else 0.0)  # three digits
        assert shown == pytest.approx(scale * expected, abs=tolerance), (pointer, text)


def test_no_other_number_is_on_the_page(page: Page, report: dict[str, Any]) -> None:
    texts = {
        *strings(report),
        *notes_of(report),
        *(part for f in report["findings"] for words in in_parts(f) for part in re.split(r" (?=--)", words)),
        options(report["fixes"]),
        *notes_of(report),
        *GLOSSARY.values(),
    }
    known = sorted({" ".join(s.split()) for s in texts if re.search(r"\d", s)}, key=len, reverse=True)
    for words in page.words:
        rest = words
        for text in known:
            rest = rest.replace(text, "")
        for phrase in PHRASES:
            rest = re.sub(phrase, "", rest)
        assert not re.search(r"\d", rest), words


def test_nothing_on_the_page_asks_for_anything_outside_it(compared: Path, page: Page) -> None:
    html = (compared / "report.html").read_text()
    assert "http" not in html.replace("http-equiv", "")
    assert not re.search(r"@import|url\((?!#)", html)
    assert {"link", "img", "iframe", "object"}.isdisjoint(page.tags)
    assert page.tags.count("script") == 1
    assert all(value.startswith("#") for name, value in page.attributes if name in {"src", "href", "xlink:href"})
    policy = next(v for k, v in page.attributes if k == "content" and v.startswith("default-src"))
    assert re.fullmatch(r"default-src 'none'; style-src 'unsafe-inline'; script-src 'sha256-[\w+/]{43}='", policy)


def test_the_page_has_everything_a_reader_looks_for(compared: Path, report: dict[str, Any]) -> None:
    html = (compared / "report.html").read_text()
    for section in (
        "trajectories",
        "where",
        "deviation",
        "spread",
        "bands",
        "consistency",
        "innovations",
        "gates",
        "credit",
    ):
        assert f'<section id="{section}">' in html, section
    for section in ("table", "figures", "sensors", "input", "settings"):
        assert f'<section id="{section}">' in html, section
    assert report["input"]["sha256"] in html
    assert f"locfuse {report['locfuse']}" in html
    assert "lrf@2Hz" in html
    assert html.index('class="verdicts"') < html.index('id="trajectories"') < html.index('id="table"')


def test_every_drawing_says_what_it_shows_and_the_samples_page_is_small(page: Page, compared: Path) -> None:
    drawings = page.tags.count("svg")
    assert drawings > 20
    assert sum(1 for name, _ in page.attributes if name in {"aria-labelledby", "aria-label"}) >= drawings
    assert len((compared / "report.html").read_bytes()) < 700_000  # nine configurations


def test_every_class_of_a_drawing_has_a_colour_for_light_and_for_dark(compared: Path) -> None:
    html = (compared / "report.html").read_text()
    used = set(re.findall(r'<path class="[^"]*\b(k\d+)"', html))
    light = html.split("/*")[0].split("@media")[0]
    dark = html.split("@media (prefers-color-scheme:dark)")[1].split("@media print")[0]
    assert used
    for slug in used:
        assert f"--{slug}:#" in light
        assert f"--{slug}:#" in dark
        assert f".{slug}{{--c:var(--{slug})}}" in html


def test_a_ten_minute_log_fits_in_one_megabyte_and_one_of_a_second_has_a_page() -> None:
    scene, report = small_scene.long(minutes=10.0, configurations=6)
    html = report_html.render(report, sections(scene), SENSORS)
    assert len(html.encode()) < 1_000_000
    scene, report = small_scene.long(minutes=1.0 / 60.0, configurations=6)
    page = read(report_html.render(report, sections(scene), SENSORS))
    assert page.tags.count("svg") > 20


@pytest.mark.parametrize("written", ["html", "md", "tex"])
def test_text_from_logs_stays_text(written: str) -> None:
    _, report = small_scene.long(minutes=0.2, configurations=2)
    report["input"]["name"] = EVIL
    report["input"]["topics"] = {"wheels": EVIL}
    report["input"]["messages"] = {EVIL: 5}
    report["input"]["dropped"] = {"wheels": {EVIL: 3}}
    report["input"]["losses"] = {EVIL: {"places": 1, "bytes": 9, "messages": 2}}
    report["notes"] = [EVIL]
    report["absent"] = {"lrf": EVIL}
    report["truth"] = {"topic": EVIL, "stamps": 3, "used": 2, "heading": True, "distance_m": 1.0}
    report["verdicts"] = {"compass": {"verdict": "helps", "words": EVIL}}
    if written == "html":
        html = report_html.render(report, [], SENSORS)
        page = read(html)
        assert page.tags.count("script") == 1  # ours; no other may run (its hash is in the page's policy)
        assert "onload" not in dict(page.attributes)
        assert EVIL in page.words
    elif written == "md":
        text = re.sub(r"(`+).*?\1", "", markdown.render(report))  # code spans aside
        assert not re.search(r"(?<!\\)<script", text)
    else:
        assert r"\textbackslash" in tables.latex(report)


def test_a_warning_whose_setting_a_finding_replaces_is_said_by_the_finding_alone() -> None:
    fix = {"role": "wheels", "message": "too long", "fixes": ["wheels.track=1.85"], "tried": None}
    old = {"message": "wheels: the track is 1.98 m. Not set: --set wheels.track=1.98", "void": False}
    report = {"validity": [old, {"message": "wheels: too long", "void": False}], "findings": [fix]}
    assert banner_of(report) == ["Warning: wheels: too long. Fix (not tried): --set wheels.track=1.85"]


def test_a_command_in_the_headline_is_code() -> None:
    _, report = small_scene.long(minutes=0.1, configurations=2)
    report["headline"] = "The track is unknown: `locfuse init a_b.mcap` asks for it."
    assert "<code>locfuse init a_b.mcap</code> asks" in report_html.render(report, [], SENSORS)
    assert "`locfuse init a_b.mcap` asks" in markdown.render(report)


def test_a_report_without_truth_says_so_and_ranks_by_prediction() -> None:
    scene, report = small_scene.untrue()
    html = report_html.render(report, sections(scene), SENSORS)
    words = " ".join(read(html).words)
    assert "There is no truth in this log" in words
    assert report["prediction"]["trust"] in words
    assert '<section id="uncertainty">' in html
    assert '<section id="deviation">' not in html


def test_title_names_the_preset_unless_it_is_the_default() -> None:
    scene, report = small_scene.long(minutes=0.1, configurations=2)
    for settings, title in (({"preset": "default"}, "made_up"), ({"preset": "paper"}, "made_up, preset paper")):
        html = report_html.render({**report, "settings": settings}, sections(scene), SENSORS)
        assert f"<title>{title}: " in html
        assert f" on {title}</h1>" in html
        written = markdown.render({**report, "settings": settings}).splitlines()[0]
        assert written.replace("\\", "") == f"# locfuse: {title}"


@pytest.mark.parametrize(
    ("write", "heavy"),
    [("json", {"matplotlib", "jinja2", "rerun", "rerun_bindings"}), ("html", {"matplotlib", "rerun"})],
)
def test_only_what_is_asked_for_loads_its_packages(tmp_path: Path, write: str, heavy: set[str]) -> None:
    code = (
        "import sys\n"
        "from locfuse.cli.main import main\n"
        "words = ['compare', 'rounded_rectangle', '--to', '5', '--sensors', 'compass', '--no-advice']\n"
        f"words += ['--write', '{write}', '-o', {str(tmp_path / 'o')!r}]\n"
        "try:\n    main(words)\nexcept SystemExit as e:\n    assert not e.code\n"
        f"assert not {heavy} & set(sys.modules)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_figure_that_is_not_finite_is_a_dash() -> None:
    figures = partial(report_html.figure, {"a": np.nan, "b": None, "c": 0.25})
    assert "–" in figures(["a"])
    assert "–" in figures(["b"])
    assert figures(["c"], "{:.2f}") == '<data value="0.25" data-from="/c">0.25</data>'


def test_what_configurations_noted_of_themselves_is_on_the_page_as_in_its_twin() -> None:
    scene, report = small_scene.untrue()
    lost = "lrf: lost from 19.9 s after the start until the end"
    for name in ("lrf", "all"):
        report["configurations"][name]["notes"] = [f"{lost} ({name})"]
    words = " ".join(read(report_html.render(report, sections(scene), SENSORS)).words)
    for said in (f"{lost} (lrf)", f"all: {lost} (all)"):
        assert said in words
        assert said in markdown.render(report)
    assert "lrf: lrf:" not in words
