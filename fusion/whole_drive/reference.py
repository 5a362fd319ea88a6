"""References for a drive without ground truth: smoothed trajectories by all sensors, and without each sensor.

drive, robot -> sets of sensors to solve -> smoothed drive with each set -> the reference for each evaluation
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import msgspec
from msgspec.structs import replace

from locfuse.fusion.data import Drive, Estimates, Evaluation, UsageError
from locfuse.fusion.judge.against import Reference
from locfuse.fusion.judge.evaluate import Align
from locfuse.fusion.judge.own_scans import are_contradictory
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY, needed

from .smooth import check_smoothing, fuse_and_smooth

Subset = frozenset[str]


def refuse(drive: Drive, robot: Robot) -> None:
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
        refuse(drive, robot)
    except UsageError:
        return False
    return True


def sets(drive: Drive) -> list[tuple[str, ...]]:
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
        for sensors in sets(drive):
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
