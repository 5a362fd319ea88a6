"""The loop that tries fixes: take the best one of the first class of evidence that has one, then repeat.

So no sensor is blamed for the fault of another: a late laser makes the compass look wrong, until the laser's clock
is set. A fix is taken if no configuration gets worse by it and one gets better.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import NamedTuple, Protocol

import msgspec
import numpy as np
from msgspec.structs import replace

from .finding import Finding

MAX_LOSS, MAX_LOSS_M = 0.02, 2e-4  # relative, m: by which no position error may grow
MAX_CHANCE_LOSS = 0.15  # relative, of the position error of a configuration that no user would keep
MAX_CONSISTENT_LOSS = 0.3  # the same, where its errors stay within what it claims
MAX_SMOOTHED_LOSS = 1.0  # of a smoothed path whose errors stay within what it claims
MAX_RUIN, MAX_RUIN_NATS = 1.0, 0.2  # relative, nats per number: more than chance does to any configuration
MAX_LN_ANEES_LOSS = 0.1  # by which ln ANEES may leave its chance range further where the error stays the same
MIN_GAIN = 0.1  # relative gain of the position error
MIN_TURN_DEG = 0.1  # by which a heading error must change, and by how much it may grow beside MAX_LOSS
MIN_LN_ANEES_GAIN = 0.2  # by which ln ANEES must come nearer to its chance range
MAX_SETTLED_SHARE = 0.5  # of the error before: a fix that leaves less is right, whatever chance does elsewhere
MAX_TURNED_SHARE = 1.0 / 3.0  # of the heading error: a fix that takes more away is right
MIN_GAIN_M = 2e-4  # m: smaller gains of the position error are none, however large their share
MAX_LOSS_NATS, MIN_GAIN_NATS = 0.02, 0.05  # nats per number; a sigma 10 % off costs about 0.01, 50 % about 0.1
MAX_CHANCE_LOSS_NATS = MIN_GAIN_NATS  # nats per number, of a configuration that no user would keep
MAX_ANEES = 50.0  # above, it only says that the noise is wrong
MAX_LOST_SHARE = 0.005  # of the drive: by which being lost may grow
WEIGHT_OF_HEADING = 0.5  # of a factor on the heading error, against one on the position error
WEIGHT_OF_ANEES = 0.5  # of a factor on ANEES, against one on the position error


class Marks(NamedTuple):
    """One configuration's figures under some settings."""

    position: float | None = None  # m, position rmse against truth
    anees: float | None = None
    bounds: tuple[float, float] | None = None  # where a consistent filter's ANEES lies on such a drive
    prediction: float | None = None  # nats per number of the sensors that only listened; without truth
    lost: float = 0.0  # share of the drive
    shape: float | None = None  # m, position rmse of the path laid on the truth as a whole
    aligned: bool = False  # `position` is that of the shape
    heading: float | None = None  # deg, heading rmse against truth

    def of_shape(self) -> Marks:
        """Return the score of the path's shape alone: where it lies in the world does not count."""
        return self._replace(position=self.shape, anees=None, bounds=None, aligned=True, heading=None)


def readable(before: Marks, after: Marks) -> tuple[Marks, Marks]:
    """Return figures to compare, without ANEES if both are so large that they only show wrong noise."""
    if min(before.anees or 0.0, after.anees or 0.0) > MAX_ANEES:
        return before._replace(anees=None), after._replace(anees=None)
    return before, after


def worsens(before: Marks, after: Marks, allowed: float = MAX_LOSS, allowed_nats: float = MAX_LOSS_NATS) -> bool:
    """Return whether any figure gets notably worse or is missing.

    `allowed` is the share by which the position error may grow, `allowed_nats` what a prediction may lose.
    """
    if after.lost > before.lost + MAX_LOST_SHARE:
        return True
    if before.position is not None:
        if after.position is None or after.position > before.position * (1.0 + allowed) + MAX_LOSS_M:
            return True
        much_smaller = after.position < (1.0 - MIN_GAIN) * before.position
        if after.position >= MAX_SETTLED_SHARE * before.position and _turns_worse(before, after, allowed):
            return True
        return not much_smaller and _off(after) > _off(before) + MAX_LN_ANEES_LOSS
    if before.prediction is not None:
        return after.prediction is None or after.prediction < before.prediction - allowed_nats
    return False


def _turns_worse(before: Marks, after: Marks, allowed: float) -> bool:
    """Return whether the heading error grows by more than the share that is `allowed` and MIN_TURN_DEG."""
    if before.heading is None or after.heading is None:
        return False
    return after.heading > (1.0 + allowed) * before.heading + MIN_TURN_DEG


