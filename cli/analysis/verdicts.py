"""Verdicts in words, and the numbers behind them as plain values for report.json."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from locfuse.formats.report.findings import length
from locfuse.fusion.data import ODOMETRY
from locfuse.fusion.judge.against import Reference
from locfuse.fusion.judge.credit import Credit, SensorCredit
from locfuse.fusion.judge.predictive import MIN_GAIN_NATS, Score, contradictions, ranking
from locfuse.fusion.judge.verdict import MAX_UNSURE, MIN_EFFECT, Effect, overconfident, verdict

TRUST_SENSORS = (
    "There is no truth in this log. Configurations are ranked by how well each predicts the sensors that it "
    "leaves out (innovation score, nats per number, compared with odometry). This finds a sensor that contradicts "
    "the others or adds nothing. It gives no error in metres. It cannot see an error that all sensors share, nor "
    "walls matched to the wrong lines. A configuration that uses every sensor has no rank."
)
TRUST_STRETCHES = (
    "There is no truth in this log and only one sensor besides the wheels, so nothing independent can judge it. "
    "Instead it was switched off every other five seconds and its readings there were predicted. That shows "
    "whether it agrees with itself, which a biased sensor does too."
)


class ByReference(NamedTuple):
    """What a reference that a sensor has no part in says of it."""

    before: float  # m, error without it
    after: float  # m, error with it
    sure: bool  # the reference is exact enough for `after` too; else that is an upper bound
    effect: Effect | None  # None where it is exact enough for neither


def verdicts(
    credit: Credit | None,
    found: Sequence[Score],
    sets: Mapping[str, Sequence[str]],
    over: str = "drives",
    base: str = ODOMETRY,
) -> dict[str, dict[str, Any]]:
    """Return for every sensor its verdict and why in words; the credit is `over` drives or robots.

    `base` is the configuration without a sensor, with which they are compared.
    """
    if credit is not None:
        return {
            s: {"verdict": c.verdict, "words": _credit_words(c, credit, over, base)}
            for s, c in credit.sensors.items()
        }
    return _predicted_verdicts(found, sets, base)


def credit_values(credit: Credit) -> dict[str, Any]:
    """Return the credit as plain values; effects are factors by which the position error shrinks."""
    return {
        "figure": "position_rmse_m",
        "complete": credit.complete,
        "total_factor": None if credit.total is None else math.exp(credit.total),
        "interval": {
            "confidence": 0.95,
            "method": credit.method,
            "effective_samples": credit.effective_samples,
            "block_s": credit.block_s,
            "logs": credit.logs,
        },
        "sensors": {s: _sensor_values(c) for s, c in credit.sensors.items()},
    }


def _sensor_values(c: SensorCredit) -> dict[str, Any]:
    return {
        "credit": _effect(c.credit),
        "alone": _effect(c.alone),
        "leave_one_out": _effect(c.last),
        "share": c.share,
        "anees_without": None if c.anees is None else c.anees[0],
        "anees_with": None if c.anees is None else c.anees[1],
        "beside": list(c.beside),
    }


def _effect(effect: Effect | None) -> dict[str, Any] | None:
    if effect is None:
        return None
    return {
        "ln": effect.value,
        "factor": math.exp(effect.value),
        "low": None if math.isnan(effect.low) else math.exp(effect.low),
        "high": None if math.isnan(effect.high) else math.exp(effect.high),
        "expected": None if effect.expected is None else math.exp(effect.expected),
    }


def _credit_words(c: SensorCredit, credit: Credit, over: str, base: str) -> str:
    main = c.credit or c.alone or c.last
    if main is None:
        return "No two configurations differ by it alone. Run all subsets: --all-subsets"
    several, by_last = len(credit.sensors) > 1, _judged_by_last(c, main)
    # what hurts beside the others may help on average: only what the grade rests on is said
    parts = [] if by_last else [_main_words(c, main, several, _few(credit.logs, over), base)]
    if c.last is not None and several and (by_last or c.credit is not None):
        parts.append(_last_words(c.last))
    if c.anees is not None and overconfident(c.anees):
        parts.append(
            f"Overconfident: errors are {short(c.anees[1] ** 0.5)} times what the filter claims with it, "
            f"{short(c.anees[0] ** 0.5)} times without it."
        )
    return " ".join(parts)


def _main_words(c: SensorCredit, main: Effect, several: bool, few: str, base: str) -> str:
    """Return the effect in figures, its interval, and what would settle it."""
    if c.credit is not None and several:
        how = "On average over all sensor combinations it makes the position error"
    elif c.beside:
        how = f"Beside {' and '.join(c.beside)} it makes the position error"
    else:
        how = f"Alone it makes {base}'s position error"
    what = f"{how} {times(main.value)}{_plausible(main)}."
    sure = main.low > 0.0 or main.high < 0.0
    if c.verdict == "no effect seen":
        if abs(main.value) < MIN_EFFECT:
            return what
        if min(-main.low, main.high) > MAX_UNSURE:
            return f"{what} {few}"
        return f"{what} The filter gives it almost no weight, so this change is probably chance." if sure else what
    return what if sure else f"{what} {few}"


def _plausible(effect: Effect) -> str:
    """Return the interval in brackets; "" where there is none."""
    return "" if math.isnan(effect.low) else f" (95 % interval: {interval(effect)})"


def _judged_by_last(c: SensorCredit, main: Effect) -> bool:
    """Return whether a sensor is said to hurt because the others are better off without it."""
    return c.verdict == "hurts" and main is not c.last and main.high >= 0.0


def _few(samples: int, over: str) -> str:
    """Return what would settle an effect whose interval includes none."""
    settle = "One drive does" if samples == 1 else f"{samples} {over} do"
    return f"{settle} not settle it; longer{' drives' if over != 'drives' else ''} or more {over} would."


def _last_words(last: Effect) -> str:
    if abs(last.value) < MIN_EFFECT:
        return "Beside all others it changes nothing."
    if last.low <= 0.0 <= last.high:
        return "Beside all others no effect is seen."
    span = "" if math.isnan(last.low) else f" ({interval(last)})"
    return f"Beside all others it makes the error {times(last.value)}{span}."


def times(ln: float) -> str:
    """Return "2.3 times smaller", or "1.2 times larger"."""
    return f"{short(math.exp(abs(ln)))} times {'smaller' if ln >= 0 else 'larger'}"


def interval(effect: Effect) -> str:
    """Return the 95 % interval as two factors, each with its direction: "1.6 times larger to 12 times smaller".

    Where both have one direction it stands once: "14 to 562 times smaller".
    """
    if effect.low > 0.0:
        return f"{short(math.exp(effect.low))} to {times(effect.high)}"
    if effect.high < 0.0:
        return f"{short(math.exp(-effect.high))} to {times(effect.low)}"
    return f"{times(effect.low)} to {times(effect.high)}"


def short(value: float) -> str:
    """Return a factor with as many digits as mean anything."""
    return f"{value:.0f}" if value >= 10 else f"{value:.1f}" if value >= 2 else f"{value:.2f}"


def prediction_values(found: Sequence[Score], names: Sequence[str]) -> dict[str, Any]:
    """Return ranking and scores as plain values, with how far to trust them."""
    ranked = ranking(found, names)
    stretches = any(r.stretches and r.gain is not None for r in ranked)
    return {
        "method": "innovation score of sensors that only listened",
        "trust": TRUST_STRETCHES if stretches else TRUST_SENSORS,
        "ranking": [
            {"configuration": r.configuration, "gain_nats": r.gain, "sensors": list(r.on)} for r in ranked
        ],
        "scores": [
            {
                "configuration": s.configuration,
                "sensor": s.sensor,
                "numbers": s.numbers,
                "score_nats": s.score,
                "gain_nats": s.gain,
                "low": s.low,
                "high": s.high,
                "by": "stretches" if s.stretches else "sensors",
            }
            for s in found
        ],
    }


def _predicted_verdicts(
    found: Sequence[Score], sets: Mapping[str, Sequence[str]], base: str
) -> dict[str, dict[str, Any]]:
    alone = {sensors[0]: name for name, sensors in sets.items() if len(sensors) == 1}
    quarrels = contradictions(found, alone)
    out = {}
    for sensor, name in alone.items():
        others = [s for s in found if s.configuration == name and not s.stretches]
        own = [s for s in found if s.configuration == name and s.stretches]
        against = [a if b == sensor else b for a, b in quarrels if sensor in {a, b}]
        out[sensor] = _predicted(others or own, against, len(alone), base)
    return out


def _predicted(mine: Sequence[Score], against: Sequence[str], sensors: int, base: str) -> dict[str, Any]:
    if against:
        lone = sensors > 2 and len(against) == sensors - 1
        rivals = " and ".join(against)
        words = f"It contradicts {rivals}: with one of them the other is predicted worse than by {base}."
        words += (
            " All other sensors disagree with it."
            if lone
            else " One of them is wrong; without truth it is open which."
        )
        return {"verdict": "hurts" if lone else "no verdict", "words": words}
    if not mine:
        return {"verdict": "no verdict", "words": "No other sensor in this log can check it."}
    gain = sum(s.gain for s in mine) / len(mine)
    if mine[0].stretches:
        return _by_itself(mine[0], base)
    on = " and ".join(s.sensor for s in mine)
    better = f"{abs(gain):.2f} nats per number {'better' if gain >= 0 else 'worse'} than by {base}"
    return {"verdict": _grade(mine, gain), "words": f"With it, {on} can be predicted {better}."}


def by_reference(
    own: Mapping[str, Any] | None,
    reference: Reference | None,
    found: ByReference | None,
    quarrel: tuple[str, str] | None,
) -> dict[str, Any]:
    """Return a sensor's verdict without truth: by a reference without it if that can judge, else its `own`."""
    own = own or {"verdict": "no verdict", "words": ""}
    if reference is None:
        words = "Without it nothing in this log says where the robot is, so no reference can judge it."
        return {**own, "words": f"{own['words']} {words}".strip()}
    if found is None:
        return dict(own)
    name = f"a reference without it ({' and '.join(reference.sensors)}, 1 sigma {length(reference.sigma)})"
    if quarrel is not None:
        words = f"{name.capitalize()} cannot judge it: {' and '.join(quarrel)} contradict each other."
        return {**own, "words": f"{own['words']} {words}".strip()}
    if found.effect is None:
        errors = f"{length(found.before)} without it and {length(found.after)} with it"
        words = f"{name.capitalize()} is not exact enough to judge errors of {errors}."
        return {**own, "words": f"{own['words']} {words}".strip()}
    return {"verdict": verdict(None, found.effect, None, None), "words": _reference_words(name, found, own)}


