"""The traps of cameras, each as a change of a healthy drive."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from trap_logs import PICTURES, Drive
from traps_wheels import Trap

from locfuse.sample_logs.messages import RawMessage

Picture = NDArray[np.uint8]
PADDING = 16  # bytes after each row


def decoded(m: RawMessage) -> Picture:
    picture = cv2.imdecode(np.frombuffer(bytes(m.fields["data"]), np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    return np.asarray(picture, np.uint8)


def jpeg(picture: Picture) -> bytes:
    return bytes(cv2.imencode(".jpg", picture)[1].tobytes())


def every(n: int, edit: Callable[[bytes], bytes]) -> Callable[[Drive], None]:
    """Change the data of every n-th picture."""

    def change(drive: Drive) -> None:
        bad = {id(m) for m in drive.on(PICTURES)[1::n]}

        def edited(m: RawMessage) -> RawMessage:
            return m._replace(fields={**m.fields, "data": edit(bytes(m.fields["data"]))}) if id(m) in bad else m

        drive.each(PICTURES, edited)

    return change


def smaller(data: bytes) -> bytes:
    picture = np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR), np.uint8)
    return jpeg(np.asarray(cv2.resize(picture, (120, 120)), np.uint8))


def raw(drive: Drive, encoding: str, pixels: Callable[[Picture], Picture]) -> None:
    """sensor_msgs/Image, its rows padded, instead of JPEG."""

    def edit(m: RawMessage) -> RawMessage:
        image = pixels(decoded(m))
        height, width = image.shape[:2]
        rows = np.pad(image.reshape(height, -1), ((0, 0), (0, PADDING)))
        size: dict[str, Any] = {"height": height, "width": width, "step": rows.shape[1]}
        return m._replace(
            topic="/image_raw",
            msgtype="sensor_msgs/msg/Image",
            fields={"encoding": encoding, "data": rows.tobytes(), **size},
        )

    drive.each(PICTURES, edit)
    del drive.tables["camera"]["topic"]


def padded(drive: Drive) -> None:
    raw(drive, "rgb8", lambda p: np.ascontiguousarray(p[..., ::-1]))


def confused(drive: Drive) -> None:
    """The driver says rgb8 and means bgr8: what is red comes as blue."""
    raw(drive, "rgb8", lambda p: p)


CAMERA_TRAPS = (
    Trap("pictures in rows with padding", padded, None, False, "camera"),
    Trap("rgb for bgr", confused, "in red: rgb is taken for bgr", True, "camera"),
    Trap("truncated JPEGs", every(5, lambda d: d[: len(d) // 3]), "cannot be decoded: truncated", False, "camera"),
    Trap("pictures that change size", every(6, smaller), "they change size: 240 x 240", False, "camera"),
)
