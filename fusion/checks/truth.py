"""Truth checks: jumps, gaps and noise of the truth, tracked point and its direction, distance scale."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Drive, Estimates, Mask, Truth, changes, stretches, totals
from locfuse.fusion.robot import Robot
from locfuse.fusion.statistics import robust
from locfuse.fusion.streams import gap_limit, outside
from locfuse.fusion.truth import NO_TRUTH, elsewhere, looks_like_truth
from locfuse.fusion.wheels.calibrate import Sigma, truth_sigma
from locfuse.fusion.wheels.motion import Wheels, path_alike, turns_explained
from locfuse.fusion.wheels.repairs import gaps_of, times

from .finding import Finding, Least, of_error
from .lag import headings
from .laser import OPEN_SCALE, WallMotion, range_fix, size_fix, who_is_right
from .start import of_start
from .tracked_point import axle_path, of_creep, of_point, of_yaw, swing, swing_by_positions

UNIT, AXES, JUMP, FEW = "unit", "axes", "jump", "few"  # codes of the findings on an unusable truth
OTHER = "other body"  # code of the finding on a truth of another body
MIN_ALIKE, MIN_SURE_SHARE, MAX_OTHER_SHARE = 0.9, 0.9, 0.5  # of paths; of turns: of one robot, of different ones
SIZE = "size"  # code of the finding on a truth with another distance scale than wheels and laser
# ratio of the truth's distances to those in m -> unit
UNITS = {1000.0: "mm", 100.0: "cm", 0.01: "hundreds of metres", 0.001: "km"}
MAX_UNIT_RATIO = 1.5  # largest factor between the observed ratio and one of these
# a truth without one of its axes: largest extent of this axis as share of the drive's; least extent of the drive,
# m; largest share of the squared distances over WINDOW_S that the truth shows
MAX_LEVEL_SHARE, MIN_EXTENT_M, MAX_SEEN_SHARE = 0.1, 0.5, 0.8
MAX_STILL_M = 1e-4  # m, extent of a truth that does not move
# standard errors; largest difference of wheels and laser, as share of the truth's scale error
MAX_SIZE_SIGMAS, MAX_APART_SHARE = 3.0, 0.5
MIN_TRUTH_ERROR = 0.015  # least relative error of the truth's distances: lasers and wheels are right to about 1 %
ROBOT_SPEEDS_MPS = 0.02, 20.0  # m/s: plausible range of the 99th percentile of a robot's speeds
STEP = "step"  # code of the finding on sideways steps
FIXES = "the fixes of the GPS"  # topic of a truth made of these
COPY = "copy"  # code of the finding on a truth that is made of the wheels
# largest rms difference as a share of the way, least way, m: a radius is rarely known better than to 1e-3
MAX_COPIED_SHARE, MIN_COPIED_M = 1e-4, 10.0
MOVED = "moved"  # code of the finding on a frame of the truth that turns or moves once
# s in which it turns or moves aside, least turn, least motion: in this time wheels creep aside by a few cm
MOVE_S, MIN_MOVE_RAD, MIN_MOVE_M = 6.0, math.radians(5.0), 0.1
WHEEL_SCALE = "wheel scale"  # code of the finding on the wheels' distance scale
MIN_READINGS = 5  # of a truth that is used
WINDOW_S = 1.0  # s over which steps are compared
WINDOWS_S = 1.0, 2.0, 4.0, 8.0  # s over which distances are compared: longer where the wheels roll slowly
MIN_WINDOWS, MAX_BEND_RAD = 20, 1.0  # windows for a ratio of distances; turn by the wheels in a straight window
STRETCH_COUNT = 8  # of the drive, for the jackknife
MIN_WAY_M, MIN_WAY_SIGMAS = 0.1, 10.0  # per window, by the wheels: m; standard deviations of the truth
MIN_SEEN_M = 1e-6  # m per window, by the truth: a truth at rest does not show the wheels' scale
MIN_SCALE_ERROR, SEVERE_SCALE_ERROR = 0.03, 0.05  # relative errors of the wheels' distances
WORTH_SAYING = Least(MIN_SCALE_ERROR, 3.0)
MAX_JUMP_SHARE = 0.01  # of a truth's steps: with more jumps it is unusable
JUMP_FACTOR, MIN_JUMP_M = 3.0, 0.3  # a jump is longer than this factor times the wheels' step plus this distance
# sideways steps: least size in m, and in median differences from the wheels; largest number
MIN_STEP_M, STEP_SIGMAS, MAX_STEPS = 0.03, 12.0, 5
MIN_STEP_RATIO = 2.0  # of a step to the usual large ones
MIN_STEPS, READINGS_AROUND = 100, 5  # steps for an estimate of the noise; readings before and after a step
WINDOW_STEPS = 41  # steps of a path over which its direction is computed; one wrong step hardly turns it
CLIPPED_SIGMAS, NOISE_SIGMAS = 6.0, 5.0  # sigmas at which steps are clipped; standard errors of significant noise
MIN_NOISE_FACTOR = 2.0  # noise above this multiple of the configured noise is reported
MIN_NOISE_M, MIN_NOISE_RAD = 3e-4, math.radians(0.05)  # smaller noise is not reported
MIN_WAY_ERROR, WAY_SIGMAS = 0.01, 3.0  # relative, standard errors: of laser distances and wheel distances


def of_truth(drive: Drive, robot: Robot) -> list[Finding]:
    """Return findings on the truth: jumps, gaps, noise, tracked point, start pose, sideways motion."""
    truth = drive.truth
    few = of_few(drive)
    if truth is None or few:
        return few
    noisy = _noise_like_jumps(truth, drive)
    if noisy:
        return noisy
    recorded, found, jumps = truth.t, jumps_of(drive), _steps(truth, drive)
    few_stay = found is not None and not found.away.any() and 0 < found.staying <= MAX_STEPS
    if found is not None and not (few_stay and jumps):  # of few jumps that stay, `_steps` gives the times
        speed = max(1.0, math.ceil(3.0 * _fastest(drive)))
        jumps = [Finding("truth", JUMP, found.words, (f"truth.max_speed={speed:g}",), True)]
        if found.staying <= 0:  # the rest of the truth is right
            theta = None if truth.theta is None else truth.theta[~found.away]
            truth = replace(truth, t=truth.t[~found.away], xy=truth.xy[~found.away], theta=theta)
    jumps = jumps or _moves(truth, drive)
    swings = swing(truth, drive)
    yaw = of_yaw(swings, robot)
    if yaw and swings is not None and truth.theta is not None:
        truth = replace(truth, theta=truth.theta + swings.aside)
        swings = swing(truth, drive)
    swings = swings if truth.theta is not None else swing_by_positions(truth, drive)
    point = of_point(truth, swings)
    if point and swings is not None:  # a wrong tracked point would look like a wrong start
        truth = replace(truth, point=(float(swings.x[0]), float(swings.x[1])))
    creep = of_creep(swings)
    aside = abs(swings.aside) if swings is not None and creep else 0.0
    # jumps that stay would look like noise, and like a wrong start
    stay = bool(jumps) and (found is None or found.staying > 0)
    start = [] if stay else of_start(truth, drive, robot, aside)
    noise = [] if stay else _noise(truth, drive)
    dt = np.diff(recorded)
    long = dt > gap_limit(recorded)
    words = f"{gaps_of(int(long.sum()), float(dt.max()))}: no errors are computed there"
    gaps = [Finding("truth", "gap", words)] if long.any() else []
    return [*yaw, *jumps, *gaps, *noise, *point, *start, *creep]


def with_headings(truth: Truth, wheels: Wheels) -> Truth:
    """Return the truth; one of positions gets the wheels' headings, turned so that both paths have one direction.

    The turn is that of the path within WINDOW_STEPS, since wheels slip.
    """
    if truth.theta is not None or len(truth.t) < MIN_STEPS:
        return truth
    _, _, pose = wheels.at(np.clip(truth.t, wheels.t[0], wheels.t[-1]))
    seen, rolled = (np.diff(xy @ (1.0, 1.0j)) for xy in (truth.xy, pose[:, :2]))
    turn = np.unwrap(np.angle(np.convolve(seen * rolled.conj(), np.ones(WINDOW_STEPS), "same")))
    return replace(truth, theta=pose[:, 2] + np.append(turn, turn[-1:]))


def _inside(truth: Truth, wheels: Wheels) -> Mask:
    """Return which of the truth's steps (n - 1,) lie within the drive and not across a gap."""
    usual = np.diff(truth.t) < gap_limit(truth.t)
    within: Mask = usual & (truth.t[:-1] >= wheels.t[0]) & (truth.t[1:] <= wheels.t[-1])
    return within


