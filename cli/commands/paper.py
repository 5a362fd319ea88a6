"""`locfuse paper`: the paper's table and figures, with locfuse's filter and with the equations as printed."""

from __future__ import annotations

from pathlib import Path

import click

from locfuse.cli.terminal import options as o
from locfuse.cli.terminal.screen import put


@click.command()
@o.option(
    "-o --out",
    "Folder for the table, the figures and the page.",
    type=o.DIRECTORY,
    default=Path("locfuse-out/paper"),
    show_default=True,
)
@o.OVERWRITE
@o.option(
    "-j --jobs", "Number of drives to run at once.", type=click.IntRange(min=1), default=2, show_default=True
)
@o.flag("--json as_json", "Print the figures as JSON instead of a table.")
@o.flag("--open shown", "Open the page in the browser when it is written.")
@o.flag("-q --quiet", "Print no progress.")
def paper(out: Path, overwrite: bool, jobs: int, as_json: bool, shown: bool, quiet: bool) -> None:
    """Repeat the paper's experiment: its table, figures 12, 13 and 14, in one folder and on one page.

    Each figure comes as SVG and PDF, one column wide, once with our filter and once with the equations as printed.
    Nothing is downloaded: logs and scenarios are included.

    \b
    locfuse paper -o paper
    locfuse paper -o paper --open
    """
    from locfuse.cli.session import paper as job
    from locfuse.cli.terminal import show
    from locfuse.formats.report import json_report, paper_page
    from locfuse.formats.whole_files import may_write, write_results

    may_write(out, overwrite, ())
    with show.progress(quiet) as progress:
        found = job.repeat(progress, jobs)
        progress("drawing figures")
        values = json_report.plain(found.values())
        files = job.files(found, values)
    write_results(out, files, overwrite)
    if as_json:
        put(json_report.encode(values))
    else:
        show.table(paper_page.table(values))
        show.lines([paper_page.conclusion(values)])
        drives = values["figure_14"]
        show.lines(f"fig. {d['figure']}, {d['steered']}: {d['rms']:.3f} m rms from the path" for d in drives)
        show.end([out / name for name in files])
    if shown:
        show.open_page([out / name for name in files])
