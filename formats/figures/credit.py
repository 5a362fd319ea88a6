"""What each sensor does to the position error, as a picture: alone, beside the others, and on average."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from .panels import Curve, Mark, Panel, Section, Spots, Strokes
from .scene import Scene

EFFECTS = {"alone": 0.28, "leave_one_out": 0.55, "credit": 0.82}  # effect -> its place in a sensor's lane
WORDS = {
    "alone": "alone, against odometry",
    "leave_one_out": "last, beside all others",
    "credit": "credit: mean over every order",
    "bounds": "no effect",
}
LIMITS = (1e-3, 1e5)  # factors beyond are drawn at the edge


def credit(scene: Scene) -> Section:
    """Return every sensor's factors with their 95 % intervals on one logarithmic axis; empty without any."""
    sensors = dict((scene.credit or {}).get("sensors", {}))
    marks: list[Mark] = []
    for lane, (sensor, values) in enumerate(sensors.items()):
        for kind, place in EFFECTS.items():
            if values.get(kind):
                marks += _effect(sensor, kind, lane + place, values[kind])
    if not marks:
        return Section("credit", "", "", ())
    n = len(sensors)
    marks.insert(0, Curve("bounds", np.ones(2), np.array([0.0, float(n)])))
    values = [float(v) for m in marks for v in (m.ends[:, :, 0].ravel() if isinstance(m, Strokes) else m.x)]
    panel = Panel(
        name="credit",
        title="How many times smaller each sensor makes the position error",
        y_label="",
        x_label="position error smaller by this factor",
        marks=tuple(marks),
        summary="Each sensor's effect with its 95 % interval; right of 1 the error shrinks.",
        x_log=True,
        x_range=(min(values) / 1.15, max(values) * 1.15),
        y_range=(float(n), 0.0),
        lanes=tuple(sensors),
        keys=tuple(dict.fromkeys(m.of for m in marks if not isinstance(m, Strokes))),
        said=WORDS,
    )
    return Section("credit", "Credit", "", (panel,))


def _effect(sensor: str, kind: str, y: float, found: Mapping[str, Any]) -> list[Mark]:
    ends = [[float(np.clip(found[k], *LIMITS)), y] for k in ("low", "high") if found[k] is not None]
    interval = [Strokes(sensor, np.array([ends]))] if ends else []
    return [*interval, Spots(kind, np.clip([found["factor"]], *LIMITS), np.array([y]))]
