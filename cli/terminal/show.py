"""Output for the user: results on stdout, notes and progress on stderr."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import sys
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from locfuse.cli.analysis.errors import EXIT_LOSS
from locfuse.cli.analysis.settings import Progress
from locfuse.formats.report import json_report, tables
from locfuse.formats.report.findings import banner_of, counts, notes_of, sentence, together, unwarned, void_reasons
from locfuse.formats.report.table import Table, terminal_lines
from locfuse.formats.text import visible
from locfuse.fusion.progress import reporting_to
from locfuse.fusion.sensors.registry import REGISTRY

from .screen import put, say as on_screen, wrapped

if TYPE_CHECKING:
    from locfuse.cli.session.result import Result

    from .options import Options

FIGURES_NOTE = (
    "rmse, max, final: distance to the truth. ANEES: 1 is right, above: overconfident. See: locfuse explain"
)
REFERENCE_NOTE = (
    "Distances are to a reference, not to truth; *: it uses the same sensors, ?: it may be wrong. "
    "See: locfuse explain reference"
)
NO_TOPIC = "no topic"  # first words of the usual reason for an absent sensor
SENTENCE_END = re.compile(r"(?<=[.?]) (?=[A-Z])")
VERDICT_COLOURS = {"helps": "green", "hurts": "red"}  # other verdicts have no colour
NO_ERRORS = "no truth in this log: the error figures do not exist; if a topic holds it: --set truth.topic=/TOPIC"
OR_REFERENCE = ", or measure against the solution of the whole drive: --reference"


def say(line: str) -> None:
    """Print a line on stderr."""
    on_screen(line, err=True)


@contextmanager
def progress(quiet: bool) -> Iterator[Progress]:
    """Show the current step and its progress on a terminal; nothing if stderr is a file or with --quiet."""
    if quiet or not sys.stderr.isatty():
        yield lambda what: None
        return

    from rich.console import Console

    own = os.fdopen(os.dup(sys.stderr.fileno()), "w", encoding=sys.stderr.encoding, errors="backslashreplace")
    with own, Console(file=own).status("opening", spinner="dots") as status:
        step = "opening"

        def begin(what: str) -> None:
            nonlocal step
            step = visible(what)
            status.update(step)

        def done(share: float | None) -> None:
            status.update(step if share is None else f"{step}: {share:.0%}")

        with reporting_to(done):
            yield begin


def width() -> int | None:
    """Return the screen's width [characters]; None for a pipe or a file, where nothing is wrapped or cut."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() or "COLUMNS" in os.environ else None


def lines(text: Iterable[str], bold: Collection[str] = ()) -> None:
    """Print lines of text; a line that is also in `bold` is bold if the screen supports it."""
    for line in text:
        on_screen(line, **({"bold": True} if line in bold else {}))


def outcome(found: Result, files: Sequence[Path], options: Options) -> list[str]:
    """Print a result, its `files` and notes, record it for Rerun if asked, and return losses in words."""
    how, outputs, lost = options.how, options.outputs, found.losses(options.how.strict)
    notes = notes_in_words(found.report)
    absent = found.report["absent"].items()
    unusable = [f"not used: {s}: {why}" for s, why in absent if not why.startswith(NO_TOPIC)]
    if outputs.as_json:
        put(json_report.encode(found.report))
    else:
        result(found.report, files[0].parent, outputs.verbose)
    void = void_reasons(found.report)
    for line in lost:  # also with --quiet, since they explain exit code 3; void figures are printed already
        if line not in void or outputs.as_json or not sys.stdout.isatty():
            say(f"{'void' if line in void else 'lost'}: {line}")
    if found.loaded.log.losses.recoverable and not how.quiet:
        words = shlex.join(("locfuse", "recover", *map(str, found.loaded.log.given), "-o", "recovered.mcap"))
        say(f"copy what can be read: {words}")
    for line in () if how.quiet else notes if outputs.verbose else unusable:
        say(line)
    transfer(found.loaded.log.transfer, how.quiet)
    if outputs.recorded:
        from locfuse.cli.rerun.record import record

        record(outputs, found, files[0].parent, say)
    unprinted = [*notes, *filter(_is_note, found.report.get("findings") or ())]
    if not outputs.as_json:
        end(files, 0 if how.quiet or outputs.verbose else len(unprinted))
    if outputs.open:
        open_page(files)
    return lost


def ended(notes: Iterable[str], lost: Sequence[str], quiet: bool) -> int:
    """Print notes and losses on stderr; return the exit code."""
    for line in (*(() if quiet else (f"note: {n}" for n in notes)), *(f"lost: {n}" for n in lost)):
        say(line)  # losses also with --quiet: they explain exit code 3
    return EXIT_LOSS if lost else 0


