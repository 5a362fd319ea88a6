"""Comparison of configurations on one measured log, judged by truth, else by a reference and by prediction.

Jitter (`--jitter N`): each configuration is fused N more times, each time on a slightly changed drive. A
difference of two figures is chance if it is smaller than their range over these runs. A verdict that changes its
direction in any run becomes "no effect seen".
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, cast, get_args

import msgspec
import numpy as np
from msgspec import field
from msgspec.structs import replace

from locfuse.formats.report import json_report
from locfuse.formats.report.findings import in_one_unit, length
from locfuse.fusion import se2
from locfuse.fusion.data import Drive, Estimates, Evaluation, RunningNis, result_name
from locfuse.fusion.fuse import configuration_name
from locfuse.fusion.judge.consistency import RunInnovations
from locfuse.fusion.judge.credit import Credit, credit
from locfuse.fusion.judge.evaluate import Align, evaluate, running_nis
from locfuse.fusion.judge.without_truth import (
    Score,
    contradictions,
    judged_by_scans,
    listeners,
    mean_density,
    scores,
)
from locfuse.fusion.measure import DROPPED_SHARE, MOVED_S, jittered
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY, needed

from . import results, verdicts
from .configurations import Configuration, fuser
from .load import Loaded
from .robot_tables import key
from .settings import Asked, Progress, one_of, silent
from .verdicts import ByReference

if TYPE_CHECKING:
    from locfuse.fusion.whole_drive.reference import Reference, References

OTHER_FRAME_M, OTHER_FRAME_RAD = 0.5, math.radians(20.0)  # difference of first poses from which on frames differ
PLAIN_FRAME = "none"  # no alignment: the covariance can be judged
JudgedRun = tuple[Estimates, Evaluation]


class Drawn:
    """The parts of the audits that figures show, collected after each run."""

    def __init__(self) -> None:
        self.nis: dict[tuple[str, str], RunningNis] = {}  # (configuration, sensor)
        self.best: Estimates | None = None  # of the run with the most sensors

    def take(self, e: Estimates) -> None:
        """Store the running NIS of a run, and its estimates if it has more sensors than all earlier runs."""
        self.nis |= {(e.name, s): running_nis(audit, e.t) for s, audit in e.audits.items()}
        if self.best is None or len(e.sensors) > len(self.best.sensors):
            self.best = e


class Compared(msgspec.Struct, frozen=True):
    """The results of one comparison of one log."""

    loaded: Loaded
    configurations: Sequence[Configuration]
    estimates: Sequence[Estimates]  # without audits, unless `Asked.audits`
    evaluations: Sequence[Evaluation]
    runs: Sequence[RunInnovations]  # residuals that show the sensors' noise
    credit: Credit | None = None  # with truth
    scores: Sequence[Score] = ()  # without truth
    densities: Mapping[str, float | None] = {}  # without truth: `mean_density` by configuration
    reference: Referenced | None = None  # without truth, if asked for
    # smoothed estimates by the name of the filtered ones; also those computed only for a reference
    smoothed: Mapping[str, Estimates] = {}
    drawn: Drawn = field(default_factory=Drawn)

    @property
    def sets(self) -> dict[str, tuple[str, ...]]:
        """The sensors of each configuration at the log's rates, by configuration name."""
        return {c.name: c.sensors for c in self.configurations if not c.rates}

    @property
    def base(self) -> str:
        """The configuration without a sensor: odometry, or scan matching if there are no wheels."""
        return configuration_name((), self.loaded.drive)

    @property
    def plain(self) -> dict[frozenset[str], JudgedRun]:
        """The filtered runs in which no sensor has a lower rate, by set of sensors."""
        pairs = zip(self.estimates, self.evaluations, strict=True)
        return {frozenset(e.sensors): (e, judged) for e, judged in pairs if e.name in self.sets}


class Referenced(msgspec.Struct, frozen=True):
    """References (smoothed solutions) that replace a missing truth, and the errors against them."""

    references: References
    judges: Mapping[str, Reference]  # by result
    effects: Mapping[str, ByReference]  # by sensor


