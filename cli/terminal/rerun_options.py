"""Rerun from `run` and `compare`: the shared options, and the one call that records and shows.

Whatever goes wrong here costs one warning: the results are already written.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from locfuse.cli.rerun.address import ADDRESS, LOCAL_VIEWER
from locfuse.cli.rerun.record import RerunOptions

F = TypeVar("F", bound=Callable[..., Any])


def every(ctx: click.Context, param: click.Parameter, value: str | None) -> int | None:
    """Return N of `every=N`, 0 for `none`. Raises click.BadParameter for anything else."""
    if value is None or value == "none":
        return None if value is None else 0
    word = value.strip().removeprefix("every=")
    if not word.isdecimal() or int(word) == 0:
        raise click.BadParameter(f"{value!r} is neither every=N (N from 1) nor none")
    return int(word)


def address(ctx: click.Context, param: click.Parameter, value: str | None) -> str | None:
    """Return a viewer's address as it is. Raises click.BadParameter for what cannot be one."""
    if value is not None and ADDRESS.fullmatch(value) is None:
        raise click.BadParameter(f"{value!r} is no viewer's address; try {LOCAL_VIEWER}")
    return value


def detail_options(prefix: str) -> Callable[[F], F]:
    """Add --images and --full, with a prefix where the command has other outputs too."""
    name = prefix.replace("-", "_")

    def decorate(command: F) -> F:
        images = click.option(
            f"--{prefix}images",
            f"{name}images",
            callback=every,
            metavar="every=N|none",
            help="Which pictures go into the recording.  [default: evenly, at most 600]",
        )
        full = click.option(
            f"--{prefix}full",
            f"{name}full",
            is_flag=True,
            help="Record everything: no thinning of curves (4000 points) and scans (2000).",
        )
        return images(full(command))

    return decorate


def rerun_options(command: F) -> F:
    """Add --rerun and its relatives; the command receives them as `rerun: RerunOptions`."""
    import functools

    @functools.wraps(command)
    def wrapped(
        *args: Any,
        rerun: bool,
        rerun_save: Path | None,
        rerun_connect: str | None,
        rerun_images: int | None,
        rerun_full: bool,
        **kwargs: Any,
    ) -> Any:
        options = RerunOptions(rerun, rerun_save, rerun_connect, rerun_images, rerun_full)
        return command(*args, rerun=options, **kwargs)

    decorated: Any = wrapped
    for option in reversed(
        (
            click.option(
                "--rerun",
                is_flag=True,
                help="Show the drive in Rerun: in a running viewer, else a new one. Of several logs: record each, "
                "and print the command that shows them all.",
            ),
            click.option(
                "--rerun-save",
                type=click.Path(path_type=Path, dir_okay=False),
                metavar="FILE.rrd",
                help="Write the Rerun recording to this file.",
            ),
            click.option(
                "--rerun-connect",
                callback=address,
                metavar="URL",
                help=f"Send the recording to the viewer at this address, e.g. {LOCAL_VIEWER}.",
            ),
            detail_options("rerun-"),
        )
    ):
        decorated = option(decorated)
    return decorated  # type: ignore[no-any-return]
