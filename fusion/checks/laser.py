"""Compare walls seen in two scans, to check the laser's distance scale and mount yaw, and the wheels' track.

When the laser moves by d, the distance of a wall with normal n decreases by y = n.d. A fit of y = a n.d + b
n.(Jd), with the rotation J by 90 degrees, to many walls gives the laser's distance scale 1 / sqrt(a^2 + b^2) and
its yaw error. The change of the wall's direction is the robot's turn. Walls that are seen while the robot turns
show whether the beams of a scan are measured in the configured order.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple, cast

import numpy as np
from msgspec.structs import replace

from locfuse.fusion import se2
from locfuse.fusion.data import Array, ArrayStream, Drive, Ints, Mask, Measurements, Ragged, Stream, totals
from locfuse.fusion.lines.scans import SCAN_FIELDS, scan_period
from locfuse.fusion.mount import SIGMA_M
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.lrf import Lrf, LrfSettings
from locfuse.fusion.statistics import MIN_SQUARES, best_split, jackknife, robust, robust_sigma
from locfuse.fusion.streams import seconds, taken
from locfuse.fusion.wheels.motion import Wheels

from .finding import Finding, Least

PAIR_DISTANCE_M, PAIR_TURN_RAD = 0.3, 0.35  # m, rad between the two positions, whichever comes first
MAX_PAIR_TIME_S = 4.0  # s between the two scans
MAX_PAIRS = 1500
# difference from the wheels' motion, beyond which it is another wall
MAX_WALL_TURN_RAD, MAX_WALL_SHIFT_M = math.radians(8.0), 0.25
MIN_SCANS, MIN_WALLS = 20, 60  # scans; walls seen twice
MAX_ITERATIONS = 3  # of the pairing
# first guesses if the configured yaw does not fit
OTHER_YAWS_RAD = (math.pi, 0.5 * math.pi, -0.5 * math.pi)
# unexplained share of the walls' distance changes: for a good fit, for a usable one
MAX_REST, MAX_TELLING_REST = 0.5, 1.0
MIN_APPROACH_M = 0.01  # m
MAX_INVERSE_SHARE = (
    0.75  # of the rest that another yaw alone leaves: medians of MIN_WALLS walls differ less by chance
)
STRETCH_COUNT = 8  # stretches of the drive whose estimates must agree
MIN_SCALE_ERROR, MIN_YAW_ERROR_RAD, MIN_SIGMAS = 0.03, math.radians(4.0), 3.0
WORTH_SAYING = Least(MIN_SCALE_ERROR, MIN_SIGMAS)
SEVERE_SCALE_ERROR, SEVERE_YAW_ERROR_RAD = 0.05, math.radians(8.0)
MIN_RANGE_FACTOR, MAX_RANGE_FACTOR = 0.5, 2.0  # plausible factors on a laser's distances
OPEN_SCALE = "distances"  # code: laser and wheels differ, the log does not show which is wrong
BUMP = "bumped"  # code of the finding on a step of its yaw
SLIPPING = "slips"  # code of the finding on wheels that slip sideways
# of wheels that drive sideways: least ratio of the ways in both directions, largest correlation of turns with the
# way sideways. A body off the axle moves sideways in turns only
MIN_SIDEWAYS_SHARE, MAX_OF_TURNS = 0.2, 0.7
MIN_BUMP_RAD, BUMP_SIGMAS = math.radians(1.5), 5.0  # rad; standard errors, as the best of many times is taken
BUMP_STRETCHES = 20  # of the drive, with independent errors
MIN_BUMP_SHARE = 0.2  # of the walls, before and after the step: 4 stretches, whose spread is known
MAX_RADIUS_MISFIT = 0.5  # difference of two errors with one cause, as a share of the smaller error
MAX_POWER_ERROR = 0.1  # relative, of a factor that is a power of 2: 29 % of all factors are so near one by chance
MIN_CORRELATION = 0.9  # of turns by walls and by wheels: with less, turns by wheels are noise
MIN_TURN_SQUARES_RAD2 = 0.5  # rad^2, smallest sum of squared turns: on a straight path they are noise


class WallPairs(NamedTuple):
    """k pairs of measurements of one wall from two positions of the laser, in time order."""

    y: Array  # (k,) decrease of the wall's distance [m]
    n: Array  # (k, 2) normals in the base frame at the first place
    d: Array  # (k, 2) motion of the laser, same frame [m]
    turn: Array  # (k,) turn of the robot by the wall's direction [rad]
    by_wheels: Array  # (k,) turn of the robot by the wheels [rad]
    t: Array  # (k,) time at the second position [s]
    since: Array  # (k,) time at the first position [s]


class WallMotion(NamedTuple):
    """Distance scale and yaw error of the laser, and turn ratio of the wheels, by walls seen in two scans."""

    scale: float  # wheel distance per laser distance
    scale_sigma: float
    yaw: float  # rad, configured minus true yaw
    yaw_sigma: float
    turns: float | None  # turn of the robot per turn by the wheels; None if it hardly turned
    turns_sigma: float  # for this drive
    walls: int
    by_slips: float = 0.0  # 1 sigma of the difference of `turns` between drives by slip
    bump: tuple[float, float] | None = None  # s, rad: time and size of a step of its yaw
    inverse: tuple[float, float] | None = None  # m, x and y of the inverse of the configured mount, if that fits


def laser_motion(drive: Drive, robot: Robot, offset: float) -> WallMotion | None:
    """Return distance scale and yaw error of the laser, and turn ratio of the wheels, by walls seen in two scans.

    Return None for too few walls. `offset` [s] is added to the laser's times to convert them to the wheels' clock.
    """
    m = drive.measurements.get("lrf")
    if m is None or len(m.t) <= MIN_SCANS:
        return None
    settings, t = robot.settings("lrf"), m.t + offset
    mount = np.array([settings.x, settings.y])
    found = _looking(m, t, drive, mount, 0.0)
    if found is None or found.rest > MAX_REST:  # walls pair wrongly if it looks backward or sideways
        others = (_looking(m, t, drive, mount, yaw) for yaw in OTHER_YAWS_RAD)
        best = min((f for f in others if f is not None), key=lambda f: f.rest, default=None)
        if best is not None and best.rest < MAX_REST and (found is None or best.rest < 0.5 * found.rest):
            found = best
    if found is None:
        return None
    walls, scale, yaw = found.walls, found.scale, se2.wrap(found.yaw)
    sigmas = _spread(fitted, walls) if found.rest < MAX_TELLING_REST else np.array(math.inf)
    scale_sigma, yaw_sigma = np.broadcast_to(sigmas, 2).tolist()
    turns, turns_sigma = turned(walls), float(_spread(turned, walls))
    by_slips = slip_sigma(drive.wheels, t)
    bump = bumped(walls, scale)
    far = abs(yaw) > MIN_YAW_ERROR_RAD + MIN_SIGMAS * yaw_sigma
    inverse = _inverse(m, t, drive, settings, found) if far else None
    return WallMotion(
        scale, scale_sigma, yaw, yaw_sigma, turns, turns_sigma, len(walls.y), by_slips, bump, inverse
    )


def _inverse(
    m: Measurements, t: Array, drive: Drive, settings: LrfSettings, found: Looking
) -> tuple[float, float] | None:
    """Return x, y [m] of the inverse of the configured mount, if walls fit this mount clearly better; else None.

    Parent and child of the mount's transform are then exchanged. `found` is the fit with only another yaw.
    """
    yaw = math.radians(settings.yaw_deg)
    mount = np.array([settings.x, settings.y])
    place = -se2.rotated(np.array([-yaw]), mount)[0]
    if abs(se2.wrap(found.yaw - 2.0 * yaw)) > MIN_YAW_ERROR_RAD or not np.abs(place - mount).max() > SIGMA_M:
        return None
    other = _looking(_turned(m, 0.0, mount, place), t, drive, place, 2.0 * yaw)
    better = other is not None and other.rest < MAX_INVERSE_SHARE * found.rest
    return (float(place[0]), float(place[1])) if better else None


def bumped(walls: WallPairs, scale: float) -> tuple[float, float] | None:
    """Return the time [s] and size [rad] of a step of the laser's yaw during the drive; None without a step.

    A least-squares fit has one yaw before a time and another yaw after it; the time is that of the best fit.
    """
    n, edge = len(walls.y), math.ceil(MIN_BUMP_SHARE * len(walls.y))
    if edge < MIN_WALLS:
        return None
    along, across = _along_across(walls)
    rest = walls.y - along / scale
    limit = 3.0 * max(robust_sigma(rest), 1.5e-4)
    rest, across = np.clip(rest, -limit, limit), across / scale
    split = best_split(across, rest, edge)
    left = rest - across * np.where(np.arange(n) <= split.at, split.before, split.after)
    by_walls = float(left.std()) * math.hypot(*split.sigmas)
    # errors by slip are correlated between neighbouring walls
    at = split.at + 1
    counts = [max(4, round(BUMP_STRETCHES * part / n)) for part in (at, n - at)]
    halves = list(zip(*(np.split(c, [at]) for c in (across, left, _by_mount(walls))), counts, strict=True))
    by_stretches = math.hypot(*(_slope_sigma(a, rest, stretches) for a, rest, _, stretches in halves))
    slopes = [a @ moved / max(float(a @ a), MIN_SQUARES) for a, _, moved, _ in halves]
    by_mount = SIGMA_M * float(np.hypot(*(slopes[0] - slopes[1])))
    change = split.before - split.after  # of the true yaw: both slopes are configured minus true yaw
    least = max(MIN_BUMP_RAD, BUMP_SIGMAS * math.hypot(max(by_walls, by_stretches), by_mount))
    return (float(walls.t[split.at]), change) if abs(change) > least else None


def _slope_sigma(across: Array, left: Array, stretches: int) -> float:
    """Return the sigma of the slope of residuals `left` (k,) over `across` (k,).

    The residuals may be correlated within each of `stretches` > 3 consecutive parts (cluster-robust standard
    error). As the parts are few, it is multiplied by the standard deviation of Student's t.
    """
    parts = (np.array_split(column, stretches) for column in (across, left))
    scores = np.array([float(a @ b) for a, b in zip(*parts, strict=True)])
    squares = max(float(across @ across), MIN_SQUARES)
    return math.sqrt(stretches / (stretches - 3) * float(scores @ scores)) / squares


def _by_mount(walls: WallPairs) -> Array:
    """Return the decrease of each wall's distance (k, 2) per metre of an error of the mount in x and in y."""
    (c, s), (x, y) = (np.cos(walls.by_wheels) - 1.0, np.sin(walls.by_wheels)), walls.n.T
    return np.stack((c * x + s * y, c * y - s * x), axis=-1)