def run_log(loaded: Loaded, c: Configuration, asked: Asked) -> Compared:
    """Run and judge one configuration: filtered estimates, then smoothed ones if these are shown."""
    judged, runs = _judged(c, loaded, asked)
    estimates, evaluations = zip(*judged, strict=True)
    smoothed = dict(zip([estimates[0].name], estimates[1:], strict=False))
    return Compared(loaded, [c], estimates, evaluations, runs, smoothed=smoothed)


def compare_log(
    loaded: Loaded,
    configurations: Sequence[Configuration],
    asked: Asked,
    progress: Progress,
    draws: bool = False,
    known: Mapping[str, Estimates] | None = None,
) -> Compared:
    """Run and judge every configuration, by truth or by its predictions; first filtered, then smoothed results.

    `known` are runs with their audits, by configuration, that need not be fused again; of use without smoothing.

    Audits take most of a run's memory. Unless `asked.audits`, they are freed as soon as the run is judged; with
    `draws` the parts that figures need are kept.
    """
    one_of(asked.align, get_args(Align), "align")
    drive, robot = loaded.drive, loaded.robot
    if asked.smooth:  # raise early: smoothing needs the optimal gain
        from locfuse.fusion.whole_drive.smooth import check_smoothing

        for c in configurations:
            check_smoothing(robot, c.sensors)
    solves = set[frozenset[str]]()
    if asked.reference:
        from locfuse.fusion.whole_drive.reference import reference_sets

        solves = {frozenset(sensors) for sensors in reference_sets(drive)}
    filtered, smoothed, runs = list[JudgedRun](), list[JudgedRun](), list[RunInnovations]()
    wholes: dict[str, Estimates] = {}  # smoothed estimates by the name of the filtered ones
    drawn = Drawn()
    for c in configurations:
        progress(f"fusing {c.name}")
        run = (known or {}).get(c.name)
        solve = frozenset(c.sensors) in solves and not c.rates
        (first, *after), residuals = _judged(c, loaded, asked, solve, drawn if draws else None, run)
        filtered.append(first)
        runs += residuals
        smoothed += after if c.is_smoothed(asked, robot) else []
        if after:
            wholes[first[0].name] = after[0][0]
    judged = {frozenset(e.sensors): own for e, own in filtered if not e.rates}
    present = [s for s in REGISTRY if s in drive.measurements]
    found = credit(judged, present) if drive.truth is not None else None
    predicted, densities = ([], {}) if found is not None else predict(drive, robot, configurations, progress)
    progress("judging")
    estimates, evaluations = zip(*filtered, *smoothed, strict=True)
    return Compared(
        loaded=loaded,
        configurations=configurations,
        estimates=estimates,
        evaluations=evaluations,
        runs=runs,
        credit=found,
        scores=predicted,
        densities=densities,
        smoothed=wholes,
        drawn=drawn,
    )


def with_others(compared: Compared, asked: Asked, foreign: Sequence[Estimates], progress: Progress) -> Compared:
    """Return the comparison with the `foreign` estimates of other programs added.

    With `asked.reference`, the errors of all estimates are computed against the smoothed path of the whole drive.
    """
    drive, robot, plain = compared.loaded.drive, compared.loaded.robot, compared.plain
    references, align = None, cast("Align", asked.align)
    if asked.reference:
        from locfuse.fusion.whole_drive.reference import References

        progress("solving the whole drive")
        alone = {sensors[0]: name for name, sensors in compared.sets.items() if len(sensors) == 1}
        contradicting = contradictions(compared.scores, alone)
        wholes = compared.smoothed
        solved = {s: (e, wholes[e.name]) for s, (e, _) in plain.items() if e.name in wholes}
        factors = verdicts.noise_factors(compared.runs, robot)
        references = References.of(drive, robot, solved, factors, contradicting)
    others = [_in_frame_of(e, drive, references, align) for e in foreign]
    aligns = [align] * len(compared.estimates) + [how for _, how in others]
    estimates = [*compared.estimates, *(e for e, _ in others)]
    evaluations = [*compared.evaluations, *(evaluate(e, drive, how) for e, how in others)]
    compared = replace(compared, estimates=estimates, evaluations=evaluations)
    if references is None:
        return compared
    runs = zip(evaluations, estimates, aligns, strict=True)
    again = {e.name: references.judged(judged, e, how) for judged, e, how in runs}
    judges = {name: reference for name, (_, reference) in again.items()}
    effects = {s: e for s in references.present if (e := _effect(references, s, plain, align)) is not None}
    referenced = Referenced(references, judges, effects)
    return replace(compared, reference=referenced, evaluations=[e for e, _ in again.values()])


