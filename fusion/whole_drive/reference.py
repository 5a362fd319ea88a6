"""References: smoothed estimates of the whole drive that replace a missing truth, by all sensors and without each.

drive, robot -> sets of sensors to solve -> smoothed drive with each set -> the reference for each evaluation

A reference uses the same wheels as every estimate, and has the errors of its own sensors. So a sensor is judged by
a reference that does not use this sensor, and only if this reference is exact enough.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence

import msgspec
import numpy as np
from msgspec.structs import replace

from locfuse.fusion.data import (
    Array,
    Drive,
    Estimates,
    Evaluation,
    Truth,
    UsageError,
    interpolate,
    matrices,
)
from locfuse.fusion.judge.credit import Effect
from locfuse.fusion.judge.evaluate import Align, evaluate
from locfuse.fusion.judge.without_truth import are_contradictory
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY, needed
from locfuse.fusion.streams import gap_limit

from .smooth import check_smoothing, fuse_and_smooth

Subset = frozenset[str]
TOPIC = "reference"
MAX_SIGMA_SHARE = 1.0 / 3.0  # largest sigma of a reference / judged error: it then changes the error by 6 %
MAX_APART_SIGMAS = 3.0  # largest difference of two references; with more, one of them is wrong
MIN_ERROR_SHARE = 1e-3  # smallest true error in the interval, as a share of the measured error


def refuse_reference(drive: Drive, robot: Robot) -> None:
    """Raise UsageError if no reference can be computed for this log."""
    if drive.truth is not None:
        raise UsageError(
            f"--reference: this log has a truth, {drive.truth.topic}, and is judged by that.",
            fixes=("truth.topic=none",),
            hint="Leave --reference out, or hide the truth: --set truth.topic=none",
        )
    if drive.wheels.stands:
        raise UsageError("--reference: the robot does not move in this log, so no sensor can be judged")
    check_smoothing(robot, _present(drive))
    if not _locates(_present(drive)):
        raise UsageError(
            "--reference: no sensor of this log shows where the robot is, so its whole-drive solution judges none"
        )


def may_have_reference(drive: Drive, robot: Robot) -> bool:
    """Return whether a reference can be computed for this log."""
    try:
        refuse_reference(drive, robot)
    except UsageError:
        return False
    return True


def reference_sets(drive: Drive) -> list[tuple[str, ...]]:
    """Return the sets of sensors for which a reference is computed: all sensors, and all without one sensor.

    The sensors that need the left-out one are left out with it. A set is left out if none of its sensors measures
    the position: its distance scale would be that of the wheels.
    """
    present = _present(drive)
    found = [present, *(_without(s, present) for s in present)]
    return list(dict.fromkeys(s for s in found if _locates(s)))


class References(msgspec.Struct, frozen=True):
    """Reference trajectories of one drive, by set of sensors."""

    solved: Mapping[Subset, Reference]
    present: tuple[str, ...]
    contradict: Sequence[tuple[str, str]] = ()  # pairs of sensors of which one must be wrong

    @classmethod
    def of(
        cls,
        drive: Drive,
        robot: Robot,
        known: Mapping[Subset, tuple[Estimates, Estimates]],
        noise: Mapping[str, float],
        contradict: Sequence[tuple[str, str]] = (),
    ) -> References | None:
        """Compute smoothed paths that stand in for truth; None if the robot is lost in the one with all sensors.

        A smoothed solution that contradicts the filter's within the covariances of both is not used: one is wrong.
        `known`: filtered and smoothed estimates that were computed before, by set of sensors. `noise`: factor by
        which the sigma of a sensor is too small according to its residuals. References are solved with the
        corrected sigma, else they would be as overconfident as the estimates that they evaluate.
        """
        present = _present(drive)
        larger = {s: factor for s, factor in noise.items() if factor > 1.0}
        scaled = {s: replace(m, scale=m.scale * larger.get(s, 1.0)) for s, m in drive.measurements.items()}
        noisier = replace(drive, measurements=scaled) if larger else drive
        solved: dict[Subset, Reference] = {}
        for sensors in reference_sets(drive):
            subset = frozenset(sensors)
            found = known.get(subset) if subset.isdisjoint(larger) else None
            filtered, e = found or fuse_and_smooth(noisier, robot, sensors)
            if not e.lost and not are_contradictory(filtered, e):
                solved[subset] = Reference.of(e, drive, tuple(s for s in present if s not in subset))
        return cls(solved, present, contradict) if frozenset(present) in solved else None

    @property
    def whole(self) -> Reference:
        """Return the reference of all sensors, without a sensor that contradicts all others."""
        every = frozenset(self.present)
        return self.solved.get(every - {self.outlier}) or self.solved[every]

    @property
    def outlier(self) -> str | None:
        """Return the sensor that contradicts all others, while these agree with each other; else None."""
        for sensor in self.present:
            others = {o for pair in self.contradict if sensor in pair for o in pair if o != sensor}
            if len(others) > 1 and others == {*self.present} - {sensor} and len(self.contradict) == len(others):
                return sensor
        return None

    def without(self, sensor: str) -> Reference | None:
        """Return the reference without a sensor; None if there is none."""
        return self.solved.get(frozenset(_without(sensor, self.present)))

    def contradiction(self, reference: Reference, judged: Collection[str]) -> tuple[str, str] | None:
        """Return two sensors of a reference and an estimate that contradict each other; None if there are none.

        `judged` are the sensors of the estimate. A sensor that contradicts all others may be evaluated by a
        reference of these others.
        """
        known = {*reference.sensors, *(s for s in judged if s != self.outlier)}
        return next((pair for pair in self.contradict if set(pair) <= known), None)

    def judged(self, judged: Evaluation, e: Estimates, align: Align) -> tuple[Evaluation, Reference]:
        """Evaluate an estimate e by a reference; return the evaluation and this reference.

        A reference that shares no sensor with the estimate is preferred, that with the least sigma first. If none
        can evaluate it, the reference of all sensors is used.
        """
        others = [r for r in self.solved.values() if e.sensors and not set(r.sensors) & set(e.sensors)]
        others = [r for r in others if self.contradiction(r, e.sensors) is None]
        for reference in sorted(others, key=lambda r: r.sigma):
            found = reference.judge(judged, e, align)
            if reference.can_judge(found.figures["position_rmse_m"]):
                return found, reference
        return self.whole.judge(judged, e, align), self.whole


def _present(drive: Drive) -> tuple[str, ...]:
    """Return the names of the sensors that have readings."""
    return tuple(s for s in REGISTRY if s in drive.measurements and len(drive.measurements[s].z))


def _without(sensor: str, present: Sequence[str]) -> tuple[str, ...]:
    return tuple(s for s in present if s != sensor and sensor not in needed(s))


def _locates(sensors: Collection[str]) -> bool:
    return any(REGISTRY[s].locates for s in sensors)


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
