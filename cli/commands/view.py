"""`locfuse view`: a log, a result or a recording in the Rerun viewer."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path

import click

from locfuse.cli.rerun.record import RECORDING
from locfuse.cli.terminal import options as o
from locfuse.cli.terminal.screen import say

TABS = ("Deviation", "Close-up", "NIS", "Innovation", "Gates", "Result", "Raw topics")


@click.command(cls=o.Grouped)
@click.argument("log", nargs=-1, required=True, metavar="LOG|OUT|FILE.rrd", shell_complete=o.complete_log)
@o.each(
    "--sensors",
    "A configuration to show. Repeatable.  [default: those of compare]",
    shell_complete=o.complete_sensors,
)
@o.option("--save", "Write the recording to this file; open no viewer.", type=o.FILE, metavar="FILE.rrd")
@o.OVERWRITE
@o.option("--connect", "Send the recording to the viewer at this address.", metavar="URL")
@o.flag("--web", "Show the recording in a browser on this machine (127.0.0.1 only).")
@o.option("--web-port", "", type=click.IntRange(1, 65535), default=9090, show_default=True)
@o.option("--tab", "The tab of plots that is shown first.", type=click.Choice(TABS, case_sensitive=False))
@o.option(
    "--images",
    "Pictures to record: every N-th, or none.  [default: evenly, at most 600]",
    callback=lambda context, parameter, value: _every(value),
    metavar="every=N|none",
)
@o.flag("--full", "Record all points: do not thin curves to 4000 points, and scans to 2000.")
@o.carried(*o.READING)
def view(
    log: tuple[str, ...],
    options: o.Options,
    save: Path | None,
    connect: str | None,
    web: bool,
    web_port: int,
    tab: str | None,
    images: int | None,
    full: bool,
) -> None:
    """Show a log with all its configurations, a folder of results, or a recording in Rerun's viewer.

    A running viewer is used. If there is none, one is started, and this command waits until you close it.

    \b
    locfuse view rounded_rectangle
    locfuse view bag/ --sensors odometry --sensors lrf --web
    locfuse view locfuse-out/bag
    locfuse view rounded_rectangle --save drive.rrd
    """
    from locfuse.cli.analysis.grouping import result_file
    from locfuse.cli.rerun import viewer
    from locfuse.cli.rerun.scene import make_scene, scene_of
    from locfuse.cli.session.session import opened
    from locfuse.cli.terminal import show
    from locfuse.formats.rerun.recording import save_recording
    from locfuse.formats.whole_files import may_replace, scratch_prefix, whole_file
    from locfuse.fusion.data import UsageError

    may_replace(save, options.outputs.overwrite, log)
    path = ready(log)
    if connect is not None and viewer.ADDRESS.fullmatch(connect) is None:
        raise UsageError(f"--connect {connect!r}: no viewer's address; try {viewer.LOCAL_VIEWER}")
    if save is None and connect is None and not web:
        viewer.require()
    with tempfile.TemporaryDirectory(prefix=scratch_prefix()) as scratch:
        with show.progress(options.how.quiet) as progress:
            if path is None:
                path, report = save or Path(scratch) / RECORDING, result_file(log[0]) if len(log) == 1 else None
                if report is not None:
                    scene = scene_of(report)
                else:
                    session = opened(log, options.how, progress, read_again=True)
                    result = session.compare(options.asked.sensors or None, reference=False)
                    progress("recording")
                    scene = make_scene(result, images, full)
                save_recording(path, scene, tab)
            elif save is not None:
                with whole_file(save) as temporary:
                    shutil.copyfile(path, temporary)
        if save is not None:
            say(f"{save}: Rerun recording")
        elif connect is not None:
            viewer.send(path, connect)
        elif web:
            viewer.serve(path, web_port, show.say)
        else:
            viewer.show_and_wait(path)


def _every(value: str | None) -> int | None:
    """Return N for "every=N", 0 for "none", None without a value. Raises click.BadParameter for other text."""
    if value is None or value == "none":
        return None if value is None else 0
    word = value.strip().removeprefix("every=")
    if not word.isdecimal() or int(word) == 0:
        raise click.BadParameter(f"{value!r} is neither every=N (N from 1) nor none")
    return int(word)


def ready(what: Sequence[str]) -> Path | None:
    """Return an existing recording: the named .rrd, or an up-to-date one of a result; None without one.

    Raises LocfuseError for an incomplete recording, UsageError for a missing one.
    """
    from locfuse.cli.analysis.grouping import result_file
    from locfuse.formats.rerun.recording import check
    from locfuse.fusion.data import UsageError

    for word in what:
        if word.endswith(".rrd") and not Path(word).is_file():
            raise UsageError(f"{word}: there is no such recording; make one with: locfuse view LOG --save {word}")
    path = Path(what[0])
    if len(what) == 1 and path.is_file() and path.suffix == ".rrd":
        check(path)
        return path
    report = result_file(what[0]) if len(what) == 1 else None
    if report is None:
        return None
    recording = report.with_name(RECORDING)
    if not recording.is_file() or recording.stat().st_mtime < report.stat().st_mtime:
        return None  # a recording older than the report may be of other settings
    check(recording)
    return recording
