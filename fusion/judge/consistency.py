"""Consistency of each sensor's configured noise, without truth: a verdict and the settings that fix it.

A sensor is judged by a consistent run that does not use it, else by its own innovations. If two sensors disagree,
the one that also disagrees with other sensors is flagged. A run with a sensor whose noise is understated judges no
other sensor. If the truth has headings, biased sensors are found by the truth first, since it is more exact than
any run.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any, Literal, NamedTuple

import msgspec
import numpy as np
from msgspec.structs import asdict, replace

from locfuse.fusion.data import Drive, Estimates
from locfuse.fusion.robot import Robot
from locfuse.fusion.se2 import wrap
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.streams import gap_limit
from locfuse.fusion.truth import body_poses

from .innovations import ComparedReadings, OwnInnovations, compare_readings, own, usual_period

Verdict = Literal[
    "consistent", "understated", "overstated", "biased", "contradicts", "correlated", "outliers", "unclear"
]
MAX_DRAWN_RATIO = 2.0  # sigma of a mean / its sigma by the readings' noise; above it, the reference adds errors
MAX_SIGMA_FACTOR, MIN_SIGMA_FACTOR = 1.5, 1.0 / 1.5  # a factor on sigma between both limits is consistent
MIN_SIGMAS = 3.0  # least significant difference, in standard errors
LEAST_CLAIM = 0.01  # m or degrees: a smaller claimed sigma counts as 0
MIN_BIAS_SIGMAS = 0.5  # least reported bias, in sigmas of the noise
MIN_SLOW_VARIANCE_RATIO = 3.0  # slow errors with this multiple of the reference's variance are the sensor's
MIN_MEAN_VARIANCE_RATIO = 4.0  # largest consistent variance of a mean / claimed variance
MAX_REFERENCE_VARIANCE_RATIO = 4.0  # largest variance of a usable reference / variance of the sensor
MIN_NOISE_SHARE = 0.1  # least share of R in the innovations' variance S; with less, S does not show R
MIN_WHITE_SHARE = 0.3  # least white share of the innovations' variance; with less, it is not white noise
MIN_REPEAT_CORRELATION = 0.5  # least autocorrelation of innovations if the state follows the sensor's slow errors
MIN_WANDER_CORRELATION = 0.25  # least autocorrelation of innovations that count as correlated
MAX_REFUSED_SHARE, MAX_REFUSED_LINE_SHARE = 0.05, 0.25  # of readings; of the lines of scans
MAX_REFERENCE_NIS_RATIO = MAX_SIGMA_FACTOR**2  # a reference run needs smaller factors on R than this
MIN_READINGS = 20  # least number of compared readings
MAX_START_M, MAX_START_RAD = 0.5, math.radians(20.0)  # with a larger distance of both starts, the frames differ


class Consistency(msgspec.Struct, frozen=True):
    """Verdict on a sensor's noise by all runs, the settings that fix it, and innovation figures of one run."""

    verdict: Verdict
    words: str
    scale: float | None = None  # factor by which the sensor's sigma should be multiplied
    fix_values: Mapping[str, float] = {}  # robot.toml key -> value
    nis_bounds: tuple[float, float] | None = None  # 95 % bounds of the mean NIS per degree of freedom
    bias_sigma: tuple[float, ...] = ()  # mean innovation in predicted standard deviations
    whiteness: tuple[float, ...] = ()  # autocorrelation of the innovations at lags 1, 2, ...
    refused: float | None = None  # rejected share of the compared measurements


def disagrees(h: ComparedReadings) -> bool:
    """Return whether a sensor's mean innovation, in a run without this sensor, is significant and notable."""
    return h.bias is not None and abs(h.bias) > MIN_SIGMAS * h.standard_error and notable(h)


def notable(h: ComparedReadings) -> bool:
    """Return whether a sensor's mean innovation exceeds half of its noise."""
    return h.bias is not None and abs(h.bias) > MIN_BIAS_SIGMAS * math.sqrt(h.white)


