"""Measuring a log: streams of sensor readings become a Drive. No pose of the robot is used here.

Wheels are read first, since scans are deskewed with the wheel motion. Then every sensor of the log is measured
once, for all configurations. Then the wheel motion between the update times is computed, which all configurations
share.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import msgspec
import numpy as np
from msgspec.structs import replace

from locfuse.fusion.lines.scans import frozen
from locfuse.fusion.sensors.registry import REGISTRY, unmet
from locfuse.fusion.wheels.motion import STANDS_M, STANDS_RAD, Wheels
from locfuse.fusion.wheels.read import WheelReading, read_wheels
from locfuse.fusion.wheels.repairs import gaps_of

from . import se2
from .data import END_OF_TIME, Array, Drive, LocfuseError, Measurements, Stream, Truth
from .robot import Robot, StartSettings
from .sensor import FoundStart
from .streams import count_dropped, gap_limit, outside, recorded_apart
from .truth import body_poses, heading_notes, read_truth

MOVED_S, DROPPED_SHARE = 1e-6, 0.01  # jittered drives: largest shift of a time [s], share of readings left out
MAX_SENSOR_GAP_S = 0.2  # s: in longer gaps without sensor readings, wheel readings are update times


def measure(
    streams: Mapping[str, Stream],
    robot: Robot,
    absent: Mapping[str, str] | None = None,
    progress: Callable[[str], None] = lambda role: None,
    known: Mapping[str, Measurements] | None = None,
    motion: WheelReading | None = None,
    before: Mapping[str, Measurements] | None = None,
) -> Drive:
    """Return the drive of a log; `streams` has "wheels", sensors by name, and optionally "truth".

    `known` are measurements with the same settings of sensor and wheels, `before` measurements with other
    settings. `motion` is the wheel motion, if already read. Raises LocfuseError if the wheels give no motion.
    """
    if motion is None:
        progress("measuring the wheels")
    wheels, epoch_ns, dropped, notes, _ = motion or read_wheels(streams["wheels"], robot.wheels)
    if abs(epoch_ns) >= END_OF_TIME:
        raise LocfuseError(
            f"the drive would begin at {epoch_ns * 1e-9:.3g} s, and stamps end at {END_OF_TIME * 1e-9:.3g} s",
            role="wheels",
            hint="(is wheels.time_offset right? It is in seconds)",
        )
    drops = {"wheels": dropped}
    measurements: dict[str, Measurements] = {}
    missing, before = dict(absent or {}), before or {}
    fixes: dict[str, tuple[str, ...]] = {}
    for name, sensor in REGISTRY.items():
        if known and name in known and name in streams:
            measurements[name] = known[name]
            drops[name] = dict(known[name].dropped)
        elif name in streams:
            progress(f"measuring {name}")
            try:
                again = sensor.again(before[name], robot.settings(name), epoch_ns) if name in before else None
                found = again or sensor.measure(streams[name], robot.settings(name), wheels, epoch_ns)
                t = found.t[np.isfinite(found.t)]
                if len(t) and not ((t >= wheels.t[0]) & (t <= wheels.t[-1])).any():
                    recorded = recorded_apart(streams[name], streams["wheels"])
                    raise outside(t, wheels.t, name, float(robot.settings(name).time_offset), recorded)
            except LocfuseError as e:
                # the other sensors can still be compared
                missing[name] = e.sentence if e.role == name else str(e)
                fixes[name] = e.fixes
                continue
            measurements[name] = _within(found, wheels)
            drops[name] = dict(measurements[name].dropped)
    for name, why in unmet(measurements).items():
        del measurements[name]
        missing[name] = why
    truth = None
    if "truth" in streams:
        truth, drops["truth"] = read_truth(streams["truth"], robot.truth, epoch_ns)
        truth = _thawed(truth, wheels, drops["truth"])
    of_truth = () if truth is None else heading_notes(truth, streams["truth"].msgtype)
    repairs = (*notes, *_gap_notes(wheels))
    of_sensors = (f"{name}: {note}" for name, m in measurements.items() for note in m.notes)
    return Drive(
        epoch_ns=epoch_ns,
        measurements=measurements,
        absent=missing,
        truth=truth,
        dropped=drops,
        wheels=wheels,
        notes=(*(f"wheels: {note}" for note in repairs), *of_sensors, *(f"truth: {note}" for note in of_truth)),
        repairs=repairs,
        fixes=fixes,
        **cut(wheels, robot, measurements, truth),
    )


def begun(robot: Robot, drive: Drive) -> tuple[Robot, Drive]:
    """Return the robot with the start pose that a sensor with a known map found, and the drive with a note on it.

    If several sensors find a pose, the one with the smallest position sigma is used. If the user configured
    [start], or no sensor finds a pose, the robot stays unchanged. A sensor with an ambiguous start is left out,
    since its map would be in another frame.
    """
    found, measurements, absent = dict[str, FoundStart](), dict(drive.measurements), dict(drive.absent)
    for name, m in drive.measurements.items() if not robot.start_given else ():
        try:
            start = REGISTRY[name].start(m, robot.settings(name), drive.wheels)
        except LocfuseError as e:
            del measurements[name]
            absent[name] = e.sentence
            continue
        found |= {name: start} if start is not None else {}
    drive = replace(drive, measurements=measurements, absent=absent)
    if not found:
        return robot, drive
    name, best = min(found.items(), key=lambda item: item[1].sigma_xy)
    x, y, theta = pose = best.pose.tolist()
    words = (
        f"{name}: the drive begins at x {x:.2f} m, y {y:.2f} m, {math.degrees(theta):.0f} deg "
        f"(1 sigma: {best.sigma_xy:.2f} m, {math.degrees(best.sigma_theta):.0f} deg): found by its map"
    )
    robot = robot.begun_at(pose, best.sigma_xy, best.sigma_theta)
    return robot, replace(drive, notes=(*drive.notes, words))


def led_back(robot: Robot, drive: Drive, first_scan: float | None) -> tuple[Robot, Drive]:
    """Return the robot with its pose at the first wheel reading, if [start] is at a later time; and the drive.

    The wheels give the motion in between, and its noise is added to the sigmas of [start]. `first_scan` [s] is the
    time of the laser's first scan; None if there is none. Raises LocfuseError for a time outside the drive.
    """
    start, end = robot.start, float(drive.t[-1])
    at = start.at
    if at == "scan":
        if first_scan is None:
            raise LocfuseError(
                'start.at = "scan": no scan lies within the drive', role="start", hint="give the moment in seconds"
            )
        at = first_scan
    if at > end:
        raise LocfuseError(f"start.at = {at:g}: the drive ends at {end:.1f} s", role="start")
    if not at:
        return robot, drive
    moved = drive.wheels.between(np.zeros(1), np.array([at]))
    back, J = se2.inverse(moved.u[0]), se2.between_jacobians(moved.u[0], np.zeros(3))[0]
    P = J @ moved.Q[0] @ J.T
    x, y, theta = se2.compose(np.array(start.pose), back).tolist()
    of_heading = start.variances[2]
    place = start.sigma_xy**2 + 0.5 * (P[0, 0] + P[1, 1] + float(back[:2] @ back[:2]) * of_heading)
    begun = replace(robot, start=replace(start, at=at))
    found = begun.begun_at((x, y, theta), math.sqrt(place), math.sqrt(of_heading + P[2, 2]))
    words = f"start: the pose is that at {at:.1f} s; the wheels lead back from it by {np.hypot(*back[:2]):.2f} m"
    return found, replace(drive, notes=(*drive.notes, words))


def cut(
    wheels: Wheels, robot: Robot, measurements: Mapping[str, Measurements], truth: Truth | None
) -> dict[str, Any]:
    """Return the fields of a drive that depend on its update times: wheel motions and indices of update times.

    `motions` lead to each update time from the one before, `truth_motions` to each truth stamp from the last
    update time before it. `instant` and `truth_instant` are the indices of these update times for readings and
    truth stamps.
    """
    t, estimate = instants(wheels.t, [m.t for m in measurements.values()]), robot.wheels.estimate
    truth_motions = truth_instant = None
    if truth is not None:
        inside = (truth.t >= t[0]) & (truth.t <= t[-1])
        truth_instant = np.where(inside, np.searchsorted(t, truth.t, side="right") - 1, -1)
        start = t[np.maximum(truth_instant, 0)]
        # several stamps may have the same update time before them
        truth_motions = wheels.between(start, np.where(inside, truth.t, start), estimate)
    return {
        "t": t,
        "motions": wheels.between(np.concatenate((t[:1], t[:-1])), t, estimate),
        "instant": {name: np.searchsorted(t, m.t) for name, m in measurements.items()},
        "truth_motions": truth_motions,
        "truth_instant": truth_instant,
    }


def _gap_notes(wheels: Wheels) -> list[str]:
    """Return notes on gaps in the wheel data, one for each kind of gap."""
    unknown, long = wheels.gap_uncertainty[:, 1] > 0.0, np.diff(wheels.t) > gap_limit(wheels.t)
    distance, turn = np.hypot(*wheels.twist[:, :2].T), np.abs(wheels.twist[:, 2])
    moved = ((distance > STANDS_M) | (turn > STANDS_RAD)) & ~unknown
    notes = []
    for kind in (unknown, long & moved, long & ~moved & ~unknown):
        if not (rows := np.flatnonzero(kind)).size:
            continue
        longest = rows[np.argmax(np.diff(wheels.t)[rows])]
        begin, end = wheels.t[longest], wheels.t[longest + 1]
        gaps = f"{gaps_of(len(rows), end - begin)} ({begin:.1f}-{end:.1f} s)"
        if unknown[longest]:
            notes.append(f"{gaps}: the path in between is unknown, so the covariance grows there")
        elif moved[longest]:
            moves = f"{distance[longest]:.2f} m and {math.degrees(turn[longest]):.0f}°"
            notes.append(f"{gaps}: the robot moved {moves} there, which is taken for one arc")
        else:
            notes.append(f"{gaps}: the robot stood there")
    return notes


def instants(wheel_t: Array, sensor_t: list[Array]) -> Array:
    """Return the update times: all measurement stamps, and both ends of the drive.

    In long gaps without sensor readings, some wheel readings are added.
    """
    t = np.unique(np.concatenate([*sensor_t, wheel_t[[0, -1]]]))
    cells = np.floor(wheel_t / MAX_SENSOR_GAP_S)
    empty = ~np.isin(cells, np.floor(t / MAX_SENSOR_GAP_S))
    first_in_cell = np.diff(cells, prepend=-1) > 0
    return np.union1d(t, wheel_t[empty & first_in_cell])


def _within(m: Measurements, wheels: Wheels) -> Measurements:
    """Return the readings between the first and the last wheel reading, in order; count the others as dropped.

    Copies are dropped too: they have the stamp and the values of the reading before, since the message was sent or
    recorded twice.
    """
    inside = np.isfinite(m.t) & (m.t >= wheels.t[0]) & (m.t <= wheels.t[-1])
    if inside.all() and (np.diff(m.t) > 0.0).all():
        return m
    keep = np.flatnonzero(inside)
    keep = keep[np.argsort(m.t[keep], kind="stable")]
    at_once = np.flatnonzero(np.diff(m.t[keep]) == 0.0) + 1
    copies = at_once[[_are_equal(m, *keep[[i - 1, i]].tolist()) for i in at_once]]
    dropped = dict(m.dropped)
    count_dropped(dropped, outside_wheels=~inside, repeat=len(copies))
    return replace(m.take(np.delete(keep, copies)), dropped=dropped)


def _are_equal(m: Measurements, one: int, other: int) -> bool:
    """Return whether two readings, given by their indices, have the same values."""
    a, b = (slice(m.first[i], m.first[i + 1]) for i in (one, other))
    return all(np.array_equal(column[a], column[b]) for column in (m.z, *m.extra.values()))


def _thawed(truth: Truth, wheels: Wheels, dropped: dict[str, int]) -> Truth:
    """Return the truth without copies of a pose from before the robot moved on; count them in `dropped`.

    A tracker that loses its marker sends its last pose again and again.
    """
    poses = truth.xy if truth.theta is None else np.column_stack((truth.xy, truth.theta))
    gone = frozen(np.append(False, (np.diff(poses, axis=0) == 0.0).all(axis=1)), truth.t, wheels)
    if not gone.any():
        return truth
    count_dropped(dropped, repeat=gone)
    theta = None if truth.theta is None else truth.theta[~gone]
    return replace(truth, t=truth.t[~gone], xy=truth.xy[~gone], theta=theta)


def windowed(drive: Drive, robot: Robot, begin: float | None, end: float | None) -> tuple[Drive, Robot]:
    """Return the drive between two times [s], and the robot with a start pose at the first time.

    Times stay those of the whole drive. The start pose is the truth's if it has headings, else [start] moved on by
    the wheels. Raises LocfuseError for an interval without wheel readings.
    """
    last = float(drive.t[-1])
    a, b = 0.0 if begin is None else begin, last if end is None else end
    wheels: Wheels = drive.wheels.window(a, b)
    if len(wheels.t) < 2:
        raise LocfuseError(
            f"--from {a:g} --to {b:g}: the drive lasts from 0 to {last:.1f} s, and nothing moves there"
        )
    within = {
        name: m.take(np.flatnonzero((m.t >= wheels.t[0]) & (m.t <= wheels.t[-1])))
        for name, m in drive.measurements.items()
    }
    truth = drive.truth
    if truth is not None:
        rows = np.flatnonzero((truth.t >= wheels.t[0]) & (truth.t <= wheels.t[-1]))
        theta = None if truth.theta is None else truth.theta[rows]
        truth = replace(truth, t=truth.t[rows], xy=truth.xy[rows], theta=theta) if len(rows) else None
    start, words = _start_at(float(wheels.t[0]), drive, robot)
    note = f"only {wheels.t[0]:.1f} to {wheels.t[-1]:.1f} s of the drive are used{words}"
    parts = {"wheels": wheels, "measurements": within, "truth": truth, "notes": (*drive.notes, note)}
    return replace(drive, **parts, **cut(wheels, robot, within, truth)), replace(robot, start=start)


def _start_at(t: float, drive: Drive, robot: Robot) -> tuple[StartSettings, str]:
    """Return the start settings with the pose at time t [s], and a text that names the source of this pose."""
    if t <= float(drive.t[0]):
        return robot.start, ""
    truth, start = drive.truth, robot.start
    if truth is not None and truth.theta is not None and truth.t[0] <= t <= truth.t[-1]:
        (pose,) = body_poses(truth, np.array([t]))
        words = "; it starts there at the truth's pose"
    else:
        pose = se2.compose(np.array(start.pose), drive.wheels.at(np.array(t))[2])
        words = "; it starts there where the wheels alone lead from [start]: --align origin judges the shape"
    x, y, theta = (float(v) for v in pose)
    return msgspec.structs.replace(start, x=x, y=y, theta_deg=float(np.degrees(theta))), words


def thinned(drive: Drive, rates: Mapping[str, float]) -> Drive:
    """Return the drive with at most `rates[sensor]` readings per second: the first reading of every period.

    The update times stay unchanged, so that all configurations have the same ones.
    """
    measurements, instant = dict(drive.measurements), dict(drive.instant)
    for sensor, rate in rates.items():
        m = measurements[sensor]
        keep = np.flatnonzero(np.diff(np.floor(m.t * rate), prepend=-1.0) > 0)
        measurements[sensor], instant[sensor] = m.take(keep), instant[sensor][keep]
    return replace(drive, measurements=measurements, instant=instant)


def jittered(drive: Drive, robot: Robot, seed: int) -> Drive:
    """Return the drive with stamps moved by up to 1 microsecond, and 1 % of the readings left out at random.

    The result depends only on `seed`. Small changes move readings across thresholds (gates, association, map
    building), so differences between the results of such drives are chance. Wheels and truth are unchanged.
    """
    first, last = float(drive.wheels.t[0]), float(drive.wheels.t[-1])
    found = {
        name: _jittered(m, first, last, np.random.default_rng([seed, k]))
        for k, (name, m) in enumerate(drive.measurements.items())
    }
    return replace(drive, measurements=found, **cut(drive.wheels, robot, found, drive.truth))


def _jittered(m: Measurements, first: float, last: float, rng: np.random.Generator) -> Measurements:
    """Return randomly selected readings, with randomly moved stamps between `first` and `last` [s], sorted."""
    n = len(m.t)
    t: Array = np.clip(m.t + MOVED_S * rng.uniform(-1.0, 1.0, n), first, last)
    stays = np.flatnonzero(rng.random(n) >= DROPPED_SHARE)
    stays = stays[np.argsort(t[stays], kind="stable")]
    return replace(m.take(stays), t=t[stays])