def _effect(
    references: References, sensor: str, plain: Mapping[frozenset[str], JudgedRun], align: Align
) -> ByReference | None:
    """Return the errors [m] without and with a sensor, by a reference without it; None if one is missing."""
    reference, before = references.without(sensor), frozenset(needed(sensor))
    after = before | {sensor}
    if reference is None or before not in plain or after not in plain:
        return None
    runs = {s: plain[s] for s in (before, after)}
    judged = {s: reference.judge(own, e, align) for s, (e, own) in runs.items()}
    errors = [e.figures["position_rmse_m"] or 0.0 for e in judged.values()]
    some = min(errors) > 0.0  # else there is no ratio of errors
    found = credit(judged, [sensor]) if some and reference.can_judge(max(errors)) else None
    alone = None if found is None else found.sensors[sensor].alone
    effect = None if alone is None else reference.widened(alone, errors[0], errors[1])
    return ByReference(errors[0], errors[1], reference.can_judge(errors[1]), effect)


def _judged(
    c: Configuration,
    loaded: Loaded,
    asked: Asked,
    solve: bool = False,
    drawn: Drawn | None = None,
    known: Estimates | None = None,
) -> tuple[list[JudgedRun], list[RunInnovations]]:
    """Fuse and judge one configuration; also smooth it if the smoothed path is shown, or with `solve`.

    Returns the filtered and the smoothed run, and the residuals that show the noise of the sensors. `solve` is for
    references. `known` is the filter's run with its audits, if there is one.
    """
    drive, robot = c.drive(loaded.drive), loaded.robot
    judged, runs = list[JudgedRun](), list[RunInnovations]()
    shown = c.is_smoothed(asked, robot)
    whole = shown or solve
    for e in c.fuse(loaded.drive, robot, whole) if known is None or whole else (known,):
        evaluation = evaluate(e, drive, cast("Align", asked.align))
        if drawn is not None and (shown or not e.smoothed):
            drawn.take(e)
        judged.append((e if asked.audits else replace(e, audits={}), evaluation))
        if not e.smoothed and robot.preset != "paper":  # no setting changes the noise of the paper's filter
            runs.append(RunInnovations.of(drive, e))
    return judged, runs


def _in_frame_of(
    e: Estimates, drive: Drive, references: References | None, align: Align
) -> tuple[Estimates, Align]:
    """Return a foreign estimate, and how to align it: "origin", with a note, if it starts in another frame.

    With align "none", its start is compared with the truth, or with the reference that replaces the truth.
    """
    whole = None if references is None else references.whole
    seen, judge, what = (e, drive, "truth") if whole is None else (whole.seen(e), whole.drive, "reference")
    truth, poses = judge.truth, seen.truth_pose
    if align != "none" or truth is None or poses is None:
        return e, align
    common = np.flatnonzero(np.isfinite(poses[:, 0]))[:1]  # the first time of both
    points = se2.transform(poses[common], np.array([truth.point]))
    away = float(np.hypot(*(points - truth.xy[common]).T).sum())
    turns = np.zeros(1) if truth.theta is None else se2.wrap_all(poses[common, 2] - truth.theta[common])
    if away <= OTHER_FRAME_M and abs(turns.sum()) <= OTHER_FRAME_RAD:
        return e, align
    words = f"{e.name}: begins {away:.2f} m from the {what}, so it is of another frame: aligned at its first pose"
    return replace(e, notes=(*e.notes, words)), "origin"


def predict(
    drive: Drive, robot: Robot, configurations: Sequence[Configuration], progress: Progress
) -> tuple[list[Score], dict[str, float | None]]:
    """Return how well each configuration predicts the sensors that it does not use: scores and mean density."""
    densities: dict[str, float | None] = {}
    if not drive.measurements:
        return [], densities
    full = (c for c in configurations if c.sensors and not c.rates)
    sets = [((), configuration_name((), drive)), *((c.sensors, c.name) for c in full)]

    def tried() -> Iterator[Estimates]:
        for sensors, name in sets:
            progress(f"trying how {name} predicts the rest")
            flags = listeners(drive, sensors)
            e = fuser(robot.preset)(drive, robot, sensors, name, flags)
            densities[name] = mean_density(drive, e, flags)
            yield e
            del e

    return scores(drive, tried()), densities