def by_reference_run(sensor: str, settings: Any, h: ComparedReadings) -> Consistency | None:
    """Return the verdict on a sensor by a run that does not use it; None if this run is too uncertain."""
    noise = min(h.white, max(h.spread - h.reference, 0.5 * h.white))
    is_slow = h.slow > max(MIN_SLOW_VARIANCE_RATIO * h.reference, 0.1 * h.white)
    if is_slow and not _drifts(sensor, settings, h):
        found = by_memory(sensor, settings, h.spread, h.memory, h.period, h.R)
        return (changing(sensor, settings, h) if found.verdict == "correlated" else None) or found
    if h.reference > MAX_REFERENCE_VARIANCE_RATIO * noise:
        return None
    return by_share(sensor, h.outlier_share, by_scale(sensor, settings, math.sqrt(noise / h.R)))


def by_itself(sensor: str, settings: Any, o: OwnInnovations, floor: Sequence[float], period: float) -> Consistency:
    """Return the verdict on a sensor by its innovations in a run that uses the sensor."""
    several = len(o.R) > 1  # whether a reading has several numbers
    if not several and abs(o.middle[0]) > max(MIN_SIGMAS * o.standard_error[0], math.sqrt(o.R[0])):
        return biased(sensor, settings, o.middle[0], o.standard_error[0], math.sqrt(o.R[0] / o.compared))
    if not several and o.white < MIN_WHITE_SHARE and o.whiteness[0] > MIN_REPEAT_CORRELATION:
        repeats = 1.0 + 2.0 * o.whiteness[0] / (1.0 - min(o.whiteness[0], 0.98))  # as for a Markov chain
        # the state followed the slow errors, so the innovations contain only a part of these errors
        return by_memory(sensor, settings, o.R[0] * o.nis, repeats, period, o.R[0] / MIN_MEAN_VARIANCE_RATIO)
    if o.raw > MIN_SIGMA_FACTOR and o.whiteness[0] > MIN_WANDER_CORRELATION:
        scale = "the range scale, " if hasattr(settings, "range_scale") else ""
        words = (
            f"successive residuals are similar ({o.whiteness[0]:.0%}). Usual causes, in this order: wheels.track, "
            f"{sensor}.time_offset, the mount, {scale}wheels.noise"
        )
        return Consistency("correlated", words)
    # the factor on sigma that multiplies R = sigma^2 R_unit + floor by `o.scale`
    parts = [(max(o.scale * r - f, 0.0) / (r - f)) for r, f in zip(o.R, floor, strict=True) if r > 1.1 * f]
    factor = max(math.sqrt(sum(parts) / len(parts)) if parts else math.sqrt(o.scale), 0.1)
    if factor < MIN_SIGMA_FACTOR and o.share < MIN_NOISE_SHARE:
        # R is such a small part of S = H P H' + R that S does not show its size
        return Consistency("unclear", "noise cannot be judged: its residuals show the error of the prediction")
    if factor < MIN_SIGMA_FACTOR < max(o.raw, o.nis):
        # if the median or the mean NIS fits the configured noise, this noise is not too high, even if successive
        # residuals are similar
        factor = MIN_SIGMA_FACTOR
    return by_share(sensor, o.refused, by_scale(sensor, settings, factor))


def _drifts(sensor: str, settings: Any, h: ComparedReadings) -> bool:
    """Return whether the configured drift of a sensor's offset already explains the sensor's slow errors."""
    key = REGISTRY[sensor].drift_key
    if key is None or h.bias is not None:
        return False
    needed, _ = _human(math.sqrt(4.0 * h.spread / h.memory / h.period), sensor)
    return float(getattr(settings, key)) > 0.5 * needed


def by_memory(sensor: str, settings: Any, variance: float, repeats: float, period: float, R: float) -> Consistency:
    """Return the verdict on slow errors: "correlated" if their variance is large relative to R, else `by_scale`.

    The mean of n readings has the variance `variance` * `repeats` / n.
    """
    if variance * repeats > MIN_MEAN_VARIANCE_RATIO * R:
        return correlated(sensor, settings, math.sqrt(variance), repeats, period)
    return by_scale(sensor, settings, min(1.0, math.sqrt(variance * repeats / R)))


