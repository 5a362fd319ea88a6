"""Rows of the paper's measurement equation (16) for each sensor: z - h(x) and H, as printed."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, LocfuseError, MapLine, Measurements, RowVerdict
from locfuse.fusion.kernels.ekf import Innovation
from locfuse.fusion.robot import Robot

from . import equations
from .equations import PRINTED

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
