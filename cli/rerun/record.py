"""Rerun recordings of results: the last step of `run`, `compare` and `fleet`.

An error here is only a warning, since the results are already written.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from locfuse.cli.analysis.settings import Outputs
from locfuse.formats.text import writable

if TYPE_CHECKING:
    from locfuse.cli.session.result import Result

Say = Callable[[str], None]  # prints a line on stderr
RECORDING = "recording.rrd"  # in the results' folder, unless --rerun-save names another
FOLDER = "recordings"  # in a fleet's results; the catalog reads no subfolders
CATALOG_PORT = 51234  # Rerun's own default for a catalog


def record(outputs: Outputs, result: Result, folder: Path, say: Say) -> None:
    """Write a result's recording, and show it if the options require it; a failure is a warning.

    The recording is in the folder of results, where `locfuse view FOLDER` finds it, or in the file that
    --rerun-save names. Raises LocfuseError if this file cannot be written.
    """
    from locfuse.fusion.data import LocfuseError

    from .viewer import show

    path = outputs.rerun_save or folder / RECORDING
    problem = saved(path, result)
    if problem and outputs.rerun_save is not None:
        raise LocfuseError(f"--rerun-save {path}: {problem}. The other results are written")
    if problem:
        say(_warning(problem))
        return
    say(f"{path}: Rerun recording")
    try:
        if outputs.rerun:
            show(path)
    except LocfuseError as unseen:
        say(_warning(f"{unseen}. The recording is whole; open it with: locfuse view {path}"))


def saved(path: Path, result: Result, identity: str | None = None) -> str:
    """Write the recording of a result; return "", or in one line why this failed, such as a missing Rerun."""
    from locfuse.fusion.data import LocfuseError

    try:
        from locfuse.formats.rerun.recording import save_recording

        from .scene import make_scene

        save_recording(path, make_scene(result), identity=identity)
    except LocfuseError as problem:
        return str(problem)
    except ModuleNotFoundError:
        return "no recording was made: Rerun is not installed (python -m pip install rerun-sdk)"
    except Exception as problem:
        return f"no recording was made: {type(problem).__name__}: {problem}"
    return ""


def _warning(text: str) -> str:
    return f"warning: rerun: {' '.join(text.split())}"


# --- Recordings of a fleet: one file per drive in one folder, which Rerun's catalog serves


def file_in(folder: Path, drive: str) -> Path:
    """Return the recording's file of a drive, or of a sweep's cell "drive,lrf.sigma_range=0.03"."""
    return folder / f"{writable(drive)}.rrd"


def record_drive(folder: Path, drive: str, result: Result) -> str:
    """Write a drive's recording for the catalog; return "" or a warning in one line."""
    path = file_in(folder, drive)
    problem = saved(path, result, identity=path.stem)  # the recording's name in the catalog
    return f"{drive}: {_warning(problem)}" if problem else ""


def catalog(folder: Path) -> str:
    """Return the commands that show all recordings of a folder in one viewer."""
    there = shlex.quote(str(folder))
    serve = f"rerun server --host 127.0.0.1 --port {CATALOG_PORT} --dataset drives={there}"
    return f"{serve}   and beside it: rerun rerun+http://127.0.0.1:{CATALOG_PORT}"
