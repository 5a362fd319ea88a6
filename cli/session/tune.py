"""Tuning of noise settings (`tune`): values, rows of a table, and robot.toml."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import msgspec
from msgspec.structs import replace

from locfuse.cli.advice.report import MAX_START_ERROR_M
from locfuse.cli.analysis.configurations import refuse_beside_others, unknown_sensor
from locfuse.cli.analysis.load import Loaded, Parts, find_log, load, start_error, with_settings
from locfuse.cli.analysis.settings import LogOptions, set_words
from locfuse.formats.columns import nested
from locfuse.formats.robot import robot_toml
from locfuse.fusion.checks.tried import MAX_LOSS_NATS, Marks, worsens
from locfuse.fusion.data import Evaluation, Measurements
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.consistency import RunInnovations, judge
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY, needed
from locfuse.fusion.statistics import SIGMAS_95
from locfuse.fusion.tune.tape import Figures
from locfuse.fusion.tune.tune import NoiseChange as TunedRow, Tuned, TuneLog, tune

from .found import Found, Row, refuse_doubtful

RMSE = "position_rmse_m"
HELD_OUT_SHARE = 0.2  # the end of every log that is not used for tuning, if no log is held out


class BothNoises(msgspec.Struct, frozen=True):
    """One log evaluated with the configured noise and with the tuned noise."""

    name: str
    before: Evaluation
    after: Evaluation
    check: str  # the command that checks this log


class Tuning(Found, frozen=True, kw_only=True):
    """The tuned noise of all logs, and each log's errors before and after."""

    tuned: Tuned
    judged: Sequence[BothNoises]
    refused: bool = False  # with the tuned noise a log gets worse, or the filter is lost

    command: ClassVar[str] = "tune"
    titles: ClassVar[Row] = ("noise", "before", "after", "95 % interval")

    def used(self, one: Loaded) -> tuple[str, ...]:
        """Return the sensors used for tuning, in any of the logs."""
        return tuple(dict.fromkeys(s for j in self.judged for s in j.after.sensors))

    def tables(self) -> dict[str, dict[str, float]]:
        """Return the tuned noise as tables of robot.toml; {} if a log gets worse with it."""
        return {} if self.refused else _tables(self.tuned)

    def values(self) -> dict[str, Any]:
        """Return all results as plain values for --json: SI units or the key's unit, null for unknown ones."""
        noise: dict[str, Any] = {}
        for row in self.tuned.rows:
            low, high = _interval(row) or (None, None)
            bounds = {"low": low, "high": high, "identifiable": row.identifiable}
            noise[row.key] = {"before": row.before, "after": row.after, **bounds}
        likelihood = {}
        pairs = (self.tuned.train, self.tuned.held_out)
        for part, pair, n in zip(("training", "held_out"), pairs, self.tuned.numbers, strict=True):
            likelihood[part] = pair and {"before": pair[0], "after": pair[1], "numbers": n}
        logs = []
        for j in self.judged:
            found: dict[str, Any] = {"name": j.name}
            for when, e in (("before", j.before), ("after", j.after)):
                nis = {s: figures.nis for s, figures in e.sensors.items()}
                found[when] = {RMSE: e.figures.get(RMSE), "nis": nis}
            logs.append(found)
        return {
            "noise": noise,
            "ln_likelihood_per_number": likelihood,
            "logs": logs,
            "measured_again": list(self.tuned.measured_again),
            "refused": self.refused,
            "robot": self.tables(),
            "notes": list(self.notes),
        }

    def rows(self) -> list[Row]:
        """Return the table's rows as text: key, before, after, 95 % interval."""
        rows: list[Row] = []
        for r in self.tuned.rows:
            interval = _interval(r)
            unknown = "at most this" if r.after < r.before else "not identifiable"
            found = f"{r.after:.3g}", unknown if interval is None else f"{interval[0]:.3g} .. {interval[1]:.3g}"
            rows.append((r.key, f"{r.before:.3g}", *(("not used", "") if self.refused else found)))
        return rows

    def before(self) -> str:
        """Return the comment line that starts a new robot.toml, used if the user gave no file."""
        head = "# without the noise that locfuse tune found: a log gets worse by it\n"
        return head if self.refused else "# noise found by locfuse tune\n"

    def given(self) -> dict[str, Any]:
        """Return the settings of the user's second and later robot.toml files, and of --set."""
        return robot_toml.merge(Found.given(self), robot_toml.apply_sets(self.how.sets))

    def judgements(self) -> list[tuple[str, str, str]]:
        """Return rows of text: figure, value before, value after tuning."""
        rows: list[tuple[str, str, str]] = []
        pairs = (self.tuned.train, self.tuned.held_out)
        for part, pair, n in zip(("tuned on", "held out"), pairs, self.tuned.numbers, strict=True):
            if pair is not None:
                rows.append((f"ln likelihood per number, {part} ({n})", f"{pair[0]:.2f}", f"{pair[1]:.2f}"))
        for j in self.judged:
            both = (j.before, j.after)
            for s in j.after.sensors:
                before, after = ("" if (nis := e.sensors[s].nis) is None else f"{nis:.2f}" for e in both)
                rows.append((f"mean NIS of {s}, {j.name}", before, after))
            before, after = ("" if (m := e.figures.get(RMSE)) is None else f"{m:.4f} m" for e in both)
            shape = "" if j.after.align == "none" else " of the path's shape"
            rows += [(f"position error{shape}, {j.name}", before, after)] if after else []
        return rows


