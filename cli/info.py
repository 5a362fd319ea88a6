"""`locfuse info`: what is in a log, what reads what and why, what is missing, and every oddity with its cure."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from .options import LogOptions, log_options

if TYPE_CHECKING:
    from .look import Look

ODD = 3


@click.command()
@click.argument("log", nargs=-1, required=True)
@click.option("--check", is_flag=True, help="Exit with 3 if something was found that would spoil an estimate.")
@click.option("--json", "as_json", is_flag=True, help="Print everything as JSON.")
@click.option(
    "--preview",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="DIR",
    help="Write a few of the camera's pictures there, with what counts as red and what was found.",
)
@log_options
def info(log: tuple[str, ...], check: bool, as_json: bool, preview: Path | None, how: LogOptions) -> int:
    """Say what is in LOG, which sensor reads which topic and why, what is missing, and what is odd.

    Every oddity that a setting cures is printed with that setting.

    \b
    locfuse info bag/
    locfuse info bag/ --check --set wheels.radius=0.033 --set wheels.track=0.16
    locfuse info bag/ --preview pictures --set camera.outer=230
    """
    from ..formats import report_json
    from . import info_json, info_text, show
    from .load import find_log
    from .look import look

    with show.progress(how.quiet) as progress:
        seen = look(find_log(log), how, progress)
        pictures = _preview(seen, preview) if preview is not None else []
    if as_json:
        click.echo(report_json.encode(info_json.values(seen)), nl=False)
    else:
        show.lines((*info_text.lines(seen, _typed(log, how), show.width()), *pictures), info_text.TITLES)
    lost = any(o.code == "lost" for o in seen.oddities)
    return ODD if lost or (check and seen.spoils) else 0


def _typed(log: tuple[str, ...], how: LogOptions) -> list[str]:
    """Return LOG and the options that describe it, as they were typed."""
    robot = ["--robot", str(how.robot)] if how.robot is not None else []
    return [*log, *robot, *(word for setting in how.sets for word in ("--set", setting))]


def _preview(seen: Look, folder: Path) -> list[str]:
    """Write preview pictures; return one line for each message."""
    from ..formats.preview import write_pictures
    from ..fusion.data import LocfuseError
    from ..fusion.preview import preview as pictures_of
    from ..fusion.sensors.registry import REGISTRY

    topic = seen.choice.topics.get("camera")
    if topic is None:
        fit = [t for t, info in sorted(seen.log.topics.items()) if info.msgtype in REGISTRY["camera"].reads]
        named = seen.robot.settings("camera").topic
        topic = named if named in fit else fit[0] if len(fit) == 1 else None
        if topic is None:
            what = f"choose one with --set camera.topic={fit[0]}" if fit else "there is none"
            raise LocfuseError(f"--preview: which pictures of {seen.log.name}? {len(fit)} topics fit; {what}")
    shown = pictures_of(seen.log.stream(topic, seen.robot.order), seen.robot.settings("camera"))
    lines = []
    for one in shown:
        files = write_pictures(folder, one.named())
        bearings = ", ".join(f"{b:.1f}" for b in one.bearings_deg) or "nothing red"
        lines.append(f"{topic} message {one.row}: bearings [deg] {bearings} -> {files[0].parent}")
    return lines
