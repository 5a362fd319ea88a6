"""The paper's filter as printed compared with locfuse's over many drives, and the effect of each misprint.

    python -m benchmarks.printed --drives 20

Both filters process the same measurements of the same simulated drives, and are evaluated in the same way. A row
called `repaired` is the printed filter with some corrected equations.
"""

import math
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks import experiment
from benchmarks.accuracy import figures
from benchmarks.experiment import Row
from locfuse.fusion.data import Array, Measurements
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.paper import equations, filter as paper_rows
from locfuse.fusion.paper.filter import fuse_as_printed
from locfuse.fusion.robot import Robot
from locfuse.fusion.se2 import sight, wrap
from locfuse.fusion.sensors.camera import MIN_DISTANCE_M

PRINTED_W = equations.eq8_W
SETS: tuple[tuple[str, ...], ...] = ((), ("compass",), ("lrf",), ("camera",), ("compass", "lrf", "camera"))


def right_W(ds: Array, dtheta: Array, theta: Array, L: float) -> Array:
    """Equation 8 with the terms that are missing in print (docs/paper.md)."""
    m = theta + dtheta / 2
    half = 0.5 * np.stack((np.cos(m), np.sin(m), np.zeros_like(m)), axis=-1)
    printed: Array = PRINTED_W(ds, dtheta, theta, L)
    return printed + half[..., None]


def right_H(C: float, beta: float) -> Array:
    s = math.copysign(1.0, C)
    return np.array([[-s * math.cos(beta), -s * math.sin(beta), 0.0], [0.0, 0.0, -1.0]])


class BearingRow(paper_rows.CameraRow):
    """The camera's bearing against the one predicted from the pose, instead of a heading."""

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot)
        settings = robot.settings("camera")
        self.landmark, self.lever = settings.landmark, (settings.x, settings.y)

    def rows(self, m: Measurements, i: int, x: Array, P: Array) -> list[paper_rows.MeasurementRow]:
        """Compare the bearing of the largest candidate of picture i."""
        row = int(m.first[i])
        pose, mount = (float(x[0]), float(x[1]), float(x[2])), (*self.lever, self.yaw)
        predicted = sight(pose, self.landmark, mount, MIN_DISTANCE_M)
        if row == int(m.first[i + 1]) or predicted is None:
            return []
        y = wrap(float(m.z[row, 0]) - predicted[0])
        return [paper_rows.innovation(row, 0, np.array([y]), np.array([predicted[2]]), self.R, P)]


REPAIRS: dict[str, Any] = {  # what replaces an equation while the printed filter runs
    "(8)": lambda: patch.object(equations, "eq8_W", right_W),
    "(13)": lambda: patch.object(equations, "eq13_H_line", right_H),
    "camera": lambda: patch.dict(paper_rows.PARTS, {"camera": BearingRow}),
}
ROWS = {
    "as printed": (),
    **{f"{name} repaired": (name,) for name in REPAIRS},
    "all three repaired": tuple(REPAIRS),
}


def work(seed: int) -> Row:
    """Simulate one drive and judge both filters on it: filter -> configuration -> figures."""
    measured, robot = experiment.simulated("rounded_rectangle", (), seed).measured(("camera.chain=paper",))
    found: dict[str, dict[str, Any]] = {}
    for name in (*ROWS, "default"):
        filter_of = fuse if name == "default" else fuse_as_printed
        with ExitStack() as stack:
            for repair in ROWS.get(name, ()):
                stack.enter_context(REPAIRS[repair]())
            judged = [evaluate(filter_of(measured, robot, sensors), measured) for sensors in SETS]
        found[name] = {e.name: figures(e) for e in judged}
    return {"found": found}


def table(rows: list[Row]) -> Iterator[str]:
    """Yield mean position rmse [mm] and median ANEES of the printed filter, its repairs, and the product's."""
    lines = []
    for name in (*ROWS, "default"):
        cells = []
        for configuration in rows[0]["found"]["default"]:
            found = [row["found"][name][configuration] for row in rows]
            anees = float(np.median([r["anees"] for r in found]))
            words = f"{float(f'{anees:.2g}'):g}" if anees < 1000 else "> 1000"
            cells.append(f"{1000 * float(np.mean([r['position_rmse_m'] for r in found])):.1f} mm ({words})")
        lines.append((name, *cells))
    yield from experiment.table(("filter", *rows[0]["found"]["default"]), lines, "12345")


main = experiment.command(work, table)

if __name__ == "__main__":
    main()