def _along_across(walls: WallPairs) -> tuple[Array, Array]:
    """Return the laser's motion along each wall's normal, and to the left of it, (k,) [m] each."""
    n, d = walls.n, walls.d
    return (n * d).sum(axis=1), n[:, 1] * d[:, 0] - n[:, 0] * d[:, 1]


def of_slipping(drive: Drive, robot: Robot, stream: Callable[[str], Stream]) -> list[Finding]:
    """Return a finding on wheels that drive sideways, and measure that in another scale than the way ahead.

    `stream` returns the raw readings of a role.
    """
    ways, m = np.abs(drive.wheels.twist).sum(axis=0), drive.measurements.get("lrf")
    both = min(ways[:2]) > MIN_SIDEWAYS_SHARE * max(ways[:2])
    if m is None or drive.wheels.matched is not None or not both or not ways[2]:
        return []
    if abs(np.corrcoef(drive.wheels.twist[:, 1:].T)[0, 1]) > MAX_OF_TURNS:
        return []
    settings = robot.settings("lrf")
    found = _looking(m, m.t, drive, np.array([settings.x, settings.y]), 0.0)
    share = None if found is None or found.rest > MAX_REST else slipping(found.walls)
    if found is None or share is None:
        return []
    sigma = float(_spread(slipping, found.walls))
    if not abs(share - 1.0) > WORTH_SAYING.error + WORTH_SAYING.sigmas * sigma:
        return []
    size = f"{abs(share - 1.0):.1%} too {'short' if share < 1.0 else 'long'}"
    words = (
        f"by the laser's walls the ways sideways are {size} if those ahead are right (1 sigma {sigma:.1%}): they "
        "slip, and no scale corrects that. Use the motion from scan to scan"
    )
    fix = f"wheels.topic={stream('lrf').topic}"
    return [Finding("wheels", SLIPPING, words, (fix,), abs(share - 1.0) > SEVERE_SCALE_ERROR)]


