"""A scene as a Rerun recording: map, curves, pictures, table, and a layout.

Rerun takes half a second and 90 MB to import, so its first import is in the functions of this file.
"""

from __future__ import annotations

import os
import re
import warnings
from pathlib import Path

from locfuse.formats.whole_files import whole_file
from locfuse.fusion.data import LocfuseError

from .scene import RerunScene

QUIET = {  # keeps Rerun's own log off the terminal, and makes it free memory at once: set before its import
    "RUST_LOG": "off",
    "MIMALLOC_PURGE_DELAY": "0",  # ms; with the pool below 20 MB less at the peak
    "ARROW_DEFAULT_MEMORY_POOL": "system",
}


def save_recording(path: Path, scene: RerunScene, tab: str | None = None, identity: str | None = None) -> None:
    """Write a recording of a scene to `path`, whole or not at all; `tab` names the tab of curves in front.

    `identity` names it in a catalog; without one it gets a new name, so that two runs never mix in a viewer.
    Raises LocfuseError where it cannot be written.
    """
    quiet_rust()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as temporary:
            _write(temporary, scene, tab, identity)
    except OSError as problem:
        raise LocfuseError(f"cannot write {path}: {problem.strerror or problem}") from None
    except RuntimeError as problem:  # of Rerun's writer thread when the disk is full
        full = "prematurely" in str(problem)
        why = "the disk is full or went away" if full else _first_line(problem)
        raise LocfuseError(f"cannot write {path}: {why}") from None


def _write(path: Path, scene: RerunScene, tab: str | None, identity: str | None) -> None:
    import rerun as rr

    from .blueprint import blueprint
    from .drawing import TimelineRecorder, draw_legend, draw_pictures
    from .map_view import draw_map
    from .series import draw_series

    rr.set_strict_mode(True)  # raise where it would warn: a recording with a hole in it is not written
    stream = rr.RecordingStream(_application(scene), recording_id=identity)
    stream.set_log_time_enabled(False)
    stream.set_log_tick_enabled(False)
    to = TimelineRecorder(stream, scene.drive)
    stream.save(path)
    try:
        stream.send_blueprint(blueprint(scene, tab))  # active at once, in a viewer that runs already too
        stream.send_recording_name(scene.name)
        draw_map(to, scene)
        draw_series(to, scene)
        draw_legend(to, scene)
        if scene.table:
            to.static("result", rr.TextDocument(unfolded(scene.table), media_type=rr.MediaType.MARKDOWN))
        if scene.picture_rows is not None:
            draw_pictures(to, scene)
        stream.flush()
    finally:
        stream.disconnect()


def _application(scene: RerunScene) -> str:
    """Return the name under which a viewer keeps the layout: shared by recordings with the same views."""
    names = [e.name for e in scene.estimates]
    what = names[0] if len(names) == 1 else f"{len(names)} configurations"
    return f"locfuse {scene.name} - {what}{'' if scene.picture_rows is None else ' with pictures'}"


def unfolded(table: str) -> str:
    """Return Markdown without the HTML for folding, which the viewer shows as text."""
    table = re.sub(r"<summary>(.*?)</summary>", r"\n\n### \1\n", table)
    return re.sub(r"</?details>", "", table)


def check(path: Path) -> None:
    """Raise LocfuseError for a file that is no recording, is cut off, or has no layout."""
    quiet_rust()
    from rerun.chunk import RrdReader

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # a file without its footer was cut short
            reader = RrdReader(path)
            whole = bool(reader.recordings()) and bool(reader.blueprints())
            for _ in reader.stream():  # a damaged chunk raises
                pass
    except Warning:
        raise LocfuseError(f"{path.name} is no whole recording: it was cut short") from None
    except (RuntimeError, ValueError, OSError) as problem:
        raise LocfuseError(f"{path.name} is no whole recording: {_first_line(problem)}") from None
    if not whole:
        raise LocfuseError(f"{path.name} was not made by locfuse: it holds no drive or no layout")


def quiet_rust() -> None:
    """Set the environment variables that keep Rerun's own log messages quiet; call it before importing Rerun."""
    for name, value in QUIET.items():
        os.environ.setdefault(name, value)


def _first_line(problem: BaseException) -> str:
    return (str(problem).strip().splitlines() or [type(problem).__name__])[0][:200]
