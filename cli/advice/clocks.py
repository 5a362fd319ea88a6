"""Clocks that look late: by the truth, by another sensor's run, by the wheels; and the offsets to be tried."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from functools import cached_property

import numpy as np

from locfuse.fusion.checks.clocks import clock_lags, lag_of_run, lags_by_truth
from locfuse.fusion.checks.finding import Finding
from locfuse.fusion.checks.lag import SAID_SIGMAS, Lag, worth_saying
from locfuse.fusion.checks.search import Fixes
from locfuse.fusion.data import Truth

from .judged import FINE, LASER, Judged, Offer

MIN_LAG_S, MIN_LAG_SIGMAS = 0.005, 2.0  # s, standard deviations: a smaller lag against the truth is not tried
MIN_SURE_LAG_SIGMAS = 3.0  # standard deviations, of a sensor that looks right otherwise
MIN_SUSPICIOUS_LAG_S, MIN_SUSPICIOUS_SIGMAS = 0.01, 2.5  # s, standard deviations: reason enough to fuse again
AS_SURE = 1.5  # times a lag's sigma: another sensor's that is known no worse says what slips do to both
CAMERA_LAGS_S = (-0.2, -0.1, 0.1, 0.2)  # s
CLOCK = "lag"  # what clocks' findings are called


class Clocks(Judged):
    """What a compared log says of clocks."""

    def _lags(self) -> bool:
        return bool(self._late) or any(worth_saying(lag) for lag in self._by_wheels.values())

    @cached_property
    def _by_wheels(self) -> dict[str, Lag]:
        drive = self.loaded.drive
        return clock_lags(drive.measurements, drive.wheels)

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

    def _late_by_wheels(self) -> Iterator[Offer]:
        """Yield lags against the wheels that are too small to be said untried.

        From four sigma on where a sensor that knows its lag as well has the same, since slips pull all alike.
        """
        for sensor, lag in self._by_wheels.items():
            sigmas = SAID_SIGMAS if self._late_like_others(sensor) else MIN_SUSPICIOUS_SIGMAS
            if abs(lag.offset) >= max(MIN_SUSPICIOUS_LAG_S, sigmas * lag.sigma):
                by_scans = self.loaded.drive.wheels.matched is not None
                yield from self._shifted(sensor, lag, "the motion by the scans" if by_scans else "the wheels")

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

    def _shifted(self, sensor: str, lag: Lag, against: str) -> Iterator[Offer]:
        """Yield a lag with the offsets to be tried: the lag itself, and one standard deviation to either side."""
        if not math.isfinite(lag.sigma) or not self._using(sensor):
            return
        late = "late" if lag.offset < 0.0 else "early"
        message = f"stamps look {abs(lag.offset):.3f} s {late} against {against} (1 sigma {lag.sigma:.3f} s)"
        near = (lag.offset + step * lag.sigma for step in (0.0, -1.0, 1.0))
        yield Finding(sensor, CLOCK, message), self._offsets_in_time(sensor, near)

    def _offsets_in_time(self, sensor: str, steps: Iterable[float]) -> tuple[Fixes, ...]:
        now = float(self.loaded.robot.settings(sensor).time_offset)
        return tuple((f"{sensor}.time_offset={now + step:z.3f}",) for step in steps)
