"""Verdicts in words, and the numbers behind them as plain values for report.json."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from locfuse.fusion.judge.credit import Credit, SensorCredit
from locfuse.fusion.judge.predictive import MIN_GAIN_NATS, Score, contradictions, ranking
from locfuse.fusion.judge.verdict import MAX_ANEES, MIN_EFFECT, Effect

TRUST_SENSORS = (
    "There is no truth in this log, so configurations are ranked by how well each predicts the sensors that it "
    "leaves out (innovation score, nats per number against odometry). Trust it to find a sensor that contradicts "
    "the others or adds nothing; do not read metres from it. It cannot see an error that all sensors share, nor "
    "walls taken for others, and a configuration that leaves no sensor out has no place."
)
TRUST_STRETCHES = (
    "There is no truth in this log and only one sensor besides the wheels, so nothing independent can judge it. "
    "Instead it was switched off every other five seconds and its readings there were predicted. That shows "
    "whether it agrees with itself, which a biased sensor does too: trust it little."
)


def verdicts(
    credit: Credit | None, found: Sequence[Score], sets: Mapping[str, Sequence[str]], over: str = "drives"
) -> dict[str, dict[str, Any]]:
    """Return for every sensor its verdict and why in words; the credit is `over` drives or robots."""
    if credit is not None:
        return {
            s: {"verdict": c.verdict, "words": _credit_words(c, credit, over)} for s, c in credit.sensors.items()
        }
    return _predicted_verdicts(found, sets)


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
        "low": math.exp(effect.low),
        "high": math.exp(effect.high),
        "expected": None if effect.expected is None else math.exp(effect.expected),
    }


def _credit_words(c: SensorCredit, credit: Credit, over: str) -> str:
    main = c.credit or c.alone or c.last
    if main is None:
        return "No two of these sets differ by it alone; --all-subsets runs all of them."
    parts = [_main_words(c, main, len(credit.sensors) > 1, _few(credit.logs, over))]
    if c.verdict == "hurts" and c.anees is not None and c.anees[1] > MAX_ANEES:
        parts.insert(
            0,
            f"It makes the filter sure and wrong: ANEES {short(c.anees[1])} with it, {short(c.anees[0])} without "
            "(1 is right).",
        )
    if c.credit is not None and c.last is not None and len(credit.sensors) > 1:
        parts.append(_last_words(c.last))
    return " ".join(parts)


def _main_words(c: SensorCredit, main: Effect, several: bool, few: str) -> str:
    how = (
        "Over every order of adding the sensors, it makes"
        if c.credit is not None and several
        else f"Beside {' and '.join(c.beside)} it makes"
        if c.beside
        else "Alone it makes"
    )
    whose = f"{'+'.join(c.beside)}'s" if c.beside else "odometry's"
    what = f"{how} {whose} position error {times(main.value)} ({interval(main)})"
    if c.credit is not None and several:
        what = what.replace(whose, "the")
    if c.verdict == "does nothing":
        if main.low > 0.0 or main.high < 0.0:
            return f"{what}. The filter takes next to nothing from it, so chance is the likelier reason."
        return f"{what}: no more than chance."
    if main.low > 0.0 or main.high < 0.0:
        return f"{what}."
    if c.verdict == "helps":
        return f"{what}. {few} not prove that, but the filter's own covariances say the same."
    return f"{what}. {few} not prove that."


def _few(samples: int, over: str) -> str:
    return "One drive does" if samples == 1 else f"{samples} {over} do"


def _last_words(last: Effect) -> str:
    if abs(last.value) < MIN_EFFECT:
        return "Beside all others it changes nothing."
    if last.low <= 0.0 <= last.high:
        return "Beside all others it changes no more than chance."
    return f"Beside all others it makes the error {times(last.value)} ({interval(last)})."


def times(ln: float) -> str:
    """Return "2.3 times smaller", or "1.2 times larger"."""
    return f"{short(math.exp(abs(ln)))} times {'smaller' if ln >= 0 else 'larger'}"


def interval(effect: Effect) -> str:
    """Return the 95 % interval in words that fit the effect's own direction."""
    if effect.value >= 0.0:
        return f"95 %: {short(math.exp(effect.low))} to {short(math.exp(effect.high))}"
    return f"95 %: {short(math.exp(-effect.high))} to {short(math.exp(-effect.low))}"


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


def _predicted_verdicts(found: Sequence[Score], sets: Mapping[str, Sequence[str]]) -> dict[str, dict[str, Any]]:
    alone = {sensors[0]: name for name, sensors in sets.items() if len(sensors) == 1}
    quarrels = contradictions(found, alone)
    out = {}
    for sensor, name in alone.items():
        others = [s for s in found if s.configuration == name and not s.stretches]
        own = [s for s in found if s.configuration == name and s.stretches]
        against = [a if b == sensor else b for a, b in quarrels if sensor in {a, b}]
        out[sensor] = _predicted(others or own, against, len(alone))
    return out


def _predicted(mine: Sequence[Score], against: Sequence[str], sensors: int) -> dict[str, Any]:
    if against:
        lone = sensors > 2 and len(against) == sensors - 1
        words = (
            f"It and {' and '.join(against)} contradict each other: one predicts the other worse than odometry."
        )
        words += " All others are against it." if lone else " One is wrong; without truth nobody can say which."
        return {"verdict": "hurts" if lone else "contradicts", "words": words}
    if not mine:
        return {"verdict": "cannot tell", "words": "Nothing in this log can check it."}
    gain = sum(s.gain for s in mine) / len(mine)
    if mine[0].stretches:
        return _by_itself(mine[0])
    on = " and ".join(s.sensor for s in mine)
    better = f"{abs(gain):.2f} nats per number {'better' if gain >= 0 else 'worse'} than odometry does"
    sure = all(s.low > 0.0 for s in mine) and gain > MIN_GAIN_NATS
    return {"verdict": "helps" if sure else "does nothing", "words": f"With it, {on} can be predicted {better}."}


def _by_itself(score: Score) -> dict[str, Any]:
    """Judge the only sensor of a log by its own readings: that can show a fault, never that it is right."""
    words = f"It predicts its own readings five seconds ahead {abs(score.gain):.2f} nats per number "
    if score.high < 0.0:
        words += "worse than odometry does. Its clock, mount or settings are probably wrong."
        return {"verdict": "hurts", "words": words}
    if score.low > 0.0:
        words += "better than odometry does: it agrees with itself, which a biased sensor does too."
    else:
        words += "off odometry's, no more than chance."
    return {"verdict": "cannot tell", "words": words}
