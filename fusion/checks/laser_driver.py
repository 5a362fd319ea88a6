"""Checks of a laser's raw ranges: values that mean no return, direction and time of the scan, and noise."""

from __future__ import annotations

import math
from typing import Any, cast

import numpy as np

from locfuse.fusion.data import Array, Ragged, Stream
from locfuse.fusion.lines.scans import MAX_BEAMS
from locfuse.fusion.sensors.lrf import Lrf, LrfSettings

from .finding import Finding

MIN_IN_TURN = 5  # scans that begin at another angle than most
SAMPLE_SCANS = 300  # looked at
MIN_TRIPLES = 1000  # of neighbouring ranges, by which noise is judged
MAX_SCATTER = 1.4  # times sigma_range: more is named
# shares of normal numbers, and how near to 0 they are in standard deviations; clutter and rounding lie elsewhere
NORMAL_SHARES, NORMAL_SIZES = (0.1, 0.25, 0.5), (0.1257, 0.3186, 0.6745)
MAX_NOISE_M = 0.1  # of a laser: more is leaves
MAX_UNLIKE = 1.2  # times the smallest of the sigmas that these say


def driver(stream: Stream) -> list[Finding]:
    """Return what is unusual about the first scans of a stream."""
    parts = [columns for _, columns in _first(stream)]
    if not parts:
        return []
    column = {k: np.concatenate([np.asarray(p[k]) for p in parts]) for k in parts[0] if k != "ranges"}
    ranges = [cast("Ragged", p["ranges"]) for p in parts]
    lengths = np.concatenate([r.lengths for r in ranges])
    values = np.concatenate([r.values[r.first[0] : r.first[-1]] for r in ranges]).astype(np.float64)
    far = np.repeat(column["range_max"].astype(np.float64), lengths)
    return [*_nothing(values, far), *_turning(column, lengths), *_in_turn(column)]


def of_scatter(stream: Stream, settings: LrfSettings) -> list[Finding]:
    """Return the noise that the ranges show, where it is more than the settings say.

    Nothing of the map, the pose or the line extraction comes in: a noise that is set too low splits the lines, and
    what is left of them fits well.
    """
    sigma = ranges_sigma(stream, settings)
    if sigma is None or not scatter_more(sigma, settings.sigma_range):
        return []
    words = (
        f"neighbouring ranges scatter by {sigma:.3f} m (1 sigma), and sigma_range is {settings.sigma_range:g} m"
    )
    return [Finding("lrf", "noise", words, (f"lrf.sigma_range={sigma:.2g}",))]


def scatter_more(shown: float | None, sigma: float) -> bool:
    """Return whether ranges with the noise `shown` [m] (`ranges_sigma`) surely scatter more than `sigma` [m]."""
    return shown is not None and MAX_SCATTER * sigma < shown < MAX_NOISE_M


def ranges_sigma(stream: Stream, settings: LrfSettings) -> float | None:
    """Return the noise of one range [m] by neighbouring ranges on walls; None if they do not show noise."""
    found = [scatter(columns) for _, columns in _first(stream)]
    each = np.abs(np.concatenate(found)) if found else np.empty(0)
    if len(each) < MIN_TRIPLES:
        return None
    sigmas = settings.range_scale * np.quantile(each, NORMAL_SHARES) / NORMAL_SIZES
    sigma = float(sigmas.min())
    return sigma if sigmas.max() <= MAX_UNLIKE * sigma else None