class Looking(NamedTuple):
    """Fit of the laser's distance scale and yaw error to walls, from one initial guess of the yaw."""

    walls: WallPairs
    scale: float  # wheel distance per laser distance
    yaw: float  # rad, configured minus true yaw
    rest: float  # unexplained distance change of walls over the whole one: medians


def _looking(m: Measurements, t: Array, drive: Drive, mount: Array, yaw: float) -> Looking | None:
    """Fit the laser's scale and yaw error to walls, from an initial error `yaw` [rad]; None with too few walls."""
    for _ in range(MAX_ITERATIONS):  # pairs get better with a better yaw
        walls = seen_twice(_turned(m, yaw, mount), t, drive, mount)
        if (fit := fitted(walls)) is None:
            return None
        scale, yaw = fit[0], yaw + fit[1]
        if abs(fit[1]) < MIN_YAW_ERROR_RAD:
            break
    along, _ = _along_across(walls)
    rest = float(np.median(np.abs(walls.y - along / scale)))
    return Looking(walls, scale, yaw, rest / max(float(np.median(np.abs(along))), MIN_APPROACH_M))


def _turned(m: Measurements, yaw: float, mount: Array, place: Array | None = None) -> Measurements:
    """Return the lines in the base frame for a laser yaw that is `yaw` [rad] less than configured.

    If it is given, the laser is at `place`, not at `mount` (2,) [m].
    """
    r, psi = m.z.T
    own = r - np.cos(psi) * mount[0] - np.sin(psi) * mount[1]
    psi, (x, y) = psi - yaw, mount if place is None else place
    return replace(m, z=np.stack((own + np.cos(psi) * x + np.sin(psi) * y, psi), axis=-1))


