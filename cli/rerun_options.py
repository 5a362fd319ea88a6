"""Rerun from `run` and `compare`: the shared options, and the one call that records and shows.

Whatever goes wrong here costs one warning: the results are already written.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from ..formats.rerun_recording import Sketch
    from ..fusion.data import Estimates, Evaluation
    from .load import Loaded

F = TypeVar("F", bound=Callable[..., Any])
ADDRESS = re.compile(r"rerun(?:\+https?)?://(?P<host>\[[^\]/]+\]|[^/:@]+)(?::(?P<port>\d{1,5}))?/proxy")
LOCAL_VIEWER = "rerun+http://127.0.0.1:9876/proxy"
RECORDING = "recording.rrd"  # in the results' folder, unless --rerun-save names another


@dataclass(frozen=True)
class RerunOptions:
    """What to record of a run, and where to show it."""

    show: bool = False
    save: Path | None = None
    connect: str | None = None
    images: int | None = None  # every n-th; 0 none; None as many as stay light
    full: bool = False

    @property
    def wanted(self) -> bool:
        """Whether anything of Rerun was asked for; if not, it is not imported."""
        return self.show or self.save is not None or self.connect is not None


class Recorded:
    """What a recording shows of each configuration, taken as it is judged."""

    def __init__(self) -> None:
        self._estimates: dict[str, Estimates] = {}

    def take(self, e: Estimates, _evaluation: Evaluation) -> None:
        """Keep one run with its audits."""
        self._estimates[e.name] = e

    def in_order(self, estimates: Sequence[Estimates]) -> list[Estimates]:
        """Return what was taken in the order of the results."""
        return [self._estimates[e.name] for e in estimates if e.name in self._estimates]


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
                "--rerun", is_flag=True, help="Show the drive in Rerun: in a running viewer, else a new one."
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


def sketched(
    options: RerunOptions,
    loaded: Loaded,
    estimates: Sequence[Estimates],
    evaluations: Sequence[Evaluation],
    report: Mapping[str, Any],
) -> Sketch | None:
    """Return the recording of the configurations in values, None where none is wanted or none can be made."""
    if not options.wanted:
        return None
    with _at_worst_a_warning():
        return _sketch(options, loaded, estimates, evaluations, report)
    return None


def record(options: RerunOptions, sketch: Sketch | None, folder: Path) -> None:
    """Write a recording and show it as the options say; at worst warn.

    Without --rerun-save the recording lies beside the results, where `locfuse view FOLDER` finds it.
    """
    if sketch is None:
        return
    path = options.save or folder / RECORDING
    if _saved(path, sketch):
        click.echo(f"{path}: Rerun recording", err=True)
        _show(path, options)


@contextmanager
def _at_worst_a_warning() -> Iterator[None]:
    """Let nothing fail the run: a Rerun of another version, or none, or broken. The results stand."""
    from ..fusion.data import LocfuseError

    try:
        yield
    except LocfuseError as problem:
        warn(str(problem))
    except Exception as problem:
        warn(f"no recording was made: {type(problem).__name__}: {problem}")


def _sketch(
    options: RerunOptions,
    loaded: Loaded,
    estimates: Sequence[Estimates],
    evaluations: Sequence[Evaluation],
    report: Mapping[str, Any],
) -> Sketch:
    from ..formats import report_md
    from ..formats.rerun_recording import sketch
    from .rerun_scene import make_scene

    table = report_md.render(report)
    return sketch(make_scene(loaded, estimates, evaluations, table, options.images, options.full))


def _saved(path: Path, sketch: Sketch) -> bool:
    from ..formats.rerun_file import save_recording
    from .memory import give_back

    give_back()  # Rerun's import takes as much as an hour's estimates did
    with _at_worst_a_warning():
        save_recording(path, sketch)
        return True
    return False


def _show(path: Path, options: RerunOptions) -> None:
    from ..fusion.data import LocfuseError
    from .rerun_viewer import send, show

    try:
        if options.connect is not None:
            send(path, options.connect)
        if options.show:
            show(path)
    except LocfuseError as problem:
        warn(f"{problem}. The recording is whole; open it with: locfuse view {path}")


def warn(text: str) -> None:
    """Say in one line on stderr what did not work."""
    click.echo(f"warning: rerun: {' '.join(text.split())}", err=True)
