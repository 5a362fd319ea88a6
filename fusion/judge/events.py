"""Events of a drive over time.

These are standstill, lost robot, pose jumps, loop closures, and consecutive rejected readings.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from locfuse.fusion.data import (
    JUMP,
    LOOP,
    LOOP_TAKEN,
    LOST,
    REFUSED,
    RELOCALISED,
    REST,
    SLIP,
    Array,
    Audit,
    Drive,
    Estimates,
    Event,
    Jump,
    Measurements,
    RowVerdict,
    consecutive,
    stretches,
)

MIN_REST_S = 2.0
REST_STEP_M, REST_STEP_RAD = 1e-4, 1e-4  # motion in one interval of the wheels; less is standstill
SAME_LOOP_S = 5.0  # loop closures in closer succession are reported as one event
MIN_REFUSED = 5  # consecutive rejected readings; fewer are single outliers
JUMPS = {SLIP: "wheel slip undone", RELOCALISED: "lost robot found", LOOP_TAKEN: "loop closed"}
USED_VERDICTS = (RowVerdict.ACCEPTED, RowVerdict.NEW, RowVerdict.REPEATED)


def events_of_drive(drive: Drive) -> list[Event]:
    """Return the intervals of at least MIN_REST_S without wheel motion, as events."""
    u = drive.motions.u
    if len(u) != len(drive.t):
        return []  # a drive read from the files of a result has no motions
    still = (np.hypot(u[:, 0], u[:, 1]) < REST_STEP_M) & (np.abs(u[:, 2]) < REST_STEP_RAD)
    still[0] = False  # no interval ends at the first update time
    rests = [(float(drive.t[first - 1]), float(drive.t[last])) for first, last in stretches(still)]
    return [Event(a, b, REST, f"at rest for {b - a:.1f} s") for a, b in rests if b - a >= MIN_REST_S]


def events_of_run(drive: Drive, e: Estimates) -> list[Event]:
    """Return the events of a run (lost, jumps, loop closures, rejections) in order of time.

    `drive` has the readings to which the audits refer (thinned as in the run); `e` is the run, with its audits.
    """
    found = [Event(a, b, LOST, f"lost for {b - a:.1f} s", e.name) for a, b in e.lost]
    found += _loops(e)
    found += [Event(jump.t, jump.t, JUMP, _step(jump), e.name) for jump in e.jumps]
    for sensor, audit in e.audits.items():
        found += _refusals(sensor, drive.measurements[sensor], drive.t[drive.instant[sensor]], audit, e.name)
    return sorted(found)


def _loops(e: Estimates) -> Iterator[Event]:
    """Yield loop closures as events; loop closures in close succession are one event."""
    if not len(e.loops):
        return
    then, now = e.loops.T
    for some in consecutive(np.cumsum(np.diff(now, prepend=now[0]) > SAME_LOOP_S)):
        a, b = float(then[some].min()), float(then[some].max())
        place = f"the place of {a:.0f} s" if b - a < 1.0 else f"places of {a:.0f} to {b:.0f} s"
        yield Event(float(now[some[0]]), float(now[some[-1]]), LOOP, f"{place} recognised", e.name)


def _step(jump: Jump) -> str:
    """Return the kind and the size of a pose jump as text."""
    x, y, turn = jump.step
    return f"{JUMPS[jump.kind]}: moved {math.hypot(x, y):.2f} m, turned {math.degrees(turn):+.1f}°"


def _refusals(sensor: str, m: Measurements, t: Array, audit: Audit, name: str) -> Iterator[Event]:
    """Yield the intervals with at least MIN_REFUSED consecutive rejected readings of a sensor, as events."""
    n = len(m.t)
    owner = np.searchsorted(m.first, audit.row, side="right") - 1
    taken = np.bincount(owner[np.isin(audit.verdict, USED_VERDICTS)], minlength=n) > 0
    seen = np.flatnonzero(np.bincount(owner, minlength=n) > 0)  # readings without measurements are skipped
    for first, last in stretches(~taken[seen]):
        if last - first + 1 < MIN_REFUSED:
            continue
        start, end = float(t[seen[first]]), float(t[seen[last]])
        words = f"{sensor}: {last - first + 1} readings in a row refused, for {end - start:.1f} s"
        yield Event(start, end, REFUSED, words, name)
