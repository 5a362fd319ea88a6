"""Comparison of configurations on one measured log, judged by truth, else by a reference and by prediction."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, cast, get_args

import msgspec
import numpy as np
from msgspec.structs import replace

from locfuse.formats.report import json_report
from locfuse.formats.report.findings import in_one_unit, length
from locfuse.fusion import se2
from locfuse.fusion.data import Drive, Estimates, Evaluation, result_name
from locfuse.fusion.fuse import configuration_name
from locfuse.fusion.judge.against import Reference
from locfuse.fusion.judge.consistency import RunInnovations
from locfuse.fusion.judge.credit import Credit, credit
from locfuse.fusion.judge.evaluate import Align, evaluate
from locfuse.fusion.judge.own_scans import judged_by_scans
from locfuse.fusion.judge.predictive import Score, contradictions, listeners, scores
from locfuse.fusion.paper.preset import fuser
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY, needed

from . import results
from .configurations import Configuration
from .load import Loaded
from .robot_tables import key
from .settings import Asked, Progress, one_of
from .verdicts import (
    ByReference,
    add_consistency,
    add_pairs,
    by_reference,
    credit_values,
    evidence,
    judge_values,
    noise_factors,
    prediction_values,
    reference_values,
    verdicts,
)

if TYPE_CHECKING:
    from locfuse.fusion.whole_drive.reference import References

OTHER_FRAME_M, OTHER_FRAME_RAD = 0.5, math.radians(20.0)  # between first poses: more is another frame
PLAIN_FRAME = "none"  # no alignment: the covariance can be judged
RunReceiver = Callable[[Estimates, Evaluation], None]
PredictionReceiver = Callable[[Estimates], None]


class Compared(msgspec.Struct, frozen=True):
    """The results of one comparison of one log."""

    loaded: Loaded
    configurations: Sequence[Configuration]
    estimates: Sequence[Estimates]  # without audits, unless `Asked.audits`
    evaluations: Sequence[Evaluation]
    runs: Sequence[RunInnovations]  # residuals that show the sensors' noise
    credit: Credit | None = None  # with truth
    scores: Sequence[Score] = ()  # without truth
    reference: Referenced | None = None  # without truth, if asked for
    smoothed: Mapping[
        str, Estimates
    ] = {}  # by the name of the filtered estimates, also if only a reference uses them

    @property
    def sets(self) -> dict[str, tuple[str, ...]]:
        """The sensors of each configuration at the log's rates, by configuration name."""
        return {c.name: c.sensors for c in self.configurations if not c.rates}

    @property
    def base(self) -> str:
        """The configuration without a sensor: odometry, or scan matching if there are no wheels."""
        return configuration_name((), self.loaded.drive)


class Referenced(msgspec.Struct, frozen=True):
    """References (smoothed solutions) that replace a missing truth, and the errors against them."""

    references: References
    judges: Mapping[str, Reference]  # by result
    effects: Mapping[str, ByReference]  # by sensor


class JudgedRun(NamedTuple):
    """One configuration's estimates and evaluation, with the residuals that show its sensors' noise."""

    estimates: Estimates
    evaluation: Evaluation
    align: Align
    evidence: Sequence[RunInnovations] = ()  # () for smoothed and foreign estimates


def run_log(loaded: Loaded, c: Configuration, asked: Asked) -> Compared:
    """Run and judge one configuration: the filtered estimates, then the smoothed ones if it is smoothed."""
    first, *after = _judged(c, loaded, asked)
    estimates, evaluations = zip(*(j[:2] for j in (first, *after)), strict=True)
    smoothed = dict(zip([first.estimates.name], (j.estimates for j in after), strict=False))
    return Compared(loaded, [c], estimates, evaluations, first.evidence, smoothed=smoothed)


