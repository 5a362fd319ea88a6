"""Turning checks: wheels compared with sensors that measure turns; mirrored, swapped or dead wheels, track.

Over windows of a second, a sensor's turn is a R + b L, with the distances L, R of the left and right wheel. If the
robot is configured correctly, a = 1/track and b = -1/track. The signs of a and b show reversed wheels and sensors.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple, cast

import msgspec
import numpy as np
from msgspec.structs import replace

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Drive, Ints, Stream, changes, totals
from locfuse.fusion.robot import Robot, WheelSettings
from locfuse.fusion.sensors.gyro import UPSIDE_DOWN_GYRO
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.statistics import jackknife, robust
from locfuse.fusion.streams import MergedStream
from locfuse.fusion.wheels.motion import Wheels
from locfuse.fusion.wheels.odometry import BODY_READS
from locfuse.fusion.wheels.read import joint_names

from .finding import Finding, Least
from .lag import headings
from .laser import MAX_WALL_TURN_RAD, PAIR_TURN_RAD, WallMotion, laser_motion

MIRROR, SWAPPED = "mirror image", "swapped"  # codes of the findings on a truth, on wheels
MIRRORED_ODOMETRY = "the odometry turns the wrong way round, as with y to the right (NED)"
MIN_ASIDE = 0.7  # least sine of a laser's yaw that shows whether the laser or the wheels are mirrored
JOINT_STATE = "sensor_msgs/msg/JointState"
WINDOW_S, MIN_WINDOWS = 1.0, 20  # s over which turns are compared; their least number
RATIO_WINDOW_S, RATIO_STRETCHES = 3.0, 8  # s over which a wheel's drift is compared; parts of the jackknife
TRACK = "track"  # code of the finding on it, or on the scale of an odometry's turns
RATIO, SURE_RATIO = "ratio", "sure ratio"  # codes of the finding on wheels of different size: by one, by several
RATIO_ERRORS = Least(0.01, 4.0), Least(0.005, 3.0)  # smallest error of the ratio: reported, tried
SEVERE_RATIO_ERROR = 0.03
AGREED_SIGMAS = 2.0  # standard errors of a second sensor's ratio that confirms the first one's
MAX_HEADINGS = 5000  # of the truth, for the wheels' ratio
RATES = ("gyro", "twist")  # sensors that measure a rate, which has a bias
MIN_SPEED_SPREAD = 0.2  # least standard deviation of the speed as share of its mean, beside a bias
MAX_LAG_S, LAG_STEP_S = 1.2, 0.05  # s: clocks may differ
# least correlation of turns that shows opposite senses, least rms of a turn
MIN_AGAINST_CORRELATION, MIN_AGAINST_TURN_RAD = 0.8, math.radians(2.0)
MIN_RMS_TURN_RAD = math.radians(5.0)  # least rms turn of a window
MIN_EXPLAINED_SHARE = 0.8  # share of a sensor's turns that the wheels must explain, with either sign
MAX_WHEEL_CORRELATION = 0.98  # of both wheels, above which their effects cannot be separated
MIN_TRACK_ERROR, MIN_SIGMAS = 0.04, 4.0  # smallest reported relative error of the track; standard errors
SEVERE_TRACK_ERROR = 0.06
WORTH_SAYING = Least(MIN_TRACK_ERROR, MIN_SIGMAS)
MIN_ROLL_SPREAD_M = 1e-3  # m per window, least standard deviation of a wheel's distance
GYRO_SCALE_SIGMA = 0.01  # 1 sigma of a gyro's scale
MAX_PAIRED_SHARE = 0.5  # largest error of a turn, as share of the largest turn of paired walls, without a bias
CHORD_M, PIECE_RAD, MIN_PIECES = 0.3, 1.5, 6  # m of path for a direction of travel; rad and number of pieces
MIN_SLOPE, MAX_SLOPE_SIGMA = 0.3, 0.05  # limits of (truth's turns / wheels' turns) and its sigma, for a track
BOTH_TURNED: Mapping[str, str] = {"none": "both", "both": "none", "left": "right", "right": "left"}
MIN_PIECES_OF_SIGN, MAX_AGAINST_SIGMA = 3, 0.25  # for the sign of this ratio: pieces; sigma as share of the ratio


class Turning(msgspec.Struct, frozen=True):
    """Linear fit of one sensor's turns by the distances of both wheels."""

    a: float  # per metre of the right wheel [rad/m]
    b: float  # per metre of the left wheel
    sigma: float  # standard error of a - b
    explained: float  # share of its variance
    offset: float  # s to add to its stamps


