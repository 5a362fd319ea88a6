"""Effect of each sensor on the position error: Shapley value, confidence interval, one-word verdict.

The value of a set of sensors is -ln(position RMSE), so effects are factors on the error: +0.69 halves it. A
sensor's credit is its Shapley value (Shapley 1953): its effect averaged over all orders in which the sensors can
be added. Credits sum to the effect of all sensors together. There are two more effects: "alone" (compared with
odometry) and "last" (`all` compared with `all` without the sensor).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations
from typing import Literal, NamedTuple

import msgspec
import numpy as np

from locfuse.fusion.data import Array, Evaluation
from locfuse.fusion.sensors.registry import needed

from .bootstrap import MIN_REPLICATES, Errors, by_chance, student_t

Verdict = Literal["helps", "seems to help", "no effect seen", "seems to hurt", "hurts", "no verdict"]

MIN_EFFECT = 0.02  # an effect below 2 % counts as no effect, even if certain
MIN_EXPECTED_EFFECT = 0.15  # smallest effect (15 %) that counts if its interval includes zero
MAX_UNSURE = math.log(10.0)  # largest bound of an effect's interval on the opposite side of zero
MIN_HARM_LAST = 0.10  # a sensor hurts if `all` is significantly 10 % better without it
# overconfident: ANEES above the first, and above the second times ANEES without the sensor
OVERCONFIDENT_ANEES, MAX_ANEES_RATIO = 10.0, 5.0
MAX_CONSISTENT_ANEES = 3.0  # with a larger ANEES, the covariance of a run is not used as evidence
Subset = frozenset[str]


class Effect(msgspec.Struct, frozen=True):
    """Contrast of ln(position RMSE): a positive value means that the sensor reduces the error.

    Over fewer than MIN_REPLICATES drives the bounds are NaN.
    """

    value: float
    low: float
    high: float
    expected: float | None  # the same contrast of the predicted standard deviations


def verdict(
    shapley: Effect | None, alone: Effect | None, last: Effect | None, anees: tuple[float, float] | None
) -> Verdict:
    """Return the verdict on a sensor's effect; "no verdict" if no effect was computed.

    "helps", "hurts": the interval of the effect excludes zero ("hurts" also if `all` is significantly better
    without the sensor). "seems to help", "seems to hurt": the effect is large, and its interval includes zero, but
    no large opposite effect (`unsure`). "no effect seen": all other cases. Also if the sensor hardly changes the
    covariance of a consistent filter (by ANEES), since the change of the error is then chance. For overconfidence
    see `overconfident`.
    """
    main = shapley or alone or last
    if main is None:
        return "no verdict"
    if _surely(main, -1.0) or (last is not None and last.high < -MIN_HARM_LAST):
        return "hurts"
    if _surely(main, 1.0):
        return "helps"
    if unsure(main):
        return "no effect seen"
    consistent = anees is None or anees[1] <= MAX_CONSISTENT_ANEES
    vetoed = consistent and main.expected is not None and abs(main.expected) < MIN_EXPECTED_EFFECT
    if abs(main.value) <= MIN_EXPECTED_EFFECT or vetoed:
        return "no effect seen"
    return "seems to help" if main.value > 0.0 else "seems to hurt"


def unsure(effect: Effect) -> bool:
    """Return whether the interval includes a tenfold change of the error in the opposite direction."""
    return (-effect.low if effect.value > 0.0 else effect.high) > MAX_UNSURE


def overconfident(anees: tuple[float, float] | None) -> bool:
    """Return whether a sensor makes the filter overconfident. `anees` is the ANEES (without, with) the sensor."""
    return anees is not None and anees[1] > max(OVERCONFIDENT_ANEES, MAX_ANEES_RATIO * anees[0])


def _surely(effect: Effect, sign: float) -> bool:
    """Return whether an effect with the sign `sign` is large enough, and its interval excludes zero.

    If the sensor hardly changes the predicted covariances, the effect is probably chance. The interval is then
    doubled, since one wrong verdict in 20 would be too many.
    """
    bound = effect.low if sign > 0 else effect.high
    if effect.expected is not None and abs(effect.expected) < MIN_EXPECTED_EFFECT:
        bound = 2.0 * bound - effect.value
    return sign * effect.value > MIN_EFFECT and sign * bound > 0.0


class SensorCredit(msgspec.Struct, frozen=True):
    """Verdict and effects of one sensor."""

    verdict: Verdict
    credit: Effect | None  # Shapley value; None unless every subset was run
    alone: Effect | None  # compared with odometry, or `beside`
    last: Effect | None  # leave one out
    share: float | None  # share of the whole improvement
    anees: tuple[float, float] | None  # ANEES without and with the sensor, for the subset in which it grows most
    beside: tuple[str, ...] = ()  # sensors whose map the sensor needs, or that were in every run with it


class Credit(msgspec.Struct, frozen=True):
    """Effects of all sensors, and how their intervals were computed."""

    sensors: Mapping[str, SensorCredit]
    total: float | None  # ln(error with odometry / error with all sensors)
    complete: bool  # every subset was run
    method: str
    effective_samples: float  # number of independent samples of one drive, or of logs
    block_s: float | None
    logs: int = 1


def credit(judged: Mapping[Subset, Evaluation], sensors: Sequence[str]) -> Credit | None:
    """Return the effects of `sensors` on one drive, by evaluations of subsets of sensors; None without truth.

    Shapley values need all 2^n subsets; with fewer, only the effects "alone" and "last" are computed. A sensor
    that is in no subset is left out.
    """
    if not judged or not sensors or any(len(e.t) == 0 for e in judged.values()):
        return None
    errors = Errors.of(np.stack([e.deviation for e in judged.values()]))
    anees = [e.figures.get("anees") for e in judged.values()]
    book = _Book(list(judged), errors, _expected(judged.values()), anees)
    found = {s: book.sensor(s, sensors) for s in sensors if any(s in run for run in judged)}
    t = next(iter(judged.values())).t
    return Credit(
        sensors=found,
        total=book.total(sensors),
        complete=book.complete(sensors),
        method="moving-block bootstrap",
        effective_samples=float(errors.samples.min()),
        block_s=errors.block * float(t[-1] - t[0]) / max(1, len(t) - 1),
    )


def credit_over_logs(drives: Sequence[Credit]) -> Credit:
    """Return the effects averaged over logs; from four logs on with Student's t intervals."""
    names = [s for s in drives[0].sensors if all(s in c.sensors for c in drives)]
    sensors = {s: _over_logs([c.sensors[s] for c in drives]) for s in names}
    totals = [c.total for c in drives if c.total is not None]
    return Credit(
        sensors=sensors,
        total=float(np.mean(totals)) if len(totals) == len(drives) else None,
        complete=all(c.complete for c in drives),
        method="Student's t over logs",
        effective_samples=float(len(drives)),
        block_s=None,
        logs=len(drives),
    )