def of_radius(motion: WallMotion | None, robot: Robot, tried: bool = False) -> list[Finding]:
    """Return a finding on the wheel radius if distances and turns of the wheels are wrong by the same factor.

    A wrong range scale does not change turns, and a wrong track does not change distances, but a wrong radius
    changes both. If the caller tries the fix (`tried`), the mean of both factors must be significant, and the
    factors nearer to each other than to 1. Errors below 3 % are not reported even then: without truth a trial
    cannot tell a radius from a range scale beside turns that are wrong by slip. If the factors differ
    significantly, the distances alone determine the radius. No range scale is wrong by more than a factor of 2:
    beyond that the factors need not be equal, as walls that are paired by such wheels bias both.
    """
    radius = robot.wheels.radius
    if motion is None or radius is None or motion.turns is None:
        return []
    scales = np.array((1.0 / motion.scale, motion.turns))
    # slip may be constant within one drive, and is different on another one
    sigmas = motion.scale_sigma / motion.scale**2, max(motion.turns_sigma, motion.by_slips)
    if not all(math.isfinite(s) and s > 0.0 for s in sigmas):
        return []
    weights = 1.0 / np.square(sigmas)
    factor, sigma = float(scales @ weights / weights.sum()), float(weights.sum() ** -0.5)
    off, apart = np.abs(scales - 1.0), abs(float(scales[0] - scales[1]))
    alike = apart < WORTH_SAYING.sigmas * math.hypot(*sigmas)
    near = apart < (1.0 if tried else MAX_RADIUS_MISFIT) * float(off.min())
    known = (sigma, sigma) if tried else sigmas
    gross = bool((scales < MIN_RANGE_FACTOR).all() or (scales > MAX_RANGE_FACTOR).all())
    small = off < [WORTH_SAYING.error + WORTH_SAYING.sigmas * s for s in known]
    if not near or not (alike or tried or gross) or small.any():
        return []
    if not alike:
        factor, sigma = float(scales[0]), sigmas[0]
    words = (
        f"by the laser's walls they measure ways and turns {1.0 / factor:.3f} times as long as these are (1 sigma "
        f"{sigma:.3f}): a wrong radius does both"
    )
    fix, rival = size_fix(robot, factor, sigma)
    return [Finding("wheels", "radius", words + rival, (fix,), abs(factor - 1.0) > SEVERE_SCALE_ERROR)]


