"""What looks wrong in a log under some settings, and which settings might be right: candidates to be tried.

The order of evidence: as long as a clock, a mount, a scale or a direction may be wrong, nothing is said of offsets
and noise, since each of these looks like one.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from locfuse.cli.pipeline.compare import Compared
from locfuse.cli.pipeline.load import Loaded
from locfuse.cli.pipeline.trust import overconfident, sensors_consistency
from locfuse.fusion.advice.probes import beyond_prior, of_mount, of_offsets, of_probe, of_scale, probe_of
from locfuse.fusion.advice.search import Candidate, Fixes, together
from locfuse.fusion.advice.slip import Slip, slip
from locfuse.fusion.data import Estimates, Truth
from locfuse.fusion.doctor.clocks import clock_lags, lag_of_run, lags_by_truth
from locfuse.fusion.doctor.examine import examine, scales
from locfuse.fusion.doctor.finding import Finding, Least
from locfuse.fusion.doctor.lag import SAID_SIGMAS, Lag, worth_saying
from locfuse.fusion.doctor.laser import OPEN_SCALE
from locfuse.fusion.doctor.laser_driver import ranges_sigma, scatter_more
from locfuse.fusion.doctor.truth import WHEEL_SCALE
from locfuse.fusion.judge.consistency import Consistency
from locfuse.fusion.judge.consistency import Evidence as Said
from locfuse.fusion.judge.covariance import honesty
from locfuse.fusion.judge.innovations import heard
from locfuse.fusion.judge.noise_verdicts import MAX_SIGMA_FACTOR, NoiseVerdict, biased_against
from locfuse.fusion.sensors.registry import REGISTRY

from .trial import Trial

ODOMETRY, LASER = "odometry", "lrf"
REFERENCE = {"wheels", "start", "truth"}  # roles whose settings move every configuration
WHEEL_NOISE_FACTORS = (0.1, 0.3, 3.0, 10.0)
MIN_LAG_S, MIN_LAG_SIGMAS = 0.005, 2.0  # s, standard deviations: a smaller lag against the truth is not tried
MIN_SURE_LAG_SIGMAS = 3.0  # standard deviations, of a sensor that looks right otherwise
WORTH_TRYING = Least(0.005, 2.0)  # what is worth saying untried is larger
SUSPICIOUS = Least(0.005, 2.5)  # what is reason enough to fuse again where nothing else looks wrong
MIN_SUSPICIOUS_LAG_S, MIN_SUSPICIOUS_SIGMAS = 0.01, 2.5  # s, standard deviations: the same of clocks
AS_SURE = 1.5  # times a lag's sigma: another sensor's that is known no worse says what slips do to both
TOO_LOW = 2.0  # a sigma that is set too low refuses the large residuals, so the observed one is a lower bound
CAMERA_LAGS_S = (-0.2, -0.1, 0.1, 0.2)  # s
MAX_NOISE_FACTOR = 4.0  # on a sigma, by the errors of its own run
CLOCK = "lag"  # what clocks' findings are called
NOISE = {"understated", "overstated", "correlated"}
FINE = {"consistent", "unclear"}  # verdicts on a sensor that are no complaint


Offer = tuple[Finding, tuple[Fixes, ...]]  # no observation, only settings that may help
Key = tuple[str, str]  # role and code of a finding


class Evidence:
    """One log compared under some settings, and what can be asked of it."""

    def __init__(self, compared: Compared, trial: Trial, fixes: Fixes) -> None:
        self.compared, self.trial, self.fixes = compared, trial, fixes
        self.honesty = {e.name: honesty(e) for e in compared.evaluations if not e.smoothed}
        by_run = sensors_consistency(compared.runs, compared.loaded.robot, self.honesty)
        self.consistency = {s: found for by_sensor in by_run.values() for s, found in by_sensor.items()}

    @property
    def loaded(self) -> Loaded:
        """The log under the settings that were kept."""
        return self.compared.loaded

    def suspicious(self) -> bool:
        """Return whether anything looks wrong at all: else nothing is tried, and nothing costs time."""
        noise = any(f.verdict not in FINE for f in self.consistency.values())
        claims_too_much = bool(overconfident(self.honesty))
        lost = any(e.lost for e in self.compared.estimates)
        seen = (
            noise
            or claims_too_much
            or lost
            or self._lags()
            or self._worse_than_odometry()
            or bool(self._mounts_found)
            or bool(self._beyond_prior)
        )
        return (
            seen
            or bool(self._biases_again)
            or self._slips_unusually
            or self._ranges_scatter
            or bool(scales(self.loaded.drive, self.loaded.robot, SUSPICIOUS))
        )

    def _lags(self) -> bool:
        return bool(self._late) or any(worth_saying(lag) for lag in self._by_wheels.values())

    @cached_property
    def _by_wheels(self) -> dict[str, Lag]:
        drive = self.loaded.drive
        return clock_lags(drive.measurements, drive.wheels)

    def _worse_than_odometry(self) -> bool:
        errors = {e.name: e.figures.get("position_rmse_m") for e in self.compared.evaluations}
        base = errors.get(ODOMETRY)
        if base is not None:
            return any(e is not None and e > base for e in errors.values())
        return any(s.high < 0.0 for s in self.compared.scores)

    # ---- candidates, in the order of evidence ----

    def clocks(self) -> list[Candidate]:
        """Return what measuring and the truth say of clocks: while one is wrong, the rest is not to be trusted."""
        pictures = list(self._late_pictures())
        offers = [*self._late, *self._late_wheels(), *pictures]
        by_truth = self.loaded.drive.truth is not None
        seen = [f for f in self.doctor if f.code == CLOCK]
        named = {(f.role, f.code) for f in seen}
        measured = {("wheels", CLOCK), *((f.role, f.code) for f, _ in self._late if by_truth)}
        found = self._candidates(seen, offers, named, named | measured)
        found = [replace(c, by_shape=by_truth and c.finding.role == LASER) for c in found]
        sensors = tuple(self.loaded.drive.measurements)
        found = [replace(c, rivals=sensors) if c.finding.role == "wheels" else c for c in found]
        return [*found, *(self._constant_of(f.role) for f, _ in pictures if _constant(self.consistency[f.role]))]

    def geometry(self) -> list[Candidate]:
        """Return what measuring and a run with more states say of mounts, scales and directions."""
        probed = [] if self._open_scale else [*self._probed(), *self._scaled()]
        named = {(f.role, f.code) for f in probed}
        mounts = [] if self._open_scale else self._mounts_found
        found = [*probed, *(f for f in mounts if (f.role, f.code) not in named)]
        offers = [(f, (f.fixes,)) for f in found]
        # a state's sigma is evidence only where the run is consistent, or less sure than it could be
        measured = {(f.role, f.code) for f in found if self._verdict(f.role) in {*FINE, "overstated"}}
        by_truth = {("wheels", WHEEL_SCALE)}  # the truth's own distances
        return self._candidates([f for f in self.doctor if f.code != CLOCK], offers, by_truth, measured)

    def _candidates(
        self,
        seen: Sequence[Finding],
        offers: Sequence[Offer],
        by_measuring: Collection[Key],
        by_offers: Collection[Key],
    ) -> list[Candidate]:
        """Return candidates; a sensor that no run can use as it is (its readings are refused) has no judge.

        `by_measuring` names those of `seen` whose value the drive shows beyond chance, `by_offers` of `offers`.
        """
        seen = [self._decided(f) for f in seen]
        known = {(f.role, f.code) for f in seen}
        judged = [f for f in seen if (f.fixes or f.code == OPEN_SCALE) and self.judges(f.role)]
        coarse = [self._candidate(f, (*_ways(f), *self._aimed(f)), not f.severe) for f in judged]
        # of what measuring shows too, the value itself: it is tried beside that
        sharper = [
            self._candidate(f, tries[:1] if (f.role, f.code) in known else tries, True) for f, tries in offers
        ]
        return [
            *(replace(c, measured=c.key in by_measuring) for c in coarse),
            *(replace(c, measured=c.key in by_offers) for c in sharper),
        ]

    def _aimed(self, finding: Finding) -> tuple[Fixes, ...]:
        """Return the fix of mirrored pictures with their zero by the run of a sensor that nothing contradicts.

        Measuring has it by the wheels alone, which a wrong track turns too far.
        """
        run = self._reference("camera") if (finding.role, finding.code) == ("camera", "mirrored") else None
        loaded = None if run is None else self.trial.under(together(self.fixes, finding.fixes))
        if run is None or loaded is None:
            return ()
        found = heard(loaded.drive, loaded.robot, run, "camera")
        if found is None or found.bias is None:
            return ()
        cures = biased_against("camera", loaded.robot.settings("camera"), found).cures
        return (together(finding.fixes, _set(cures)),)

    @property
    def _open_scale(self) -> bool:
        """Whether laser and wheels surely differ in distance and nothing tells who is right: that moves mounts."""
        return any(f.severe and not self._decided(f).fixes for f in self.doctor if f.code == OPEN_SCALE)

    def _decided(self, finding: Finding) -> Finding:
        """Return a finding; without its fix where nothing tells whose distances are right, laser's or wheels'.

        The laser's own readings are predicted better if its distances are the wheels', whoever is wrong.
        """
        known = self.loaded.drive.measurements
        few = np.arange(2)  # readings: whether a sensor tells its turning does not depend on them
        if finding.code != OPEN_SCALE or any(REGISTRY[s].heading(m.take(few)) is None for s, m in known.items()):
            return finding  # what knows more than its own turning may tell
        return replace(finding, fixes=(), message=f"{finding.message}. Nothing in this log says which")

    @cached_property
    def doctor(self) -> list[Finding]:
        """Return what the sensors say of each other (`fusion.doctor`)."""
        loaded = self.trial.whole_under(self.fixes)
        if loaded is None or any(loaded.window) or loaded.robot.preset != "default":
            return []  # the doctor looks at whole drives
        streams = {role: loaded.stream(role) for role in loaded.choice.topics}
        return examine(loaded.drive, loaded.robot, streams, WORTH_TRYING)

    @cached_property
    def _late(self) -> list[Offer]:
        """Return clock lags against the truth, without it against other runs and the wheels."""
        drive = self.loaded.drive
        if drive.truth is not None and drive.truth.theta is not None:
            return list(self._late_by_truth(self._lags_by_truth()))
        found: list[Offer] = []
        for offers in (self._late_by_runs(), self._late_by_each_other(), self._late_by_wheels()):
            named = {finding.role for finding, _ in found}
            found += (offer for offer in offers if offer[0].role not in named)
        return found

    def _lags_by_truth(self) -> dict[str, Lag]:
        """Return lags against the truth's headings; the laser's by its own run, where that tells it better.

        Not while another clock looks wrong, or the laser's by a tenth of a second: the run goes by the wheels too,
        and is late by a part of what they are.
        """
        drive, runs = self.loaded.drive, self.compared.estimates
        lags = lags_by_truth(drive, drive.truth)
        if any(f.code == CLOCK and (f.role != LASER or f.severe) for f in self.doctor):
            return lags
        own = (e for e in runs if e.sensors == (LASER,) and not e.smoothed and not e.lost)
        lag = next((lag_of_run(drive, drive.truth, e) for e in own), None)
        if lag is not None and (LASER not in lags or lag.sigma < lags[LASER].sigma):
            lags[LASER] = lag
        return lags

    def _late_by_truth(self, lags: Mapping[str, Lag]) -> Iterator[Offer]:
        """Yield lags against the truth's headings; small ones only of sensors that look wrong anyway.

        Not where another clock is surely wrong: what a few milliseconds change beside that is chance.
        """
        sure = any(f.code == CLOCK and f.severe for f in self.doctor)
        if self._was_set("truth", "time_offset") and lags:
            yield from self._truth_again(min(lags.values(), key=lambda lag: lag.sigma))
            return  # what is left against a clock that was set by the wheels, which slip, is that clock's
        for sensor, lag in lags.items():
            if not self._using(sensor):
                continue  # no run takes its readings as they are
            small = self._complained(sensor) and not sure
            sigmas = MIN_LAG_SIGMAS if small else MIN_SURE_LAG_SIGMAS
            least = MIN_LAG_S if small or self._was_set(sensor, "time_offset") else MIN_SUSPICIOUS_LAG_S
            if abs(lag.offset) >= max(least, sigmas * lag.sigma):
                yield from self._shifted(sensor, lag, "the truth")

    def _truth_again(self, lag: Lag) -> Iterator[Offer]:
        """Yield the truth's clock once more, by the sensor that knows its lag best."""
        if abs(lag.offset) >= max(MIN_LAG_S, MIN_SURE_LAG_SIGMAS * lag.sigma):
            side = "late" if lag.offset > 0.0 else "early"
            words = f"stamps look {abs(lag.offset):.3f} s {side} against the sensors (1 sigma {lag.sigma:.3f} s)"
            offset = self.loaded.robot.truth.time_offset - lag.offset
            yield Finding("truth", CLOCK, words), ((f"truth.time_offset={offset:z.3f}",),)

    def _late_by_runs(self) -> Iterator[Offer]:
        """Yield lags of sensors that look wrong against the run of another one that does not.

        So is a clock that was set: the wheels, which slip, told it less exactly than a run's headings do.
        """
        for sensor in self.loaded.drive.measurements:
            wrong = self._complained_itself(sensor) or self._was_set(sensor, "time_offset")
            run = self._reference(sensor) if wrong else None
            if run is None:
                continue
            truth = Truth("", run.t, run.pose[:, :2], run.pose[:, 2])
            lag = lags_by_truth(self.loaded.drive, truth).get(sensor)
            if lag is not None and abs(lag.offset) >= max(MIN_LAG_S, MIN_LAG_SIGMAS * lag.sigma):
                yield from self._shifted(sensor, lag, f"the headings of {run.name}")

    def _late_by_each_other(self) -> Iterator[Offer]:
        """Yield the lag between the run of one sensor and another's headings, as either one's: one of them is off.

        It is sharper than any against the wheels, which slip, and does not say whose it is. That is tried.
        """
        for e in self.compared.estimates:
            if e.sensors != (LASER,) or e.smoothed or e.lost:
                continue  # of no other sensor does a run go by its clock alone
            truth = Truth("", e.t, e.pose[:, :2], e.pose[:, 2])
            for sensor, lag in lags_by_truth(self.loaded.drive, truth).items():
                if sensor != LASER and abs(lag.offset) >= max(MIN_SUSPICIOUS_LAG_S, SAID_SIGMAS * lag.sigma):
                    yield from self._shifted(sensor, lag, f"the headings of {e.name}")
                    other = lag._replace(offset=-lag.offset)
                    yield from self._shifted(LASER, other, f"the headings of {sensor}")

    def _was_set(self, role: str, key: str) -> bool:
        """Return whether a fix that was kept sets this."""
        return any(fix.startswith(f"{role}.{key}=") for fix in self.fixes)

    def _late_by_wheels(self) -> Iterator[Offer]:
        """Yield lags against the wheels that are too small to be said untried.

        From four sigma on where a sensor that knows its lag as well has the same, since slips pull all alike.
        """
        for sensor, lag in self._by_wheels.items():
            sigmas = SAID_SIGMAS if self._late_like_others(sensor) else MIN_SUSPICIOUS_SIGMAS
            if abs(lag.offset) >= max(MIN_SUSPICIOUS_LAG_S, sigmas * lag.sigma):
                yield from self._shifted(sensor, lag, "the wheels")

    def _late_like_others(self, sensor: str) -> bool:
        """Return whether a sensor that knows its lag against the wheels about as well has the same."""
        own = self._by_wheels[sensor]
        return any(
            abs(lag.offset - own.offset) < MIN_LAG_SIGMAS * lag.sigma and lag.sigma <= AS_SURE * own.sigma
            for name, lag in self._by_wheels.items()
            if name != sensor
        )

    def _late_wheels(self) -> Iterator[Offer]:
        """Yield the wheels' clock where all sensors that turn are as late as each other: then it is theirs."""
        lags = [lag for lag in self._by_wheels.values() if 0.0 < lag.sigma < math.inf]
        if len(lags) < 2:
            return
        offsets, weights = np.array([lag.offset for lag in lags]), np.array([lag.sigma**-2 for lag in lags])
        mean = float(offsets @ weights / weights.sum())
        sigma = min(lag.sigma for lag in lags)  # the wheels' slips pull all of them alike: no mean is surer
        alike = (np.abs(offsets - mean) < MIN_LAG_SIGMAS * weights**-0.5).all()
        if alike and abs(mean) >= max(MIN_SUSPICIOUS_LAG_S, SAID_SIGMAS * sigma):
            names = " and ".join(self._by_wheels)
            words = f"stamps look {abs(mean):.3f} s {'late' if mean > 0.0 else 'early'} against {names} alike"
            yield (
                Finding("wheels", CLOCK, f"{words} (1 sigma {sigma:.3f} s)"),
                ((f"wheels.time_offset={self.loaded.robot.wheels.time_offset - mean:z.3f}",),),
            )

    def _shifted(self, sensor: str, lag: Lag, against: str) -> Iterator[Offer]:
        """Yield a lag with the offsets to be tried: the lag itself, and one standard deviation to either side."""
        if not math.isfinite(lag.sigma) or not self._using(sensor):
            return
        late = "late" if lag.offset < 0.0 else "early"
        message = f"stamps look {abs(lag.offset):.3f} s {late} against {against} (1 sigma {lag.sigma:.3f} s)"
        near = (lag.offset + step * lag.sigma for step in (0.0, -1.0, 1.0))
        yield Finding(sensor, CLOCK, message), self._offsets_in_time(sensor, near)

    def _reference(self, sensor: str) -> Estimates | None:
        """Return the run of one other sensor, which nothing contradicts, that knows its heading best."""
        fine = {s for s in self.loaded.drive.measurements if s != sensor and not self._complained_itself(s)}
        runs = [
            e
            for e in self.compared.estimates
            if len(e.sensors) == 1 and e.sensors[0] in fine and not e.smoothed and not e.lost
        ]
        return min(runs, key=lambda e: float(np.median(e.triangles[:, 5])), default=None)

    def _late_pictures(self) -> Iterator[Offer]:
        """Yield clocks to be tried of a camera that contradicts the rest: bearings know no turning.

        Not while measuring shows what is wrong: these are guesses.
        """
        if any(f.role == "camera" and f.severe and f.fixes for f in self.doctor):
            return
        verdict = self.consistency.get("camera")
        if verdict is not None and verdict.verdict not in {*FINE, "overstated"}:
            message = f"{verdict.words}; its clock explains that"
            yield Finding("camera", CLOCK, message), self._offsets_in_time("camera", CAMERA_LAGS_S)

    def _offsets_in_time(self, sensor: str, steps: Iterable[float]) -> tuple[Fixes, ...]:
        now = float(self.loaded.robot.settings(sensor).time_offset)
        return tuple((f"{sensor}.time_offset={now + step:z.3f}",) for step in steps)

    def _probed(self) -> Iterator[Finding]:
        """Yield mounts and the track as a run with `all` sensors estimates them, one sensor at a time."""
        drive, robot = self.loaded.drive, self.loaded.robot
        for sensor in filter(self._using, drive.measurements):
            probe = probe_of(robot, sensor)
            if not probe or not REGISTRY[sensor].placed:
                continue
            if not self._complained(sensor) and sensor not in self._beyond_prior:
                continue
            probed = self.trial.under((*self.fixes, *probe))
            run = None if probed is None else self.trial.fused(probed, self._alone(sensor))
            if run is not None and not run.lost:
                yield from of_probe(robot, sensor, run, drive.truth is not None)

    @cached_property
    def _mounts_found(self) -> list[Finding]:
        """Mounts that are states already, where the run of their sensor alone finds them elsewhere."""
        return [
            finding
            for e in self.compared.estimates
            if len(e.sensors) == 1 and not e.smoothed and not e.lost
            for finding in of_mount(self.loaded.robot, e.sensors[0], e, self.loaded.drive.truth is not None)
        ]

    @cached_property
    def _beyond_prior(self) -> set[str]:
        """Sensors whose mount is a state already that the drive finds further off than its prior allows."""
        if self.loaded.drive.truth is not None:
            return set()  # the truth judges what the state says
        alone = (e for e in self.compared.estimates if len(e.sensors) == 1 and not e.smoothed and not e.lost)
        return {e.sensors[0] for e in alone if beyond_prior(self.loaded.robot, e.sensors[0], e)}

    def _scaled(self) -> Iterator[Finding]:
        """Yield the laser's range scale by the size of its own run, once no clock or mount is wrong."""
        for e in self.compared.estimates:
            if e.sensors == (LASER,) and not e.smoothed and not e.lost and self._complained(LASER):
                yield from of_scale(self.loaded.robot, e, self.loaded.drive)

    def offsets(self) -> list[Candidate]:
        """Return constant errors: offsets that were estimated or are configured wrongly, a mirrored camera."""
        found = [
            self._candidate(f, (f.fixes,), True)
            for e in self.compared.estimates
            if e.name == self._all() and not e.smoothed and self.loaded.drive.truth is not None
            for f in of_offsets(self.loaded.robot, e)
        ]
        found += [
            replace(self._candidate(Finding(s, "biased", v.words), (_set(v.cures),), True), measured=True)
            for s, v in self._biases_again.items()
        ]
        for sensor, verdict in self.consistency.items():
            options = _constant(verdict)
            if sensor == "camera" and verdict.verdict in {"biased", "outliers", "contradicts", "understated"}:
                options.append(
                    (f"camera.clockwise={str(not self.loaded.robot.settings('camera').clockwise).lower()}",)
                )
            if options:
                finding = Finding(sensor, verdict.verdict, verdict.words)
                found.append(self._candidate(finding, tuple(options)))
        return found

    def _constant_of(self, sensor: str) -> Candidate:
        """Return the constant error of a sensor whose clock is guessed at: tried beside it, the better is kept.

        On a drive of left turns both look alike.
        """
        verdict = self.consistency[sensor]
        return self._candidate(Finding(sensor, verdict.verdict, verdict.words), tuple(_constant(verdict)), True)

    @cached_property
    def _biases_again(self) -> dict[str, NoiseVerdict]:
        """Offsets that were fixed before something else was: measured again, since that had moved them."""
        keys = [fix.partition("=")[0] for fix in self.fixes]
        fixed = [
            s for s in self.consistency if (b := REGISTRY[s].bias) is not None and f"{s}.{b.key}" in keys[:-1]
        ]
        if not fixed:
            return {}
        said = Said(self.compared.runs, self.loaded.robot, overconfident(self.honesty))
        found = {s: said.bias(s) for s in fixed if self._verdict(s) != "biased"}
        return {s: verdict for s, verdict in found.items() if verdict is not None}

    def noise(self) -> list[Candidate]:
        """Return noise that does not fit, sensor by sensor, and that of the wheels."""
        found = []
        for sensor, verdict in self.consistency.items():
            seen, more = [*_noise_options(verdict), *_above(verdict)], self._by_anees(sensor)
            by_ranges, words = self._as_ranges_scatter(sensor, verdict), verdict.words
            if by_ranges:
                seen.append(by_ranges)
                words += f" by its lines, {by_ranges[0].partition('=')[2]} m by its ranges"
            if self._ranges_show_more(sensor, verdict) or self._too_sure(sensor, verdict):
                seen = []
            words = words if seen else self._errors_in_sigmas(sensor)
            if verdict.verdict == "overstated" and seen and more:
                # a sigma above the configured one is no fix of one that is too high: it has words of its own
                found.append(self._candidate(Finding(sensor, verdict.verdict, words), tuple(seen)))
                seen, words = [], self._errors_in_sigmas(sensor)
            if seen or more:
                finding = Finding(sensor, verdict.verdict if seen else self._by_truth(sensor), words)
                options = tuple(dict.fromkeys((*seen, *more)))
                found.append(self._candidate(finding, options, not seen))
        if self.loaded.drive.truth is not None and self._doubtful(self._best(self.trial.configurations)):
            found.append(self._wheel_noise())
        return found

    def slips(self) -> list[Candidate]:
        """Return the wheels' noise where their turning shows it: every sensor's run is as sure as it says."""
        return [self._wheel_noise()] if self._slips_unusually else []

    @cached_property
    def _ranges_sigma(self) -> float | None:
        """The noise of a range as the laser's raw ranges show it [m]; None where they show none."""
        if LASER not in self.loaded.drive.measurements:
            return None
        return ranges_sigma(self.loaded.stream(LASER), self.loaded.robot.settings(LASER))

    @property
    def _ranges_scatter(self) -> bool:
        """Whether the laser's raw ranges scatter by more than configured."""
        return scatter_more(self._ranges_sigma, self.loaded.robot.settings(LASER).sigma_range)

    def _as_ranges_scatter(self, sensor: str, verdict: Consistency) -> Fixes:
        """Return the laser's noise as its raw ranges show it, where its lines show it too, if not as exactly.

        A sigma that is far too high also joins walls that are two, and these lines fit worse than others.
        """
        cure, shown = _smaller_range_noise(sensor, verdict), self._ranges_sigma
        if cure is None or shown is None or not cure / MAX_SIGMA_FACTOR <= shown < cure:
            return ()
        settings = self.loaded.robot.settings(LASER)
        share = shown / settings.sigma_range
        return tuple(f"{LASER}.{k}={getattr(settings, k) * share:.2g}" for k in REGISTRY[LASER].noise_keys)

    def _ranges_show_more(self, sensor: str, verdict: Consistency) -> bool:
        """Whether the laser's raw ranges scatter by more than a smaller sigma would say: then it is none.

        The lines' residuals show the noise of ranges and angles together; the ranges show their own.
        """
        cure = _smaller_range_noise(sensor, verdict)
        return cure is not None and scatter_more(self._ranges_sigma, cure)

    @cached_property
    def _slip(self) -> Slip | None:
        return slip(self.loaded.drive)

    @property
    def _slips_unusually(self) -> bool:
        """Whether the wheels slip more than configured, or clearly less.

        Less is only believed where truth judges it or several sensors agree: wheels that hardly slip in most turns
        may slip far in a few, and a laser's own turning is no evidence beside a run that goes by the same scans.
        """
        found, truth = self._slip, self.loaded.drive.truth
        return found is not None and found.unusual and (found.factor > 1.0 or truth is not None or found.agreed)

    def _too_sure(self, sensor: str, verdict: Consistency) -> bool:
        """Whether truth shows that a filter which is to trust a sensor more trusts it too much already."""
        honest = self.honesty.get(self._alone(sensor))
        return verdict.verdict == "overstated" and honest is not None and honest.overconfident

    @property
    def _noise_factors(self) -> tuple[float, ...]:
        """Factors on the wheels' noise, to be tried where truth judges: less is no fix of a filter too sure."""
        honest = self.honesty.get(self._best(self.trial.configurations))
        if honest is None:
            return ()
        return tuple(factor for factor in WHEEL_NOISE_FACTORS if (factor > 1.0) == (honest.anees > 1.0))

    def _by_anees(self, sensor: str) -> list[Fixes]:
        """Return the sensor's noise scaled by what truth says of the run that uses it alone.

        Not against what its residuals show: only a map that is built from the readings takes their errors along.
        """
        if sensor != LASER and self._verdict(sensor) == "consistent":
            return []
        honest = self.honesty.get(self._alone(sensor))
        if honest is None or honest.consistent or honest.anees <= 0.0:
            return []
        settings, keys = self.loaded.robot.settings(sensor), REGISTRY[sensor].noise_keys
        if any(self._was_set(sensor, key) for key in keys):
            return []  # once: what is still wrong then is something else
        factor = honest.anees**0.5
        if not 1.0 / MAX_NOISE_FACTOR <= factor <= MAX_NOISE_FACTOR:
            return []  # that is no noise
        return [tuple(f"{sensor}.{k}={getattr(settings, k) * factor:.2g}" for k in keys)]

    def _by_truth(self, sensor: str) -> str:
        """Return what truth says of the covariance of the run that uses a sensor alone."""
        honest = self.honesty.get(self._alone(sensor))
        return "understated" if honest is None or honest.anees > 1.0 else "overstated"

    def unexplained(self) -> list[Candidate]:
        """Return what is unusual in a sensor's residuals where no setting is known that explains it."""
        return [
            self._candidate(Finding(sensor, verdict.verdict, verdict.words), ())
            for sensor, verdict in self.consistency.items()
            if verdict.verdict not in FINE and not verdict.cures
        ]

    def _errors_in_sigmas(self, sensor: str) -> str:
        """Return how much larger or smaller the errors of the sensor's own run are than it claims."""
        honest = self.honesty.get(self._alone(sensor))
        times = 1.0 if honest is None else honest.anees**0.5
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
        judges = tuple(n for n in found.judges if n not in found.minor and n != ODOMETRY)
        # wheels that hardly slipped where this could be seen may slip far elsewhere: less has to gain something
        more = any(factor > 1.0 for factor in factors)
        return replace(found, judges=judges, measured=measured and (more or self.loaded.drive.truth is not None))

    # ---- configurations that judge ----

    def _complained(self, sensor: str) -> bool:
        """Return whether a sensor's own run is inconsistent, or its residuals are unusual."""
        return self._complained_itself(sensor) or self._doubtful(self._alone(sensor))

    def _complained_itself(self, sensor: str) -> bool:
        """Return whether a sensor's own residuals are unusual, whatever truth says of its run."""
        return self._verdict(sensor) not in FINE

    def _verdict(self, sensor: str) -> str:
        """Return the verdict on a sensor's residuals; that on what has none is "unclear"."""
        verdict = self.consistency.get(sensor)
        return "unclear" if verdict is None else verdict.verdict

    def _doubtful(self, name: str) -> bool:
        """Return whether a configuration is inconsistent by truth; without truth any may be, once one looks so."""
        honest = self.honesty.get(name)
        lost = any(e.lost for e in self.compared.estimates if e.name == name)
        return honest is None or lost or not honest.consistent

    def _candidate(self, finding: Finding, alternatives: tuple[Fixes, ...], offer: bool = False) -> Candidate:
        judges = self.judges(finding.role)
        kept = self.kept(finding.role)
        minor = tuple(n for n in judges if n not in kept)
        others = tuple(n for n in minor if n != ODOMETRY) if finding.role in REFERENCE else ()
        return Candidate(finding, alternatives, judges, minor, others, offer)

    def kept(self, role: str) -> set[str]:
        """Return the configurations that somebody would keep who uses a role."""
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
            others = (n for n in known if n not in kept and n != ODOMETRY)  # first: what settles one is right
            # one random walk: without truth it predicts places by chance
            walk = (ODOMETRY,) if self.loaded.drive.truth is not None or len(known) == 1 else ()
            return tuple(n for n in dict.fromkeys((*others, *kept, *walk)) if n != ODOMETRY or walk)
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


