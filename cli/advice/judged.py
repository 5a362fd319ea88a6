"""One log compared under some settings: configurations that judge a fix, and findings on noise.

Sensor noise is judged by residuals, raw ranges and truth; wheel noise by slip.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from functools import cached_property
from typing import Any

import numpy as np
from msgspec.structs import replace

from locfuse.cli.analysis.compare import Compared
from locfuse.cli.analysis.examined import examined
from locfuse.cli.analysis.load import Loaded
from locfuse.cli.analysis.verdicts import overconfident_by_truth
from locfuse.fusion.checks.finding import Finding, Least
from locfuse.fusion.checks.laser_ranges import of_offset, ranges_sigma, scatter_more
from locfuse.fusion.checks.slip import WheelSlip, beside_path, slip
from locfuse.fusion.checks.start import START
from locfuse.fusion.checks.tried import Candidate, Fixes, keys
from locfuse.fusion.checks.truth import FEW
from locfuse.fusion.data import BASES, LASER, Estimates
from locfuse.fusion.judge.consistency import MAX_SIGMA_FACTOR, Consistency, judge
from locfuse.fusion.judge.evaluate import covariance_check
from locfuse.fusion.judge.innovations import OwnInnovations, own
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.truth import poses_at

from .trial import Trial

SHARED_ROLES = {"wheels", "start", "truth"}  # roles whose settings change every configuration
WORTH_TRYING = Least(0.005, 2.0)  # least size of a fault to try a fix
UNREMARKABLE = {"consistent", "unclear"}  # verdicts on residuals that need no fix


def as_fixes(fix_values: Mapping[str, float]) -> Fixes:
    """Return settings as the words of --set, "key=value" each."""
    return tuple(f"{key}={value:g}" for key, value in fix_values.items())


class Judged:
    """One log compared under some settings, with the configurations that judge fixes of each sensor."""

    def __init__(self, compared: Compared, trial: Trial, fixes: Fixes) -> None:
        self.compared, self.trial, self.fixes = compared, trial, fixes
        self.covariance_checks = {e.name: covariance_check(e) for e in compared.evaluations}
        self.overconfident = overconfident_by_truth(self.covariance_checks)
        by_run = judge(compared.runs, compared.loaded.robot, self.overconfident)
        self.consistency = {s: found for by_sensor in by_run.values() for s, found in by_sensor.items()}

    @property
    def loaded(self) -> Loaded:
        """The log under the settings of the kept fixes."""
        return self.compared.loaded

    @cached_property
    def doctor(self) -> list[Finding]:
        """Findings by comparison of the sensors with each other (`fusion.checks`)."""
        loaded = self.trial.whole_under(self.fixes)
        if loaded is None or (any(loaded.window) and not loaded.how.beside_hole):
            return []  # checks need whole drives
        found = examined(loaded, WORTH_TRYING)
        return [f for f in found if f.code != FEW and (f.code != START or self._starts_in_map)]

    @property
    def _starts_in_map(self) -> bool:
        """Whether errors count from the start that is configured."""
        return self.trial.align == "none" and not self.loaded.how.begin

    def _looks_wrong(self, sensor: str) -> bool:
        """Return whether a sensor's residuals are unusual, or its run is inconsistent."""
        return self._verdict(sensor) not in UNREMARKABLE or self._doubtful(self._alone(sensor))

    def _verdict(self, sensor: str) -> str:
        """Return the verdict on a sensor's residuals; "unclear" without residuals."""
        verdict = self.consistency.get(sensor)
        return "unclear" if verdict is None else verdict.verdict

    def _doubtful(self, name: str) -> bool:
        """Return whether a run is lost, or its covariance does not fit the truth or is not checked by truth."""
        check = self.covariance_checks.get(name)
        lost = any(e.lost for e in self.compared.estimates if e.name == name)
        return check is None or lost or not check.consistent

    def constant(self, verdict: Consistency) -> tuple[Fixes, ...]:
        """Return the fix of a constant error; () if the verdict is not "biased"."""
        return (as_fixes(verdict.fix_values),) if verdict.verdict == "biased" and verdict.fix_values else ()

    def _candidate(self, finding: Finding, alternatives: tuple[Fixes, ...], offer: bool = False) -> Candidate:
        judges = self.judges(finding.role)
        kept = self.kept(finding.role)
        minor = tuple(n for n in judges if n not in kept)
        others = tuple(n for n in minor if n not in BASES) if finding.role in SHARED_ROLES else ()
        return Candidate(finding, alternatives, judges, minor, others, offer)

    def kept(self, role: str) -> set[str]:
        """Return the configurations that a user would keep: all sensors, and the best one that uses this role."""
        return {self._all(), self._best(self._using(role))}

    def _using(self, role: str) -> list[str]:
        """Return the configurations that a fix of this role (a sensor, wheels, start, truth) changes."""
        known = self.trial.configurations
        return list(known) if role in SHARED_ROLES else [n for n, c in known.items() if role in c.sensors]

    def judges(self, role: str) -> tuple[str, ...]:
        """Return the configurations that judge a fix of this role.

        A sensor's fix is judged by three configurations with this sensor: the best one, all sensors, and the best
        one with fewer sensors, in which the fix has the largest effect. All configurations judge a fix of wheels,
        start or truth: a track that fits one drive's slip may improve odometry and harm a camera.
        """
        if role in SHARED_ROLES:
            known = self.trial.configurations
            kept = (self._best(known), self._all())
            others = (n for n in known if n not in kept and n not in BASES)  # judged before the kept ones
            # without truth, errors of odometry (one random walk) are chance: it judges only if it is alone
            walk_judges = self.loaded.drive.truth is not None or len(known) == 1
            walk = tuple(n for n in BASES if n in known and walk_judges)
            # for wheels odometry is first: if its error halves, later judges may get worse by chance
            order = (*walk, *others, *kept) if role == "wheels" else (*others, *kept, *walk)
            return tuple(n for n in dict.fromkeys(order) if n not in BASES or walk)
        using = self._using(role)
        if not using:
            return ()
        fewer = [n for n in using if n != self._all()] or using
        return tuple(dict.fromkeys((self._best(fewer), self._best(using), self._all())))

    def _all(self) -> str:
        return max(self.trial.configurations, key=lambda n: len(self.trial.configurations[n].sensors))

    def _alone(self, sensor: str) -> str:
        """Return the configuration with this sensor and the fewest other sensors."""
        return min(self._using(sensor), key=lambda n: len(self.trial.configurations[n].sensors))

    def _best(self, names: Iterable[str]) -> str:
        """Return the configuration with the smallest position error; without truth, the one with most sensors."""
        errors = {e.name: e.figures.get("position_rmse_m") for e in self.compared.evaluations}
        known = {n: e for n in names if (e := errors.get(n)) is not None}
        if known:
            return min(known, key=lambda n: known[n])
        return max(names, key=lambda n: len(self.trial.configurations[n].sensors))

    def _reference(self, sensor: str) -> Estimates | None:
        """Return the run of another single sensor with usual residuals and the smallest heading sigma."""
        fine = {s for s in self.loaded.drive.measurements if s != sensor and self._verdict(s) in UNREMARKABLE}
        runs = self.runs_alone(*fine) if fine else []
        return min(runs, key=lambda e: float(np.median(e.triangles[:, 5])), default=None)

    def runs_alone(self, *sensors: str) -> list[Estimates]:
        """Return the filtered runs with a single sensor that were never lost; `sensors`: only of these sensors."""
        runs = (e for e in self.compared.estimates if len(e.sensors) == 1 and not e.lost)
        return [e for e in runs if not sensors or e.sensors[0] in sensors]