def size_fix(robot: Robot, factor: float, sigma: float) -> tuple[str, str]:
    """Return the setting that makes ways of counted wheels `factor` times as long, and words for an equal one.

    An encoder of n lines counts n, 2 n or 4 n edges per revolution, so a factor that is a power of 2, within its
    uncertainty and that of the radius, comes from a wrong number of ticks.
    """
    radius, ticks = robot.wheels.radius or 0.0, robot.wheels.ticks_per_revolution
    power, by_radius = 2.0 ** -round(math.log2(factor)), f"wheels.radius={radius * factor:.4g}"
    rest = WORTH_SAYING.error + WORTH_SAYING.sigmas * sigma * power  # an error of the radius that is not reported
    if ticks is None or power == 1.0 or abs(factor * power - 1.0) > min(rest, MAX_POWER_ERROR):
        return by_radius, ""
    words = f". A wrong number of ticks does that (encoders count 1, 2 or 4 edges per line), or {by_radius}"
    return f"wheels.ticks_per_revolution={ticks * power:g}", words


def of_laser(
    motion: WallMotion | None, robot: Robot, metre: float = 1.0, least: Least | None = None, by_truth: bool = False
) -> list[Finding]:
    """Return findings on the laser's distance scale and yaw.

    `metre` is the factor by which another fix changes the wheels' distances. Scale errors below `least` are not
    reported. `by_truth`: the wheels' distances match the truth; else either the laser or the wheels may be wrong.
    """
    if motion is None:
        return []
    settings, least = robot.settings("lrf"), least or WORTH_SAYING
    if motion.bump is not None:
        t, change = motion.bump
        words = (
            f"its direction on the robot turns by {math.degrees(change):+.1f}° at about {t:.0f} s: it was bumped"
        )
        return [Finding("lrf", BUMP, words, severe=True)]
    if abs(motion.yaw) > MIN_YAW_ERROR_RAD + MIN_SIGMAS * motion.yaw_sigma:
        yaw = se2.wrap(math.radians(settings.yaw_deg) - motion.yaw)
        words = (
            f"walls come nearer as they would with a yaw of {math.degrees(yaw):z.0f} deg, not of "
            f"{settings.yaw_deg:.0f} deg as configured"
        )
        fixes: tuple[str, ...] = (f"lrf.yaw_deg={math.degrees(yaw):z.1f}",)
        if motion.inverse is not None:
            x, y = motion.inverse
            words += ": its transform seems to be inverted, with parent and child exchanged"
            fixes = f"lrf.x={x:z.4g}", f"lrf.y={y:z.4g}", f"lrf.yaw_deg={-settings.yaw_deg:z.4g}"
        return [Finding("lrf", "yaw", words, fixes, abs(motion.yaw) > SEVERE_YAW_ERROR_RAD)]
    scale = motion.scale * metre
    if abs(scale - 1.0) < least.error + least.sigmas * motion.scale_sigma:
        return []
    by_truth = by_truth or metre != 1.0
    whose = "truth" if by_truth else "wheels"
    words = (
        f"it measures {abs(1.0 / scale - 1.0):.1%} too {'short' if scale > 1.0 else 'long'} by the {whose} "
        f"(± {motion.scale_sigma:.1%})"
    )
    fixes = range_fix(robot, scale)
    words += "" if by_truth or not fixes else who_is_right(robot, scale, fixes[0])
    code = "range scale" if by_truth else OPEN_SCALE
    return [Finding("lrf", code, words, fixes, abs(scale - 1.0) > SEVERE_SCALE_ERROR)]


def range_fix(robot: Robot, factor: float) -> tuple[str, ...]:
    """Return the setting that multiplies the laser's distances by `factor`; () for an implausible factor."""
    if not MIN_RANGE_FACTOR < factor < MAX_RANGE_FACTOR:
        return ()
    return (f"lrf.range_scale={float(robot.settings('lrf').range_scale) * factor:.4g}",)


