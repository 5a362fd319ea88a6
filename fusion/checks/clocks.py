"""Checks of the clocks: does each sensor's clock agree with the wheels', or with another sensor's?

Turning is compared for sensors, speed for the truth, at every lag. Wheels slip: over a lap of the paper's robot
they tell a lag to 7 ms at best (docs/trust.md). Two sensors see the same turning, slips and all: so a clock that
the wheels contradict is held against those that they do not.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial

import numpy as np
from msgspec.structs import replace

from locfuse.fusion.data import Array, Drive, Estimates, Measurements, Truth
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.truth import body_poses
from locfuse.fusion.wheels.motion import Wheels

from .finding import Finding
from .lag import MIN_LAG_S, Lag, Reference, by_wheels, find_lag, worth_saying

WINDOW_S = 1.0  # s over which ways are compared
MAX_LAG_S, LAG_STEP_S = 1.5, 0.02  # s
MIN_TRUTH_LAG_S, MAX_MISFIT_RATIO, MIN_CORRELATION = 0.06, 0.75, 0.9
SEVERE_LAG_S = 0.1  # s: at half a metre per second and a radian per second this is centimetres and degrees
MAX_STAMPED_RATIO = 0.85  # of the misfits as stamped and shifted: nearer to 1 they say nothing of the clock
SAME_LAG_S = 0.05  # s: lags that differ by less are one


def of_clocks(drive: Drive, robot: Robot) -> list[Finding]:
    """Return the streams whose clock is off, with the offset that they need; where all are, it is the wheels'."""
    lags = clock_lags(drive.measurements, drive.wheels)
    late = {name: lag for name, lag in lags.items() if worth_saying(lag)}
    truth = truth_lag(drive)
    if truth is not None:
        lags["truth"] = truth
        late |= {"truth": truth} if off_by(truth) else {}
    offsets = [lag.offset for lag in late.values()]
    if len(late) > 1 and len(late) == len(lags) and np.ptp(offsets) < SAME_LAG_S:
        return [_wheels(float(np.mean(offsets)), list(late), robot)]
    if truth is not None and list(late) == ["truth"] and (witnesses := _on_truths_clock(drive, robot, truth)):
        return [_wheels(truth.offset, ["truth", *witnesses], robot)]
    if list(late) == list(lags) == ["truth"]:
        return [_either(late["truth"], robot)]
    return [_stream(name, lag, robot) for name, lag in late.items()]


def _on_truths_clock(drive: Drive, robot: Robot, lag: Lag) -> list[str]:
    """Return the sensors whose readings fit the truth as it is stamped clearly better than shifted to the wheels.

    They know places, not turning: landmarks. A robot that follows its commands late looks like a late truth.
    """
    truth = drive.truth
    if truth is None or truth.theta is None:
        return []
    found = []
    for name, every in drive.measurements.items():
        inside = (every.t > truth.t[0] + MAX_LAG_S) & (every.t < truth.t[-1] - MAX_LAG_S)
        m = every.take(np.flatnonzero(inside))
        spreads = [
            REGISTRY[name].misfit(m, robot.settings(name), body_poses(truth, m.t - shift))
            for shift in (0.0, lag.offset)
        ]
        stamped, shifted = spreads
        if stamped is not None and shifted is not None and stamped < MAX_STAMPED_RATIO * shifted:
            found.append(name)
    return found


def _stream(name: str, lag: Lag, robot: Robot) -> Finding:
    settings = robot.truth if name == "truth" else robot.settings(name)
    offset = settings.time_offset + lag.offset
    fix = f"{name}.time_offset={offset:z.2f}"
    return Finding(name, "lag", in_words(lag), (fix,), abs(lag.offset) > SEVERE_LAG_S)


def _either(lag: Lag, robot: Robot) -> Finding:
    """Return the finding of two clocks that differ where no third one says which of them is off."""
    found = _stream("truth", lag, robot)
    same = f"wheels.time_offset={robot.wheels.time_offset - lag.offset:z.2f}"
    return replace(found, message=f"{found.message}; no third clock says which of the two is off: {same} is equal")


def _wheels(offset: float, names: list[str], robot: Robot) -> Finding:
    late = "late" if offset < 0 else "early"
    words = (
        f"{' and '.join(names)} look equally {late} against them, {abs(offset):.2f} s: the wheels' clock is off"
    )
    fix = f"wheels.time_offset={robot.wheels.time_offset - offset:z.2f}"
    return Finding("wheels", "lag", words, (fix,), abs(offset) > SEVERE_LAG_S)


def lags_by_truth(drive: Drive, truth: Truth | None) -> dict[str, Lag]:
    """Return how far each sensor's clock is from the truth's, by the truth's headings: these never slip.

    In place of the truth there may be a run that knows its heading better than the wheels do.
    """
    reference = _by_headings(drive, truth)
    if reference is None:
        return {}
    turned = {
        name: heading for name, m in drive.measurements.items() if (heading := _heading(name, m)) is not None
    }
    found = {name: find_lag(*heading, reference) for name, heading in turned.items()}
    return {name: lag._replace(against="truth") for name, lag in found.items() if lag is not None}