def subsets(sensors: Sequence[str]) -> list[tuple[str, ...]]:
    """Return all 2^n subsets of sensors, the smallest first, each in the order of `sensors`."""
    return [c for k in range(len(sensors) + 1) for c in combinations(sensors, k)]


class AddedSensor(NamedTuple):
    """Adding one sensor to a subset of sensors: weight of this step, subset before, subset after."""

    weight: float
    before: Subset
    after: Subset


def shapley_steps(sensor: str, sensors: Sequence[str]) -> list[AddedSensor]:
    """Return the 2^(n-1) steps that add a sensor to a subset of the other sensors, with Shapley weights."""
    n = len(sensors)
    sets = subsets([s for s in sensors if s != sensor])
    return [
        AddedSensor(
            math.factorial(len(s)) * math.factorial(n - len(s) - 1) / math.factorial(n),
            frozenset(s),
            frozenset((*s, sensor)),
        )
        for s in sets
    ]


class _Book(msgspec.Struct, frozen=True):
    """Errors and ANEES of every subset of sensors that was run."""

    sets: list[Subset]
    errors: Errors
    expected: Array | None  # (k,) ln of the predicted rms deviation
    anees: list[float | None]

    def complete(self, sensors: Sequence[str]) -> bool:
        return all(frozenset(s) in self.sets for s in subsets(sensors))

    def total(self, sensors: Sequence[str]) -> float | None:
        effect = self.effect([AddedSensor(1.0, frozenset(), frozenset(sensors))])
        return None if effect is None else effect.value

    def effect(self, steps: Sequence[AddedSensor]) -> Effect | None:
        """Return the weighted sum of ln(RMSE before / RMSE after) over steps; None if a subset was not run."""
        if any(s not in self.sets for step in steps for s in (step.before, step.after)):
            return None
        w = np.zeros(len(self.sets))
        least = most = 0.0
        for step in steps:
            i, j = self.sets.index(step.before), self.sets.index(step.after)
            w[i] += step.weight
            w[j] -= step.weight
            if self.expected is None:
                continue
            # A sensor that reduces the predicted variance moves the estimate by about the square root of the
            # reduction. With few independent samples, the direction of this move alone may reduce or increase the
            # error, which the bootstrap does not show: the moved error has the same shape as before. The number of
            # samples is halved: errors of x, y and neighbouring samples are correlated through the heading.
            moved = math.sqrt(abs(math.exp(2.0 * self.expected[i]) - math.exp(2.0 * self.expected[j])))
            error, samples = math.exp(float(self.errors.ln_rmse[i])), float(self.errors.samples[[i, j]].min())
            worst, best = by_chance(moved / error, max(1.0, 0.5 * samples))
            least, most = least + step.weight * worst, most + step.weight * best
        value, (low, high) = float(w @ self.errors.ln_rmse), self.errors.interval(w)
        expected = None if self.expected is None else float(w @ self.expected)
        return Effect(value, min(low, value - most), max(high, value - least), expected)

    def sensor(self, sensor: str, sensors: Sequence[str]) -> SensorCredit:
        every = frozenset(sensors)
        shapley = self.effect(shapley_steps(sensor, sensors)) if self.complete(sensors) else None
        beside = self._beside(sensor, sensors)
        alone = self.effect([AddedSensor(1.0, frozenset(beside), frozenset((*beside, sensor)))])
        last = self.effect([AddedSensor(1.0, every - {sensor}, every)])
        total = self.total(sensors)
        share = shapley.value / total if shapley and total is not None and total > MIN_EFFECT else None
        anees = self._worst_anees(sensor)
        return SensorCredit(verdict(shapley, alone, last, anees), shapley, alone, last, share, anees, beside)

    def _beside(self, sensor: str, sensors: Sequence[str]) -> tuple[str, ...]:
        """Return the sensors to which `sensor` is added for its effect "alone".

        These are the sensors on which it depends. If this step was not run: the smallest subset for which it was
        run.
        """
        usual = needed(sensor)  # the effect "alone" is compared with these
        run = [s for s in self.sets if sensor not in s and s | {sensor} in self.sets]
        if not run or frozenset(usual) in run:
            return usual
        fewest = min(run, key=len)
        return tuple(s for s in sensors if s in fewest)

    def _worst_anees(self, sensor: str) -> tuple[float, float] | None:
        """Return ANEES (without, with) a sensor, for the subset in which the sensor increases it most."""
        pairs = [
            (a, b)
            for s, a in zip(self.sets, self.anees, strict=True)
            if sensor not in s and s | {sensor} in self.sets
            for b in (self.anees[self.sets.index(s | {sensor})],)
            if a is not None and b is not None and 0.0 < a <= OVERCONFIDENT_ANEES
        ]
        return max(pairs, key=lambda p: p[1] / p[0]) if pairs else None


