"""`locfuse compare` with several logs: each by itself into a folder of its name, then the summary over them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from locfuse.cli.jobs import ci_gates
from locfuse.cli.pipeline.results import LOSS
from locfuse.cli.session.summary import default_folder, named, naming, summarised, summary_files
from locfuse.cli.terminal import show
from locfuse.cli.terminal.screen import put, reader_may_leave, say, screen
from locfuse.formats.report import summary as over
from locfuse.formats.whole_files import may_write, write_results
from locfuse.fusion.data import UsageError

from .one_log import Wish, one


def several(logs: Sequence[Sequence[str]], wish: Wish) -> int:
    """Compare every log, then write and print the summary; return the worst exit code."""
    _refuse_rerun(wish)
    folder = wish.out or default_folder()
    may_write(folder, wish.overwrite, (wish.how.robot, wish.baseline))
    done = {}
    for name, parts in named(logs).items():
        if not wish.how.quiet:
            show.say(f"{name}:")
        with naming(name):
            done[name] = one(parts, _of_one(wish, name, folder), table=False)
    judged = {name: found.judged for name, found in done.items()}
    summary = summarised(judged)
    files = summary_files(summary, judged, wish.write)
    write_results(folder, files, overwrite=True)
    with reader_may_leave():
        if wish.as_json:
            put(files["summary.json"])
        else:
            _show_summary(summary)
            say(f"{folder}: {', '.join(sorted(files))}; a folder with the report of each log")
    codes = [found.code for found in done.values()]
    return max(codes, key=lambda code: (code == ci_gates.FAILED, code == LOSS))


def _refuse_rerun(wish: Wish) -> None:
    rerun = wish.rerun
    asked = {"--rerun": rerun.show, "--rerun-save": rerun.save, "--rerun-connect": rerun.connect}
    for option, value in asked.items():
        if value:
            raise UsageError(f"{option}: one log at a time; several were given")


def _of_one(wish: Wish, name: str, folder: Path) -> Wish:
    """Return what is asked of one of the logs: its report.json always, in a folder of its name."""
    write = None if wish.write is None else f"{wish.write},json"
    return replace(wish, out=folder / name, write=write, figures=wish.figures and wish.figures / name)


def _show_summary(summary: Mapping[str, Any]) -> None:
    from rich.text import Text

    if over.columns_of(summary):
        show.table(over.brief(summary))
    screen().print(Text(over.headline(summary)))
    show.verdicts(summary)