def lag_of_run(drive: Drive, truth: Truth | None, run: Estimates) -> Lag | None:
    """Return how far the clock of a run's only sensor is from the truth's, by the headings of the run.

    The run of a laser turns by the clock of its scans, since its map holds the heading at each of them, and with
    less noise than turns from scan to scan have: the lag's sigma is about half as large. A sensor that the wheels
    outweigh would show a part of its lag only.
    """
    reference, (sensor,) = _by_headings(drive, truth), run.sensors
    if reference is None or len(drive.instant[sensor]) < MIN_READINGS:
        return None
    at = np.unique(drive.instant[sensor])[:MAX_READINGS]
    found = find_lag(run.t[at], run.pose[at, 2], reference)
    return None if found is None else found._replace(against="truth")


def _by_headings(drive: Drive, truth: Truth | None) -> Reference | None:
    """Return the truth's headings as what is held against; None where it has none."""
    if truth is None or truth.theta is None or len(truth.t) < MIN_READINGS:
        return None
    span = (float(truth.t[0]), float(truth.t[-1]))
    return Reference(partial(_between, truth.t, np.unwrap(truth.theta)), span, drive.wheels.heading, wanders=False)


def off_by(lag: Lag) -> bool:
    """Return whether the truth's lag is large and clear enough to be said."""
    clearly = 1.0 - lag.correlation <= MAX_MISFIT_RATIO * (1.0 - lag.without)
    return abs(lag.offset) >= MIN_TRUTH_LAG_S and lag.correlation >= MIN_CORRELATION and clearly


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
    inside = (truth.t > wheels.t[0] + MAX_LAG_S) & (truth.t < wheels.t[-1] - MAX_LAG_S - WINDOW_S)
    start = truth.t[inside & (truth.t + WINDOW_S <= truth.t[-1])]
    if len(start) < 20:
        return None
    ends = [np.stack([np.interp(start + s, truth.t, c) for c in truth.xy.T], axis=-1) for s in (0.0, WINDOW_S)]
    own = np.hypot(*(ends[1] - ends[0]).T)
    if own.std() < 0.02 or own.std() < 0.1 * own.mean():
        return None
    lags = np.arange(-MAX_LAG_S, MAX_LAG_S + LAG_STEP_S / 2, LAG_STEP_S)
    scores = []
    for lag in lags.tolist():
        theirs = np.hypot(*wheels.relative(start + lag, start + lag + WINDOW_S)[:, :2].T)
        scores.append(float(np.corrcoef(own, theirs)[0, 1]) if theirs.std() > 0 else 0.0)
    best = int(np.argmax(scores))
    if scores[best] < MIN_CORRELATION or best in {0, len(lags) - 1}:
        return None
    return Lag(float(lags[best]), scores[best], scores[int(np.argmin(np.abs(lags)))])


MIN_READINGS = 20  # readings
MAX_READINGS = 3000  # enough to find a lag: five minutes of a 10 Hz laser


def clock_lags(measurements: Mapping[str, Measurements], wheels: Wheels) -> dict[str, Lag]:
    """Return how far each sensor's clock is from the wheels', from the first minutes of the drive."""
    turned = {name: heading for name, m in measurements.items() if (heading := _heading(name, m)) is not None}
    found = {name: find_lag(*heading, by_wheels(wheels)) for name, heading in turned.items()}
    lags = {name: lag for name, lag in found.items() if lag is not None}
    right = {name: turned[name] for name, lag in lags.items() if abs(lag.offset) < MIN_LAG_S}
    return {
        name: _sharper(lag, turned[name], right, wheels) if worth_saying(lag) else lag
        for name, lag in lags.items()
    }


def _heading(name: str, m: Measurements) -> tuple[Array, Array] | None:
    """Return times (n,) [s] and headings (n,) [rad] of a sensor that knows its own turning."""
    if len(m.t) < MIN_READINGS:
        return None
    heading = REGISTRY[name].heading(m.take(np.arange(min(len(m.t), MAX_READINGS))))
    if heading is None:
        return None
    t, angle = heading
    known = np.isfinite(angle)
    return (t[known], angle[known]) if known.sum() >= MIN_READINGS else None


def _sharper(lag: Lag, own: tuple[Array, Array], right: Mapping[str, tuple[Array, Array]], wheels: Wheels) -> Lag:
    """Return the lag against whose turning agrees best: the wheels', or that of a sensor."""
    lags = [lag]
    for name, (t, heading) in right.items():
        span = (float(t[0]), float(t[-1]))
        found = find_lag(*own, Reference(partial(_between, t, heading), span, wheels.heading))
        if found is not None:
            lags.append(found._replace(against=name))
    return max(lags, key=lambda lag: lag.correlation)


def _between(t: Array, heading: Array, at: Array) -> Array:
    return np.interp(at, t, heading)


def in_words(lag: Lag) -> str:
    """Return "stamps look 0.12 s late (1 sigma: 0.005 s) against the wheels (correlation ...)"."""
    sigma = f" (1 sigma: {lag.sigma:.3f} s)" if math.isfinite(lag.sigma) else ""
    whose = "the wheels" if lag.against == "wheels" else f"the {lag.against}, which agrees with the wheels"
    return (
        f"stamps look {abs(lag.offset):.2f} s {'late' if lag.offset < 0 else 'early'}{sigma} against {whose} "
        f"(correlation {lag.without:.3f} as stamped, {lag.correlation:.3f} shifted)"
    )
