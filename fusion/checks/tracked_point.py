"""Checks of the body point that a truth tracks, of the direction of its body, and of an odometry's body point."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Drive, Ints, Truth, interpolate, totals
from locfuse.fusion.robot import Robot
from locfuse.fusion.statistics import Plane, jackknife, off_turned, robust, robust_with_sigmas
from locfuse.fusion.wheels.motion import Wheels
from locfuse.fusion.wheels.odometry import on_base

from .finding import Finding

POINT, CREEP = "body point", "sideways"  # codes of the findings on the tracked point, on sideways motion
YAW = "body yaw"  # code of the finding on the direction of the tracked body
MIN_CREEP, CREEP_SIGMAS, MIN_YAW_ERROR_RAD = 0.008, 5.0, math.radians(5.0)  # m per m; standard errors
MIN_MOVED_SHARE = 0.3  # of the wheels' steps, by the truth
MIN_POINT_ERROR_M, SEVERE_POINT_ERROR_M, POINT_SIGMAS = 0.01, 0.05, 4.0  # m; standard errors, of the tracked point
AHEAD, MIN_AHEAD_M = "ahead", 0.03  # code of the finding on an odometry's body point, m of a reported one
MAX_REST = 0.5  # largest share of the odometry's sideways motion that its body point leaves
APART_SIGMAS, MIN_APART_M = 6.0, 0.1  # standard errors of x and of y, one of which may be unclear; m
MIN_SCALE_SHARE = 0.05  # least share of a path's squared steps that no tracked point explains, to find its scale
WINDOW_S = 1.0  # s over which steps are compared
MIN_WINDOWS, STRETCH_COUNT = 20, 8  # windows; stretches of the drive, for the jackknife
MIN_TURN_RAD = math.radians(60.0)  # range of the headings
# tracked point by positions alone: s in which the wheels' heading error is constant; steps of the path, of Gauss-
# Newton, and of its numeric slopes (m, 1, s); least chi-square that a lag explains
MIN_LAG_CHI2 = 9.0
FRAME_S, MAX_FITTED_STEPS, GAUSS_NEWTON_STEPS, STEP_OF_SLOPE = 10.0, 2000, 5, 1e-3


def axle_path(truth: Truth, wheels: Wheels) -> Array | None:
    """Return the axle's path (n, 2) [m, map frame] from wheel distances and truth headings, at the truth's stamps.

    The wheels' turns are not used, since slip changes them. None for a truth without headings.
    """
    if truth.theta is None:
        return None
    theta = np.interp(wheels.t, truth.t, np.unwrap(truth.theta))
    turn = np.diff(theta)
    chord = wheels.twist[:, :2] * np.sinc(turn / (2.0 * np.pi))[:, None]
    path = totals(se2.rotated(theta[:-1] + 0.5 * turn, chord))
    return interpolate(truth.t, wheels.t, path)


class Swing(NamedTuple):
    """Fit of the base's path to the truth's motion: tracked point, scale of the path, sideways motion."""

    x: Array  # (4,) tracked point (x, y) [m], scale of the path, sideways motion [m per m]
    sigma: Array  # (4,)
    lag: tuple[float, float] | None = None  # s to add to the truth's stamps, and its sigma; None: not seen

    @property
    def moves(self) -> bool:
        """Whether the truth moves about as far as the wheels, which only slip if the robot turns on the spot."""
        return math.hypot(self.x[2], self.x[3]) > MIN_MOVED_SHARE

    @property
    def aside(self) -> float:
        """Angle from the truth's headings to the directions of travel [rad]."""
        return math.atan2(self.x[3], self.x[2])

    @property
    def scale(self) -> float:
        """Length of the truth's steps / length of the path's steps; wrong headings only turn the steps."""
        return math.hypot(*self.x[2:])


def swing(truth: Truth, drive: Drive, path: Array | None = None) -> Swing | None:
    """Fit tracked point, path scale and sideways motion to the truth; None if the robot hardly turns.

    The point is at p(t) = base + R(theta) l. So its step is the step of the base, times a factor and rotated by a
    small angle (sideways motion), plus (R(theta') - R(theta)) l. `path` (n, 2) [m] are the base's positions at the
    truth's stamps, NaN where unknown; by default those of the axle by the wheels.
    """
    path = axle_path(truth, drive.wheels) if path is None else path
    if path is None or truth.theta is None or np.ptp(np.unwrap(truth.theta)) < MIN_TURN_RAD:
        return None
    wheels = drive.wheels
    last = np.searchsorted(truth.t, truth.t + WINDOW_S)
    first = np.flatnonzero((last < len(truth.t)) & (truth.t >= wheels.t[0]))
    known = (truth.t[last[first]] <= wheels.t[-1]) & np.isfinite(path[first] + path[last[first]]).all(axis=1)
    first = first[known]
    if len(first) < MIN_WINDOWS:
        return None
    last = last[first]
    # with points as complex numbers a step is turned * l + rolled * (scale + i sideways)
    columns = np.exp(1.0j * truth.theta), path @ (1.0, 1.0j), truth.xy @ (1.0, 1.0j)
    turned, rolled, y = (c[last] - c[first] for c in columns)
    if not _tells_point(turned, rolled):
        return None
    A = np.stack((turned, rolled), axis=-1)

    def fitted(some: Ints) -> Array:
        return robust(A[some], y[some])[0].view(np.float64)

    return Swing(fitted(np.arange(len(y))), jackknife(fitted, len(y), STRETCH_COUNT))