def turns_right(before: Marks, after: Marks) -> bool:
    """Return whether the heading error falls by more than a third: more than chance on one drive."""
    return _turned(before, after) > -math.log(1.0 - MAX_TURNED_SHARE)


def worsens_alone(before: Marks, after: Marks) -> bool:
    """Return whether a configuration that no user would keep gets notably worse.

    One drive's error moves by many percent with every other way of weighing the same readings, by chance: such a
    configuration may not hinder what helps the better ones; least where both errors are no larger than it claims,
    or where only the new ones are.
    """
    allowed = MAX_CONSISTENT_LOSS if within_claim(before, after) or was_chance(before, after) else MAX_CHANCE_LOSS
    return worsens(before, after, allowed, MAX_CHANCE_LOSS_NATS) and not _only_underconfident(before, after)


def within_claim(before: Marks, after: Marks) -> bool:
    """Return whether both ANEES are known and not above their chance ranges: no error is larger than claimed."""
    known = [(m.anees, m.bounds) for m in (before, after) if m.anees is not None and m.bounds is not None]
    return len(known) == 2 and all(anees <= high for anees, (_, high) in known)


def worsens_smoothed(before: Marks, after: Marks) -> bool:
    """Return whether a smoothed path gets worse: its errors, since no fix is about its covariance.

    One whose errors stay within what it claims may lose by chance.
    """
    allowed = MAX_SMOOTHED_LOSS if within_claim(before, after) else MAX_LOSS
    return worsens(before._replace(anees=None), after._replace(anees=None), allowed)


def _only_underconfident(before: Marks, after: Marks) -> bool:
    """Return whether only the claimed uncertainty grows and the error does not: that does no harm."""
    if before.position is None or after.position is None or after.lost > before.lost + MAX_LOST_SHARE:
        return False
    small = after.position <= before.position * (1.0 + MAX_CHANCE_LOSS) + MAX_LOSS_M
    return small and after.anees is not None and after.anees < 1.0


def worsens_far(before: Marks, after: Marks) -> bool:
    """Return whether a configuration gets worse by far more than chance explains."""
    if after.lost > before.lost + MAX_LOST_SHARE:
        return True
    if before.position is not None:
        return after.position is None or after.position > (1.0 + MAX_RUIN) * before.position
    if before.prediction is not None:
        return after.prediction is None or after.prediction < before.prediction - MAX_RUIN_NATS
    return False


def was_chance(before: Marks, after: Marks) -> bool:
    """Return whether the smaller error before the fix was chance: only the run before was inconsistent."""
    if before.position is None or not after.anees:
        return False
    return _off(before) > MIN_LN_ANEES_GAIN and _off(after) == 0.0


def leaves(before: Marks, after: Marks) -> bool:
    """Return whether an ANEES leaves its chance range."""
    return before.bounds is not None and _off(before) == 0.0 and _off(after) > MAX_LN_ANEES_LOSS


def improves(before: Marks, after: Marks) -> bool:
    """Return whether one figure gets notably better. An ANEES within its chance range has nothing to gain."""
    if before.lost - after.lost > MAX_LOST_SHARE:
        return True
    if before.position is not None and after.position is not None:
        less = before.position - after.position
        if less > max(MIN_GAIN * before.position, MIN_GAIN_M) or (less >= 0.0 and _turned(before, after) > 0.0):
            return True
        if turns_right(before, after) and less >= -MAX_CHANCE_LOSS * before.position:
            return True
        nearer = _off(before) - _off(after)
        # and outweighs an error that grows: 220 and 176 are both far off
        return nearer > MIN_LN_ANEES_GAIN and gain(before, after) > WEIGHT_OF_ANEES * MIN_LN_ANEES_GAIN - 1e-9
    if before.prediction is not None and after.prediction is not None:
        return after.prediction - before.prediction > MIN_GAIN_NATS
    return False


def settles(before: Marks, after: Marks) -> bool:
    """Return whether a configuration's error falls to less than half: more than chance on one drive."""
    if before.position is None or after.position is None:
        return False
    return after.position < MAX_SETTLED_SHARE * before.position and not worsens(before, after)