def _steps(truth: Truth, drive: Drive) -> list[Finding]:
    """Return a finding if the truth steps off the wheels' path between two stamps and does not come back."""
    where = steps_aside(truth, drive)
    first = "that" if len(where) == 1 else "the first of these"
    words = f"it steps aside by {', '.join(where)}, while the robot rolls on: errors after {first} are the truth's"
    return [Finding("truth", STEP, words, (), True)] if where else []


def steps_aside(truth: Truth, drive: Drive) -> list[str]:
    """Return size and time of each of few steps of positions off the wheels' path that stay."""
    if drive.wheels.matched is not None:
        return []  # scan matching loses its way too
    new = np.append(True, np.diff(truth.xy, axis=0).any(axis=1))  # a held pose seems to step when it is renewed
    theta = None if truth.theta is None else truth.theta[new]
    truth = with_headings(replace(truth, t=truth.t[new], xy=truth.xy[new], theta=theta), drive.wheels)
    path = axle_path(truth, drive.wheels)
    if path is None or truth.theta is None:
        return []
    body = truth.xy - se2.rotated(truth.theta, np.tile(truth.point, (len(truth.t), 1))) - path
    step, inside = np.diff(body, axis=0), _inside(truth, drive.wheels)
    size = np.hypot(*step.T)
    if inside.sum() < MIN_STEPS:
        return []
    # wheels that slip often give many larger steps; a step of the truth is far larger than these, so they are few
    usual = float(np.partition(size[inside], -MAX_STEPS - 1)[-MAX_STEPS - 1])
    least, sure = max(MIN_STEP_M, MIN_STEP_RATIO * usual), STEP_SIGMAS * float(np.median(size[inside]))
    found, largest = [], 0.0
    for k in np.flatnonzero(inside & (size > least)).tolist():
        before, after = body[max(0, k - READINGS_AROUND) : k + 1], body[k + 1 : k + 2 + READINGS_AROUND]
        stays = float(np.hypot(*(np.median(after, axis=0) - np.median(before, axis=0))))
        if stays > 0.7 * float(size[k]):
            found.append((float(truth.t[k + 1]), stays))
            largest = max(largest, float(size[k]))
    return [f"{away:.2f} m at {t:.1f} s" for t, away in found] if largest > sure else []


