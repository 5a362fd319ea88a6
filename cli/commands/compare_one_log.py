"""One log through `locfuse compare`: what was asked of it, and what became of it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import msgspec
from msgspec.structs import replace

from locfuse.cli.analysis.settings import OF_COMPARISON as KINDS
from locfuse.cli.analysis.settings import LogOptions
from locfuse.cli.fleet.options import FleetOptions
from locfuse.cli.rerun.record import RerunOptions, record
from locfuse.cli.terminal.options import chosen


class Wish(msgspec.Struct, frozen=True):
    """What the command line asks of a comparison."""

    sensors: tuple[str, ...]
    all_subsets: bool
    align: str
    smooth: bool
    figures: Path | None
    fail_if: tuple[str, ...]
    baseline: Path | None
    tolerance: str
    how: LogOptions
    out: Path | None
    overwrite: bool
    write: str | None
    as_json: bool
    export: set[str]
    rerun: RerunOptions
    fleet: FleetOptions
    estimate: tuple[str, ...] = ()
    given_map: Path | None = None
    jitter: int = 0  # runs
    reference: bool | None = None  # of several logs there is none
    advice: bool = True  # fixes are tried; of several logs never
    open: bool = False  # the page, in the browser

    def without_robot(self) -> LogOptions:
        """Return how a log is read but for --robot."""
        return replace(self.how, robot=None, over=())

    def with_sets(self, sets: Sequence[str]) -> LogOptions:
        """Return how a log is read with more words of --set, and nothing from files."""
        return replace(self.how, robot=None, over=(), sets=(*self.how.sets, *sets))


def one(log: Sequence[str], wish: Wish) -> int:
    """Compare one log, write and print it; return the exit code."""
    from locfuse.cli.analysis.gates import FAILED, Gates, refuse_another_log
    from locfuse.cli.analysis.results import LOSS, default_folder
    from locfuse.cli.session.foreign import named_sources
    from locfuse.cli.session.session import opened
    from locfuse.cli.terminal import show
    from locfuse.formats.whole_files import may_replace, may_write

    how, rerun = wish.how, wish.rerun
    kinds = chosen(wish.write, KINDS)
    sources = named_sources(wish.estimate)
    gates = Gates.read(wish.fail_if, wish.baseline, wish.tolerance)
    may_replace(rerun.save, wish.overwrite, log)
    with show.progress(how.quiet) as progress:
        session = opened(log, how, progress, read_again=rerun.wanted)
        refuse_another_log(gates.baseline, session.log)
        if wish.given_map is not None:
            session = session.with_map(wish.given_map)
        inputs = (*how.robot_files, wish.baseline, wish.given_map)
        may_write(wish.out or default_folder(session.log.name), wish.overwrite, inputs)
        result = session.compare(
            wish.sensors or None,
            all_subsets=wish.all_subsets,
            align=wish.align,
            smooth=wish.smooth,
            advice=wish.advice,
            jitter=wish.jitter,
            reference=wish.reference,
            audits=rerun.wanted,
            estimates=sources,
        )
        files = result.write(wish.out, write=kinds, export=wish.export, overwrite=wish.overwrite)
        if wish.figures is not None:
            progress("drawing figures")
            result.write_figures(wish.figures)
    report, lost = result.report, result.losses(how.strict)
    show.result(report, files, wish.as_json)
    show.notes(report, lost, how.quiet)
    show.transfer(session.log.transfer, how.quiet)
    record(rerun, result, files[0].parent, show.say)
    show.end(files, wish.as_json, wish.open)
    failed = gates.failures(report)
    for line in failed:
        show.say(f"gate: {line}")
    return FAILED if failed else LOSS if lost else 0
