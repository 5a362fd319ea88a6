"""Does the verdict find the useless and the harmful sensor? Many simulated drives, all subsets, one word each.

    python -m benchmarks.verdicts --drives 20

`noise`: a compass whose noise is 180 degrees, and configured so. `bias`: a compass that is constantly 5 degrees
off, configured to be absolute and good to 1 degree. `plain`: the scenario as shipped.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from benchmarks import experiment
from benchmarks.experiment import Row
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.credit import credit, subsets
from locfuse.fusion.judge.evaluate import evaluate

# the compass' offset is minus the direction of north: 65 degrees counter-clockwise from the map's x axis
PERFECT = ("compass.hard_iron=[0, 0]", "compass.soft_iron=[1, 1, 0]", "room.north_deg=65")
CASES = {  # settings of the scenario, and those of the robot
    "plain": ((), ()),
    "noise": (("compass.noise_deg=180",), ("compass.sigma_deg=180", "compass.field_tolerance=1e9")),
    "bias": (PERFECT, ("compass.offset_deg=-60", "compass.sigma_deg=1")),
}


def work(name: str, seed: int, camera: bool) -> Row:
    """Simulate one drive, run every subset, and return each sensor's verdict."""
    scenario, sets = CASES[name]
    off = () if camera else ("camera.enabled=false",)
    drive, robot = experiment.simulated("rounded_rectangle", (*scenario, *off), seed).measured(sets)
    sensors = list(drive.measurements)
    judged = {frozenset(s): evaluate(fuse(drive, robot, s), drive) for s in subsets(sensors)}
    found = credit(judged, sensors)
    return {"verdicts": {s: c.verdict for s, c in found.sensors.items()} if found else {}}


def table(rows: list[Row]) -> Iterator[str]:
    """Yield how often each sensor got which verdict."""
    counts: dict[tuple[str, str], Counter[str]] = {}
    for row in rows:
        for sensor, verdict in row["verdicts"].items():
            counts.setdefault((row["task"][0], sensor), Counter())[verdict] += 1
    for (name, sensor), found in sorted(counts.items(), key=lambda item: list(CASES).index(item[0][0])):
        yield f"{name:6} {sensor:8} " + ", ".join(f"{n} {v}" for v, n in found.most_common())


CAMERA = experiment.option("--camera/--no-camera", default=False, help="Rendering takes most of the time.")
main = experiment.command(work, table, CASES, options=[CAMERA])

if __name__ == "__main__":
    main()
