"""The one call of `run` and `compare` that records and shows.

Whatever goes wrong here costs one warning: the results are already written.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

if TYPE_CHECKING:
    from locfuse.cli.session.result import Result
    from locfuse.formats.rerun.recording import Sketch

Say = Callable[[str], None]  # prints a line on stderr
RECORDING = "recording.rrd"  # in the results' folder, unless --rerun-save names another


class RerunOptions(msgspec.Struct, frozen=True):
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


def sketched(options: RerunOptions, result: Result, say: Say) -> Sketch | None:
    """Return the recording of a result in values, None where none is wanted or none can be made."""
    return _drawn(result, options.images, options.full, say, options.save) if options.wanted else None


def _drawn(result: Result, images: int | None, full: bool, say: Say, named: Path | None = None) -> Sketch | None:
    with _at_worst_a_warning(say, named):
        from locfuse.formats.rerun.recording import sketch

        from .scene import scene_of_result

        return sketch(scene_of_result(result, images, full))
    return None


def record(options: RerunOptions, sketch: Sketch | None, folder: Path, say: Say) -> None:
    """Write a recording and show it as the options say; at worst warn.

    Without --rerun-save the recording lies beside the results, where `locfuse view FOLDER` finds it. With it, the
    file was asked for by name: LocfuseError where it cannot be written.
    """
    if sketch is None:
        return
    path = options.save or folder / RECORDING
    if _saved(path, sketch, say, options.save):
        say(f"{path}: Rerun recording")
        _show(path, options, say)


def saved(path: Path, result: Result, images: int | None, full: bool, say: Say) -> None:
    """Write the recording of a result to a file, show it nowhere; at worst say in one line why there is none.

    A catalog lists it by the file's name.
    """
    if (drawn := _drawn(result, images, full, say)) is not None:
        _saved(path, drawn._replace(identity=path.stem), say, None)


def _why(problem: Exception) -> str:
    if isinstance(problem, ModuleNotFoundError):
        return "Rerun is not installed (python -m pip install rerun-sdk)"
    return f"{type(problem).__name__}: {problem}"


@contextmanager
def _at_worst_a_warning(say: Say, named: Path | None) -> Iterator[None]:
    """Let nothing fail the run: a Rerun of another version, or none, or broken. The results stand.

    Raises LocfuseError where the recording was asked for by the name of its file.
    """
    from locfuse.fusion.data import LocfuseError

    try:
        yield
    except Exception as problem:
        ours = isinstance(problem, LocfuseError)
        words = str(problem) if ours else f"no recording was made: {_why(problem)}"
        if named is not None:
            raise LocfuseError(f"--rerun-save {named}: {words}. The other results are written") from None
        say(warning(words))


def _saved(path: Path, sketch: Sketch, say: Say, named: Path | None) -> bool:
    from locfuse.cli.analysis.memory import give_back
    from locfuse.formats.rerun.file import save_recording

    give_back()  # Rerun's import takes as much as an hour's estimates did
    with _at_worst_a_warning(say, named):
        save_recording(path, sketch)
        return True
    return False


def _show(path: Path, options: RerunOptions, say: Say) -> None:
    from locfuse.fusion.data import LocfuseError

    from .viewer import send, show

    try:
        if options.connect is not None:
            send(path, options.connect)
        if options.show:
            show(path)
    except LocfuseError as problem:
        say(warning(f"{problem}. The recording is whole; open it with: locfuse view {path}"))


def warning(text: str) -> str:
    """Return in one line what did not work."""
    return f"warning: rerun: {' '.join(text.split())}"
