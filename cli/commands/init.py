"""`locfuse init`: a commented robot.toml for a log, to be corrected and gone on with."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING

import click

from locfuse.cli.pipeline.settings import LogOptions
from locfuse.cli.terminal.options import log_options
from locfuse.cli.terminal.screen import put, reader_may_leave

if TYPE_CHECKING:
    from locfuse.cli.inspect.template import Draft

LOSS = 3


@click.command()
@click.argument("log", nargs=-1, required=True)
@log_options
def init(log: tuple[str, ...], how: LogOptions) -> int:
    """Print a robot.toml for LOG: a starting point with a comment on every line.

    What the log shows is set: topics, joints, mounts by /tf_static, wheels by /robot_description, clock lags.
    Guesses are marked as guesses. Lines starting with # are inactive: they say what to measure.

    \b
    locfuse init bag/ > robot.toml
    locfuse init bag/ --set wheels.radius=0.033 --set wheels.track=0.16 > robot.toml
    locfuse compare bag/ --robot robot.toml
    """
    from locfuse.cli.inspect.template import draft
    from locfuse.cli.pipeline.load import find_log
    from locfuse.cli.terminal import show
    from locfuse.formats.robot.commented_toml import printable, render

    with show.progress(how.quiet) as progress:
        made = draft(find_log(log), how, progress)
    words = printable(shlex.join(log))
    with reader_may_leave():
        put(render(_head(made, words), made.sections, _foot(made)))
    lost = made.overview.log.losses.lines()
    if not how.quiet:
        _say(made, words, lost)
    return LOSS if lost else 0


def _head(made: Draft, words: str) -> str:
    name = made.overview.log.name
    return (
        f"robot.toml of {name}, a starting point by locfuse init. Lines starting with # are inactive.\n"
        f"\n"
        f"  locfuse info {words} --check --robot robot.toml\n"
        f"  locfuse tune {words} --robot robot.toml -o tuned.toml\n"
        f"  locfuse compare {words} --robot robot.toml --robot tuned.toml"
    )


def _foot(made: Draft) -> str:
    """Return which sensors the log lacks, and why where that is not plain."""
    written = {section.name for section in made.sections if section.lines}
    absent = {name: why for name, why in made.overview.choice.absent.items() if name not in written - {"wheels"}}
    plain = [name for name in absent if name in made.overview.choice.foreign]
    odd = [f"{name}: {why}" for name, why in absent.items() if name not in plain]
    return "\n".join(([f"Not in this log: {', '.join(plain)}."] if plain else []) + odd)


def _say(made: Draft, words: str, lost: list[str]) -> None:
    from locfuse.cli.terminal import show

    for line in lost:
        show.say(f"lost: {line}")
    for guess in made.guesses:
        show.say(f"guessed: {guess}")
    if (nothing := made.overview.choice.absent.get("wheels")) is not None:
        show.say(f"this log cannot run: {nothing}")
    elif made.missing:
        show.say(f"to be filled in: {', '.join(made.missing)} (their lines say how to measure them)")
    else:
        show.say(f"next: locfuse tune {words} --robot robot.toml -o tuned.toml")