def report_of(compared: Compared, asked: Asked | None = None) -> dict[str, Any]:
    """Return report.json as plain values; without `asked`, its values "key" and "repeat" are None."""
    report = results.build(compared.loaded, compared.evaluations)
    tables = compared.loaded.given
    report["key"] = key(compared.loaded.log.identity, tables, asked) if asked and tables is not None else None
    report["repeat"] = results.repeat(compared.loaded, asked) if asked else None
    report["changed_settings"] = results.changed_settings(compared.loaded)
    sets, scores, base = compared.sets, compared.scores, compared.base
    report["verdicts"] = verdicts.verdicts(compared.credit, scores, sets, base=base)
    report["credit"] = None if compared.credit is None else verdicts.credit_values(compared.credit)
    report["prediction"] = verdicts.prediction_values(scores, list(sets), base) if scores else None
    verdicts.add_consistency(report, compared.runs, compared.evaluations, compared.loaded.robot)
    add_reference(report, compared)
    slower = {c.name: c.sensors for c in compared.configurations if c.rates}
    errors = {name: values.get("position_rmse_m") for name, values in report["configurations"].items()}
    verdicts.add_pairs(report["verdicts"], sets, slower, errors, compared.credit is not None)
    add_own_scans(report, compared, compared.loaded.drive)
    return json_report.plain(report)


def add_own_scans(report: dict[str, Any], compared: Compared, drive: Drive) -> None:
    """Add pose jumps to each result; if any path was smoothed, also how well scans agree along the paths."""
    report["doubt"] = None
    for e in compared.estimates:  # slips, relocalisations, loop closures
        report["configurations"][e.name]["events"] = [
            {"t_s": t, "kind": kind, "dx_m": x, "dy_m": y, "dtheta_deg": math.degrees(turn)}
            for t, kind, (x, y, turn) in e.jumps
        ]
    if not compared.smoothed:
        return
    for values in report["configurations"].values():
        values.update(dict.fromkeys(("revisit_agreement", "crispness_cells")))
    ours = [e for e in compared.estimates if len(e.t) == len(drive.t)]
    for name, own in judged_by_scans(drive, ours, compared.smoothed).items():
        values, apart = report["configurations"][name], own.smoothed
        values["revisit_agreement"], values["crispness_cells"] = own.revisit_agreement, own.crispness_cells
        if apart is None:
            continue
        values["smoothed_distance_m"] = msgspec.to_builtins(apart)
        away = f"differs by {length(apart.rms)} rms (at most {length(apart.max)}, at {apart.t_s:.0f} s)"
        more = ", which is more than both claim: neither is a reference" if own.contradicted else ""
        values["notes"].append(in_one_unit(f"the smoothed path {away}{more}"))
        if own.is_overconfident:
            times = apart.rms / max(own.claimed_m, 1e-9)
            values["notes"].append(f"covariance too small: the smoothed path differs by {times:.1f} sigma")
        if apart.doubted(values["distance_m"]):
            row = result_name(name, smoothed=True)
            use = f"Use {row}" if row in report["configurations"] else "Use the smoothed one: --smooth"
            proven = use if own.smoothed_is_better else "Neither is proven right"
            report["doubt"] = f"Doubtful: the smoothed path of {name} {away}. {proven}."


def add_reference(report: dict[str, Any], compared: Compared) -> None:
    """Add `reference` to the report and to each result, and verdicts on the sensors that it can judge."""
    found = compared.reference
    report["reference"] = None
    if found is None:
        return
    references, whole = found.references, found.references.whole
    for name, values in report["configurations"].items():
        judge = found.judges[name]
        shared = [s for s in judge.sensors if s in values["sensors"]]
        own_reference = verdicts.reference_values(judge)
        values["reference"] = {**own_reference, "shared": shared, "agrees": judge.agrees(whole)}
    words = verdicts.reference_words(whole, references.contradict, compared.base)
    report["reference"] = {**verdicts.reference_values(whole), "words": words}
    for sensor in references.present:
        own, effect = report["verdicts"].get(sensor), found.effects.get(sensor)
        reference = references.without(sensor)
        contradiction = None if reference is None else references.contradiction(reference, (sensor,))
        if own is not None or effect is not None:
            report["verdicts"][sensor] = verdicts.by_reference(own, reference, effect, contradiction)


