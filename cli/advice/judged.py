"""One log compared under some settings: the verdicts on its sensors, and the configurations that judge a fix."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cached_property

import numpy as np

from locfuse.cli.analysis.compare import Compared
from locfuse.cli.analysis.load import Loaded
from locfuse.cli.analysis.trust import sensors_consistency
from locfuse.fusion.checks.examine import examine
from locfuse.fusion.checks.finding import Finding, Least
from locfuse.fusion.checks.tried import Candidate, Fixes
from locfuse.fusion.data import BASES, Estimates
from locfuse.fusion.judge.consistency import Consistency
from locfuse.fusion.judge.covariance import honesty

from .trial import Trial

LASER = "lrf"
REFERENCE = {"wheels", "start", "truth"}  # roles whose settings move every configuration
WORTH_TRYING = Least(0.005, 2.0)  # what is worth saying untried is larger
FINE = {"consistent", "unclear"}  # verdicts on a sensor that are no complaint


def as_fixes(cures: Mapping[str, float]) -> Fixes:
    """Return settings as written in fixes."""
    return tuple(f"{key}={value:g}" for key, value in cures.items())


Offer = tuple[Finding, tuple[Fixes, ...]]  # no observation, only settings that may help


class Judged:
    """One log compared under some settings: complaints about its sensors, and the judges of their fixes."""

    def __init__(self, compared: Compared, trial: Trial, fixes: Fixes) -> None:
        self.compared, self.trial, self.fixes = compared, trial, fixes
        self.honesty = {e.name: honesty(e) for e in compared.evaluations if not e.smoothed}
        by_run = sensors_consistency(compared.runs, compared.loaded.robot, self.honesty)
        self.consistency = {s: found for by_sensor in by_run.values() for s, found in by_sensor.items()}

    @property
    def loaded(self) -> Loaded:
        """The log under the kept settings."""
        return self.compared.loaded

    @cached_property
    def doctor(self) -> list[Finding]:
        """Return the findings of the sensors' comparison (`fusion.checks`)."""
        loaded = self.trial.whole_under(self.fixes)
        if loaded is None or any(loaded.window) or loaded.robot.preset != "default":
            return []  # the doctor looks at whole drives
        streams = {role: loaded.stream(role) for role in loaded.choice.topics}
        found = examine(loaded.drive, loaded.robot, streams, WORTH_TRYING)
        return [f for f in found if f.code != "start" or self.trial.align == "none"]

    def _complained(self, sensor: str) -> bool:
        """Return whether a sensor's own run is inconsistent, or its residuals are unusual."""
        return self._complained_itself(sensor) or self._doubtful(self._alone(sensor))

    def _complained_itself(self, sensor: str) -> bool:
        """Return whether a sensor's own residuals are unusual, whatever truth shows of its run."""
        return self._verdict(sensor) not in FINE

    def _verdict(self, sensor: str) -> str:
        """Return the verdict on a sensor's residuals; "unclear" without any."""
        verdict = self.consistency.get(sensor)
        return "unclear" if verdict is None else verdict.verdict

    def _doubtful(self, name: str) -> bool:
        """Return whether a configuration is inconsistent by truth; without truth, whether any looks so."""
        honest = self.honesty.get(name)
        lost = any(e.lost for e in self.compared.estimates if e.name == name)
        return honest is None or lost or not honest.consistent

    def constant(self, verdict: Consistency) -> tuple[Fixes, ...]:
        """Return the fix of a constant error, empty if a verdict is about something else."""
        return (as_fixes(verdict.cures),) if verdict.verdict == "biased" and verdict.cures else ()

    def _was_set(self, role: str, key: str) -> bool:
        """Return whether a kept fix sets this."""
        return any(fix.startswith(f"{role}.{key}=") for fix in self.fixes)

    def _candidate(self, finding: Finding, alternatives: tuple[Fixes, ...], offer: bool = False) -> Candidate:
        judges = self.judges(finding.role)
        kept = self.kept(finding.role)
        minor = tuple(n for n in judges if n not in kept)
        others = tuple(n for n in minor if n not in BASES) if finding.role in REFERENCE else ()
        return Candidate(finding, alternatives, judges, minor, others, offer)

    def kept(self, role: str) -> set[str]:
        """Return the configurations that a user of a sensor would keep."""
        return {self._all(), self._best(self._using(role))}

    def _using(self, role: str) -> list[str]:
        """Return the configurations that depend on a role."""
        known = self.trial.configurations
        return list(known) if role in REFERENCE else [n for n, c in known.items() if role in c.sensors]

    def judges(self, role: str) -> tuple[str, ...]:
        """Return the configurations by which a role's fix is judged.

        The best that uses it and all sensors, which are kept; the best but for all, in which the gain shows. What
        moves every configuration is judged by all of them: a track that fits the slips of one drive makes odometry
        better, and a camera beside it worse.
        """
        if role in REFERENCE:
            known = self.trial.configurations
            kept = (self._best(known), self._all())
            others = (n for n in known if n not in kept and n not in BASES)  # first: what settles one is right
            # one random walk: without truth it predicts places by chance
            walk = (
                tuple(n for n in BASES if n in known)
                if self.loaded.drive.truth is not None or len(known) == 1
                else ()
            )
            return tuple(n for n in dict.fromkeys((*others, *kept, *walk)) if n not in BASES or walk)
        using = self._using(role)
        if not using:
            return ()
        fewer = [n for n in using if n != self._all()] or using
        return tuple(dict.fromkeys((self._best(fewer), self._best(using), self._all())))

    def _all(self) -> str:
        return max(self.trial.configurations, key=lambda n: len(self.trial.configurations[n].sensors))

    def _alone(self, sensor: str) -> str:
        """Return the configuration with the fewest sensors that uses this one."""
        using = {n: c for n, c in self.trial.configurations.items() if sensor in c.sensors}
        return min(using, key=lambda n: len(using[n].sensors))

    def _best(self, names: Iterable[str]) -> str:
        """Return the configuration with the smallest error, without truth the one with most sensors."""
        errors = {e.name: e.figures.get("position_rmse_m") for e in self.compared.evaluations}
        known = {n: e for n in names if (e := errors.get(n)) is not None}
        if known:
            return min(known, key=lambda n: known[n])
        return max(names, key=lambda n: len(self.trial.configurations[n].sensors))

    def _reference(self, sensor: str) -> Estimates | None:
        """Return the run of one other sensor without complaints that knows its heading best."""
        fine = {s for s in self.loaded.drive.measurements if s != sensor and not self._complained_itself(s)}
        runs = [
            e
            for e in self.compared.estimates
            if len(e.sensors) == 1 and e.sensors[0] in fine and not e.smoothed and not e.lost
        ]
        return min(runs, key=lambda e: float(np.median(e.triangles[:, 5])), default=None)
