"""A scene as a Rerun recording: map, sights, curves, pictures, table, and a blueprint that opens tidy."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from .blueprint import blueprint
from .deferred import made, rr
from .events import draw_events
from .images import draw_pictures
from .map_view import draw_map
from .recorder import Recorder
from .scene import Picture, Scene
from .series import draw_series
from .sights import draw_sights
from .style import draw_legend

APPLICATION = "locfuse"


class Sketch(NamedTuple):
    """A recording in values: thinned, free of the estimates it shows, and of Rerun."""

    name: str
    application: str
    layout: Any  # the blueprint, to be made
    noted: Recorder
    pictures: Iterable[Picture]  # read from the log as they are written: too big to be held
    picture_rows: int | None
    identity: str | None = None  # in a catalog; None: a new one, so that two runs never mix in a viewer


def sketch(scene: Scene, tab: str | None = None) -> Sketch:
    """Draw a scene; `tab` names the tab of curves in front."""
    to = Recorder(scene.drive)
    draw_map(to, scene)
    draw_sights(to, scene)
    draw_series(to, scene)
    draw_events(to, scene.events)
    draw_legend(to, scene)
    if scene.table:
        to.static("result", rr.TextDocument(unfolded(scene.table), media_type=rr.MediaType.MARKDOWN))
    return Sketch(scene.name, application(scene), blueprint(scene, tab), to, scene.pictures, scene.picture_rows)


def write_recording(path: Path, drawn: Sketch) -> Counter[str]:
    """Write a sketch to an .rrd and return how many rows every entity must have when it is read back.

    Raises RuntimeError where the disk is full or the file cannot be written.
    """
    import rerun

    stream = rerun.RecordingStream(drawn.application, recording_id=drawn.identity)
    stream.set_log_time_enabled(False)
    stream.set_log_tick_enabled(False)
    with _strict():
        stream.save(path)
        try:
            stream.send_blueprint(made(drawn.layout))  # active at once, in a viewer that runs already too
            stream.send_recording_name(drawn.name)
            drawn.noted.write(stream)
            if drawn.picture_rows is not None:
                for _ in draw_pictures(drawn.noted, drawn.pictures, drawn.picture_rows):
                    drawn.noted.write(stream)
            stream.flush()
        finally:
            stream.disconnect()
    return drawn.noted.rows


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
