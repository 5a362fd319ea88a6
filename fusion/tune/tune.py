"""Noise tuning from logs without truth: maximum likelihood of the innovations.

A mean NIS of 1 is not enough: too much noise of one sensor compensates too little noise of another one. The
likelihood of the innovations shows both errors (Schweppe 1965). In each round the filter runs once, which fixes
acceptance and matches; then the logarithms of the noise are searched from several starts (tape). Noise that the
likelihood does not determine is reported as not identifiable, and not changed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import msgspec
import numpy as np
from msgspec.structs import replace

from locfuse.fusion.data import Drive, LocfuseError, Measurements, Motions
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.innovations import OwnInnovations, own
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY

from .tape import DRIFT, MAX_SIGMA_LOG, WHEELS, Figures, Likelihood, at_most, best, drifting, identify, record

MAX_ROUNDS, MIN_LOG_CHANGE = 6, 0.03  # the rounds end if all logarithms change by less
START_LOG_FACTORS = (0.0, math.log(6.0), -math.log(6.0))
PREVIEW_S = 30.0  # s of motion, for the first choice between the starts
MAX_TRIES = 8  # of scaling the noise until measurements are accepted
MAX_REFUSED_SHARE = 0.3
MAX_NIS_RATIO, MIN_NIS_RATIO = 2.25, 0.2  # limits of the NIS ratio that needs no scaling
MIN_OWN_SHARE = 0.3  # least share of R in the innovations' variance, to reduce a sigma
WIDENING_FACTOR = 3.0  # factor on the sigma of a sensor with many rejections
REMEASURE_FACTOR = 1.1  # change of a sigma from which the laser's lines are extracted again
OPTIMAL = {"first-scan": "refine", "consider": "refine"}  # with a frozen map the gain is not optimal

Remeasure = Callable[[int, str, Robot], Measurements]
Progress = Callable[[str], None]


class TuneLog(NamedTuple):
    """One log that the noise is tuned on."""

    name: str
    drive: Drive
    robot: Robot
    until: float = math.inf  # s: later measurements are held out


class NoiseChange(NamedTuple):
    """One noise setting before and after tuning."""

    key: str  # of robot.toml
    before: float
    after: float
    error: float  # standard error of ln(after)
    identifiable: bool


class Tuned(msgspec.Struct, frozen=True):
    """Tuned noise settings, with their likelihoods."""

    rows: Sequence[NoiseChange]
    train: tuple[float, ...] | None  # mean log likelihood per number before and after [nats]
    held_out: tuple[float, ...] | None
    numbers: tuple[int, int]  # in training, and held out
    flags: Sequence[str]  # notes on noise that is not identifiable
    measured_again: Sequence[str]  # sensors
    trials: Sequence[TuneLog]  # with the tuned noise and the other settings as given


def tune(
    trials: Sequence[TuneLog],
    sensors: Sequence[str],
    drift: bool = False,
    remeasure: Remeasure | None = None,
    progress: Progress = lambda what: None,
) -> Tuned:
    """Return the noise settings that maximise the likelihood of the innovations in these logs.

    `remeasure` measures sensors again whose lines depend on a changed sigma. Raises LocfuseError without a sensor
    to tune, or if the logs are configured with different noise.
    """
    bench = Bench(trials, sensors, drift, remeasure)
    bench.bring_near(progress)
    for n in range(MAX_ROUNDS):
        progress(f"round {n + 1}: deciding what is accepted")
        problem = bench.problem()
        progress(f"round {n + 1}: searching the noise")
        first = n == 0
        step = best(problem, START_LOG_FACTORS, bench.preview()) if first else best(problem, START_LOG_FACTORS[:1])
        bench.move(dict(zip(problem.names, step.tolist(), strict=True)))
        if not first and np.abs(step).max() < MIN_LOG_CHANGE:
            break
    progress("judging what was found")
    return bench.result()


class Bench:
    """The logs and the present noise settings during tuning."""

    def __init__(
        self, trials: Sequence[TuneLog], sensors: Sequence[str], drift: bool, remeasure: Remeasure | None
    ) -> None:
        present = {s for t in trials for s in t.drive.measurements}
        used = tuple(s for s in REGISTRY if s in sensors and s in present and not brings_covariance(s, trials))
        if not used:
            raise LocfuseError(f"nothing to tune by: no log has {' or '.join(sensors) or 'a sensor'}", role="tune")
        if trials[0].robot.wheels.noise <= 0.0:
            fix = "wheels.noise=4e-4"
            raise LocfuseError(
                "wheels.noise is 0:", role="tune", fixes=(fix,), hint=f"give a start, such as --set {fix}"
            )
        check_same_noise(trials, used)
        self._given = [t.robot for t in trials]
        self.trials = [t._replace(robot=optimal(t.robot)) for t in trials]
        self.figures = Figures(trials[0].robot, used, drifting(trials[0].robot, used, drift))
        self._remeasure = remeasure
        self._measured_at = dict.fromkeys(used, 0.0)
        self._again: list[str] = []

    def now(self) -> list[TuneLog]:
        """Return copies of the logs whose robot settings, motions and measurements have the present noise."""
        figures, found = self.figures, []
        more = figures.factor(WHEELS)
        factors = {s: math.exp(figures.factors.get(s, 0.0) - self._measured_at[s]) for s in figures.sensors}
        for trial in self.trials:
            d = trial.drive
            scaled = {s: rescaled(m, factors[s]) for s, m in d.measurements.items() if s in factors}
            to_truth = None if d.truth_motions is None else _with_more_noise(d.truth_motions, more)
            motions = _with_more_noise(d.motions, more)
            drive = replace(d, motions=motions, truth_motions=to_truth, measurements=scaled)
            found.append(trial._replace(drive=drive, robot=figures.robot(trial.robot)))
        return found

    def bring_near(self, progress: Progress) -> None:
        """Scale each sigma by the sensor's own innovations until most measurements are accepted."""
        for n in range(MAX_TRIES):
            progress(f"bringing the noise near ({n + 1})")
            found: dict[str, list[float]] = {}
            for t in self.now():
                run = fuse(t.drive, t.robot, list(t.drive.measurements))
                for s, m in t.drive.measurements.items():
                    found.setdefault(s, []).append(_sigma_factor(own(run.audits[s], m)))
            steps = {s: math.log(float(np.median(f))) for s, f in found.items()}
            if not any(steps.values()):
                return
            self.move(steps)

    def preview(self) -> list[float]:
        """Return for each log the time [s] at which the robot has moved for PREVIEW_S; else the log's end."""
        ends = []
        for t in self.trials:
            d = t.drive
            driven = np.cumsum(np.diff(d.t, prepend=d.t[0]) * (np.abs(d.motions.u).max(axis=1) > 0.0))
            ends.append(float(d.t[min(int(np.searchsorted(driven, PREVIEW_S)), len(d.t) - 1)]))
        return ends

    def move(self, steps: dict[str, float]) -> None:
        """Change the noise: `steps` maps the name of each search variable to the change of its ln(noise).

        If a sensor's lines depend on its sigma and sigma has changed much, its measurements are made again.
        """
        for name, step in steps.items():
            self.figures.factors[name] = self.figures.factors.get(name, 0.0) + step
        for s in self.figures.sensors:
            now = self.figures.factors.get(s, 0.0)
            wrong = abs(now - self._measured_at[s]) > math.log(REMEASURE_FACTOR)
            if wrong and self._remeasure is not None and REGISTRY[s].measures_by_sigma:
                for i, trial in enumerate(self.trials):
                    if s in trial.drive.measurements:
                        m = self._remeasure(i, s, self.figures.robot(trial.robot))
                        d = trial.drive
                        instant = {**d.instant, s: np.searchsorted(d.t, m.t)}
                        d = replace(d, measurements={**d.measurements, s: m}, instant=instant)
                        self.trials[i] = trial._replace(drive=d)
                self._measured_at[s] = now
                self._again.append(s)

    def problem(self) -> Likelihood:
        """Run the filter on all logs with the present noise; return the likelihood of these runs to maximise."""
        tapes = [record(t.drive, t.robot, list(t.drive.measurements)) for t in self.now()]
        return Likelihood(tapes, [t.until for t in self.trials], self.figures.names)

    def result(self) -> Tuned:
        """Return the tuned settings, compared with the configured ones on the same measurements."""
        figures, problem = self.figures, self.problem()
        errors, flags = identify(problem)
        configured = -np.array([figures.factors.get(name, 0.0) for name in figures.names])
        for name, error in zip(figures.names, errors.tolist(), strict=True):
            if error > MAX_SIGMA_LOG:
                flags.append(self._reset(problem, name))
        now = configured + np.array([figures.factors.get(name, 0.0) for name in figures.names])
        now[~np.isfinite(now)] = 0.0
        (train, held_out), numbers = problem.means(np.stack((configured, now)))
        before = Figures(figures.configured, figures.sensors, figures.drift)
        error_of = dict(zip(figures.names, errors.tolist(), strict=True))
        rows = [
            NoiseChange(key, before.values()[key], after, error_of[name], error_of[name] <= MAX_SIGMA_LOG)
            for key, after in figures.values().items()
            for name in (figures.name_of(key),)
        ]
        again = list(dict.fromkeys(self._again))
        # with the tuned noise; all other settings as configured, as other commands use them
        given = zip(self.now(), self._given, strict=True)
        as_used = [t._replace(robot=figures.robot(robot)) for t, robot in given]
        return Tuned(rows, train, held_out, numbers, flags, again, as_used)

    def _reset(self, problem: Likelihood, name: str) -> str:
        """Reset a value that the likelihood does not determine; return a note on it."""
        figures = self.figures
        if name.endswith(DRIFT):
            figures.factors[name] = -math.inf
            sensor = name.removesuffix(DRIFT)
            return f"no drift of the {sensor}'s offset is seen: {REGISTRY[sensor].drift_key} is 0"
        key = next(key for key in figures.values() if figures.name_of(key) == name)
        now = figures.factors.get(name, 0.0)
        most = at_most(problem, figures.names.index(name), -now)
        figures.factors[name] = min(0.0, now + most)
        value = figures.values()[key]
        if figures.factors[name] < 0.0:
            return f"{key} is at most {value:.2g}: how much less is not identifiable from these logs"
        return f"{key} is not identifiable from these logs: left as it was"


