"""Inner loops against public packages, taking turns in one process: python -m benchmarks.kernels NAME LOG.

Prints {"ours": [s per unit, ...], "theirs": [...]} as JSON, CPU time, one entry per round.
"""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks import textbook_lines
from locfuse.formats.log.log import open_log
from locfuse.fusion.camera.detect import Detector, detect
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.lines.extract import extract_lines
from locfuse.fusion.sensor import Innovation

Array = NDArray[np.float64]
Work = Callable[[], int]  # does some units of work and says how many
ROUNDS = 7
SCANS = 512
STEPS = 2000
MOTION, NOISE = (0.04, 0.001, 0.02), (1e-6, 0.0, 0.0, 1e-6, 0.0, 1e-5)
SIGMA = 0.05
WALLS = [(2.0, a, math.cos(a), math.sin(a)) for a in (0.0, 1.0, 2.0, 3.0, -1.0, -2.0)]  # rho [m], beta [rad], n


def filters(lines: bool) -> tuple[Work, Work]:
    """One step of the 3 x 3 filter: predict, then correct by a heading or by six lines (r, psi)."""
    rng = np.random.default_rng(0)
    z = rng.normal(0.0, SIGMA, (STEPS, 12 if lines else 1))
    return (lambda: our_filter(z)), (lambda: filterpy(z))


def our_filter(z: Array) -> int:
    """Predict and correct with the product's filter."""
    belief = JointBelief((0.0, 0.0, 0.0), (0.01, 0.0, 0.0, 0.01, 0.0, 0.01))
    alone = z.shape[1] == 1
    H_lines = [((-c, -s, 0.0), (0.0, 0.0, -1.0)) for _, _, c, s in WALLS]
    r, R = SIGMA**2, ((SIGMA**2, 0.0), (0.0, SIGMA**2))
    for row in z.tolist():
        belief.predict(MOTION, NOISE)
        if alone:
            off = (row[0] - belief.theta,)
            seen = [Innovation(0, 0, -1, 0.0, 0.0, off, off, ((0.0, 0.0, 1.0),), ((r,),))]
        else:
            seen, (x, y, theta) = [], belief.pose()
            for k, ((rho, beta, c, s), H) in enumerate(zip(WALLS, H_lines, strict=True)):
                e = (row[2 * k] + x * c + y * s - rho, row[2 * k + 1] - beta + theta)
                seen.append(Innovation(k, 0, k, 0.0, 0.0, e, e, H, R))
        belief.correct(seen)
    return len(z)


def filterpy(z: Array) -> int:
    """Predict and correct with filterpy's filter, everything one instant saw stacked."""
    from filterpy.kalman import ExtendedKalmanFilter

    class Robot(ExtendedKalmanFilter):  # type: ignore[misc]
        x: Array

        def predict_x(self, u: tuple[float, float, float] = MOTION) -> None:
            c, s = math.cos(self.x[2]), math.sin(self.x[2])
            step = np.array([c * u[0] - s * u[1], s * u[0] + c * u[1], u[2]])
            turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
            self.x = self.x + step
            self.F = np.array([[1.0, 0.0, -step[1]], [0.0, 1.0, step[0]], [0.0, 0.0, 1.0]])
            self.Q = turn @ W @ turn.T

    rho, beta, c, s = np.array(WALLS).T
    H_lines = np.zeros((12, 3))
    H_lines[::2, 0], H_lines[::2, 1], H_lines[1::2, 2] = -c, -s, -1.0
    W, alone = np.diag([NOISE[0], NOISE[3], NOISE[5]]), z.shape[1] == 1
    H = np.array([[0.0, 0.0, 1.0]]) if alone else H_lines

    def expected(x: Array) -> Array:
        if alone:
            return x[2:]
        return np.stack((rho - x[0] * c - x[1] * s, beta - x[2]), axis=1).ravel()

    ekf = Robot(dim_x=3, dim_z=len(H))
    ekf.x, ekf.P, ekf.R = np.zeros(3), 0.01 * np.eye(3), SIGMA**2 * np.eye(len(H))
    for row in z:
        ekf.predict(MOTION)
        ekf.update(row, lambda x: H, expected)
    return len(z)


def scans(path: Path) -> tuple[Array, Array]:
    """Return the first scans of a log (n, b) and their angles (b,)."""
    columns = open_log([path]).stream("/scan").columns("ranges", "angle_min", "angle_increment")
    ranges: Any = columns["ranges"]
    matrix = ranges.matrix()[:SCANS].astype(float)
    start, step = (float(np.asarray(columns[name])[0]) for name in ("angle_min", "angle_increment"))
    return matrix, start + step * np.arange(matrix.shape[1])


def icp(matrix: Array, angles: Array) -> int:
    """Align every scan of a few with the one before."""
    import small_gicp

    some = matrix[:48]
    points = np.stack((some * np.cos(angles), some * np.sin(angles), 0 * some), axis=-1)
    for before, now in pairwise(points):
        small_gicp.align(before, now, registration_type="ICP", downsampling_resolution=0.01)
    return len(points) - 1


def lines(path: Path) -> tuple[Work, Work]:
    """Lines of a scan against ICP of the same scans."""
    matrix, angles = scans(path)
    return (lambda: len(extract_lines(matrix, angles).first) - 1), (lambda: icp(matrix, angles))


def recursion(path: Path) -> tuple[Work, Work]:
    """Lines of a scan against recursive split-and-merge, scan by scan, in NumPy."""
    matrix, angles = scans(path)
    return (
        lambda: len(extract_lines(matrix, angles).first) - 1,
        lambda: sum(1 for scan in matrix[:64] if textbook_lines.extract(scan, angles) is not None),
    )


def omni(path: Path) -> tuple[Work, Work]:
    """Bearing of the landmark, decoding included, against decoding alone."""
    import cv2

    column: Any = open_log([path]).stream("/omni/image/compressed").columns("data")["data"]
    jpegs = [bytes(data) for data in column][:60]
    detector = Detector()

    def ours() -> int:
        return sum(1 for data in jpegs if not isinstance(detect((data, "jpeg"), detector), str))

    def theirs() -> int:
        return sum(1 for d in jpegs if cv2.imdecode(np.frombuffer(d, np.uint8), cv2.IMREAD_COLOR) is not None)

    return ours, theirs


KERNELS: dict[str, Callable[[Path], tuple[Work, Work]]] = {
    "ekf_heading": lambda path: filters(lines=False),
    "ekf_lines": lambda path: filters(lines=True),
    "lines": lines,
    "lines_recursive": recursion,
    "omni": omni,
}


def timed(work: Work) -> float:
    """Return CPU seconds per unit of work."""
    begin = time.process_time()
    units = work()
    return (time.process_time() - begin) / units


if __name__ == "__main__":
    ours, theirs = KERNELS[sys.argv[1]](Path(sys.argv[2]))
    ours(), theirs()  # warm
    rounds = [(timed(ours), timed(theirs)) for _ in range(ROUNDS)]
    print(json.dumps({"ours": [a for a, _ in rounds], "theirs": [b for _, b in rounds]}))
