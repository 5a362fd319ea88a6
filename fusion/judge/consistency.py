"""Can the covariance be trusted? A verdict on every sensor's noise, without truth, with the fix.

A sensor is best judged by a run that does not use it and is healthy itself; else by its own innovations. Where two
sensors disagree, the one that others disagree with too is to blame. A run that uses a sensor whose noise is
understated judges nobody else. Whose mean is off, a truth with headings says first: no run is as exact.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import msgspec
import numpy as np
from msgspec import field
from msgspec.structs import replace

from locfuse.fusion.data import Drive, Estimates
from locfuse.fusion.robot import Robot
from locfuse.fusion.se2 import wrap
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.streams import gap_limit
from locfuse.fusion.truth import body_poses

from .innovations import Heard, Own, heard, own, usual_period
from .noise_verdicts import (
    MAX_REFUSED_LINE_SHARE,
    MAX_SIGMA_FACTOR,
    NoiseVerdict,
    Verdict,
    biased_against,
    by_itself,
    by_reference_run,
    contradicting,
    disagrees,
    notable,
    of_messages,
)

MAX_REFERENCE_NIS_RATIO = (
    MAX_SIGMA_FACTOR**2
)  # a run with a sensor whose variance is understated by more is no reference
MIN_READINGS = 20  # readings
MAX_START_M, MAX_START_RAD = 0.5, math.radians(20.0)  # a truth that starts further from a run: another frame


class Consistency(msgspec.Struct, frozen=True):
    """Figures of one sensor's innovations in one run, and the verdict of all runs together."""

    verdict: Verdict
    words: str
    nis_bounds: tuple[float, float] | None = None  # 95 % bounds of the mean NIS per degree of freedom
    bias_sigma: tuple[float, ...] = ()  # mean innovation in predicted standard deviations
    whiteness: tuple[float, ...] = ()  # autocorrelation of the innovations at lags 1, 2, ...
    scale: float | None = None  # by which the sensor's sigma should be multiplied
    refused: float | None = None  # share of what was compared
    cures: Mapping[str, float] = field(default_factory=dict)  # robot.toml key -> value


class Run(NamedTuple):
    """One configuration's result on its drive, and the figures of its innovations of every sensor."""

    drive: Drive
    estimates: Estimates  # without audits
    own: Mapping[str, Own | None]

    @classmethod
    def of(cls, drive: Drive, estimates: Estimates) -> Run:
        """Summarise a run's innovations; its audits are not needed afterwards."""
        found = {s: own(estimates.audits[s], drive.measurements[s]) for s in estimates.sensors}
        return cls(drive, replace(estimates, audits={}), found)


def judge(
    runs: Sequence[Run], robot: Robot, overconfident: Collection[str] = ()
) -> dict[str, dict[str, Consistency]]:
    """Return the consistency of every sensor in every configuration: configuration -> sensor -> Consistency.

    `overconfident` are configurations that truth shows to be so: their covariance is no evidence against a sensor.
    """
    evidence = Evidence([r for r in runs if not r.estimates.smoothed], robot, overconfident)
    findings = {s: evidence.finding(s) for s in evidence.sensors}
    return {
        r.estimates.name: {s: evidence.in_run(r, s, findings[s]) for s in r.estimates.sensors}
        for r in evidence.runs
    }


