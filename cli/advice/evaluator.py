"""The evaluator: one log -> findings, each with the fix that was tried and what it did.

`run`, `compare`, `tune`, `info --check`, the report and Rerun all show what this finds, and nothing else. It works
in rounds: what looks wrong is tried, what helps is kept, and the log is judged again under it, so that no sensor
is blamed for the fault of another.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence

from msgspec.structs import replace

from locfuse.cli.analysis.compare import Compared, Heard, Watch, compare_log
from locfuse.cli.analysis.configurations import Configuration, for_comparison
from locfuse.cli.analysis.load import Loaded
from locfuse.cli.analysis.settings import Asked, Progress, silent
from locfuse.fusion.checks.score import MAX_CHANCE_LOSS, Score, improves, spoils, spoils_alone
from locfuse.fusion.checks.search import Advice, Candidate, Fixes, search, together, total
from locfuse.fusion.data import Estimates
from locfuse.fusion.robot import Robot

from .advised import Advised
from .beginning import Beginning
from .evidence import Evidence
from .trial import Trial

MAX_ROUNDS = 4
# findings that are measured again, better, once others are fixed
REFINED = ("lag", "mount", "way", "biased", "understated", "overstated")
CLEAR = 1.0  # worth of fixes beyond which nothing of a later stage is likely to explain the same
CHANCE = 2.0 * math.log(1.0 + MAX_CHANCE_LOSS)  # worth that two configurations may gain or lose by chance
MIN_DURATION_S = 5.0  # s: a shorter drive judges no setting


def standard(loaded: Loaded) -> list[Configuration]:
    """Return the configurations by which every command judges a log, whichever it shows."""
    return for_comparison([], loaded.drive)


class Evaluator:
    """The evaluation of one log. Where a comparison of it is made anyway, it watches: see `takes` and `hears`."""

    def __init__(self, loaded: Loaded, progress: Progress, align: str = "none") -> None:
        self.trial = Trial(loaded, {c.name: c for c in standard(loaded)}, align, progress)
        self._watch = Beginning(self.trial)
        self._may_judge = _may_judge(loaded)

    @property
    def takes(self) -> list[Watch]:
        """What a comparison's finished runs are to be given to."""
        return [self._watch.take] if self._may_judge else []

    @property
    def hears(self) -> list[Heard]:
        """What runs that other sensors listen to are to be given to."""
        return [self._watch.hear] if self._may_judge else []

    def advised(self) -> Advised:
        """Return what is found, by what was watched; by a comparison of its own if that was not all it needs."""
        if not self._may_judge:
            return Advised()
        trial = self.trial
        first = self._watch.compared() or _compared((), trial.loaded, trial)
        found, kept = _rounds(first, trial)
        found = changing(found, kept, trial.loaded.robot)
        until = None if trial.loaded is trial.whole else float(trial.loaded.drive.t[-1])
        return Advised(tuple(found), until, trial.fusions) if found or kept else Advised()


def _may_judge(loaded: Loaded) -> bool:
    """Return whether a log can be evaluated: with a given map, and by the print's filter, nothing is tried."""
    if loaded.robot.lines or loaded.robot.preset != "default":
        return False
    if not loaded.drive.measurements and loaded.drive.truth is None:
        return False
    return float(loaded.drive.t[-1]) - float(loaded.drive.t[0]) >= MIN_DURATION_S


def looks_wrong(loaded: Loaded, one: Compared) -> bool:
    """Return whether a single configuration's run gives reason to evaluate the log."""
    if loaded.robot.lines or loaded.robot.preset != "default":
        return False
    trial = Trial(loaded, {c.name: c for c in one.configurations}, "none", silent)
    return Evidence(one, trial, ()).suspicious()


def _compared(fixes: Fixes, loaded: Loaded, trial: Trial) -> Compared:
    configurations = list(trial.configurations.values())
    trial.fusions += len(configurations)

    def hear(e: Estimates) -> None:
        trial.heard(fixes, loaded, e)

    asked = Asked(align=trial.align, audits=False)
    return compare_log(loaded, configurations, asked, trial.progress, heard=[hear])


def _rounds(compared: Compared, trial: Trial) -> tuple[list[Advice], Fixes]:
    """Try, keep, look again; clocks before geometry, geometry before offsets, offsets before noise."""
    helped: list[Advice] = []
    without: dict[str, Advice] = {}
    kept: Fixes = ()
    for _ in range(MAX_ROUNDS):
        trial.seed(kept, compared)
        evidence = Evidence(compared, trial, kept)
        if not evidence.suspicious():
            without = {}  # what had no fix looked wrong only beside what now has one
            break
        found = _first_that_helps(evidence, kept, trial, done={(a.finding.role, a.finding.code) for a in helped})
        without = {a.finding.role: a for a in found if not a.helps}
        new = [a for a in found if a.helps] or _beside_another(found, kept, trial)
        if not new:
            break
        helped += new
        for advice in new:
            kept = together(kept, advice.fixes)
        loaded = trial.under(kept)
        if loaded is None:
            break
        compared = _compared(kept, loaded, trial)
    names = {a.finding.role for a in helped}
    return [*helped, *(a for role, a in without.items() if a.finding.severe or role not in names)], kept