Turnings = Mapping[str, Turning]  # by sensor


class Headings(NamedTuple):
    """Headings of the truth or of one sensor."""

    t: Array  # (n,) s
    angle: Array  # (n,) rad, unwrapped
    without_lines: Array | None = None  # (n,) number of readings so far whose turn is unknown; None: no such ones


def headings_of(drive: Drive) -> dict[str, Headings]:
    """Return the headings of each sensor that measures turns."""
    found = {}
    for name, (t, own) in headings(drive.measurements).items():
        # while no lines match, the turn is exactly zero
        unknown = np.cumsum(np.diff(own, prepend=np.nan) == 0.0) * 1.0 if REGISTRY[name].heading_holds else None
        found[name] = Headings(t, own, unknown)
    return found


def true_headings(drive: Drive) -> dict[str, Headings]:
    """Return the headings of the truth, as those of a sensor; {} if it has none."""
    truth = drive.truth
    if truth is None or truth.theta is None:
        return {}
    return {"truth": Headings(truth.t, np.unwrap(truth.theta))}


def turnings(drive: Drive) -> dict[str, Turning]:
    """Return for each sensor that measures turns how these follow from the distances of both wheels."""
    return _fits(headings_of(drive), drive.wheels)


def _fits(known: Mapping[str, Headings], wheels: Wheels) -> dict[str, Turning]:
    return {name: fit for name, h in known.items() if (fit := explain(h, wheels)) is not None}


def explain(h: Headings, wheels: Wheels) -> Turning | None:
    """Return the fit of turns by wheel distances at the best clock offset; None if they do not fit."""
    start, own = _turns(h, wheels, WINDOW_S)
    if len(start) < MIN_WINDOWS or math.sqrt(float((own**2).mean())) < MIN_RMS_TURN_RAD:
        return None
    way = totals(wheels.rolled)
    best: Turning | None = None
    for offset in np.arange(-MAX_LAG_S, MAX_LAG_S + LAG_STEP_S / 2, LAG_STEP_S).tolist():
        fit = _fit(own, changes(start + offset, WINDOW_S, wheels.t, way), offset)
        if fit is not None and (best is None or fit.explained > best.explained):
            best = fit
    return best if best is not None and best.explained > MIN_EXPLAINED_SHARE else None


def _turns(h: Headings, wheels: Wheels, span: float) -> tuple[Array, Array]:
    """Return the starts (n,) [s] of windows of `span` seconds with lines throughout, and the turns (n,) [rad]."""
    start = h.t[(h.t >= wheels.t[0] + MAX_LAG_S) & (h.t <= wheels.t[-1] - MAX_LAG_S - span)]
    start = start[start + span <= h.t[-1]]
    if h.without_lines is not None:
        start = start[changes(start, span, h.t, h.without_lines) == 0.0]
    return start, changes(start, span, h.t, h.angle)


def _fit(own: Array, rolled: Array, offset: float) -> Turning | None:
    """Return the fit of turns (n,) by wheel distances (n, 2); or None."""
    left, right = rolled.T
    if np.std(left) < MIN_ROLL_SPREAD_M or np.std(right) < MIN_ROLL_SPREAD_M or own.var() == 0.0:
        return None
    if abs(float(np.corrcoef(left, right)[0, 1])) < MAX_WHEEL_CORRELATION:
        return _regression(own, np.stack((right, left), axis=-1), np.eye(2), offset)
    turn = _regression(own, (right - left)[:, None], np.array([[1.0, -1.0]]), offset)
    if turn is not None and turn.explained > MIN_EXPLAINED_SHARE:
        return turn
    # at constant speed, the sum of both distances varies if one wheel counts backward
    return _regression(own, (right + left)[:, None], np.array([[1.0, 1.0]]), offset) or turn


