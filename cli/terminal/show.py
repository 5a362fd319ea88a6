"""What the user sees: tables on stdout, notes and progress on stderr."""

from __future__ import annotations

import os
import sys
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from locfuse.cli.rerun.record import record
from locfuse.formats.report import json_report, tables
from locfuse.formats.report.findings import banner_of, findings_of, notes_of, together
from locfuse.formats.report.table import Table
from locfuse.fusion.progress import heard_by

from . import text_table
from .screen import put, reader_may_leave, screen
from .screen import say as on_screen

if TYPE_CHECKING:
    from locfuse.cli.session.result import Result

    from .options import Options

FIGURES_NOTE = (
    " rmse, max, final: distance to the truth. ANEES: 1 is right, more is overconfident. See: locfuse explain"
)
REFERENCE_NOTES = (
    " rmse, max, final: distance to a reference, not to truth. See: locfuse explain reference",
    " *: the reference uses the same sensors. ?: the reference may be wrong.",
)
SENSORS_NOTE = " NIS: 1 is right, more: its noise is set too low. absent: readings without a measurement"
VERDICT_COLOURS = {"helps": "green", "hurts": "red"}  # of verdicts; the others need none
NO_TRUTH = "no truth in this log: the error figures do not exist; if a topic holds it: --set truth.topic=/TOPIC"
OR_REFERENCE = ", or measure against the solution of the whole drive: --reference"


class Progress(Protocol):
    """Shows the current step."""

    def __call__(self, what: str) -> None:
        """Name the current step."""


def say(line: str) -> None:
    """Print a line on stderr."""
    on_screen(line, err=True)


@contextmanager
def progress(quiet: bool) -> Iterator[Progress]:
    """Show on a terminal what is being done and how far it is; nothing where stderr is a file or with --quiet."""
    if quiet or not sys.stderr.isatty():
        yield lambda what: None
        return

    own = os.fdopen(os.dup(sys.stderr.fileno()), "w", encoding=sys.stderr.encoding, errors="backslashreplace")
    with own, screen(file=own).status("opening", spinner="dots") as status:
        step = "opening"

        def begin(what: str) -> None:
            nonlocal step
            step = what
            status.update(what)

        def done(share: float | None) -> None:
            status.update(step if share is None else f"{step}: {share:.0%}")

        with heard_by(done):
            yield begin


def width() -> int | None:
    """Return how wide the screen is; None in a pipe or a file, where nothing need be wrapped or left out."""
    console = screen()
    return console.width if console.is_terminal or "COLUMNS" in os.environ else None


def lines(text: Iterable[str], bold: Collection[str] = ()) -> None:
    """Print lines as they are, some of them bold where the screen can."""
    from rich.text import Text

    console = screen(soft_wrap=True, highlight=False)
    for line in text:
        console.print(Text(line, "bold" if line in bold else ""))


def outcome(found: Result, files: Sequence[Path], options: Options) -> list[str]:
    """Print a result and its notes, record it for Rerun where asked, and return in words what was lost.

    `files` are those that it was written to, in one folder.
    """
    quiet, lost = options.how.quiet, found.losses(options.how.strict)
    result(found.report, files, options.outputs.as_json)
    notes(found.report, lost, quiet)
    transfer(found.loaded.log.transfer, quiet)
    record(options.rerun, found, files[0].parent, say)
    return lost


def result(report: Mapping[str, Any], files: Sequence[Path], as_json: bool) -> None:
    """Print a finished report, and which files it was written to; they lie in one folder."""
    with reader_may_leave():
        if as_json:
            put(json_report.encode(report))
            return
        headline(report)
        figures(report)
        verdicts(report)
        findings(report)
        on_screen(f"{files[0].parent}: {', '.join(file.name for file in files)}")


