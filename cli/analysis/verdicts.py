"""Verdicts on sensors, noise and covariance: in words, and as plain values for report.json."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from msgspec.structs import asdict, replace

from locfuse.formats.report.findings import change, in_one_unit, length
from locfuse.fusion.data import ODOMETRY, Evaluation
from locfuse.fusion.judge.consistency import Consistency, RunInnovations, judge
from locfuse.fusion.judge.credit import MIN_EFFECT, Credit, Effect, SensorCredit, overconfident, unsure, verdict
from locfuse.fusion.judge.evaluate import CovarianceCheck, covariance_check
from locfuse.fusion.judge.without_truth import MIN_GAIN_NATS, Score, contradictions, ranking
from locfuse.fusion.robot import Robot

if TYPE_CHECKING:
    from locfuse.fusion.whole_drive.reference import Reference

REFERENCE = (
    "Errors are measured against the smoothed solution of the {base}{sensors} (1 sigma {sigma}), not against "
    "truth. See: locfuse explain reference."
)
TOO_SMALL = {"understated", "correlated"}  # verdicts on a sigma
TRUST_SENSORS = (
    "There is no truth in this log. Configurations are ranked by how well each predicts the sensors that it "
    "leaves out (innovation score, nats per number, compared with {base}). This finds a sensor that contradicts "
    "the others or adds nothing. It gives no error in metres. It cannot see an error that all sensors share, nor "
    "walls matched to the wrong lines. A configuration that uses every sensor has no rank."
)
TRUST_STRETCHES = (
    "Self-check: the only sensor was switched off every other five seconds, and its readings there were predicted."
)
MIN_UNPROVEN_NATS = 0.1  # nats per number: smallest gain that is reported if it is not proven
MIN_HARM_RATIO = 1.25  # position error with / without a sensor: smallest ratio that is reported


def overconfident_by_truth(check: Mapping[str, CovarianceCheck | None]) -> set[str]:
    """Return the names of configurations with larger errors to the truth than their covariance allows."""
    return {name for name, h in check.items() if h is not None and h.overconfident}


def add_consistency(
    report: dict[str, Any], runs: Sequence[RunInnovations], evaluations: Sequence[Evaluation], robot: Robot
) -> None:
    """Add `consistency` to the report: by sensor, by sensor and configuration, and by configuration with truth."""
    rows = report["configurations"]
    by_truth = {judged.name: covariance_check(judged) for judged in evaluations}
    for name, check in by_truth.items():
        rows[name]["consistency"] = None if check is None else asdict(check)
    if not runs:
        return
    verdicts: dict[str, dict[str, Any]] = {}
    judged = judge(runs, robot, overconfident_by_truth(by_truth))
    for name, sensors in judged.items():
        for sensor, consistency in sensors.items():
            using = [by_truth.get(n) for n, used in judged.items() if sensor in used]
            found = unless_overconfident(consistency, using)
            values = rows[name]["sensors"][sensor]["consistency"] = asdict(found)
            del values["fix_values"]  # a fix that was not tried is no advice; `findings` has the tried ones
            verdicts[sensor] = {key: values[key] for key in ("verdict", "words")}
    report["consistency"] = verdicts


def unless_overconfident(found: Consistency, using: Sequence[CovarianceCheck | None]) -> Consistency:
    """Withdraw the advice to reduce a sensor's sigma if truth shows that all runs with it are overconfident.

    Its readings then share an error of mount, scale or clock, which a noise setting cannot fix.
    """
    wrong = [check for check in using if check is not None]
    all_wrong = bool(wrong) and all(check.overconfident for check in wrong)
    if found.verdict != "overstated" or found.scale is None or not all_wrong:
        return found
    times = math.sqrt(min(check.anees for check in wrong))
    words = (
        f"residuals are {1.0 / found.scale:.2g} times smaller than configured, yet position errors are "
        f"{times:.1f} times what the covariance says: check mount, scale and clock; a smaller sigma would make "
        "this worse"
    )
    return replace(found, words=words, fix_values={})


def noise_factors(runs: Sequence[RunInnovations], robot: Robot) -> dict[str, float]:
    """Return {sensor: factor >= 1} by which to multiply the sigma of each sensor whose sigma is too small."""
    found = {s: c for sensors in judge(runs, robot).values() for s, c in sensors.items()}
    return {s: max(1.0, c.scale) for s, c in found.items() if c.verdict in TOO_SMALL and c.scale is not None}


def reference_values(r: Reference) -> dict[str, Any]:
    """Return a reference as plain values."""
    return {"sensors": list(r.sensors), "left_out": list(r.left_out), "sigma_m": r.sigma}


def reference_words(whole: Reference, contradicting: Sequence[tuple[str, str]], base: str) -> str:
    """Return a sentence on the reference by all sensors; `base`: name of the motion used."""
    sensors = "".join(f", {s}" for s in whole.sensors[:-1]) + f" and {whole.sensors[-1]}"
    words = REFERENCE.format(base=base, sensors=sensors, sigma=length(whole.sigma))
    words += "".join(f" {s} contradicts all others and is left out." for s in whole.left_out)
    doubtful = [pair for pair in contradicting if set(pair) <= set(whole.sensors)]
    return words + "".join(f" {a} and {b} contradict each other, so it is doubtful." for a, b in doubtful)


class ByReference(NamedTuple):
    """Position errors without and with a sensor, by a reference that does not use it."""

    before: float  # m, without the sensor
    after: float  # m, with the sensor
    sure: bool  # the reference is exact enough to judge `after`; else `after` is an upper bound
    effect: Effect | None  # None if the reference is not exact enough for either


def verdicts(
    credit: Credit | None,
    found: Sequence[Score],
    sets: Mapping[str, Sequence[str]],
    over: str = "drives",
    base: str = ODOMETRY,
) -> dict[str, dict[str, Any]]:
    """Return verdict and reason for each sensor, by the credit; if it is None, by the scores `found`.

    `over`: replicates of a credit over several logs, "drives" or "robots". Effects are relative to `base`, the
    configuration without a sensor.
    """
    if credit is not None:
        of = credit.sensors.items()
        return {s: {"verdict": c.verdict, "words": _credit_words(c, credit, over, base)} for s, c in of}
    alone = {sensors[0]: name for name, sensors in sets.items() if len(sensors) == 1}
    contradicting = contradictions(found, alone)
    out = {}
    for sensor, name in alone.items():
        mine = [s for s in found if s.configuration == name]
        others = [s for s in mine if not s.stretches]
        against = [a if b == sensor else b for a, b in contradicting if sensor in {a, b}]
        out[sensor] = _predicted(others or mine, against, len(alone), base)
    return out


def credit_values(credit: Credit) -> dict[str, Any]:
    """Return the credit, the effect of each sensor as a ratio of position errors, as plain values."""
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
        "sensors": {
            s: {
                "credit": _effect(c.credit),
                "alone": _effect(c.alone),
                "leave_one_out": _effect(c.last),
                "share": c.share,
                "anees_without": c.anees and c.anees[0],
                "anees_with": c.anees and c.anees[1],
                "beside": list(c.beside),
            }
            for s, c in credit.sensors.items()
        },
    }


def _effect(effect: Effect | None) -> dict[str, Any] | None:
    if effect is None:
        return None
    factors = {"factor": effect.value, "low": effect.low, "high": effect.high, "expected": effect.expected}
    known = {key: None if ln is None or math.isnan(ln) else math.exp(ln) for key, ln in factors.items()}
    return {"ln": effect.value, **known}


def _credit_words(c: SensorCredit, credit: Credit, over: str, base: str) -> str:
    main = c.credit or c.alone or c.last
    if main is None:
        return "No two configurations differ by it alone. Run all subsets: --all-subsets"
    several = len(credit.sensors) > 1
    by_last = c.verdict == "hurts" and main is not c.last and main.high >= 0.0  # best left out of the full set
    # a sensor may help on average but hurt the full set: only the effect that decides the verdict is shown
    few = f"Not proven by {'this drive' if credit.logs == 1 else f'{credit.logs} {over}'}. Record more."
    parts = [] if by_last else [_main_words(c, main, several, few, base)]
    if c.last is not None and several and (by_last or c.credit is not None):
        parts.append(_last_words(c.last))
    if c.anees is not None and overconfident(c.anees):
        parts.append(
            f"Overconfident: errors are {short(c.anees[1] ** 0.5)} times what the filter claims with it, "
            f"{short(c.anees[0] ** 0.5)} times without it."
        )
    return " ".join(parts)


def _main_words(c: SensorCredit, main: Effect, several: bool, few: str, base: str) -> str:
    """Return sentences on a sensor's `main` effect: ratio of errors, interval, and whether it is proven."""
    if c.credit is not None and several:
        how = "On average over all sensor combinations"
    elif c.beside:
        how = f"Beside {' and '.join(c.beside)}"
    else:
        how = "Alone" if base == ODOMETRY else f"Alone, against {base}"
    span = "" if math.isnan(main.low) else f" (plausible: {interval(main)})"
    what = f"{how}: {times(main.value)}{span}."
    sure = main.low > 0.0 or main.high < 0.0
    if c.verdict == "no effect seen":
        if abs(main.value) < MIN_EFFECT:
            return what
        if unsure(main):
            return f"{what} {few}"
        return f"{what} The filter gives it almost no weight, so this change is probably chance." if sure else what
    return what if sure else f"{what} {few}"


