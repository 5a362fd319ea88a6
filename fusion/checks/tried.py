"""Trial of fixes: each class of faults in turn, the best fix is kept, and the log is measured again.

The order of the classes matters: a late laser makes the compass look wrong until the laser's clock is corrected. A
fix is kept if it makes no configuration worse, and at least one better.

A configuration is a set of sensors that is fused. Its errors under some settings are called its figures (`Marks`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from itertools import chain
from typing import NamedTuple, Protocol

import msgspec
import numpy as np
from msgspec.structs import replace

from .finding import Finding

MAX_LOSS, MAX_LOSS_M = 0.02, 2e-4  # relative, m: largest growth of a position error
MAX_CHANCE_LOSS = 0.15  # the same, relative, for a configuration that no user would keep
MAX_CONSISTENT_LOSS = 0.3  # the same, if its ANEES is not above its chance range
MAX_SMOOTHED_LOSS = 1.0  # the same, for a smoothed path whose ANEES is not above its chance range
MAX_RUIN, MAX_RUIN_NATS = 1.0, 0.2  # relative, nats per number: a larger loss is not due to chance
MAX_LN_ANEES_LOSS = 0.1  # largest move of ln ANEES away from its chance range, at equal error
MAX_CHANCE_LN_ANEES_LOSS = 0.3  # the same, for a configuration that no user would keep
MIN_GAIN = 0.1  # relative gain of the position error
MIN_TURN_DEG = 0.1  # deg: smallest change of a heading error; allowed growth in addition to MAX_LOSS
MIN_LN_ANEES_GAIN = 0.2  # least move of ln ANEES towards its chance range
MAX_SETTLED_SHARE = 0.5  # a fix that reduces the error to less than this share is right
MAX_TURNED_SHARE = 1.0 / 3.0  # a fix that reduces the heading error by more than this share is right
MIN_GAIN_M = 2e-4  # m: smaller gains of the position error count as none, however large their share
MAX_LOSS_NATS, MIN_GAIN_NATS = 0.02, 0.05  # nats per number; a sigma 10 % off costs about 0.01, 50 % about 0.1
MAX_CHANCE_LOSS_NATS = MIN_GAIN_NATS  # nats per number, for a configuration that no user would keep
MAX_COMPARED_ANEES = 50.0  # larger values only show that the noise is wrong, and are not compared
MAX_LOST_GROWTH = 0.005  # of the drive: largest growth of the lost share
WEIGHT_OF_HEADING = 0.5  # of ln heading error, relative to ln position error
WEIGHT_OF_ANEES = 0.5  # of ln ANEES, relative to ln position error


class Marks(NamedTuple):
    """Error figures of one configuration under given settings."""

    position: float | None = None  # m, position rmse against truth
    anees: float | None = None
    bounds: tuple[float, float] | None = None  # chance range of a consistent filter's ANEES on this drive
    prediction: float | None = None  # nats per number, likelihood of sensors that were not fused; without truth
    lost: float = 0.0  # share of the drive
    shape: float | None = None  # m, position rmse after rigid alignment with the truth
    aligned: bool = False  # whether `position` is after alignment
    heading: float | None = None  # deg, heading rmse against truth

    def of_shape(self) -> Marks:
        """Return the figures after rigid alignment of the path with the truth."""
        return self._replace(position=self.shape, anees=None, bounds=None, aligned=True, heading=None)


def readable(before: Marks, after: Marks) -> tuple[Marks, Marks]:
    """Return the figures before and after a fix, without ANEES if both ANEES exceed MAX_COMPARED_ANEES."""
    if min(before.anees or 0.0, after.anees or 0.0) > MAX_COMPARED_ANEES:
        return before._replace(anees=None), after._replace(anees=None)
    return before, after


def worsens(before: Marks, after: Marks, allowed: float = MAX_LOSS, by_chance: bool = False) -> bool:
    """Return whether a figure gets notably worse or is missing after a fix.

    `allowed` is the largest relative growth of the position error. With `by_chance`, the limits for ANEES and
    prediction are those of chance.
    """
    if after.lost > before.lost + MAX_LOST_GROWTH:
        return True
    if before.position is not None:
        if after.position is None or after.position > before.position * (1.0 + allowed) + MAX_LOSS_M:
            return True
        much_smaller = after.position < (1.0 - MIN_GAIN) * before.position
        if after.position >= MAX_SETTLED_SHARE * before.position and _turns_worse(before, after, allowed):
            return True
        more = MAX_CHANCE_LN_ANEES_LOSS if by_chance else MAX_LN_ANEES_LOSS
        return not much_smaller and _off(after) > _off(before) + more
    if before.prediction is not None:
        less = MAX_CHANCE_LOSS_NATS if by_chance else MAX_LOSS_NATS
        return after.prediction is None or after.prediction < before.prediction - less
    return False


def _turns_worse(before: Marks, after: Marks, allowed: float) -> bool:
    """Return whether the heading error grows by more than the share `allowed` plus MIN_TURN_DEG."""
    if before.heading is None or after.heading is None:
        return False
    return after.heading > (1.0 + allowed) * before.heading + MIN_TURN_DEG


def turns_right(before: Marks, after: Marks) -> bool:
    """Return whether the heading error falls by more than a third, which is more than chance."""
    return _turned(before, after) > -math.log(1.0 - MAX_TURNED_SHARE)


def worsens_alone(before: Marks, after: Marks) -> bool:
    """Return whether a configuration that no user would keep gets worse by more than chance.

    Small changes of weights change the error on one drive by many percent by chance. So the limits for such a
    configuration are wider. They are widest if no ANEES is above its chance range, or only the ANEES before the
    fix.
    """
    allowed = MAX_CONSISTENT_LOSS if within_claim(before, after) or was_chance(before, after) else MAX_CHANCE_LOSS
    return worsens(before, after, allowed, by_chance=True) and not _only_underconfident(before, after)


def within_claim(before: Marks, after: Marks) -> bool:
    """Return whether the ANEES before and after a fix are known and not above their chance ranges."""
    known = [(m.anees, m.bounds) for m in (before, after) if m.anees is not None and m.bounds is not None]
    return len(known) == 2 and all(anees <= high for anees, (_, high) in known)


def worsens_smoothed(before: Marks, after: Marks, settled: bool = False) -> bool:
    """Return whether the errors of a smoothed path get notably worse.

    Its ANEES does not count as an error, since no fix is about the covariance of smoothed paths. If the ANEES is
    not above its chance range, the path may get worse by MAX_SMOOTHED_LOSS; if the fix has halved a filter's error
    (`settled`), by MAX_CHANCE_LOSS.
    """
    allowed = MAX_SMOOTHED_LOSS if within_claim(before, after) else MAX_CHANCE_LOSS if settled else MAX_LOSS
    return worsens(before._replace(anees=None), after._replace(anees=None), allowed)


def _only_underconfident(before: Marks, after: Marks) -> bool:
    """Return whether a fix only makes the filter underconfident (ANEES < 1), without a larger error: no harm."""
    if before.position is None or after.position is None or after.lost > before.lost + MAX_LOST_GROWTH:
        return False
    small = after.position <= before.position * (1.0 + MAX_CHANCE_LOSS) + MAX_LOSS_M
    return small and after.anees is not None and after.anees < 1.0


def worsens_far(before: Marks, after: Marks) -> bool:
    """Return whether a configuration gets worse by far more than chance explains."""
    if after.lost > before.lost + MAX_LOST_GROWTH:
        return True
    if before.position is not None:
        return after.position is None or after.position > (1.0 + MAX_RUIN) * before.position
    if before.prediction is not None:
        return after.prediction is None or after.prediction < before.prediction - MAX_RUIN_NATS
    return False


def was_chance(before: Marks, after: Marks) -> bool:
    """Return whether a smaller error before a fix was chance: the fix makes an inconsistent ANEES consistent."""
    if before.position is None or not after.anees:
        return False
    return _off(before) > MIN_LN_ANEES_GAIN and _off(after) == 0.0


def leaves(before: Marks, after: Marks) -> bool:
    """Return whether a fix moves the ANEES farther out of its chance range."""
    return before.bounds is not None and _off(after) > _off(before) + MAX_LN_ANEES_LOSS


def improves(before: Marks, after: Marks) -> bool:
    """Return whether a figure gets notably better by a fix; an ANEES in its chance range cannot get better."""
    if before.lost - after.lost > MAX_LOST_GROWTH:
        return True
    if before.position is not None and after.position is not None:
        less = before.position - after.position
        if less > max(MIN_GAIN * before.position, MIN_GAIN_M) or (less >= 0.0 and _turned(before, after) > 0.0):
            return True
        if turns_right(before, after) and less >= -MAX_CHANCE_LOSS * before.position:
            return True
        nearer = _off(before) - _off(after)
        if (before.anees or 1.0) < 1.0 and less < 0.0:
            return False  # a covariance that was too large is no reason for a larger error
        # a better ANEES must outweigh a larger error: an ANEES of 176 is as useless as one of 220
        return nearer > MIN_LN_ANEES_GAIN and gain(before, after) > WEIGHT_OF_ANEES * MIN_LN_ANEES_GAIN - 1e-9
    if before.prediction is not None and after.prediction is not None:
        return after.prediction - before.prediction > MIN_GAIN_NATS
    return False


def settles(before: Marks, after: Marks) -> bool:
    """Return whether the position error falls to less than half, which is more than chance."""
    if before.position is None or after.position is None:
        return False
    return after.position < MAX_SETTLED_SHARE * before.position and not worsens(before, after)


def gain(before: Marks, after: Marks) -> float:
    """Return the gain of a fix: ln(error before / after) of position, plus half of those of heading and ANEES."""
    if before.position is not None and after.position is not None:
        turned = WEIGHT_OF_HEADING * _turned(before, after)
        return (
            math.log(max(before.position, MIN_GAIN_M) / max(after.position, MIN_GAIN_M))
            + turned
            + WEIGHT_OF_ANEES * (_off(before) - _off(after))
            + before.lost
            - after.lost
        )
    if before.prediction is not None and after.prediction is not None:
        return after.prediction - before.prediction + before.lost - after.lost
    return 0.0


def _turned(before: Marks, after: Marks) -> float:
    """Return ln(heading error before / after); 0 if the change is negligible."""
    if before.heading is None or after.heading is None:
        return 0.0
    small = abs(before.heading - after.heading) < max(MIN_TURN_DEG, MIN_GAIN * before.heading)
    return 0.0 if small else math.log(before.heading / max(after.heading, MIN_TURN_DEG))


def _off(score: Marks) -> float:
    """Return the distance of ln ANEES from its chance range; 0 inside it or if unknown.

    Values inside differ by chance only: 0.73 before and 0.47 after are no loss.
    """
    if not score.anees:
        return 0.0
    low, high = score.bounds or (1.0, 1.0)
    return max(0.0, math.log(score.anees / high), math.log(low / score.anees))


MAX_FIXES = 6  # largest number of fixes for one log
MAX_MOVES = 2  # number of times that a finding may change a value by any amount
MAX_MOVED_SHARE = 0.5  # later changes must be smaller than this share of the largest change
# findings that are measured again, more exactly, once others are fixed
REFINED = ("lag", "mount", "way", "biased", "understated", "overstated")
# findings whose first alternative was measured: other alternatives are tried only if the first does not help
FIRST_VALUE = ("lag",)
ESTIMATED = ("wheels.estimate=true",)  # in place of a measured scale: tried only if that does not help
# findings on noise, which another fault may cause
NOISE_CODES = ("understated", "overstated", "correlated", "floor", "noise")
CLEAR_GAIN = 1.0  # gain of a fix beyond which later classes are not tried
EQUAL_GAIN = 1e-6  # gains that differ by less are equal: the fix of the earlier class is better
CHANCE_GAIN = 2.0 * math.log(1.0 + MAX_CHANCE_LOSS)  # largest gain of two configurations by chance

Fixes = tuple[str, ...]  # "table.key=value"
Scores = Mapping[str, Marks]  # by configuration
Pairs = Mapping[str, tuple[Marks, Marks]]  # by configuration: before and after a fix
Try = Callable[[Fixes, Sequence[str]], Scores]  # settings, configurations -> their scores


class Candidate(msgspec.Struct, frozen=True):
    """A finding, alternative fixes, and the configurations that judge these fixes."""

    finding: Finding
    alternatives: tuple[Fixes, ...]
    judges: tuple[str, ...]
    minor: tuple[str, ...] = ()  # those judges that may get slightly worse
    others: tuple[str, ...] = ()  # those judges that must not get far worse: they also depend on the wheels
    offer: bool = False  # no observation suggests the setting: it is not reported if it does not help
    measured: bool = False  # value measured on the drive: without truth and by shape it need not improve a figure
    # other logs, sensors or states agree with the value: even with truth it need not improve a figure
    proven: bool = False
    guards: tuple[str, ...] = ()  # configurations whose ANEES must stay in its chance range
    by_shape: bool = False  # may be judged after alignment, since the position of its map is not observed
    # judges whose drift may cancel a wrong start: if their error grows, the shape of their path counts
    drifting: tuple[str, ...] = ()

    @property
    def key(self) -> tuple[str, str]:
        """Role and code of the finding."""
        return self.finding.role, self.finding.code


class Advice(msgspec.Struct, frozen=True):
    """A finding with the fix that was found by trial, and the figures before and after it."""

    finding: Finding
    fixes: Fixes = ()
    pairs: Pairs = {}
    tried: tuple[Fixes, ...] = ()  # every alternative that was tried
    harmless: bool = False  # whether some alternative made nothing worse
    candidate: Candidate | None = None  # the candidate of the finding

    @property
    def judges(self) -> tuple[str, ...]:
        """Names of the configurations that judge the fix."""
        return () if self.candidate is None else self.candidate.judges

    @property
    def helps(self) -> bool:
        """Whether a fix was found that helps."""
        return bool(self.fixes)

    @property
    def shown_by(self) -> str | None:
        """Name of the configuration that gains most by the fix."""
        return max(self.pairs, key=lambda name: gain(*self.pairs[name]), default=None)


def together(*sets: Fixes) -> Fixes:
    """Return sets of settings merged; of several values for one key, the last one wins."""
    return tuple(f"{key}={value}" for key, value in by_key(chain(*sets)).items())


def keys(fixes: Iterable[str]) -> set[str]:
    """Return the keys of settings."""
    return set(by_key(fixes))


def by_key(fixes: Iterable[str]) -> dict[str, str]:
    """Return settings as key -> value; of several values for one key, the last one wins."""
    return dict(fix.partition("=")[::2] for fix in fixes)


class Case(Protocol):
    """A log, measured and fused under given settings."""

    def suspicious(self) -> bool:
        """Return whether some figure or finding is unusual; if not, no fix is tried."""

    def classes(self) -> Sequence[Sequence[Callable[[], Sequence[Candidate]]]]:
        """Return functions that create candidates, grouped by class of evidence, in the order of use.

        A fault of an earlier class looks like one of a later class. Later groups are not used while a severe
        finding has no fix.
        """

    def kept(self, role: str) -> Collection[str]:
        """Return the configurations a user would keep: all sensors, and the best one with the sensor `role`."""


Now = Callable[[str], float | None]
Look = Callable[[Fixes], Case | None]  # measures and fuses a log under settings; None if that fails


def tried(look: Look, trial: Try, now: Now = lambda key: None) -> tuple[list[Advice], Fixes]:
    """Find fixes that help by trial; return the advice, helpful fixes first, and all kept settings.

    `now` returns the configured number of a key. After a fix the log is measured again with it. A value that still
    changes after several such rounds is not used.
    """
    helped: list[Advice] = []
    open_: dict[str, Advice] = {}
    kept: Fixes = ()
    rests: set[tuple[str, str]] = set()  # findings measured again with their own fix; no value helps
    case = look(kept)
    while case is not None and len(helped) < MAX_FIXES:
        rests = set()
        if not case.suspicious():
            open_ = {}  # the fixes have removed the other findings
            break
        done = {_key(a) for a in helped}
        found = _first_that_helps(case, kept, trial, done)
        open_ = {a.finding.role: a for a in found if not a.helps}
        rests = {_key(a) for a in open_.values() if any(together(kept, fixes) != kept for fixes in a.tried)}
        new = [a for a in found if a.helps] or _beside_another(found, kept, look, trial, done)
        if not new:
            break
        runaway = {_key(a) for a in new if _moves_on(a, helped, now)}
        if runaway:
            open_ |= {a.finding.role: _without_fix(a) for a in new if _key(a) in runaway}
            helped = [a for a in helped if _key(a) not in runaway]
            kept = together(*(a.fixes for a in helped))
            break
        helped += new
        kept = together(kept, *(a.fixes for a in new))
        case = look(kept)
    helped = _without_plasters(helped, trial)
    kept = together(*(a.fixes for a in helped))
    names = {a.finding.role for a in helped}
    helped = [_with_rest(a) if _key(a) in rests else a for a in helped]
    return [*helped, *(a for role, a in open_.items() if a.finding.severe or role not in names)], kept


def _without_plasters(helped: Sequence[Advice], trial: Try) -> list[Advice]:
    """Return the advice without fixes of noise that were kept before a cause and are not needed after it."""
    last = max((i for i, a in enumerate(helped) if a.finding.code not in NOISE_CODES), default=0)
    left = list(helped)
    for advice in [a for a in helped[:last] if a.finding.code in NOISE_CODES]:
        others = [a for a in left if a is not advice]
        every, rest = (together(*(a.fixes for a in some)) for some in (left, others))
        pairs = scored(every, rest, advice.judges, trial)
        if pairs and not any(worsens(*pair) for pair in pairs.values()):
            left = others
    return left


def _key(advice: Advice) -> tuple[str, str]:
    return advice.finding.role, advice.finding.code


def _moves_on(advice: Advice, helped: Sequence[Advice], now: Now) -> bool:
    """Return whether a fix would move a setting, after MAX_MOVES moves, far in the same direction again.

    Far is more than half of the largest move before. The second move may be large: a late clock may have made the
    filter reject half of the scans at first.
    """
    same = [by_key(a.fixes) for a in (*helped, advice) if _key(a) == _key(advice)]
    for key in by_key(advice.fixes):
        first = now(key)
        if first is None:
            continue
        *moves, last = np.diff([first, *(float(fixes[key]) for fixes in same if key in fixes)]).tolist()
        largest = max(moves, key=abs, default=0.0)
        if len(moves) >= MAX_MOVES and last * largest > 0.0 and abs(last) > MAX_MOVED_SHARE * abs(largest):
            return True
    return False


def _with_rest(advice: Advice) -> Advice:
    words = f"{advice.finding.brief}; under the fix it is still measured off: something else is wrong too"
    return replace(advice, finding=replace(advice.finding, message=words, source="", hint=""))


def _without_fix(advice: Advice) -> Advice:
    words = f"{advice.finding.message}; set so, it is measured further off: something else is wrong"
    finding = replace(advice.finding, message=words, severe=True)
    return replace(advice, finding=finding, fixes=(), pairs={})


def _first_that_helps(case: Case, kept: Fixes, trial: Try, done: Collection[tuple[str, str]]) -> list[Advice]:
    """Return the best fix of the first class with a fix that helps, after severe findings without a fix.

    If there is no such fix, one finding for each sensor is returned, without fixes. If a fix gains little, and no
    observation suggests it (`Candidate.offer`), it is compared with the fixes of later classes.
    """
    open_: list[Advice] = []
    best: Advice | None = None
    last = 0
    for group, candidates_of in ((i, one) for i, several in enumerate(case.classes()) for one in several):
        if group != last and any(a.finding.severe for a in open_):
            break  # later classes (offsets, noise) wait for a fix of this one
        last = group
        candidates = [c for c in candidates_of() if c.key not in done or c.finding.code in REFINED]
        results = [(c, best_of(c, kept, trial)) for c in candidates]
        helpful = [a for _, a in results if a.helps]
        if helpful:
            first = max(helpful, key=lambda a: _rank(a, helpful))
            best = first if best is None or _weight(first) > _weight(best) + EQUAL_GAIN else best
            observed = any(not c.offer for c, a in results if a is first)
            if observed or worth(best) > CLEAR_GAIN:
                break
        open_ += (a for c, a in results if not a.helps and not c.offer)
    if best is not None:
        return [*(a for a in open_ if a.finding.severe), best]
    first_of: dict[str, Advice] = {}  # one finding for each sensor at a time
    for advice in open_:
        first_of.setdefault(advice.finding.role, advice)
    return list(first_of.values())


def _weight(advice: Advice) -> float:
    """Return the gain of a fix, with a bonus for a measured value, for comparison with fixes of later classes.

    The bonus is needed because another fix, such as more noise, may gain more by chance.
    """
    measured = advice.candidate is not None and advice.candidate.measured
    return worth(advice) + (CHANCE_GAIN if measured else 0.0)


def _beside_another(
    found: Sequence[Advice], kept: Fixes, look: Look, trial: Try, done: Collection[tuple[str, str]]
) -> list[Advice]:
    """Return two fixes that help only together; [] if there are none. The first one is for a severe finding.

    Two faults may hide each other: a late compass is rejected and does no harm to a laser with too high noise,
    until the clock of the compass is corrected.
    """
    for advice in found:
        for fixes in advice.tried if advice.finding.severe else ():
            beside = together(kept, fixes)
            if not any(improves(*pair) for pair in scored(kept, beside, advice.judges, trial).values()):
                continue
            case = look(beside)
            if case is None:
                continue
            now = {*done, _key(advice)}
            others = [a for a in _first_that_helps(case, beside, trial, now) if a.helps]
            both = together(beside, *(other.fixes for other in others))
            pairs = scored(kept, both, advice.judges, trial)
            if not others or not pairs:
                continue
            strict = case.kept(advice.finding.role)  # for other configurations only a loss beyond chance counts
            if not any((worsens if name in strict else worsens_alone)(*pair) for name, pair in pairs.items()):
                return [replace(advice, fixes=fixes, pairs=pairs), *others]
    return []


def scored(kept: Fixes, fixes: Fixes, judges: Sequence[str], trial: Try) -> Pairs:
    """Return the figures of configurations before and after `fixes`; {} if some are missing."""
    before, after = trial(kept, judges), trial(fixes, judges)
    return {name: (before[name], after[name]) for name in before} if before and after else {}


def worth(advice: Advice) -> float:
    """Return the sum of the gains of all configurations that judged a fix."""
    return sum(gain(*pair) for pair in advice.pairs.values())


def _rank(advice: Advice, rivals: Sequence[Advice]) -> float:
    """Return the gain by which a fix is ranked among `rivals`, fixes that compete with it.

    If two sensors disagree and there is no truth, a change of either sensor improves the prediction of the other
    one. So only configurations that judged all rivals count, if there are any.
    """
    if any(before.position is not None for before, _ in advice.pairs.values()):
        return worth(advice)
    shared = [pair for name, pair in advice.pairs.items() if all(name in a.pairs for a in rivals)]
    return sum(gain(*pair) for pair in shared) or worth(advice)


def best_of(candidate: Candidate, kept: Fixes, trial: Try) -> Advice:
    """Return the alternative of a candidate that reduces the position error most.

    If none helps and `candidate.by_shape` is true, errors after rigid alignment with the truth are compared.
    """
    found = _best_by(candidate, kept, trial, False)
    if found.helps or not candidate.by_shape:
        return found
    by_shape = _best_by(candidate, kept, trial, True)
    return by_shape if by_shape.helps else found


def _best_by(candidate: Candidate, kept: Fixes, trial: Try, shape: bool) -> Advice:
    unfixed = Advice(candidate.finding, tried=candidate.alternatives, candidate=candidate)
    options: list[Advice] = []
    harmless = False
    for fixes in candidate.alternatives:
        if together(kept, fixes) == kept:
            continue  # set already
        first = fixes == ESTIMATED or (candidate.measured and candidate.finding.code in FIRST_VALUE)
        if options and first:
            break
        pairs = judged_pairs(candidate, kept, fixes, trial, shape)
        harmless = harmless or bool(pairs)
        # a measured value need not improve a figure, but no configuration may get worse (with a proven value, the
        # minor ones may get worse within the limits of chance)
        by_prediction = all(one.position is None for one, _ in pairs.values())
        by_chance = candidate.minor if candidate.proven else ()
        worse = any((worsens_alone if n in by_chance else worsens)(*pair) for n, pair in pairs.items())
        sure = (candidate.proven or by_prediction) and not worse and not _idle(pairs)
        shown = candidate.measured and bool(pairs) and (shape or sure)
        if shown or any(improves(*pair) for pair in pairs.values()):
            guards = scored(kept, together(kept, fixes), candidate.guards, trial)
            if any(leaves(*pair) for pair in guards.values()):
                continue
            advice = replace(unfixed, fixes=fixes, pairs=pairs)
            options += [advice] if (shown and not shape) or worth(advice) > 0.0 else []
    return max(options, key=worth, default=replace(unfixed, harmless=harmless))


def _idle(pairs: Pairs) -> bool:
    """Return whether a fix moves no pose and hardly lowers an ANEES, such as a small noise of the truth."""
    return all(
        one.position is not None
        and one.position == other.position
        and math.log(max(one.anees or 1.0, 1e-9) / max(other.anees or 1.0, 1e-9)) < MIN_LN_ANEES_GAIN
        for one, other in pairs.values()
    )


def judged_pairs(candidate: Candidate, kept: Fixes, fixes: Fixes, trial: Try, shape: bool = False) -> Pairs:
    """Return each judge's figures before and after a fix; {} if one of them gets worse."""
    pairs: dict[str, tuple[Marks, Marks]] = {}
    chance_alone = turned = False
    # a value that others confirm, and that halves one error, is right even if other rows lose by it
    settled = candidate.measured and any(
        settles(*pair) for pair in scored(kept, together(kept, fixes), candidate.judges, trial).values()
    )
    proven = settled and candidate.proven
    for name in candidate.judges:
        found = scored(kept, together(kept, fixes), (name,), trial)
        if not found:
            return {}
        before, after = found[name]
        shapes = readable(before.of_shape(), after.of_shape())
        one, other = shapes if shape else readable(before, after)
        if name in candidate.drifting and worsens(one, other):
            one, other = shapes
        # after one error fell to less than half, others may get worse by chance
        right = candidate.measured and turns_right(one, other)
        chance = name in candidate.minor or settled or right
        far = proven or name in candidate.others
        worse = worsens_far if far else worsens_alone if chance else worsens
        if turned and not _turns_worse(one, other, MAX_RUIN):
            one = one._replace(heading=None)  # it was better by chance, since the turns of another are right now
        if worse(one, other):
            if name not in candidate.minor or not was_chance(one, other):
                return {}
            chance_alone = True  # accepted only if some error is settled
        pairs[name] = one, other
        observed = candidate.measured or not candidate.offer
        if observed and settles(one, other):
            settled, turned = True, turned or turns_right(one, other)
    # a measured value under which a kept row gains and the others' covariances become right
    gained = candidate.measured and any(improves(*pair) for n, pair in pairs.items() if n not in candidate.minor)
    return {} if chance_alone and not (settled or gained) else pairs