def _moves(truth: Truth, drive: Drive) -> list[Finding]:
    """Return a finding if the truth's frame turns, or moves aside, by much once, within MOVE_S, and stays so.

    AMCL that is started elsewhere does that when it finds its place. Another sensor must turn as the wheels do.
    """
    wheels, path = drive.wheels, axle_path(truth, drive.wheels)
    inside = (truth.t >= wheels.t[0]) & (truth.t <= wheels.t[-1])
    if truth.theta is None or path is None or wheels.matched is not None or inside.sum() < MIN_WINDOWS:
        return []
    t, turn = truth.t[inside], np.unwrap(truth.theta[inside])
    body = (truth.xy - path)[inside] - se2.rotated(turn, np.tile(truth.point, (len(t), 1)))
    aside, turned = se2.rotated(-turn[1:], np.diff(body, axis=0))[:, 1], np.diff(turn)
    ahead, _ = robust(turned[:, None], aside)  # of another tracked point than configured
    aside = totals(aside - turned * ahead)  # wheels slip ahead, and hardly aside
    most = MIN_MOVE_RAD
    if found := _moved_once(t, turn - wheels.heading(t), MIN_MOVE_RAD):
        how, most = f"turns by {math.degrees(found[1]):.0f}°", found[1] / (2.0 * MIN_STEP_RATIO)
    elif found := _moved_once(t, aside, MIN_MOVE_M):
        how = f"moves aside by {found[1]:.2f} m"
    else:
        return []
    begin, end, agree = found[0], found[0] + MOVE_S, list[str]()
    for name, (at, angle) in headings(drive.measurements).items():
        apart = np.diff(np.interp((begin, end), at, angle - wheels.heading(at)))
        agree += [name] if abs(float(apart[0])) < most else []
    if not agree:
        return []
    begin, end = math.floor(begin), math.ceil(end)
    part = f"--from {end} --align se2" if begin + end < t[0] + t[-1] else f"--to {begin}"
    words = (
        f"its frame {how} between {begin} s and {end} s, while wheels and {agree[0]} agree, as when localisation "
        f"finds its place. To judge a part: locfuse compare LOG {part}"
    )
    return [Finding("truth", MOVED, words, (), True)]


