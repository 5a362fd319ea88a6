"""The paper's filter as printed: every 100 ms it uses the newest reading of every sensor (eq. 16).

Its measurements (lines, headings, bearings) are those of locfuse's filter, so that only the filters differ.
docs/paper.md describes how gaps in the printed equations are filled.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from locfuse.fusion.data import Array, Drive, Estimates, Ints, LocfuseError, interpolate, totals, upper_triangles
from locfuse.fusion.ekf.record import Record
from locfuse.fusion.fuse import BLOCK_INSTANTS, configuration_name
from locfuse.fusion.progress import report_progress
from locfuse.fusion.robot import Robot

from . import equations
from .equations import PRINTED
from .rows import PARTS, LineRows, MeasurementRow

MAX_STAMP_ROUNDING_S = 1e-9  # s: largest rounding error of a stamp on the grid
MAX_STEPS = 2_000_000  # with 100 bytes each; this is more than two days


def fuse_as_printed(
    drive: Drive,
    robot: Robot,
    sensors: Sequence[str],
    name: str | None = None,
    listen: Mapping[str, NDArray[np.bool_]] | None = None,
) -> Estimates:
    """Run the printed filter with these sensors; arguments and result are those of `fuse.fuse`.

    Between two steps, the wheels predict the pose, so that errors do not include the delay. Raises LocfuseError if
    the drive lacks a sensor, or if the paper has no equation for it.
    """
    listen = listen or {}
    for sensor in (*sensors, *listen):
        if sensor not in drive.measurements:
            raise drive.lacks(sensor)
        if sensor not in PARTS:
            hint = "leave it out, or use --preset default"
            raise LocfuseError("the paper has no equation for it;", role=sensor, hint=hint)
    run = PrintedFilter(drive, robot, sensors, listen)
    for k in range(len(run.grid)):
        if k % BLOCK_INSTANTS == 0:
            report_progress(k / len(run.grid))
        run.step(k)
    report_progress(None)
    return run.estimates(name or configuration_name(sensors, drive))


def _grid(end: float, period: float) -> Array:
    """Return the times (m,) [s] of the filter's steps. Raises LocfuseError for more than MAX_STEPS."""
    if end / period > MAX_STEPS:
        raise LocfuseError(
            f"--preset paper steps every {period:g} s, and this drive of {end:.3g} s has {end / period:.3g} "
            f"steps; {MAX_STEPS} are the most. Fuse a part of it with --from and --to"
        )
    return np.arange(0.0, end + MAX_STAMP_ROUNDING_S, period)


