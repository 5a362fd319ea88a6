"""The page in a real browser: one cursor over all plots, values, zoom; and complete where no script runs."""

import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import browser
import numpy as np
import pytest
import small_scene

from locfuse.formats.figures.panels import Curve
from locfuse.formats.figures.sections import sections
from locfuse.formats.report import html as report_html
from locfuse.fusion.sensors.registry import colours

needs_chromium = pytest.mark.skipif(
    browser.CHROMIUM is None, reason="no Chromium on the path: the page is not tried in a browser"
)
SCRIPT_BYTES = 6000


@pytest.fixture(scope="module")
def scene() -> Any:
    return small_scene.long(minutes=0.5, configurations=6)


@pytest.fixture(scope="module")
def page(scene: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("page") / "report.html"
    path.write_text(report_html.render(scene[1], sections(scene[0]), colours()))
    return path


@pytest.fixture(scope="module")
def tab(page: Path) -> Iterator[browser.Tab]:
    with browser.browser(1280, 1000) as tab:
        tab.open(page)
        yield tab


def box(tab: browser.Tab, figure: str) -> dict[str, float]:
    """Return where the axes of a figure lie in the window, after scrolling there."""
    tab.js(f"document.getElementById('{figure}').scrollIntoView({{block: 'center'}})")
    found: dict[str, float] = tab.js(
        f"""(() => {{
            const svg = document.getElementById('{figure}'), r = svg.getBoundingClientRect();
            const n = svg.dataset.axes.split(' ').map(Number), k = r.width / svg.viewBox.baseVal.width;
            return {{left: r.left + n[2] * k, right: r.left + n[3] * k, low: n[0], high: n[1],
                     bottom: r.top + n[7] * k, top: r.top + n[8] * k, y_low: n[5], y_high: n[6]}};
        }})()"""
    )
    return found


def at(box: dict[str, float], x: float, y: float) -> tuple[float, float]:
    """Return the window's place of shares of a figure's axes."""
    return box["left"] + x * (box["right"] - box["left"]), box["bottom"] + y * (box["top"] - box["bottom"])


def ticks(tab: browser.Tab, figure: str, axis: str) -> list[float]:
    words = tab.js(f"[...document.querySelectorAll('#{figure} .{axis} text')].map(e => e.textContent)")
    return [float(w.replace("−", "-")) for w in words]


def test_the_script_is_small_has_no_markup_and_is_the_only_one_that_may_run(page: Path) -> None:
    html = page.read_text()
    scripts = re.findall(r"<script>(.*?)</script>", html, re.DOTALL)
    assert len(scripts) == 1
    assert len(scripts[0].encode()) <= SCRIPT_BYTES
    assert f"script-src 'sha256-{report_html.hash_of(scripts[0])}'" in html
    assert "innerHTML" not in scripts[0]
    assert "fetch" not in scripts[0]


@needs_chromium
def test_one_cursor_stands_in_every_time_plot_and_on_the_map(tab: browser.Tab) -> None:
    where = box(tab, "deviation-0")
    tab.mouse("mouseMoved", *at(where, 0.4, 0.5))
    time = where["low"] + 0.4 * (where["high"] - where["low"])
    lines = tab.js(
        """[...document.querySelectorAll('.fig')].map(f => [f.dataset.axes.split(' '),
            (f.querySelector('.cursor').getAttribute('d') || '').slice(1).split(' ')[0]])"""
    )
    shown = [(axes, float(x)) for axes, x in lines if axes[10] == "time" and x]
    assert len(shown) == sum(axes[10] == "time" for axes, _ in lines) > 10
    for axes, x in shown:
        low, high, start, end = map(float, axes[:4])
        assert x == pytest.approx(start + (time - low) / (high - low) * (end - start), abs=1.0)
    assert tab.js("document.querySelectorAll('#trajectories-0 .here[d]').length") == 7  # six results and the truth


@needs_chromium
def test_the_values_under_the_pointer_are_those_of_the_curves(tab: browser.Tab, scene: Any) -> None:
    found = scene[0]
    where = box(tab, "consistency-0")
    tab.mouse("mouseMoved", *at(where, 0.5, 0.5))
    said = tab.js("[...document.querySelectorAll('#tip div')].map(e => e.textContent)")
    assert said[0].startswith("15.0 s: NEES / dof")
    values = dict(line.split("  ") for line in said[1:])
    panel = next(p for s in sections(found) for p in s.panels if p.name == "nees")
    curves = [m for m in panel.marks if isinstance(m, Curve)]
    assert set(values) == {c.of for c in curves}
    for curve in curves:
        near = np.interp([14.8, 14.9, 15.0, 15.1, 15.2], curve.x, curve.y)  # a pixel is 0.07 s
        assert 0.98 * near.min() <= float(values[curve.of]) <= 1.02 * near.max()


@needs_chromium
def test_a_result_that_is_unticked_is_not_listed(tab: browser.Tab) -> None:
    where = box(tab, "deviation-0")
    tab.js("document.querySelectorAll('.toggles input')[2].click()")
    tab.mouse("mouseMoved", *at(where, 0.3, 0.5))
    said = tab.js("document.getElementById('tip').textContent")
    tab.js("document.querySelectorAll('.toggles input')[2].click()")
    assert "compass" in said
    assert not re.search(r"lrf {2}", said.replace("compass+lrf", ""))


@needs_chromium
def test_the_pointer_on_the_map_sets_the_time_of_every_plot(tab: browser.Tab, scene: Any) -> None:
    where = box(tab, "trajectories-0")
    track = scene[0].drive.truth
    x, y = track.xy[np.searchsorted(track.t, 12.0)]
    share_x = (x - where["low"]) / (where["high"] - where["low"])
    share_y = (y - where["y_low"]) / (where["y_high"] - where["y_low"])
    tab.mouse("mouseMoved", *at(where, share_x, share_y))
    assert tab.js("document.getElementById('tip').textContent").startswith(("11.", "12."))
    assert tab.js("document.querySelectorAll('.cursor[d]').length") > 10


@needs_chromium
def test_dragging_zooms_all_time_plots_and_a_double_click_goes_back(tab: browser.Tab) -> None:
    where = box(tab, "deviation-0")
    before = {f: (ticks(tab, f, "xt"), ticks(tab, f, "yt")) for f in ("deviation-0", "bands-3", "consistency-1")}
    tab.drag(at(where, 0.2, 0.5), at(where, 0.5, 0.51))
    span = where["high"] - where["low"]
    for figure, (x, y) in before.items():
        shown = ticks(tab, figure, "xt")
        assert len(shown) >= 3
        assert min(shown) >= where["low"] + 0.19 * span
        assert max(shown) <= where["low"] + 0.51 * span
        assert shown != x
        assert ticks(tab, figure, "yt") == y  # the drag was along time only
    tab.double_click(*at(where, 0.5, 0.5))
    for figure, found in before.items():
        assert (ticks(tab, figure, "xt"), ticks(tab, figure, "yt")) == found


@needs_chromium
def test_a_drag_over_both_axes_zooms_the_values_of_its_own_plot(tab: browser.Tab) -> None:
    where, other = box(tab, "deviation-0"), ticks(tab, "deviation-1", "yt")
    whole = ticks(tab, "deviation-0", "yt")
    tab.drag(at(where, 0.2, 0.3), at(where, 0.6, 0.7))
    found = ticks(tab, "deviation-0", "yt")
    assert len(found) >= 3
    assert np.ptp(found) < 0.75 * np.ptp(whole)
    assert len({round(b - a, 9) for a, b in pairwise(sorted(found))}) == 1
    assert ticks(tab, "deviation-1", "yt") == other
    tab.double_click(*at(where, 0.5, 0.5))


@needs_chromium
def test_the_map_keeps_one_scale_for_both_axes_when_it_is_enlarged(tab: browser.Tab) -> None:
    where = box(tab, "trajectories-0")
    tab.drag(at(where, 0.4, 0.4), at(where, 0.5, 0.6))
    scale = tab.js("document.querySelector('#trajectories-0 [clip-path]>g').getAttribute('transform')")
    kx, ky = map(float, re.search(r"scale\((\S+) (\S+)\)", scale).groups())  # type: ignore[union-attr]
    assert kx == pytest.approx(ky)
    assert kx > 1.5
    tab.double_click(*at(where, 0.5, 0.5))
    assert tab.console == []


@needs_chromium
def test_no_page_is_wider_than_its_window(tab: browser.Tab) -> None:
    for width in (400, 1280, 2000):
        tab.look(width)
        assert tab.js("document.documentElement.scrollWidth") <= width


@needs_chromium
def test_without_a_script_every_drawing_is_there_and_nothing_waits_for_one(tab: browser.Tab, page: Path) -> None:
    tab.look(1280, script=False)
    tab.open(page)
    drawn = tab.js("[...document.querySelectorAll('.fig')].map(f => f.querySelectorAll('path').length)")
    assert len(drawn) > 20
    assert min(drawn) >= 2
    assert not tab.js("!!document.querySelector('#tip, .cursor, .here[d]')")