def _expected(judged: Iterable[Evaluation]) -> Array | None:
    """Return ln of the predicted position RMSE of each configuration (k,); None if a variance is zero."""
    mean = np.array([float((e.sigma[:, :2] ** 2).sum(axis=1).mean()) for e in judged])
    return 0.5 * np.log(mean) if (mean > 0.0).all() else None


def _over_logs(found: Sequence[SensorCredit]) -> SensorCredit:
    credit, alone, last = (_mean_effect([getattr(f, name) for f in found]) for name in ("credit", "alone", "last"))
    shares = [f.share for f in found if f.share is not None]
    pairs = [f.anees for f in found if f.anees is not None]
    anees = (float(np.median([p[0] for p in pairs])), float(np.median([p[1] for p in pairs]))) if pairs else None
    share = float(np.mean(shares)) if len(shares) == len(found) else None
    beside = found[0].beside if found else ()
    return SensorCredit(verdict(credit, alone, last, anees), credit, alone, last, share, anees, beside)


def _mean_effect(effects: Sequence[Effect | None]) -> Effect | None:
    known = [e for e in effects if e is not None]
    if len(known) < len(effects) or len(known) < 2:
        return None
    values = np.array([e.value for e in known])
    half = math.nan
    if len(values) >= MIN_REPLICATES:
        half = student_t(len(values) - 1.0) * float(values.std(ddof=1)) / math.sqrt(len(values))
    expected = [e.expected for e in known if e.expected is not None]
    mean = float(values.mean())
    claimed = float(np.mean(expected)) if len(expected) == len(known) else None
    return Effect(mean, mean - half, mean + half, claimed)
