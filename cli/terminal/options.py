"""Options that several commands share, declared once."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import click
from msgspec.structs import replace

from locfuse.cli.analysis import settings
from locfuse.cli.analysis.exports import KINDS as EXPORTS
from locfuse.cli.analysis.settings import LogOptions, MapOptions

from . import completion

F = TypeVar("F", bound=Callable[..., Any])


def preset_option(command: F) -> F:
    """Add --preset to a command with @log_options below it: it arrives in `how`."""

    @functools.wraps(command)
    def wrapped(*args: Any, how: LogOptions, preset: str | None, **kwargs: Any) -> Any:
        return command(*args, how=replace(how, preset=preset), **kwargs)

    option = click.option(
        "--preset",
        type=click.Choice(["default", "paper"]),
        help="The filter: our own, or the paper's equations as printed (docs/paper.md).  [default: default]",
    )
    return option(wrapped)  # type: ignore[return-value]


def window_options(command: F) -> F:
    """Add --from and --to to a command with @log_options above it: they arrive in `how`."""

    @functools.wraps(command)
    def wrapped(*args: Any, how: LogOptions, begin: float | None, end: float | None, **kwargs: Any) -> Any:
        if begin is not None and end is not None and begin >= end:
            raise click.UsageError(f"--from {begin:g} --to {end:g}: the first must be the earlier one")
        return command(*args, how=replace(how, begin=begin, end=end), **kwargs)

    decorated: Any = wrapped
    words = "s since the first wheel reading"
    for option in (
        click.option("--to", "end", type=float, metavar="S", help=f"Use only what comes before: {words}."),
        click.option("--from", "begin", type=float, metavar="S", help=f"Use only what comes after: {words}."),
    ):
        decorated = option(decorated)
    return decorated  # type: ignore[no-any-return]


def smooth_option(command: F) -> F:
    """Add --smooth."""
    words = "Also smooth: what the whole drive, its end included, says of every instant."
    return click.option("--smooth", is_flag=True, help=words)(command)


def advice_option(command: F) -> F:
    """Add --no-advice, which arrives as `advice`."""
    words = "Try no fixes: report what the settings give as they are, without fusing again."
    return click.option("--no-advice", "advice", flag_value=False, default=True, help=words)(command)


def jitter_option(command: F) -> F:
    """Add --jitter."""
    words = (
        "Also fuse N times with stamps moved by 1 µs and 1 % of the readings dropped: the range of every "
        "figure is reported, and a verdict that changes becomes: no effect seen."
    )
    return click.option("--jitter", type=int, default=0, metavar="N", help=words)(command)


def reference_option(command: F) -> F:
    """Add --reference and --no-reference, which arrive as `reference`; None where neither was given."""
    words = (
        "Without truth: measure errors against the solution of the whole drive by all sensors, and judge each "
        "sensor by one without it.  [default: with --smooth, and for drives of up to "
        f"{settings.MAX_REFERENCE_INSTANTS} update times]"
    )
    return click.option("--reference/--no-reference", default=None, help=words)(command)


class RobotFile(click.Path):
    """A robot.toml, or one for each robot of a fleet: those are looked for when the robots are known."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path."""
        return Path(value) if "{robot}" in str(value) else super().convert(value, param, ctx)