def by_scale(sensor: str, settings: Any, factor: float) -> Consistency:
    """Return "consistent", or the verdict that sigma is too small or too large by `factor`."""
    if MIN_SIGMA_FACTOR <= factor <= MAX_SIGMA_FACTOR:
        return Consistency("consistent", f"{sensor} noise matches the configured noise", factor)
    keys = REGISTRY[sensor].noise_keys
    fix_values = {f"{sensor}.{k}": rounded(getattr(settings, k) * factor) for k in keys}
    verdict: Verdict = "understated" if factor > 1.0 else "overstated"
    first = keys[0]
    unit = _sign(sensor)
    words = (
        f"noise is set too {'low' if factor > 1.0 else 'high'}: {getattr(settings, first):g}{unit} configured, "
        f"{fix_values[f'{sensor}.{first}']:g}{unit} observed"
    )
    return Consistency(verdict, words, factor, fix_values)


def of_messages(found: Consistency, sensor: str, claimed: Mapping[str, float]) -> Consistency:
    """Return the verdict for a sensor whose messages contain covariances, with `claimed` sigmas by noise key.

    Their sigmas replace the covariances if `covariance` is set to "sigma".
    """
    if found.scale is None or found.verdict not in {"understated", "overstated", "correlated"}:
        return found
    times = f"{rounded(max(found.scale, 1.0 / found.scale)):g} times"
    if found.verdict == "correlated":
        words = "errors last longer than a reading, while its messages claim each to be independent"
    elif found.verdict == "understated":
        words = f"its messages claim errors about {times} smaller than they are"
        if math.isinf(found.scale):
            words = "its messages claim errors that are far smaller than they are"
            if max(claimed.values(), default=0.0) < LEAST_CLAIM:
                words = "its messages claim to have no errors: their covariances are 0"
    else:
        words = f"its messages claim errors about {times} larger than they are"
    if found.verdict == "correlated" or not math.isfinite(found.scale):
        return Consistency(found.verdict, words, found.scale)
    fix_values = {f"{sensor}.{key}": rounded(found.scale * value) for key, value in claimed.items()}
    return Consistency(found.verdict, words, found.scale, fix_values)


def biased_against(sensor: str, settings: Any, h: ComparedReadings) -> Consistency:
    """Return the verdict "biased" by the mean difference from a run that does not use the sensor."""
    return biased(sensor, settings, h.bias or 0.0, h.standard_error, math.sqrt(h.white / h.readings))


def biased(sensor: str, settings: Any, bias: float, standard_error: float, drawn: float) -> Consistency:
    """Return the verdict "biased".

    `bias` is the mean of measured - predicted [rad or m], `standard_error` its sigma, `drawn` its sigma by the
    readings' noise alone. If `standard_error` is clearly larger than `drawn`, the reference has a constant error
    of its own. The fix then also sets the sigma of the offset: with an offset taken as exact, this error would
    pull the estimate with the weight of all readings.
    """
    amount, unit = _human(bias, sensor)
    sigma = rounded(_human(standard_error, sensor)[0])
    words = f"differs from the other sensors by {amount:+.2g} {unit} on average"
    fix = REGISTRY[sensor].bias
    if fix is None:
        return Consistency("biased", words)
    value = (getattr(settings, fix.key) or 0.0) + fix.sign * amount
    value = round((value + 180.0) % 360.0 - 180.0, 2) if unit == "deg" else rounded(value)
    fix_values = {f"{sensor}.{fix.key}": value}
    if fix.sigma is not None and standard_error > MAX_DRAWN_RATIO * drawn and _accepts(settings, fix.sigma, sigma):
        fix_values[f"{sensor}.{fix.sigma}"] = sigma
        words += f" (1 sigma {sigma:g})"
    return Consistency("biased", words, None, fix_values)


def _accepts(settings: Any, key: str, value: float) -> bool:
    """Return whether a setting can have this value together with the other settings of the sensor."""
    try:
        type(settings)(**{**asdict(settings), key: value})
    except ValueError:
        return False
    return True