def _ways(finding: Finding) -> tuple[Fixes, ...]:
    """Return the ways to fix what measuring shows; a wrong radius alone turns the robot wrongly too."""
    if finding.code == WHEEL_SCALE and len(finding.fixes) > 1:
        return finding.fixes, finding.fixes[:1]
    return (finding.fixes,) if finding.fixes else ()


def _smaller_range_noise(sensor: str, verdict: Consistency) -> float | None:
    """Return the smaller noise of a range [m] that the lines of a laser show, None where they show none."""
    return (
        verdict.cures.get(f"{LASER}.sigma_range") if sensor == LASER and verdict.verdict == "overstated" else None
    )


def _constant(verdict: Consistency) -> list[Fixes]:
    """Return the fix of a constant error, nothing where a verdict is about something else."""
    return [_set(verdict.cures)] if verdict.verdict == "biased" and verdict.cures else []


def _noise_options(verdict: Consistency) -> list[Fixes]:
    """Return the alternatives of one noise verdict: all keys of a sigma at once, else one key after the other."""
    if verdict.verdict not in NOISE or not verdict.cures:
        return []
    if verdict.verdict == "correlated":
        return [(f"{key}={value:g}",) for key, value in verdict.cures.items()]
    return [_set(verdict.cures)]


def _above(verdict: Consistency) -> list[Fixes]:
    """Return a sigma above the observed one, where the configured one was too low."""
    if verdict.verdict != "understated" or not verdict.cures:
        return []
    return [_set({key: float(f"{TOO_LOW * value:.2g}") for key, value in verdict.cures.items()})]


def _set(cures: Mapping[str, float]) -> Fixes:
    return tuple(f"{key}={value:g}" for key, value in cures.items())