def _beside_another(found: Sequence[Advice], kept: Fixes, trial: Trial) -> list[Advice]:
    """Return a severe finding's fix with what else is wrong once it is set, where only both together help.

    Two faults may hide each other: a compass that is refused because it is late does not disturb a laser whose
    noise is set too high, and disturbs it as soon as it is used.
    """
    for advice in found:
        for fixes in advice.tried if advice.finding.severe else ():
            beside = together(kept, fixes)
            loaded = trial.under(beside)
            if loaded is None:
                continue
            evidence = Evidence(_compared(beside, loaded, trial), trial, beside)
            trial.seed(beside, evidence.compared)
            judges = evidence.judges(advice.finding.role)
            if not any(improves(*pair) for pair in _pairs(kept, beside, judges, trial).values()):
                continue
            done = {(advice.finding.role, advice.finding.code)}
            others = [a for a in _first_that_helps(evidence, beside, trial, done) if a.helps]
            both = beside
            for other in others:
                both = together(both, other.fixes)
            pairs = _pairs(kept, both, judges, trial)
            if others and pairs and not _any_spoiled(pairs, evidence.kept(advice.finding.role)):
                before, after = ({name: pair[i] for name, pair in pairs.items()} for i in (0, 1))
                return [replace(advice, fixes=fixes, before=before, after=after), *others]
    return []


def _any_spoiled(pairs: Mapping[str, tuple[Score, Score]], kept: Collection[str]) -> bool:
    """Return whether a configuration gets worse; one that nobody would keep may by what chance does."""
    return any((spoils if name in kept else spoils_alone)(*pair) for name, pair in pairs.items())


def _pairs(kept: Fixes, fixes: Fixes, judges: Sequence[str], trial: Trial) -> dict[str, tuple[Score, Score]]:
    """Return the scores of configurations under two sets of fixes; {} where one has none."""
    before, after = trial(kept, judges), trial(fixes, judges)
    return {name: (before[name], after[name]) for name in before} if before and after else {}


def _first_that_helps(evidence: Evidence, kept: Fixes, trial: Trial, done: set[tuple[str, str]]) -> list[Advice]:
    """Return the advice of the first stage of evidence in which anything helps; else all that has no fix."""
    stages: Sequence[Callable[[], list[Candidate]]] = (
        evidence.clocks,
        evidence.geometry,
        evidence.offsets,
        evidence.slips,
        evidence.noise,
        evidence.unexplained,
    )
    failed: list[Advice] = []
    best: list[Advice] = []
    for stage in stages:
        candidates = [c for c in stage() if c.key not in done or c.finding.code in REFINED]
        found = search(candidates, kept, trial)
        best = max(best, found, key=_weight)
        observed = {c.key for c in candidates if not c.offer}
        if stage == evidence.slips and any(a.helps for a in found):
            break
        if total(best) > CLEAR or any(a.helps and (a.finding.role, a.finding.code) in observed for a in found):
            break
        failed += (a for a in found if not a.helps)
        if any(a.finding.severe for a in found):
            break  # while this is open, nothing is said of offsets and noise
    if any(a.helps for a in best):
        return [*(a for a in failed if a.finding.severe and not a.helps), *best]
    return _one_each(failed)


def _weight(found: Sequence[Advice]) -> float:
    """Return what a stage's fixes are worth beside a later one's, which explains the same in another way.

    A clock that is measured to be off and noise that would hide it: chance alone may make noise look better.
    """
    measured = any(a.helps and a.measured for a in found)
    return total(found) + (CHANCE if measured else 0.0)


def changing(found: Sequence[Advice], kept: Fixes, robot: Robot) -> list[Advice]:
    """Return advice without fixes that set, in the end, what is configured already.

    A clock that was moved because another sensor's distances were wrong is moved back once these are right.
    """
    last = dict(fix.partition("=")[::2] for fix in kept)
    same = {key for key, value in last.items() if _is_configured(key, value, robot)}
    kept_fixes = [tuple(fix for fix in a.fixes if fix.partition("=")[0] not in same) for a in found]
    return [replace(a, fixes=fixes) for a, fixes in zip(found, kept_fixes, strict=True) if fixes or not a.helps]


def _is_configured(key: str, value: str, robot: Robot) -> bool:
    """Return whether a setting has this value, as near as it is written."""
    table, _, name = key.partition(".")
    settings = getattr(robot, table, None) if table in ("wheels", "start", "truth") else robot.settings(table)
    now = getattr(settings, name, None)
    try:
        return now is not None and not isinstance(now, bool) and math.isclose(float(value), now, abs_tol=5e-5)
    except (TypeError, ValueError):
        return False


def _one_each(found: Sequence[Advice]) -> list[Advice]:
    """Return the first of every role: a sensor is told one thing at a time."""
    first: dict[str, Advice] = {}
    for advice in found:
        first.setdefault(advice.finding.role, advice)
    return list(first.values())