WHEEL_NOISE_FACTORS = (0.1, 0.3, 3.0, 10.0)
TOO_LOW = 2.0  # times the observed sigma is tried too: the gate has rejected the largest residuals
MAX_OFFERED_FACTOR = 8.0  # largest proposed increase of a sigma: more would disable the sensor
MAX_TRUTH_FACTOR = 2.0  # largest sigma that is tried, as multiple of the error by truth
MAX_NOISE_FACTOR = 4.0  # largest change of a sigma by ANEES, up or down
FLOORS, FLOOR_FACTORS = ("floor_range", "floor_angle_deg"), (5.0, 10.0, 20.0)  # of a laser's lines
NOISE_VERDICTS = {"understated", "overstated", "correlated"}


class NoiseFindings(Judged):
    """One log compared under some settings, with findings on sensor and wheel noise."""

    def noise(self) -> list[Candidate]:
        """Return candidate fixes of the noise settings of sensors and wheels."""
        found = []
        for sensor, verdict in self.consistency.items():
            if verdict.verdict == "overstated" and sensor != LASER and self.loaded.drive.truth is None:
                continue  # costs little, and no truth would show errors that last longer than its readings do
            seen, more = _noise_options(sensor, verdict), self._by_anees(sensor)
            by_ranges, words = self._as_ranges_scatter(sensor, verdict), verdict.words
            if by_ranges:
                seen.append(by_ranges)
                words += f" by its lines, {by_ranges[0].partition('=')[2]} m by its ranges"
            smaller = _smaller_range_noise(sensor, verdict)
            scattered = smaller is not None and scatter_more(self._ranges_sigma, smaller)
            if scattered or self._overconfident(sensor, verdict):
                seen = []
            code, words = (verdict.verdict, words) if seen else self._by_truth(sensor)
            found += self._shared_by_lines(sensor, verdict)
            by_settings = (f"{sensor}.covariance=sigma",) if self._claimed(sensor) else ()
            options = tuple(dict.fromkeys((*by_settings, *one) for one in (*seen, *more)))
            if sensor != LASER:  # the laser's noise is checked by its raw ranges
                settings = self.loaded.robot.settings(sensor)
                most = self._most_by_truth(sensor)
                options = tuple(fixes for fixes in options if useful(fixes, settings, most))
                if seen and not options and math.isfinite(most):
                    continue  # the truth shows that its readings are as exact as configured
            if options:
                found.append(self._candidate(Finding(sensor, code, words), options, not seen))
            elif seen:
                words += ": so much that something else is wrong with it"
                found.append(self._candidate(Finding(sensor, code, words), ()))
        as_configured = self._slip is not None and not self._slip.unusual  # slip in turns fits wheels.noise
        doubtful = self.loaded.drive.truth is not None and self._doubtful(self._best(self.trial.configurations))
        if doubtful and not as_configured:
            found.append(self._wheel_noise())
        return found

    def _most_by_truth(self, sensor: str) -> float:
        """Return the largest sigma to try, for the first noise key of a sensor: a multiple of its error by truth.

        Infinite if the truth does not show the sensor's error.
        """
        drive, settings = self.loaded.drive, self.loaded.robot.settings(sensor)
        if drive.truth is None:
            return math.inf
        every = drive.measurements[sensor]
        m = every.take(np.flatnonzero(drive.truth.spans(every.t)))
        spread = REGISTRY[sensor].misfit(m, settings, poses_at(drive.truth, m.t)) if len(m.t) else None
        if spread is None or not math.isfinite(spread):
            return math.inf
        now = float(getattr(settings, REGISTRY[sensor].noise_keys[0]))
        return max(now, MAX_TRUTH_FACTOR * spread * REGISTRY[sensor].components[0].scale)

    def _claimed(self, sensor: str) -> dict[str, float]:
        """Return the sigmas that a sensor's messages claim, by noise key; {} if its settings give them."""
        m = self.loaded.drive.measurements.get(sensor)
        return {} if m is None else REGISTRY[sensor].claimed(m)

    def _shared_by_lines(self, sensor: str, verdict: Consistency) -> list[Candidate]:
        """Return fixes with larger line noise floors, if laser lines scatter more than their beams explain.

        Neighbouring beams of a depth camera share errors (calibration, disparity steps), which averaging over a
        line does not reduce.
        """
        if sensor != LASER or verdict.verdict != "correlated" or verdict.fix_values:
            return []
        own_run = self._innovations(sensor, ())
        if own_run is None or own_run.nis < MAX_SIGMA_FACTOR**2:
            return []
        settings = self.loaded.robot.settings(LASER)
        words = (
            f"lines scatter {own_run.nis**0.5:.2g} times as far as the noise of their beams says: beams of a line "
            "share their error (a depth camera, walls that are not flat)"
        )
        now = {key: getattr(settings, key) for key in FLOORS}
        options = tuple(
            tuple(f"{LASER}.{key}={v * factor:.2g}" for key, v in now.items()) for factor in FLOOR_FACTORS
        )
        return [self._candidate(Finding(LASER, "floor", words), options, True)]

    @cached_property
    def _ranges_sigma(self) -> float | None:
        """Standard deviation of one range [m], from the laser's raw ranges; None if they do not show it."""
        if LASER not in self.loaded.drive.measurements:
            return None
        return ranges_sigma(self.loaded.stream(LASER), self.loaded.robot.settings(LASER))

    @cached_property
    def _walls_bend(self) -> bool:
        """Whether straight walls look bent in the laser's raw ranges, as with a constant range error."""
        stream = self.loaded.stream(LASER) if LASER in self.loaded.drive.measurements else None
        return stream is not None and bool(of_offset(stream, self.loaded.robot.settings(LASER)))

    @property
    def _ranges_scatter(self) -> bool:
        """Whether the laser's raw ranges scatter more than lrf.sigma_range."""
        return scatter_more(self._ranges_sigma, self.loaded.robot.settings(LASER).sigma_range)

    def _as_ranges_scatter(self, sensor: str, verdict: Consistency) -> Fixes:
        """Return the laser's noise settings scaled to the sigma of its raw ranges; () if its lines contradict it.

        A sigma that is far too high merges two walls into one line, whose residuals are too large.
        """
        smaller, shown = _smaller_range_noise(sensor, verdict), self._ranges_sigma
        if smaller is None or shown is None or not smaller / MAX_SIGMA_FACTOR <= shown < smaller:
            return ()
        settings = self.loaded.robot.settings(LASER)
        share = shown / settings.sigma_range
        return tuple(f"{LASER}.{k}={getattr(settings, k) * share:.2g}" for k in REGISTRY[LASER].noise_keys)

    @cached_property
    def _slip(self) -> WheelSlip | None:
        """Wheel slip in turns, or in distances against the laser's path if it is larger there; None if unknown."""
        drive, found = self.loaded.drive, slip(self.loaded.drive)
        for e in self.runs_alone(LASER):
            if found is not None and found.factor < 1.0:
                found = beside_path(found, drive, e.t, e.pose)
        return found

    @property
    def _slips_unusually(self) -> bool:
        """Whether the wheels slip more than wheels.noise allows, or clearly less.

        Less slip is accepted only if truth can judge it: wheels may slip rarely but far.
        """
        found, truth = self._slip, self.loaded.drive.truth
        return found is not None and found.unusual and (found.factor > 1.0 or truth is not None)

    def _overconfident(self, sensor: str, verdict: Consistency) -> bool:
        """Return whether residuals call a sensor's sigma too large, but by truth its run is overconfident."""
        check = self.covariance_checks.get(self._alone(sensor))
        return verdict.verdict == "overstated" and check is not None and check.overconfident

    def _innovations(self, sensor: str, fixes: Fixes) -> OwnInnovations | None:
        """Return a sensor's innovation statistics with these settings added; None if fusing fails."""
        tried = self.trial.under((*self.fixes, *fixes))
        run = self.trial.run((*self.fixes, *fixes), self._alone(sensor))
        if tried is None or run is None:
            return None
        return own(run.audits[sensor], tried.drive.measurements[sensor])

    def _by_anees(self, sensor: str) -> list[Fixes]:
        """Return the sensor's noise settings multiplied by the square root of its run's ANEES.

        [] if the residuals are consistent. The laser's residuals are ignored: its map shares errors of its scans.
        """
        if sensor != LASER and self._verdict(sensor) == "consistent":
            return []
        check = self.covariance_checks.get(self._alone(sensor))
        if check is None or check.consistent or check.anees <= 0.0:
            return []
        settings, noise_keys = self.loaded.robot.settings(sensor), REGISTRY[sensor].noise_keys
        if keys(self.fixes) & {f"{sensor}.{key}" for key in noise_keys}:
            return []  # already changed by a fix: the remaining error has another cause
        factor = check.anees**0.5
        if not 1.0 / MAX_NOISE_FACTOR <= factor <= MAX_NOISE_FACTOR:
            return []  # too large for noise
        if sensor == LASER and factor > 1.0 and self._ranges_sigma is not None and not self._ranges_scatter:
            return []  # its raw ranges scatter as configured: something else is wrong
        now = self._claimed(sensor) or {k: getattr(settings, k) for k in noise_keys}
        return [tuple(f"{sensor}.{k}={value * factor:.2g}" for k, value in now.items())]

    def _by_truth(self, sensor: str) -> tuple[str, str]:
        """Return the verdict on a sensor's noise by its run's ANEES, and a sentence with errors in sigmas.

        The verdict is "understated" or "overstated".
        """
        check = self.covariance_checks.get(self._alone(sensor))
        times = 1.0 if check is None else check.anees**0.5
        words = f"position errors with it are {times:.2g} times what the covariance claims"
        return "understated" if check is None or check.anees > 1.0 else "overstated", words

    def _wheel_noise(self) -> Candidate:
        noise = self.loaded.robot.wheels.noise
        words = f"wheels.noise = {noise:g} m does not fit this drive"
        check = self.covariance_checks.get(self._best(self.trial.configurations))
        more_noise = check is not None and check.anees > 1.0  # an overconfident filter
        factors = () if check is None else tuple(f for f in WHEEL_NOISE_FACTORS if (f > 1.0) == more_noise)
        measured = self._slips_unusually
        if measured and self._slip is not None:
            words = self._slip.words
            factors = (self._slip.factor, *factors)
        if any(e.slips for e in self.compared.estimates):  # slips were detected: less noise cannot be right
            factors = tuple(factor for factor in factors if factor > 1.0)
        options = tuple((f"wheels.noise={noise * factor:.2g}",) for factor in factors)
        found = self._candidate(Finding("wheels", "noise", words), options, True)
        # odometry, one random walk, cannot judge noise; minor configurations change by chance
        judges = tuple(n for n in found.judges if n not in found.minor and n not in BASES)
        return replace(found, judges=judges, guards=tuple(self.trial.configurations), measured=measured)


