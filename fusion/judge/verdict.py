"""The verdict on a sensor: helps, does nothing, hurts. What one drive cannot tell from chance is nothing."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

Verdict = Literal["helps", "does nothing", "hurts", "cannot tell"]

MIN_EFFECT = 0.02  # an effect below 2 % is none, however sure
MIN_EXPECTED_EFFECT = 0.15  # what filter and truth must both say where one drive cannot settle it
MIN_HARM_LAST = 0.10  # a set that is surely 10 % better without the sensor is hurt by it
LN_2 = math.log(2.0)
MAX_ANEES, MAX_ANEES_RATIO = 10.0, 5.0  # confidently wrong: ANEES above this, and this many times the one before


@dataclass(frozen=True)
class Effect:
    """A contrast of ln(position RMSE): positive means that the sensor makes the error smaller."""

    value: float
    low: float
    high: float
    expected: float | None  # the same contrast of the filter's own predicted standard deviations


def verdict(
    shapley: Effect | None, alone: Effect | None, last: Effect | None, anees: tuple[float, float] | None
) -> Verdict:
    """Return one of three words, a fourth where nothing was compared. What chance may have made is nothing.

    Hurts: the error surely grows, or the set is surely better off without the sensor, or the sensor turns an
    honest estimate into a confidently wrong one and does not surely halve the error. Helps: the error surely
    shrinks, or it shrinks and the filter's own covariances say that it should.
    """
    main = shapley or alone or last
    if main is None:
        return "cannot tell"
    if _surely(main, -1.0) or (last is not None and last.high < -MIN_HARM_LAST):
        return "hurts"
    overconfident = anees is not None and anees[1] > max(MAX_ANEES, MAX_ANEES_RATIO * anees[0])
    if _surely(main, 1.0) and (not overconfident or main.low > LN_2):
        return "helps"
    if overconfident:
        return "hurts"
    if main.value > MIN_EXPECTED_EFFECT and main.expected is not None and main.expected > MIN_EXPECTED_EFFECT:
        return "helps"
    return "does nothing"


def _surely(effect: Effect, sign: float) -> bool:
    """Whether an effect of this sign matters and its interval excludes none, twice where nothing is expected.

    The filter itself takes little from a sensor that its covariances expect little of: there chance is the
    likelier reason for an effect, and 1 in 20 would be too often.
    """
    bound = effect.low if sign > 0 else effect.high
    if effect.expected is not None and abs(effect.expected) < MIN_EXPECTED_EFFECT:
        bound = 2.0 * bound - effect.value
    return sign * effect.value > MIN_EFFECT and sign * bound > 0.0
