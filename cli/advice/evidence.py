"""What looks wrong in a log under some settings, and which settings might be right: candidates to be tried.

The order of evidence: as long as a clock, a mount, a scale or a direction may be wrong, nothing is said of offsets
and noise, since each of these looks like one.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cached_property

from locfuse.cli.pipeline.compare import Compared
from locfuse.cli.pipeline.load import Loaded
from locfuse.cli.pipeline.trust import sensors_consistency
from locfuse.fusion.advice.probes import of_offsets, of_probe, probe_of
from locfuse.fusion.advice.search import Candidate, Fixes
from locfuse.fusion.doctor.clocks import clock_lags, lags_by_truth
from locfuse.fusion.doctor.examine import examine
from locfuse.fusion.doctor.finding import Finding
from locfuse.fusion.doctor.lag import worth_saying
from locfuse.fusion.judge.consistency import Consistency
from locfuse.fusion.judge.covariance import honesty
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.streams import merged

from .trial import Trial

ODOMETRY, ALL = "odometry", "all"
REFERENCE = {"wheels", "start", "truth"}  # roles whose settings move every configuration
WHEEL_NOISE_FACTORS = (0.1, 0.3, 3.0, 10.0)
MIN_LAG_S, MIN_LAG_SIGMAS = 0.005, 2.0  # s, standard deviations: a smaller lag against the truth is not tried
MAX_NOISE_FACTOR = 4.0  # on a sigma, by the errors of its own run
CLOCK = "lag"  # what clocks' findings are called
NOISE = {"understated", "overstated", "correlated"}


class Evidence:
    """One log compared under some settings, and what can be asked of it."""

    def __init__(self, compared: Compared, trial: Trial, fixes: Fixes) -> None:
        self.compared, self.trial, self.fixes = compared, trial, fixes
        self.consistency = {
            s: found
            for name, by_sensor in sensors_consistency(compared.runs, compared.loaded.robot).items()
            for s, found in by_sensor.items()
        }
        self.honesty = {e.name: honesty(e) for e in compared.evaluations if not e.smoothed}

    @property
    def loaded(self) -> Loaded:
        """The log under the settings that were kept."""
        return self.compared.loaded

    def suspicious(self) -> bool:
        """Return whether anything looks wrong at all: else nothing is tried, and nothing costs time."""
        noise = any(f.verdict not in {"consistent", "unclear"} for f in self.consistency.values())
        overconfident = any(h is not None and h.anees > h.bounds[1] for h in self.honesty.values())
        lost = any(e.lost for e in self.compared.estimates)
        return noise or overconfident or lost or self._lags() or self._worse_than_odometry()

    def _lags(self) -> bool:
        drive = self.loaded.drive
        return any(worth_saying(lag) for lag in clock_lags(drive.measurements, drive.wheels).values())

    def _worse_than_odometry(self) -> bool:
        errors = {e.name: e.figures.get("position_rmse_m") for e in self.compared.evaluations}
        base = errors.get(ODOMETRY)
        if base is not None:
            return any(e is not None and e > base for e in errors.values())
        return any(s.high < 0.0 for s in self.compared.scores)

    # ---- candidates, in the order of evidence ----

    def clocks(self) -> list[Candidate]:
        """Return what measuring and the truth say of clocks: while one is wrong, the rest is not to be trusted."""
        return self._candidates([f for f in self.doctor if f.code == CLOCK], list(self._late()))

    def geometry(self) -> list[Candidate]:
        """Return what measuring and a run with more states say of mounts, scales and directions."""
        return self._candidates([f for f in self.doctor if f.code != CLOCK], list(self._probed()))

    def _candidates(self, seen: Sequence[Finding], offers: Sequence[Finding]) -> list[Candidate]:
        """Return candidates; a sensor that no run can use as it is (its readings are refused) has no judge."""
        known = {(f.role, f.code) for f in seen}
        seen = [f for f in seen if f.fixes and self.judges(f.role)]
        offers = [f for f in offers if (f.role, f.code) not in known]
        return [Candidate(f, (f.fixes,), self.judges(f.role), offer=f in offers) for f in (*seen, *offers)]

    @cached_property
    def doctor(self) -> list[Finding]:
        """Return what the sensors say of each other (`fusion.doctor`)."""
        loaded = self.loaded
        if any(loaded.window) or loaded.robot.preset != "default":
            return []  # the doctor looks at whole drives
        streams = {
            role: merged([loaded.log.stream(topic, loaded.robot.order) for topic in loaded.choice.of(role)])
            for role in loaded.choice.topics
        }
        return examine(loaded.drive, loaded.robot, streams)

    def _late(self) -> Iterator[Finding]:
        """Yield clock lags against the truth's headings, of sensors whose own run is inconsistent."""
        for sensor, lag in lags_by_truth(self.loaded.drive).items():
            if abs(lag.offset) < max(MIN_LAG_S, MIN_LAG_SIGMAS * lag.sigma) or not self._doubtful(
                self._alone(sensor)
            ):
                continue
            offset = self.loaded.robot.settings(sensor).time_offset + lag.offset
            late = "late" if lag.offset < 0.0 else "early"
            message = f"stamps look {abs(lag.offset):.3f} s {late} against the truth"
            yield Finding(sensor, "lag", message, (f"{sensor}.time_offset={offset:.3f}",))

    def _probed(self) -> Iterator[Finding]:
        """Yield mounts and the track as a run with `all` sensors estimates them, one sensor at a time."""
        drive, robot = self.loaded.drive, self.loaded.robot
        for sensor in drive.measurements:
            probe = probe_of(robot, sensor)
            if not probe or not REGISTRY[sensor].placed or not self._doubtful(self._alone(sensor)):
                continue
            probed = self.trial.under((*self.fixes, *probe))
            run = None if probed is None else self.trial.fused(probed, self._alone(sensor))
            if run is not None and not run.lost:
                yield from of_probe(robot, sensor, run)

    def offsets(self) -> list[Candidate]:
        """Return constant errors: offsets that were estimated or are configured wrongly, a mirrored camera."""
        found = [
            Candidate(f, (f.fixes,), self.judges(f.role), offer=True)
            for e in self.compared.estimates
            if e.name == self._all() and not e.smoothed and self.loaded.drive.truth is not None
            for f in of_offsets(self.loaded.robot, e)
        ]
        for sensor, verdict in self.consistency.items():
            options = [_set(verdict.cures)] if verdict.verdict == "biased" and verdict.cures else []
            if sensor == "camera" and verdict.verdict in {"biased", "outliers", "contradicts", "understated"}:
                options.append(
                    (f"camera.clockwise={str(not self.loaded.robot.settings('camera').clockwise).lower()}",)
                )
            if options:
                finding = Finding(sensor, verdict.verdict, verdict.words)
                found.append(Candidate(finding, tuple(options), self.judges(sensor)))
        return found

    def noise(self) -> list[Candidate]:
        """Return noise that does not fit, sensor by sensor, and that of the wheels."""
        found = []
        for sensor, verdict in self.consistency.items():
            seen, more = _noise_options(verdict), self._by_anees(sensor)
            words = verdict.words if seen else self._errors_in_sigmas(sensor)
            if seen or more:
                finding = Finding(sensor, verdict.verdict, words)
                options = tuple(dict.fromkeys((*seen, *more)))
                found.append(Candidate(finding, options, self.judges(sensor), offer=not seen))
        if self.loaded.drive.truth is not None and self._doubtful(self._best(self.trial.configurations)):
            found.append(self._wheel_noise())
        return found

    def _by_anees(self, sensor: str) -> list[Fixes]:
        """Return the sensor's noise scaled by what truth says of the run that uses it alone."""
        honest = self.honesty.get(self._alone(sensor))
        if honest is None or honest.bounds[0] <= honest.anees <= honest.bounds[1] or honest.anees <= 0.0:
            return []
        settings, keys = self.loaded.robot.settings(sensor), REGISTRY[sensor].noise_keys
        factor = honest.anees**0.5
        if not 1.0 / MAX_NOISE_FACTOR <= factor <= MAX_NOISE_FACTOR:
            return []  # that is no noise
        return [tuple(f"{sensor}.{k}={getattr(settings, k) * factor:.2g}" for k in keys)]

    def _errors_in_sigmas(self, sensor: str) -> str:
        """Return how much larger or smaller the errors of the sensor's own run are than it claims."""
        honest = self.honesty.get(self._alone(sensor))
        times = 1.0 if honest is None else honest.anees**0.5
        return f"position errors with it are {times:.2g} times what the covariance claims"

    def _wheel_noise(self) -> Candidate:
        noise = self.loaded.robot.wheels.noise
        finding = Finding("wheels", "noise", f"wheels.noise = {noise:g} m does not fit this drive")
        options = tuple((f"wheels.noise={noise * factor:.2g}",) for factor in WHEEL_NOISE_FACTORS)
        judges = [n for n in self.judges("wheels") if n != ODOMETRY]  # its one random walk tells no noise
        return Candidate(finding, options, tuple(judges), offer=True)

    # ---- configurations that judge ----

    def _doubtful(self, name: str) -> bool:
        """Return whether a configuration is inconsistent by truth; without truth any may be, once one looks so."""
        honest = self.honesty.get(name)
        lost = any(e.lost for e in self.compared.estimates if e.name == name)
        return honest is None or lost or not honest.bounds[0] <= honest.anees <= honest.bounds[1]

    def judges(self, role: str) -> tuple[str, ...]:
        """Return the configurations by which a role's fix is judged: the best that uses it, and all sensors."""
        if role in REFERENCE:
            return tuple(dict.fromkeys((ODOMETRY, self._best(self.trial.configurations), self._all())))
        using = [n for n, c in self.trial.configurations.items() if role in c.sensors]
        if not using:
            return ()
        return tuple(dict.fromkeys((self._best([n for n in using if n != self._all()] or using), self._all())))

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


def _noise_options(verdict: Consistency) -> list[Fixes]:
    """Return the alternatives of one noise verdict: all keys of a sigma at once, else one key after the other."""
    if verdict.verdict not in NOISE or not verdict.cures:
        return []
    if verdict.verdict == "correlated":
        return [(f"{key}={value:g}",) for key, value in verdict.cures.items()]
    return [_set(verdict.cures)]


def _set(cures: Mapping[str, float]) -> Fixes:
    return tuple(f"{key}={value:g}" for key, value in cures.items())