def _reference_words(name: str, found: ByReference, own: Mapping[str, Any]) -> str:
    effect = found.effect
    assert effect is not None
    most = "" if found.sure else "at most "
    errors = f"{length(found.before)} without it and {most}{length(found.after)} with it"
    span = interval(effect) if found.sure else f"at {'least' if effect.low > 0.0 else 'most'} {times(effect.low)}"
    words = f"Against {name} the position error is {errors} (95 % interval: {span})."
    return f"{words} {own['words']}".strip()


def _grade(mine: Sequence[Score], gain: float) -> str:
    if abs(gain) <= MIN_GAIN_NATS or (gain < 0.0 and all(s.shared for s in mine)):
        return "no effect seen"
    if gain > 0.0:
        return "helps" if all(s.low > 0.0 for s in mine) else "seems to help"
    return "hurts" if all(s.high < 0.0 for s in mine) else "seems to hurt"


def _by_itself(score: Score, base: str) -> dict[str, Any]:
    """Judge the only sensor of a log by its own readings: that can show a fault, never that it is right."""
    words = "The log has no truth and no second sensor. Self-check: its readings five seconds ahead are predicted "
    if score.high < 0.0:
        words += (
            f"{abs(score.gain):.2f} nats per number worse than by {base}. Check its clock, mount and settings."
        )
        return {"verdict": "hurts", "words": words}
    if score.low > 0.0:
        words += f"{score.gain:.2f} nats per number better than by {base}. A biased sensor can do that too."
    else:
        words += f"no better than by {base}."
    return {"verdict": "no verdict", "words": words}
