"""Several logs of one robot: values that they share, and settings tried on all of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, cast

import msgspec

from locfuse.cli.analysis.load import Loaded
from locfuse.cli.analysis.settings import Progress
from locfuse.formats.text import writable
from locfuse.fusion.checks.examine import MIXED, holes
from locfuse.fusion.checks.together import LogEstimates, Look, asked, shown
from locfuse.fusion.checks.tried import Fixes
from locfuse.fusion.data import Estimates
from locfuse.fusion.judge.evaluate import Align, evaluate

from .evaluator import may_judge, standard
from .report import FIXES_FILE, data_advice, fixes_file, score
from .trial import Trial, marks_of

MAX_TRIED_LOGS = 12  # logs of one robot, evenly spread
# function (names of logs, settings) -> {log: {settings: figures}}
LooksOf = Callable[[Sequence[str], Sequence[Fixes]], Mapping[str, Mapping[Fixes, Look]]]


def looks(loaded: Loaded, sets: Sequence[Fixes], align: str, progress: Progress) -> dict[Fixes, Look]:
    """Fuse a log's whole drive under each of several settings; settings that cannot be applied are left out."""
    if not may_judge(loaded):
        return {}
    trial = Trial(loaded, {c.name: c for c in standard(loaded)}, align, progress)
    sensors = {name: tuple(c.sensors) for name, c in trial.configurations.items()}
    found = {}
    for fixes in sets:
        progress(f"trying {' '.join(fixes) or 'the settings as they are'}")
        whole = trial.whole_under(fixes)
        if whole is None:
            continue
        runs = [e for name in sensors if (e := trial.fused(whole, name)) is not None]
        if whole.drive.truth is None:
            marks = trial.on_whole(fixes, [e.name for e in runs])
        else:
            judged = [evaluate(e, whole.drive, cast("Align", align)) for e in runs]
            marks = {e.name: marks_of(e, j, whole.drive) for e, j in zip(runs, judged, strict=True)}
        found[fixes] = Look(shown(whole.drive, whole.robot, runs), sensors, marks)
    return found


def numbers_of(loaded: Loaded, runs: Sequence[Estimates] = ()) -> dict[str, Any] | None:
    """Return a log's estimates of settings as plain values; None if the log cannot be evaluated."""
    if loaded.motion_faults or loaded.drive.wheels.stands or not may_judge(loaded):
        return None
    if holes(loaded.drive) or any(a.finding.code in MIXED for a in data_advice(loaded)):
        return None
    found: dict[str, Any] = msgspec.to_builtins(shown(loaded.drive, loaded.robot, runs))
    return found


def ask(logs: Mapping[str, Mapping[str, Any]], look: LooksOf) -> dict[str, Any]:
    """Return the values on which logs of one robot agree, and the settings that help all logs, as plain values.

    Settings are tried on at most MAX_TRIED_LOGS logs.
    """
    step = max(1.0, len(logs) / MAX_TRIED_LOGS)
    chosen = [list(logs)[int(i * step)] for i in range(min(len(logs), MAX_TRIED_LOGS))]
    estimates = {log: msgspec.convert(values, LogEstimates) for log, values in logs.items()}
    found = asked(estimates, partial(look, chosen))
    return {
        "logs": list(logs),
        "values": [{**msgspec.to_builtins(c), "off": c.off, "words": c.words} for c in found.common],
        "fixes": [] if found.fix is None else list(found.fix.fixes),
        "tried": [
            {
                "fixes": list(step.fixes),
                "helps": step.helps,
                "configuration": step.configuration,
                "logs": {
                    log: {"before": score(one), "after": score(two)} for log, (one, two) in step.pairs.items()
                },
                "worse": list(step.losers),
            }
            for step in (*filter(None, (found.fix,)), *found.refused)
        ],
    }


def fixes_files(robots: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Return {name: text} of fixes.toml, or of fixes-ROBOT.toml for named robots, if a fix helps."""
    return {
        name: text
        for robot in robots
        for name, text in fixes_file(
            robot, f"fixes-{writable(robot['robot'])}.toml" if robot["robot"] else FIXES_FILE
        ).items()
    }


def in_this_process(logs: Mapping[str, Loaded], align: str, progress: Progress) -> LooksOf:
    """Return a function that fuses these logs in this process under given settings."""
    return lambda names, sets: {name: looks(logs[name], sets, align, progress) for name in names}
