"""The result of `tune`: values, rows of words, and robot.toml."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import msgspec
from msgspec.structs import replace

from locfuse.cli.advice.report import MAX_START_ERROR_M
from locfuse.cli.analysis.configurations import refuse_beside_others, unknown_sensor
from locfuse.cli.analysis.load import Loaded, load, start_error, with_settings
from locfuse.cli.analysis.settings import LogOptions, set_words
from locfuse.formats.container.url import Place
from locfuse.formats.robot import robot_toml
from locfuse.fusion.checks.tried import MAX_LOSS_NATS, Marks, spoils
from locfuse.fusion.chi_square import SIGMAS_95
from locfuse.fusion.data import Evaluation, Measurements
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.consistency import Run, judge
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY, needed
from locfuse.fusion.tune.likelihood import Figures
from locfuse.fusion.tune.tune import Row as TunedRow
from locfuse.fusion.tune.tune import Trial, Tuned, tune

from .found import Found, Row, refuse_doubtful

HELD_OUT_SHARE = 0.2  # share of every log, its end, where no log is held out
LIKELIHOOD = "ln likelihood per number, {part} ({numbers})"


class Judged(msgspec.Struct, frozen=True):
    """One log under the configured and under the tuned noise."""

    name: str
    before: Evaluation
    after: Evaluation
    check: str  # the command that says what else is wrong with it


class Tuning(Found, frozen=True, kw_only=True):
    """The tuning of all logs."""

    tuned: Tuned
    judged: Sequence[Judged]
    refused: bool = False  # a log gets worse or is lost under the noise that was found

    command: ClassVar[str] = "tune"
    titles: ClassVar[Row] = ("noise", "before", "after", "95 % interval")

    def used(self, one: Loaded) -> tuple[str, ...]:
        """Return the sensors used for tuning."""
        return tuple(dict.fromkeys(s for j in self.judged for s in j.after.sensors))

    def tables(self) -> dict[str, dict[str, float]]:
        """Return the results as robot.toml tables, without figures that the logs do not show or that do harm."""
        return {} if self.refused else _tables(self.tuned)

    def values(self) -> dict[str, Any]:
        """Return all results as plain values: SI units or the key's, null for figures without a judgement."""
        tuned = self.tuned
        parts = zip(("training", "held_out"), (tuned.train, tuned.held_out), tuned.numbers, strict=True)
        return {
            "noise": {row.key: _row_values(row) for row in tuned.rows},
            "ln_likelihood_per_number": {
                name: None if pair is None else {"before": pair[0], "after": pair[1], "numbers": numbers}
                for name, pair, numbers in parts
            },
            "logs": [_log_values(j) for j in self.judged],
            "measured_again": list(tuned.measured_again),
            "refused": self.refused,
            "robot": self.tables(),
            "notes": list(self.notes),
        }

    def rows(self) -> list[Row]:
        """Return (key, before, after, interval) in words."""
        unused = ("not used", "")
        return [(r.key, f"{r.before:.3g}", *(unused if self.refused else _found(r))) for r in self.tuned.rows]

    def before(self) -> str:
        """Return the text of the first robot.toml if the user gave none."""
        head = "# without the noise that locfuse tune found: a log gets worse by it\n"
        return head if self.refused else "# noise found by locfuse tune\n"

    def given(self) -> dict[str, Any]:
        """Return the user's tables beside the first robot.toml, single settings included."""
        return robot_toml.merge(Found.given(self), robot_toml.apply_sets(self.how.sets))

    def judgements(self) -> list[tuple[str, str, str]]:
        """Return (figure, before, after) in words."""
        tuned = self.tuned
        rows: list[tuple[str, str, str]] = []
        for part, pair, n in zip(
            ("tuned on", "held out"), (tuned.train, tuned.held_out), tuned.numbers, strict=True
        ):
            if pair is not None:
                rows.append((LIKELIHOOD.format(part=part, numbers=n), f"{pair[0]:.2f}", f"{pair[1]:.2f}"))
        for j in self.judged:
            for s in j.after.sensors:
                before, after = (_cell(e.sensors[s].nis, "{:.2f}") for e in (j.before, j.after))
                rows.append((f"mean NIS of {s}, {j.name}", before, after))
            before, after = (_cell(e.figures.get("position_rmse_m"), "{:.4f} m") for e in (j.before, j.after))
            if after:
                shape = "" if j.after.align == "none" else " of the path's shape"
                rows.append((f"position error{shape}, {j.name}", before, after))
        return rows


