"""Panels, their two renderers, ticks and colours."""

import math
import re
import xml.etree.ElementTree as ET
from importlib.resources import files
from itertools import combinations, pairwise

import numpy as np
import pytest
import small_scene
from msgspec.structs import replace

from locfuse.formats.figures import palette, svg
from locfuse.formats.figures.for_paper import paper_figures
from locfuse.formats.figures.panels import Band, Curve, Dots, Panel, Spots, Strokes, linear_ticks, log_ticks
from locfuse.formats.figures.sections import credit, sections, spread
from locfuse.formats.figures.where import spots, step, track, where
from locfuse.fusion import se2
from locfuse.fusion.data import VERDICTS, Array
from locfuse.fusion.sensors.registry import colours

SENSORS = colours()
LOOKS: list[dict[str, object]] = [
    {},
    {"log": True, "y_range": (0.1, 20.0)},
    {"equal": True},
    {"lanes": ("a", "b"), "y_range": (2.0, 0.0)},
]


def trace(name: str, sensors: tuple[str, ...] | None = None, **how: bool) -> palette.Trace:
    """How a configuration is drawn; its sensors are those of the name unless they are given."""
    of_name = {"odometry": (), "all": ("compass", "lrf", "camera")}.get(name, tuple(name.split("+")))
    return palette.Trace(name, of_name if sensors is None else sensors, **how)


PAPERS = {n: trace(n) for n in ("odometry", "compass", "lrf", "camera", "all")}
INKS = {n: c for n, c in palette.colours(PAPERS, SENSORS).items() if n in {*PAPERS, "truth"}}


# --- colours as people see them: colour blindness simulated, distances that the eye tells apart, contrast

# Machado, Oliveira, Fernandes 2009: severity 1.0, on linear RGB
VISION = {
    "normal": np.eye(3),
    "protanopia": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "deuteranopia": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.01182, 0.04294, 0.968881]]
    ),
    "tritanopia": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.3039]]
    ),
}
TO_LMS = np.array(  # Ottosson 2020
    [
        [0.4122214708, 0.5363325363, 0.0514459929],
        [0.2119034982, 0.6806995451, 0.1073969566],
        [0.0883024619, 0.2817188376, 0.6299787005],
    ]
)
TO_LAB = np.array(
    [
        [0.2104542553, 0.793617785, -0.0040720468],
        [1.9779984951, -2.428592205, 0.4505937099],
        [0.0259040371, 0.7827717662, -0.808675766],
    ]
)