def fitted(walls: WallPairs) -> tuple[float, float] | None:
    """Return the laser's scale (wheel distance per laser distance) and yaw error [rad]; None for few walls."""
    x = _solved(walls, np.stack(_along_across(walls), axis=-1))
    length = 0.0 if x is None else float(np.hypot(*x))
    return (1.0 / length, math.atan2(float(x[1]), float(x[0]))) if x is not None and length > 0.2 else None


def slipping(walls: WallPairs) -> float | None:
    """Return the way sideways by the wheels per true way, if the ways ahead are right; None for few walls."""
    x = _solved(walls, np.column_stack((walls.n * walls.d, _along_across(walls)[1])))
    return None if x is None or min(x[:2]) < MIN_RANGE_FACTOR else float(x[0] / x[1])


def _solved(walls: WallPairs, A: Array) -> Array | None:
    """Return the robust least-squares solution (c,) of A (k, c) for the walls' distances; None for few walls."""
    if len(A) < MIN_WALLS:
        return None
    x, keep = robust(A, walls.y)
    return x if keep.sum() >= MIN_WALLS else None


def turned(walls: WallPairs) -> float | None:
    """Return the ratio robot turn / wheel turn by walls; None for small turns or if the walls disagree."""
    rest = np.abs(walls.turn - walls.by_wheels)
    near = rest < MAX_WALL_TURN_RAD
    c = _slope(walls, near)
    if c is None:
        return None
    scatter = robust_sigma(rest[near]) + 1e-3
    return _slope(walls, near & (np.abs(walls.turn - c * walls.by_wheels) < 3.0 * scatter))


def slip_sigma(wheels: Wheels, t: Array) -> float:
    """Return the relative sigma that slip alone causes in a ratio of turns, for readings at t (n,) [s]."""
    if wheels.noise <= 0.0 or len(t) < 2:
        return 0.0
    t = np.clip(t, wheels.t[0], wheels.t[-1])
    turn = np.diff(wheels.heading(t))
    variance = wheels.slips(np.stack((t[:-1], t[1:]), axis=-1))[:, 0].sum(axis=-1) / wheels.track**2
    squares = float(turn @ turn)
    return math.sqrt(float(turn**2 @ variance)) / squares if squares > 0.0 else 0.0


def _slope(walls: WallPairs, rows: Mask) -> float | None:
    turn, by_wheels = walls.turn[rows], walls.by_wheels[rows]
    squares = float((by_wheels**2).sum())
    if squares < MIN_TURN_SQUARES_RAD2 or float(np.corrcoef(turn, by_wheels)[0, 1]) < MIN_CORRELATION:
        return None
    return float((turn * by_wheels).sum()) / squares


def _spread(estimate: Callable[[WallPairs], Any], walls: WallPairs) -> Array:
    """Return the standard errors of `estimate(walls)`: one stretch of the drive is left out at a time (jackknife).

    Pairs of scans overlap, so they are not independent. In turns, a position error of the mount by SIGMA_M changes
    scale and yaw: these changes are added. The result is infinite if an estimate is None.
    """
    errors = jackknife(
        lambda some: estimate(WallPairs(*(column[some] for column in walls))), len(walls.y), STRETCH_COUNT
    )
    moved = [walls._replace(y=walls.y + SIGMA_M * nearer) for nearer in _by_mount(walls).T]
    found = [estimate(some) for some in (walls, *moved)]
    if any(f is None for f in found):
        return np.array(math.inf)
    whole, x, y = np.array(found)
    spread: Array = np.sqrt(errors**2 + (x - whole) ** 2 + (y - whole) ** 2)
    return spread


def seen_twice(m: Measurements, t: Array, drive: Drive, mount: Array) -> WallPairs:
    """Return walls seen in two scans, paired by the wheels' motion between the scans."""
    first, second = map(_evenly, _places(t, drive))
    moved = drive.wheels.relative(t[first], t[second])
    swing = se2.rotated(moved[:, 2], mount) - mount
    rows: list[WallPairs] = []
    for k, (i, j) in enumerate(zip(first.tolist(), second.tolist(), strict=True)):
        a, b = m.z[m.first[i] : m.first[i + 1]], m.z[m.first[j] : m.first[j + 1]]
        if len(a) and len(b):
            rows.append(_paired(a, b, moved[k], moved[k, :2] + swing[k], mount, (float(t[i]), float(t[j]))))
    if not rows:
        return WallPairs(*(np.zeros((0, 2) if name in "nd" else 0) for name in WallPairs._fields))
    return WallPairs(*(np.concatenate(column) for column in zip(*rows, strict=True)))


