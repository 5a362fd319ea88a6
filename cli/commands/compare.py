"""`locfuse compare`: runs the filter on a log with several sets of sensors, and compares the errors.

The sensors' measurements are computed only once, for all sets. Finished results can be compared too.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource
from msgspec.structs import replace

from locfuse.cli.analysis.settings import OF_COMPARISON as KINDS, Outputs
from locfuse.cli.terminal import options as o
from locfuse.cli.terminal.screen import put, say

ALLOWED_OPTIONS = ("log", "out", "overwrite", "as_json", "quiet")  # options for finished results


@click.command(cls=o.Grouped)
@click.argument("log", nargs=-1, shell_complete=o.complete_log)
@o.carried(
    *o.CONFIGURATIONS,
    o.each(
        "--estimate estimates",
        "Another estimate as a row: a topic of poses, two frames of /tf, a .tum or .csv file, "
        "e.g. --estimate amcl=/amcl_pose. Repeatable.",
        callback=lambda context, parameter, value: _named(value),
        metavar="NAME=SOURCE",
    ),
    o.ALIGN,
    o.SMOOTH,
    o.REFERENCE,
    o.ADVICE,
    o.JITTER,
    o.FIGURES,
    *o.GATES,
    o.OPEN,
    *o.fleet(hidden=True),
    *o.FUSING,
    *o.written(KINDS),
    o.GIVEN_MAP,
    o.EXPORT,
    *o.RERUN,
)
def compare(log: tuple[str, ...], options: o.Options) -> int:
    """Report what each sensor of LOG adds: run the filter with several sets of sensors and compare the errors.

    LOG is an .mcap, the parts of a split one, a rosbag2 folder, or the name of a sample log. For several logs this
    command does what `locfuse fleet` does. Folders of results are compared with the first of them.

    \b
    locfuse compare rounded_rectangle
    locfuse compare rounded_rectangle --all-subsets
    locfuse compare bag/ --sensors odometry --sensors lrf -o out
    locfuse compare log.mcap --fail-if "all.position_rmse_m > 0.02"
    locfuse compare rounded_rectangle rounded_triangle
    locfuse compare locfuse-out/before locfuse-out/after
    """
    from locfuse.cli.analysis.grouping import expanded, logs_of, results_of

    words = expanded(log, options.fleet.each)
    if not words:
        raise click.UsageError("Missing argument 'LOG...'.", click.get_current_context())
    finished = results_of(words)
    if finished is not None:
        return changes(finished, options.outputs)
    listed = any(word.startswith("@") for word in log) or options.fleet.asked
    if not listed and (len(words) == 1 or len(logs_of(words)) == 1):
        return one(words, options)
    from .fleet import many

    return many(words, options)


def one(log: Sequence[str], options: o.Options) -> int:
    """Compare several sets of sensors on one log, write and print the result; return the exit code."""
    from locfuse.cli.analysis.errors import EXIT_LOSS
    from locfuse.cli.analysis.gates import EXIT_GATE_FAILED, Gates, refuse_another_log
    from locfuse.cli.analysis.results import default_folder
    from locfuse.cli.session.session import opened
    from locfuse.cli.terminal import show
    from locfuse.formats.whole_files import may_replace, may_write

    how, outputs = options.how, options.outputs
    gates = Gates.read(options.gates)
    may_replace(outputs.rerun_save, outputs.overwrite, log)
    with show.progress(how.quiet) as progress:
        session = opened(log, how, progress, read_again=outputs.recorded)
        refuse_another_log(gates.baseline, session.log)
        may_write(outputs.out or default_folder(session.log.name), outputs.overwrite, options.inputs)
        result = session.compared(replace(options.asked, audits=outputs.recorded))
        files = result.write(outputs.out, write=outputs.write, export=outputs.export, overwrite=outputs.overwrite)
        if outputs.figures is not None:
            progress("drawing figures")
            result.write_figures(outputs.figures)
    lost = show.outcome(result, files, options)
    failed = gates.failures(result.report)
    for line in failed:
        show.say(f"gate: {line}")
    return EXIT_GATE_FAILED if failed else EXIT_LOSS if lost else 0


def changes(files: Sequence[Path], outputs: Outputs) -> int:
    """Compare finished results with the first one, and print the differences."""
    from locfuse.cli.terminal import show
    from locfuse.formats.report import changes as sides, json_report
    from locfuse.formats.whole_files import write_results

    _refuse_log_options()
    reports = [_read(file) for file in files]
    first, *others = zip(files, reports, strict=True)
    found = {str(file.parent): sides.changes(first[1], report) for file, report in others}
    before = str(first[0].parent)
    values = {"before": before, "after": found}
    written: dict[str, str] = {}
    if outputs.out is not None:
        texts = [sides.render((before, after), c) for after, c in found.items()]
        written = {"changes.json": json_report.encode(values), "changes.md": "\n".join(texts)}
        write_results(outputs.out, written, outputs.overwrite)
    if outputs.as_json:
        put(json_report.encode(values))
        return 0
    for after, one in found.items():
        say(f"{before} -> {after}")
        show.table(sides.table(one).once())
        for line in sides.remarks(one):
            say(line)
    if written:
        say(f"{outputs.out}: {', '.join(written)}")
    return 0


def _named(words: Sequence[str]) -> dict[str, str]:
    from locfuse.cli.session.foreign import named_sources

    return named_sources(words) if words else {}


def _refuse_log_options() -> None:
    """Raise UsageError for options that finished results do not support, such as gates."""
    from locfuse.fusion.data import UsageError

    context = click.get_current_context()
    for option in context.command.params:
        given = context.get_parameter_source(str(option.name)) is ParameterSource.COMMANDLINE
        if given and option.name not in ALLOWED_OPTIONS:
            name = max(option.opts, key=len)
            raise UsageError(f"{name} is for logs; finished results are compared unchanged")


def _read(file: Path) -> dict[str, Any]:
    import json

    from locfuse.formats.inputs import MAX_REPORT, read_small
    from locfuse.formats.report import changes as sides, json_report
    from locfuse.fusion.data import LocfuseError

    try:
        report = json_report.readable(json.loads(read_small(file, MAX_REPORT)), str(file))
        sides.changes(report, report)
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        raise LocfuseError(f"{file}: not a report of locfuse; make one with: locfuse compare LOG -o DIR") from None
    return report