def _smaller_range_noise(sensor: str, verdict: Consistency) -> float | None:
    """Return the smaller range sigma [m] that a laser's lines show, None if they do not."""
    shown = sensor == LASER and verdict.verdict == "overstated"
    return verdict.fix_values.get(f"{LASER}.sigma_range") if shown else None


def useful(fixes: Fixes, settings: Any, most: float) -> bool:
    """Return whether proposed sigmas are plausible, the first one at most `most`.

    A much larger sigma than configured would disable the sensor.
    """
    changed = (fix.partition("=") for fix in fixes if ".covariance=" not in fix)
    pairs = [(float(value), getattr(settings, key.partition(".")[2], None)) for key, _, value in changed]
    plausible = all(not now or value <= MAX_OFFERED_FACTOR * now for value, now in pairs)
    return plausible and all(value <= most for value, _ in pairs[:1])


def _noise_options(sensor: str, verdict: Consistency) -> list[Fixes]:
    """Return alternative fixes of a noise verdict; [] if it proposes no values.

    For correlated residuals: a larger sigma, or a drifting offset. For others: the proposed sigma, and a still
    larger one if the verdict is "understated".
    """
    if verdict.verdict not in NOISE_VERDICTS or not verdict.fix_values:
        return []
    if verdict.verdict == "correlated":  # a larger sigma, or a drifting offset
        noise = {k: v for k, v in verdict.fix_values.items() if k.partition(".")[2] in REGISTRY[sensor].noise_keys}
        walks = {k: v for k, v in verdict.fix_values.items() if k not in noise}
        return [as_fixes(fix_values) for fix_values in (noise, walks) if fix_values]
    larger = {key: float(f"{TOO_LOW * value:.2g}") for key, value in verdict.fix_values.items()}
    return [as_fixes(verdict.fix_values), *([as_fixes(larger)] if verdict.verdict == "understated" else [])]