def _moved_once(t: Array, off: Array, least: float) -> tuple[float, float] | None:
    """Return when `off` (n,), at times t (n,) [s], changes by `least` or more within MOVE_S and stays so; by what.

    None if it does not, or also changes much elsewhere.
    """
    step = np.interp(t + MOVE_S, t, off) - off
    i = int(np.argmax(np.abs(step)))
    begin, size = float(t[i]), abs(float(step[i]))
    stays = float(np.subtract(*np.interp((begin + 2.0 * MOVE_S, begin - MOVE_S), t, off)))
    elsewhere_most = float(np.abs(step[np.abs(t - begin) > MOVE_S]).max(initial=0.0))
    if size < max(least, MIN_STEP_RATIO * elsewhere_most) or stays / float(step[i]) < 1.0 / MIN_STEP_RATIO:
        return None
    return begin, size


def _noise(truth: Truth, drive: Drive) -> list[Finding]:
    """Return a finding if the truth is noisier than truth.sigma: ANEES counts that as an error of the estimate."""
    rest, moving = truth_sigma(truth, drive.wheels), _scatter(truth, drive.wheels)
    place = max(rest.xy, moving.xy)
    turn = max(rest.theta, moving.theta) if truth.theta is not None else 0.0
    if place < MIN_NOISE_M and turn < MIN_NOISE_RAD:
        return []
    parts: list[tuple[str, str]] = []  # both: ANEES needs both sigmas, or none
    if place > MIN_NOISE_FACTOR * truth.sigma:
        parts.append((f"{1e3 * place:.2g} mm", f"truth.sigma={place:.2g}"))
    if turn > MIN_NOISE_FACTOR * truth.sigma_theta:
        parts.append((f"{math.degrees(turn):.2g}°", f"truth.sigma_theta_deg={math.degrees(turn):.2g}"))
    if not parts:
        return []
    words = " and ".join(part for part, _ in parts)
    return [Finding("truth", "noise", f"its own noise is {words} (1 sigma)", tuple(fix for _, fix in parts))]


def _scatter(truth: Truth, wheels: Wheels) -> Sigma:
    """Return the noise of truth poses by the negative correlation of neighbouring steps.

    Only sideways steps are used, since jitter of the stamps looks like noise along the path. The noise is zero if
    it is not significant.
    """
    path, inside = axle_path(truth, wheels), _inside(truth, wheels)
    if inside.sum() < MIN_STEPS:
        return Sigma(0.0, 0.0)
    if path is None or truth.theta is None:  # only noise larger than the robot's steps shows
        return Sigma(max(white_sigma(step[inside]) for step in np.diff(truth.xy, axis=0).T), 0.0)
    step = se2.rotated(-truth.theta[:-1], np.diff(truth.xy - path, axis=0))[:, 1]
    turn = np.diff(np.unwrap(truth.theta) - np.interp(truth.t, wheels.t, wheels.pose[:, 2]))
    return Sigma(white_sigma(step[inside]), white_sigma(turn[inside]))