def _regression(own: Array, by: Array, shares: Array, offset: float) -> Turning | None:
    """Return the fit of turns by wheel distances with errors in both: geometric mean of the two regressions.

    `by` (n, k) are the regressors, `shares` (k, 2) their values per metre of the right and the left wheel.
    """
    A = np.concatenate((by, np.ones((len(own), 1))), axis=1)
    x, _, rank, _ = np.linalg.lstsq(A, own, rcond=None)
    rest = own - A @ x
    explained = 1.0 - float(rest.var() / own.var())
    if explained <= 0.0 or rank < A.shape[1]:
        return None
    # windows overlap
    independent = max(4.0, len(own) * 0.25)
    covariance = np.linalg.inv(A.T @ A)[:-1, :-1] * float(rest.var()) * len(own) / independent
    a, b = (x[:-1] / math.sqrt(explained) @ shares).tolist()
    v = shares @ np.array([1.0, -1.0])
    return Turning(a, b, math.sqrt(max(0.0, float(v @ covariance @ v))), explained, offset)


def of_turning(drive: Drive, robot: Robot, by_sensor: Turnings, streams: Mapping[str, Stream]) -> list[Finding]:
    """Return findings on wrong directions of wheels and mounts, by the turns of wheels and sensors."""
    counts_wheels = streams["wheels"].msgtype not in BODY_READS
    mirrored = [w for t in by_sensor.values() if (w := _mirrored(t)) is not None]
    if counts_wheels and len(mirrored) > len(by_sensor) / 2:
        wheel = max(set(mirrored), key=mirrored.count)
        by = " and ".join(name for name, t in by_sensor.items() if _mirrored(t) == wheel)
        words = f"the {wheel} wheel counts backward, by the turning of {by}"
        return [Finding("wheels", "mirrored", words, (f"wheels.mirrored={_also(robot, wheel)}",), True)]
    found = _against_the_truth(drive, robot, by_sensor, streams)
    if not found and not by_sensor and counts_wheels:
        found = _by_the_wheels_alone(drive.wheels, robot)
    if found:
        return found
    if unlike := _against_truths_turns(drive, by_sensor):
        return [_reversed(name, robot, streams, "truth") for name in unlike]
    if not by_sensor:
        return []
    back = _against(by_sensor)
    # a gyro that turns against the wheels is not measured
    others = [*back, *(name for name, fixes in drive.fixes.items() if UPSIDE_DOWN_GYRO in fixes)]
    if len(others) > 1 and len(back) == len(by_sensor):
        return [exchanged(drive, robot, by_sensor, others, streams["wheels"])]
    found = [_reversed(name, robot, streams) for name in back]
    if len(by_sensor) == len(found) == 1 and drive.truth is None:
        other = exchanged(drive, robot, by_sensor, back, streams["wheels"])
        if not counts_wheels and back == ["lrf"] and _fits_as_mounted(drive, robot, by_sensor):
            return [other]
        rival = " and ".join(_swapped(robot.wheels, streams["wheels"]) if counts_wheels else other.fixes)
        words = "left and right are swapped" if counts_wheels else MIRRORED_ODOMETRY
        words = f"{found[0].message}; or {words} ({rival}): no third sensor shows which"
        found = [replace(found[0], message=words)]
    return found


def _mirrored(t: Turning) -> str | None:
    """Return the wheel whose distance has the wrong sign; None if neither has it or it is unclear."""
    weak = 0.3 * max(abs(t.a), abs(t.b))
    if abs(t.a) < weak or abs(t.b) < weak or t.a * t.b < 0.0:
        return None
    return "left" if t.a > 0.0 else "right"


def _also(robot: Robot, wheel: str) -> str:
    """Return the new value of wheels.mirrored that reverses the sign of `wheel` ("left" or "right")."""
    now = robot.wheels.mirrored
    other = "right" if wheel == "left" else "left"
    return {"none": wheel, wheel: "none", other: "both", "both": other}[now]