def compare_log(
    loaded: Loaded,
    configurations: Sequence[Configuration],
    asked: Asked,
    progress: Progress,
    receivers: Sequence[RunReceiver] = (),
    foreign: Sequence[Estimates] = (),
    prediction_receivers: Sequence[PredictionReceiver] = (),
) -> Compared:
    """Run and judge every configuration; results are filtered, smoothed, then `foreign` estimates.

    `foreign` are estimates of other programs. With `asked.reference` smoothed solutions replace the missing truth;
    the evaluations given to `receivers` do not use them.

    Audits take most of a run's memory. Unless `asked.audits`, they are freed as soon as the run is judged:
    `receivers` get each run before that, `prediction_receivers` each run in which unused sensors are predicted.
    """
    align = cast("Align", one_of(asked.align, get_args(Align), "align"))
    drive, robot, reference = loaded.drive, loaded.robot, bool(asked.reference)
    if asked.smooth:  # raise early: smoothing needs the optimal gain
        from locfuse.fusion.whole_drive.smooth import check_smoothing

        for c in configurations:
            check_smoothing(robot, c.sensors)
    solves: set[frozenset[str]] = set()
    if reference:
        from locfuse.fusion.whole_drive.reference import sets

        solves = {frozenset(sensors) for sensors in sets(drive)}
    filtered, smoothed = [], []
    plain: dict[frozenset[str], JudgedRun] = {}  # by sensors, all at the log's rates
    wholes: dict[str, Estimates] = {}  # smoothed estimates by the name of the filtered ones
    for c in configurations:
        progress(f"fusing {c.name}")
        solve = frozenset(c.sensors) in solves and not c.rates
        first, *after = _judged(c, loaded, asked, solve, receivers)
        filtered.append(first)
        smoothed += after if c.is_smoothed(asked, robot) else []
        plain |= {} if c.rates else {frozenset(c.sensors): first}
        if after:
            wholes[first.estimates.name] = after[0].estimates
    present = [s for s in REGISTRY if s in drive.measurements]
    judged = {sensors: j.evaluation for sensors, j in plain.items()}
    found = credit(judged, present) if drive.truth is not None else None
    predicted = [] if found is not None else predict(drive, robot, configurations, progress, prediction_receivers)
    progress("solving the whole drive" if reference else "judging")
    runs = [run for j in filtered for run in j.evidence]
    references = None
    if reference:
        from locfuse.fusion.whole_drive.reference import References

        alone = {c.sensors[0]: c.name for c in configurations if len(c.sensors) == 1 and not c.rates}
        contradicting = contradictions(predicted, alone)
        pairs = ((s, j.estimates, wholes.get(j.estimates.name)) for s, j in plain.items())
        solved = {s: (e, whole) for s, e, whole in pairs if whole is not None}
        references = References.of(drive, robot, solved, noise_factors(runs, robot), contradicting)
    others = [_in_frame_of(e, drive, references, align) for e in foreign]
    every = [*filtered, *smoothed, *(JudgedRun(e, evaluate(e, drive, how), how) for e, how in others)]
    compared = Compared(
        loaded=loaded,
        configurations=configurations,
        estimates=[j.estimates for j in every],
        evaluations=[j.evaluation for j in every],
        runs=runs,
        credit=found,
        scores=predicted,
        smoothed=wholes,
    )
    if references is None:
        return compared
    again = {j.estimates.name: references.judged(j.evaluation, j.estimates, j.align) for j in every}
    judges = {name: reference for name, (_, reference) in again.items()}
    effects = {s: e for s in references.present if (e := _effect(references, s, plain)) is not None}
    referenced = Referenced(references, judges, effects)
    return replace(compared, reference=referenced, evaluations=[e for e, _ in again.values()])


def _effect(references: References, sensor: str, plain: Mapping[frozenset[str], JudgedRun]) -> ByReference | None:
    """Return the position errors [m] without and with a sensor, against a reference that does not use it.

    None if the reference or one of the two runs is missing.
    """
    reference, before = references.without(sensor), frozenset(needed(sensor))
    after = before | {sensor}
    if reference is None or before not in plain or after not in plain:
        return None
    runs = {s: plain[s] for s in (before, after)}
    judged = {s: reference.judge(j.evaluation, j.estimates, j.align) for s, j in runs.items()}
    errors = [e.figures["position_rmse_m"] or 0.0 for e in judged.values()]
    some = min(errors) > 0.0  # a ratio of errors needs both above 0
    found = credit(judged, [sensor]) if some and reference.can_judge(max(errors)) else None
    alone = None if found is None else found.sensors[sensor].alone
    effect = None if alone is None else reference.widened(alone, errors[0], errors[1])
    return ByReference(errors[0], errors[1], reference.can_judge(errors[1]), effect)


def _judged(
    c: Configuration, loaded: Loaded, asked: Asked, solve: bool = False, receivers: Sequence[RunReceiver] = ()
) -> list[JudgedRun]:
    """Fuse and judge one configuration; also smooth it if that path is shown, or with `solve` (for references)."""
    drive, robot, judged = c.drive(loaded.drive), loaded.robot, []
    shown = c.is_smoothed(asked, robot)
    how = cast("Align", asked.align)
    for e in c.fuse(loaded.drive, robot, shown or solve):
        evaluation = evaluate(e, drive, how)
        for look in receivers if shown or not e.smoothed else ():
            look(e, evaluation)
        kept = e if asked.audits else replace(e, audits={})
        judged.append(JudgedRun(kept, evaluation, how, evidence(drive, e, robot)))
    return judged


def _other_frame(estimates: Estimates, drive: Drive) -> float | None:
    """Return the distance [m] from a foreign estimate to the truth at its first pose with truth.

    None if the two are near in position and heading, or without truth.
    """
    if drive.truth is None or estimates.truth_pose is None:
        return None
    rows = np.flatnonzero(np.isfinite(estimates.truth_pose[:, 0]))
    if not len(rows):
        return None
    first, pose = rows[0], estimates.truth_pose[rows[0]]
    point = se2.transform(pose[None], np.array([drive.truth.point]))[0]
    away = float(np.hypot(*(point - drive.truth.xy[first])))
    theta = drive.truth.theta
    turned = 0.0 if theta is None else abs(float(se2.wrap_all(np.array([pose[2] - theta[first]]))[0]))
    return away if away > OTHER_FRAME_M or turned > OTHER_FRAME_RAD else None


