"""Pictures of the log, passed through as they were recorded, with what was found in them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import islice

import numpy as np

from locfuse.fusion.data import Array

from . import style
from .deferred import rr
from .recorder import Recorder
from .scene import Picture

OMNI, PANORAMA = "camera/omni", "camera/panorama"
FOUND_ORDER = 10.0  # draw order of what was found, over the picture
PICTURES_AT_ONCE = 16  # pictures in memory at a time


def draw_pictures(to: Recorder, pictures: Iterable[Picture], rows: int) -> Iterator[None]:
    """Note the omni pictures, their panoramas, and a ray or a column through everything that was found.

    Yields after every batch, which is to be written before the next one is read.
    """
    _styles(to)
    for batch in _batches(pictures):
        t = np.array([picture.t for picture in batch])
        _send_encoded(to, OMNI, t, [p.omni for p in batch], [p.omni_type for p in batch])
        unwrapped = [(p.t, p.panorama) for p in batch if p.panorama is not None]
        if unwrapped:
            times, data = zip(*unwrapped, strict=True)
            _send_encoded(to, PANORAMA, np.array(times), data, ["image/jpeg"] * len(data))
        _send_found(to, t, batch, rows)
        yield


def _batches(pictures: Iterable[Picture]) -> Iterator[list[Picture]]:
    rest = iter(pictures)
    while batch := list(islice(rest, PICTURES_AT_ONCE)):
        yield batch


def _styles(to: Recorder) -> None:
    for root in (OMNI, PANORAMA):
        for name, colour in style.GROUPS.items():
            to.static(f"{root}/found/{name}", style.lines(colour, 1.0, order=FOUND_ORDER))


def _send_encoded(to: Recorder, path: str, t: Array, data: Sequence[bytes], kinds: Sequence[str]) -> None:

    blobs = [np.frombuffer(d, np.uint8) for d in data]
    to.send(path, t, rr.EncodedImage.columns(blob=blobs, media_type=list(kinds)))


def _send_found(to: Recorder, t: Array, batch: Sequence[Picture], rows: int) -> None:
    """Send one entity per group; a picture without a member of the group empties it."""
    for name in style.GROUPS:
        members = [[i for i, verdict in enumerate(p.verdicts) if verdict == name] for p in batch]
        rays = [p.rays[i] for p, found in zip(batch, members, strict=True) for i in found]
        columns = [
            [(p.columns[i], 0.0), (p.columns[i], float(rows))]
            for p, found in zip(batch, members, strict=True)
            for i in found
        ]
        lengths = [len(found) for found in members]
        for root, strips in ((OMNI, rays), (PANORAMA, columns)):
            shape = np.array(strips, np.float32).reshape(-1, 2, 2)
            to.send(f"{root}/found/{name}", t, rr.LineStrips2D.columns(strips=shape), lengths=lengths)
