"""Verdicts on one sensor's noise, with the fix: the key of robot.toml and its value."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import msgspec
from msgspec import field
from msgspec.structs import asdict

from locfuse.fusion.sensors.registry import REGISTRY

from .innovations import Heard, Own

Verdict = Literal[
    "consistent", "understated", "overstated", "biased", "contradicts", "correlated", "outliers", "unclear"
]
MAX_DRAWN_RATIO = (
    2.0  # of a mean's sigma, beside what its readings' own noise leaves: more is somebody else's error
)
MAX_SIGMA_FACTOR, MIN_SIGMA_FACTOR = 1.5, 1.0 / 1.5  # a factor on sigma between these is no complaint
MIN_SIGMAS = 3.0  # standard errors
MIN_BIAS_SIGMAS = 0.5  # of its noise: a smaller bias is no complaint
MIN_SLOW_VARIANCE_RATIO = 3.0  # times the reference's own variance: slower errors must be the sensor's
MIN_MEAN_VARIANCE_RATIO = 4.0  # times the told variance: what a mean of many readings may be off
MAX_REFERENCE_VARIANCE_RATIO = 4.0  # times the sensor's variance: a reference with more is no judge
MIN_NOISE_SHARE = 0.1  # of R in the innovations' variance S: with less, a small S is no sign of a small R
MIN_WHITE_SHARE = 0.3  # share of the innovations' variance: less is not white noise
MIN_REPEAT_CORRELATION = 0.5  # autocorrelation of innovations that follow their sensor's own slow errors
MIN_WANDER_CORRELATION = 0.25  # autocorrelation of innovations from which the prediction is said to wander
MAX_REFUSED_SHARE, MAX_REFUSED_LINE_SHARE = 0.05, 0.25  # share of readings; of the lines of scans


class NoiseVerdict(msgspec.Struct, frozen=True):
    """A verdict, its words, and the settings that fix it."""

    verdict: Verdict
    words: str
    scale: float | None = None  # by which the sensor's sigma should be multiplied
    cures: Mapping[str, float] = field(default_factory=dict)  # table.key -> value


def disagrees(h: Heard) -> bool:
    """Return whether a sensor's mean differs certainly and notably from a run that does not use it."""
    return h.bias is not None and abs(h.bias) > MIN_SIGMAS * h.sure and notable(h)


def notable(h: Heard) -> bool:
    """Return whether a sensor's mean is off by more than half its noise."""
    return h.bias is not None and abs(h.bias) > MIN_BIAS_SIGMAS * math.sqrt(h.white)


def by_reference_run(sensor: str, settings: Any, h: Heard) -> NoiseVerdict | None:
    """Judge a sensor by a run that does not use it; None where that run is too vague."""
    noise = min(h.white, max(h.spread - h.reference, 0.5 * h.white))
    if (
        h.slow > MIN_SLOW_VARIANCE_RATIO * h.reference
        and h.slow > 0.1 * h.white
        and not _drifts(sensor, settings, h)
    ):
        return by_memory(sensor, settings, h.spread, h.memory, h.period, h.R)
    if h.reference > MAX_REFERENCE_VARIANCE_RATIO * noise:
        return None
    return by_share(sensor, h.wild, by_scale(sensor, settings, math.sqrt(noise / h.R)))


def by_itself(sensor: str, settings: Any, o: Own, floor: Sequence[float], period: float) -> NoiseVerdict:
    """Judge a sensor by the innovations of a run that uses it."""
    several = len(o.R) > 1  # numbers of one reading
    if not several and abs(o.middle[0]) > max(MIN_SIGMAS * o.sure[0], math.sqrt(o.R[0])):
        return biased(sensor, settings, o.middle[0], o.sure[0], math.sqrt(o.R[0] / o.compared))
    if not several and o.white < MIN_WHITE_SHARE and o.whiteness[0] > MIN_REPEAT_CORRELATION:
        repeats = 1.0 + 2.0 * o.whiteness[0] / (1.0 - min(o.whiteness[0], 0.98))  # as of a Markov chain
        # the state has followed the slow errors, so that the innovations show a part of them
        return by_memory(sensor, settings, o.R[0] * o.nis, repeats, period, o.R[0] / MIN_MEAN_VARIANCE_RATIO)
    if o.raw > MIN_SIGMA_FACTOR and o.whiteness[0] > MIN_WANDER_CORRELATION:
        return wanders(sensor, o)
    factor = _on_sigma(o, floor)
    if factor < MIN_SIGMA_FACTOR and o.share < MIN_NOISE_SHARE:
        # S = H P H' + R: that all of it is too large says nothing of so small a part
        return NoiseVerdict("unclear", "noise cannot be judged: its residuals show the error of the prediction")
    if factor < MIN_SIGMA_FACTOR < max(o.raw, o.nis):
        # residuals as large as configured, in the middle or on average (a few large ones make that: people, walls
        # that are not flat), do not show that the noise is set too high, however similar neighbouring ones are
        factor = MIN_SIGMA_FACTOR
    return by_share(sensor, o.refused, by_scale(sensor, settings, factor))


