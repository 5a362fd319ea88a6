"""--save-map and --map: a line map leaves one run and is given to another."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from .maps import MapOptions

F = TypeVar("F", bound=Callable[..., Any])


def map_options(command: F) -> F:
    """Add --map and --save-map; the command receives them as `maps: MapOptions`."""

    @functools.wraps(command)
    def wrapped(*args: Any, given_map: Path | None, save_map: Path | None, **kwargs: Any) -> Any:
        return command(*args, maps=MapOptions(given_map, save_map), **kwargs)

    decorated: Any = wrapped
    file = click.Path(path_type=Path, dir_okay=False)
    for option in (
        click.option("--save-map", type=file, help="Write the line map of this run, with covariances, as JSON."),
        click.option(
            "--map",
            "given_map",
            type=click.Path(path_type=Path, dir_okay=False, exists=True),
            help="Localise in this line map, which --save-map wrote; it is not changed.",
        ),
    ):
        decorated = option(decorated)
    return decorated  # type: ignore[no-any-return]
