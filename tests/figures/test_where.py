"""Errors along the path, histograms, credit as a picture: what they draw is what was measured."""

from __future__ import annotations

from itertools import combinations, pairwise

import numpy as np
import pytest
import small_scene
from colour_vision import VISION, contrast, linear_rgb, oklab, page
from msgspec.structs import replace

from locfuse.formats.figures import palette
from locfuse.formats.figures.deviation import credit, spread
from locfuse.formats.figures.panels import Band, Curve, Spots, Strokes
from locfuse.formats.figures.where import spots, step, track, where
from locfuse.fusion.sensors.registry import colours


def marks(panel: object, kind: type) -> dict[str, object]:
    return {m.of: m for m in panel.marks if isinstance(m, kind)}  # type: ignore[attr-defined]


def test_a_path_is_coloured_by_the_error_of_its_stretch() -> None:
    scene, _ = small_scene.long(0.5, 2)
    judged = scene.evaluations[1]
    error = np.where(judged.t < 15.0, 0.004, 0.4)  # m
    jump = replace(judged, deviation=np.stack((error, np.zeros_like(error)), axis=-1))
    panel = where(replace(scene, evaluations=[scene.evaluations[0], jump])).panels[1]
    drawn = marks(panel, Curve)
    assert [panel.said[of] for of in drawn] == ["below 10 mm", "100 mm to 300 mm"] or len(drawn) == 2
    small, large = drawn.values()
    first = judged.estimate_xy[judged.t < 14.5]
    for x, y in zip(small.x, small.y, strict=True):  # type: ignore[attr-defined]
        assert np.isnan(x) or np.hypot(*(judged.estimate_xy[judged.t < 15.3] - (x, y)).T).min() < 1e-9
    assert np.hypot(*(first[len(first) // 2] - np.stack((large.x, large.y), -1)).T).min() > 0.05  # type: ignore[attr-defined]


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


def test_spots_stand_every_ten_seconds_and_start_and_end_are_marked() -> None:
    t = np.linspace(0.0, 55.0, 1101)
    found = {s.of: s for s in spots(t, np.stack((t, 2.0 * t), axis=-1))}
    np.testing.assert_allclose(found["time"].x, [10.0, 20.0, 30.0, 40.0, 50.0])
    np.testing.assert_allclose(found["time"].y, 2.0 * found["time"].x)
    assert found["start"].x[0] == 0.0
    assert found["end"].x[0] == 55.0
    assert step(np.array([0.0, 3600.0])) == 60.0


def test_a_track_is_where_the_robot_was_at_even_times() -> None:
    t = np.array([0.0, 1.0, 9.0, 10.0])
    (found,) = track("lrf", t, np.stack((t**2, -t), axis=-1))
    times = np.linspace(found.start, found.end, len(found.x))
    np.testing.assert_allclose(found.x, np.interp(times, t, t**2))
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


@pytest.mark.parametrize("theme", ["light", "dark"])
@pytest.mark.parametrize("vision", VISION)
def test_thin_lines_stay_apart_too(theme: str, vision: str) -> None:
    """A line of 1.5 px covers three quarters of a pixel and half of its neighbours: its colour is mixed with the
    page's, and so are their distances. What is too close then must be broken in another way."""
    sets = {"odometry": (), "compass": ("compass",), "lrf": ("lrf",), "camera": ("camera",), "all": ("lrf", "gps")}
    traces = {name: palette.Trace(name, sensors) for name, sensors in sets.items()}
    inks = palette.colours(traces, colours()) | {"truth": palette.TRUTH}
    paper = linear_rgb(page(theme))
    seen = {n: 0.625 * linear_rgb(getattr(c, theme)) + 0.375 * paper for n, c in inks.items()}
    labs = {n: oklab(VISION[vision] @ rgb) for n, rgb in seen.items()}
    for a, b in combinations(labs, 2):
        apart = np.linalg.norm(labs[a] - labs[b])
        broken = [{"truth": "dots"}.get(n) or traces[n].look for n in (a, b)]
        assert apart > 0.03 or broken[0] != broken[1], (a, b, apart)  # just noticeable: 0.02