def end(files: Sequence[Path], notes: int = 0) -> None:
    """Print where the results are (page or folder), and the number of notes not printed."""
    page = next((file for file in files if file.suffix == ".html"), None)
    where = f"{files[0].parent}: {', '.join(file.name for file in files)}" if page is None else f"report: {page}"
    count = f" ({notes} note{'' if notes == 1 else 's'}: -v)" if notes else ""
    on_screen(f"{where}{count}")


def open_page(files: Sequence[Path]) -> None:
    """Open the page among these files in the browser, or print why that is impossible."""
    import webbrowser

    if (page := next((file for file in files if file.suffix == ".html"), None)) is None:
        say("--open: no page was written; add html to --write")
    elif not webbrowser.open(page.resolve().as_uri()):
        say(f"--open: no browser was found; open {page} yourself")


def result(report: Mapping[str, Any], folder: Path, verbose: bool) -> None:
    """Print a report: headline, void figures, table of figures, a line for each sensor, fixes."""
    headline(report)
    table(tables.brief(report, short=not verbose))
    if tables.has_figures(report) and verbose:
        lines((REFERENCE_NOTE if report.get("reference") else FIGURES_NOTE,))
    table(tables.jitter(report))
    if verbose:
        of_sensors = tables.sensors(report).without("verdicts", "joint_nis")
        table(of_sensors)
        lines([tables.SENSORS_NOTE] if of_sensors.rows else [])
    verdicts(report)
    findings(report, folder, verbose)


def table(shown: Table) -> None:
    """Print a table if it has any rows."""
    if shown.rows:
        text = terminal_lines(shown, width(), "   ")
        lines(text, bold=text[:1])


def notes_in_words(report: Mapping[str, Any]) -> list[str]:
    """Return notes on the figures: unused sensors, notes, dropped readings, the reference."""
    found = [f"not used: {sensor}: {why}" for sensor, why in report["absent"].items()]
    found += [f"note: {note}" for note in notes_of(report)]
    found += [f"dropped: {stream}: {counts(n)}" for stream, n in report["input"]["dropped"].items()]
    if report.get("jitter"):
        found.append(f"note: {report['jitter']['words']}")
    if report.get("reference"):
        found.append(f"note: {report['reference']['words']}")
    elif report["truth"] is None:
        locates = any(REGISTRY[name].locates for name in report["input"]["topics"] if name in REGISTRY)
        found.append(NO_ERRORS + (OR_REFERENCE if locates else ""))
    if report.get("prediction"):
        found.append(f"note: {report['prediction']['trust']}")
    return found


def transfer(came: tuple[int, int] | None, quiet: bool) -> None:
    """Print to stderr how many bytes of a remote log were transferred: `came` is (read, total)."""
    if came is not None and not quiet:
        say(f"read {came[0] / 1e6:.1f} of {came[1] / 1e6:.1f} MB over the network")


def verdicts(report: Mapping[str, Any]) -> None:
    """Print the verdict on each sensor; sensors with equal verdicts share a line."""
    equal: dict[tuple[str, str], list[str]] = {}
    for sensor, found in report.get("verdicts", {}).items():
        equal.setdefault((found["verdict"], found["words"]), []).append(sensor)
    printed: set[str] = set()
    for (verdict, words), sensors in equal.items():
        new = [sentence for sentence in SENTENCE_END.split(words) if sentence not in printed]
        printed.update(new)
        head = f"{', '.join(sensors)} {verdict}."
        paragraph(f"{head} {' '.join(new)}", len(head), bold=True, fg=VERDICT_COLOURS.get(verdict))


def headline(report: Mapping[str, Any]) -> None:
    """Print the headline, then the warnings on void and doubtful figures."""
    if report.get("headline"):
        paragraph(report["headline"], bold=True)
    for line in banner_of(report):
        paragraph(line, fg="yellow")


def findings(report: Mapping[str, Any], folder: Path | None = None, verbose: bool = True) -> None:
    """Print findings with the tried fix of each, and all fixes: their file in `folder`, or the fixes."""
    lines(sentence(f, brief=not verbose) for f in unwarned(report) if verbose or not _is_note(f))
    text = together(report)
    if text is not None and folder is not None:
        both = f"--robot {folder / 'robot.toml'} --robot {folder / 'fixes.toml'}"
        text = f"All fixes together, in place of your --robot and --set: {both}"
    lines([text] if text else [], bold=[text or ""])


def _is_note(finding: Mapping[str, Any]) -> bool:
    """Return whether a finding is harmless and without fix, and is printed only with -v."""
    return not finding["fixes"] and bool(finding.get("harmless"))


def paragraph(text: str, styled: int | None = None, **style: Any) -> None:
    """Print a text, wrapped between words on a screen; its first `styled` characters (None: all) in a style."""
    left = len(text) if styled is None else styled
    for line in wrapped("", text, width()):
        on_screen(line, styled=left, **style)
        left -= len(line) + 1
