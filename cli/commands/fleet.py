"""`locfuse fleet`: compares each of many logs, then writes tables and a page over all."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from msgspec.structs import replace

from locfuse.cli.analysis.errors import EXIT_LOSS
from locfuse.cli.analysis.settings import OF_COMPARISON as KINDS, swept
from locfuse.cli.rerun.record import FOLDER, catalog
from locfuse.cli.terminal import options as o, show
from locfuse.cli.terminal.screen import put
from locfuse.formats.report import json_report
from locfuse.fusion.data import LocfuseError, UsageError

if TYPE_CHECKING:
    from locfuse.cli.fleet.jobs import FleetRows, Job, JobOutcome
    from locfuse.cli.fleet.queue import Ended, QueueState

LINE_INTERVAL_S = 60.0  # between lines of progress if stderr is not a terminal
MAX_LINES_PRINTED = 20  # of losses or gates on stderr; the tables have all


@click.command(cls=o.Grouped)
@click.argument("log", nargs=-1, shell_complete=o.complete_log)
@o.carried(
    *o.fleet(),
    *o.CONFIGURATIONS,
    o.ALIGN,
    o.SMOOTH,
    o.ADVICE,
    o.FIGURES,
    *o.GATES,
    o.OPEN,
    *o.FUSING,
    *o.written(KINDS),
    o.EXPORT,
    o.RERUN_SHOW,
)
def fleet(log: tuple[str, ...], options: o.Options) -> int:
    """Compare many LOGS, and summarise the results in tables and on one page (docs/fleet.md).

    LOGS may also be @list.txt or "pattern*.mcap". Logs that already have results are not run again. A fix for a
    robot is tried on all of its logs, and is printed if it helps in all of them.

    \b
    locfuse fleet rounded_rectangle rounded_triangle disturbed --jobs 2
    locfuse fleet @logs.txt --robot-from "fleet/([^/]+)/" --robot "robots/{robot}.toml"
    locfuse fleet --each day1 --sweep lrf.sigma_range=0.01,0.03
    """
    from locfuse.cli.analysis.grouping import expanded

    words = expanded(log, options.fleet.each)
    if not words:
        raise click.UsageError("Missing argument 'LOG...'.", click.get_current_context())
    return many(words, options)


def many(words: Sequence[str], options: o.Options) -> int:
    """Compare every log, write and print the summary; return the exit code."""
    from locfuse.cli.analysis.gates import Gates
    from locfuse.cli.analysis.results import default_folder
    from locfuse.cli.fleet.jobs import FleetRows, plan
    from locfuse.cli.fleet.queue import NOT_RUN
    from locfuse.cli.session.summary import SUMMARY, summarised, write_summary
    from locfuse.formats.report.fleet import Entry
    from locfuse.formats.whole_files import RUN_LOCK, UNFINISHED, may_write, sole_writer, write_results

    how, outputs, fleet = options.how, options.outputs, options.fleet
    folder = outputs.out or default_folder(SUMMARY)
    every = _job_options(options, folder)
    gates = Gates.read(options.gates, of_fleet=True)
    may_write(folder, outputs.overwrite, options.inputs)
    jobs, found = plan(words, every, fleet.robot_from, fleet.sweep), FleetRows()
    with sole_writer(folder, RUN_LOCK, patience_s=0.0):
        if not (folder / "summary.json").exists():  # marks the folder as results even if the run is killed
            write_results(folder, {UNFINISHED: json_report.encode({"logs": list(jobs)})}, overwrite=True)
        ended = _run(list(jobs.values()), options, fleet.max_failures)
        outcomes = list(ended.outcomes.values())
        if outcomes and len(outcomes) == len(jobs) and all(o.misused for o in outcomes):
            raise UsageError(outcomes[0].reason)
        for name, job in jobs.items():
            outcome = ended.outcomes.get(name)
            if outcome is None:
                found.entries.append(Entry(name, job.robot, "not run", ended.stopped or NOT_RUN))
            elif outcome.state == "failed":
                found.entries.append(Entry(name, job.robot, "failed", outcome.reason))
            else:
                found.add(job, gates, how.strict)
        if ended.by is not None and not any(e.state == "done" for e in found.entries):
            raise ended.by
        robots = _robots(jobs, found, options) if ended.by is None else []
        summary = {**summarised(found.entries), "robots": robots}
        keys = tuple(swept(fleet.sweep))
        written = write_summary(folder, summary, found.entries, outputs.write, keys)
        (folder / UNFINISHED).unlink(missing_ok=True)
    if ended.by is not None:
        states = [e.state for e in found.entries]
        counts = ", ".join(f"{states.count(s)} {s}" for s in ("done", "failed", "not run") if s in states)
        show.say(f"{folder}: {counts}; the same command goes on with the rest")
        raise ended.by
    _print(summary, written, outputs.as_json)
    _say_some([line for outcome in outcomes for line in outcome.warnings], "warnings")
    if every.recordings is not None and any(every.recordings.glob("*.rrd")):
        show.say(f"all drives in one viewer: {catalog(every.recordings)}")
    if outputs.open:
        show.open_page(written)
    return _code(found, gates.failures_together(summary), ended)


def _job_options(options: o.Options, folder: Path) -> Job:
    """Return a job with the options of all jobs, without a log. Raises UsageError for options of one log."""
    from locfuse.cli.fleet.jobs import Job
    from locfuse.cli.session.summary import of_each

    how, outputs = options.how, options.outputs
    if how.given_map is not None:
        raise UsageError(f"--map {how.given_map}: it is of one drive: compare one log at a time")
    if outputs.rerun_save is not None:
        raise UsageError("--rerun-save: one log at a time; of several logs --rerun records each")
    recordings = (folder / FOLDER).absolute() if outputs.rerun else None
    return Job(
        name="",
        log=(),
        folder=folder,
        how=replace(how, quiet=True),
        asked=replace(options.asked.of_each(), audits=recordings is not None),
        outputs=replace(outputs, write=frozenset(of_each(outputs.write))),
        recordings=recordings,
        again=options.fleet.again,
    )


def _run(jobs: Sequence[Job], options: o.Options, max_failures: int | None) -> Ended:
    """Run jobs in processes of this machine, or on a cluster."""
    from locfuse.cli.fleet.queue import executor, run_all

    quiet, printed = options.how.quiet, time.monotonic()
    with show.progress(quiet) as progress, executor(options.fleet) as pool:

        def watch(standing: QueueState, outcome: JobOutcome | None) -> None:
            nonlocal printed
            progress(standing.words())
            if outcome is not None and outcome.state == "failed":
                name, reason = outcome.name, outcome.reason
                show.say(f"failed: {reason if name in reason else f'{name}: {reason}'}")
            if not quiet and not sys.stderr.isatty() and time.monotonic() - printed > LINE_INTERVAL_S:
                printed = time.monotonic()
                show.say(standing.words())

        return run_all(jobs, pool, max_failures, watch)


def _robots(todo: Mapping[str, Job], found: FleetRows, options: o.Options) -> list[dict[str, Any]]:
    """Return for each robot the values that its logs share, and settings that help all its logs."""
    from locfuse.cli.fleet.jobs import robots

    def run(jobs: Sequence[Job]) -> Mapping[str, JobOutcome]:
        ended = _run(jobs, options, None)
        if ended.by is not None:
            raise ended.by
        return ended.outcomes

    return [] if options.fleet.sweep or not options.asked.advice else robots(found.entries, todo, run)


def _print(summary: Mapping[str, Any], files: Sequence[Path], as_json: bool) -> None:
    from locfuse.formats.report import summary as over

    if as_json:
        put(json_report.encode(summary))
        return
    show.paragraph(over.headline(summary), bold=True)
    if over.columns_of(summary):
        show.table(over.brief(summary))
    show.verdicts(summary)
    show.lines(" ".join(line).strip() for line in over.robots(summary))
    show.end(files)


def _code(found: FleetRows, failed_gates: Sequence[str], ended: Ended) -> int:
    """Print void and doubtful figures, losses and failed gates; return the exit code."""
    from locfuse.cli.analysis.gates import EXIT_GATE_FAILED

    gates = [*found.gates, *failed_gates]
    void = [f"void: {e.name}: {line}" for e in found.entries for line in e.void]
    # also with --quiet, since they explain exit code 3
    _say_some(void, "void figures")
    _say_some([f"doubtful: {e.name}: {line}" for e in found.entries for line in e.doubtful], "doubtful figures")
    _say_some([f"lost: {line}" for line in found.lost], "losses")
    _say_some([f"gate: {line}" for line in gates], "gates")
    if ended.stopped:
        show.say(f"stopped: {ended.stopped}")
    states = {e.state for e in found.entries}
    if gates:
        return EXIT_GATE_FAILED
    if "done" not in states:
        raise LocfuseError(f"none of {len(found.entries)} logs could be compared; the reasons stand above")
    return EXIT_LOSS if void or found.lost or states != {"done"} else 0


def _say_some(lines: Sequence[str], what: str) -> None:
    for line in lines[:MAX_LINES_PRINTED]:
        show.say(line)
    if len(lines) > MAX_LINES_PRINTED:
        show.say(f"and {len(lines) - MAX_LINES_PRINTED} more {what}")