def _tables(tuned: Tuned) -> dict[str, dict[str, float]]:
    tables: dict[str, dict[str, float]] = {}
    for row in tuned.rows:
        table, _, key = row.key.partition(".")
        if row.identifiable or row.after != row.before:
            tables.setdefault(table, {})[key] = float(f"{row.after:.4g}")
    return tables


def sensor_names(words: str) -> tuple[str, ...]:
    """Return the sensors of `--sensors`. Raises UsageError for an unknown one."""
    if words.strip() == "all":
        return tuple(REGISTRY)
    names = tuple(dict.fromkeys(w.strip() for w in words.split(",") if w.strip()))
    refuse_beside_others(words, names)
    for name in names:
        if name not in REGISTRY:
            raise unknown_sensor(name)
    return names


def tune_logs(
    logs: Sequence[Sequence[Place]],
    held_out: Sequence[Sequence[Place]],
    sensors: tuple[str, ...],
    drift: bool,
    how: LogOptions,
    progress: Callable[[str], None],
) -> Tuning:
    """Measure the logs, tune, and judge every log before and after.

    Where what was found spoils a log, and a sensor's errors last while the likelihood takes every reading for
    independent, the sigma of that sensor is left as it was, and the others are tuned once more.
    """
    paths = [*logs, *held_out]
    loaded = [load(p, how, progress, only=sensors) for p in paths]
    for one in loaded:
        refuse_doubtful(one, "noise found now")
    checks = [shlex.join(("locfuse", "info", *map(str, p), *how.words, "--check")) for p in paths]
    trials = []
    for i, one in enumerate(loaded):
        last = float(one.drive.t[-1])
        until = -math.inf if i >= len(logs) else math.inf if held_out else (1.0 - HELD_OUT_SHARE) * last
        trials.append(Trial(one.log.name, one.drive, one.robot, until))

    def remeasure(i: int, sensor: str, robot: Robot) -> Measurements:
        progress(f"measuring {sensor} of {trials[i].name} with another sigma")
        noise = Figures(robot, (sensor,)).values()
        sets = tuple(f"{key}={value!r}" for key, value in noise.items() if key.startswith(f"{sensor}."))
        again = load(paths[i], replace(how, sets=(*how.sets, *sets)), only=(sensor,))
        return again.drive.measurements[sensor]

    def tuned_by(names: Sequence[str]) -> tuple[Tuned, list[Judged], list[str]]:
        tuned = tune(trials, names, drift, remeasure, progress)
        progress("judging the logs")
        return tuned, (judged := _judged(loaded, tuned, checks)), _worse(tuned, judged)

    tuned, judged, worse = tuned_by(sensors)
    lasting = lasting_errors(tuned.trials)
    notes = [f"{name}: {sensor}: {words}" for (name, sensor), words in lasting.items()]
    left = {sensor for _, sensor in lasting}
    others = [s for s in sensors if s not in left and any(s in t.drive.measurements for t in trials)]
    if worse and left and others:
        progress(f"again, with the sigma of {' and '.join(sorted(left))} left as it was")
        tuned, judged, worse = tuned_by(others)
        notes = [f"{note}. It is left out, and its sigma left as it was" for note in notes]
    notes = [*worse, *_notes(tuned), *notes]
    return Tuning(loaded=loaded, how=how, notes=tuple(notes), tuned=tuned, judged=judged, refused=bool(worse))


def _judged(loaded: Sequence[Loaded], tuned: Tuned, checks: Sequence[str]) -> list[Judged]:
    """Evaluate every log as `run` would, before and after: measuring depends on the noise too."""
    sets = set_words(_tables(tuned))
    return [
        Judged(one.log.name, _evaluated(one), _evaluated(with_settings(one, sets)), check)
        for one, check in zip(loaded, checks, strict=True)
    ]


