"""Detection of kidnapping: simulated drives in which the robot is moved to a random place.

    python -m benchmarks.kidnapping --drives 20
    python -m benchmarks.kidnapping --drives 20 --seconds 0.1

After 20 s the robot is carried to a random place, which takes `--seconds`. The columns: "marked", the time at
which the run first reports that it is lost; "worst", the largest position error while it does not report that;
"found", the runs that are relocalised at the end. A bare rectangle looks the same after a turn by 180 degrees:
without a compass, no run may be relocalised there.
"""

import math
from collections.abc import Iterator

import numpy as np

from benchmarks import experiment
from benchmarks.experiment import Row
from locfuse.fusion.data import Drive, LocfuseError
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.robot import Robot

AT = 20.0  # s
SETTLES = 0.15  # s, more than the time between two scans: before the next scan the filter cannot be lost
ROOMS = {"with plates": (), "bare rectangle": ("room.plates=[]",)}
SENSORS = {"lrf": ("lrf",), "compass+lrf": ("compass", "lrf")}


def work(room: str, seed: int, seconds: float) -> Row:
    """Return the results of one drive with kidnapping; nothing if the new place is in a wall."""
    rng = np.random.default_rng(seed)
    x, y, turn = rng.uniform(-2.5, -0.3), rng.uniform(0.2, 2.0), rng.uniform(-150.0, 150.0)
    fault = f'{{kind="kidnap", start={AT}, end={AT + seconds}, x={x:.3f}, y={y:.3f}, theta_deg={turn:.2f}}}'
    sets = ("camera.enabled=false", 'control.estimator="truth"', f"faults=[{fault}]", *ROOMS[room])
    try:
        drive, robot = experiment.simulated("rounded_rectangle", sets, seed).measured()
    except LocfuseError:
        return {"runs": {}}
    return {"runs": {name: judged(drive, robot, sensors) for name, sensors in SENSORS.items()}}


def judged(drive: Drive, robot: Robot, sensors: tuple[str, ...]) -> Row:
    """Return when the run is first lost [s after AT], and its largest errors [m] before AT and when not lost."""
    estimates = fuse(drive, robot, sensors)
    e = evaluate(estimates, drive)
    error = np.hypot(*e.deviation.T)
    known = ~np.any([(e.t >= a) & (e.t <= b) for a, b in (*estimates.lost, (AT, AT + SETTLES))], axis=0)
    marked = min((a - AT for a, _ in estimates.lost if a > AT - 1.0), default=math.nan)
    found = not estimates.lost or bool(estimates.lost[-1][1] < drive.t[-1] - 1e-6)
    errors = {"before": float(error[e.t < AT].max()), "worst": float(error[known].max())}
    return {"marked": marked, "found": found, **errors}


def table(rows: list[Row]) -> Iterator[str]:
    lines = []
    for room, mine in experiment.by_case(rows).items():
        for sensors in SENSORS:
            runs = [row["runs"][sensors] for row in mine if row["runs"]]
            late = f"{float(np.max([r['marked'] for r in runs])):+.1f} s"
            errors = (f"{1000.0 * max(r[key] for r in runs):.0f} mm" for key in ("before", "worst"))
            lines.append((room, sensors, len(runs), late, *errors, sum(r["found"] for r in runs)))
    head = ("room", "sensors", "drives", "marked at the latest", "worst before", "worst outside", "found again")
    yield from experiment.table(head, lines, "23456")


SECONDS = experiment.option("--seconds", default=2.0, help="How long the robot is in the air.")
main = experiment.command(work, table, ROOMS, options=[SECONDS])

if __name__ == "__main__":
    main()