def _in_frame_of(e: Estimates, drive: Drive, references: References | None, align: str) -> tuple[Estimates, Align]:
    """Return a foreign estimate, and how to align it: "origin", with a note, if it starts in another frame.

    Its start is compared with the truth, or with the reference that replaces the truth; only for align "none".
    """
    whole = None if references is None else references.whole
    seen, judge, what = (e, drive, "truth") if whole is None else (whole.seen(e), whole.drive, "reference")
    away = _other_frame(seen, judge) if align == "none" else None
    if away is None:
        return e, cast("Align", align)
    words = f"{e.name}: begins {away:.2f} m from the {what}, so it is of another frame: aligned at its first pose"
    return replace(e, notes=(*e.notes, words)), "origin"


def predict(
    drive: Drive,
    robot: Robot,
    configurations: Sequence[Configuration],
    progress: Progress,
    prediction_receivers: Sequence[PredictionReceiver] = (),
) -> list[Score]:
    """Return the innovation scores of each configuration for the sensors that it does not use."""
    if not drive.measurements:
        return []
    sets = [
        ((), configuration_name((), drive)),
        *((c.sensors, c.name) for c in configurations if c.sensors and not c.rates),
    ]

    def tried() -> Iterator[Estimates]:
        for sensors, name in sets:
            progress(f"trying how {name} predicts the rest")
            e = fuser(robot.preset)(drive, robot, sensors, name, listeners(drive, sensors))
            for take in prediction_receivers:
                take(e)
            yield e
            del e

    return scores(drive, tried())


def report_of(compared: Compared, asked: Asked | None = None) -> dict[str, Any]:
    """Return report.json as plain values; without `asked`, its key and its command to repeat it are None."""
    report = results.build(compared.loaded, compared.evaluations)
    tables = compared.loaded.given
    report["key"] = key(compared.loaded.log.identity, tables, asked) if asked and tables is not None else None
    report["repeat"] = results.repeat(compared.loaded, asked) if asked else None
    report["changed_settings"] = results.changed_settings(compared.loaded)
    sets = compared.sets
    report["verdicts"] = verdicts(compared.credit, compared.scores, sets, base=compared.base)
    report["credit"] = None if compared.credit is None else credit_values(compared.credit)
    report["prediction"] = (
        prediction_values(compared.scores, list(sets), compared.base) if compared.scores else None
    )
    add_consistency(report, compared.runs, compared.evaluations, compared.loaded.robot)
    add_reference(report, compared)
    slower = {c.name: c.sensors for c in compared.configurations if c.rates}
    errors = {name: values.get("position_rmse_m") for name, values in report["configurations"].items()}
    add_pairs(report["verdicts"], sets, slower, errors, compared.credit is not None)
    add_own_scans(report, compared.loaded.drive, compared.estimates, compared.smoothed)
    return json_report.plain(report)


def add_own_scans(
    report: dict[str, Any], drive: Drive, estimates: Sequence[Estimates], smoothed: Mapping[str, Estimates]
) -> None:
    """Add pose jumps to each result; if any path was smoothed, also how well scans agree along the paths."""
    report["doubt"] = None
    for e in estimates:  # slips, relocalisations, loop closures
        report["configurations"][e.name]["events"] = [
            {"t_s": t, "kind": kind, "dx_m": x, "dy_m": y, "dtheta_deg": math.degrees(turn)}
            for t, kind, (x, y, turn) in e.jumps
        ]
    if not smoothed:
        return
    for values in report["configurations"].values():
        values.update(dict.fromkeys(("revisit_agreement", "crispness_cells")))
    ours = [e for e in estimates if len(e.t) == len(drive.t)]
    for name, own in judged_by_scans(drive, ours, smoothed).items():
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
    references = found.references
    for name, values in report["configurations"].items():
        values["reference"] = judge_values(found.judges[name], references.whole, values["sensors"])
    report["reference"] = reference_values(references.whole, references.contradict, compared.base)
    for sensor in references.present:
        own, effect = report["verdicts"].get(sensor), found.effects.get(sensor)
        reference = references.without(sensor)
        contradiction = None if reference is None else references.contradiction(reference, (sensor,))
        if own is not None or effect is not None:
            report["verdicts"][sensor] = by_reference(own, reference, effect, contradiction)


def report_of_run(compared: Compared) -> dict[str, Any]:
    """Return run.json, the report of one configuration, as plain values."""
    report = results.build(compared.loaded, compared.evaluations)
    add_consistency(report, compared.runs, compared.evaluations, compared.loaded.robot)
    drive = compared.configurations[0].drive(compared.loaded.drive)
    add_own_scans(report, drive, compared.estimates, compared.smoothed)
    return json_report.plain(report)