def _against(by_sensor: Turnings) -> list[str]:
    """Return the sensors that turn opposite to the wheels."""
    return [name for name, t in by_sensor.items() if t.a < 0.0 < t.b]


def exchanged(drive: Drive, robot: Robot, by_sensor: Turnings, others: Sequence[str], stream: Stream) -> Finding:
    """Return the finding on wheels that turn opposite to `others`: swapped, or both counting backward."""
    words = f"the wheels turn against {' and '.join(others)}"
    if stream.msgtype in BODY_READS:
        fixes = (f"wheels.turn_scale={-robot.wheels.turn_scale:g}",)
        return Finding("wheels", SWAPPED, f"{words}: {MIRRORED_ODOMETRY}", fixes, True)
    if _backward(drive, robot, by_sensor):
        fixes = (f"wheels.mirrored={BOTH_TURNED[robot.wheels.mirrored]}",)
        return Finding("wheels", SWAPPED, f"{words}: both wheels count backward", fixes, True)
    return Finding("wheels", SWAPPED, f"{words}: left and right are swapped", _swapped(robot.wheels, stream), True)


def _backward(drive: Drive, robot: Robot, by_sensor: Turnings) -> bool:
    """Return whether forward wheel distances have the wrong sign, by the truth's headings, else by walls."""
    wheels, truth = drive.wheels, drive.truth
    if truth is not None and truth.theta is not None:
        middle = 0.5 * (truth.t[1:] + truth.t[:-1])
        theta = np.interp(middle, truth.t, np.unwrap(truth.theta))
        moved = se2.rotated(-theta, np.diff(truth.xy, axis=0))[:, 0]
        return float(moved @ wheels.relative(truth.t[:-1], truth.t[1:])[:, 0]) < 0.0
    yaw = _yaw_if_turned(drive, robot, by_sensor)
    return yaw is not None and abs(yaw) > 0.5 * math.pi


def _yaw_if_turned(drive: Drive, robot: Robot, by_sensor: Turnings) -> float | None:
    """Return the laser's yaw error [rad] if the wheels turn the other way round; None if it is unknown."""
    wheels = drive.wheels
    turned = Wheels.from_twists(wheels.t, wheels.twist * [1.0, -1.0, -1.0], wheels.track, wheels.noise)
    motion = laser_motion(replace(drive, wheels=turned), robot, clock_offset("lrf", by_sensor))
    return None if motion is None else motion.yaw


def _fits_as_mounted(drive: Drive, robot: Robot, by_sensor: Turnings) -> bool:
    """Return whether a laser that looks aside fits as configured if the wheels turn the other way round.

    If the laser were upside-down instead, its yaw would have the other sign, which is another direction then.
    """
    if abs(math.sin(math.radians(robot.settings("lrf").yaw_deg))) < MIN_ASIDE:
        return False
    yaw = _yaw_if_turned(drive, robot, by_sensor)
    return yaw is not None and abs(yaw) < 0.25 * math.pi


def _swapped(settings: WheelSettings, stream: Stream) -> tuple[str, ...]:
    if isinstance(stream, MergedStream):
        left, right = (part.topic for part in stream.parts)
        return (f"wheels.left_topic={right}", f"wheels.right_topic={left}")
    if settings.left is not None and settings.right is not None:
        return (f"wheels.left={settings.right}", f"wheels.right={settings.left}")
    if stream.msgtype == JOINT_STATE:
        names = cast("list[tuple[str, ...]]", stream.columns("name")["name"])
        left, right = joint_names(names, stream.topic, settings)
        return (f"wheels.left={right}", f"wheels.right={left}")
    return ("wheels.mirrored=both",)


