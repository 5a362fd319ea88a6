"""Pictures of the log, as they were recorded, with the detections in them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import islice

import numpy as np
import rerun as rr

from locfuse.fusion.data import Array

from . import style
from .recorder import TimelineRecorder
from .scene import Picture

OMNI, PANORAMA = "camera/omni", "camera/panorama"
FOUND_ORDER = 10.0  # draw order of what was found, over the picture
PICTURES_AT_ONCE = 16  # in memory at a time


def draw_pictures(to: TimelineRecorder, pictures: Iterable[Picture], rows: int) -> None:
    """Draw the omni pictures, their panoramas, and a ray or a column through every detection."""
    for root in (OMNI, PANORAMA):
        for name, colour in style.GROUPS.items():
            to.static(f"{root}/found/{name}", style.lines(colour, 1.0, order=FOUND_ORDER))
    rest = iter(pictures)
    while batch := list(islice(rest, PICTURES_AT_ONCE)):
        t = np.array([picture.t for picture in batch])
        _send_encoded(to, OMNI, t, [p.omni for p in batch], [p.omni_type for p in batch])
        unwrapped = [(p.t, p.panorama) for p in batch if p.panorama is not None]
        times, panoramas = np.array([t for t, _ in unwrapped]), [data for _, data in unwrapped]
        _send_encoded(to, PANORAMA, times, panoramas, ["image/jpeg"] * len(panoramas))
        for name in style.GROUPS:
            _send_found(to, name, t, batch, rows)


def _send_encoded(to: TimelineRecorder, path: str, t: Array, data: Sequence[bytes], kinds: Sequence[str]) -> None:
    blobs = [np.frombuffer(d, np.uint8) for d in data]
    to.send(path, t, rr.EncodedImage.columns(blob=blobs, media_type=list(kinds)))


def _send_found(to: TimelineRecorder, group: str, t: Array, batch: Sequence[Picture], rows: int) -> None:
    """Draw the detections of one group; a picture without any clears the group."""
    members = [[i for i, verdict in enumerate(p.verdicts) if verdict == group] for p in batch]
    lengths = [len(found) for found in members]
    found = [(p, i) for p, some in zip(batch, members, strict=True) for i in some]
    rays = [p.rays[i] for p, i in found]
    columns = [[(p.columns[i], 0.0), (p.columns[i], float(rows))] for p, i in found]
    for root, strips in ((OMNI, rays), (PANORAMA, columns)):
        shape = np.array(strips, np.float32).reshape(-1, 2, 2)
        to.send(f"{root}/found/{group}", t, rr.LineStrips2D.columns(strips=shape), lengths=lengths)
