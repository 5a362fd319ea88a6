"""Map figures: trajectories over the line map, and paths coloured by their error."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from locfuse.formats.geometry import walls
from locfuse.fusion.data import Array, Estimates, Evaluation, RowVerdict, evenly, interpolate

from .palette import LEVELS
from .panels import Curve, Mark, Panel, Scene, Section, Spots, Strokes, TimedPlaces, values_of

STEPS_S = (10.0, 30.0, 60.0, 300.0, 600.0, 3600.0)
MAX_SPOTS = 60
TRACK_STEP_S = 0.25
MAX_TRACK = 600  # positions of one track


def timed_path(estimates: Estimates, judged: Evaluation) -> tuple[Array, Array]:
    """Return times (n,) [s] and positions (n, 2) [m] of a result.

    For a result aligned to the truth these are the evaluated positions after alignment, else all estimates.
    """
    if judged.align == "none":
        return estimates.t, estimates.pose[:, :2]
    return judged.t, judged.estimate_xy


def spots(t: Array, xy: Array) -> list[Spots]:
    """Return symbols at the start and end of a path and at regular times between; [] without positions."""
    good = np.isfinite(xy).all(axis=1)
    t, xy = t[good], xy[good]
    if len(t) == 0:
        return []
    at = interpolate(np.arange(t[0] + step(t), t[-1], step(t)), t, xy)
    return [Spots("time", *at.T), Spots("end", *xy[-1:].T), Spots("start", *xy[:1].T)]


def landmarks(scene: Scene) -> list[Spots]:
    """Return symbols for the landmarks of bearings and ranges."""
    return [Spots("landmark", np.array([x]), np.array([y])) for x, y in scene.landmarks]


def step(t: Array) -> float:
    """Return the time [s] between two symbols on a path.

    It is the shortest of STEPS_S that gives at most MAX_SPOTS symbols.
    """
    span = float(t[-1] - t[0]) if len(t) else 0.0
    return next((s for s in STEPS_S if span <= s * MAX_SPOTS), max(STEPS_S[-1], span / MAX_SPOTS))


def track(of: str, t: Array, xy: Array) -> list[TimedPlaces]:
    """Return a path's positions at evenly spaced times; [] for fewer than two positions."""
    good = np.isfinite(xy).all(axis=1)
    t, xy = t[good], xy[good]
    if len(t) < 2:
        return []
    start, end = float(t[0]), float(t[-1])
    times = np.linspace(start, end, int(np.clip((end - start) / TRACK_STEP_S, 2, MAX_TRACK)))
    return [TimedPlaces(of, start, end, *interpolate(times, t, xy).T)]


# --- Trajectories over the line map

MARGIN_SHARE, MIN_MARGIN_M = 0.25, 3.0  # marks further from the path are not shown: share of its extent, and m
MAX_POINTS = 20_000  # of all paths together
WALLS = ("walls of the first scan", "walls seen later")


def trajectories(scene: Scene) -> Section:
    """Return the section with the map: walls, the true path, and a path per configuration.

    Walls of the first scan and walls that were added later are drawn differently.
    """
    mapped = max(scene.estimates, key=lambda e: (len(e.final_map), len(e.sensors)))
    marks: list[Mark] = []
    if mapped.final_map:
        first = {line.id for line in mapped.first_map}
        old = [line for line in mapped.final_map if line.id in first]
        new = [line for line in mapped.final_map if line.id not in first]
        marks += [Strokes(role, walls(lines)) for role, lines in zip(WALLS, (old, new), strict=True) if lines]
    paths = {e.name: timed_path(e, j) for e, j in scene.shown()}
    most = MAX_POINTS // (len(paths) + 1)
    marks += [_curve(name, xy, most) for name, (_, xy) in paths.items()]
    truth = scene.drive.truth
    if truth is not None:
        paths["truth"] = truth.t, truth.xy
        marks.append(_curve("truth", truth.xy, most))
    marks += landmarks(scene)
    main = paths["truth"] if truth is not None else paths.get(scene.best.name, paths[list(paths)[-1]])
    x_range, y_range = framed(main[1], marks)
    marks += spots(*main)
    every = f"every {step(main[0]):.0f} seconds"
    names = ", ".join(e.name for e, _ in scene.shown())
    panel = Panel(
        name="trajectories",
        title="Trajectories over the line map" if mapped.final_map else "Trajectories",
        y_label="y, m",
        x_label="x, m",
        marks=tuple(marks),
        summary=f"Paths of {names}{' and the truth' if truth else ''}, seen from above"
        + (f", and the walls of the map that {mapped.name} ended with." if mapped.final_map else "."),
        equal=True,
        keys=tuple(m.of for m in marks if isinstance(m, Strokes | Spots)),
        legend={"time": every},
        x_range=x_range,
        y_range=y_range,
        tracks=tuple(found for name, (t, xy) in paths.items() for found in track(name, t, xy)),
    )
    text = f"Walls are where “{mapped.name}” knew them at the end." if mapped.final_map else ""
    return Section("trajectories", "Trajectories", text, (panel,), columns=1)


def framed(path: Array, marks: Sequence[Mark]) -> list[tuple[float, float] | None]:
    """Return limits (low, high) [m] of x and y that show 99 % of `path` (n, 2) and the marks near it.

    Single walls far away and diverged estimates are cut off. None for a path without positions.
    """
    good = path[np.isfinite(path).all(axis=1)]
    if len(good) == 0:
        return [None, None]
    least, most = np.quantile(good, (0.005, 0.995), axis=0)
    margin = max(MARGIN_SHARE * float((most - least).max()), MIN_MARGIN_M)
    found: list[tuple[float, float] | None] = []
    for axis, (low, high) in enumerate(zip(least - margin, most + margin, strict=True)):
        shown = np.concatenate([v for m in marks for v in values_of(m, axis)])
        inside = shown[(shown >= low) & (shown <= high)]
        found.append((float(inside.min()), float(inside.max())) if len(inside) else None)
    return found