def log_options(command: F) -> F:
    """Add --robot, --set, --order, --truth, --strict, --quiet; the command receives them as `how: LogOptions`."""
    import functools

    @functools.wraps(command)
    def wrapped(
        *args: Any,
        robot: tuple[Path, ...],
        sets: tuple[str, ...],
        order: str | None,
        strict: bool,
        quiet: bool,
        truth: Path | None,
        hash_all: bool,
        **kwargs: Any,
    ) -> Any:
        if truth is not None:
            from locfuse.formats.robot.robot_toml import as_set

            sets = (*sets, as_set("truth.topic", str(truth)))
        how = LogOptions(
            robot[0] if robot else None, sets, order, strict, quiet, hash_all=hash_all, over=robot[1:]
        )
        return command(*args, how=how, **kwargs)

    decorated: Any = wrapped
    for option in reversed(
        (
            click.option(
                "--robot",
                multiple=True,
                type=RobotFile(path_type=Path, exists=True, dir_okay=False),
                help="robot.toml that describes the robot; merged over the one in the log. Repeatable: later "
                "files win, e.g. --robot robot.toml --robot fixes.toml. Of many logs (--robot-from): "
                "'robots/{robot}.toml'.",
            ),
            click.option(
                "--set",
                "sets",
                multiple=True,
                metavar="TABLE.KEY=VALUE",
                shell_complete=completion.settings,
                help="Set one key of robot.toml, e.g. --set lrf.sigma_range=0.03. Repeatable.",
            ),
            click.option(
                "--order",
                type=click.Choice(["auto", "stamp", "recorded"]),
                help="Which clock wins where stamps run backwards.  [default: auto]",
            ),
            click.option(
                "--truth",
                type=click.Path(path_type=Path, exists=True, dir_okay=False),
                metavar="FILE",
                help="Reference poses beside the log: a .tum, or a .csv with columns t, x, y (theta).",
            ),
            click.option("--strict", is_flag=True, help="Exit with 3 on any loss of data."),
            click.option(
                "--hash",
                "hash_all",
                is_flag=True,
                help="Read and hash every byte of the log for the report.  [default: only if all bytes are read]",
            ),
            click.option("-q", "--quiet", is_flag=True, help="Print no progress and no notes."),
        )
    ):
        decorated = option(decorated)
    return decorated  # type: ignore[no-any-return]


def out_options(kinds: tuple[str, ...]) -> Callable[[F], F]:
    """Add -o, --overwrite and --write with these kinds of output."""

    def decorate(command: F) -> F:
        decorated: Any = command
        for option in reversed(
            (
                click.option(
                    "-o",
                    "--out",
                    type=click.Path(path_type=Path, file_okay=False),
                    help="Folder for the results.  [default: locfuse-out/<log name>]",
                ),
                click.option(
                    "--overwrite",
                    is_flag=True,
                    help="Replace files, and write into a folder that holds something else.",
                ),
                click.option(
                    "--write",
                    metavar="KINDS",
                    help=f"Comma-separated outputs to write: {', '.join(kinds)}.  [default: all]",
                ),
                click.option(
                    "--json", "as_json", is_flag=True, help="Print the report as JSON instead of a table."
                ),
            )
        ):
            decorated = option(decorated)
        return decorated  # type: ignore[no-any-return]

    return decorate


def chosen(write: str | None, kinds: tuple[str, ...]) -> set[str]:
    """Return the kinds of output that --write names. Raises click.UsageError for an unknown one."""
    return _known(write, kinds, "--write: unknown output")


def _known(words: str | None, known: Sequence[str], what: str) -> set[str]:
    from locfuse.fusion.data import UsageError

    try:
        return settings.chosen(words, known, what)
    except UsageError as problem:
        raise click.UsageError(str(problem)) from None


def export_option(command: F) -> F:
    """Add --export; the command receives `export: set[str]`."""
    words = "; ".join(f"{kind} ({what})" if what else kind for kind, what in EXPORTS.items())
    option = click.option(
        "--export",
        callback=lambda context, parameter, value: exported(value),
        metavar="KINDS",
        help=f"Comma-separated formats of other tools to write as well: {words}.",
    )
    return option(command)


def exported(words: str | None) -> set[str]:
    """Return the kinds that --export names. Raises click.UsageError for an unknown one."""
    return _known(words or "", list(EXPORTS), "--export: unknown format")


def map_options(command: F) -> F:
    """Add --map and --save-map; the command receives them as `maps: MapOptions`."""

    @functools.wraps(command)
    def wrapped(*args: Any, given_map: Path | None, save_map: Path | None, **kwargs: Any) -> Any:
        return command(*args, maps=MapOptions(given_map, save_map), **kwargs)

    words = "Write the line map of this run as JSON, its landmarks as .csv."
    save = click.option("--save-map", type=click.Path(path_type=Path, dir_okay=False), help=words)
    return given_map_option(save(wrapped))  # type: ignore[return-value]


def given_map_option(command: F) -> F:
    """Add --map, which arrives as `given_map`."""
    return click.option(
        "--map",
        "given_map",
        type=click.Path(path_type=Path, dir_okay=False, exists=True),
        help="Localise in this map: the JSON of --save-map, or the .yaml of an image (map_server), in which the "
        "start is looked for. It is not changed.",
    )(command)