def report_of_run(compared: Compared) -> dict[str, Any]:
    """Return run.json, the report of one configuration, as plain values."""
    report = results.build(compared.loaded, compared.evaluations)
    verdicts.add_consistency(report, compared.runs, compared.evaluations, compared.loaded.robot)
    add_own_scans(report, compared, compared.configurations[0].drive(compared.loaded.drive))
    return json_report.plain(report)


DIRECTIONS = {"helps": 1, "seems to help": 1, "hurts": -1, "seems to hurt": -1}
NO_EFFECT = "no effect seen"
JITTER_NOTE = (
    f"The drive was fused {{runs}} times more with stamps moved by up to {1e6 * MOVED_S:g} µs and "
    f"{DROPPED_SHARE:.0%} of the readings dropped. Differences between configurations that are smaller than these "
    "ranges mean nothing."
)


class Jittered(NamedTuple):
    """Figures, path changes and verdicts of one run on a jittered drive."""

    figures: Mapping[str, Mapping[str, float | None]]  # result -> figure -> value
    away: Mapping[str, float]  # result -> largest distance of its path to that of the original drive [m]
    verdicts: Mapping[str, str]  # sensor -> verdict


def add_jitter(report: dict[str, Any], compared: Compared, asked: Asked, progress: Progress) -> None:
    """Fuse and judge all configurations on jittered drives, and add the ranges of the figures to the report."""
    loaded, plain = compared.loaded, {e.name: e for e in compared.estimates}
    once, found = replace(asked, reference=False, audits=False), []
    for seed in range(asked.jitter):
        progress(f"jitter {seed + 1} of {asked.jitter}")
        other = replace(loaded, drive=jittered(loaded.drive, loaded.robot, seed))
        run = compare_log(other, compared.configurations, once, silent)
        away = {}
        for e in run.estimates:
            own = plain[e.name]
            x, y = (np.interp(own.t, e.t, e.pose[:, k]) - own.pose[:, k] for k in (0, 1))
            away[e.name] = float(np.hypot(x, y).max())
        words = {s: v["verdict"] for s, v in verdicts.verdicts(run.credit, run.scores, run.sets).items()}
        found.append(Jittered({e.name: e.figures for e in run.evaluations}, away, words))
    add_ranges(report, found)


def add_ranges(report: dict[str, Any], found: Sequence[Jittered]) -> None:
    """Add each figure's range over all runs to the report; a verdict that changes becomes "no effect seen"."""
    if not found:
        return
    report["jitter"] = {"runs": len(found), "words": JITTER_NOTE.format(runs=len(found))}
    for name, values in report["configurations"].items():
        if name in found[0].figures:
            values["jitter"] = _ranges(values, [run.figures[name] for run in found])
            values["jitter"]["path_moved_m"] = max(run.away[name] for run in found)
    for sensor, own in report.get("verdicts", {}).items():
        seen = Counter(run.verdicts[sensor] for run in found if sensor in run.verdicts)
        if len({DIRECTIONS.get(word, 0) for word in (own["verdict"], *seen)}) > 1:
            counted = ", ".join(f"{w} {n}" for w, n in sorted(seen.items(), key=lambda pair: (-pair[1], pair[0])))
            words = f"The verdict is chance: it changes under jitter ({counted})."
            recorded = "" if own["verdict"] == NO_EFFECT else f" As recorded: {own['verdict']}."
            own.update(verdict=NO_EFFECT, words=f"{words}{recorded} {own['words']}")


def _ranges(own: Mapping[str, Any], runs: Sequence[Mapping[str, float | None]]) -> dict[str, Any]:
    """Return [smallest, largest] value of each figure that exists in all runs."""
    out = {}
    for figure in runs[0]:
        values = [own.get(figure), *(run.get(figure) for run in runs)]
        numbers = [v for v in values if v is not None and math.isfinite(v)]
        if len(numbers) == len(values):
            out[figure] = [min(numbers), max(numbers)]
    return out