def _curve(name: str, xy: Array, most: int) -> Curve:
    return Curve(name, *xy[evenly(len(xy), most)].T)


# --- Paths coloured by their error, or without truth by the filter's sigma

COLOURED_STRETCHES = 240  # pieces of a path, each in one colour
MAX_POINTS_ON_SMALL_MAP = 1500  # points of a path on a small map
REFUSAL_CELL = 0.025  # cell size as a share of the map's extent: rejected readings in one cell share a cross
TINY_M = 1e-6  # m: smaller values count as 0
LIMITS = 10.0 ** np.arange(-6, 7)[:, None] * np.array([1.0, 2.0, 5.0])  # m, the possible limits between colours


class Route(NamedTuple):
    """A path with the values for its colours."""

    name: str
    t: Array  # (n,)
    xy: Array  # (n, 2)
    value: Array  # (n,) m
    refused: Array  # (k,) s, times of rejected readings


def where(scene: Scene) -> Section:
    """Return the section with a map per configuration, its path coloured by its error."""
    routes = []
    for e, judged in scene.shown():
        refused = [e.t[audit.instant[audit.verdict == RowVerdict.GATE]] for audit in e.audits.values()]
        times = np.unique(np.concatenate([np.zeros(0), *refused]))
        if scene.has_truth:
            t, xy, value = judged.t, judged.estimate_xy, np.hypot(*judged.deviation.T)
        else:
            t, xy = timed_path(e, judged)
            value = np.sqrt(np.maximum(e.triangles[:, 0] + e.triangles[:, 3], 0.0))
        if np.isfinite(value).any():
            routes.append(Route(e.name, t, xy, value, times))
    if not routes:
        return Section("where", "", "", ())
    what = "position error" if scene.has_truth else "claimed sigma of the position"
    edges = _edges(routes)
    legend = dict(zip((f"level {i}" for i in range(len(LEVELS))), _words(edges), strict=False))
    legend["time"] = f"every {step(routes[0].t):.0f} seconds"
    panels = tuple(_panel(scene, route, edges, what, legend) for route in routes)
    crosses = any(len(r.refused) for r in routes)
    text = (
        f"Each path in the colours of its {what}."
        f"{f' Crosses: a reading of “{scene.best.name}” was rejected.' if crosses else ''}"
    )
    return Section("where", f"Where: {what} along the path", text, panels, columns=3)


def _edges(routes: Sequence[Route]) -> Array:
    """Return at most four increasing limits between the colours [m]: 1, 2 or 5 times a power of ten.

    The limits are near the quantiles of the values of all paths, so that every colour occurs. Each path has the
    same weight.
    """
    shares = np.arange(1, len(LEVELS)) / len(LEVELS)
    values = [r.value[r.value > TINY_M] for r in routes]
    own = [np.quantile(v, np.linspace(0.0, 1.0, 101)) for v in values if len(v)]
    limits = np.quantile(np.concatenate(own), shares) if own else np.full(1, TINY_M)
    nearest = np.abs(np.log(limits[:, None]) - np.log(LIMITS.ravel())).argmin(axis=1)
    edges: Array = LIMITS.ravel()[np.unique(nearest)]
    return edges


def _words(edges: Array) -> list[str]:
    scale, unit = (1000.0, "mm") if edges[-1] < 1.0 else (1.0, "m")
    legend = [f"{scale * e:g}" for e in edges]
    middle = [f"{a} to {b} {unit}" for a, b in pairwise(legend)]
    return [f"below {legend[0]} {unit}", *middle, f"above {legend[-1]} {unit}"]


def _panel(scene: Scene, route: Route, edges: Array, what: str, legend: dict[str, str]) -> Panel:
    marks: list[Mark] = list(_coloured(route, edges))
    crosses = interpolate(route.refused, route.t, route.xy)
    crosses = crosses[np.isfinite(crosses).all(axis=1)]
    if len(crosses):  # at most one in each cell of the map
        cell = max(float(np.nanmax(np.ptp(route.xy, axis=0))), TINY_M) * REFUSAL_CELL
        _, first = np.unique(np.floor(crosses / cell), axis=0, return_index=True)
        marks.append(Spots("gate", *crosses[np.sort(first)].T))
    marks += landmarks(scene)
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
        legend=legend,
    )


def _coloured(route: Route, edges: Array) -> list[Curve]:
    """Return the path as one curve per colour; the rms value of each piece determines its colour."""
    ends = evenly(len(route.t), COLOURED_STRETCHES + 1)
    pieces: dict[int, list[Array]] = {}
    for first, last in pairwise(ends):
        stretch = route.value[first : last + 1]
        if np.isfinite(stretch).any():
            level = int(np.searchsorted(edges, np.sqrt(np.nanmean(stretch**2)), side="right"))
            kept = first + evenly(last + 1 - first, MAX_POINTS_ON_SMALL_MAP // COLOURED_STRETCHES)
            found, points = pieces.setdefault(level, []), route.xy[kept]
            if found and (found[-1][-1] == points[0]).all():
                found.append(points[1:])
            else:  # a row of NaN breaks the curve
                found += [np.full((1, 2), np.nan), points] if found else [points]
    paths = {level: np.concatenate(found) for level, found in sorted(pieces.items())}
    return [Curve(f"level {level}", xy[:, 0], xy[:, 1], wide=True) for level, xy in paths.items()]