def swing_by_positions(truth: Truth, drive: Drive) -> Swing | None:
    """Fit tracked point l, path scale s and lag to a truth without headings; None if the robot hardly turns.

    Over WINDOW_S, a step of the truth is c (s dp + dr l). The axle's step dp and the change dr of exp(i theta) are
    those of the wheels. The factor c, of length 1, turns the wheels' frame to the truth's; it is constant in every
    FRAME_S. It is found for each l, s and lag, which are found by Gauss-Newton steps. At a constant speed, a lag
    has the effect of a point further back, so it is 0 unless it explains the steps much better.
    """
    wheels = drive.wheels
    inside = (truth.t >= wheels.t[0]) & (truth.t <= wheels.t[-1])
    t, seen = truth.t[inside], truth.xy[inside] @ (1.0, 1.0j)
    last = np.searchsorted(t, t + WINDOW_S)
    first = np.flatnonzero(last < len(t))
    first = first[:: 1 + len(first) // MAX_FITTED_STEPS]
    if len(first) < MIN_WINDOWS:
        return None
    ends, y = np.stack((t[first], t[last[first]])), seen[last[first]] - seen[first]
    part = ((t[first] - t[0]) / FRAME_S).astype(np.int64)

    def steps(lag: float) -> tuple[Plane, Plane]:
        _, _, pose = wheels.at(np.clip(ends + lag, wheels.t[0], wheels.t[-1]))
        turned, rolled = (
            np.diff(c, axis=0)[0] for c in (np.exp(1.0j * pose[..., 2]), pose[..., :2] @ (1.0, 1.0j))
        )
        return turned, rolled

    if np.ptp(wheels.heading(t)) < MIN_TURN_RAD or not _tells_point(*steps(0.0)):
        return None

    def rest(x: Array, some: Ints) -> Array:
        turned, rolled = steps(float(x[3]))
        moved = (rolled * x[2] + turned * complex(x[0], x[1]))[some]
        own = off_turned(y[some], moved, part[some])
        return np.concatenate((own.real, own.imag))

    def fitted(some: Ints, x: Array, free: Array, count: int) -> Array:
        for _ in range(count):
            own = rest(x, some)
            slopes = [(own - rest(x + d, some)) / STEP_OF_SLOPE for d in STEP_OF_SLOPE * free]
            x = x + robust(np.stack(slopes, axis=-1), own)[0] @ free
        return x

    def found(free: Array) -> tuple[Array, float]:
        x = fitted(every, np.array([*truth.point, 1.0, 0.0]), free, GAUSS_NEWTON_STEPS)
        return x, float((rest(x, every) ** 2).sum() + 1e-12)

    def swing_of(x: Array, free: Array) -> Swing:
        sigma = np.broadcast_to(jackknife(lambda some: fitted(some, x, free, 2), len(y), STRETCH_COUNT), 4)
        lag = (float(x[3]), float(sigma[3])) if len(free) > 3 else None
        return Swing(np.append(x[:3], 0.0), np.append(sigma[:3], 0.0), lag)

    every, unit = np.arange(len(y)), np.eye(4)
    (x, left), (late, late_left) = found(unit[:3]), found(unit)
    # windows overlap: each adds the numbers of one period
    chi = 2.0 * len(y) * min(1.0, float(np.median(np.diff(t[first]))) / WINDOW_S) * math.log(left / late_left)
    swing = swing_of(late, unit) if chi >= MIN_LAG_CHI2 else None
    if swing is not None and swing.lag is not None and abs(swing.lag[0]) >= POINT_SIGMAS * swing.lag[1]:
        return swing
    return swing_of(x, unit[:3])


def _tells_point(turned: Plane, rolled: Plane) -> bool:
    """Return whether a path shows the difference between a tracked point beside the axle and a scale error.

    On a circle, both have the same effect. `turned` has the changes of exp(i theta), `rolled` the steps of the
    path.
    """
    square, length = (float(np.vdot(one, one).real) for one in (turned, rolled))
    if 2.0 * square < 1.0:
        return False
    alone = rolled - turned * (np.vdot(turned, rolled) / square)
    return float(np.vdot(alone, alone).real) > MIN_SCALE_SHARE * length


def of_point(truth: Truth, found: Swing | None) -> list[Finding]:
    """Return a finding if the tracked point is not the configured one."""
    if found is None:
        return []
    (x, y), sigma, configured = found.x[:2].tolist(), float(np.hypot(*found.sigma[:2])), truth.point
    away = math.hypot(x - configured[0], y - configured[1])
    apart = float(np.hypot(*((found.x[:2] - configured) / np.maximum(found.sigma[:2], 1e-9))))
    unclear = apart < APART_SIGMAS or away < MIN_APART_M
    if away < MIN_POINT_ERROR_M or (away < POINT_SIGMAS * sigma and unclear):
        return []
    words = (
        f"it swings as the body point ({x:.3f}, {y:.3f}) m does (1 sigma {sigma:.3f}), not "
        f"({configured[0]:g}, {configured[1]:g}): a tracked marker off the axle"
    )
    return [Finding("truth", POINT, words, (f"truth.x={x:.3f}", f"truth.y={y:.3f}"), away > SEVERE_POINT_ERROR_M)]


def of_yaw(found: Swing | None, robot: Robot) -> list[Finding]:
    """Return a finding if the truth's headings are not the directions of travel, by more than wheels can creep."""
    if found is None or not found.moves:
        return []
    if abs(found.aside) < MIN_YAW_ERROR_RAD + CREEP_SIGMAS * float(found.sigma[3]):
        return []
    yaw = math.degrees(se2.wrap(math.radians(robot.truth.yaw_deg) - found.aside))
    words = f"{_sideways(found)}, more than wheels can creep: the tracked body is turned on the robot"
    return [Finding("truth", YAW, words, (f"truth.yaw_deg={yaw:.1f}",), True)]


def of_creep(found: Swing | None) -> list[Finding]:
    """Return a finding if, by the truth, the robot drives sideways to its heading."""
    if found is None or not found.moves or abs(found.aside) < max(MIN_CREEP, CREEP_SIGMAS * float(found.sigma[3])):
        return []
    words = f"{_sideways(found)}: wheels that creep sideways, or a truth whose headings are off by that"
    return [Finding("wheels", CREEP, words)]


def _sideways(found: Swing) -> str:
    aside, sigma = math.degrees(found.aside), math.degrees(float(found.sigma[3]))
    return (
        f"by the truth the robot drives {abs(aside):.1f}° to the {'left' if aside > 0.0 else 'right'} of where it "
        f"points (1 sigma {sigma:.1g}°)"
    )


def of_odometry(drive: Drive, robot: Robot) -> tuple[list[Finding], Drive]:
    """Return a finding if an odometry moves sideways in turns, as a body ahead of the axle does, and the drive.

    A body at x on the base moves sideways by x times the turn. A driver that moves a step along the heading of the
    step's begin or end has sideways motion too, as a body half a step away: this is not reported. If the truth's
    point shows that the axle is meant, the drive is that of the axle; if it shows the body, nothing is reported.
    """
    (ahead, left, turn), wheels, truth = drive.wheels.twist.T, drive.wheels, drive.truth
    if wheels.matched is not None or not left.any() or float(np.abs(turn).sum()) < MIN_TURN_RAD:
        return [], drive
    (aside, x), sigmas = robust_with_sigmas(np.stack((ahead, turn), axis=-1), left, STRETCH_COUNT)
    least = max(MIN_AHEAD_M + float(np.percentile(np.abs(ahead), 90.0)), POINT_SIGMAS * float(sigmas[1]))
    other = left - ahead * aside
    if abs(x) < least or float(np.abs(other - turn * x).sum()) > MAX_REST * float(np.abs(other).sum()):
        return [], drive
    if truth is not None and (seen := swing(truth, drive)) is not None:
        off = float(seen.x[0]) - truth.point[0]
        if abs(off) < 0.5 * abs(x):
            return [], drive
        if abs(off + x) < 0.5 * abs(x):
            twist = on_base(wheels.twist, float(x), 0.0)
            drive = replace(drive, wheels=Wheels.from_twists(wheels.t, twist, wheels.track, wheels.noise))
    words = (
        f"in turns they move sideways by {abs(x):.3f} m per radian (1 sigma {sigmas[1]:.3f}): the poses look like "
        f"those of a body {abs(x):.2f} m {'ahead of' if x > 0.0 else 'behind'} the axle"
    )
    return [Finding("wheels", AHEAD, words, (f"wheels.x={robot.wheels.x + x:.3f}",))], drive