def scatter(columns: dict[str, Any]) -> Array:
    """Return the residuals of three neighbouring ranges on a wall, scaled to the noise of one range [m].

    Beams that are `a` apart meet a straight wall where 1 / r0 + 1 / r2 = 2 cos(a) / r1, however it lies. Corners
    and clutter leave much more than noise does.
    """
    ranges = cast("Ragged", columns["ranges"])
    lengths = ranges.lengths
    r = ranges.values[ranges.first[0] : ranges.first[-1]].astype(np.float64)
    scan = np.repeat(np.arange(len(lengths)), lengths)
    low, far, step = (
        np.asarray(columns[k], np.float64)[scan] for k in ("range_min", "range_max", "angle_increment")
    )
    seen = np.isfinite(r) & (r > 0.0) & (r >= low) & (r < far)
    at = np.flatnonzero(seen[:-2] & seen[1:-1] & seen[2:] & (scan[:-2] == scan[2:])) + 1
    before, here, after, cos = r[at - 1], r[at], r[at + 1], np.cos(step[at])
    total = before + after
    by = 2.0 * cos * np.square(np.stack((before, after)) / total)  # derivatives by `after` and `before`
    return np.asarray((here - 2.0 * cos * before * after / total) / np.sqrt(1.0 + np.square(by).sum(axis=0)))


def _first(stream: Stream) -> list[tuple[Any, dict[str, Any]]]:
    """Return rows and columns of the first scans but for those that have more beams than a laser has."""
    found: list[tuple[Any, dict[str, Any]]] = []
    fields, seen = (*Lrf.reads[stream.msgtype],), 0
    for rows, columns in stream.blocks(*fields, rows=SAMPLE_SCANS):
        ranges = cast("Ragged", columns["ranges"])
        use = np.flatnonzero(ranges.lengths <= MAX_BEAMS)
        if len(use) == len(rows):
            found.append((rows, columns))
        elif len(use):
            values = np.concatenate([ranges[i] for i in use.tolist()])
            first = np.append(0, np.cumsum(ranges.lengths[use]))
            numbers = {k: np.asarray(v)[use] for k, v in columns.items() if k != "ranges"}
            found.append((rows[use], {**numbers, "ranges": Ragged(values, first)}))
        seen += len(rows)
        if seen >= SAMPLE_SCANS:
            break
    return found


def _nothing(values: Array, far: Array) -> list[Finding]:
    """Count the ranges without a return, by the value that marks them."""
    shares = {
        "inf": np.isinf(values).mean() if len(values) else 0.0,
        "NaN": np.isnan(values).mean() if len(values) else 0.0,
        "zero": (values == 0.0).mean() if len(values) else 0.0,
        "beyond range_max": ((values > far) & np.isfinite(values)).mean() if len(values) else 0.0,
    }
    words = ", ".join(f"{share:.0%} {how}" for how, share in shares.items() if share >= 0.005)
    return [Finding("lrf", "no return", f"of its ranges {words}: nothing came back there")] if words else []


def _in_turn(column: dict[str, Array]) -> list[Finding]:
    """Report that scans begin at two angles in turn: two lasers, or one that sends a revolution in parts."""
    angles, which, counts = np.unique(column["angle_min"].round(3), return_inverse=True, return_counts=True)
    if len(angles) < 2:
        return []
    a, b = np.argsort(-counts)[:2].tolist()
    changes = int((np.diff(which[np.isin(which, (a, b))]) != 0).sum())
    if counts[b] < MIN_IN_TURN or changes < counts[b]:
        return []
    parts = " and ".join(f"{counts[k]} scans at {math.degrees(angles[k]):.0f}°" for k in (a, b))
    words = (
        f"angle_min changes in turn ({parts}): two publishers on one topic? Record each laser on a topic of its "
        "own. If one laser sends each turn in parts, nothing is wrong"
    )
    return [Finding("lrf", "scan angles", words)]


def _turning(column: dict[str, Array], lengths: Array) -> list[Finding]:
    found = []
    if (column["angle_increment"] < 0.0).any():
        found.append(Finding("lrf", "clockwise", "its angles decrease: it scans clockwise, and is read so"))
    if len(np.unique(lengths)) > 1:
        words = f"its scans have {int(lengths.min())} to {int(lengths.max())} beams; each is read with its own"
        found.append(Finding("lrf", "beams", words))
    if not (column["time_increment"] > 0.0).any():
        words = "time_increment is 0: points are not corrected for the motion during a scan"
        found.append(Finding("lrf", "not deskewed", words))
    return found