def _against_truths_turns(drive: Drive, by_sensor: Mapping[str, Turning]) -> list[str]:
    """Return the sensors that turn opposite to the truth, of those whose turns the wheels do not explain."""
    truth = drive.truth
    if truth is None or truth.theta is None:
        return []
    found = []
    for name, known in headings_of(drive).items():
        start, turned = _turns(known, drive.wheels, WINDOW_S)
        start, turned = (c[(start >= truth.t[0]) & (start + WINDOW_S <= truth.t[-1])] for c in (start, turned))
        if name in by_sensor or len(start) < MIN_WINDOWS:
            continue
        both = np.stack((changes(start, WINDOW_S, truth.t, np.unwrap(truth.theta)), turned))
        turns = np.sqrt((both**2).mean(axis=1)).min() > MIN_AGAINST_TURN_RAD
        if turns and np.corrcoef(both)[0, 1] < -MIN_AGAINST_CORRELATION:
            found.append(name)
    return found


def _reversed(name: str, robot: Robot, streams: Mapping[str, Stream], whom: str = "wheels") -> Finding:
    """Return the finding on one sensor that turns opposite to the wheels, or to the truth."""
    why, sets = REGISTRY[name].reversal(robot.settings(name), streams[name].msgtype)
    fixes = tuple(f"{name}.{key}={_toml(value)}" for key, value in sets.items())
    return Finding(name, "reversed", f"it turns the other way round than the {whom}: {why}", fixes, True)


def _toml(value: str | float | bool) -> str:
    """Return a value in the form that --set takes."""
    return str(value).lower() if isinstance(value, bool) else f"{value:g}" if isinstance(value, float) else value


def of_track(
    drive: Drive,
    settings: WheelSettings,
    by_sensor: Turnings,
    motion: WallMotion | None,
    metre: float = 1.0,
    least: Least | None = None,
) -> list[Finding]:
    """Return a finding if the track is wrong by the truth, else by walls, the compass or a gyro.

    `metre` is the factor by which another fix changes the wheels' distances and the track. Errors below `least`
    are not reported; the sigma includes slip.
    """
    of_driver = settings.is_of_driver
    if of_driver and (settings.estimate or drive.wheels.matched is not None):
        return []
    if settings.radius is None and not of_driver:
        return []
    configured = 1.0 if of_driver else settings.track
    found = observed_track(configured or 0.0, drive, by_sensor, motion)
    if configured is None or found is None:
        return []
    track, own, by = metre * found[0], metre * found[1], found[2]
    off = track / (metre * configured) - 1.0
    sigma = max(own, track * (0.0 if motion is None else motion.by_slips))
    # a caller that tries the fix needs no margin for slip
    slips, least = 0.0 if least else sigma, least or WORTH_SAYING
    if abs(off) < max(least.error + least.sigmas * own / track, least.sigmas * slips / track):
        return []
    sure = abs(off) > max(SEVERE_TRACK_ERROR, MIN_TRACK_ERROR + MIN_SIGMAS * own / track)
    if of_driver:
        words = f"they turn {abs(off):.1%} too {'far' if off > 0.0 else 'little'} by {by} (1 sigma {sigma:.1%})"
        fix = f"wheels.turn_scale={settings.turn_scale / found[0]:.4g}"
        return [Finding("wheels", TRACK, words, (fix,), sure)]
    words = (
        f"by the turning of {by} the track is {track:.3f} m (1 sigma {sigma:.3f}), configured {configured:g} m; "
        "or let the filter find it (wheels.estimate=true)"
    )
    return [Finding("wheels", TRACK, words, (f"wheels.track={track:.4g}",), sure)]