class PrintedFilter:
    """Filter with the equations as printed in the paper: state, measurements and the record of a run."""

    def __init__(
        self, drive: Drive, robot: Robot, sensors: Sequence[str], listen: Mapping[str, NDArray[np.bool_]]
    ) -> None:
        self.drive, self.listen = drive, listen
        self.grid = _grid(float(drive.t[-1]), PRINTED.period)
        self.counts = totals(drive.wheels.rolled)  # (n, 2) m, left, right until each reading of the encoders
        latest = np.searchsorted(drive.wheels.t, self.grid + MAX_STAMP_ROUNDING_S, side="right") - 1
        self.rolled = np.diff(self.counts[np.maximum(latest, 0)], axis=0, prepend=0.0)  # (m, 2) by step
        self.L = float(drive.wheels.track)
        self.dt_R = PRINTED.period * (robot.wheels.radius or 1.0)  # odometry has no radius; any value cancels out
        self.x = np.array(robot.start.pose)
        self.P = np.diag(robot.start.variances)
        self.used = tuple(s for s in drive.measurements if s in sensors)
        self.parts = {s: part(robot) for s, part in PARTS.items() if s in sensors or s in listen}
        self._newest = {s: newest(self.grid, drive.measurements[s].t) for s in self.parts}
        self._records = {s: Record() for s in self.parts}
        self._poses = np.empty((len(self.grid), 3))
        self._covariances = np.empty((len(self.grid), 3, 3))

    def step(self, k: int) -> None:
        """Run one sampling period: predict by the wheels, correct by the newest readings."""
        self.x, self.P = self.predict(self.x, self.P, self.rolled[k])
        seen: dict[str, list[MeasurementRow]] = {}
        for sensor, part in self.parts.items():
            i = int(self._newest[sensor][k])
            if i >= 0:
                found = part.rows(self.drive.measurements[sensor], i, self.x, self.P)
                self._records[sensor].add(int(self.drive.instant[sensor][i]), [row.seen for row in found])
                listens = sensor in self.listen and bool(self.listen[sensor][i])
                seen[sensor] = [] if listens else [row for row in found if row.seen.verdict == 0]
        self.correct(seen)
        self._poses[k], self._covariances[k] = self.x, self.P

    def predict(self, x: Array, P: Array, rolled: Array) -> tuple[Array, Array]:
        """Return pose and covariance by eq. 2, 3, 6-9, for rolled distances (..., 2) [m] of left and right wheel.

        The missing factor dt R of eq. 8 is added: as printed, the noise of a step at 0.4 m/s is 108 degrees.
        """
        ds, dtheta = equations.eq2_increments(rolled[..., 1], rolled[..., 0], self.L)
        A = equations.eq7_A(ds, dtheta, x[..., 2])
        W = self.dt_R * equations.eq8_W(ds, dtheta, x[..., 2], self.L)
        omega = rolled / self.dt_R
        Q = equations.eq9_Q(PRINTED.delta, omega[..., 1], omega[..., 0])
        return equations.eq3_motion(x, ds, dtheta), equations.eq6_P(P, A, W, Q)

    def correct(self, seen: dict[str, list[MeasurementRow]]) -> None:
        """Correct by eq. 10-12 with all measurements stacked as in eq. 16."""
        stacked = [row for sensor in PARTS for row in seen.get(sensor, [])]
        if not stacked:
            return
        y = np.concatenate([row.seen.y for row in stacked])
        H = np.concatenate([row.H for row in stacked])
        lines, compass, camera = (len(seen.get(sensor, [])) for sensor in PARTS)
        R = equations.eq19_R(lines, bool(compass), bool(camera))
        K = equations.eq10_K(self.P, H, R)
        self.x, self.P = equations.eq11_x(self.x, K, y), equations.eq12_P(K, H, self.P)

    def at(self, t: Array) -> tuple[Array, Array]:
        """Return pose (n, 3) and covariance (n, 3, 3) at times t (n,) [s], predicted from the step before."""
        k = np.clip(np.searchsorted(self.grid, t + MAX_STAMP_ROUNDING_S, side="right") - 1, 0, len(self.grid) - 1)
        begin, end = (interpolate(at, self.drive.wheels.t, self.counts) for at in (self.grid[k], t))
        moved = end - begin
        return self.predict(self._poses[k], self._covariances[k], moved)

    def estimates(self, name: str) -> Estimates:
        """Return the estimates at the drive's update times and at the truth's stamps."""
        drive = self.drive
        pose, P = self.at(drive.t)
        truth = drive.truth
        truth_pose, truth_P = (None, None) if truth is None else drive.at_truth(lambda *_: self.at(truth.t))
        lines = [line for part in self.parts.values() if isinstance(part, LineRows) for line in part.lines()]
        return Estimates(
            configuration=name,
            sensors=self.used,
            t=drive.t,
            pose=pose,
            triangles=upper_triangles(P),
            audits={s: self._records[s].audit() for s in drive.measurements if s in self._records},
            first_map=lines,
            final_map=lines,
            truth_pose=truth_pose,
            truth_P=truth_P,
            notes=tuple(self._notes()),
        )

    def _notes(self) -> list[str]:
        """Return notes on the readings that the filter leaves out because of its fixed period."""
        notes = []
        for sensor, used in self._newest.items():
            n = len(self.drive.measurements[sensor].t)
            if late := n - int((used >= 0).sum()):
                words = f"{late} of {n} readings were not the newest of their 100 ms and are not used"
                notes.append(f"{sensor}: {words}")
        return notes


def newest(grid: Array, t: Array) -> Ints:
    """Return the index of the newest reading since the previous step, (m,); -1 if there is none.

    t (n,) [s] are the sorted times of the readings.
    """
    last = np.searchsorted(t, grid + MAX_STAMP_ROUNDING_S, side="right") - 1
    before = np.concatenate(([-1], last[:-1]))
    return np.where(last > before, last, -1)
