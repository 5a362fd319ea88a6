"""Some pictures of a log with their detections, in pixels of the picture and of its panorama."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from locfuse.formats.rerun.scene import GROUP_OF, Picture
from locfuse.fusion.data import Array, Drive, Estimates, Ints, Stream

JPEG_QUALITY = 80  # JPEG, of what has to be encoded: panoramas, and raw Image messages
MEDIA = {b"\xff\xd8": "image/jpeg", b"\x89P": "image/png"}


def pictures(stream: Stream, settings: Any, drive: Drive, best: Estimates, every: int) -> Iterator[Picture]:
    """Yield every n-th picture of the camera's stream that can be read, few in memory at a time."""
    from locfuse.fusion.camera.images import decode, messages
    from locfuse.fusion.sensors.camera import detector

    m = drive.measurements["camera"]
    verdicts = _verdicts(best, len(m.z))
    finder = detector(settings)
    for block in messages(stream):
        for row, message in block:
            if row % every:
                continue
            picture = decode(message)
            if isinstance(picture, str):
                continue
            t = float((stream.t_ns[row] - drive.epoch_ns) * 1e-9 + settings.time_offset)
            i = int(np.searchsorted(m.t, t - 1e-9))
            found = np.arange(m.first[i], m.first[i + 1]) if i < len(m.t) and abs(m.t[i] - t) < 1e-6 else _NONE
            yield _picture(t, message, picture, finder.optics(picture.shape), m.z[found, 0], verdicts[found])


_NONE: Ints = np.zeros(0, np.int64)


def panorama_rows(stream: Stream, settings: Any) -> int | None:
    """Return the height of the panoramas [px], None if no picture can be read."""
    from locfuse.fusion.camera.images import decode, messages
    from locfuse.fusion.sensors.camera import detector

    for block in messages(stream):
        for _, message in block:
            picture = decode(message)
            if not isinstance(picture, str):
                return int(detector(settings).optics(picture.shape).rows)
    return None


def _verdicts(best: Estimates, rows: int) -> np.ndarray[Any, np.dtype[np.str_]]:
    """Return the group of every candidate (rows,) in this configuration; "new" if it was not compared."""
    out = np.full(rows, "new", dtype="<U8")
    audit = best.audits.get("camera")
    if audit is not None:
        out[audit.row] = np.array(GROUP_OF)[audit.verdict]
    return out


def _picture(t: float, message: Any, picture: Any, optics: Any, bearings: Array, verdicts: Any) -> Picture:
    from locfuse.fusion.camera.optics import angle_of_bearing, column
    from locfuse.fusion.camera.panorama import unwrap

    theta = angle_of_bearing(bearings, optics)
    ray = np.stack((np.sin(theta), np.cos(theta)), axis=-1)
    centre = np.array([optics.x_c, optics.y_c])
    rays = centre + np.array([optics.inner, optics.outer])[:, None] * ray[:, None]
    # panorama row 0 is the inner radius, the floor: shown at the bottom
    data, kind = _passed_through(message, picture)
    return Picture(
        t,
        data,
        kind,
        _jpeg(unwrap(picture, optics)[::-1]),
        rays,
        column(theta, optics.width),
        tuple(verdicts.tolist()),
    )


def _passed_through(message: Any, picture: Any) -> tuple[bytes, str]:
    """Return the picture's own bytes if they are a JPEG or PNG, else a JPEG of it, and the media type."""
    if len(message) == 2:
        data = bytes(message[0])
        if data[:2] in MEDIA:
            return data, MEDIA[data[:2]]
    return _jpeg(picture), "image/jpeg"


def _jpeg(picture: Any) -> bytes:
    from locfuse.fusion.camera.opencv import cv2

    done, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return data.tobytes() if done else b""