def of_ratio(drive: Drive, robot: Robot, by_sensor: Turnings, least: Least | None = None) -> list[Finding]:
    """Return a finding if headings drift with the distance, by truth or a sensor: one wheel is larger.

    `by_sensor` may have a fit of the truth. An odometry has two virtual wheels.
    """
    wheels, truth = robot.wheels, drive.truth
    if wheels.estimate or drive.wheels.matched is not None:
        return []
    if not wheels.is_of_driver and (wheels.radius is None or wheels.track is None):
        return []
    known = headings_of(drive) | _of_truth(drive)
    names = [name for name in by_sensor if name in known]
    # directions of travel are less exact than headings
    names.sort(key=lambda name: name == "truth", reverse=truth is not None and truth.theta is not None)
    names.sort(key=RATES.__contains__)
    fits = ((n, _ratio(known[n], by_sensor[n].offset, drive.wheels, n in RATES)) for n in names)
    (name, (ratio, sigma)), *others = [(n, fit) for n, fit in fits if fit is not None] or [("", (1.0, 0.0))]
    least, off = RATIO_ERRORS[least is not None], abs(ratio - 1.0)
    if off < least.error + least.sigmas * sigma:
        return []
    agreed = any((other - 1.0) * math.copysign(1.0, ratio - 1.0) > AGREED_SIGMAS * s for _, (other, s) in others)
    severe = off > SEVERE_RATIO_ERROR + RATIO_ERRORS[0].sigmas * sigma
    drift, drift_sigma = np.degrees(np.array([1.0 - ratio, sigma]) / drive.wheels.track).tolist()
    ratio *= wheels.ratio
    words = (
        f"by the headings of {source_words(name)} the right wheel's radius is {ratio:.3f} times the left one's (1 "
        f"sigma {sigma:.3f}), configured {wheels.ratio:g}"
    )
    if wheels.is_of_driver:
        side = "left" if drift > 0.0 else "right"
        words = (
            f"by {source_words(name)} they turn {abs(drift):.1f}° per metre too far to the {side} (1 sigma "
            f"{drift_sigma:.1g}°), as with a flat tyre or an offset of the steering"
        )
    code = SURE_RATIO if agreed else RATIO
    return [Finding("wheels", code, words, (f"wheels.ratio={ratio:.4g}",), severe)]


def _ratio(known: Headings, offset: float, wheels: Wheels, biased: bool) -> tuple[float, float] | None:
    """Return the turn per metre of the right wheel / that of the left one, and its sigma; None if unclear.

    The rate of the headings has an unknown bias if `biased`. `offset` [s] is added to their times.
    """
    start, own = _turns(known, wheels, RATIO_WINDOW_S)
    if len(start) < MIN_WINDOWS:
        return None
    left, right = changes(start + offset, RATIO_WINDOW_S, wheels.t, totals(wheels.rolled)).T
    if biased and np.std(right + left) < MIN_SPEED_SPREAD * abs(np.mean(right + left)):
        return None  # at constant speed a bias looks like a ratio
    A = np.stack((right - left, right + left, np.ones(len(start)))[: 3 if biased else 2], axis=-1)

    def ratio(some: Ints) -> float | None:
        turn, drift = robust(A[some], own[some])[0].tolist()[:2]
        return (turn + drift) / (turn - drift) if abs(drift) < abs(turn) else None

    found, sigma = ratio(np.arange(len(start))), float(jackknife(ratio, len(start), RATIO_STRETCHES))
    return None if found is None or not math.isfinite(sigma) else (found, sigma)


def and_truth(drive: Drive, by_sensor: Turnings) -> dict[str, Turning]:
    """Return the fits of turns with that of the truth, if it turns as the wheels do."""
    return {**by_sensor, **_fits(_of_truth(drive), drive.wheels)}


def source_words(name: str) -> str:
    """Return the words for the truth or a sensor whose headings show something."""
    return "the scans" if name == "lrf" else f"the {name}"


