"""The circles in an omni picture: the mirror's rim, and the inner one, within which the robot sees itself.

Both stand still while the scene moves, so they are clear in the mean of some pictures. Along each ray from the
middle the brightness steps there; a circle through these steps is the algebraic fit of Kåsa (1976, IEEE
Transactions on Instrumentation and Measurement 25).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from locfuse.fusion.data import Array
from locfuse.fusion.sensors.camera import CameraSettings, detector

from .finding import Finding

if TYPE_CHECKING:
    from locfuse.fusion.camera.images import Picture

RIMS = "rims"  # code of the finding
RAYS = 240
MIN_PICTURES = 4
MIN_STEP_SHARE = 0.15  # of the picture's brightest grey level: a step in brightness that may be a rim
MIN_ON_CIRCLE_SHARE = 0.7  # of the rays: else what was found is no circle
MAX_REST_SHARE, MIN_REST_PX = 0.01, 1.0  # of the radius, px: a step further off does not lie on the circle
MAX_INNER_SHARE = 0.6  # of the rim's radius
MIN_ERROR_PX = 1.5  # px: a calibration that is nearer is left alone


class Circle(NamedTuple):
    """A circle in a picture, px."""

    x: float
    y: float
    radius: float


def of_rims(pictures: Sequence[Picture], settings: CameraSettings) -> list[Finding]:
    """Return where the mirror's circles lie, if the calibration says something else; [] where none are clear."""
    if len(pictures) < MIN_PICTURES:
        return []
    grey = np.mean([p.astype(np.float32).mean(axis=2) for p in pictures], axis=0)
    height, width = grey.shape
    rim = _circle(grey, Circle(0.5 * (width - 1), 0.5 * (height - 1), 0.5 * np.hypot(width, height)), inward=True)
    if rim is None:
        return []
    inner = _circle(grey, rim._replace(radius=MAX_INNER_SHARE * rim.radius), inward=False)
    now = detector(settings).optics((height, width))
    found = {"centre": f"[{rim.x:.1f}, {rim.y:.1f}]", "outer": f"{rim.radius:.0f}"}
    off = [np.hypot(rim.x - now.x_c, rim.y - now.y_c), abs(rim.radius - now.outer)]
    if inner is not None:
        found["inner"] = f"{inner.radius:.0f}"
        off.append(abs(inner.radius - now.inner))
    if max(off) < MIN_ERROR_PX:
        return []
    words = (
        f"the mirror's rim is a circle about ({rim.x:.1f}, {rim.y:.1f}) px of radius {rim.radius:.0f} px, "
        f"configured are ({now.x_c:.1f}, {now.y_c:.1f}) px and {now.outer:.0f} px"
    )
    return [Finding("camera", RIMS, words, tuple(f"camera.{key}={value}" for key, value in found.items()))]


def _circle(grey: Array, within: Circle, inward: bool) -> Circle | None:
    """Return the circle at the first step in brightness along rays of a disc: from its edge inward, or outward."""
    angle = np.arange(RAYS) * (2.0 * np.pi / RAYS)
    r = np.arange(2.0, within.radius)
    x, y = (c + np.outer(w, r) for c, w in ((within.x, np.cos(angle)), (within.y, np.sin(angle))))
    column, row = np.rint(x).astype(int), np.rint(y).astype(int)
    inside = (column >= 0) & (column < grey.shape[1]) & (row >= 0) & (row < grey.shape[0])
    seen = np.where(inside, grey[row.clip(0, grey.shape[0] - 1), column.clip(0, grey.shape[1] - 1)], np.nan)
    steps = np.abs(seen[:, 3:] - seen[:, :-3]) > MIN_STEP_SHARE * float(grey.max())
    steps = steps[:, ::-1] if inward else steps
    first = steps.argmax(axis=1)
    rays = np.flatnonzero(steps.any(axis=1))
    at = (steps.shape[1] - 1 - first if inward else first)[rays]
    # the steepest pixel of the step, not where it begins
    near = np.clip(at[:, None] + np.arange(-3, 4), 0, seen.shape[1] - 4)
    slope = np.nan_to_num(np.abs(seen[rays[:, None], near + 2] - seen[rays[:, None], near + 1]))
    best = near[np.arange(len(rays)), slope.argmax(axis=1)] + 1.5
    points = np.stack(
        (within.x + (2.0 + best) * np.cos(angle[rays]), within.y + (2.0 + best) * np.sin(angle[rays]))
    )
    keep = np.ones(len(rays), dtype=bool)
    for _ in range(5):
        if keep.sum() < MIN_ON_CIRCLE_SHARE * RAYS:
            return None
        px, py = points[:, keep]
        (a, b, c), *_ = np.linalg.lstsq(np.stack((px, py, np.ones_like(px)), axis=-1), px**2 + py**2, rcond=None)
        found = Circle(0.5 * float(a), 0.5 * float(b), float(np.sqrt(c + 0.25 * (a * a + b * b))))
        rest = np.abs(np.hypot(points[0] - found.x, points[1] - found.y) - found.radius)
        keep = rest < max(MIN_REST_PX, MAX_REST_SHARE * found.radius, 2.0 * float(np.median(rest)))
    return found if (rest < max(MIN_REST_PX, MAX_REST_SHARE * found.radius)).mean() > MIN_ON_CIRCLE_SHARE else None
