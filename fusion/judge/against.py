"""Reference solution: a smoothed estimate of the whole drive that replaces truth, for logs without truth.

The reference uses the same wheels as every estimate, and has the errors of its own sensors. So a sensor is judged
by a reference that does not use this sensor, and only if this reference is exact enough.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np
from msgspec.structs import replace

from locfuse.fusion.data import Array, Drive, Estimates, Evaluation, Truth, interpolate, matrices
from locfuse.fusion.streams import gap_limit

from .credit import Effect
from .evaluate import Align, evaluate

TOPIC = "reference"
MAX_SIGMA_SHARE = 1.0 / 3.0  # largest sigma of a reference / judged error: it then changes the error by 6 %
MAX_APART_SIGMAS = 3.0  # largest difference of two references; with more, one of them is wrong
MIN_ERROR_SHARE = 1e-3  # smallest true error in the interval, as a share of the measured error


class Reference(msgspec.Struct, frozen=True):
    """The smoothed estimate of a drive, used instead of truth."""

    sensors: tuple[str, ...]  # sensors that the solution uses, besides the wheels
    left_out: tuple[str, ...]  # sensors of the log that were not used
    sigma: float  # m, median over the drive of the position sigma, sqrt(P_xx + P_yy)
    drive: Drive  # the drive with the reference as its truth, at every update time

    @classmethod
    def of(cls, solved: Estimates, drive: Drive, left_out: tuple[str, ...] = ()) -> Reference:
        """Return the reference that a smoothed estimate of this drive gives."""
        spread = np.sqrt(np.maximum(solved.triangles[:, 0] + solved.triangles[:, 3], 0.0))
        truth = Truth(TOPIC, drive.t, solved.pose[:, :2], solved.pose[:, 2])
        moved = replace(drive, truth=truth, truth_motions=None, truth_instant=None)
        return cls(solved.sensors, left_out, float(np.median(spread)), moved)

    def can_judge(self, error: float | None) -> bool:
        """Return whether the reference is exact enough to measure an error of this size [m]."""
        return error is not None and self.sigma <= MAX_SIGMA_SHARE * error

    def agrees(self, other: Reference) -> bool:
        """Return whether two references of one drive differ by less than their sigmas allow."""
        assert self.drive.truth is not None
        assert other.drive.truth is not None
        apart = np.hypot(*(self.drive.truth.xy - other.drive.truth.xy).T)
        return float(np.sqrt((apart**2).mean())) <= MAX_APART_SIGMAS * math.hypot(self.sigma, other.sigma)

    def judge(self, judged: Evaluation, e: Estimates, align: Align = "none") -> Evaluation:
        """Return the evaluation of an estimate by its deviations from the reference, in place of truth.

        ANEES is None: estimate and reference share wheels and sensors, so their errors are correlated.
        """
        found = evaluate(self.seen(e), self.drive, align)
        figures = {**found.figures, "anees": None, "truth_coverage": None}
        own = {key: judged.figures[key] for key in ("duration_s", "distance_m")}
        nees = np.full(len(found.nees), np.nan)
        return replace(found, sensors=judged.sensors, figures={**figures, **own}, nees=nees, reference=True)

    def seen(self, e: Estimates) -> Estimates:
        """Return the estimate without audits, with its poses at the reference's stamps as `truth_pose`."""
        t = self.drive.t
        same = len(e.t) == len(t) and bool((e.t == t).all())
        pose, P = (e.pose, matrices(e.triangles)) if same else interpolated(t, e.t, e.pose, e.triangles)
        return replace(e, audits={}, truth_pose=pose, truth_P=P)

    def widened(self, effect: Effect, before: float, after: float) -> Effect:
        """Return an effect ln(before / after) of errors [m]; the reference's uncertainty widens its interval.

        If the errors of estimate and reference are independent, the true squared error is smaller by sigma^2. If
        they share sensors, it may be larger by up to sigma^2.
        """
        least, most = (self._bounds(error) for error in (before, after))
        low = math.log(least[0] / before) - math.log(most[1] / after)
        high = math.log(least[1] / before) - math.log(most[0] / after)
        return replace(effect, low=effect.low + low, high=effect.high + high)

    def _bounds(self, error: float) -> tuple[float, float]:
        square = error**2 - self.sigma**2
        return max(math.sqrt(max(square, 0.0)), MIN_ERROR_SHARE * error), math.hypot(error, self.sigma)


def interpolated(stamps: Array, t: Array, pose: Array, triangles: Array) -> tuple[Array, Array]:
    """Return poses (q, 3) and covariances (q, 3, 3) at stamps (q,), from rows at t (n,); NaN outside and in gaps.

    The covariance is that of the row before the stamp, since its growth between two rows is unknown.
    """
    before = np.maximum(np.searchsorted(t, stamps, side="right") - 1, 0)
    after = np.minimum(before + 1, len(t) - 1)
    exact = np.abs(stamps - t[before]) < 1e-9
    near = (stamps >= t[0]) & (stamps <= t[-1] + 1e-9) & (exact | (t[after] - t[before] <= gap_limit(t)))
    out = interpolate(stamps, t, pose)
    out[~near] = np.nan
    spread = matrices(triangles[before])
    spread[~near] = np.nan
    return out, spread
