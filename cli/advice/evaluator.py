"""The evaluation of one log: findings, the fix tried for each, and the effect of this fix.

`run`, `compare`, `info --check`, the report and Rerun show exactly these findings. `fusion.checks.tried` has the
loop over findings and fixes. In a long drive, fixes are tried on its beginning; fixes that help are then tried on
the whole drive.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from functools import partial

from msgspec.structs import replace

from locfuse.cli.analysis.compare import Compared, compare_log
from locfuse.cli.analysis.configurations import Configuration, for_comparison
from locfuse.cli.analysis.load import Loaded, unbroken, with_settings
from locfuse.cli.analysis.results import settings_tables
from locfuse.cli.analysis.robot_tables import flat
from locfuse.cli.analysis.settings import Asked, Progress, silent
from locfuse.formats.report.findings import change, options
from locfuse.fusion.checks.examine import MIXED, holes, too_short
from locfuse.fusion.checks.finding import Finding
from locfuse.fusion.checks.tried import (
    Advice,
    Candidate,
    Fixes,
    Marks,
    by_key,
    improves,
    judged_pairs,
    keys,
    settles,
    together,
    tried,
    worsens_smoothed,
)
from locfuse.fusion.checks.turning import turnings
from locfuse.fusion.data import LocfuseError
from locfuse.fusion.robot import Robot

from .evidence import Evidence
from .judged import SHARED_ROLES
from .report import Advised, data_advice
from .trial import SMOOTHED, WHOLE, Trial, marks_of

MAX_AGREEMENT_LOSS = 0.1  # largest accepted loss of agreement at revisited places; equally good paths differ less
UNIT_KEYS = {"gyro.unit"}  # keys of fixes that other faults, such as mirrored wheels, do not explain
MAX_WHOLE = 2  # severe findings whose fix did not help on the beginning: so many are tried on the whole drive


def standard(loaded: Loaded) -> list[Configuration]:
    """Return the configurations that judge a log in every command: odometry, each sensor alone, and all."""
    return for_comparison([], loaded.drive)


def advise(loaded: Loaded, progress: Progress, align: str, compared: Compared | None = None) -> Advised:
    """Return all findings on a log with their tried fixes; runs of a finished run or comparison are used again."""
    loaded, broken = unbroken(loaded)  # fixes are tried on the longest part without a hole
    of_holes, unusable = [Advice(hole) for hole in broken], data_advice(loaded)
    if not may_judge(loaded) or any(a.finding.code in MIXED for a in unusable):
        return Advised((*unusable, *of_holes))
    trial = Trial(loaded, {c.name: c for c in standard(loaded)}, align, progress)
    first = None if compared is None or broken else _known(compared, trial)

    def look(fixes: Fixes) -> Evidence | None:
        loaded = trial.under(fixes)
        if loaded is None:
            return None
        trial.keep(fixes)
        compared = first
        if compared is None or fixes:
            known = trial.complete(fixes)
            trial.fusions += len(trial.configurations) - len(known)
            how = Asked(align=align, smooth=False)
            several = [*trial.configurations.values()]
            compared = compare_log(loaded, several, how, progress, known=known)
        trial.seed(fixes, compared)
        return Evidence(compared, trial, fixes)

    found, kept = tried(look, trial, partial(number, trial.whole.robot))
    if trial.loaded is not trial.whole:
        found, kept = on_the_whole_drive(found, trial)
    if kept and _harm_to_path_or_map(found, (), kept, list(trial.configurations), trial):
        found, kept = on_the_whole_drive(found, trial, afterwards=True)
    found = without_repeated(found, kept, trial.whole.robot)
    empty, helped = {a.finding.role for a in unusable}, {a.finding.role for a in found if a.helps}
    found = [a for a in found if a.helps or a.finding.role not in empty]
    others = (a for a in unusable if a.finding.role not in helped)
    return Advised((*found, *_made_readable(loaded), *others, *of_holes), trial.fusions)


def _made_readable(loaded: Loaded) -> list[Advice]:
    """Return the fixes of sensors that cannot be measured as configured, but turn as the wheels do with the fix.

    No configuration of this log has such a sensor, so no run can judge them.
    """
    found = []
    for name, fixes in loaded.drive.fixes.items():
        with suppress(LocfuseError):
            turned = turnings(with_settings(loaded, fixes).drive).get(name) if UNIT_KEYS & keys(fixes) else None
            if turned is not None and turned.b < 0.0 < turned.a:
                why = loaded.drive.absent[name].removesuffix(options(fixes)).rstrip(" :").replace("; ", ": ")
                found.append(Advice(Finding(name, "unusable", why), fixes))
    return found


def advise_on_run(one: Compared, progress: Progress, align: str) -> Advised:
    """Return the advice after a run of one configuration; fixes are tried only if this run looks wrong."""
    if looks_wrong(one):
        return advise(one.loaded, progress, align, one)
    return Advised(data_advice(unbroken(one.loaded)[0]))


def _known(compared: Compared, trial: Trial) -> Compared | None:
    """Store the figures of a finished comparison, and return it with only the standard configurations.

    Returns None if the comparison lacks a standard configuration, or if fixes are tried on part of the drive.
    """
    drive = compared.loaded.drive
    known = trial.configurations
    seen = {e.name: (replace(e, audits={}), judged) for e, judged in compared.plain.values() if e.name in known}
    for e, judged in zip(compared.estimates, compared.evaluations, strict=True):
        if e.smoothed and not e.rates and e.configuration in known:
            trial.know(SMOOTHED, (), e.configuration, marks_of(e, judged, drive))
    if trial.loaded is not trial.whole:
        marks = {n: Marks(prediction=density) for n, density in compared.densities.items()}
        marks |= {n: marks_of(*run, drive) for n, run in seen.items() if drive.truth is not None}
        for name, found in marks.items():
            trial.know(WHOLE, (), name, found)
        return None
    if not set(trial.configurations) <= set(seen):
        return None
    runs = {run.estimates.name: run for run in compared.runs}
    estimates, evaluations = zip(*(seen[name] for name in trial.configurations), strict=True)
    return replace(
        compared,
        configurations=list(trial.configurations.values()),
        estimates=estimates,
        evaluations=evaluations,
        runs=[runs[name] for name in trial.configurations if name in runs],
        credit=None,
    )


def _harm_to_path_or_map(
    found: Sequence[Advice], before: Fixes, after: Fixes, names: Sequence[str], trial: Trial
) -> str:
    """Return in words how fixes that help the filter harm the smoothed path or the map; "" if they do not.

    With truth the smoothed path's error is compared. Without truth it is the agreement of scans at revisited
    places: a fix may improve predictions of other sensors by the laser, and still damage the map.
    """
    if lost := smoothed_worse(found, before, after, names, trial):
        return f"makes the smoothed path worse ({change(*lost)})"
    first, last = trial.agreement(before), trial.agreement(after)
    if first is None or last is None or last > first - MAX_AGREEMENT_LOSS:
        return ""
    return f"lets places seen twice fit worse ({first:.0%} -> {last:.0%})"


def smoothed_worse(
    found: Sequence[Advice], before: Fixes, after: Fixes, names: Sequence[str], trial: Trial
) -> tuple[float, float] | None:
    """Return the errors [m] (before, after) of the first smoothed path that fixes make worse; None without one.

    If a fix in `found` was judged after alignment, smoothed paths are judged after alignment too.
    """
    first = trial.smoothed(before, names)
    last = trial.smoothed(after, [*first]) if first else {}
    pairs = [(first[name], last[name]) for name in last]
    if any(score.aligned for advice in found for score, _ in advice.pairs.values()):
        pairs = [(b.of_shape(), a.of_shape()) for b, a in pairs]
    settled = all(any(settles(*pair) for pair in advice.pairs.values()) for advice in found)
    lost = ((b.position, a.position) for b, a in pairs if worsens_smoothed(b, a, settled))
    return next(((b, a) for b, a in lost if b is not None and a is not None), None)


def on_the_whole_drive(
    found: Sequence[Advice], trial: Trial, afterwards: bool = False
) -> tuple[list[Advice], Fixes]:
    """Judge advice again on the whole drive; return the judged advice and the kept fixes.

    All configurations that use a finding's sensor judge its fix. The fix is dropped if one of them gets worse, or
    none gets better; with `afterwards` also if the smoothed path or the map gets worse. Severe findings whose fix
    did not help on the beginning are tried again, since slow errors appear later.
    """
    judged: list[Advice] = []
    kept: Fixes = ()
    more = 0 if trial.loaded is trial.whole else MAX_WHOLE
    for advice in found:
        fixes = advice.fixes
        if not fixes and more > 0 and advice.finding.severe and advice.tried:
            fixes, more = advice.tried[0], more - 1
        if not fixes:
            judged.append(advice)
            continue
        role = advice.finding.role
        names = [n for n, c in trial.configurations.items() if role in SHARED_ROLES or role in c.sensors]
        candidate = _judged_by_all(advice, names)
        pairs = judged_pairs(candidate, kept, fixes, trial.on_whole)
        if not pairs and candidate.by_shape:
            pairs = judged_pairs(candidate, kept, fixes, trial.on_whole, shape=True)
        worse = not pairs
        if worse or not (candidate.proven or any(improves(*pair) for pair in pairs.values())):
            judged.append(replace(advice, fixes=(), pairs={}, tried=(fixes,), harmless=not worse))
            continue
        lost = _harm_to_path_or_map([advice], kept, together(kept, fixes), names, trial) if afterwards else ""
        if lost:
            what = f"{' and '.join(fixes)} helps while driving and {lost}"
            finding = replace(advice.finding, message=f"{advice.finding.brief}. {what}", source="", hint="")
            judged.append(replace(advice, finding=finding, fixes=(), pairs={}, tried=()))
            continue
        judged.append(replace(advice, fixes=fixes, pairs=pairs))
        kept = together(kept, fixes)
    first: dict[str, Advice] = {}  # at most one finding without a fix per sensor
    for advice in judged:
        if not advice.helps:
            first.setdefault(advice.finding.role, advice)
    return [*(a for a in judged if a.helps), *first.values()], kept


def _judged_by_all(advice: Advice, names: Sequence[str]) -> Candidate:
    """Return the advice as a candidate judged by the configurations `names`; new judges become `minor` ones."""
    one = advice.candidate or Candidate(advice.finding, (advice.fixes,), tuple(names))
    kept = [n for n in one.judges if n not in one.minor]
    minor = tuple(n for n in names if n not in kept)
    return replace(one, judges=(*minor, *kept), minor=minor, others=())


def may_judge(loaded: Loaded) -> bool:
    """Return whether a log can be evaluated.

    This needs the default filter without a given map, a drive of sufficient length, and a sensor or a truth.
    """
    ours = loaded.robot.preset == "default" and not loaded.robot.lines
    judges = bool(loaded.drive.measurements) or loaded.drive.truth is not None
    return ours and judges and not too_short(loaded.drive)


def looks_wrong(one: Compared) -> bool:
    """Return whether one configuration's run shows anything suspicious, so that the log needs evaluation."""
    loaded = one.loaded
    if loaded.robot.lines or loaded.robot.preset != "default":
        return False
    one = replace(one, estimates=one.estimates[:1], evaluations=one.evaluations[:1])  # without the smoothed run
    trial = Trial(loaded, {c.name: c for c in one.configurations}, "none", silent)
    return bool(holes(loaded.drive)) or Evidence(one, trial, ()).suspicious()


def without_repeated(found: Sequence[Advice], kept: Fixes, robot: Robot) -> list[Advice]:
    """Return the advice without fixes that set the configured value again.

    Example: a time offset changed because of a wrong distance scale is changed back after the scale is fixed.
    """
    now = {key: number(robot, key) for key in keys(kept)}
    new = by_key(kept).items()
    same = {k for k, v in new if (old := now[k]) is not None and abs(float(v) - old) <= 5e-5}
    kept_fixes = [tuple(fix for fix in a.fixes if not keys((fix,)) & same) for a in found]
    return [replace(a, fixes=fixes) for a, fixes in zip(found, kept_fixes, strict=True) if fixes or not a.helps]


def number(robot: Robot, key: str) -> float | None:
    """Return the number configured at a key of robot.toml; None if the value is not a number."""
    now = flat(settings_tables(robot)).get(key)
    return None if isinstance(now, bool) or not isinstance(now, int | float) else float(now)
