"""Agreement of the verdicts on sensors by a reference with those by truth, for logs with a truth.

    LOCFUSE_DATA=... python -m benchmarks.references
    python -m benchmarks.references --log rounded_triangle

Each log is compared twice: by its truth, and without the truth, by a reference and by predictions. The sample logs
are also compared under wrong settings, with which a sensor makes the estimate worse. The table has both verdicts
of every sensor ("helps", "hurts", or neither), and the error of its own configuration by truth and by reference
(*: a reference that uses the sensor). Verdicts agree if they are equal, and contradict if one is "helps" and the
other one "hurts".
"""

from collections import Counter
from collections.abc import Iterator
from typing import Any

import locfuse
from benchmarks import experiment
from benchmarks.experiment import Row
from benchmarks.real_logs import FILES, KNOWN, are_there, folder

SAMPLES = ("rounded_rectangle", "rounded_triangle", "disturbed")
WRONG: dict[str, dict[str, Any]] = {
    "compass 5° off, called exact": {"compass.offset_deg": -60, "compass.sigma_deg": 1},
    "compass 40° off, called exact": {"compass.offset_deg": -25, "compass.sigma_deg": 1},
    "laser turned by 4°, called exact": {"lrf.yaw_deg": 4, "lrf.sigma_yaw_deg": 0},
    "camera mirrored": {"camera.clockwise": True},
    "wheels 5 % too large": {"wheels.radius": 0.0525},
}
BRENNER: dict[str, dict[str, Any]] = {
    "brenner, track 0.155": {"wheels.track": 0.155},
    "brenner, track 0.173": {"wheels.track": 0.173},
    "brenner, clock and scale right": {"wheels.track": 0.173, "lrf.time_offset": -0.45, "lrf.range_scale": 1.126},
}
CASES: dict[str, dict[str, Any]] = {  # "log" or "log, what is wrong" -> settings
    **{log: {} for log in SAMPLES},
    **{f"{log}, {name}": sets for log in SAMPLES[:2] for name, sets in WRONG.items()},
    **({name: {**KNOWN["brenner"], **sets} for name, sets in BRENNER.items()} if are_there() else {}),
}
GRADES = {"helps": 1, "seems to help": 1, "hurts": -1, "seems to hurt": -1, "no effect seen": 0}


def work(name: str) -> Row:
    log = name.partition(", ")[0]
    path = log if log in SAMPLES else folder() / FILES[log]
    by_truth, hidden = (
        locfuse.load(path, sets={**CASES[name], **more}).compare(advice=False, audits=False, smooth=False).report
        for more in ({}, {"truth.topic": "none"})
    )
    return {"sensors": [judged(sensor, by_truth, hidden) for sensor in by_truth["verdicts"]]}


def judged(sensor: str, by_truth: dict[str, Any], hidden: dict[str, Any]) -> Row:
    """Return one sensor's verdicts by truth and by reference, and both errors [m] of this sensor alone."""
    name = next(n for n, v in hidden["configurations"].items() if list(v["sensors"]) == [sensor])
    shared = (hidden["configurations"][name]["reference"] or {"shared": [sensor]})["shared"]
    return {
        "sensor": sensor,
        "by_truth": by_truth["verdicts"][sensor]["verdict"],
        "by_reference": hidden["verdicts"].get(sensor, {"verdict": "no verdict"})["verdict"],
        "error": [one["configurations"][name]["position_rmse_m"] for one in (by_truth, hidden)],
        "independent": not shared,  # no part of the reference
    }


def outcome(row: Row) -> str:
    truth, other = GRADES.get(row["by_truth"]), GRADES.get(row["by_reference"])
    if truth is None or other is None:
        return "no verdict without truth" if other is None else "no verdict by truth"
    return "agree" if truth == other else "contradict" if truth * other < 0 else "one sees no effect"


def table(rows: list[Row]) -> Iterator[str]:
    found = [{"log": row["task"][0], **sensor} for row in rows for sensor in row["sensors"]]
    lines = []
    for row in found:
        truth, reference = ("-" if e is None else f"{e:.3f} m" for e in row["error"])
        verdicts = (row["log"], row["sensor"], row["by_truth"], row["by_reference"])
        lines.append((*verdicts, truth, reference if row["independent"] else f"{reference} *"))
    head = ("log", "sensor", "by truth", "without truth", "alone, by truth", "by reference")
    yield from experiment.table(head, lines, "45")
    counts = Counter(outcome(row) for row in found)
    yield f"\n{len(found)} sensors: " + ", ".join(f"{what} {n}" for what, n in counts.most_common()) + "."
    ratios = [b / a for row in found if row["independent"] for a, b in [row["error"]] if a and b]
    near = sum(0.9 <= ratio <= 1.1 for ratio in ratios)
    yield f"Judged by a reference without it: {len(ratios)} errors, {near} of them within 10 % of the truth's."


main = experiment.command(work, table, CASES, drives=0)

if __name__ == "__main__":
    main()
