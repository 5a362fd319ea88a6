"""The paper's filter as printed: every 100 ms it uses the newest reading of every sensor (eq. 16).

Its measurements (lines, headings, bearings) are those of locfuse's filter, so that only the filters differ; their
rows z - h(x) and H are as printed. docs/paper.md describes how gaps in the printed equations are filled.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from locfuse.fusion import se2
from locfuse.fusion.data import (
    Array,
    Drive,
    Estimates,
    Ints,
    LocfuseError,
    MapLine,
    Measurements,
    RowVerdict,
    interpolate,
    totals,
    upper_triangles,
)
from locfuse.fusion.ekf.record import Record
from locfuse.fusion.fuse import BLOCK_INSTANTS, configuration_name
from locfuse.fusion.kernels.ekf import Innovation
from locfuse.fusion.progress import report_progress
from locfuse.fusion.robot import Robot

from . import equations
from .equations import PRINTED

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


TO_RIGHT = math.pi / 2  # 0 degrees point right in the paper's scans, ahead in the base frame


class MeasurementRow(NamedTuple):
    """One measurement in eq. 16."""

    seen: Innovation
    H: Array  # (d, 3) by the pose


class LineRows:
    """Rows for lines (r, psi), compared with the map of the first scan; this map counts as exact."""

    def __init__(self, robot: Robot) -> None:
        self.R = equations.eq19_R(1, compass=False, camera=False)
        self.map: list[tuple[float, float]] = []  # (rho, beta)
        self.ends: list[tuple[float, float]] = []
        self.hits: list[int] = []

    def rows(self, m: Measurements, i: int, x: Array, P: Array) -> list[MeasurementRow]:
        """Return the rows for the lines of scan i, each with the nearest map line.

        The first scan becomes the map. The predicted pose is x (3,) with covariance P (3, 3).
        """
        lines = range(int(m.first[i]), int(m.first[i + 1]))
        if not self.map:
            self._remember(m, lines, x)
            return [unmatched(row, RowVerdict.NEW) for row in lines]
        return [self._row(row, float(m.z[row, 0]), float(m.z[row, 1]) + TO_RIGHT, x, P) for row in lines]

    def _remember(self, m: Measurements, lines: range, x: Array) -> None:
        for row in lines:
            rho, beta = equations.eq14_line(x, float(m.z[row, 0]), float(m.z[row, 1]) + TO_RIGHT)
            along = float(x[1]) * math.cos(beta) - float(x[0]) * math.sin(beta)
            low, high = (m.extra["ends"][row] + along).tolist()
            self.map.append((rho, beta))
            self.ends.append((low, high))
            self.hits.append(1)

    def _row(self, row: int, r: float, psi: float, x: Array, P: Array) -> MeasurementRow:
        j, dr, dpsi = self._nearest(r, psi, x)
        if j < 0:
            return unmatched(row, RowVerdict.UNMATCHED)
        self.hits[j] += 1
        rho, beta = self.map[j]
        C = equations.eq17_C(rho, beta, float(x[0]), float(x[1]))
        return innovation(row, j, np.array([dr, dpsi]), equations.eq13_H_line(C, beta), self.R, P)

    def _nearest(self, r: float, psi: float, x: Array) -> tuple[int, float, float]:
        """Return the nearest map line and the differences in r and psi; -1 if none is in the window."""
        best, least = (-1, math.nan, math.nan), math.inf
        for j, (rho, beta) in enumerate(self.map):
            C = equations.eq17_C(rho, beta, float(x[0]), float(x[1]))
            r_, psi_ = equations.eq18_prediction(C, beta, float(x[2]))
            dr, dpsi = r - r_, se2.wrap(psi - psi_)
            far = max(abs(dr) / PRINTED.window_r, abs(dpsi) / PRINTED.window_psi)
            if far <= 1.0 and (distance := math.hypot(dr / PRINTED.window_r, dpsi / PRINTED.window_psi)) < least:
                best, least = (j, dr, dpsi), distance
        return best

    def lines(self) -> list[MapLine]:
        """Return the lines of the map, with covariances of zero."""
        known = zip(self.map, self.ends, self.hits, strict=True)
        return [MapLine(j, rho, beta, ends, np.zeros((2, 2)), n) for j, ((rho, beta), ends, n) in enumerate(known)]


class CompassRow:
    """Row for the compass heading phi; if no offset is configured, the first reading defines the offset."""

    def __init__(self, robot: Robot) -> None:
        offset = robot.settings("compass").offset_deg
        self.offset = None if offset is None else math.radians(offset)
        self.R = equations.eq19_R(0, compass=True, camera=False)

    def rows(self, m: Measurements, i: int, x: Array, P: Array) -> list[MeasurementRow]:
        """Return the row for heading i."""
        z, theta = float(m.z[i, 0]), float(x[2])
        if self.offset is None:
            self.offset = z - theta
        y = se2.wrap(z - self.offset - theta)
        return [innovation(i, -1, np.array([y]), equations.eq13_H_heading(), self.R, P)]


class CameraRow:
    """Row for the camera's heading gamma: direction from start pose to landmark, minus measured bearing."""

    def __init__(self, robot: Robot) -> None:
        settings, start = robot.settings("camera"), robot.start
        if settings.landmark is None:
            raise LocfuseError("camera.landmark is not set;", role="camera", hint="--set camera.landmark=[X,Y]")
        self.direction = math.atan2(settings.landmark[1] - start.y, settings.landmark[0] - start.x)
        self.yaw = math.radians(settings.yaw_deg)
        self.R = equations.eq19_R(0, compass=False, camera=True)

    def rows(self, m: Measurements, i: int, x: Array, P: Array) -> list[MeasurementRow]:
        """Return the row for the largest candidate of picture i."""
        row = int(m.first[i])
        if row == int(m.first[i + 1]):
            return []
        gamma = self.direction - (float(m.z[row, 0]) + self.yaw)
        y = se2.wrap(gamma - float(x[2]))
        return [innovation(row, 0, np.array([y]), equations.eq13_H_heading(), self.R, P)]


def innovation(row: int, landmark: int, y: Array, H: Array, R: Array, P: Array) -> MeasurementRow:
    """Return an accepted row with y (d,), H (d, 3), R (d, d); the paper has no gate."""
    S = H @ P @ H.T + R
    nis = float(y @ np.linalg.solve(S, y))
    sigma = np.sqrt(np.maximum(np.diag(S), 0.0))
    return MeasurementRow(Innovation(row, 0, landmark, nis, math.inf, tuple(y.tolist()), tuple(sigma.tolist())), H)


def unmatched(row: int, verdict: int) -> MeasurementRow:
    """Return the row of a line without a match."""
    return MeasurementRow(Innovation.unpredicted(row, verdict, 2, math.inf), np.zeros((0, 3)))


MeasurementEquation = LineRows | CompassRow | CameraRow
# in the order of eq. 16
PARTS: dict[str, type[MeasurementEquation]] = {"lrf": LineRows, "compass": CompassRow, "camera": CameraRow}
