"""Make docs/images/observability.svg: python -m benchmarks.observability

It shows the claimed sigma of one wall's direction in the map during a lap with a laser alone, for two filters. One
has the pose of a local frame in the map as states. In the other one (the usual EKF-SLAM, and version 0.1), pose
and lines are relative to the map itself.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np

from benchmarks.consistency import MOVING, SCENARIO
from benchmarks.experiment import simulated
from locfuse.fusion.data import Array, Drive, Measurements
from locfuse.fusion.fuse import Due, Filter, due_readings, steps_of

PICTURE = Path(__file__).parents[1] / "docs" / "images" / "observability.svg"


class WithoutFrame(Filter):
    """Filter without a local frame: pose and lines are relative to the map."""

    def _begin_frame(self, due: Sequence[Due], measurements: Mapping[str, Measurements]) -> None:
        return


def directions(run: Filter, drive: Drive) -> Array:
    """Return times [s] and sigmas [deg] of the first wall's direction in the map, (n, 2)."""
    model, rows, steps = run.models["lrf"], [], steps_of(drive)
    for k, due in enumerate(due_readings(drive, ["lrf"])):
        run.advance(k, steps, due, drive.measurements)
        if due:
            wall = next(line for line in model.results(run.belief).final_map if line.id == 0)
            rows.append((drive.t[k], math.degrees(math.sqrt(wall.P_map[1, 1]))))
    return np.array(rows)


def main() -> None:
    """Draw both filters."""
    mpl.use("svg")
    mpl.rcParams.update({"svg.hashsalt": "locfuse", "font.size": 9, "svg.fonttype": "none"})
    from matplotlib import pyplot as plt

    drive, robot = simulated(SCENARIO, MOVING, 1000).measured()
    figure, axes = plt.subplots(figsize=(6.0, 2.4), layout="constrained")
    for kind, words in ((Filter, "map frame as states"), (WithoutFrame, "without (version 0.1)")):
        t, sigma = directions(kind(robot, ["lrf"]), drive).T
        axes.plot(t, sigma, label=f"{words}: {sigma[0]:.2f}° to {sigma[-1]:.2f}°", linewidth=1.2)
    axes.set(xlabel="time [s]", ylabel="sigma of a wall's direction [°]", ylim=(0.0, None))
    axes.legend(frameon=False)
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(PICTURE, metadata={"Date": None})


if __name__ == "__main__":
    main()
