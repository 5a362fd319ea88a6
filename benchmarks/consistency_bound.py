"""What no filter can beat: the least error of the path's shape on a drive of `benchmarks.consistency`.

The posterior Cramer-Rao bound (Tichavsky, Muravchik and Nehorai 1998) of a filter that is told the true walls,
from the first scan on: it uses every beam with its own noise, and the wheels with theirs. A scan is used from its
end on: the truth's stamps of the cases fall into the first half of a sweep, where the product too has only the
scan before. A filter that must learn the walls knows less.

An aligned error is that of a path in the world. A compass turns the map while it finds out where it lies, and that
bends this path; what the laser and the wheels make of the shape is the path within the map's own frame.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Drive
from locfuse.fusion.fuse import Filter
from locfuse.fusion.instants import due_readings, steps_of
from locfuse.fusion.robot import Robot
from locfuse.sample_logs.scenario import Lrf, Scenario
from locfuse.sample_logs.simulate import Outcome, Simulation
from locfuse.sample_logs.world import Plan, cast

PIECES = 12  # of a sweep: its beams are used piece by piece, with the wheels' slips in between
STEP = 1e-6  # m, rad: of the derivatives
MAX_SLOPE = 50.0  # m/m: beyond, a beam grazes a wall or passes its end by less than a step


class Bound(NamedTuple):
    """Root mean square errors of position [m] over a drive, none smaller is possible."""

    at_truth: float  # at the truth's stamps, by the scans that ended before
    after_scan: float  # at the end of every scan


class Roll(NamedTuple):
    """The drive as it was: the true poses, and how far either wheel had rolled."""

    t: Array  # (n,) s
    pose: Array  # (n, 3)
    rolled_t: Array  # (k,) s
    rolled: Array  # (k, 2) m, left and right, never falling

    def at(self, t: Array) -> tuple[Array, Array]:
        """Return the poses (m, 3) and the ways (m, 2) [m] at times t (m,)."""
        pose = np.stack([np.interp(t, self.t, column) for column in self.pose.T], axis=-1)
        return pose, np.stack([np.interp(t, self.rolled_t, column) for column in self.rolled.T], axis=-1)


def roll_of(outcome: Outcome) -> Roll:
    """Return how a simulated robot rolled."""
    steps = np.abs(np.diff(outcome.counts, axis=0, prepend=outcome.counts[:1]))
    rolled = np.cumsum(steps, axis=0) * outcome.rad_per_count * outcome.radius
    return Roll(outcome.truth_t, outcome.truth, outcome.ticks_t, rolled)


def drive_once(scenario: Scenario, seed: int) -> tuple[Roll, Plan]:
    """Drive a scenario on the truth; return how it rolled and what the laser could see."""
    simulation = Simulation(scenario, seed)
    outcome = simulation.run(None, lambda message: None)
    return roll_of(outcome), simulation.scene.plan(scenario.lrf.z)


def bound(scenario: Scenario, roll: Roll, plan: Plan) -> Bound:
    """Return the bound of one drive."""
    lrf, wheels, end = scenario.lrf, scenario.wheels, float(roll.t[-1])
    scans = np.arange(lrf.phase, end - lrf.duration, 1.0 / lrf.rate)
    stamps = np.arange(scenario.truth.phase, end, 1.0 / scenario.truth.rate)
    share = (np.arange(PIECES) + 0.5) / PIECES
    t = (scans[:, None] + lrf.duration * share).ravel()
    known = np.concatenate([information(lrf, roll, plan, s) for s in scans])
    P, last, ends = np.zeros((3, 3)), t[0], []
    at_truth = []
    for k, (now, fresh) in enumerate(zip(t.tolist(), known, strict=True)):
        if k % PIECES == 0:
            due = stamps[(stamps > last) & (stamps <= now + lrf.duration * (1.0 - share[0]))]
            at_truth += [moved(P, roll, last, stamp, wheels.noise, wheels.track) for stamp in due]
        P = moved(P, roll, last, now, wheels.noise, wheels.track)
        P = P - P @ fresh @ np.linalg.solve(np.eye(3) + P @ fresh, P)
        last = now
        if k % PIECES == PIECES - 1:
            ends.append(P)
    return Bound(_rms(at_truth), _rms(ends))


def information(lrf: Lrf, roll: Roll, plan: Plan, begin: float) -> Array:
    """Return what the beams of the scan that began then tell of the pose, (PIECES, 3, 3), piece by piece."""
    half = math.radians(lrf.field_of_view_deg) / 2.0
    angles, times = np.linspace(-half, half, lrf.beams), begin + np.linspace(0.0, lrf.duration, lrf.beams)
    pose, mount = roll.at(times)[0], np.array([lrf.x, lrf.y, math.radians(lrf.yaw_deg)])

    def ranges(off: Array, turn: float = 0.0) -> Array:
        laser = se2.compose(pose + off, mount)
        return cast(plan, laser[:, :2], laser[:, 2] + angles + turn)

    none, steps = np.zeros(3), STEP * np.eye(3)
    with np.errstate(invalid="ignore"):  # beams that hit nothing
        H = np.stack([(ranges(step) - ranges(-step)) / (2.0 * STEP) for step in steps], axis=-1)
        by_angle = (ranges(none, STEP) - ranges(none, -STEP)) / (2.0 * STEP)
    variance = lrf.sigma_range**2 + (math.radians(lrf.sigma_angle_deg) * by_angle) ** 2
    seen = (np.abs(H).max(axis=1) < MAX_SLOPE) & (ranges(none) <= lrf.range_max)
    weights = np.where(seen, (1.0 - lrf.lost) / variance, 0.0)
    H = np.where(seen[:, None], H, 0.0)
    pieces = np.array_split(np.arange(lrf.beams), PIECES)
    return np.stack([(H[rows].T * weights[rows]) @ H[rows] for rows in pieces])


def moved(P: Array, roll: Roll, begin: float, end: float, noise: float, track: float) -> Array:
    """Return the covariance (3, 3) after the wheels rolled from `begin` to `end` [s]."""
    (a, b), (before, after) = roll.at(np.array([begin, end]))
    dx, dy = (b - a)[:2].tolist()
    F = np.array([[1.0, 0.0, -dy], [0.0, 1.0, dx], [0.0, 0.0, 1.0]])
    c, s = math.cos(0.5 * (a[2] + b[2])), math.sin(0.5 * (a[2] + b[2]))
    B = np.array([[0.5 * c, 0.5 * c], [0.5 * s, 0.5 * s], [-1.0 / track, 1.0 / track]])
    out: Array = F @ P @ F.T + (B * (noise * (after - before))) @ B.T
    return out


def _rms(covariances: list[Array]) -> float:
    return math.sqrt(float(np.mean([P[0, 0] + P[1, 1] for P in covariances])))


def path_in_frame(drive: Drive, robot: Robot, sensors: tuple[str, ...]) -> Array:
    """Return the path (q, 2) [m] within the map's own frame at the truth's stamps; NaN before the frame began."""
    if drive.truth_motions is None or drive.truth_instant is None:
        raise ValueError("the drive has no truth")
    run = Filter(robot, sensors)
    local = np.full((len(drive.t), 3), np.nan)
    steps = steps_of(drive)
    for k, due in enumerate(due_readings(drive, sensors)):
        run.advance(k, steps, due, drive.measurements)
        if run.belief.framed:
            local[k] = run.belief.state[:3]
    at = drive.truth_instant
    out: Array = se2.compose(local[at], drive.truth_motions.u)[:, :2]
    out[at < 0] = np.nan
    return out


def shape_error(path: Array, truth: Array) -> float:
    """Return the root mean square distance [m] of a path (q, 2) laid on the truth (q, 2); NaN is left out."""
    known = np.isfinite(path[:, 0])
    own, true = (xy[known] @ np.array([1.0, 1.0j]) for xy in (path, truth))
    own, true = own - own.mean(), true - true.mean()
    turn = np.vdot(own, true)
    return float(np.sqrt(np.mean(np.abs(own * turn / abs(turn) - true) ** 2)))