def _drifts(sensor: str, settings: Any, h: Heard) -> bool:
    """Whether the drift of an estimated offset already covers the slow errors."""
    key = REGISTRY[sensor].drift_key
    if key is None or h.bias is not None:
        return False
    needed, _ = _human(math.sqrt(4.0 * h.spread / h.memory / h.period), sensor)
    return float(getattr(settings, key)) > 0.5 * needed


def by_memory(
    sensor: str, settings: Any, variance: float, repeats: float, period: float, R: float
) -> NoiseVerdict:
    """Judge slow errors: the variance of a mean of n readings is variance * repeats / n."""
    if variance * repeats > MIN_MEAN_VARIANCE_RATIO * R:
        return correlated(sensor, settings, math.sqrt(variance), repeats, period)
    return by_scale(sensor, settings, min(1.0, math.sqrt(variance * repeats / R)))


def _on_sigma(o: Own, floor: Sequence[float]) -> float:
    """Turn a factor on R = sigma^2 R_unit + floor into the factor on sigma."""
    parts = [(max(o.scale * r - f, 0.0) / (r - f)) for r, f in zip(o.R, floor, strict=True) if r > 1.1 * f]
    return max(math.sqrt(sum(parts) / len(parts)) if parts else math.sqrt(o.scale), 0.1)


def by_scale(sensor: str, settings: Any, factor: float) -> NoiseVerdict:
    """Report a sigma that is off by more than MAX_SIGMA_FACTOR."""
    if MIN_SIGMA_FACTOR <= factor <= MAX_SIGMA_FACTOR:
        return NoiseVerdict("consistent", f"{sensor} noise matches the configured noise", factor)
    keys = REGISTRY[sensor].noise_keys
    cures = {f"{sensor}.{k}": rounded(getattr(settings, k) * factor) for k in keys}
    verdict: Verdict = "understated" if factor > 1.0 else "overstated"
    first = keys[0]
    unit = _sign(REGISTRY[sensor].components[0].sign)
    words = (
        f"noise is set too {'low' if factor > 1.0 else 'high'}: {getattr(settings, first):g}{unit} configured, "
        f"{cures[f'{sensor}.{first}']:g}{unit} observed"
    )
    return NoiseVerdict(verdict, words, factor, cures)


def of_messages(sensor: str, found: NoiseVerdict) -> NoiseVerdict:
    """Return a verdict on readings that bring their own covariance, which no sigma of robot.toml changes."""
    if found.scale is None or found.verdict not in {"understated", "overstated", "correlated"}:
        return found
    times = f"{rounded(max(found.scale, 1.0 / found.scale)):g} times"
    if found.verdict == "correlated":
        words = f"{sensor} errors last longer than one reading, while its messages claim each to be independent"
    elif found.verdict == "understated":
        words = f"{sensor}: its messages claim errors about {times} smaller than they are"
    else:
        words = f"{sensor}: its messages claim errors about {times} larger than they are"
    return NoiseVerdict(found.verdict, words, found.scale)


def biased_against(sensor: str, settings: Any, h: Heard) -> NoiseVerdict:
    """Report a mean that differs from a run that does not use the sensor."""
    return biased(sensor, settings, h.bias or 0.0, h.sure, math.sqrt(h.white / h.readings))