def end(files: Sequence[Path], as_json: bool, wanted: bool) -> None:
    """Print as the last line where the report lies, and open it in the browser if that is `wanted`."""
    report = next((file for file in files if file.name.endswith(".html")), None)
    if report is not None and not as_json:
        with reader_may_leave():
            on_screen(f"report: {report}")
    if wanted:
        open_page(report)


def open_page(page: Path | None) -> None:
    """Show a page in the user's browser; print a line where there is none."""
    import webbrowser

    if page is None:
        say("--open: no page was written; add html to --write")
    elif not webbrowser.open(page.resolve().as_uri()):
        say(f"--open: no browser was found; open {page} yourself")


def figures(report: Mapping[str, Any]) -> None:
    """Print the configurations, and how many measurements of each sensor were accepted and rejected."""
    table(tables.brief(report))
    if tables.has_figures(report):
        lines(REFERENCE_NOTES if report.get("reference") else (FIGURES_NOTE,))
    table(tables.jitter(report))
    of_sensors = tables.sensors(report).without("verdicts").without("joint_nis")
    table(of_sensors)
    if of_sensors.rows:
        lines([SENSORS_NOTE])


def table(shown: Table) -> None:
    """Print a table if it has any rows."""
    if shown.rows:
        text = text_table.ruled(shown, width())
        lines(text, bold=text[1:2])


def notes(report: Mapping[str, Any], losses: Sequence[str], quiet: bool) -> None:
    """Print to stderr what a reader of the figures must know: absent sensors, findings, losses."""
    void = {v["message"] for v in report.get("validity") or () if v["void"]}
    for line in losses:  # the reasons of exit code 3: printed with --quiet too
        say(f"{'void' if line in void else 'lost'}: {line}")
    if quiet:
        return
    for sensor, why in report["absent"].items():
        say(f"absent: {sensor}: {why}")
    for note in notes_of(report):
        say(f"note: {note}")
    for stream, reasons in report["input"]["dropped"].items():
        counted = ", ".join(f"{count} {reason.replace('_', ' ')}" for reason, count in reasons.items())
        say(f"dropped: {stream}: {counted}")
    if report.get("jitter"):
        say(f"note: {report['jitter']['words']}")
    if report.get("reference"):
        say(f"note: {report['reference']['words']}")
    elif report["truth"] is None:
        say(NO_TRUTH + (OR_REFERENCE if "verdicts" in report else ""))
    if report.get("prediction"):
        say(f"note: {report['prediction']['trust']}")


def transfer(came: tuple[int, int] | None, quiet: bool) -> None:
    """Print to stderr how much of a log that is elsewhere came over the network, of how many bytes."""
    if came is not None and not quiet:
        say(f"read {came[0] / 1e6:.1f} of {came[1] / 1e6:.1f} MB over the network")


def verdicts(report: Mapping[str, Any]) -> None:
    """Print what each sensor improved, in words; sensors with equal words share a line."""
    from rich.text import Text

    console = screen()
    equal: dict[tuple[str, str], list[str]] = {}
    for sensor, found in report.get("verdicts", {}).items():
        equal.setdefault((found["verdict"], found["words"]), []).append(sensor)
    for (verdict, words), sensors in equal.items():
        colour = VERDICT_COLOURS.get(verdict, "")
        console.print(Text.assemble((f"{', '.join(sensors)} {verdict}. ", f"bold {colour}"), words))


def headline(report: Mapping[str, Any]) -> None:
    """Print the answer first, then which figures are not to be trusted."""
    from rich.text import Text

    if report.get("headline"):
        screen().print(Text(report["headline"], "bold"))
    for line in banner_of(report):
        screen(soft_wrap=True).print(Text(line, "yellow"))


def findings(report: Mapping[str, Any]) -> None:
    """Print what is wrong or can be better, with the fix that was tried."""
    from rich.text import Text

    console = screen(soft_wrap=True)
    for line in findings_of(report):
        console.print(Text(line))
    if (all_fixes := together(report)) is not None:
        console.print(Text(all_fixes, "bold"))
