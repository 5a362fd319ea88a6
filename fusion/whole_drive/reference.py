"""References of a drive without truth: its whole-drive solution, and those that leave one sensor out.

drive, robot -> which sets of sensors to solve -> the whole drive with each (`smooth`) -> what judges what
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
    """Raise UsageError if this log can have no reference."""
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


def possible(drive: Drive, robot: Robot) -> bool:
    """Return whether this log can have a reference."""
    try:
        refuse(drive, robot)
    except UsageError:
        return False
    return True


def sets(drive: Drive) -> list[tuple[str, ...]]:
    """Return the sets of sensors to solve: all, and all without each one (and without those that need it).

    A set in which no sensor locates the robot, is none: a wrong wheel radius would judge the sensors.
    """
    present = _present(drive)
    found = [present, *(_without(s, present) for s in present)]
    return list(dict.fromkeys(s for s in found if _locates(s)))


class References(msgspec.Struct, frozen=True):
    """The references of one drive."""

    solved: Mapping[Subset, Reference]
    present: tuple[str, ...]
    contradict: Sequence[tuple[str, str]] = ()  # sensors of which one must be wrong, unknown which

    @classmethod
    def of(
        cls,
        drive: Drive,
        robot: Robot,
        known: Mapping[Subset, tuple[Estimates, Estimates]],
        noise: Mapping[str, float],
        contradict: Sequence[tuple[str, str]] = (),
    ) -> References | None:
        """Return the references of a drive; None if its whole-drive solution is lost on the way.

        Nor is a solution a reference that lies further from the filter's than both claim: one of them is wrong.
        `known` are filtered and smoothed estimates that were made anyway, by their sensors. `noise`: by how much
        the sigma of a sensor is too small, as its residuals show; references are solved with the larger one, else
        they would be as wrong and as sure as the estimates that they judge.
        """
        present = _present(drive)
        larger = {s: factor for s, factor in noise.items() if factor > 1.0}
        honest = _noisier(drive, larger)
        solved: dict[Subset, Reference] = {}
        for sensors in sets(drive):
            subset = frozenset(sensors)
            found = known.get(subset) if subset.isdisjoint(larger) else None
            filtered, e = found or fuse_and_smooth(honest, robot, sensors)
            if not e.lost and not are_contradictory(filtered, e):
                solved[subset] = Reference.of(e, drive, tuple(s for s in present if s not in subset))
        return cls(solved, present, contradict) if frozenset(present) in solved else None

    @property
    def whole(self) -> Reference:
        """The reference of all sensors, except a sensor that contradicts all others."""
        every = frozenset(self.present)
        return self.solved.get(every - {self.outlier}) or self.solved[every]

    @property
    def outlier(self) -> str | None:
        """The one sensor that contradicts all others, which agree with each other; None if there is none."""
        for sensor in self.present:
            others = {o for pair in self.contradict if sensor in pair for o in pair if o != sensor}
            if len(others) > 1 and others == {*self.present} - {sensor} and len(self.contradict) == len(others):
                return sensor
        return None

    def without(self, sensor: str) -> Reference | None:
        """Return a reference that does not use the sensor; None if there is none."""
        return self.solved.get(frozenset(_without(sensor, self.present)))

    def contradiction(self, reference: Reference, judged: Collection[str]) -> tuple[str, str] | None:
        """Return two sensors that contradict each other, if one judges with or against the other.

        All others together may judge the one that contradicts them all.
        """
        known = {*reference.sensors, *(s for s in judged if s != self.outlier)}
        return next((pair for pair in self.contradict if set(pair) <= known), None)

    def judged(self, judged: Evaluation, e: Estimates, align: Align) -> tuple[Evaluation, Reference]:
        """Judge an evaluation by a reference, if possible one without its sensors; return both."""
        others = [
            r
            for r in self.solved.values()
            if e.sensors and not set(r.sensors) & set(e.sensors) and self.contradiction(r, e.sensors) is None
        ]
        for reference in sorted(others, key=lambda r: r.sigma):
            found = reference.judge(judged, e, align)
            if reference.can_judge(found.figures["position_rmse_m"]):
                return found, reference
        return self.whole.judge(judged, e, align), self.whole


def _noisier(drive: Drive, factors: Mapping[str, float]) -> Drive:
    """Return a drive whose sensors have sigmas larger by these factors."""
    scaled = {s: replace(m, scale=m.scale * factors.get(s, 1.0)) for s, m in drive.measurements.items()}
    return replace(drive, measurements=scaled) if factors else drive


def _present(drive: Drive) -> tuple[str, ...]:
    """Return the sensors that measured something: a dead one gives no reference."""
    return tuple(s for s in REGISTRY if s in drive.measurements and len(drive.measurements[s].z))


def _without(sensor: str, present: Sequence[str]) -> tuple[str, ...]:
    return tuple(s for s in present if s != sensor and sensor not in needed(s))


def _locates(sensors: Collection[str]) -> bool:
    return any(REGISTRY[s].locates for s in sensors)