def biased(sensor: str, settings: Any, bias: float, sure: float, drawn: float) -> NoiseVerdict:
    """Report a mean that is off; `bias` is measured minus predicted [rad or m], `sure` its sigma.

    A mean that is known less exactly than the readings' own noise would allow (`drawn`) has another's error in it,
    which is the same in every reading: set as exact, it would pull the estimate with all their weight. So the fix
    sets how well it is known too.
    """
    amount, unit = _human(bias, sensor)
    sigma = rounded(_human(sure, sensor)[0])
    words = f"differs from the other sensors by {amount:+.2g} {unit} on average"
    fix = REGISTRY[sensor].bias
    if fix is None:
        return NoiseVerdict("biased", words)
    value = (getattr(settings, fix.key) or 0.0) + fix.sign * amount
    cures = {f"{sensor}.{fix.key}": _turned(value) if unit == "deg" else rounded(value)}
    if fix.sigma is not None and sure > MAX_DRAWN_RATIO * drawn and _accepts(settings, fix.sigma, sigma):
        cures[f"{sensor}.{fix.sigma}"] = sigma
        words += f" (1 sigma {sigma:g})"
    return NoiseVerdict("biased", words, None, cures)


def _accepts(settings: Any, key: str, value: float) -> bool:
    """Return whether settings allow a value beside the others; without mount states they have no sigmas."""
    try:
        type(settings)(**{**asdict(settings), key: value})
    except ValueError:
        return False
    return True


def contradicting(sensor: str, others: Sequence[str]) -> NoiseVerdict:
    """Report sensors that contradict each other where the wrong one is unknown."""
    words = f"{sensor} and {' and '.join(others)} contradict each other; no other sensor can tell which is wrong"
    return NoiseVerdict("contradicts", words)


def correlated(sensor: str, settings: Any, sigma: float, repeats: float, period: float) -> NoiseVerdict:
    """Report slow errors: `sigma` [rad or m], correlated over so many readings."""
    memory = repeats * period
    amount, unit = _human(sigma, sensor)
    key = REGISTRY[sensor].noise_keys[0]
    value = rounded(amount * math.sqrt(repeats))
    cures = {f"{sensor}.{key}": value}
    drift, offset = REGISTRY[sensor].drift_key, REGISTRY[sensor].bias
    if drift is not None and offset is not None:
        cures[f"{sensor}.{drift}"] = rounded(amount * math.sqrt(4.0 / memory))
    words = (
        f"errors of {rounded(amount):g}{_sign(unit.replace('deg', '°'))} last about {rounded(memory):g} s, but "
        "the filter assumes independent readings"
    )
    return NoiseVerdict("correlated", words, math.sqrt(repeats), cures)


def wanders(sensor: str, o: Own) -> NoiseVerdict:
    """Return the verdict for correlated innovations of normal size: the prediction drifts."""
    words = (
        f"successive residuals are similar ({o.whiteness[0]:.0%}). Usual causes, in this order: wheels.track, "
        f"{sensor}.time_offset, the mount, the range scale, wheels.noise. Check with: locfuse info LOG --check"
    )
    return NoiseVerdict("correlated", words)


def many_refused(sensor: str, share: float) -> bool:
    """Return whether too large a share of a sensor's readings is rejected; for lines, people cause many."""
    return share > (MAX_REFUSED_LINE_SHARE if _sees_lines(sensor) else MAX_REFUSED_SHARE)


def _sees_lines(sensor: str) -> bool:
    return REGISTRY[sensor].sees == "line"


def by_share(sensor: str, share: float, rest: NoiseVerdict) -> NoiseVerdict:
    """Report that many readings are rejected, unless their noise is understated anyway."""
    if not many_refused(sensor, share) or rest.verdict == "understated":
        return rest
    if _sees_lines(sensor):
        words = (
            f"{share:.0%} of the lines do not fit the map: people, or a wrong time_offset, mount or range scale"
        )
    else:
        words = f"{share:.0%} of the readings are rejected as outliers; the others match the configured noise"
    return NoiseVerdict("outliers", words)


def _sign(unit: str) -> str:
    """Return a unit as it follows a number: "°", " m"."""
    return unit if unit.startswith("°") else f" {unit}"


def _human(value: float, sensor: str) -> tuple[float, str]:
    """Return an amount [rad or m] of the sensor's first component in its unit, which is the sigma's too."""
    first = REGISTRY[sensor].components[0]
    return value * first.scale, first.unit


def rounded(value: float) -> float:
    """Return a number with two significant digits."""
    return float(f"{value:.2g}")


def _turned(degrees: float) -> float:
    return round((degrees + 180.0) % 360.0 - 180.0, 2)