def white_sigma(steps: Array) -> float:
    """Return the sigma of white position noise by the correlation of steps (n,); 0 if not significant.

    Noise of one position adds to one step and is subtracted in the next one.
    """
    steps = np.clip(steps, *(np.array([-1.0, 1.0]) * CLIPPED_SIGMAS * float(np.median(np.abs(steps)))))
    products = -steps[1:] * steps[:-1]
    variance, sure = float(products.mean()), float(products.std()) / math.sqrt(len(products))
    return math.sqrt(variance) if variance > NOISE_SIGMAS * sure else 0.0


class Jumps(NamedTuple):
    """Jumps of the truth: steps much longer than the wheels rolled, as when a tracker loses the tracked body."""

    number: int
    away: Mask  # readings between a jump away and the jump back
    staying: int  # jumps that do not return
    steps: int  # of the whole truth

    @property
    def unusable(self) -> bool:
        """Whether the truth jumps so often that it cannot be used."""
        return self.number > MAX_JUMP_SHARE * self.steps

    @property
    def words(self) -> str:
        """Text on the jumps."""
        words = f"it jumps {times(self.number)} by more than the wheels rolled"
        words += f"; {self.away.sum()} readings can be left out" if self.away.any() else ""
        if self.staying > 0:
            words += f"; {self.staying} jumps do not return, and errors across them mean nothing"
        return words


def jumps_of(drive: Drive) -> Jumps | None:
    """Return the jumps of the truth; None without truth or without jumps."""
    truth = drive.truth
    if truth is None or len(truth.t) < MIN_READINGS:
        return None
    limit = JUMP_FACTOR * np.diff(drive.wheels.driven(truth.t)) + MIN_JUMP_M + 6.0 * truth.sigma
    number = int((np.hypot(*np.diff(truth.xy, axis=0).T) > limit).sum())
    if not number:
        return None
    away = elsewhere(truth.t, truth.xy, limit)
    return Jumps(number, away, number - 2 * len(stretches(away)), len(limit))


def _noise_like_jumps(truth: Truth, drive: Drive) -> list[Finding]:
    """Return the finding on the truth's noise if this alone makes it jump too often to be used."""
    found = jumps_of(drive)
    if found is None or not found.unusable:
        return []
    noise = _noise(truth, drive)
    sigma = max(truth.sigma, _scatter(truth, drive.wheels).xy)
    rest = jumps_of(replace(drive, truth=replace(truth, sigma=sigma)))
    return [replace(f, severe=True) for f in noise] if rest is None or not rest.unusable else []


def _fastest(drive: Drive) -> float:
    """Return the 99th percentile of the wheels' speed [m/s]."""
    return float(np.percentile(np.hypot(*drive.wheels.twist[:, :2].T) / np.diff(drive.wheels.t), 99.0))


def of_few(drive: Drive) -> list[Finding]:
    """Return a finding if fewer than MIN_READINGS poses of the truth lie within the drive."""
    if drive.truth is None:
        return []
    t, wheels = drive.truth.t, drive.wheels.t
    inside = int(((t >= wheels[0]) & (t <= wheels[-1])).sum())
    if inside >= MIN_READINGS:
        return []
    if len(t) >= MIN_READINGS and not inside:
        return [of_error(outside(t, wheels, "truth", drive.truth.time_offset), "truth", FEW)]
    number = f"{len(t)} pose{'' if len(t) == 1 else 's'}{f', {inside} of them' if inside < len(t) else ''}"
    words = f"it has {number} in the {wheels[-1] - wheels[0]:.1f} s of the drive, too few to measure errors"
    hint = f"({MIN_READINGS} are the least; to judge without it: --set {NO_TRUTH})"
    return [Finding("truth", FEW, words, (NO_TRUTH,), True, hint=hint)]


