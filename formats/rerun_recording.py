"""A scene as a Rerun recording: map, sights, curves, pictures, table, and a blueprint that opens tidy."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from .rerun_blueprint import blueprint
from .rerun_images import draw_pictures
from .rerun_map import draw_map
from .rerun_recorder import Recorder
from .rerun_scene import Scene
from .rerun_series import draw_series
from .rerun_sights import draw_sights

if TYPE_CHECKING:
    import rerun as rr

APPLICATION = "locfuse"


def write_recording(path: Path, scene: Scene, tab: str | None = None) -> Counter[str]:
    """Write the scene to an .rrd and return how many rows every entity must have when it is read back.

    Raises RuntimeError where the disk is full or the file cannot be written.
    """
    import rerun as rr

    stream = rr.RecordingStream(application(scene))
    stream.set_log_time_enabled(False)
    stream.set_log_tick_enabled(False)
    with _strict():
        stream.save(path)
        try:
            stream.send_blueprint(blueprint(scene, tab))  # active at once, in a viewer that runs already too
            rows = draw(stream, scene)
            stream.flush()
        finally:
            stream.disconnect()
    return rows


def draw(stream: rr.RecordingStream, scene: Scene) -> Counter[str]:
    """Send the scene to an open stream and return the rows sent to every entity."""
    import rerun as rr

    stream.send_recording_name(scene.name)
    to = Recorder(stream, scene.drive)
    draw_map(to, scene)
    draw_sights(to, scene)
    draw_series(to, scene)
    if scene.table:
        to.static("result", rr.TextDocument(unfolded(scene.table), media_type=rr.MediaType.MARKDOWN))
    draw_pictures(to, scene)
    return to.rows


def application(scene: Scene) -> str:
    """Return the name under which a viewer keeps the layout: recordings that show the same things share it."""
    names = [e.name for e in scene.estimates]
    what = names[0] if len(names) == 1 else f"{len(names)} configurations"
    pictures = "" if scene.picture_rows is None else " with pictures"
    return f"{APPLICATION} {scene.name} - {what}{pictures}"


def unfolded(table: str) -> str:
    """Return Markdown without the HTML that folds parts of it away: the viewer shows tags as text."""
    table = re.sub(r"<summary>(.*?)</summary>", r"\n\n### \1\n", table)
    return re.sub(r"</?details>", "", table)


@contextmanager
def _strict() -> Iterator[None]:
    """Let Rerun raise where it would warn: a recording with a hole in it is not written."""
    from rerun.error_utils import set_strict_mode, strict_mode

    before = strict_mode()
    set_strict_mode(True)
    try:
        yield
    finally:
        set_strict_mode(before)