def _last_words(last: Effect) -> str:
    if abs(last.value) < MIN_EFFECT:
        return "Beside all others it changes nothing."
    if last.low <= 0.0 <= last.high:
        return "Beside all others no effect is seen."
    span = "" if math.isnan(last.low) else f" ({interval(last)})"
    return f"Beside all others: {times(last.value)}{span}."


def times(ln: float) -> str:
    """Return a ratio of errors in words from its logarithm: "2.3x better" or "1.2x worse"."""
    return f"{short(math.exp(abs(ln)))}x {'better' if ln >= 0 else 'worse'}"


def interval(effect: Effect) -> str:
    """Return the 95 % interval of an effect in words: "1.6x worse to 12x better", "14x to 562x better"."""
    near, far = sorted((effect.low, effect.high), key=abs)
    if near * far > 0.0:
        return f"{short(math.exp(abs(near)))}x to {times(far)}"
    return f"{times(effect.low)} to {times(effect.high)}"


def short(value: float) -> str:
    """Return a factor as text with two or three significant digits."""
    return f"{value:.0f}" if value >= 10 else f"{value:.1f}" if value >= 1.5 else f"{value:.2f}"


def prediction_values(found: Sequence[Score], names: Sequence[str], base: str = ODOMETRY) -> dict[str, Any]:
    """Return ranking and scores by prediction as plain values, with their intervals."""
    ranked = ranking(found, names)
    stretches = any(r.stretches and r.gain is not None for r in ranked)
    return {
        "method": "innovation score of sensors that only listened",
        "trust": TRUST_STRETCHES if stretches else TRUST_SENSORS.format(base=base),
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


def add_pairs(
    verdicts: Mapping[str, dict[str, Any]],
    sets: Mapping[str, Sequence[str]],
    slower: Mapping[str, Sequence[str]],
    errors: Mapping[str, float | None],
    by_truth: bool,
) -> None:
    """Add to each sensor's verdict the effect of a lower rate, and the sensors beside which it harms most.

    `sets`: configuration -> sensors; `slower`: those at a lower rate; `errors`: position errors [m]. Harm is shown
    only by truth, since two configurations may have different references.
    """
    names = {frozenset(sensors): name for name, sensors in sets.items()}
    known = {name: error for name, error in errors.items() if error}
    for sensor, found in verdicts.items():
        pairs = [(names.get(frozenset(used)), name, name) for name, used in slower.items() if f"{sensor}@" in name]
        beside = [(names.get(frozenset(used) - {sensor}), name) for name, used in sets.items() if sensor in used]
        harms = [
            (known[name] / known[without], without, name)
            for without, name in beside
            if without in known and name in known and len(sets[without]) and len(sets[name]) < len(verdicts)
        ]
        worst = max(harms, default=(0.0, "", ""))
        pairs += [(worst[1], worst[2], f"Beside {worst[1]}")] if by_truth and worst[0] > MIN_HARM_RATIO else []
        words = [
            f"{what}: {change(known[a], known[b])} ({times(math.log(known[a] / known[b]))})."
            for a, b, what in pairs
            if a in known and b in known
        ]
        found["words"] = " ".join((found["words"], *words)).strip()


def _predicted(mine: Sequence[Score], against: Sequence[str], sensors: int, base: str) -> dict[str, Any]:
    if against:
        lone = sensors > 2 and len(against) == sensors - 1
        rivals = " and ".join(against)
        words = f"It contradicts {rivals}: with one of them the other is predicted worse than by {base}."
        either = "One of them is wrong; without truth it is open which."
        words += f" {'All other sensors disagree with it.' if lone else either}"
        return {"verdict": "hurts" if lone else "no verdict", "words": words}
    if not mine:
        return {"verdict": "no verdict", "words": "No other sensor in this log can check it."}
    if mine[0].stretches:
        return _by_itself(mine[0], base)
    gain = sum(s.gain for s in mine) / len(mine)
    on = " and ".join(s.sensor for s in mine)
    better = f"{abs(gain):.2f} nats per number {'better' if gain >= 0 else 'worse'} than by {base}"
    return {"verdict": _grade(mine, gain), "words": f"With it, {on} can be predicted {better}."}


def by_reference(
    own: Mapping[str, Any] | None,
    reference: Reference | None,
    found: ByReference | None,
    contradiction: tuple[str, str] | None,
) -> dict[str, Any]:
    """Return a sensor's verdict without truth: by a reference that does not use it, else its `own` verdict."""
    own = own or {"verdict": "no verdict", "words": ""}
    if reference is None:
        words = "Without it nothing in this log says where the robot is, so no reference can judge it."
        return {**own, "words": f"{own['words']} {words}".strip()}
    if found is None:
        return dict(own)
    name = f"a reference without it ({' and '.join(reference.sensors)}, 1 sigma {length(reference.sigma)})"
    before, after = f"{length(found.before)} without it and ", f"{length(found.after)} with it"
    if contradiction is None and (effect := found.effect) is not None:
        bound = f"at {'least' if effect.low > 0.0 else 'most'} {times(effect.low)}"
        span, after = (interval(effect), after) if found.sure else (bound, f"at most {after}")
        words = f"Against {name} the position error is {before}{after} (plausible: {span}). {own['words']}".strip()
        return {"verdict": verdict(None, effect, None, None), "words": in_one_unit(words)}
    if contradiction is not None:
        words = f"{name.capitalize()} cannot judge it: {' and '.join(contradiction)} contradict each other."
    else:
        words = f"{name.capitalize()} is not exact enough to judge errors of {before}{after}."
    return {**own, "words": f"{own['words']} {words}".strip()}


def _grade(mine: Sequence[Score], gain: float) -> str:
    if abs(gain) <= MIN_GAIN_NATS or (gain < 0.0 and all(s.shared for s in mine)):
        return "no effect seen"
    does = "help" if gain > 0.0 else "hurt"
    if all(s.low > 0.0 if gain > 0.0 else s.high < 0.0 for s in mine):
        return f"{does}s"
    return f"seems to {does}" if abs(gain) >= MIN_UNPROVEN_NATS else "no effect seen"


def _by_itself(score: Score, base: str) -> dict[str, Any]:
    """Return the verdict on a log's only sensor by its own readings: they show faults, but not correctness."""
    notable, size = abs(score.gain) > MIN_GAIN_NATS, f"than {base} ({score.gain:+.2f}; 0.1 is much)"
    if notable and score.high < 0.0:
        words = f"Self-check failed: it predicts its readings worse {size}. Check its clock, mount and settings."
        return {"verdict": "hurts", "words": words}
    words = f"Self-check: it predicts its readings no better than {base}."
    if notable and score.low > 0.0:
        words = f"Self-check passed: it predicts its readings better {size}. A bias would not show."
    return {"verdict": "no verdict", "words": words}
