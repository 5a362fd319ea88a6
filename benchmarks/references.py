"""Do verdicts by a reference agree with those by truth? Logs that have a truth, judged with it and without it.

    LOCFUSE_DATA=... python -m benchmarks.references
    python -m benchmarks.references --log rounded_triangle

Each log is compared twice: by its truth, and with the truth hidden, so that only a reference and prediction judge.
The sample logs are also compared under wrong settings, where a sensor harms. Printed are both verdicts of every
sensor, and the error of its own configuration by truth and by reference (*: which has the sensor in it). A sensor
helps or hurts, or neither: verdicts agree where they say the same of that, and contradict where one says helps and
the other hurts.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any, NamedTuple

import locfuse
from benchmarks import experiment
from benchmarks.experiment import Row
from benchmarks.real_logs import FILES, KNOWN, are_there, folder

HIDDEN = {"truth.topic": "none"}
SAMPLES = ("rounded_rectangle", "rounded_triangle", "disturbed")
WRONG: dict[str, dict[str, Any]] = {
    "compass 5° off, called exact": {"compass.offset_deg": -60, "compass.sigma_deg": 1},
    "compass 40° off, called exact": {"compass.offset_deg": -25, "compass.sigma_deg": 1},
    "laser turned by 4°, called exact": {"lrf.yaw_deg": 4, "lrf.sigma_yaw_deg": 0},
    "camera mirrored": {"camera.clockwise": True},
    "wheels 5 % too large": {"wheels.radius": 0.0525},
}
GRADES = {"helps": 1, "seems to help": 1, "hurts": -1, "seems to hurt": -1, "no effect seen": 0}


class Case(NamedTuple):
    """A log with truth under some settings."""

    name: str
    log: str
    sets: dict[str, Any]


def cases() -> Iterator[Case]:
    """Yield the sample logs, as they are and with wrong settings, and real logs with a truth if they are there."""
    for log in SAMPLES:
        yield Case(log, log, {})
    for log in SAMPLES[:2]:
        for name, sets in WRONG.items():
            yield Case(f"{log}, {name}", log, sets)
    if are_there():
        brenner, known = str(folder() / FILES["brenner"]), KNOWN["brenner"]
        for track in (0.155, 0.173):
            yield Case(f"brenner, track {track}", brenner, {**known, "wheels.track": track})
        right = {"wheels.track": 0.173, "lrf.time_offset": -0.45, "lrf.range_scale": 1.126}
        yield Case("brenner, clock and scale right", brenner, {**known, **right})


def work(name: str) -> Row:
    """Return every sensor's verdicts and errors with the truth and without it."""
    case = next(case for case in cases() if case.name == name)
    by_truth, hidden = (
        locfuse.load(case.log, sets={**case.sets, **more}).compare(advice=False, audits=False, smooth=False).report
        for more in ({}, HIDDEN)
    )
    return {"sensors": [judged(sensor, by_truth, hidden) for sensor in by_truth["verdicts"]]}


def judged(sensor: str, by_truth: dict[str, Any], hidden: dict[str, Any]) -> Row:
    """Return one sensor, judged both ways; `error` [m] is that of the sensor alone, by truth and by reference."""
    name = next(n for n, v in hidden["configurations"].items() if list(v["sensors"]) == [sensor])
    alone = hidden["configurations"][name]
    return {
        "sensor": sensor,
        "by_truth": by_truth["verdicts"][sensor]["verdict"],
        "by_reference": hidden["verdicts"].get(sensor, {"verdict": "no verdict"})["verdict"],
        "error": [one["configurations"][name]["position_rmse_m"] for one in (by_truth, hidden)],
        "independent": not (alone["reference"] or {"shared": [sensor]})["shared"],  # no part of the reference
    }


def outcome(row: Row) -> str:
    """Return whether both verdicts agree."""
    truth, other = GRADES.get(row["by_truth"]), GRADES.get(row["by_reference"])
    if other is None:
        return "no verdict without truth"
    if truth is None:
        return "no verdict by truth"
    return "agree" if truth == other else "contradict" if truth * other < 0 else "one sees no effect"


def table(rows: list[Row]) -> Iterator[str]:
    """Yield both verdicts of every sensor, and how often they agree."""
    found = [{"log": row["task"][0], **sensor} for row in rows for sensor in row["sensors"]]
    lines = []
    for row in found:
        truth, reference = ("-" if e is None else f"{e:.3f} m" for e in row["error"])
        star = "" if row["independent"] else " *"
        verdicts = (row["log"], row["sensor"], row["by_truth"], row["by_reference"])
        lines.append((*verdicts, truth, f"{reference}{star}"))
    head = ("log", "sensor", "by truth", "without truth", "alone, by truth", "by reference")
    yield from experiment.table(head, lines, "45")
    counts = Counter(outcome(row) for row in found)
    yield f"\n{len(found)} sensors: " + ", ".join(f"{what} {n}" for what, n in counts.most_common()) + "."
    ratios = [b / a for row in found if row["independent"] for a, b in [row["error"]] if a and b]
    near = sum(0.9 <= ratio <= 1.1 for ratio in ratios)
    yield f"Judged by a reference without it: {len(ratios)} errors, {near} of them within 10 % of the truth's."


main = experiment.command(work, table, [case.name for case in cases()], drives=0)

if __name__ == "__main__":
    main()
