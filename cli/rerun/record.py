"""Recording a result and showing it: the last step of `run` and `compare`.

Whatever goes wrong here costs one warning: the results are already written.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from locfuse.cli.analysis.settings import Outputs
from locfuse.formats.visible import writable

if TYPE_CHECKING:
    from locfuse.cli.session.result import Result

Say = Callable[[str], None]  # prints a line on stderr
RECORDING = "recording.rrd"  # in the results' folder, unless --rerun-save names another
FOLDER = "recordings"  # in a fleet's results; the catalog reads no folders below it
CATALOG_PORT = 51234  # Rerun's own default for a catalog


def record(outputs: Outputs, result: Result, folder: Path, say: Say) -> None:
    """Write a result's recording and show it by the options; a failure is only a warning.

    Without --rerun-save the recording lies beside the results, where `locfuse view FOLDER` finds it. With it, the
    file was asked for by name: LocfuseError where it cannot be written.
    """
    if not outputs.recorded:
        return
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
    """Write a result's recording; return the reason in one line if it fails, else "".

    Nothing fails the run, not a Rerun of another version, none, or a broken one: the results stand.
    """
    from locfuse.fusion.data import LocfuseError

    try:
        from locfuse.formats.rerun.recording import save_recording

        from .scene import make_scene

        scene = make_scene(result.loaded, result.estimates, result.evaluations, result.report)
        save_recording(path, scene, identity=identity)
    except LocfuseError as problem:
        return str(problem)
    except ModuleNotFoundError:
        return "no recording was made: Rerun is not installed (python -m pip install rerun-sdk)"
    except Exception as problem:
        return f"no recording was made: {type(problem).__name__}: {problem}"
    return ""


def _warning(text: str) -> str:
    return f"warning: rerun: {' '.join(text.split())}"


# --- Of a fleet: one recording for every drive, side by side in one folder that Rerun's catalog serves


def file_in(folder: Path, drive: str) -> Path:
    """Return the file of a drive's recording, or of a sweep's cell "drive,lrf.sigma_range=0.03"."""
    return folder / f"{writable(drive)}.rrd"


def record_drive(folder: Path, drive: str, result: Result) -> str:
    """Write a drive's recording with its audits; return the reason in one line if it fails, else ""."""
    path = file_in(folder, drive)
    problem = saved(path, result, identity=path.stem)  # by which the catalog lists it
    return f"{drive}: {_warning(problem)}" if problem else ""


def catalog(folder: Path) -> str:
    """Return the commands that show all recordings of a folder in one viewer on this machine."""
    there = shlex.quote(str(folder))
    serve = f"rerun server --host 127.0.0.1 --port {CATALOG_PORT} --dataset drives={there}"
    return f"{serve}   and beside it: rerun rerun+http://127.0.0.1:{CATALOG_PORT}"
