"""The log doctor: what the sensors of a drive say of each other, before any filter believes them.

Nothing here needs a pose. Turning is compared over windows, motion between scans with the wheels', the truth with
both; every complaint names the setting that cures it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from locfuse.fusion.data import Array, Drive, Measurements, Stream
from locfuse.fusion.robot import Robot
from locfuse.fusion.streams import gap_limit
from locfuse.fusion.wheels.repairs import times

from .clocks import of_clocks
from .compass import of_convention, tilted
from .finding import Oddity
from .laser import laser_motion, of_laser
from .truth import metre, of_truth
from .turning import Turning, aligned, of_track, of_turning, turnings

FEWEST = 10  # readings from which a sensor is judged
BLIND = 0.9  # share of readings without any measurement: such a sensor is dead, or misunderstood
SEES = {"lrf": "line", "sonar": "echo"}
REFUSED = {
    "repeat": "repeat the one before",
    "same_stamp": "share the stamp of another",
    "not_finite": "hold NaN or Inf",
    "outside_wheels": "before the first or after the last of the wheels",
    "too_many_beams": "with more beams than can be true",
}
TOLD = {"spike", "other_joints"}


def examine(drive: Drive, robot: Robot, streams: Mapping[str, Stream]) -> list[Oddity]:
    """Return everything odd about a measured drive; `streams` are the raw readings by role."""
    found = [*_notes(drive), *_refused(drive)]
    found += _gaps("wheels", drive.wheels.t)
    found += [o for name, m in drive.measurements.items() for o in (*_gaps(name, m.t), *_blind(name, m))]
    seen = turnings(drive)
    turning = of_turning(drive, robot, seen, streams)
    wrong_wheels = any(o.stream == "wheels" and o.spoils for o in turning)
    tilts = tilted(drive, robot, streams, by_wheels=not wrong_wheels)
    found += [*of_convention(drive, robot, streams), *tilts]
    found += [o for o in turning if o.stream not in {t.stream for t in tilts}]
    if wrong_wheels:
        return found  # nothing can be held against such wheels
    scales = _scales(drive, robot, seen, turning)
    truth = of_truth(drive, robot, not any(o.code == "wheel scale" for o in scales))
    return [*found, *scales, *of_clocks(drive, robot), *truth]


def _scales(drive: Drive, robot: Robot, seen: Mapping[str, Turning], turning: Sequence[Oddity]) -> list[Oddity]:
    """Return what is odd about metres and the track; each cure is told in the metre that the others will leave."""
    motion, lrf = None, drive.measurements.get("lrf")
    if lrf is not None and len(lrf.t) > 20 and not any(o.stream == "lrf" for o in turning):
        motion = laser_motion(lrf, aligned(lrf, seen.get("lrf")), drive, robot)
    factor, scaled = metre(drive, robot)
    track = of_track(robot.wheels, seen, motion, factor) if robot.wheels.radius is not None else []
    if track:
        scaled = [replace(o, cures=o.cures[:1]) for o in scaled]
    return [*scaled, *track, *of_laser(motion, robot, factor)]


def _notes(drive: Drive) -> list[Oddity]:
    """What was repaired while reading the wheels; the clock lags among the notes are judged anew below."""
    own = (note.removeprefix("wheels: ") for note in drive.notes if note.startswith("wheels: "))
    return [Oddity("repaired", "wheels", note) for note in own]


def _refused(drive: Drive) -> list[Oddity]:
    """Readings that are not used, by reason; what a repair counted is told with the repair."""
    found = []
    for stream, reasons in drive.dropped.items():
        words = [f"{n} {REFUSED.get(why, why.replace('_', ' '))}" for why, n in reasons.items() if why not in TOLD]
        if words:
            found.append(Oddity("refused", stream, f"readings that are not used: {', '.join(words)}"))
    return found


def _gaps(name: str, t: Array) -> list[Oddity]:
    """Silences are listed: without a sensor the filter keeps predicting, without wheels all motion is one arc."""
    found = gaps(t)
    if not found:
        return []
    longest = max(end - start for start, end in found)
    where = ", ".join(f"{start:.1f}-{end:.1f} s" for start, end in found[:3])
    more = " ..." if len(found) > 3 else ""
    return [Oddity("gap", name, f"silent {times(len(found))}, at most {longest:.1f} s ({where}{more})")]


def gaps(t: Array) -> list[tuple[float, float]]:
    """Return the silences (start, end) [s] in times (n,)."""
    dt = np.diff(t)
    if len(dt) < 2:
        return []
    long = np.flatnonzero(dt > gap_limit(t))
    return [(float(t[i]), float(t[i + 1])) for i in long]


def _blind(name: str, m: Measurements) -> list[Oddity]:
    n = len(m.t)
    if n >= FEWEST and m.absent > BLIND * n:
        words = (
            f"no {SEES.get(name, 'value')} in {m.absent} of {n} readings: it is dead, or its settings do not fit"
        )
        return [Oddity("blind", name, words, spoils=name == "lrf")]
    return [] if n else [Oddity("blind", name, "no reading within the wheels' time", spoils=True)]