def correlated(sensor: str, settings: Any, sigma: float, repeats: float, period: float) -> Consistency:
    """Return the verdict "correlated": errors of size `sigma` [rad or m] last for `repeats` readings."""
    memory = repeats * period
    amount, _ = _human(sigma, sensor)
    key = REGISTRY[sensor].noise_keys[0]
    value = rounded(amount * math.sqrt(repeats))
    fix_values = {f"{sensor}.{key}": value, **drift_fix_values(sensor, settings, 2.0 * amount, memory)}
    sign = _sign(sensor)
    words = (
        f"errors of {rounded(amount):g}{sign} last about {rounded(memory):g} s, so {rounded(repeats):g} readings "
        "count as one, but the filter assumes independent readings"
    )
    return Consistency("correlated", words, math.sqrt(repeats), fix_values)


def changing(sensor: str, settings: Any, h: ComparedReadings) -> Consistency | None:
    """Return the verdict on a mean that steps or drifts during the drive; None if it does not.

    The change must exceed half of the noise of a reading.
    """
    least = max(MIN_BIAS_SIGMAS * math.sqrt(h.white), MIN_SIGMAS * h.standard_error)
    if h.change is None or abs(h.change.amount) < least:
        return None
    amount, sign = _human(h.change.amount, sensor)[0], _sign(sensor)
    if h.change.step_s is None:
        words = f"drifts by {amount:+.2g}{sign} in {h.change.span:.0f} s"
    else:
        words = f"steps by {amount:+.2g}{sign} at {h.change.step_s:.1f} s"
    return Consistency("correlated", words, None, drift_fix_values(sensor, settings, abs(amount), h.change.span))


def drift_fix_values(sensor: str, settings: Any, amount: float, span: float) -> dict[str, float]:
    """Return the settings for an offset that drifts by `amount` in `span` [s]; {} if there is no offset."""
    drift, offset = REGISTRY[sensor].drift_key, REGISTRY[sensor].bias
    if drift is None or offset is None:
        return {}
    fix_values = {f"{sensor}.{drift}": rounded(amount / math.sqrt(span))}
    exact = getattr(settings, offset.key) is not None and offset.sigma and not getattr(settings, offset.sigma)
    if exact and _accepts(settings, str(offset.sigma), amount):
        fix_values[f"{sensor}.{offset.sigma}"] = rounded(amount)  # an offset with sigma 0 cannot drift
    return fix_values


def many_refused(sensor: str, share: float) -> bool:
    """Return whether too large a share of readings is rejected; the limit is higher for laser lines."""
    return share > (MAX_REFUSED_LINE_SHARE if _sees_lines(sensor) else MAX_REFUSED_SHARE)


def _sees_lines(sensor: str) -> bool:
    return REGISTRY[sensor].sees == "line"


def by_share(sensor: str, share: float, rest: Consistency) -> Consistency:
    """Return the verdict "outliers" if too many readings are rejected, else the verdict `rest`."""
    if not many_refused(sensor, share) or rest.verdict == "understated":
        return rest
    if _sees_lines(sensor):
        words = (
            f"{share:.0%} of the lines do not fit the map: people, or a wrong time_offset, mount or range scale"
        )
    else:
        words = f"{share:.0%} of the readings are rejected as outliers; the others match the configured noise"
    return Consistency("outliers", words)


def _sign(sensor: str) -> str:
    """Return the unit of a sensor's first component as a suffix for a number: "°" or " m"."""
    sign = REGISTRY[sensor].components[0].sign
    return sign if sign.startswith("°") else f" {sign}"


def _human(value: float, sensor: str) -> tuple[float, str]:
    """Return a value [rad or m] of a sensor's first component in the unit for display, and this unit."""
    first = REGISTRY[sensor].components[0]
    return value * first.scale, first.unit


def rounded(value: float) -> float:
    """Return a number rounded to two significant digits."""
    return float(f"{value:.2g}")


class RunInnovations(NamedTuple):
    """Estimates of one configuration on its drive, with innovation figures of each sensor."""

    drive: Drive
    estimates: Estimates  # without audits
    own: Mapping[str, OwnInnovations | None]

    @classmethod
    def of(cls, drive: Drive, estimates: Estimates) -> RunInnovations:
        """Compute the innovation figures of each sensor of a run; the audits are not kept."""
        found = {s: own(estimates.audits[s], drive.measurements[s]) for s in estimates.sensors}
        return cls(drive, replace(estimates, audits={}), found)


