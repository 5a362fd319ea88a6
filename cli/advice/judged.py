"""One log compared under some settings: the runs that judge a fix, and findings on noise.

Noise of each sensor by residuals, ranges and truth; of the wheels by their slip.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cached_property
from typing import Any

import numpy as np
from msgspec.structs import replace

from locfuse.cli.analysis.compare import Compared
from locfuse.cli.analysis.load import Loaded
from locfuse.cli.analysis.verdicts import sensors_consistency
from locfuse.fusion.checks.examine import examine
from locfuse.fusion.checks.finding import Finding, Least
from locfuse.fusion.checks.laser_ranges import of_offset, ranges_sigma, scatter_more
from locfuse.fusion.checks.slip import Slip, beside_path, slip
from locfuse.fusion.checks.tried import Candidate, Fixes
from locfuse.fusion.data import BASES, Estimates
from locfuse.fusion.judge.consistency import MAX_SIGMA_FACTOR, Consistency, many_refused
from locfuse.fusion.judge.evaluate import covariance_check
from locfuse.fusion.judge.innovations import Own, own
from locfuse.fusion.sensors.registry import REGISTRY

from .trial import Trial

LASER = "lrf"
REFERENCE = {"wheels", "start", "truth"}  # roles whose settings move every configuration
WORTH_TRYING = Least(0.005, 2.0)  # what is worth saying untried is larger
FINE = {"consistent", "unclear"}  # verdicts on a sensor that are no complaint


def as_fixes(fix_values: Mapping[str, float]) -> Fixes:
    """Return settings as fixes, "key=value" each."""
    return tuple(f"{key}={value:g}" for key, value in fix_values.items())


Offer = tuple[Finding, tuple[Fixes, ...]]  # no observation, only settings that may help


class Judged:
    """One log compared under some settings: complaints about its sensors, and the judges of their fixes."""

    def __init__(self, compared: Compared, trial: Trial, fixes: Fixes) -> None:
        self.compared, self.trial, self.fixes = compared, trial, fixes
        self.covariance_checks = {e.name: covariance_check(e) for e in compared.evaluations if not e.smoothed}
        by_run = sensors_consistency(compared.runs, compared.loaded.robot, self.covariance_checks)
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
        """Return whether truth shows a configuration to be inconsistent; without truth, whether any looks so."""
        check = self.covariance_checks.get(name)
        lost = any(e.lost for e in self.compared.estimates if e.name == name)
        return check is None or lost or not check.consistent

    def constant(self, verdict: Consistency) -> tuple[Fixes, ...]:
        """Return the fix of a constant error; empty if the verdict is not "biased"."""
        return (as_fixes(verdict.fix_values),) if verdict.verdict == "biased" and verdict.fix_values else ()

    def _was_set(self, role: str, key: str) -> bool:
        """Return whether a kept fix sets this key of a role."""
        return any(fix.startswith(f"{role}.{key}=") for fix in self.fixes)

    def _candidate(self, finding: Finding, alternatives: tuple[Fixes, ...], offer: bool = False) -> Candidate:
        judges = self.judges(finding.role)
        kept = self.kept(finding.role)
        minor = tuple(n for n in judges if n not in kept)
        others = tuple(n for n in minor if n not in BASES) if finding.role in REFERENCE else ()
        return Candidate(finding, alternatives, judges, minor, others, offer)

    def kept(self, role: str) -> set[str]:
        """Return the configurations with a sensor that a user would keep: all sensors, and the best one."""
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
        """Return the configuration with the fewest sensors among those with this sensor."""
        using = {n: c for n, c in self.trial.configurations.items() if sensor in c.sensors}
        return min(using, key=lambda n: len(using[n].sensors))

    def _best(self, names: Iterable[str]) -> str:
        """Return the configuration with the smallest error; without truth, the one with most sensors."""
        errors = {e.name: e.figures.get("position_rmse_m") for e in self.compared.evaluations}
        known = {n: e for n in names if (e := errors.get(n)) is not None}
        if known:
            return min(known, key=lambda n: known[n])
        return max(names, key=lambda n: len(self.trial.configurations[n].sensors))

    def _reference(self, sensor: str) -> Estimates | None:
        """Return the run of another single sensor, without complaints, whose heading is most certain."""
        fine = {s for s in self.loaded.drive.measurements if s != sensor and not self._complained_itself(s)}
        runs = self.runs_alone(*fine) if fine else []
        return min(runs, key=lambda e: float(np.median(e.triangles[:, 5])), default=None)

    def runs_alone(self, *sensors: str) -> list[Estimates]:
        """Return the causal runs with one sensor alone that were never lost; if sensors are named, only theirs."""
        runs = (e for e in self.compared.estimates if len(e.sensors) == 1 and not e.smoothed and not e.lost)
        return [e for e in runs if not sensors or e.sensors[0] in sensors]


WHEEL_NOISE_FACTORS = (0.1, 0.3, 3.0, 10.0)
TOO_LOW = 2.0  # a sigma that is set too low refuses the large residuals, so the observed one is a lower bound
MAX_OFFERED_FACTOR = 8.0  # on a sigma: more means that the sensor is not to be used, and is not offered
MAX_NOISE_FACTOR = 4.0  # on a sigma, by the errors of its own run
FLOORS, FLOOR_FACTORS = ("floor_range", "floor_angle_deg"), (5.0, 10.0, 20.0)  # of a laser's lines
NOISE = {"understated", "overstated", "correlated"}


class Noise(Judged):
    """Findings on noise of a compared log."""

    def noise(self) -> list[Candidate]:
        """Return findings on wrong noise, of each sensor and of the wheels."""
        found = []
        for sensor, verdict in self.consistency.items():
            seen, more = [*_noise_options(sensor, verdict), *_above(verdict)], self._by_anees(sensor)
            by_ranges, words = self._as_ranges_scatter(sensor, verdict), verdict.words
            if by_ranges:
                seen.append(by_ranges)
                words += f" by its lines, {by_ranges[0].partition('=')[2]} m by its ranges"
            if self._ranges_show_more(sensor, verdict) or self._too_sure(sensor, verdict):
                seen = []
            if seen and verdict.verdict == "overstated":
                seen, words = self._beside_the_wheels(sensor, seen, words)
            words = words if seen else self._errors_in_sigmas(sensor)
            if verdict.verdict == "overstated" and seen and more:
                # a sigma above the configured one is no fix of one that is too high: it has words of its own
                found.append(self._candidate(Finding(sensor, verdict.verdict, words), tuple(seen)))
                seen, words = [], self._errors_in_sigmas(sensor)
            found += self._shared_by_lines(sensor, verdict)
            options = tuple(dict.fromkeys((*seen, *more)))
            if sensor != LASER:  # its raw ranges show its noise by themselves
                settings = self.loaded.robot.settings(sensor)
                options = tuple(fixes for fixes in options if useful(fixes, settings))
            if options:
                finding = Finding(sensor, verdict.verdict if seen else self._by_truth(sensor), words)
                found.append(self._candidate(finding, options, not seen))
            elif seen:
                words += ": so much that something else is wrong with it"
                found.append(self._candidate(Finding(sensor, verdict.verdict, words), ()))
        as_configured = self._slip is not None and not self._slip.unusual  # as the turning itself shows
        doubtful = self.loaded.drive.truth is not None and self._doubtful(self._best(self.trial.configurations))
        if doubtful and not as_configured:
            found.append(self._wheel_noise())
        return found

    def _shared_by_lines(self, sensor: str, verdict: Consistency) -> list[Candidate]:
        """Return larger floors for a laser's lines if they scatter more than their beams and no sigma explains it.

        A depth camera's neighbouring beams are wrong alike (calibration, steps of the disparity): what a line is
        off does not become less with the number of its beams.
        """
        if sensor != LASER or verdict.verdict != "correlated" or verdict.fix_values:
            return []
        own_run = self._own(sensor, ())
        if own_run is None or own_run.nis < MAX_SIGMA_FACTOR**2:
            return []
        settings = self.loaded.robot.settings(LASER)
        words = (
            f"lines scatter {own_run.nis**0.5:.2g} times as far as the noise of their beams says: beams of a line "
            "share their error (a depth camera, walls that are not flat)"
        )
        options = tuple(
            tuple(f"{LASER}.{key}={getattr(settings, key) * factor:.2g}" for key in FLOORS)
            for factor in FLOOR_FACTORS
        )
        return [self._candidate(Finding(LASER, "floor", words), options, True)]

    def slips(self) -> list[Candidate]:
        """Return the wheels' noise if their turning shows it and every sensor's run is consistent."""
        return [self._wheel_noise()] if self._slips_unusually else []

    @cached_property
    def _ranges_sigma(self) -> float | None:
        """Noise of one range [m], measured from the laser's raw ranges; None if they do not show it."""
        if LASER not in self.loaded.drive.measurements:
            return None
        return ranges_sigma(self.loaded.stream(LASER), self.loaded.robot.settings(LASER))

    @property
    def _walls_bend(self) -> bool:
        """Whether straight walls look bent in the laser's raw ranges, as by a constant error of them."""
        stream = self.loaded.stream(LASER) if LASER in self.loaded.drive.measurements else None
        return stream is not None and bool(of_offset(stream, self.loaded.robot.settings(LASER)))

    @property
    def _ranges_scatter(self) -> bool:
        """Whether the laser's raw ranges scatter by more than configured."""
        return scatter_more(self._ranges_sigma, self.loaded.robot.settings(LASER).sigma_range)

    def _as_ranges_scatter(self, sensor: str, verdict: Consistency) -> Fixes:
        """Return the laser's noise as its raw ranges show it, if its lines show about the same noise.

        A sigma that is far too high also joins walls that are two, and these lines fit worse than others.
        """
        cure, shown = _smaller_range_noise(sensor, verdict), self._ranges_sigma
        if cure is None or shown is None or not cure / MAX_SIGMA_FACTOR <= shown < cure:
            return ()
        settings = self.loaded.robot.settings(LASER)
        share = shown / settings.sigma_range
        return tuple(f"{LASER}.{k}={getattr(settings, k) * share:.2g}" for k in REGISTRY[LASER].noise_keys)

    def _ranges_show_more(self, sensor: str, verdict: Consistency) -> bool:
        """Whether the raw ranges are noisier than a smaller sigma; then the smaller sigma is not proposed.

        The lines' residuals show the noise of ranges and angles together; the ranges show their own.
        """
        cure = _smaller_range_noise(sensor, verdict)
        return cure is not None and scatter_more(self._ranges_sigma, cure)

    @cached_property
    def _slip(self) -> Slip | None:
        """The slip by turns, and by the distances of the laser's own run where these need more noise."""
        drive, found = self.loaded.drive, slip(self.loaded.drive)
        for e in self.runs_alone(LASER):
            if found is not None and found.factor < 1.0:
                found = beside_path(found, drive, e.t, e.pose)
        return found

    @property
    def _slips_unusually(self) -> bool:
        """Whether the wheels slip more than configured, or clearly less.

        Less is only believed where truth judges it or several sensors agree: wheels that hardly slip in most turns
        may slip far in a few, and a laser's own turning is no evidence beside a run that goes by the same scans.
        """
        found, truth = self._slip, self.loaded.drive.truth
        return found is not None and found.unusual and (found.factor > 1.0 or truth is not None or found.agreed)

    def _too_sure(self, sensor: str, verdict: Consistency) -> bool:
        """Whether truth shows that runs with a sensor are overconfident; then it must not be trusted more."""
        check = self.covariance_checks.get(self._alone(sensor))
        return verdict.verdict == "overstated" and check is not None and check.overconfident

    def _beside_the_wheels(self, sensor: str, seen: list[Fixes], words: str) -> tuple[list[Fixes], str]:
        """Return fixes with a smaller sensor noise; add wheel noise where the gate would reject too much.

        Noise of a sensor that is set too high can hide noise of the wheels that is set too low: with the first
        alone the filter trusts its prediction too much. Truth shows that by itself (`_too_sure`).
        """
        if self.loaded.drive.truth is not None:
            return seen, words
        usual, shares = [], []
        for fixes in seen:
            share = self._refused(sensor, fixes)
            if share is None or not many_refused(sensor, share):
                usual.append(fixes)
            else:
                shares.append(share)
        if usual or not shares:
            return usual, words
        noise = self.loaded.robot.wheels.noise
        more = [(*seen[0], f"wheels.noise={noise * f:.2g}") for f in WHEEL_NOISE_FACTORS if f > 1.0]
        both = [fixes for fixes in more if not many_refused(sensor, self._refused(sensor, fixes) or 0.0)]
        alone = f"with the first alone {min(shares):.0%} of its readings would be rejected"
        return both, f"{words}; wheels.noise is set too low ({alone})"

    def _refused(self, sensor: str, fixes: Fixes) -> float | None:
        """Return the share of a sensor's readings that its own run rejects under more settings."""
        found = self._own(sensor, fixes)
        return None if found is None else found.refused

    def _own(self, sensor: str, fixes: Fixes) -> Own | None:
        """Return the innovation figures of a sensor's own run under more settings."""
        tried = self.trial.under((*self.fixes, *fixes))
        run = None if tried is None else self.trial.fused(tried, self._alone(sensor))
        if tried is None or run is None:
            return None
        return own(run.audits[sensor], tried.drive.measurements[sensor])

    @property
    def _noise_factors(self) -> tuple[float, ...]:
        """Factors on the wheels' noise, tried with truth: a smaller one cannot fix an overconfident filter."""
        check = self.covariance_checks.get(self._best(self.trial.configurations))
        if check is None:
            return ()
        return tuple(factor for factor in WHEEL_NOISE_FACTORS if (factor > 1.0) == (check.anees > 1.0))

    def _by_anees(self, sensor: str) -> list[Fixes]:
        """Return the sensor's noise scaled by the ANEES of the run that uses it alone.

        Not against what its residuals show: only a map that is built from the readings takes their errors along.
        """
        if sensor != LASER and self._verdict(sensor) == "consistent":
            return []
        check = self.covariance_checks.get(self._alone(sensor))
        if check is None or check.consistent or check.anees <= 0.0:
            return []
        settings, keys = self.loaded.robot.settings(sensor), REGISTRY[sensor].noise_keys
        if any(self._was_set(sensor, key) for key in keys):
            return []  # once: what is still wrong then is something else
        factor = check.anees**0.5
        if not 1.0 / MAX_NOISE_FACTOR <= factor <= MAX_NOISE_FACTOR:
            return []  # that is no noise
        if sensor == LASER and factor > 1.0 and self._ranges_sigma is not None and not self._ranges_scatter:
            return []  # its raw ranges scatter as configured: something else is wrong
        return [tuple(f"{sensor}.{k}={getattr(settings, k) * factor:.2g}" for k in keys)]

    def _by_truth(self, sensor: str) -> str:
        """Return the covariance figures by truth for the run that uses a sensor alone."""
        check = self.covariance_checks.get(self._alone(sensor))
        return "understated" if check is None or check.anees > 1.0 else "overstated"

    def _errors_in_sigmas(self, sensor: str) -> str:
        """Return the ratio of the errors of the sensor's own run to its claimed sigmas."""
        check = self.covariance_checks.get(self._alone(sensor))
        times = 1.0 if check is None else check.anees**0.5
        return f"position errors with it are {times:.2g} times what the covariance claims"

    def _wheel_noise(self) -> Candidate:
        noise = self.loaded.robot.wheels.noise
        words = f"wheels.noise = {noise:g} m does not fit this drive"
        factors = self._noise_factors
        measured = self._slips_unusually
        if measured and self._slip is not None:
            words = self._slip.words
            factors = (self._slip.factor, *factors)
        if any(e.slips for e in self.compared.estimates):  # less noise would hold them for impossible
            factors = tuple(factor for factor in factors if factor > 1.0)
        options = tuple((f"wheels.noise={noise * factor:.2g}",) for factor in factors)
        found = self._candidate(Finding("wheels", "noise", words), options, True)
        # odometry's one random walk tells no noise, and chance moves the others by as much
        judges = tuple(n for n in found.judges if n not in found.minor and n not in BASES)
        # wheels that hardly slipped where this could be seen may slip far elsewhere: less has to gain something
        more = any(factor > 1.0 for factor in factors)
        return replace(
            found,
            judges=judges,
            guards=tuple(self.trial.configurations),
            measured=measured and (more or self.loaded.drive.truth is not None),
        )


