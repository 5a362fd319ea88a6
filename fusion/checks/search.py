"""Trying fixes: which of them help, which help together, and which is worth most.

Fixes are tried one after the other on top of those that were kept, the most valuable first. What helped alone
and no longer helps beside a better one is dropped: a late laser makes the compass look wrong, until the laser's
clock is set. A fix is kept if no configuration gets worse by it and one gets better (`score`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import msgspec

from .finding import Finding
from .score import Score, gain, improves, ruins, settles, spoils, spoils_alone, was_chance

Fixes = tuple[str, ...]  # "table.key=value"
Scores = Mapping[str, Score]  # by configuration
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
    rivals: tuple[str, ...] = ()  # roles whose fixes explain the same: beside one of them, look again first
    by_shape: bool = False  # may be judged by the path's shape: nobody observes where its map lies, that is chance

    @property
    def key(self) -> tuple[str, str]:
        """Role and code of the finding."""
        return self.finding.role, self.finding.code


class Advice(msgspec.Struct, frozen=True):
    """A finding with the fix that was tried, and what it did; no fixes where none of them helps."""

    finding: Finding
    fixes: Fixes = ()
    before: Mapping[str, Score] | None = None
    after: Mapping[str, Score] | None = None
    tried: tuple[Fixes, ...] = ()  # every alternative that was tried
    measured: bool = False  # as the candidate's
    harmless: bool = False  # one of what was tried changes little; else all of it makes something worse

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
    """Return both, the other's value where both set a key."""
    keys = {fix.partition("=")[0]: fix for fix in (*one, *other)}
    return tuple(keys.values())


def search(candidates: Sequence[Candidate], kept: Fixes, trial: Try) -> list[Advice]:
    """Return advice on every candidate, what helps first and in the order in which it was found to help."""
    left = list(candidates)
    found: list[Advice] = []
    while left:
        tried = [(c, _best(c, kept, trial)) for c in left]
        helpful = [(c, advice) for c, advice in tried if advice.helps]
        if not helpful:
            return [*found, *(advice for c, advice in tried if not c.offer)]
        best, advice = max(helpful, key=lambda pair: _rank(pair[1], [a for _, a in helpful]))
        found.append(advice)
        kept = together(kept, advice.fixes)
        # what did not help is tried again only beside what did: a second fault may have hidden it
        left = [c for c in left if c is not best and not _explains_the_same(c, best)]
    return found


def _explains_the_same(one: Candidate, other: Candidate) -> bool:
    roles = one.finding.role, other.finding.role
    return roles[0] == roles[1] or roles[0] in other.rivals or roles[1] in one.rivals


def worth(advice: Advice) -> float:
    """Return the sum of the gains of all configurations that judged it."""
    if advice.before is None or advice.after is None:
        return 0.0
    return sum(gain(advice.before[name], advice.after[name]) for name in advice.before)


def _rank(advice: Advice, rivals: Sequence[Advice]) -> float:
    """Return what a fix is worth beside others.

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


def total(found: Sequence[Advice]) -> float:
    """Return what all fixes that help are worth together."""
    return sum(worth(advice) for advice in found if advice.helps)


def _best(candidate: Candidate, kept: Fixes, trial: Try) -> Advice:
    """Return the alternative that gains most of those that help, by position, else by the path's shape."""
    found = _best_by(candidate, kept, trial, False)
    if found.helps or not candidate.by_shape:
        return found
    by_shape = _best_by(candidate, kept, trial, True)
    return by_shape if by_shape.helps else found


def _best_by(candidate: Candidate, kept: Fixes, trial: Try, shape: bool) -> Advice:
    options, harmless = [], False
    for fixes in candidate.alternatives:
        pairs = _pairs(candidate, kept, fixes, trial, shape)
        harmless = harmless or bool(pairs)
        # by the drive itself: not to lose is enough, but then in every configuration, also those that nobody keeps
        shown = candidate.measured and bool(pairs) and (shape or (_by_prediction(pairs) and not _any_loses(pairs)))
        if shown or any(improves(*pair) for pair in pairs.values()):
            before = {name: pair[0] for name, pair in pairs.items()}
            after = {name: pair[1] for name, pair in pairs.items()}
            advice = Advice(candidate.finding, fixes, before, after, candidate.alternatives, candidate.measured)
            options += [advice] if (shown and not shape) or worth(advice) > 0.0 else []
    return max(
        options, key=worth, default=Advice(candidate.finding, tried=candidate.alternatives, harmless=harmless)
    )


def _by_prediction(pairs: Mapping[str, tuple[Score, Score]]) -> bool:
    return all(before.position is None for before, _ in pairs.values())


def _any_loses(pairs: Mapping[str, tuple[Score, Score]]) -> bool:
    return any(spoils(*pair) for pair in pairs.values())


def _pairs(
    candidate: Candidate, kept: Fixes, fixes: Fixes, trial: Try, shape: bool
) -> dict[str, tuple[Score, Score]]:
    """Return every judge's score before and after; {} as soon as one gets worse, since each is a run."""
    pairs: dict[str, tuple[Score, Score]] = {}
    settled = False
    for name in candidate.judges:
        before, after = trial(kept, (name,)), trial(together(kept, fixes), (name,))
        if name not in before or name not in after:
            return {}
        if shape:
            before, after = ({name: scores[name].of_shape()} for scores in (before, after))
        # what takes one configuration's error to less than half is right: another one's may lose what chance does
        chance = name in candidate.minor or settled
        worse = ruins if name in candidate.others else spoils_alone if chance else spoils
        lucky = settled and name in candidate.minor and was_chance(before[name], after[name])
        if worse(before[name], after[name]) and not lucky:
            return {}
        pairs[name] = before[name], after[name]
        observed = candidate.measured or not candidate.offer
        settled = settled or (observed and settles(before[name], after[name]))
    return pairs