def gain(before: Marks, after: Marks) -> float:
    """Return the worth of a fix: ln(error before / after) of position, plus half of heading's and of ANEES'."""
    if before.position is not None and after.position is not None:
        turned = WEIGHT_OF_HEADING * _turned(before, after)
        return (
            _less(before, after)
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


def _less(before: Marks, after: Marks) -> float:
    """Return ln of how many times smaller the position error gets."""
    if before.position is None or after.position is None:
        return 0.0
    return math.log(max(before.position, MIN_GAIN_M) / max(after.position, MIN_GAIN_M))


def _off(score: Marks) -> float:
    """Return how far ln ANEES lies outside its chance range, 0 inside it or where there is none.

    Inside, one drive cannot tell one ANEES from another: 0.73 before and 0.47 after are no loss.
    """
    if not score.anees:
        return 0.0
    low, high = score.bounds or (1.0, 1.0)
    return max(0.0, math.log(score.anees / high), math.log(low / score.anees))


MAX_FIXES = 6  # of one log
MAX_MOVES = 2  # of a value by one finding; a third one must be smaller than MAX_MOVED_SHARE
MAX_MOVED_SHARE = 0.5  # of the largest change of a value, by which measuring it again may move it on
# findings that are measured again, better, once others are fixed
REFINED = ("lag", "mount", "way", "biased", "understated", "overstated")
# findings whose first value is the one that was measured: others beside it are tried only where it does not help
FIRST_VALUE = ("lag",)
CLEAR = 1.0  # worth of a fix beyond which nothing of a later class is likely to explain the same
CHANCE = 2.0 * math.log(1.0 + MAX_CHANCE_LOSS)  # worth that two configurations may gain or lose by chance

Fixes = tuple[str, ...]  # "table.key=value"
Scores = Mapping[str, Marks]  # by configuration
Try = Callable[[Fixes, Sequence[str]], Scores]  # settings, configurations -> their scores


class Candidate(msgspec.Struct, frozen=True):
    """A finding, the ways to fix it, and the configurations by which they are judged."""

    finding: Finding
    alternatives: tuple[Fixes, ...]
    judges: tuple[str, ...]
    minor: tuple[str, ...] = ()  # of these, by which a gain shows and a little more error is no harm
    others: tuple[str, ...] = ()  # of these, which no fix may ruin: what moves the wheels moves them too
    offer: bool = False  # no observation, only a setting that may help: silent where it does not
    measured: bool = False  # the drive shows the value: without truth and by shape it is taken if nothing is lost
    proven: bool = False  # several others agree on the value: it is taken if nothing is lost, with truth too
    guards: tuple[str, ...] = ()  # configurations whose ANEES may not leave its chance range: of noise
    by_shape: bool = False  # may be judged by the path's shape: where its map lies is not observed

    @property
    def key(self) -> tuple[str, str]:
        """Role and code of the finding."""
        return self.finding.role, self.finding.code


class Advice(msgspec.Struct, frozen=True):
    """A finding with the fix that was tried, and what it did; no fixes where none of them helps."""

    finding: Finding
    fixes: Fixes = ()
    before: Mapping[str, Marks] | None = None
    after: Mapping[str, Marks] | None = None
    tried: tuple[Fixes, ...] = ()  # every alternative that was tried
    harmless: bool = False  # one of what was tried changes little; else all of it makes something worse
    candidate: Candidate | None = None  # what it came from

    @property
    def judges(self) -> tuple[str, ...]:
        """The configurations by which the fix is judged, as in the candidate."""
        return () if self.candidate is None else self.candidate.judges

    @property
    def measured(self) -> bool:
        """Whether the drive shows the fix's value, as in the candidate."""
        return self.candidate is not None and self.candidate.measured

    @property
    def proven(self) -> bool:
        """Whether several other logs agree on the fix's value, as in the candidate."""
        return self.candidate is not None and self.candidate.proven

    @property
    def helps(self) -> bool:
        """Whether the fix was tried and found to help."""
        return bool(self.fixes)

    @property
    def shown_by(self) -> str | None:
        """The configuration that gains most by the fix."""
        if not self.before or not self.after:
            return None
        before, after = self.before, self.after
        return max((name for name in before if name in after), key=lambda name: gain(before[name], after[name]))


def together(one: Fixes, other: Fixes) -> Fixes:
    """Return two sets of settings merged; where both set a key, the second one wins."""
    return tuple(f"{key}={value}" for key, value in by_key((*one, *other)).items())


def keys(fixes: Iterable[str]) -> set[str]:
    """Return the keys that fixes set."""
    return set(by_key(fixes))


def by_key(fixes: Iterable[str]) -> dict[str, str]:
    """Return the values that fixes set, by key; of several fixes with one key, the last one counts."""
    return dict(fix.partition("=")[::2] for fix in fixes)


class Case(Protocol):
    """A log under some settings, with the methods that the loop of `tried` calls."""

    def suspicious(self) -> bool:
        """Return whether anything looks wrong; if not, no fix is tried."""

    def classes(self) -> Sequence[Sequence[Callable[[], Sequence[Candidate]]]]:
        """Return possible faults by class of evidence: a fault of an earlier class may look like a later one.

        Where something severe of a group is open, those of later groups are not asked.
        """

    def kept(self, role: str) -> Collection[str]:
        """Return the configurations that a user of a sensor would keep."""


Now = Callable[[str], float | None]
Look = Callable[[Fixes], Case | None]  # measures and fuses a log under settings; None: it cannot be


def tried(look: Look, trial: Try, now: Now = lambda key: None) -> tuple[list[Advice], Fixes]:
    """Try fixes, take the best one of the first class that has one, measure again, repeat; helpful ones first.

    `now` returns the number that a key has as configured. A value that moves on when it is measured again under
    itself is none: something else is wrong.
    """
    helped: list[Advice] = []
    open_: dict[str, Advice] = {}
    kept: Fixes = ()
    rests: set[tuple[str, str]] = set()  # what is measured off again under its own fix, and no value helps
    case = look(kept)
    while case is not None and len(helped) < MAX_FIXES:
        rests = set()
        if not case.suspicious():
            open_ = {}  # what had no fix looked wrong only beside what now has one
            break
        done = {(a.finding.role, a.finding.code) for a in helped}
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
            kept = ()
            for advice in helped:
                kept = together(kept, advice.fixes)
            break
        helped += new
        for advice in new:
            kept = together(kept, advice.fixes)
        case = look(kept)
    names = {a.finding.role for a in helped}
    helped = [_with_rest(a) if _key(a) in rests else a for a in helped]
    return [*helped, *(a for role, a in open_.items() if a.finding.severe or role not in names)], kept


def _key(advice: Advice) -> tuple[str, str]:
    return advice.finding.role, advice.finding.code


def _moves_on(advice: Advice, helped: Sequence[Advice], now: Now) -> bool:
    """Return whether a fix moves a number again, after several moves, by more than half of the largest one.

    A second move may be large: under a late clock half of the scans were refused, and the rest showed too little.
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
    return replace(advice, finding=finding, fixes=(), before=None, after=None)


def _first_that_helps(case: Case, kept: Fixes, trial: Try, done: Collection[tuple[str, str]]) -> list[Advice]:
    """Return the best fix of the first class of evidence that has one; else all findings, without fixes.

    A fix that only its own success speaks for, and that gains little, waits for the later classes: the best is
    taken.
    """
    open_: list[Advice] = []
    best: Advice | None = None
    last = 0
    for group, candidates_of in ((i, one) for i, several in enumerate(case.classes()) for one in several):
        if group != last and any(a.finding.severe for a in open_):
            break  # while this is open, nothing is said of offsets and noise
        last = group
        candidates = [c for c in candidates_of() if c.key not in done or c.finding.code in REFINED]
        results = [(c, best_of(c, kept, trial)) for c in candidates]
        helpful = [a for _, a in results if a.helps]
        if helpful:
            first = max(helpful, key=lambda a: _rank(a, helpful))
            best = first if best is None or _weight(first) > _weight(best) else best
            observed = any(not c.offer for c, a in results if a is first)
            if observed or worth(best) > CLEAR:
                break
        open_ += (a for c, a in results if not a.helps and not c.offer)
    if best is not None:
        return [*(a for a in open_ if a.finding.severe), best]
    first_of: dict[str, Advice] = {}  # one finding for each sensor at a time
    for advice in open_:
        first_of.setdefault(advice.finding.role, advice)
    return list(first_of.values())


def _weight(advice: Advice) -> float:
    """Return the weight of a fix when it competes with a fix of a later class for the same error.

    A clock that is measured to be off and noise that would hide it: chance alone may make noise look better.
    """
    return worth(advice) + (CHANCE if advice.measured else 0.0)


def _beside_another(
    found: Sequence[Advice], kept: Fixes, look: Look, trial: Try, done: Collection[tuple[str, str]]
) -> list[Advice]:
    """Return a severe finding's fix together with a second fix, where only both together help.

    Two faults may hide each other: a compass that is refused because it is late does not disturb a laser whose
    noise is set too high, and disturbs it as soon as it is used.
    """
    for advice in found:
        for fixes in advice.tried if advice.finding.severe else ():
            beside = together(kept, fixes)
            if not any(improves(*pair) for pair in scored(kept, beside, advice.judges, trial).values()):
                continue
            case = look(beside)
            if case is None:
                continue
            now = {*done, (advice.finding.role, advice.finding.code)}
            others = [a for a in _first_that_helps(case, beside, trial, now) if a.helps]
            both = beside
            for other in others:
                both = together(both, other.fixes)
            pairs = scored(kept, both, advice.judges, trial)
            if others and pairs and not _any_worsened(pairs, case.kept(advice.finding.role)):
                before, after = ({name: pair[i] for name, pair in pairs.items()} for i in (0, 1))
                return [replace(advice, fixes=fixes, before=before, after=after), *others]
    return []


def _any_worsened(pairs: Mapping[str, tuple[Marks, Marks]], kept: Collection[str]) -> bool:
    """Return whether a configuration gets worse; one that no user would keep may get worse by chance."""
    return any((worsens if name in kept else worsens_alone)(*pair) for name, pair in pairs.items())


def scored(kept: Fixes, fixes: Fixes, judges: Sequence[str], trial: Try) -> dict[str, tuple[Marks, Marks]]:
    """Return the scores of configurations under two sets of fixes; {} where one has none."""
    before, after = trial(kept, judges), trial(fixes, judges)
    return {name: (before[name], after[name]) for name in before} if before and after else {}


def worth(advice: Advice) -> float:
    """Return the sum of the gains of all configurations that judged it."""
    if advice.before is None or advice.after is None:
        return 0.0
    return sum(gain(advice.before[name], advice.after[name]) for name in advice.before)


def _rank(advice: Advice, rivals: Sequence[Advice]) -> float:
    """Return a fix's rank for sorting.

    Without truth a sensor that is moved to where a wrong one is predicts that one better: two sensors that
    disagree accuse each other. So only configurations that judged all of them are counted, where there are any.
    """
    if (
        advice.before is None
        or advice.after is None
        or any(s.position is not None for s in advice.before.values())
    ):
        return worth(advice)
    shared = [name for name in advice.before if all(name in (a.before or {}) for a in rivals)]
    return sum(gain(advice.before[name], advice.after[name]) for name in shared) or worth(advice)


def best_of(candidate: Candidate, kept: Fixes, trial: Try) -> Advice:
    """Return the alternative that gains most of those that help, by position, else by the path's shape."""
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
        if options and candidate.measured and candidate.finding.code in FIRST_VALUE:
            break
        pairs = judged_pairs(candidate, kept, fixes, trial, shape)
        harmless = harmless or bool(pairs)
        # by the drive itself: not to lose is enough, but then in every configuration, kept or not
        sure = (candidate.proven or _by_prediction(pairs)) and not _any_loses(pairs)
        shown = candidate.measured and bool(pairs) and (shape or sure)
        if shown or any(improves(*pair) for pair in pairs.values()):
            before = {name: pair[0] for name, pair in pairs.items()}
            after = {name: pair[1] for name, pair in pairs.items()}
            advice = replace(unfixed, fixes=fixes, before=before, after=after)
            if any(
                leaves(*pair) for pair in scored(kept, together(kept, fixes), candidate.guards, trial).values()
            ):
                continue
            options += [advice] if (shown and not shape) or worth(advice) > 0.0 else []
    return max(options, key=worth, default=replace(unfixed, harmless=harmless))


def _by_prediction(pairs: Mapping[str, tuple[Marks, Marks]]) -> bool:
    return all(before.position is None for before, _ in pairs.values())


def _any_loses(pairs: Mapping[str, tuple[Marks, Marks]]) -> bool:
    return any(worsens(*pair) for pair in pairs.values())


def judged_pairs(
    candidate: Candidate, kept: Fixes, fixes: Fixes, trial: Try, shape: bool = False
) -> dict[str, tuple[Marks, Marks]]:
    """Return every judge's scores before and after a fix; stop with {} at the first that gets worse."""
    pairs: dict[str, tuple[Marks, Marks]] = {}
    settled = chance_alone = False
    for name in candidate.judges:
        before, after = trial(kept, (name,)), trial(together(kept, fixes), (name,))
        if name not in before or name not in after:
            return {}
        if shape:
            before, after = ({name: scores[name].of_shape()} for scores in (before, after))
        one, other = readable(before[name], after[name])
        # what takes one configuration's error to less than half is right: another one's may lose what chance does
        right = candidate.measured and turns_right(one, other)
        chance = name in candidate.minor or settled or right
        worse = worsens_far if name in candidate.others else worsens_alone if chance else worsens
        if worse(one, other):
            if name not in candidate.minor or not was_chance(one, other):
                return {}
            chance_alone = True  # which excuses nothing unless the fix is right
        pairs[name] = one, other
        observed = candidate.measured or not candidate.offer
        settled = settled or (observed and settles(one, other))
    return {} if chance_alone and not settled else pairs