def _smaller_range_noise(sensor: str, verdict: Consistency) -> float | None:
    """Return a range noise [m] below the configured one if a laser's lines show it, else None."""
    return (
        verdict.fix_values.get(f"{LASER}.sigma_range")
        if sensor == LASER and verdict.verdict == "overstated"
        else None
    )


def useful(fixes: Fixes, settings: Any) -> bool:
    """Return whether a proposed sigma is plausible; a much larger one would switch the sensor off."""
    changed = (fix.partition("=") for fix in fixes)
    pairs = ((float(value), getattr(settings, key.partition(".")[2], None)) for key, _, value in changed)
    return all(not now or value <= MAX_OFFERED_FACTOR * now for value, now in pairs)


def _noise_options(sensor: str, verdict: Consistency) -> list[Fixes]:
    """Return the alternative fixes of one noise verdict: all sigma keys together, else one key after another."""
    if verdict.verdict not in NOISE or not verdict.fix_values:
        return []
    if verdict.verdict == "correlated":  # a larger sigma, or an offset that walks
        noise = {k: v for k, v in verdict.fix_values.items() if k.partition(".")[2] in REGISTRY[sensor].noise_keys}
        walks = {k: v for k, v in verdict.fix_values.items() if k not in noise}
        return [as_fixes(fix_values) for fix_values in (noise, walks) if fix_values]
    return [as_fixes(verdict.fix_values)]


def _above(verdict: Consistency) -> list[Fixes]:
    """Return a sigma above the observed one, if the configured one was too low."""
    if verdict.verdict != "understated" or not verdict.fix_values:
        return []
    return [as_fixes({key: float(f"{TOO_LOW * value:.2g}") for key, value in verdict.fix_values.items()})]
