"""Do all clocks agree with the wheels'? Turning is compared for sensors, speed for the truth, at every lag."""

from __future__ import annotations

import numpy as np

from .clocks import clock_lags, in_words, side
from .data import Drive, Truth
from .lag import Lag, by_wheels, find_lag, worth_saying
from .oddity import Oddity
from .robot import Robot

WINDOW = 1.0  # s over which ways are compared
LONGEST, STEP = 1.5, 0.02  # s
WORTH, BETTER, AGREES = 0.06, 0.75, 0.9
LARGE = 0.1  # s: at half a metre per second and a radian per second this is centimetres and degrees
ALIKE = 0.05  # s: lags that differ by less are one


def of_clocks(drive: Drive, robot: Robot) -> list[Oddity]:
    """Return the streams whose clock is off, with the offset that they need; where all are, it is the wheels'."""
    lags = clock_lags(drive.measurements, drive.wheels)
    late = {name: lag for name, lag in lags.items() if worth_saying(lag)}
    truth = truth_lag(drive)
    if truth is not None:
        lags["truth"] = truth
        late |= {"truth": truth} if off_by(truth) else {}
    offsets = [lag.offset for lag in late.values()]
    if len(late) > 1 and len(late) == len(lags) and np.ptp(offsets) < ALIKE:
        return [_wheels(float(np.mean(offsets)), list(late), robot)]
    return [_stream(name, lag, robot) for name, lag in late.items()]


def _stream(name: str, lag: Lag, robot: Robot) -> Oddity:
    told = robot.truth if name == "truth" else robot.settings(name)
    offset = told.time_offset + lag.offset
    cure = f"{name}.time_offset={offset:.2f}"
    return Oddity("lag", name, f"its motion {in_words(lag)}", (cure,), abs(lag.offset) > LARGE)


def _wheels(offset: float, names: list[str], robot: Robot) -> Oddity:
    words = f"{' and '.join(names)} run {abs(offset):.2f} s {side(offset)} them alike: the wheels' clock is off"
    cure = f"wheels.time_offset={robot.wheels.time_offset - offset:.2f}"
    return Oddity("lag", "wheels", words, (cure,), abs(offset) > LARGE)


def off_by(lag: Lag) -> bool:
    """Return whether the truth's lag is large and clear enough to be said."""
    clearly = 1.0 - lag.correlation <= BETTER * (1.0 - lag.without)
    return abs(lag.offset) >= WORTH and lag.correlation >= AGREES and clearly


def truth_lag(drive: Drive) -> Lag | None:
    """Return the lag of the truth by its headings, else by its speed; None where neither tells."""
    truth, wheels = drive.truth, drive.wheels
    if truth is None or len(truth.t) < 5:
        return None
    turning = None
    if truth.theta is not None:
        turning = find_lag(truth.t, np.unwrap(truth.theta), by_wheels(wheels))
    return turning or way_lag(truth, drive)


def way_lag(truth: Truth, drive: Drive) -> Lag | None:
    """Return the lag at which the truth's speed follows the wheels' best; None where speed hardly changes."""
    wheels = drive.wheels
    inside = (truth.t > wheels.t[0] + LONGEST) & (truth.t < wheels.t[-1] - LONGEST - WINDOW)
    start = truth.t[inside & (truth.t + WINDOW <= truth.t[-1])]
    if len(start) < 20:
        return None
    ends = [np.stack([np.interp(start + s, truth.t, c) for c in truth.xy.T], axis=-1) for s in (0.0, WINDOW)]
    own = np.hypot(*(ends[1] - ends[0]).T)
    if own.std() < 0.02 or own.std() < 0.1 * own.mean():
        return None
    lags = np.arange(-LONGEST, LONGEST + STEP / 2, STEP)
    scores = []
    for lag in lags.tolist():
        theirs = np.hypot(*wheels.relative(start + lag, start + lag + WINDOW)[:, :2].T)
        scores.append(float(np.corrcoef(own, theirs)[0, 1]) if theirs.std() > 0 else 0.0)
    best = int(np.argmax(scores))
    if scores[best] < AGREES or best in {0, len(lags) - 1}:
        return None
    return Lag(float(lags[best]), scores[best], scores[int(np.argmin(np.abs(lags)))])