def _interval(row: TunedRow) -> tuple[float, float] | None:
    """Return the 95 % interval (low, high) of a tuned setting; None if the logs do not determine the setting."""
    factor = math.exp(SIGMAS_95 * row.error)
    return (row.after / factor, row.after * factor) if row.identifiable else None


def _tables(tuned: Tuned) -> dict[str, dict[str, float]]:
    shown = (row for row in tuned.rows if row.identifiable or row.after != row.before)
    return nested({row.key: float(f"{row.after:.4g}") for row in shown})


def sensor_names(words: str) -> tuple[str, ...]:
    """Return the sensors of `--sensors`, comma-separated or "all". Raises UsageError for an unknown name."""
    if words.strip() == "all":
        return tuple(REGISTRY)
    names = tuple(dict.fromkeys(w.strip() for w in words.split(",") if w.strip()))
    refuse_beside_others(words, names)
    for name in names:
        if name not in REGISTRY:
            raise unknown_sensor(name)
    return names


def tune_logs(
    logs: Sequence[Parts],
    held_out: Sequence[Parts],
    sensors: tuple[str, ...],
    drift: bool,
    how: LogOptions,
    progress: Callable[[str], None],
) -> Tuning:
    """Measure the logs, tune the noise, and evaluate every log before and after.

    The likelihood assumes independent readings. If a log gets worse and errors of a sensor are correlated in time,
    this sensor's sigma is left as configured, and the others are tuned again.
    """
    paths = [find_log(parts) for parts in (*logs, *held_out)]
    loaded = [load(p, how, progress, only=sensors) for p in paths]
    for one in loaded:
        refuse_doubtful(one, "noise found now")
    checks = [shlex.join(("locfuse", "info", *map(str, p), *how.words, "--check")) for p in paths]
    trials = []
    for i, one in enumerate(loaded):
        last = float(one.drive.t[-1])
        until = -math.inf if i >= len(logs) else math.inf if held_out else (1.0 - HELD_OUT_SHARE) * last
        trials.append(TuneLog(one.log.name, one.drive, one.robot, until))

    def remeasure(i: int, sensor: str, robot: Robot) -> Measurements:
        progress(f"measuring {sensor} of {trials[i].name} with another sigma")
        noise = Figures(robot, (sensor,)).values()
        sets = tuple(f"{key}={value!r}" for key, value in noise.items() if key.startswith(f"{sensor}."))
        again = load(paths[i], replace(how, sets=(*how.sets, *sets)), only=(sensor,))
        return again.drive.measurements[sensor]

    def tuned_by(names: Sequence[str]) -> tuple[Tuned, list[BothNoises], list[str]]:
        tuned = tune(trials, names, drift, remeasure, progress)
        progress("judging the logs")
        sets = set_words(_tables(tuned))  # measured again: line fitting depends on the noise
        judged = [
            BothNoises(one.log.name, _evaluated(one), _evaluated(with_settings(one, sets)), check)
            for one, check in zip(loaded, checks, strict=True)
        ]
        worse = [line for j in judged if (line := got_worse(j)) is not None]
        if tuned.held_out is not None and tuned.held_out[1] < tuned.held_out[0] - MAX_LOSS_NATS:
            worse.append(f"{_less_likely(*tuned.held_out)}: the noise that was found is not used")
        return tuned, judged, worse

    tuned, judged, worse = tuned_by(sensors)
    lasting = lasting_errors(tuned.trials)
    notes = [f"{name}: {sensor}: {words}" for (name, sensor), words in lasting.items()]
    left = {sensor for _, sensor in lasting}
    others = [s for s in sensors if s not in left and any(s in t.drive.measurements for t in trials)]
    if worse and left and others:
        progress(f"again, with the sigma of {' and '.join(sorted(left))} left as it was")
        tuned, judged, worse = tuned_by(others)
        notes = [f"{note}. It is left out, and its sigma left as it was" for note in notes]
    why = "was measured again: where one of its lines ends and the next begins is judged by its noise"
    again = [f"{s} {why}" for s in tuned.measured_again]
    found = tuned.held_out
    if found is not None and found[0] - MAX_LOSS_NATS <= found[1] < found[0]:
        again.append(f"{_less_likely(*found)}, by no more than chance: a longer log would settle it")
    notes = [*worse, *tuned.flags, *again, *notes]
    return Tuning(loaded=loaded, notes=tuple(notes), tuned=tuned, judged=judged, refused=bool(worse))


