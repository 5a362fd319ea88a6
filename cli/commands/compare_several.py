"""`locfuse compare` with several logs: a job for each, then the tables over all of them."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from locfuse.cli.analysis.gates import FAILED, FleetGates
from locfuse.cli.analysis.key import Asked
from locfuse.cli.analysis.load import check_settings
from locfuse.cli.analysis.results import LOSS
from locfuse.cli.analysis.settings import OF_COMPARISON
from locfuse.cli.fleet.gather import Gathered, gather
from locfuse.cli.fleet.job import Outcome
from locfuse.cli.fleet.options import FleetOptions
from locfuse.cli.fleet.plan import Plan, Wanted, plan
from locfuse.cli.fleet.queue import NOT_RUN, Ended, Executor, Standing, run_all
from locfuse.cli.fleet.robots import PLACE, Robots
from locfuse.cli.rerun.recordings import FOLDER, Recording, catalog
from locfuse.cli.session.summary import default_folder, of_each, summarised
from locfuse.cli.terminal import show
from locfuse.cli.terminal.options import chosen
from locfuse.cli.terminal.screen import put, reader_may_leave, say, screen
from locfuse.formats.fleet.files import summary_files
from locfuse.formats.report import json_report
from locfuse.formats.report import summary as over
from locfuse.formats.whole_files import RUN_LOCK, UNFINISHED, may_write, sole_writer, write_results
from locfuse.fusion.data import LocfuseError, UsageError
from locfuse.fusion.sensors.registry import colours

from .compare_one_log import Wish

ALL_FAILED = 1
STILL_S = 60.0  # s between lines of progress where stderr is no terminal
MAX_LINES = 20  # about losses and gates on stderr; all of them are in the tables


def several(words: Sequence[str], wish: Wish) -> int:
    """Compare every log, write and print the summary; return the exit code."""
    _refuse_rerun(wish)
    folder = wish.out or default_folder()
    wanted = _wanted(wish, folder)
    gates = FleetGates.read(wish.fail_if, wish.baseline, wish.tolerance)
    may_write(folder, wish.overwrite, (*wish.how.robot_files, wish.baseline))
    todo = plan(words, wanted, folder)
    with sole_writer(folder, RUN_LOCK, patience_s=0.0):
        _mark(folder, todo)
        ended = _run(todo, wish)
        found = gather(todo, ended.outcomes, ended.stopped or NOT_RUN, gates, wish.how.strict)
        _refuse_misuse(found, ended, todo)
        if ended.by is not None and not any(e.state == "done" for e in found.entries):
            raise ended.by
        summary = summarised(found.entries)
        kinds = chosen(wish.write, OF_COMPARISON)
        files = summary_files(summary, found.entries, kinds, colours(), wanted.swept)
        write_results(folder, files, overwrite=True)
        (folder / UNFINISHED).unlink(missing_ok=True)
    if ended.by is not None:
        show.say(f"{folder}: {_standing(found)}; the same command goes on with the rest")
        raise ended.by
    _print(summary, files, folder, wish)
    _say_recordings(ended, wanted.recording)
    show.end([folder / name for name in files], wish.as_json, wish.open)
    return _code(found, gates.failures(summary), ended)


def _wanted(wish: Wish, folder: Path) -> Wanted:
    """Return what is asked of every log, checked as far as it can be without one."""
    how, fleet = wish.how, wish.fleet
    if wish.estimate:
        raise UsageError(f"--estimate {wish.estimate[0]}: it is of one drive: compare one log at a time")
    if wish.given_map is not None:
        raise UsageError(f"--map {wish.given_map}: it is of one drive: compare one log at a time")
    if wish.jitter:
        raise UsageError(f"--jitter {wish.jitter}: several logs say by themselves what is chance; give one log")
    if wish.reference:
        raise UsageError("--reference: it is of one drive: compare one log at a time")
    robots = Robots.of(fleet.robot_from, how.robot)
    check_settings(how if how.robot is None or PLACE not in str(how.robot) else wish.without_robot())
    wanted = Wanted(
        how=how,
        asked=Asked.of(wish.sensors, wish.all_subsets, wish.align, wish.smooth),
        kinds=frozenset(of_each(chosen(wish.write, OF_COMPARISON))),
        export=frozenset(wish.export),
        figures=wish.figures,
        overwrite=wish.overwrite,
        again=fleet.again,
        robots=robots,
        recording=_recording(wish, folder),
        sweep=fleet.sweep,
    )
    for cell in wanted.cells:
        check_settings(wish.with_sets(cell.sets))
    return wanted


def _refuse_rerun(wish: Wish) -> None:
    rerun = wish.rerun
    asked = {"--rerun-save": rerun.save, "--rerun-connect": rerun.connect}
    for option, value in asked.items():
        if value:
            raise UsageError(f"{option}: one log at a time; of several logs --rerun records each")


def _mark(folder: Path, todo: Plan) -> None:
    """Leave a sign that the folder is ours, for a run that is killed before it has a summary."""
    if not (folder / "summary.json").exists():
        write_results(folder, {UNFINISHED: json_report.encode({"logs": list(todo.names)})}, overwrite=True)


def _run(todo: Plan, wish: Wish) -> Ended:
    """Run the jobs on this machine, or on a cluster."""
    with show.progress(wish.how.quiet) as progress, _executor(wish.fleet) as (executor, slots):
        for outcome in todo.refused.values():
            _say_failed(outcome)
        watch = _watch(progress, wish.how.quiet)
        return run_all(list(todo.jobs.values()), executor, slots, wish.fleet.max_failures, watch)


@contextmanager
def _executor(fleet: FleetOptions) -> Iterator[tuple[Executor, int]]:
    """Yield what runs jobs, and how many at once: threads that each wait for a process, or workers elsewhere."""
    if fleet.cluster is None:
        with ThreadPoolExecutor(fleet.jobs) as threads:
            yield threads, fleet.jobs
        return
    from locfuse.cli.fleet.cluster import cluster

    with cluster(fleet.cluster) as workers:
        yield workers, workers.slots


def _watch(progress: show.Progress, quiet: bool) -> Callable[[Standing, Outcome | None], None]:
    said = time.monotonic()

    def watch(standing: Standing, outcome: Outcome | None) -> None:
        nonlocal said
        progress(standing.words())
        if outcome is not None and outcome.state == "failed":
            _say_failed(outcome)
        if not quiet and not sys.stderr.isatty() and time.monotonic() - said > STILL_S:
            said = time.monotonic()
            show.say(standing.words())

    return watch


def _say_failed(outcome: Outcome) -> None:
    name = outcome.name
    show.say(f"failed: {outcome.reason if name in outcome.reason else f'{name}: {outcome.reason}'}")


def _refuse_misuse(found: Gathered, ended: Ended, todo: Plan) -> None:
    """Raise UsageError where every log failed by what was asked for, as a single log would."""
    outcomes = [*ended.outcomes.values(), *todo.refused.values()]
    if outcomes and len(outcomes) == len(found.entries) and all(o.misused for o in outcomes):
        raise UsageError(outcomes[0].reason)


def _standing(found: Gathered) -> str:
    states = [e.state for e in found.entries]
    return ", ".join(f"{states.count(s)} {s}" for s in ("done", "failed", "not run") if s in states)


def _print(summary: Mapping[str, Any], files: Mapping[str, Any], folder: Path, wish: Wish) -> None:
    with reader_may_leave():
        if wish.as_json:
            put(json_report.encode(summary))
        else:
            _show_summary(summary)
            say(f"{folder}: {', '.join(sorted(files))}; a folder with the report of each log")


def _show_summary(summary: Mapping[str, Any]) -> None:
    from rich.text import Text

    if over.columns_of(summary):
        show.table(over.brief(summary))
    screen().print(Text(over.headline(summary)))
    show.verdicts(summary)


def _recording(wish: Wish, folder: Path) -> Recording | None:
    rerun = wish.rerun
    return Recording(str((folder / FOLDER).absolute()), rerun.images, rerun.full) if rerun.show else None


def _say_recordings(ended: Ended, recording: Recording | None) -> None:
    """Say what could not be recorded, and how to open all that was."""
    _say_some([line for outcome in ended.outcomes.values() for line in outcome.warnings], "warnings")
    if recording is not None and any(Path(recording.folder).glob("*.rrd")):
        show.say(f"all drives in one viewer: {catalog(Path(recording.folder))}")


def _code(found: Gathered, failed_gates: Sequence[str], ended: Ended) -> int:
    """Say what is void, what was lost and which gates failed, and return the exit code."""
    void = [f"void: {name}: {line}" for name, lines in found.void.items() for line in lines]
    lost = [f"lost: {name}: {line}" for name, lines in found.lost.items() for line in lines]
    _say_some(void, "void figures")  # reasons of exit code 3: said under --quiet too
    _say_some(lost, "losses")
    gates = [f"gate: {line}" for line in (*found.gates, *failed_gates)]
    _say_some(gates, "gates")
    if ended.stopped:
        show.say(f"stopped: {ended.stopped}")
    states = {e.state for e in found.entries}
    if gates:
        return FAILED
    if "done" not in states:
        raise LocfuseError(f"none of {len(found.entries)} logs could be compared; the reasons stand above")
    return LOSS if void or lost or states != {"done"} else 0


def _say_some(lines: Sequence[str], what: str) -> None:
    for line in lines[:MAX_LINES]:
        show.say(line)
    if len(lines) > MAX_LINES:
        show.say(f"and {len(lines) - MAX_LINES} more {what}")
