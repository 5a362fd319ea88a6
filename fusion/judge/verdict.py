"""The verdict on a sensor in grades: helps, seems to help, no effect seen, seems to hurt, hurts, or no verdict."""

from __future__ import annotations

import math
from typing import Literal

import msgspec

Verdict = Literal["helps", "seems to help", "no effect seen", "seems to hurt", "hurts", "no verdict"]

MIN_EFFECT = 0.02  # an effect below 2 % is none, however certain
MIN_EXPECTED_EFFECT = 0.15  # an effect whose interval includes none is only seen from 15 % on
MAX_UNSURE = math.log(10.0)  # an interval that reaches ten times smaller and ten times larger shows nothing
MIN_HARM_LAST = 0.10  # a set that is surely 10 % better without the sensor is hurt by it
MAX_ANEES, MAX_ANEES_RATIO = 10.0, 5.0  # overconfident: ANEES above this, and this many times the one before
MAX_CONSISTENT_ANEES = 3.0  # a run with more is inconsistent, and its covariance is no evidence


class Effect(msgspec.Struct, frozen=True):
    """A contrast of ln(position RMSE): positive means that the sensor makes the error smaller.

    Its bounds are NaN over so few drives that there is no interval.
    """

    value: float
    low: float
    high: float
    expected: float | None  # the same contrast of the filter's own predicted standard deviations


def verdict(
    shapley: Effect | None, alone: Effect | None, last: Effect | None, anees: tuple[float, float] | None
) -> Verdict:
    """Return the grade of a sensor; "no verdict" if nothing was compared.

    Helps or hurts: the interval of the effect excludes none (or the set is surely better off without the sensor).
    Seems to: the effect is large and its interval includes none. The filter's own covariance has a veto where it
    is consistent (ANEES): a sensor from which it takes nothing changed the error by chance. Being overconfident is
    no reason to be called harmful: `overconfident` says it beside the grade.
    """
    main = shapley or alone or last
    if main is None:
        return "no verdict"
    if _surely(main, -1.0) or (last is not None and last.high < -MIN_HARM_LAST):
        return "hurts"
    if _surely(main, 1.0):
        return "helps"
    if min(-main.low, main.high) > MAX_UNSURE:
        return "no effect seen"
    consistent = anees is None or anees[1] <= MAX_CONSISTENT_ANEES
    vetoed = consistent and main.expected is not None and abs(main.expected) < MIN_EXPECTED_EFFECT
    if abs(main.value) <= MIN_EXPECTED_EFFECT or vetoed:
        return "no effect seen"
    return "seems to help" if main.value > 0.0 else "seems to hurt"


def overconfident(anees: tuple[float, float] | None) -> bool:
    """Return whether adding a sensor, ANEES (without, with), makes the filter much more overconfident."""
    return anees is not None and anees[1] > max(MAX_ANEES, MAX_ANEES_RATIO * anees[0])


def _surely(effect: Effect, sign: float) -> bool:
    """Whether an effect of this sign matters and its interval excludes none (twice, if no effect is expected).

    The filter itself takes little from a sensor that its covariances expect little of: there chance is the
    likelier reason for an effect, and 1 in 20 would be too often.
    """
    bound = effect.low if sign > 0 else effect.high
    if effect.expected is not None and abs(effect.expected) < MIN_EXPECTED_EFFECT:
        bound = 2.0 * bound - effect.value
    return sign * effect.value > MIN_EFFECT and sign * bound > 0.0
