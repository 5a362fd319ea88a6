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

from locfuse.cli.analysis.load import load
from locfuse.cli.analysis.memory import settle_heap
from locfuse.cli.analysis.settings import LogOptions
from locfuse.formats.logs.log import open_log
from locfuse.fusion import se2
from locfuse.fusion.camera.detect import Detector, detect
from locfuse.fusion.data import Drive, Measurements, Motions
from locfuse.fusion.fuse import fuse
from locfuse.fusion.lines.extract import extract_lines
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.lrf import LrfSettings

Array = NDArray[np.float64]
Work = Callable[[], int]  # does some units of work and says how many
ROUNDS = 7
SCANS = 512
# of filterpy; of a drive of half an hour, in which a run's beginning and end do not count
STEPS, LONG = 2000, 20_000
MOTION, NOISE = (0.01, 0.0001, 0.02), (1e-6, 0.0, 0.0, 1e-6, 0.0, 1e-5)
SIGMA = 0.05
WALLS = [(2.0, a, math.cos(a), math.sin(a)) for a in (0.0, 1.0, 2.0, 3.0, -1.0, -2.0)]  # rho [m], beta [rad], n


def headings(path: Path) -> tuple[Work, Work]:
    """A drive with headings, fused as the product fuses it and recorded, against as many steps of filterpy."""
    loaded = load([path], LogOptions(None, (), None, False, True), only={"compass"})
    z = np.random.default_rng(0).normal(0.0, SIGMA, (STEPS, 1))
    return (lambda: len(fuse(loaded.drive, loaded.robot, ["compass"]).t)), (lambda: filterpy(z))


def six_lines(_: Path) -> tuple[Work, Work]:
    """A drive in circles among six known walls, fused as the product does it: matched, judged and recorded too."""
    drive, robot = among_walls()
    z = np.random.default_rng(0).normal(0.0, SIGMA, (STEPS, 2 * len(WALLS)))

    def ours() -> int:
        run = fuse(drive, robot, ["lrf"])
        assert int((run.audits["lrf"].verdict == 0).sum()) > 0.99 * len(WALLS) * LONG
        return LONG

    return ours, (lambda: filterpy(z))


def among_walls() -> tuple[Drive, Robot]:
    """Return a drive of which every instant shows all walls, with a map of its first scan."""
    n, lrf = LONG + 1, LrfSettings(map="first-scan")
    u, (xx, _, _, yy, _, tt) = np.zeros((n, 3)), NOISE
    u[1:] = MOTION
    poses = np.zeros((n, 3))
    for k in range(1, n):
        poses[k] = se2.compose(poses[k - 1], u[k])
    rho, beta, c, s = np.array(WALLS).T
    x, y, theta = poses.T[:, :, None]
    z = np.stack((rho - x * c - y * s, se2.wrap_all(beta - theta)), axis=-1).reshape(-1, 2)
    z += np.random.default_rng(0).normal(0.0, SIGMA, z.shape)
    t: Array = 0.1 * np.arange(n, dtype=np.float64)
    rows = np.broadcast_to(np.eye(2), (len(z), 2, 2))
    ends = np.broadcast_to(np.array([-1.0, 1.0]), z.shape)
    seen = Measurements(t, len(WALLS) * np.arange(n + 1), z, rows, SIGMA, np.zeros((2, 2)), {"ends": ends})
    motions = Motions(u, np.broadcast_to(np.diag((xx, yy, tt)), (n, 3, 3)).copy(), np.zeros((n, 3, 0)))
    return Drive(0, t, motions, {"lrf": seen}, {"lrf": np.arange(n)}, {}), Robot(sensors={"lrf": lrf})


def jacobian() -> Array:
    """Return the derivative (12, 3) of r and psi of all walls by the pose."""
    _, _, c, s = np.array(WALLS).T
    H = np.zeros((2 * len(WALLS), 3))
    H[::2, 0], H[::2, 1], H[1::2, 2] = -c, -s, -1.0
    return H


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

    W, alone = np.diag([NOISE[0], NOISE[3], NOISE[5]]), z.shape[1] == 1
    H = np.array([[0.0, 0.0, 1.0]]) if alone else jacobian()
    rho, beta, c, s = np.array(WALLS).T

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
    "ekf_heading": headings,
    "ekf_lines": six_lines,
    "lines": lines,
    "omni": omni,
}


def timed(work: Work) -> float:
    """Return CPU seconds per unit of work."""
    begin = time.process_time()
    units = work()
    return (time.process_time() - begin) / units


if __name__ == "__main__":
    settle_heap()  # as every command does, for both
    ours, theirs = KERNELS[sys.argv[1]](Path(sys.argv[2]))
    ours(), theirs()  # warm
    rounds = [(timed(ours), timed(theirs)) for _ in range(ROUNDS)]
    print(json.dumps({"ours": [a for a, _ in rounds], "theirs": [b for _, b in rounds]}))
