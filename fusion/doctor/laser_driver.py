"""What a laser's driver does: how it says that nothing came back, which way it scans, and when."""

from __future__ import annotations

from typing import Any, cast

import numpy as np

from locfuse.fusion.data import Array, Ragged, Stream
from locfuse.fusion.sensors.lrf import Lrf, LrfSettings

from .finding import Finding

SAMPLE_SCANS = 300  # looked at
RANGE_MAX_SHARE = 0.01  # of the ranges at exactly range_max: more are no walls
SEVERE_RANGE_MAX_SHARE = 0.05  # share from which they would be taken for walls


def driver(stream: Stream, settings: LrfSettings) -> list[Finding]:
    """Return what is unusual about the first scans of a stream."""
    parts = [columns for _, columns in _first(stream)]
    if not parts:
        return []
    column = {k: np.concatenate([np.asarray(p[k]) for p in parts]) for k in parts[0] if k != "ranges"}
    ranges = [cast("Ragged", p["ranges"]) for p in parts]
    lengths = np.concatenate([r.lengths for r in ranges])
    values = np.concatenate([r.values[r.first[0] : r.first[-1]] for r in ranges]).astype(np.float64)
    far = np.repeat(column["range_max"].astype(np.float64), lengths)
    return [*_nothing(values, far, settings), *_turning(column, lengths)]


def _first(stream: Stream) -> list[tuple[Any, dict[str, Any]]]:
    found: list[tuple[Any, dict[str, Any]]] = []
    fields = (*Lrf.reads[stream.msgtype],)
    for rows, columns in stream.blocks(*fields, rows=SAMPLE_SCANS):
        found.append((rows, columns))
        if sum(len(r) for r, _ in found) >= SAMPLE_SCANS:
            break
    return found


def _nothing(values: Array, far: Array, settings: LrfSettings) -> list[Finding]:
    """How many ranges are no walls, by how they say so."""
    n = max(1, len(values))
    shares = {
        "inf": np.isinf(values).mean() if len(values) else 0.0,
        "NaN": np.isnan(values).mean() if len(values) else 0.0,
        "zero": (values == 0.0).mean() if len(values) else 0.0,
        "beyond range_max": ((values > far) & np.isfinite(values)).mean() if len(values) else 0.0,
    }
    words = ", ".join(f"{share:.0%} {how}" for how, share in shares.items() if share >= 0.005)
    found = [Finding("lrf", "no return", f"of its ranges {words}: nothing came back there")] if words else []
    limit = np.minimum(far, settings.range_max or np.inf)
    full = (values == far) & (values <= limit)
    share = float(full.sum()) / n
    if share > RANGE_MAX_SHARE:
        end = float(far[full][0])
        words = f"{share:.0%} of its ranges are exactly range_max = {end:g} m: its driver's word for no return"
        found.append(
            Finding(
                "lrf", "range_max", words, (f"lrf.range_max={0.999 * end:.4g}",), share > SEVERE_RANGE_MAX_SHARE
            )
        )
    return found


def _turning(column: dict[str, Array], lengths: Array) -> list[Finding]:
    found = []
    if (column["angle_increment"] < 0.0).any():
        found.append(Finding("lrf", "clockwise", "its angles decrease: it scans clockwise, and is read so"))
    if len(np.unique(lengths)) > 1:
        words = f"its scans have {int(lengths.min())} to {int(lengths.max())} beams; each is read with its own"
        found.append(Finding("lrf", "beams", words))
    if not (column["time_increment"] > 0.0).any():
        words = "time_increment is 0: what it sees while the robot turns is taken for the sight of one instant"
        found.append(Finding("lrf", "not deskewed", words))
    return found