def of_axes(drive: Drive) -> list[Finding]:
    """Return a finding if x or y of the truth hardly changes, but the drive extends in both: it may be the height.

    In a straight corridor, wrong turns of the wheels have the same effect, but there truth and wheels move equally
    far.
    """
    truth, wheels = drive.truth, drive.wheels
    if truth is None:
        return []
    inside = (truth.t >= wheels.t[0]) & (truth.t <= wheels.t[-1])
    t, xy = truth.t[inside], truth.xy[inside]
    if len(t) < MIN_STEPS:
        return []
    path = wheels.relative(np.full(len(t), t[0]), t)[:, :2]
    _, _, axes = np.linalg.svd(path - path.mean(axis=0), full_matrices=False)
    wide, narrow = np.ptp(path @ axes.T, axis=0).tolist()
    level = np.ptp(xy, axis=0)
    if wide > MIN_EXTENT_M and level.max() < MAX_STILL_M:
        words = f"its positions stay within {level.max():.2f} m, while the wheels drive {wide:.1f} m far"
        words += ": it does not track this robot, or the wheels turn in the air"
        return [Finding("truth", AXES, words, (), True)]
    last = np.minimum(np.searchsorted(t, t + WINDOW_S), len(t) - 1)
    seen, rolled = float(((xy[last] - xy) ** 2).sum()), float(((path[last] - path) ** 2).sum())
    share = MAX_LEVEL_SHARE * narrow
    if narrow < MIN_EXTENT_M or level.min() > share or level.max() < share or seen > MAX_SEEN_SHARE * rolled:
        return []
    words = (
        f"its {'xy'[int(level.argmin())]} changes by {level.min():.2f} m only, while the robot covers "
        f"{wide:.1f} m by {narrow:.1f} m: it looks like the height. Errors by it mean nothing: record z up"
    )
    return [Finding("truth", AXES, words, (), True)]


def of_body(drive: Drive) -> list[Finding]:
    """Return a finding if the truth neither turns nor moves as the wheels do, which a sensor's turns confirm."""
    truth, wheels = drive.truth, drive.wheels
    if truth is None or truth.theta is None or len(truth.t) < MIN_STEPS:
        return []
    from .clocks import truth_lag  # imported here since it imports this file

    share, alike = turns_explained(wheels, truth.t, np.unwrap(truth.theta)), path_alike(wheels, truth.t, truth.xy)
    if share is None or share > MAX_OTHER_SHARE or alike is None or alike > MIN_ALIKE or truth_lag(drive):
        return []
    known = headings(drive.measurements).items()
    sure, best = max(((turns_explained(wheels, *h) or 0.0, name) for name, h in known), default=(0.0, ""))
    if sure < MIN_SURE_SHARE:
        return []
    words = (
        f"the wheels explain {share:.0%} of its turns, and {sure:.0%} of those of the {best}: it tracks "
        "another body, or its clock is wrong by more than a second. Errors by it mean nothing: set truth.topic to "
        "your robot's"
    )
    return [Finding("truth", OTHER, words, (), True)]


def of_copy(drive: Drive) -> list[Finding]:
    """Return a finding if the truth follows the wheels more exactly than wheels can roll: it is made of them.

    A simulator's wheels may be exact, so a file and a topic with a name of ground truth are not judged.
    """
    truth, wheels = drive.truth, drive.wheels
    if truth is None or wheels.matched is not None:
        return []
    if looks_like_truth(truth.topic) or "." in truth.topic:  # a file; names in ROS have no dots
        return []
    inside = (truth.t >= wheels.t[0]) & (truth.t <= wheels.t[-1])
    t, xy = truth.t[inside], truth.xy[inside]
    if len(t) < MIN_STEPS or (way := float(np.diff(wheels.driven(t[[0, -1]]))[0])) < MIN_COPIED_M:
        return []
    own = wheels.relative(np.full(len(t), t[0]), t)[:, :2]
    apart = math.sqrt(float(np.square(se2.off_laid_on(own, xy)).sum(axis=1).mean()))
    if apart > MAX_COPIED_SHARE * way:
        return []
    words = (
        f"it follows the wheels to {1e3 * apart:.2g} mm over {way:.0f} m, which no robot does: it is made of them "
        "(as by robot_localization), and judges nothing"
    )
    return [Finding("truth", COPY, words, (NO_TRUTH,), True)]


def of_wrong_kind(drive: Drive) -> list[Finding]:
    """Return a finding on a truth with wrong axes, in another unit, of another body, or made of the wheels."""
    return of_axes(drive) or of_unit(drive) or of_body(drive) or of_copy(drive)