def _of_truth(drive: Drive) -> dict[str, Headings]:
    """Return {"truth": headings} with at most MAX_HEADINGS headings; {} if there are none.

    For a truth without headings, the directions of travel are returned.
    """
    truth, wheels = drive.truth, drive.wheels
    if truth is None:
        return {}
    if truth.theta is not None:
        t, heading = truth.t, np.unwrap(truth.theta)
    else:
        inside = (truth.t >= wheels.t[0]) & (truth.t <= wheels.t[-1])
        at, xy = truth.t[inside], truth.xy[inside]
        way = wheels.driven(at)
        end = np.searchsorted(way, way + CHORD_M)
        first = np.flatnonzero(end < len(at))
        ahead = (xy[end[first]] - xy[first]).T
        t, kept = np.unique(0.5 * (at[first] + at[end[first]]), return_index=True)
        heading = np.unwrap(np.arctan2(ahead[1], ahead[0])[kept])
    some = np.arange(0, len(t), 1 + len(t) // MAX_HEADINGS)
    return {"truth": Headings(t[some], heading[some])} if len(some) else {}


def observed_track(
    configured: float, drive: Drive, by_sensor: Turnings, motion: WallMotion | None
) -> tuple[float, float, str] | None:
    """Return the track by turns of other sensors, its sigma, and its source; None without a source."""
    turns = turns_by_truth(drive)
    if turns is not None:
        return configured / turns[0], configured * turns[1] / turns[0] ** 2, "the truth"
    far = far_by_scans(drive.wheels.track, by_sensor)
    if far is not None:
        return configured * far[0], configured * far[1], "the scans"
    if motion is not None and motion.turns is not None and math.isfinite(motion.turns_sigma):
        return configured / motion.turns, configured * motion.turns_sigma / motion.turns**2, "the laser's walls"
    for name, scale_sigma in (("compass", 0.0), ("gyro", GYRO_SCALE_SIGMA)):
        t = by_sensor.get(name)
        if t is not None and t.a - t.b > 0.0:
            # the turns of an odometry imply a track in `drive` that is not configured
            track = configured * 2.0 / (t.a - t.b) / drive.wheels.track
            return track, track * math.hypot(t.sigma / (t.a - t.b), scale_sigma), f"the {name}"
    return None


def far_by_scans(track: float, by_sensor: Turnings) -> tuple[float, float] | None:
    """Return (track by turns from scan to scan) / `track` and its sigma if this ratio is far from 1; else None.

    Walls of two scans are paired by the turn of the wheels. If the error of this turn is too large, the pairs with
    the largest errors are missing, and the track by paired walls lies between the configured and the true track.
    """
    t = by_sensor.get("lrf")
    if t is None or t.a - t.b <= 0.0:
        return None
    ratio = 2.0 / (t.a - t.b) / track
    if abs(1.0 / ratio - 1.0) * PAIR_TURN_RAD < MAX_PAIRED_SHARE * MAX_WALL_TURN_RAD:
        return None
    return ratio, ratio * t.sigma / (t.a - t.b)


def turns_by_truth(drive: Drive) -> tuple[float, float] | None:
    """Return the ratio of the truth's turns to the wheels' turns, and its sigma; None if unclear."""
    found = _slope_by_truth(drive, MIN_PIECES, by_path=False)
    return found if found is not None and found[0] > MIN_SLOPE and found[1] < MAX_SLOPE_SIGMA else None


def _slope_by_truth(drive: Drive, fewest: int, by_path: bool) -> tuple[float, float] | None:
    """Return the signed ratio of the truth's turns to the wheels', and its sigma; None for short drives.

    The truth's turns are those of its headings, or of the direction of travel (if `by_path`, or without headings).
    Turns are summed over pieces with independent slip.
    """
    truth, wheels = drive.truth, drive.wheels
    if truth is None:
        return None
    rows = np.flatnonzero((truth.t >= wheels.t[0]) & (truth.t <= wheels.t[-1]))
    pose = wheels.at(truth.t[rows])[2]
    if truth.theta is not None and not by_path:
        own, at = np.unwrap(truth.theta[rows]), truth.t[rows]
        turned = wheels.heading(at)
    else:
        way = np.hypot(*np.diff(pose[:, :2], axis=0).T).cumsum()
        first = np.unique(np.searchsorted(way, np.arange(0.0, way[-1] if len(way) else 0.0, CHORD_M)))
        seen, rolled = (np.diff(xy[first], axis=0) for xy in (truth.xy[rows], pose[:, :2]))
        direction = [np.unwrap(np.arctan2(d[:, 1], d[:, 0])) for d in (seen, rolled)]
        own, turned = direction
    if len(own) < fewest + 1:
        return None
    piece = np.cumsum(np.abs(np.diff(turned, prepend=turned[0])))
    ends = np.unique(np.searchsorted(piece, np.arange(0.0, piece[-1], PIECE_RAD)))
    x, y = np.diff(turned[ends]), np.diff(own[ends])
    if len(x) < fewest or float(x @ x) <= 0.0:
        return None
    (slope,), keep = robust(x[:, None], y, least=1e-3)
    rest = (y - slope * x)[keep]
    sigma = math.sqrt(float(rest @ rest) / max(1, len(rest) - 1) / float(x[keep] @ x[keep]))
    return float(slope), sigma


def _sense_by_truth(drive: Drive, by_path: bool) -> int:
    """Return 1 if truth and wheels turn in the same direction, -1 if opposite, 0 if unclear."""
    slope, sigma = _slope_by_truth(drive, MIN_PIECES_OF_SIGN, by_path) or (0.0, 0.0)
    if abs(slope) < MIN_SLOPE or sigma > MAX_AGAINST_SIGMA * abs(slope):
        return 0
    return 1 if slope > 0.0 else -1


def _against_the_truth(
    drive: Drive, robot: Robot, by_sensor: Turnings, streams: Mapping[str, Stream]
) -> list[Finding]:
    """Return a finding if truth and wheels turn in opposite directions.

    A third sensor shows which of them is right. If the truth's own path and headings disagree, the truth is wrong.
    """
    truth, stream = drive.truth, streams["wheels"]
    by_path = _sense_by_truth(drive, by_path=True)
    sense = by_path if truth is None or truth.theta is None else _sense_by_truth(drive, by_path=False)
    if by_path * sense < 0:
        words = "its path and its headings turn in opposite directions: one of its axes points the other way"
        return [Finding("truth", MIRROR, words, (), True)]
    if sense >= 0:
        return []
    matched = drive.wheels.matched is not None  # the laser replaces the wheels, so it is no third sensor
    others = {name: t for name, t in by_sensor.items() if not (matched and name == "lrf")}
    back = _against(others)
    if back and len(back) == len(others) and not matched:
        return [exchanged(drive, robot, by_sensor, (*back, "the truth"), stream)]
    if not others and stream.msgtype not in BODY_READS:
        found = exchanged(drive, robot, by_sensor, ("the truth",), stream)
        return [replace(found, message=f"{found.message}, or the truth is a mirror image")]
    words = "it is a mirror image of the drive: one of its axes points the other way"
    if matched:
        words += "; or the laser, whose scans are the motion here, is mounted upside-down (lrf.flipped)"
    elif not others:
        words += f"; or {MIRRORED_ODOMETRY} (wheels.turn_scale={-robot.wheels.turn_scale:g})"
    agree = all(t.b < 0.0 < t.a for t in others.values())
    if len(others) == 1 and stream.msgtype not in BODY_READS:
        (name,) = others
        rival = *_swapped(robot.wheels, stream), *_reversed(name, robot, streams).fixes
        words += f"; or both others turn the wrong way: --set {' --set '.join(rival)}"
    return [Finding("truth", MIRROR, words, (), True)] if agree else []


def _by_the_wheels_alone(wheels: Wheels, robot: Robot) -> list[Finding]:
    """Return a finding if the wheels nearly always roll in opposite directions."""
    left, right = wheels.rolled.T
    moving = (np.abs(left) > 1e-5) & (np.abs(right) > 1e-5)
    against = float(np.mean(left[moving] * right[moving] < 0.0)) if moving.any() else 0.0
    if against < 0.7 or moving.sum() < 50 or float(np.abs(left[moving]).sum()) < 0.5:
        return []
    words = (
        f"they turn against each other {against:.0%} of the time: unless the robot only turned on the spot, one "
        "counts backward (if it is the right one: wheels.mirrored=right)"
    )
    fix = "left" if float(right.sum()) > float(left.sum()) else "right"
    return [Finding("wheels", "mirrored", words, (f"wheels.mirrored={_also(robot, fix)}",), False)]


def clock_offset(sensor: str, by_sensor: Turnings) -> float:
    """Return the time [s] to add to a sensor's stamps for the wheels' clock, by its turns; 0 if unknown."""
    return by_sensor[sensor].offset if sensor in by_sensor else 0.0