def _worse(tuned: Tuned, judged: Sequence[Judged]) -> list[str]:
    """Return the configurations that get worse with the tuned noise."""
    worse = [line for j in judged if (line := spoiled(j)) is not None]
    if tuned.held_out is not None and tuned.held_out[1] < tuned.held_out[0] - MAX_LOSS_NATS:
        worse.append(f"{_less_likely(*tuned.held_out)}: the noise that was found is not used")
    return worse


def _less_likely(before: float, after: float) -> str:
    figures = f"{before:.3f} -> {after:.3f} per number"
    return f"what was held out is less likely with the noise that was found ({figures})"


def spoiled(j: Judged) -> str | None:
    """Return a note on a log that gets worse with the tuned noise: such noise is not written."""
    before, after = (Marks(e.figures.get("position_rmse_m"), lost=e.lost_share) for e in (j.before, j.after))
    if not spoils(before, after):
        return None
    if after.lost > before.lost:
        what = f"is lost for {after.lost:.0%} of the drive, before for {before.lost:.0%}"
    else:
        shape = "" if j.after.align == "none" else " (of the path's shape)"
        what = f"has a position error{shape} of {after.position:.4f} m, before {before.position:.4f} m"
    return f"{j.name} {what}: the noise that was found is not used. Something else is set wrong; see: {j.check}"


def _evaluated(one: Loaded) -> Evaluation:
    """Evaluate all sensors of a log; by the path's shape if its start is unknown."""
    run = fuse(one.drive, one.robot, list(one.drive.measurements))
    elsewhere = (start_error(one.robot, one.drive) or 0.0) >= MAX_START_ERROR_M
    return evaluate(run, one.drive, "se2" if elsewhere else "none")


def _notes(tuned: Tuned) -> list[str]:
    again = [
        f"{s} was measured again: where one of its lines ends and the next begins is judged by its noise"
        for s in tuned.measured_again
    ]
    found = tuned.held_out
    if found is not None and found[0] - MAX_LOSS_NATS <= found[1] < found[0]:
        again.append(f"{_less_likely(*found)}, by no more than chance: a longer log would settle it")
    return [*tuned.flags, *again]


def lasting_errors(trials: Sequence[Trial]) -> dict[tuple[str, str], str]:
    """Return notes on sensors with slow errors, by log and sensor: no sigma describes such errors."""
    lasting: dict[tuple[str, str], str] = {}
    for trial in trials:
        sensors = list(trial.drive.measurements)
        together = dict.fromkeys((tuple(sensors), *((*needed(s), s) for s in sensors)))
        runs = [Run.of(trial.drive, fuse(trial.drive, trial.robot, chosen)) for chosen in together]
        found = judge(runs, trial.robot)
        worded = {s: verdict for verdicts in found.values() for s, verdict in verdicts.items()}
        lasting |= {(trial.name, s): v.words for s, v in worded.items() if v.verdict == "correlated"}
    return lasting


def _found(row: TunedRow) -> tuple[str, str]:
    """Return a figure and its interval, or that the logs do not show it."""
    if not row.identifiable:
        return f"{row.after:.3g}", "at most this" if row.after < row.before else "not identifiable"
    low, high = row.after * math.exp(-SIGMAS_95 * row.error), row.after * math.exp(SIGMAS_95 * row.error)
    return f"{row.after:.3g}", f"{low:.3g} .. {high:.3g}"


def _row_values(row: TunedRow) -> dict[str, Any]:
    factor = math.exp(SIGMAS_95 * row.error) if row.identifiable else None
    return {
        "before": row.before,
        "after": row.after,
        "low": None if factor is None else row.after / factor,
        "high": None if factor is None else row.after * factor,
        "identifiable": row.identifiable,
    }


def _log_values(j: Judged) -> dict[str, Any]:
    found = {
        when: {
            "position_rmse_m": e.figures.get("position_rmse_m"),
            "nis": {s: figures.nis for s, figures in e.sensors.items()},
        }
        for when, e in (("before", j.before), ("after", j.after))
    }
    return {"name": j.name, **found}


def _cell(value: float | None, form: str) -> str:
    return "" if value is None else form.format(value)