def of_unit(drive: Drive) -> list[Finding]:
    """Return a finding if the truth is not in metres: its distances are a power of ten times the wheels'.

    A wrong wheel radius has the same effect. So the truth is wrong only if the wheels' speed is plausible for a
    robot, and the truth's speed is not.
    """
    factor, (slowest, fastest), speed = (wheels_metre(drive) or (1.0,))[0], ROBOT_SPEEDS_MPS, _fastest(drive)
    unit = next((u for f, u in UNITS.items() if 1.0 / MAX_UNIT_RATIO < factor / f < MAX_UNIT_RATIO), None)
    if unit is None or not slowest < speed < fastest or slowest < factor * speed < fastest:
        return []
    from .clocks import truth_lag  # imported here since it imports this file

    if (lag := truth_lag(drive)) is not None and abs(lag.offset) > WINDOW_S:
        return []  # distances at other times
    words = (
        f"its distances are {float(f'{factor:.2g}'):g} times the wheels': its unit looks like {unit}. "
        "Errors by it mean nothing until it is recorded in m"
    )
    return [Finding("truth", UNIT, words, (), True)]


def of_size(drive: Drive, motion: WallMotion | None) -> list[Finding]:
    """Return a finding if wheels and laser agree on distances, and the truth differs from both.

    `motion` compares laser and wheels by walls. If both agree, they are hardly wrong by the same factor.
    """
    truth = drive.truth
    if truth is None or motion is None or drive.wheels.matched is not None:
        return []
    # distances between two positions are not enough: noise, or a tracked point off the axle, makes them longer
    found = swing(truth, drive)
    if found is None:
        return []
    factor, sigma = found.scale, float(found.sigma[2])
    if factor == 0.0:
        return []  # a truth that stays in one place has no scale
    off, apart = abs(math.log(factor)), abs(math.log(motion.scale))
    if off < max(MIN_TRUTH_ERROR, MAX_SIZE_SIGMAS * sigma / factor) or apart > MAX_APART_SHARE * off:
        return []
    if apart + MAX_SIZE_SIGMAS * motion.scale_sigma / motion.scale > off:
        return []  # the laser may agree with the truth instead
    words = (
        f"its distances are {factor:.3f} times those of the wheels and of the laser, which agree to "
        f"{abs(motion.scale - 1.0):.1%}: its scale is wrong, or theirs if one was calibrated by the other"
    )
    return [Finding("truth", SIZE, words, (), True)]


def unusable(drive: Drive) -> Finding | None:
    """Return a finding if no error can be computed by this truth (few poses, unit, axes, jumps), else None."""
    for found in of_few(drive) or of_wrong_kind(drive):
        return found
    jumps = jumps_of(drive)
    if jumps is None or not jumps.unusable:
        return None
    words = f"{jumps.words}. Set truth.max_speed, or truth.sigma if this is its noise"
    return Finding("truth", JUMP, words, (), True)


def wheels_metre(drive: Drive) -> tuple[float, float] | None:
    """Return the ratio of truth distances to wheel distances, and its sigma; None for a short path.

    Distances between positions one of WINDOWS_S apart are compared: the shortest in which the wheels roll far
    enough for the truth's noise. In shorter windows it would increase the distances; in longer windows, and where
    the robot turns, wrong turns would change them.
    """
    truth = drive.truth
    if truth is None:
        return None
    return next((found for w in WINDOWS_S if (found := _metre_over(w, truth, drive.wheels)) is not None), None)