def brings_covariance(sensor: str, trials: Sequence[TuneLog]) -> bool:
    """Return whether a sensor's readings contain their own covariance, so that its sigma has no effect."""
    found = [t.drive.measurements[sensor] for t in trials if sensor in t.drive.measurements]
    return any(map(REGISTRY[sensor].brings_covariance, found))


def check_same_noise(trials: Sequence[TuneLog], sensors: Sequence[str]) -> None:
    """Raise LocfuseError if two logs are configured with different noise: the search needs one start."""
    first, *others = trials
    configured = Figures(first.robot, tuple(sensors)).values()
    for t in others:
        for key, b in Figures(t.robot, tuple(sensors)).values().items():
            a = configured[key]
            if a != b:
                fix = f"{key}={a:g}"
                raise LocfuseError(
                    f"{key} is {a:g} in {first.name} and {b:g} in {t.name}: is this one robot?",
                    role="tune",
                    fixes=(fix,),
                    hint=f"Start from one value with --set {fix}",
                )


def optimal(robot: Robot) -> Robot:
    """Return the robot, configured as an optimal filter: map lines are states and outliers are rejected."""
    settings = {}
    for s, c in robot.sensors.items():
        mode = getattr(c, "map", "")
        changes = {"outliers": "reject"}
        if isinstance(mode, str) and mode in OPTIMAL:
            changes["map"] = OPTIMAL[mode]
        settings[s] = msgspec.structs.replace(c, **changes)
    return replace(robot, sensors=settings)


def rescaled(m: Measurements, factor: float) -> Measurements:
    """Return measurements with a sigma that is `factor` times as large.

    The noise floor and the variance "rest", which does not depend on sigma, are not changed.
    """
    rest = m.extra.get("rest")
    if rest is None:
        return replace(m, scale=m.scale * factor)
    own = (rest / m.scale**2)[:, None, None] * np.eye(m.z.shape[1])
    return replace(m, scale=m.scale * factor, R_unit=m.R_unit - own + own / factor**2)


def _with_more_noise(motions: Motions, factor: float) -> Motions:
    return Motions(motions.u, factor * motions.Q, motions.J)


def _sigma_factor(o: OwnInnovations | None) -> float:
    """Return the factor on a sensor's sigma that brings its NIS near 1; 1 if it is near already."""
    if o is None or o.refused > MAX_REFUSED_SHARE or math.isinf(o.raw):
        return WIDENING_FACTOR
    if MIN_NIS_RATIO <= o.raw <= MAX_NIS_RATIO or (o.raw < MIN_NIS_RATIO and o.share < MIN_OWN_SHARE):
        return 1.0
    return math.sqrt(min(max(o.raw, 0.04), 9.0))
