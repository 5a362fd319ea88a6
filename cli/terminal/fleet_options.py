"""The options of `locfuse compare` for many logs."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import click

from locfuse.cli.fleet.options import FleetOptions

F = TypeVar("F", bound=Callable[..., Any])


class Folder(click.Path):
    """A folder on this machine, or one in a store: s3://bucket/day1/."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return it as a word."""
        from locfuse.formats.container.url import is_url

        return value if is_url(str(value)) else str(super().convert(value, param, ctx))


FOLDER = Folder(exists=True, file_okay=False)
OPTIONS = (
    click.option(
        "-j",
        "--jobs",
        type=click.IntRange(min=1),
        default=1,
        show_default=True,
        help="Of several logs, how many to run at once, each in a process of its own.",
    ),
    click.option(
        "--cluster",
        metavar="ADDRESS",
        help="Run the jobs on the workers of a Dask scheduler, such as tcp://127.0.0.1:8786 (docs/fleet.md).",
    ),
    click.option(
        "--each",
        type=FOLDER,
        multiple=True,
        metavar="DIR",
        help="Compare every log below this folder. Repeatable.",
    ),
    click.option("--again", is_flag=True, help="Of several logs, run also those whose results are there already."),
    click.option(
        "--max-failures",
        type=click.IntRange(min=0),
        metavar="N",
        help="Of several logs, stop when more than N have failed.  [default: go on]",
    ),
    click.option(
        "--robot-from",
        metavar="REGEX",
        help="Which robot a log is of: a pattern of its path with a group, such as 'fleet/(?P<robot>[^/]+)/'.",
    ),
    click.option(
        "--sweep",
        multiple=True,
        metavar="KEY=V1,V2",
        help="Compare under each of these values of a key, e.g. lrf.sigma_range=0.01,0.03. A log is read once. "
        "Repeatable.",
    ),
)


def fleet_options(command: F) -> F:
    """Add them; the command receives them as `fleet: FleetOptions`."""

    @functools.wraps(command)
    def wrapped(
        *args: Any,
        jobs: int,
        max_failures: int | None,
        again: bool,
        each: tuple[str, ...],
        robot_from: str | None,
        sweep: tuple[str, ...],
        cluster: str | None,
        **kwargs: Any,
    ) -> Any:
        if cluster is not None and jobs > 1:
            raise click.UsageError("--jobs is for this machine; --cluster runs a job per thread of its workers")
        fleet = FleetOptions(jobs, max_failures, again, each, robot_from, sweep, cluster)
        return command(*args, fleet=fleet, **kwargs)

    decorated: Any = wrapped
    for option in reversed(OPTIONS):
        decorated = option(decorated)
    return decorated  # type: ignore[no-any-return]