def _places(t: Array, drive: Drive) -> tuple[Ints, Ints]:
    """Return pairs of scans, indices (k,) each, between which the robot moved or turned far enough."""
    wheels = drive.wheels
    way = np.hypot(*wheels.twist[:, :2].T)
    step = np.maximum(way / PAIR_DISTANCE_M, np.abs(wheels.twist[:, 2]) / PAIR_TURN_RAD)
    gone = np.interp(t, wheels.t, totals(step))
    second = np.searchsorted(gone, gone + 1.0)
    first = np.flatnonzero(second < len(t))
    first = first[t[second[first]] - t[first] < MAX_PAIR_TIME_S]
    return first, second[first]


def _evenly(places: Ints) -> Ints:
    """Return about MAX_PAIRS of these scans, evenly chosen."""
    return places[:: max(1, len(places) // MAX_PAIRS)]


def _paired(a: Array, b: Array, moved: Array, d: Array, mount: Array, t: tuple[float, float]) -> WallPairs:
    """Return the pairs of lines a (k, 2) and b (l, 2), of scans at two times t [s], that are the same wall."""
    n = np.stack((np.cos(a[:, 1]), np.sin(a[:, 1])), axis=-1)
    r, psi = a[:, 0] - n @ moved[:2], a[:, 1] - moved[2]
    turn = np.abs(se2.wrap_all(psi[:, None] - b[None, :, 1]))
    shift = np.abs(r[:, None] - b[None, :, 0])
    near = (turn < MAX_WALL_TURN_RAD) & (shift < MAX_WALL_SHIFT_M)
    cost = np.where(near, turn / MAX_WALL_TURN_RAD + shift / MAX_WALL_SHIFT_M, np.inf)
    nearest = cost.argmin(axis=1)
    best = cost[np.arange(len(a)), nearest]
    # only unambiguous pairs are used
    good = np.isfinite(best) & ((cost < best[:, None] + 0.7).sum(axis=1) == 1)
    b_near = b[nearest[good]]
    n_b = np.stack((np.cos(b_near[:, 1]), np.sin(b_near[:, 1])), axis=-1)
    y = (a[good, 0] - n[good] @ mount) - (b_near[:, 0] - n_b @ mount)
    k = int(good.sum())
    own = moved[2] + se2.wrap_all(a[good, 1] - b_near[:, 1] - moved[2])
    return WallPairs(y, n[good], np.tile(d, (k, 1)), own, np.full(k, moved[2]), np.full(k, t[1]), np.full(k, t[0]))


def who_is_right(robot: Robot, scale: float, fix: str) -> str:
    """Return a text with two alternative fixes: one if the wheels are right, one if the laser is right."""
    wheels = robot.wheels
    if wheels.radius is None:
        return f". If the odometry is right, set {fix}; if lrf is, the odometry has a wrong wheel radius"
    track = "" if wheels.track is None else f" and wheels.track={wheels.track / scale:.4g}"
    return f". If the wheels are right, set {fix}; if lrf is, wheels.radius={wheels.radius / scale:.4g}{track}"


# ---- the order in which the beams are measured ----

MIN_RATE_RADPS = 0.3  # rad/s, least difference of the turn rates of two scans: an equal distortion shows nothing
MIN_PAIRS = 60  # least number of walls seen at such different turn rates
MAX_MISFIT_RATIO = 0.65  # largest ratio of the misfits with the reverse and with the configured order
RATE_STEP_S = 0.1  # s over which the turn rate is taken
MAX_SWEPT_MISFIT_RAD = math.radians(1.0)  # with more, a sweep is not the error, or not the only one
UNSWEPT = "unswept"  # code of the finding on scans without the time between two beams
ORDERS = {"forward": "backward", "backward": "forward"}


def of_sweep(stream: Stream, drive: Drive, robot: Robot, offset: float) -> list[Finding]:
    """Return a finding if walls seen while turning fit clearly better in the reverse order of the beams.

    Without `time_increment` the finding is that they fit better if a scan lasts as long as the time between two.

    Deskewing with `time_increment` corrects a scan for the robot's turn; in the wrong order of beams it doubles
    the error. A driver may reverse the ranges but leave time_increment positive. `offset` [s] is added to the
    laser's times: the wheels' clock.
    """
    settings = cast("LrfSettings", robot.settings("lrf"))
    if not settings.deskew or not len(drive.measurements["lrf"].t):
        return []
    settings = replace(settings, time_offset=settings.time_offset + offset)
    pairs = _places(seconds(stream.t_ns, drive.epoch_ns, settings.time_offset), drive)
    rows = np.unique(np.concatenate([_evenly(scans) for scans in pairs]))  # only these scans are compared
    if not len(rows):
        return []
    period, stream = scan_period(stream.t_ns), taken(stream, rows, *SCAN_FIELDS)
    other = ORDERS[settings.sweep]
    now = _misfit(stream, drive, settings)
    if now is not None and not np.any(cast("Array", stream.data["time_increment"])):
        return _unswept(stream, drive, settings, period, now)
    then = None if now is None else _misfit(stream, drive, replace(settings, sweep=other))
    if now is None or then is None or then > MAX_MISFIT_RATIO * now:
        return []
    first = "last" if other == "backward" else "first"
    words = (
        f"the directions of walls seen in turns are wrong by {math.degrees(now):.1f}°, but by "
        f"{math.degrees(then):.1f}° if each scan begins with its {first} beam: it sweeps {other}"
    )
    return [Finding("lrf", "sweep", words, (f"lrf.sweep={other}",), True)]


def _unswept(stream: ArrayStream, drive: Drive, settings: LrfSettings, period: float, now: float) -> list[Finding]:
    """Return a finding if walls fit clearly better if a sweep lasts `period` [s]; `now` [rad] is the misfit."""
    lengths = cast("Ragged", stream.data["ranges"]).lengths
    each = period / float(np.median(lengths))  # s
    swept = replace(stream, data={**stream.data, "time_increment": np.full(len(lengths), each)})
    orders = [(_misfit(swept, drive, replace(settings, sweep=order)), order) for order in ORDERS]
    then, order = min(((misfit, order) for misfit, order in orders if misfit is not None), default=(math.inf, ""))
    if then > min(MAX_MISFIT_RATIO * now, MAX_SWEPT_MISFIT_RAD):
        return []
    words = (
        f"time_increment is 0: the directions of walls seen in turns are wrong by {math.degrees(now):.1f}°, but "
        f"by {math.degrees(then):.1f}° if a scan takes {period:.2g} s ({order}). Write the time between two beams "
        f"(about {each:.2g} s) in the driver"
    )
    return [Finding("lrf", UNSWEPT, words, (), True)]


def _misfit(stream: Stream, drive: Drive, settings: LrfSettings) -> float | None:
    """Return the median difference [rad] of wall directions seen at different turn rates; None for few walls.

    The effect of a slightly wrong clock, proportional to the difference of the rates, is subtracted.
    """
    m: Measurements = Lrf().measure(stream, settings, drive.wheels, drive.epoch_ns)
    walls = seen_twice(m, m.t, drive, np.array([settings.x, settings.y]))
    rate = _rate(drive.wheels, walls.t) - _rate(drive.wheels, walls.since)
    off = walls.turn - walls.by_wheels
    use = (np.abs(rate) > MIN_RATE_RADPS) & (np.abs(off) < MAX_WALL_TURN_RAD)
    if use.sum() < MIN_PAIRS:
        return None
    late, keep = robust(rate[use, None], off[use])
    return float(np.median(np.abs(off - late * rate)[use][keep])) if keep.sum() >= MIN_PAIRS else None


def _rate(wheels: Wheels, t: Array) -> Array:
    """Return the wheels' turn rates [rad/s] at t (k,) [s]."""
    begin, end = (np.clip(t + s, wheels.t[0], wheels.t[-1]) for s in (-0.5 * RATE_STEP_S, 0.5 * RATE_STEP_S))
    return (wheels.heading(end) - wheels.heading(begin)) / RATE_STEP_S