def linear_rgb(colour: str) -> Array:
    c = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def page(theme: str) -> str:
    """The background that the report's style sheet gives a theme."""
    light, dark, *_ = re.findall(r"--bg:#(\w+)", (files("locfuse.formats.report") / "report.css").read_text())
    digits = {"light": light, "dark": dark}[theme]
    return "#" + "".join(c * (6 // len(digits)) for c in digits)


def oklab(rgb: Array) -> Array:
    """Distances here are about what the eye tells apart."""
    lab: Array = TO_LAB @ np.cbrt(TO_LMS @ np.clip(rgb, 0.0, 1.0))
    return lab


def contrast(a: str, b: str) -> float:
    """WCAG 2.1."""
    light, dark = sorted((float(np.dot([0.2126, 0.7152, 0.0722], linear_rgb(c))) for c in (a, b)), reverse=True)
    return (light + 0.05) / (dark + 0.05)


@pytest.mark.parametrize("theme", ["light", "dark"])
@pytest.mark.parametrize("vision", VISION)
def test_the_papers_five_configurations_and_the_truth_stay_apart_as_thin_lines_too(
    theme: str, vision: str
) -> None:
    labs = {n: oklab(VISION[vision] @ linear_rgb(getattr(c, theme))) for n, c in INKS.items()}
    for a, b in combinations(labs, 2):
        assert np.linalg.norm(labs[a] - labs[b]) > 0.09, (a, b)  # just noticeable: 0.02
    # a line of 1.5 px covers three quarters of a pixel and half of its neighbours: its colour is mixed with the
    # page's; what is too close then must be broken in another way
    paper = linear_rgb(page(theme))
    seen = {n: 0.625 * linear_rgb(getattr(c, theme)) + 0.375 * paper for n, c in INKS.items()}
    labs = {n: oklab(VISION[vision] @ rgb) for n, rgb in seen.items()}
    for a, b in combinations(labs, 2):
        apart = np.linalg.norm(labs[a] - labs[b])
        broken = [{"truth": "dots"}.get(n) or PAPERS[n].look for n in (a, b)]
        assert apart > 0.03 or broken[0] != broken[1], (a, b, apart)  # just noticeable: 0.02


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_every_configuration_stands_out_from_its_page(theme: str) -> None:
    names = ["odometry", "all", *SENSORS, "compass+lrf", "lrf+camera", "compass+camera", "sonar+gps"]
    inks = palette.colours({n: trace(n) for n in names}, SENSORS)
    for name in names:
        assert contrast(getattr(inks[name], theme), page(theme)) >= 3.0, name


def test_a_sensors_colour_does_not_depend_on_what_else_is_in_the_log_nor_on_a_name() -> None:
    alone = palette.colours({"lrf": trace("lrf")}, SENSORS)["lrf"]
    beside = palette.colours({n: trace(n) for n in ("odometry", "compass", "lrf")}, SENSORS)
    assert beside["lrf"] == alone
    for look in (trace("lrf@2Hz", ("lrf",), slowed=True), trace("lrf", smoothed=True)):
        assert palette.colours({"x": look}, SENSORS)["x"] == alone
        assert look.dashed
    assert trace("compass+lrf").look == "dash"
    assert trace("lrf").look == ""
    assert trace("all").look == "over"  # its gaps show the curve that it lies on
    assert trace("all", ("lrf",)).look == ""  # the only sensor is no set
    assert not trace("all").dashed
    assert not trace("lrf").dashed
    assert not trace("lrf@2Hz+x smoothed", ("lrf",)).dashed
    assert set(VERDICTS) <= set(palette.ROLES)


@pytest.mark.parametrize(
    ("low", "high"),
    [(0.0, 1.0), (-0.55, 0.52), (0.0, 54.78), (-3e-5, 2e-5), (1e4, 3e4), (-20.1, 4.2), (0.99, 1.01)],
)
def test_linear_ticks_are_round_evenly_spaced_and_three_to_seven(low: float, high: float) -> None:
    found = linear_ticks(low, high, 6)
    values = [v for v, _ in found]
    assert 3 <= len(found) <= 7
    assert all(low - 1e-9 <= v <= high + 1e-9 for v in values)
    step = values[1] - values[0]
    assert round(step / 10.0 ** math.floor(math.log10(step) + 1e-9), 6) in {1.0, 2.0, 5.0}
    for v, label in found:
        assert float(label.replace("−", "-")) == pytest.approx(v, abs=1e-9 * max(1.0, abs(v)) + 1e-12)


@pytest.mark.parametrize("half", [1.01, 2.3, 4.9, 9.7, 4.9e-3, 49.0])
def test_a_low_axis_shows_its_scale_too(half: float) -> None:
    assert 2 <= len(linear_ticks(-half, half, 3)) <= 5


@pytest.mark.parametrize(("low", "high"), [(0.01, 100.0), (0.3, 2.5), (1e-9, 1e9), (0.0001, 1.3)])
def test_logarithmic_ticks_lie_within_and_read_as_what_they_are(low: float, high: float) -> None:
    found = log_ticks(low, high)
    assert 2 <= len(found) <= 8
    assert all(low <= v * (1 + 1e-9) and v <= high * (1 + 1e-9) for v, _ in found)


def points(path: str) -> list[Array]:
    """What a path made by figure_path draws: one array (n, 2) px per piece."""
    pieces = []
    for piece in re.findall(r"M[^M]*", path):
        numbers = [int(n) for n in re.findall(r"-?\d+", piece)]
        pieces.append(np.cumsum(np.array(numbers[: len(numbers) // 2 * 2]).reshape(-1, 2), axis=0) / 10.0)
    return pieces


def test_a_noisy_curve_keeps_its_peaks_and_a_smooth_one_its_shape() -> None:
    rng = np.random.default_rng(0)
    x, y = np.linspace(0.0, 400.0, 50_000), 100.0 + 20.0 * rng.normal(size=50_000)
    y[31_234], y[777] = 500.0, -300.0
    path = svg.curve_path(x, y, 400)
    drawn = np.concatenate(points(path))
    assert drawn[:, 1].max() == 500.0
    assert drawn[:, 1].min() == -300.0
    assert len(drawn) <= 2 * 400 + 4
    assert len(path) < 10_000
    x = np.linspace(0.0, 400.0, 5000)
    y = 100.0 + 80.0 * np.sin(x / 40.0)
    drawn = points(svg.curve_path(x, y, 400))[0]
    np.testing.assert_allclose(np.interp(x, drawn[:, 0], drawn[:, 1]), y, atol=0.4)
    assert len(drawn) < 150


def test_nan_breaks_a_curve_and_dots_that_touch_become_one_stroke() -> None:
    y = np.full(100, 5.0)
    y[40:50] = np.nan
    assert len(points(svg.curve_path(np.arange(100.0), y, 400))) == 2
    x, y = np.array([3.0, 3.0, 3.0, 3.0, 8.0]), np.array([1.0, 2.0, 3.0, 30.0, 7.0])
    path = svg.dots_path(x, y)
    assert path.count("M") == 3
    assert "M30 10v20" in path
    assert svg.dots_path(np.array([np.nan]), np.array([1.0])) == ""


def panel(**changes: object) -> Panel:
    x = np.linspace(0.0, 10.0, 50)
    marks = (
        Band("bounds", x, x - 1.0, x + 1.0),
        Curve("lrf", x, x),
        Dots("gate", x[::5], x[::5]),
        Strokes("walls of the first scan", np.array([[[0.0, 0.0], [10.0, 5.0]]])),
    )
    base = {"name": "p", "title": "T <b>", "y_label": "y, m", "x_label": "time, s", "marks": marks}
    return Panel(**{**base, **changes})  # type: ignore[arg-type]


SLUGS = {name: f"k{i}" for i, name in enumerate(["lrf", *palette.ROLES])}


@pytest.mark.parametrize("equal", [False, True])
@pytest.mark.parametrize("limits", [None, (-math.inf, math.inf)])
def test_values_whose_span_no_number_holds_are_drawn(limits: tuple[float, float] | None, equal: bool) -> None:
    """A damaged log may say 1e308 m one moment and -1e308 m the next."""
    x = np.linspace(0.0, 10.0, 6)
    curve = Curve("lrf", x, np.array([-1.5e308, 0.0, 1.5e308, 1.0, -1.0, 0.5]))
    drawing = svg.svg(panel(marks=(curve,), y_range=limits, equal=equal), "p-0", SLUGS)
    ET.fromstring(drawing)
    assert "inf" not in drawing
    assert "nan" not in drawing


@pytest.mark.parametrize("changes", LOOKS)
def test_a_drawing_is_well_formed_and_labelled(changes: dict[str, object]) -> None:
    root = ET.fromstring(svg.svg(panel(**changes), "p-0", SLUGS))
    ids = {e.get("id") for e in root.iter()}
    assert set(root.get("aria-labelledby", "").split()) <= ids
    assert root.find("title").text == "T <b>"  # type: ignore[union-attr]
    assert not [e for e in root.iter() if e.get("style") or e.get("fill") or e.get("stroke")]  # CSS decides
    text = [e.text for e in root.iter("text")]
    assert "y, m" in text
    assert "time, s" in text


@pytest.mark.parametrize("limits", [{"x_range": (0.0, 0.0)}, {"y_range": (3.0, 3.0)}, {"x_range": (2e9, 2e9)}])
def test_a_panel_of_one_instant_or_one_value_is_drawn(limits: dict[str, object]) -> None:
    ET.fromstring(svg.svg(panel(**limits), "p-0", SLUGS))


def test_points_are_drawn_where_the_axes_say() -> None:
    x = np.array([0.0, 2.0, 10.0])
    drawing = svg.svg(panel(marks=(Curve("lrf", x, 3.0 * x),), x_range=(0.0, 10.0)), "p-0", SLUGS)
    root = ET.fromstring(drawing)
    labels = {e.text: (float(e.get("x", 0)), float(e.get("y", 0)), e.get("class")) for e in root.iter("text")}
    drawn = points(re.search(r'class="curve[^"]*" d="([^"]*)"', drawing)[1])[0]  # type: ignore[index]
    assert drawn[0, 0] == pytest.approx(labels["0"][0], abs=6)  # the y label "0" stands left of the axis
    assert drawn[-1, 0] == pytest.approx(labels["10"][0] if labels["10"][2] == "m" else 450, abs=0.2)
    middle = labels["20"][1] - 3.6  # of the row y = 20
    at_20 = np.interp(20.0 / 3.0, [0.0, 10.0], [drawn[0, 1], drawn[-1, 1]])
    assert at_20 == pytest.approx(middle, abs=0.2)


def test_an_equal_panel_has_one_scale() -> None:
    square = np.array([[[0.0, 0.0], [4.0, 0.0]], [[4.0, 0.0], [4.0, 4.0]]])
    drawing = svg.svg(panel(marks=(Strokes("walls of the first scan", square),), equal=True), "p-0", SLUGS)
    drawn = points(re.search(r'class="stroke[^"]*" d="([^"]*)"', drawing)[1])  # type: ignore[index]
    lengths = [np.hypot(*(b - a)) for piece in drawn for a, b in pairwise(piece)]
    assert lengths[0] == pytest.approx(lengths[1], abs=0.3)


def test_paper_figures_are_the_same_bytes_twice_with_real_fonts() -> None:
    scene, _ = small_scene.long(0.05, 2)
    some = [s for s in sections(scene) if s.name in {"trajectories", "gates"}]
    traces = palette.traces_of(scene.estimates)
    first, second = (paper_figures(some, traces, SENSORS) for _ in range(2))
    assert first == second
    assert set(first) == {"trajectories.svg", "trajectories.pdf", "gates.svg", "gates.pdf"}
    ET.fromstring(first["gates.svg"])
    assert first["gates.pdf"].startswith(b"%PDF")
    assert b"/CIDFontType2" in first["gates.pdf"]  # TrueType: journals refuse Type 3
    assert b"/Type3" not in first["gates.pdf"]
    assert b"<dc:date>" not in first["gates.svg"]
    assert b"CreationDate" not in first["gates.pdf"]


# --- errors along the path, histograms, credit as a picture: what they draw is what was measured


def marks(panel: object, kind: type) -> dict[str, object]:
    return {m.of: m for m in panel.marks if isinstance(m, kind)}  # type: ignore[attr-defined]


def test_a_path_is_coloured_by_the_error_of_its_stretch() -> None:
    scene, _ = small_scene.long(0.5, 2)
    judged = scene.evaluations[1]
    error = np.where(judged.t < 15.0, 0.004, 0.4)  # m
    jump = replace(judged, deviation=np.stack((error, np.zeros_like(error)), axis=-1))
    panel = where(replace(scene, evaluations=[scene.evaluations[0], jump])).panels[1]
    drawn = marks(panel, Curve)
    assert len(drawn) == 2
    small, large = drawn.values()
    first = judged.estimate_xy[judged.t < 14.5]
    for x, y in zip(small.x, small.y, strict=True):  # type: ignore[attr-defined]
        assert np.isnan(x) or np.hypot(*(judged.estimate_xy[judged.t < 15.3] - (x, y)).T).min() < 1e-9
    assert np.hypot(*(first[len(first) // 2] - np.stack((large.x, large.y), -1)).T).min() > 0.05  # type: ignore[attr-defined]


def test_the_classes_serve_every_path_however_far_apart_the_errors_are() -> None:
    scene, _ = small_scene.long(0.5, 2)
    judged = [scene.evaluations[0], scene.evaluations[1]]
    sizes = np.linspace(0.6, 6.0, len(judged[0].t)), np.linspace(0.0006, 0.006, len(judged[1].t))  # m
    own = [replace(j, deviation=np.stack((s, np.zeros_like(s)), -1)) for j, s in zip(judged, sizes, strict=True)]
    panels = where(replace(scene, estimates=scene.estimates[:2], evaluations=own)).panels
    coarse, fine = (list(marks(panel, Curve)) for panel in panels)
    assert len(coarse) >= 2
    assert len(fine) >= 2
    assert {of for of in panels[0].legend if of.startswith("level")} <= {*coarse, *fine}
    assert all(words.endswith(" m") for of, words in panels[0].legend.items() if of.startswith("level"))


def test_refusals_are_crosses_where_the_robot_was() -> None:
    scene, _ = small_scene.long(0.5, 6)
    best = scene.best
    panel = next(p for p in where(scene).panels if p.name == f"where_{best.name}")
    crosses = marks(panel, Spots)["gate"]
    times = np.unique(np.concatenate([best.t[a.instant[a.verdict == 1]] for a in best.audits.values()]))
    judged = scene.evaluations[-1]
    at = np.stack([np.interp(times, judged.t, c) for c in judged.estimate_xy.T], axis=-1)
    assert 0 < len(crosses.x) <= len(times)  # type: ignore[attr-defined]
    for place in zip(crosses.x, crosses.y, strict=True):  # type: ignore[attr-defined]
        assert np.hypot(*(at - place).T).min() < 1e-9


def test_without_truth_the_path_shows_what_the_filter_claims() -> None:
    scene, _ = small_scene.untrue()
    found = where(scene)
    assert "claimed sigma" in found.title
    assert len(found.panels) == len(scene.estimates)


def test_tracks_and_spots_are_where_the_robot_was_at_even_times() -> None:
    t = np.linspace(0.0, 55.0, 1101)
    found = {s.of: s for s in spots(t, np.stack((t, 2.0 * t), axis=-1))}
    np.testing.assert_allclose(found["time"].x, [10.0, 20.0, 30.0, 40.0, 50.0])
    np.testing.assert_allclose(found["time"].y, 2.0 * found["time"].x)
    assert found["start"].x[0] == 0.0
    assert found["end"].x[0] == 55.0
    assert step(np.array([0.0, 3600.0])) == 60.0
    t = np.array([0.0, 1.0, 9.0, 10.0])
    (line,) = track("lrf", t, np.stack((t**2, -t), axis=-1))
    times = np.linspace(line.start, line.end, len(line.x))
    np.testing.assert_allclose(line.x, np.interp(times, t, t**2))
    assert track("lrf", t[:1], np.zeros((1, 2))) == []


def test_the_histogram_holds_every_stamp_and_the_line_is_the_median() -> None:
    scene, _ = small_scene.long(0.5, 3)
    panel, heading = spread(scene).panels
    assert "°" in heading.x_label
    scale = 1000.0 if "mm" in panel.x_label else 1.0
    for lane, judged in enumerate(scene.evaluations):
        error = scale * np.hypot(*judged.deviation.T)
        band = next(m for m in panel.marks if isinstance(m, Band) and m.of == judged.name)
        height, edges = (band.low - band.high)[::2], band.x[::2]
        counts = np.histogram(error, [*edges, band.x[-1]])[0]
        np.testing.assert_allclose(height / height.sum(), counts / len(error), atol=2e-3)
        line = [m for m in panel.marks if isinstance(m, Strokes)][lane]
        assert line.ends[0, 0, 0] == pytest.approx(np.median(error))


def test_the_picture_of_credit_shows_every_interval_of_the_report() -> None:
    effect = {"factor": 5.0, "low": 0.6, "high": 12.0, "expected": 8.0}
    values = {"compass": {"alone": effect, "leave_one_out": None, "credit": {**effect, "factor": 2.0}}}
    scene, _ = small_scene.long(0.1, 2)
    (panel,) = credit(replace(scene, credit={"sensors": values})).panels
    assert {m.of: float(m.x[0]) for m in panel.marks if isinstance(m, Spots)} == {"alone": 5.0, "credit": 2.0}
    assert [m.ends[0, :, 0].tolist() for m in panel.marks if isinstance(m, Strokes)] == [[0.6, 12.0]] * 2
    assert credit(replace(scene, credit=None)).panels == ()


def test_the_result_that_is_the_reference_itself_has_no_curve_of_its_errors() -> None:
    scene, _ = small_scene.long(0.1, 2)
    other, best = (replace(j, reference=True) for j in scene.evaluations)
    itself = replace(best, deviation=np.zeros_like(best.deviation))
    assert replace(scene, evaluations=[other, itself]).judged() == [other]
    assert replace(scene, evaluations=[other, best]).judged() == [other, best]


@pytest.mark.parametrize("theme", ["light", "dark"])
@pytest.mark.parametrize("vision", VISION)
def test_the_colours_of_a_scale_are_told_apart_and_grow_evenly_in_lightness(theme: str, vision: str) -> None:
    labs = [oklab(VISION[vision] @ linear_rgb(getattr(c, theme))) for c in palette.LEVELS]
    for a, b in combinations(labs, 2):
        assert np.linalg.norm(a - b) > 0.08  # just noticeable: 0.02
    lightness = [lab[0] for lab in labs]
    steps = np.diff(lightness) * (-1 if theme == "light" else 1)
    assert (steps > 0.03).all()
    against = [contrast(getattr(c, theme), page(theme)) for c in palette.LEVELS]
    assert all(a < b for a, b in pairwise(against))


@pytest.mark.parametrize("turns", [0.3, 1.2])
def test_a_heading_is_not_drawn_across_the_panel_where_it_passes_half_a_turn(turns: float) -> None:
    t = np.linspace(0.0, 500.0, 20_000)
    heading = np.degrees(se2.wrap_all(2.0 * np.pi * turns * t / t[-1]))
    assert len(points(svg.curve_path(t, heading, 500, 360.0))) == 1 + round(turns)