def judge(
    runs: Sequence[RunInnovations], robot: Robot, overconfident: Collection[str] = ()
) -> dict[str, dict[str, Consistency]]:
    """Return configuration -> sensor -> consistency of the sensor's noise.

    `overconfident` are configurations that truth shows to be overconfident: their covariance is not used.
    """
    evidence = NoiseEvidence([r for r in runs if not r.estimates.smoothed], robot, overconfident)
    findings = {s: evidence.finding(s) for s in evidence.sensors}
    return {r.estimates.name: {s: _of_run(o, findings[s]) for s, o in r.own.items()} for r in evidence.runs}


def _of_run(o: OwnInnovations | None, found: Consistency) -> Consistency:
    """Return the verdict on a sensor by all runs, together with the innovation figures `o` of one run."""
    if o is None:
        return found
    return replace(found, nis_bounds=o.bounds, bias_sigma=o.bias, whiteness=o.whiteness, refused=o.refused)


class NoiseEvidence:
    """Evidence on the noise of all sensors: their innovations in all runs."""

    def __init__(self, runs: Sequence[RunInnovations], robot: Robot, overconfident: Collection[str] = ()) -> None:
        self.robot, self.runs, self.overconfident = robot, runs, overconfident
        self.sensors = sorted({s for r in runs for s in r.estimates.sensors})
        self._compared: dict[tuple[str, str], ComparedReadings | None] = {}
        self._truth = as_run(runs[0].drive, runs[0].estimates) if runs else None
        self.flagged: dict[str, ComparedReadings] = {}
        self.contradict: set[str] = set()
        self._flag()

    def finding(self, sensor: str) -> Consistency:
        """Return the verdict on a sensor."""
        found = self._finding(sensor)
        m = next(r.drive.measurements[sensor] for r in self.runs if sensor in r.estimates.sensors)
        if not REGISTRY[sensor].brings_covariance(m):
            return found
        return of_messages(found, sensor, REGISTRY[sensor].claimed(m))

    def _finding(self, sensor: str) -> Consistency:
        settings = self.robot.settings(sensor)
        if sensor in self.flagged:
            flagged = self.flagged[sensor]
            return changing(sensor, settings, flagged) or biased_against(sensor, settings, flagged)
        if sensor in self.contradict:
            others = " and ".join(sorted(self.contradict - {sensor}))
            words = f"{sensor} and {others} contradict each other; no other sensor can tell which is wrong"
            return Consistency("contradicts", words)
        references = self.reference_runs(sensor)[:1]
        for _, evidence in references:
            found = by_reference_run(sensor, settings, evidence)
            if found is not None:
                return found
        run = self._purest(sensor)
        mine = None if run is None else run.own[sensor]
        if run is not None and mine is not None and mine.compared >= MIN_READINGS:
            m = run.drive.measurements[sensor]
            if (period := usual_period(m.t)) is not None:
                found = by_itself(sensor, settings, mine, np.diagonal(m.floor).tolist(), period)
                if found.verdict == "overstated" and references and len(mine.R) == 1:
                    # its innovations hide slow errors, which the state follows, and the reference is too uncertain
                    words = "noise cannot be judged: the runs without it are too uncertain to show slow errors"
                    return Consistency("unclear", words)
                return found
        own = [(s, o) for r in self.runs for s, o in r.own.items() if s != sensor]
        loud = sorted({s for s, o in own if o and o.scale > MAX_REFERENCE_NIS_RATIO})
        why = f"the noise of {' and '.join(loud)} must be set first" if loud else "too few measurements"
        return Consistency("unclear", f"noise cannot be judged: {why}")

    def reference_runs(self, sensor: str) -> list[tuple[RunInnovations, ComparedReadings]]:
        """Return consistent runs that use neither `sensor` nor a flagged sensor, smallest variance first."""
        found = []
        for run in self.runs:
            used = set(run.estimates.sensors)
            if not used or used & {sensor, *self.flagged} or run.estimates.name in self.overconfident:
                continue
            if self._healthy(run):
                evidence = self._compare(run, sensor)
                if evidence is not None and evidence.readings >= MIN_READINGS:
                    found.append((run, evidence))
        return sorted(found, key=lambda w: w[1].reference)

    def bias(self, sensor: str) -> Consistency | None:
        """Return the verdict "biased" if the mean innovation is notable, even if uncertain; else None."""
        found = self._compare_with_truth(sensor) or next((h for _, h in self.reference_runs(sensor)), None)
        if found is None or not notable(found):
            return None
        return biased_against(sensor, self.robot.settings(sensor), found)

    def _compare_with_truth(self, sensor: str) -> ComparedReadings | None:
        found = None if self._truth is None else self._compare(self._truth, sensor)
        return found if found is not None and found.readings >= MIN_READINGS else None

    def _compare(self, run: RunInnovations, sensor: str) -> ComparedReadings | None:
        key = run.estimates.name, sensor
        if key not in self._compared:
            self._compared[key] = compare_readings(run.drive, self.robot, run.estimates, sensor)
        return self._compared[key]

    def _healthy(self, run: RunInnovations, but: str = "") -> bool:
        """Return whether every sensor of a run, except `but`, has plausible noise and few rejections."""
        found = [run.own[s] for s in run.estimates.sensors if s != but]
        nis, share = MAX_REFERENCE_NIS_RATIO, MAX_REFUSED_LINE_SHARE
        return all(o is not None and o.scale < nis and o.refused < share for o in found)

    def _purest(self, sensor: str) -> RunInnovations | None:
        """Return the run with `sensor` and the smallest number of other sensors; None if there is none.

        The other sensors must be healthy, or have noise that is less understated than that of `sensor`.
        """

        def worst(run: RunInnovations) -> str | None:  # sensor whose R is understated most
            scales = {s: o.scale for s in run.estimates.sensors if (o := run.own[s])}
            return max(scales, key=lambda s: scales[s]) if scales else None

        using = [r for r in self.runs if sensor in r.estimates.sensors]
        pure = [r for r in using if self._healthy(r, sensor) or worst(r) == sensor]
        return min(pure, key=lambda r: len(r.estimates.sensors)) if pure else None

    def _flag(self) -> None:
        """Set `flagged` (sensors with a biased mean) and `contradict` (sensors that contradict each other)."""
        by_truth = {s: h for s in self.sensors if (h := self._compare_with_truth(s)) is not None}
        self.flagged |= {s: h for s, h in by_truth.items() if disagrees(h)}
        left = [s for s in self.sensors if s not in by_truth]
        compared = {s: found[0][1] for s in left if (found := self.reference_runs(s))}
        for s in sorted(compared, key=lambda s: compared[s].reference):
            found = self.reference_runs(s)
            if not found or not disagrees(found[0][1]):
                continue
            run, evidence = found[0]
            rivals = [x for x in run.estimates.sensors if x in compared]
            others = {x: [w for r, w in self.reference_runs(x) if s not in r.estimates.sensors] for x in rivals}
            if any(disagrees(w) for found_x in others.values() for w in found_x[:1]):
                continue  # others contradict a sensor of this reference, which is flagged later
            if rivals and not any(others.values()):
                self.contradict |= {s, *rivals}
            else:
                self.flagged[s] = evidence
        self.contradict -= self.flagged.keys()


def as_run(drive: Drive, estimates: Estimates) -> RunInnovations | None:
    """Return the truth as a run without sensors; None if it has no headings or is in another frame.

    Its poses are NaN in gaps of the truth.
    """
    truth = drive.truth
    if truth is None or truth.theta is None or len(truth.t) < MIN_READINGS:
        return None
    pose = body_poses(truth, drive.t)
    after = np.clip(np.searchsorted(truth.t, drive.t), 1, len(truth.t) - 1)
    known = truth.spans(drive.t)
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
    return RunInnovations(drive, Estimates("truth", (), drive.t, pose, triangles, {}), {})
