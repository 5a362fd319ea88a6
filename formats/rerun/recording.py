"""Saving a scene as a Rerun recording: map, curves, pictures, table and layout.

The import of Rerun takes half a second and 90 MB, so it is only inside functions of this file.
"""

from __future__ import annotations

import os
import re
import warnings
from pathlib import Path

from locfuse.formats.whole_files import whole_file
from locfuse.fusion.data import LocfuseError

from .scene import RerunScene

QUIET = {  # environment variables set before the import of Rerun: no log messages, and memory is freed at once
    "RUST_LOG": "off",
    "MIMALLOC_PURGE_DELAY": "0",  # ms; this and the next variable save 20 MB of peak memory
    "ARROW_DEFAULT_MEMORY_POOL": "system",
}


def save_recording(path: Path, scene: RerunScene, tab: str | None = None, identity: str | None = None) -> None:
    """Write a recording of a scene to `path` atomically; the tab with the name `tab` is active.

    `identity` is the recording id; None: a new one, so that a viewer shows each recording separately. Raises
    LocfuseError if the file cannot be written.
    """
    quiet_rust()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as temporary:
            _write(temporary, scene, tab, identity)
    except OSError as problem:
        raise LocfuseError(f"cannot write {path}: {problem.strerror or problem}") from None
    except RuntimeError as problem:  # from Rerun's writer thread, e.g. if the disk is full
        full = "prematurely" in str(problem)
        why = "the disk is full or went away" if full else _first_line(problem)
        raise LocfuseError(f"cannot write {path}: {why}") from None


def _write(path: Path, scene: RerunScene, tab: str | None, identity: str | None) -> None:
    import rerun as rr

    from .blueprint import blueprint
    from .drawing import TimelineRecorder, draw_legend, draw_pictures, draw_series
    from .map_view import draw_map

    rr.set_strict_mode(True)  # raise instead of warn, so that no incomplete recording is written
    # a viewer stores its layout under the application id: recordings with equal views have equal ids
    names = [e.name for e in scene.estimates]
    what = names[0] if len(names) == 1 else f"{len(names)} configurations"
    pictures = "" if scene.picture_rows is None else " with pictures"
    stream = rr.RecordingStream(f"locfuse {scene.name} - {what}{pictures}", recording_id=identity)
    stream.set_log_time_enabled(False)
    stream.set_log_tick_enabled(False)
    to = TimelineRecorder(stream, scene.drive)
    stream.save(path)
    try:
        stream.send_blueprint(blueprint(scene, tab))  # activates the layout in a running viewer too
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


def unfolded(table: str) -> str:
    """Return Markdown in which <details> and <summary> are replaced, since the viewer does not interpret them."""
    table = re.sub(r"<summary>(.*?)</summary>", r"\n\n### \1\n", table)
    return re.sub(r"</?details>", "", table)


def check(path: Path) -> None:
    """Raise LocfuseError unless the file is a complete recording with a layout."""
    quiet_rust()
    from rerun.chunk import RrdReader

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # a missing footer is only a warning
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
    """Set the environment variables of QUIET that are not yet set: no log messages of Rerun, less memory.

    Must be called before Rerun is imported.
    """
    for name, value in QUIET.items():
        os.environ.setdefault(name, value)


def _first_line(problem: BaseException) -> str:
    return (str(problem).strip().splitlines() or [type(problem).__name__])[0][:200]