class Evidence:
    """The evidence of all runs together."""

    def __init__(self, runs: Sequence[Run], robot: Robot, overconfident: Collection[str] = ()) -> None:
        self.robot, self.runs, self.overconfident = robot, runs, overconfident
        self.sensors = sorted({s for r in runs for s in r.estimates.sensors})
        self.own: dict[tuple[str, str], Own | None] = {
            (r.estimates.name, s): found for r in runs for s, found in r.own.items()
        }
        self._heard: dict[tuple[str, str], Heard | None] = {}
        self._truth = as_run(runs[0].drive, runs[0].estimates) if runs else None
        self.flagged: dict[str, Heard] = {}
        self.contradict: set[str] = set()
        self._flag()

    def in_run(self, run: Run, sensor: str, found: NoiseVerdict) -> Consistency:
        """Return the run's own figures with the verdict of all runs."""
        o = self.own[run.estimates.name, sensor]
        if o is None:
            return Consistency(found.verdict, found.words, scale=found.scale, cures=found.cures)
        return Consistency(
            found.verdict, found.words, o.bounds, o.bias, o.whiteness, found.scale, o.refused, found.cures
        )

    def finding(self, sensor: str) -> NoiseVerdict:
        """Return the verdict on a sensor and its words."""
        found = self._finding(sensor)
        m = next(r.drive.measurements[sensor] for r in self.runs if sensor in r.estimates.sensors)
        return of_messages(sensor, found) if REGISTRY[sensor].says_noise(m) else found

    def _finding(self, sensor: str) -> NoiseVerdict:
        settings = self.robot.settings(sensor)
        if sensor in self.flagged:
            return biased_against(sensor, settings, self.flagged[sensor])
        if sensor in self.contradict:
            return contradicting(sensor, sorted(self.contradict - {sensor}))
        for _, evidence in self.reference_runs(sensor)[:1]:
            found = by_reference_run(sensor, settings, evidence)
            if found is not None:
                return found
        run = self._purest(sensor)
        mine = None if run is None else self.own[run.estimates.name, sensor]
        if run is None or mine is None or mine.compared < MIN_READINGS:
            return self._unclear(sensor)
        m = run.drive.measurements[sensor]
        period = usual_period(m.t)
        if period is None:
            return self._unclear(sensor)
        return by_itself(sensor, settings, mine, np.diagonal(m.floor).tolist(), period)

    def _unclear(self, sensor: str) -> NoiseVerdict:
        inconsistent = sorted(
            {
                s
                for (_, s), o in self.own.items()
                if s != sensor and o is not None and o.scale > MAX_REFERENCE_NIS_RATIO
            }
        )
        why = (
            f"the noise of {' and '.join(inconsistent)} must be set first"
            if inconsistent
            else "too few measurements"
        )
        return NoiseVerdict("unclear", f"noise cannot be judged: {why}")

    def reference_runs(self, sensor: str) -> list[tuple[Run, Heard]]:
        """Return consistent runs that use neither the sensor nor a flagged one, the most certain first."""
        found = []
        for run in self.runs:
            used = set(run.estimates.sensors)
            if not used or used & {sensor, *self.flagged} or run.estimates.name in self.overconfident:
                continue
            if self._healthy(run):
                evidence = self._hear(run, sensor)
                if evidence is not None and evidence.readings >= MIN_READINGS:
                    found.append((run, evidence))
        return sorted(found, key=lambda w: w[1].reference)

    def bias(self, sensor: str) -> NoiseVerdict | None:
        """Return a sensor's mean innovation if it is notable, certain or not; None if no run shows it."""
        found = self._hear_by_truth(sensor) or next((h for _, h in self.reference_runs(sensor)), None)
        if found is None or not notable(found):
            return None
        return biased_against(sensor, self.robot.settings(sensor), found)

    def _hear_by_truth(self, sensor: str) -> Heard | None:
        found = None if self._truth is None else self._hear(self._truth, sensor)
        return found if found is not None and found.readings >= MIN_READINGS else None

    def _hear(self, run: Run, sensor: str) -> Heard | None:
        key = run.estimates.name, sensor
        if key not in self._heard:
            self._heard[key] = heard(run.drive, self.robot, run.estimates, sensor)
        return self._heard[key]

    def _healthy(self, run: Run, but: str = "") -> bool:
        """Return whether no sensor of a run (except one) has understated noise or is mostly rejected."""
        found = [self.own[run.estimates.name, s] for s in run.estimates.sensors if s != but]
        return all(
            o is not None and o.scale < MAX_REFERENCE_NIS_RATIO and o.refused < MAX_REFUSED_LINE_SHARE
            for o in found
        )

    def _purest(self, sensor: str) -> Run | None:
        """Return the run that uses a sensor with the fewest other sensors, all of them healthy."""
        using = [r for r in self.runs if sensor in r.estimates.sensors]
        pure = [r for r in using if self._healthy(r, sensor) or self._worst(r) == sensor]
        return min(pure, key=lambda r: len(r.estimates.sensors)) if pure else None

    def _worst(self, run: Run) -> str:
        """Return the sensor of a run whose innovations are too large by the greatest factor."""
        scales = {s: o.scale for s in run.estimates.sensors if (o := self.own[run.estimates.name, s])}
        return max(scales, key=lambda s: scales[s]) if scales else ""

    def _flag(self) -> None:
        """Find the sensors whose mean is off: by truth if there is one, else the most certain evidence first."""
        by_truth = {s: h for s in self.sensors if (h := self._hear_by_truth(s)) is not None}
        self.flagged |= {s: h for s, h in by_truth.items() if disagrees(h)}
        left = [s for s in self.sensors if s not in by_truth]
        surest = {s: found[0][1] for s in left if (found := self.reference_runs(s))}
        for s in sorted(surest, key=lambda s: surest[s].reference):
            found = self.reference_runs(s)
            if not found or not disagrees(found[0][1]):
                continue
            run, evidence = found[0]
            rivals = [x for x in run.estimates.sensors if x in surest]
            others = {x: [w for r, w in self.reference_runs(x) if s not in r.estimates.sensors] for x in rivals}
            if any(disagrees(w) for found_x in others.values() for w in found_x[:1]):
                continue  # this reference is contradicted by others, and its turn comes
            if rivals and not any(others.values()):
                self.contradict |= {s, *rivals}
            else:
                self.flagged[s] = evidence
        self.contradict -= self.flagged.keys()


def as_run(drive: Drive, estimates: Estimates) -> Run | None:
    """Return a truth with headings as a run that uses no sensor; None where there is none in the run's frame.

    Its poses are NaN where the truth has a gap: nothing is compared there.
    """
    truth = drive.truth
    if truth is None or truth.theta is None or len(truth.t) < MIN_READINGS:
        return None
    pose = body_poses(truth, drive.t)
    after = np.clip(np.searchsorted(truth.t, drive.t), 1, len(truth.t) - 1)
    known = (drive.t >= truth.t[0]) & (drive.t <= truth.t[-1])
    known &= truth.t[after] - truth.t[after - 1] <= gap_limit(truth.t)
    if not known.any():
        return None
    first = int(np.argmax(known))
    away = pose[first] - estimates.pose[first]
    if math.hypot(*away[:2].tolist()) > MAX_START_M or abs(wrap(float(away[2]))) > MAX_START_RAD:
        return None
    triangles = np.zeros((len(drive.t), 6))
    triangles[:, [0, 3]], triangles[:, 5] = truth.sigma**2, truth.sigma_theta**2
    pose[~known] = np.nan
    return Run(drive, Estimates("truth", (), drive.t, pose, triangles, {}), {})
