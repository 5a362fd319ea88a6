"""Where a drive went wrong: each path in the colours of its error, or of what the filter claims without truth."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from locfuse.formats.thin import evenly
from locfuse.fusion.data import VERDICTS, Array, Audit, Estimates, Evaluation

from .palette import LEVELS
from .panels import Curve, Mark, Panel, Section, Spots
from .route import between, spots, step, timed_path
from .scene import Scene

STRETCHES = 240  # of a path, each in one colour
MAX_POINTS = 1500  # of a path on a small map
GATE = VERDICTS.index("gate")
REFUSAL_CELL = 0.025  # of the map's extent: refusals in one cell share a cross
HIGHEST = 0.6  # of the largest value: the last limit lies below, so that its colour is seen
TINY_M = 1e-6  # m: below, a path is without error


class Route(NamedTuple):
    """A path and what colours it."""

    name: str
    t: Array  # (n,)
    xy: Array  # (n, 2)
    value: Array  # (n,) m
    refused: Array  # (k,) s, when readings were refused


def where(scene: Scene) -> Section:
    """Return one map per configuration, its path in the colours of its error."""
    routes = [_route(e, j, scene.has_truth) for e, j in scene.shown()]
    routes = [r for r in routes if np.isfinite(r.value).any()]
    if not routes:
        return Section("where", "", "", ())
    what = "position error" if scene.has_truth else "claimed sigma of the position"
    edges = _edges(max(float(np.nanmax(r.value)) for r in routes))
    said = dict(zip((f"level {i}" for i in range(len(LEVELS))), _words(edges), strict=True))
    said["time"] = f"every {step(routes[0].t):.0f} seconds"
    panels = tuple(_panel(scene, route, edges, what, said) for route in routes)
    crosses = any(len(r.refused) for r in routes)
    text = (
        f"Each path in the colours of its {what}."
        f"{f' Crosses: a reading of “{scene.best.name}” was refused.' if crosses else ''}"
    )
    return Section("where", f"Where: {what} along the path", text, panels, columns=3)


def _route(e: Estimates, judged: Evaluation, has_truth: bool) -> Route:
    refused = [_refused(audit, e.t) for audit in e.audits.values()]
    times = np.unique(np.concatenate([np.zeros(0), *refused]))
    if has_truth:
        return Route(e.name, judged.t, judged.estimate_xy, np.hypot(*judged.deviation.T), times)
    t, xy = timed_path(e, judged)
    return Route(e.name, t, xy, np.sqrt(np.maximum(e.triangles[:, 0] + e.triangles[:, 3], 0.0)), times)


def _refused(audit: Audit, t: Array) -> Array:
    found: Array = t[audit.instant[audit.verdict == GATE]]
    return found


def _edges(largest: float) -> Array:
    """Return the limits between the colours [m]: 1, 3, 10, 30... up to about half the largest value."""
    power = np.floor(2.0 * np.log10(max(HIGHEST * largest, TINY_M)))
    halves = np.arange(power - len(LEVELS) + 2, power + 1)
    edges: Array = np.where(halves % 2 == 0, 1.0, 3.0) * 10.0 ** np.floor(halves / 2.0)
    return edges


def _words(edges: Array) -> list[str]:
    said = [f"{1000.0 * e:g} mm" if e < 1.0 else f"{e:g} m" for e in edges]
    middle = [f"{a} to {b}" for a, b in pairwise(said)]
    return [f"below {said[0]}", *middle, f"above {said[-1]}"]


def _panel(scene: Scene, route: Route, edges: Array, what: str, said: dict[str, str]) -> Panel:
    marks: list[Mark] = list(_coloured(route, edges))
    crosses = _crosses(route)
    marks += [Spots("gate", *crosses.T)] if len(crosses) else []
    marks += [Spots("landmark", np.array([x]), np.array([y])) for x, y in scene.landmarks]
    marks += spots(route.t, route.xy)
    rms = float(np.sqrt(np.nanmean(route.value**2)))
    return Panel(
        name=f"where_{route.name}",
        title=f"{route.name}: {what} along the path",
        y_label=f"{route.name}: y, m",
        x_label="x, m",
        marks=tuple(marks),
        summary=f"Path of {route.name}, coloured by its {what}: rms {rms:.4f} m, at most "
        f"{float(np.nanmax(route.value)):.4f} m.",
        equal=True,
        keys=tuple(dict.fromkeys(m.of for m in marks)),
        said=said,
    )


def _coloured(route: Route, edges: Array) -> list[Curve]:
    """Return the path as one curve per colour; a stretch has the colour of its rms value."""
    ends = np.unique(np.rint(np.linspace(0, len(route.t) - 1, STRETCHES + 1)).astype(int))
    pieces: dict[int, list[Array]] = {}
    for first, last in pairwise(ends):
        stretch = route.value[first : last + 1]
        if np.isfinite(stretch).any():
            level = int(np.searchsorted(edges, np.sqrt(np.nanmean(stretch**2)), side="right"))
            shown = route.xy[first : last + 1][evenly(last + 1 - first, MAX_POINTS // STRETCHES)]
            _extend(pieces.setdefault(level, []), shown)
    paths = {level: np.concatenate(found) for level, found in sorted(pieces.items())}
    return [Curve(f"level {level}", xy[:, 0], xy[:, 1], wide=True) for level, xy in paths.items()]


def _extend(found: list[Array], stretch: Array) -> None:
    """Continue a curve where it ended, else begin a new one after a break."""
    if found and (found[-1][-1] == stretch[0]).all():
        found.append(stretch[1:])
    else:
        found += [np.full((1, 2), np.nan), stretch] if found else [stretch]


def _crosses(route: Route) -> Array:
    """Return where readings were refused, (k, 2): one cross for many at one place."""
    places = between(route.t, route.xy, route.refused)
    places = places[np.isfinite(places).all(axis=1)]
    if len(places) == 0:
        return places
    cell = max(float(np.nanmax(np.ptp(route.xy, axis=0))), TINY_M) * REFUSAL_CELL
    _, first = np.unique(np.floor(places / cell), axis=0, return_index=True)
    return places[np.sort(first)]
