"""The extended Kalman filter (paper eq. 5, 6, 10-12): predict by wheel motion, correct by innovations.

Beliefs with one interface. `PoseBelief` is the paper's 3 x 3 filter in plain floats: at this size NumPy's call
overhead is twenty times the arithmetic (benchmarks: "EKF step"). `few_blocks.FewBlocks` has a few states beside
the pose, `joint.JointBelief` any number: map lines, a compass offset, wheel parameters. All keep P symmetric by
construction and agree with a textbook filter to 1e-9 (tests/ekf/test_ekf.py).
"""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, sin

import numpy as np

from locfuse.fusion.data import Array, LocfuseError
from locfuse.fusion.sensor import Innovation, Matrix, PoseRows

from .map_frame import Together
from .rows import pose_rows

Pose = tuple[float, float, float]
Triangle = tuple[float, float, float, float, float, float]  # xx, xy, xt, yy, yt, tt
Rows = Sequence[Sequence[float]]


class PoseBelief:
    """Pose (x, y, theta) [m, m, rad] in the map and its covariance, in plain floats.

    Where a local frame has begun (map_frame), in that frame.
    """

    __slots__ = ("P", "theta", "x", "y")
    frame: int | None = None  # first column of the map frame in the state; None: the pose is that in the map

    def __init__(self, pose: Pose, P: Triangle) -> None:
        self.x, self.y, self.theta = pose
        self.P = P

    def block(self, name: str) -> tuple[int, Sequence[float]]:
        """Raise: this belief has no blocks."""
        raise KeyError(name)

    def frame_pose(self) -> Pose | None:
        """Return the map frame, where the local frame lies in the map; None: they are the same."""
        return None

    def with_frame(self) -> Together:
        """Raise: this belief has no map frame of its own."""
        raise KeyError("map frame")

    def observed(
        self, H: PoseRows, columns: tuple[int, ...] = (), H_block: Matrix = ()
    ) -> tuple[Matrix, PoseRows, tuple[int, ...], Matrix]:
        """Return H P H' and the derivatives as they are: they are by this belief's own pose."""
        return self.spread(H, columns, H_block), H, columns, H_block

    def variances(self, name: str) -> list[float]:
        """Raise: this belief has no blocks."""
        raise KeyError(name)

    def predict(self, u: Sequence[float], Q: Sequence[float], dt: float = 0.0, J: Array | None = None) -> None:
        """Paper eq. 5, 6: move by the relative pose u = (x, y, theta) whose covariance triangle is Q.

        The time that passed [s] and the derivative J of u by the wheel parameters matter to blocks only.
        """
        ux, uy, turn = u
        c, s = cos(self.theta), sin(self.theta)
        dx, dy = c * ux - s * uy, s * ux + c * uy  # eq. 5
        self.x += dx
        self.y += dy
        self.theta += turn
        xx, xy, xt, yy, yt, tt = self.P
        qxx, qxy, qxt, qyy, qyt, qtt = Q
        # eq. 6: A P A' with A of eq. 7, then the motion's noise turned into the map frame
        xt_, yt_ = xt - dy * tt, yt + dx * tt
        cc, cs, ss = c * c, c * s, s * s
        bend = 2.0 * cs * qxy
        self.P = (
            xx - dy * (xt + xt_) + cc * qxx - bend + ss * qyy,
            xy + dx * xt - dy * yt_ + cs * (qxx - qyy) + (cc - ss) * qxy,
            xt_ + c * qxt - s * qyt,
            yy + dx * (yt + yt_) + ss * qxx + bend + cc * qyy,
            yt_ + s * qxt + c * qyt,
            tt + qtt,
        )

    def spread(self, H: Rows, columns: Sequence[int] = (), H_block: Rows = ()) -> tuple[tuple[float, ...], ...]:
        """Return H P H', (d, d)."""
        xx, xy, xt, yy, yt, tt = self.P
        PH = [(xx * a + xy * b + xt * c, xy * a + yy * b + yt * c, xt * a + yt * b + tt * c) for a, b, c in H]
        return tuple(tuple(h[0] * p[0] + h[1] * p[1] + h[2] * p[2] for p in PH) for h in H)

    def correct(self, seen: Sequence[Innovation]) -> None:
        """Paper eq. 10-12, one scalar row after another.

        Every innovation was computed at the same prior, so what earlier rows have moved is taken out again:
        y <- y - H (x - x_prior). P <- P - (P h)(P h)' / s is symmetric by construction.
        """
        xx, xy, xt, yy, yt, tt = self.P
        dx = dy = dt = 0.0
        for y, a, b, c, r in pose_rows(seen):
            p0 = xx * a + xy * b + xt * c
            p1 = xy * a + yy * b + yt * c
            p2 = xt * a + yt * b + tt * c
            s = a * p0 + b * p1 + c * p2 + r  # eq. 10: the gain is p / s
            e = (y - a * dx - b * dy - c * dt) / s
            dx += p0 * e  # eq. 11
            dy += p1 * e
            dt += p2 * e
            g0, g1, g2 = p0 / s, p1 / s, p2 / s  # eq. 12
            xx -= g0 * p0
            xy -= g0 * p1
            xt -= g0 * p2
            yy -= g1 * p1
            yt -= g1 * p2
            tt -= g2 * p2
        self.x += dx
        self.y += dy
        self.theta += dt
        self.P = (xx, xy, xt, yy, yt, tt)

    def shift(self, turn: float, xy: float, theta: float) -> None:
        """Turn the pose by `turn` [rad] and add variances xy [m^2] and theta [rad^2]: a slip was found."""
        xx, xy_, xt, yy, yt, tt = self.P
        self.theta += turn
        self.P = (xx + xy, xy_, xt, yy + xy, yt, tt + theta)

    def place(self, pose: Pose, xy: float, theta: float) -> None:
        """Set the pose with variances xy [m^2] and theta [rad^2]: the robot was kidnapped, or found again."""
        self.x, self.y, self.theta = pose
        self.P = (xy, 0.0, 0.0, xy, 0.0, theta)

    def pose(self) -> Pose:
        """Return (x, y, theta)."""
        return self.x, self.y, self.theta

    def located(self) -> tuple[Pose, Triangle]:
        """Return the pose and its covariance's upper triangle."""
        return (self.x, self.y, self.theta), self.P

    def triangle(self) -> Triangle:
        """Return the pose covariance's upper triangle."""
        return self.P

    def matrix(self) -> Array:
        """Return the pose covariance, (3, 3)."""
        xx, xy, xt, yy, yt, tt = self.P
        return np.array([[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]])


def too_far_apart(S: float) -> LocfuseError:
    """Return what to raise where an innovation's variance S came out as none: rounding ate it."""
    return LocfuseError(
        f"the filter's variances span too many powers of ten to be computed with (innovations of up to {S:.0e}): "
        "are the sigmas and floors of robot.toml meant so?"
    )