def _less_likely(before: float, after: float) -> str:
    figures = f"{before:.3f} -> {after:.3f} per number"
    return f"what was held out is less likely with the noise that was found ({figures})"


def got_worse(j: BothNoises) -> str | None:
    """Return a note if a log gets worse with the tuned noise (which is then not written), else None."""
    before, after = (Marks(e.figures.get(RMSE), lost=e.lost_share) for e in (j.before, j.after))
    if not worsens(before, after):
        return None
    if after.lost > before.lost:
        what = f"is lost for {after.lost:.0%} of the drive, before for {before.lost:.0%}"
    else:
        shape = "" if j.after.align == "none" else " (of the path's shape)"
        what = f"has a position error{shape} of {after.position:.4f} m, before {before.position:.4f} m"
    return f"{j.name} {what}: the noise that was found is not used. Something else is set wrong; see: {j.check}"


def _evaluated(one: Loaded) -> Evaluation:
    """Evaluate a log with all sensors; aligned to the truth if its start is unknown."""
    run = fuse(one.drive, one.robot, list(one.drive.measurements))
    elsewhere = (start_error(one.robot, one.drive) or 0.0) >= MAX_START_ERROR_M
    return evaluate(run, one.drive, "se2" if elsewhere else "none")


def lasting_errors(trials: Sequence[TuneLog]) -> dict[tuple[str, str], str]:
    """Return {(log, sensor): note} for sensors with errors correlated in time, which no sigma describes."""
    lasting: dict[tuple[str, str], str] = {}
    for trial in trials:
        sensors = list(trial.drive.measurements)
        together = dict.fromkeys((tuple(sensors), *((*needed(s), s) for s in sensors)))
        runs = [RunInnovations.of(trial.drive, fuse(trial.drive, trial.robot, chosen)) for chosen in together]
        found = judge(runs, trial.robot)
        worded = {s: verdict for verdicts in found.values() for s, verdict in verdicts.items()}
        lasting |= {(trial.name, s): v.words for s, v in worded.items() if v.verdict == "correlated"}
    return lasting