def _metre_over(window: float, truth: Truth, wheels: Wheels) -> tuple[float, float] | None:
    start = truth.t[(truth.t >= wheels.t[0]) & (truth.t + window <= min(wheels.t[-1], truth.t[-1]))]
    if len(start) < MIN_WINDOWS:
        return None
    step = changes(start, window, truth.t, truth.xy).T
    moved = wheels.relative(start, start + window)
    point = np.tile(truth.point, (len(start), 1))
    seen, own = np.hypot(*step), np.hypot(*(moved[:, :2] + se2.rotated(moved[:, 2], point) - point).T)
    used = (own > max(MIN_WAY_M, MIN_WAY_SIGMAS * truth.sigma)) & (seen > MIN_SEEN_M)
    straight = used & (np.abs(moved[:, 2]) < MAX_BEND_RAD)
    used = straight if straight.sum() >= MIN_WINDOWS else used
    ratio = seen[used] / own[used]
    if len(ratio) < MIN_WINDOWS:
        return None
    parts = [float(np.median(part)) for part in np.array_split(ratio, STRETCH_COUNT)]
    return float(np.median(ratio)), 1.25 * float(np.std(parts, ddof=1)) / math.sqrt(STRETCH_COUNT)


def metre(drive: Drive, robot: Robot, least: Least | None = None) -> tuple[float, list[Finding]]:
    """Return the factor that corrects the wheels' distances, and a finding if it differs from 1 significantly.

    The factor is truth distance / wheel distance; it is 1 if unknown or if the difference is smaller than `least`
    (without one: WORTH_SAYING).
    """
    found = wheels_metre(drive)
    by_driver = robot.wheels.is_of_driver
    if found is None or drive.wheels.matched is not None or (robot.wheels.radius is None and not by_driver):
        return 1.0, []
    (factor, sigma), least = found, least or WORTH_SAYING
    if abs(factor - 1.0) < least.error + least.sigmas * sigma:
        return 1.0, []
    by_fixes = drive.truth is not None and drive.truth.topic == FIXES
    source = f"by {FIXES} (± {sigma:.1%})" if by_fixes else f"by the truth (± {sigma:.1%})"
    words = f"they measure {abs(1.0 / factor - 1.0):.1%} too {'short' if factor > 1.0 else 'long'} {source}"
    fixes, rival = wheels_fix(robot, factor, sigma)
    if not fixes and robot.wheels.estimate:
        return factor, []
    return factor, [Finding("wheels", WHEEL_SCALE, words + rival, fixes, abs(factor - 1.0) > SEVERE_SCALE_ERROR)]


def wheels_fix(robot: Robot, factor: float, sigma: float) -> tuple[tuple[str, ...], str]:
    """Return settings that make wheel distances `factor` times as long, and words for an equal setting.

    The settings are () if the filter estimates the scale.
    """
    wheels = robot.wheels
    if wheels.radius is None:  # no setting changes a driver's radius: the filter estimates the scale
        return () if wheels.estimate else ("wheels.estimate=true",), ""
    track = () if wheels.track is None else (f"wheels.track={wheels.track * factor:.4g}",)  # turns stay equal
    fix, rival = size_fix(robot, factor, sigma)
    return (fix, *track), rival


def of_ways(drive: Drive, robot: Robot, run: Estimates) -> list[Finding]:
    """Return findings if distances of the wheels and of a `run` with only the laser differ."""
    rows = np.unique(drive.instant[run.sensors[0]])
    if len(rows) < 2:
        return []
    by_laser = Truth("", run.t[rows], run.pose[rows, :2], np.unwrap(run.pose[rows, 2]))
    found = swing(by_laser, drive)
    way = float(drive.wheels.driven(drive.wheels.t[-1]))
    if found is None or way <= 0.0:
        return []
    ratio, sigma = float(found.x[2]), max(float(found.sigma[2]), math.sqrt(0.5 * drive.wheels.noise / way))
    if abs(ratio - 1.0) < max(MIN_WAY_ERROR, WAY_SIGMAS * sigma) or not range_fix(robot, ratio):
        return []
    fixes = range_fix(robot, 1.0 / ratio)
    words = (
        f"laser and wheels differ by {abs(ratio - 1.0):.1%} in distance (the laser's is {ratio:.3f} times the "
        f"wheels', 1 sigma {sigma:.3f})"
    )
    hint = who_is_right(robot, 1.0 / ratio, fixes[0]) if fixes else ""
    found_too = [Finding("wheels", WHEEL_SCALE, words, wheels_fix(robot, ratio, sigma)[0])]
    return [Finding(run.sensors[0], OPEN_SCALE, words + hint, fixes), *found_too]
