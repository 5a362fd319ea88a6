"""Preview pictures for the setup of a camera: raw picture, red mask, panorama, detected landmarks."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from locfuse.fusion.camera.detect import Detection, Detector
from locfuse.fusion.camera.images import decode, messages
from locfuse.fusion.camera.opencv import cv2
from locfuse.fusion.camera.optics import Optics, angle_of_bearing, bearing, omni_1
from locfuse.fusion.camera.panorama import Picture, red_grey, unwrap
from locfuse.fusion.data import LocfuseError, Stream
from locfuse.fusion.sensors.camera import CameraSettings, detector

RING_COLOUR, GRID_COLOUR, CANDIDATE_COLOUR = (255, 200, 0), (0, 200, 255), (80, 255, 80)  # blue, green, red


class PreviewPictures(NamedTuple):
    """Preview of one camera picture after each step of the landmark detection."""

    row: int  # of the stream
    raw: Picture  # (h, w, 3) BGR
    mask: Picture  # (h, w) 255 where red counts
    panorama: Picture  # (rows, W, 3) column 0 at the left
    detection: Picture  # (h, w, 3) calibration and candidates drawn over the raw picture
    bearings_deg: tuple[float, ...]  # of the candidates, camera frame, the largest first

    def named(self) -> dict[str, bytes]:
        """Return the pictures as PNG by file name, such as "000012-mask.png"."""
        pictures = {key: getattr(self, key) for key in ("raw", "mask", "panorama", "detection")}
        encoded = {key: cv2.imencode(".png", picture)[1].tobytes() for key, picture in pictures.items()}
        return {f"{self.row:06d}-{key}.png": png for key, png in encoded.items()}


def preview(stream: Stream, settings: CameraSettings, count: int = 4) -> list[PreviewPictures]:
    """Return previews of `count` pictures, evenly spread over a stream.

    Raises LocfuseError if none of them can be decoded.
    """
    total, find = len(stream.t_ns), detector(settings)
    wanted = set(np.unique(np.linspace(0, max(0, total - 1), max(1, min(count, total))).astype(int)).tolist())
    shown: list[PreviewPictures] = []
    reasons: list[str] = []
    for row, message in ((r, m) for block in messages(stream) for r, m in block if r in wanted):
        picture = decode(message)
        if isinstance(picture, str):
            reasons.append(picture)
        else:
            shown.append(_pictures(row, picture, find))
        if len(shown) + len(reasons) == len(wanted):
            break
    if not shown:
        why = ", ".join(sorted(set(reasons))) or "no messages"
        raise LocfuseError(f"{stream.topic}: none of {len(reasons)} pictures looked at can be shown ({why})")
    return shown


def _pictures(row: int, delivered: Picture, find: Detector) -> PreviewPictures:
    detection, picture = find.find(delivered), find.coloured(delivered)
    optics = detection.optics
    y, x = np.mgrid[: picture.shape[0], : picture.shape[1]]
    r = np.hypot(x - optics.x_c, y - optics.y_c)
    grey = np.where((r >= optics.inner) & (r <= optics.outer), red_grey(picture, find.red), np.uint8(0))
    bearings = [math.degrees(float(bearing(np.asarray(c.theta), optics))) for c in detection.candidates]
    return PreviewPictures(
        row=row,
        raw=picture,
        mask=np.where(grey > 0, np.uint8(255), np.uint8(0)),
        panorama=unwrap(picture, optics, printed=find.chain == "printed"),
        detection=_drawn(picture, detection, bearings),
        bearings_deg=tuple(bearings),
    )


def _drawn(picture: Picture, detection: Detection, bearings: list[float]) -> Picture:
    """Return the picture with the mirror's circles, bearings every 30 degrees, and the candidates drawn in."""
    canvas, optics = picture.copy(), detection.optics
    centre = (round(optics.x_c), round(optics.y_c))
    for radius in (optics.inner, optics.outer):
        cv2.circle(canvas, centre, round(radius), RING_COLOUR, _pen(canvas), cv2.LINE_AA)
    cv2.drawMarker(canvas, centre, RING_COLOUR, cv2.MARKER_CROSS, 12 * _pen(canvas), _pen(canvas))
    for degrees in range(-150, 181, 30):
        theta = float(angle_of_bearing(np.asarray(math.radians(degrees)), optics))
        word = "0 forward" if degrees == 0 else str(degrees)
        _ray(canvas, optics, theta, (0.92 * optics.outer, optics.outer), GRID_COLOUR, word)
    for candidate, found in zip(detection.candidates, bearings, strict=True):
        reach = candidate.radius - candidate.length / 2, candidate.radius + candidate.length / 2
        _ray(canvas, optics, candidate.theta, reach, CANDIDATE_COLOUR, f"{found:.2f}")
    return canvas


def _ray(
    canvas: Picture, optics: Optics, theta: float, reach: tuple[float, float], colour: tuple[int, ...], word: str
) -> None:
    """Draw a section of a radius with a label at its inner end."""
    pen, scale = _pen(canvas), max(0.35, canvas.shape[0] / 1400)
    (width, height), _ = cv2.getTextSize(word, cv2.FONT_HERSHEY_SIMPLEX, scale, pen)
    halfway = (abs(math.sin(theta)) * width + abs(math.cos(theta)) * height) / 2.0 + 3.0 * pen
    x_p = np.full(3, theta) * optics.width / (2.0 * math.pi)
    x, y = omni_1(x_p, np.array((*reach, reach[0] - halfway)) - optics.inner, optics)
    (x1, x2, x3), (y1, y2, y3) = np.rint(x).astype(int).tolist(), np.rint(y).astype(int).tolist()
    cv2.line(canvas, (x1, y1), (x2, y2), colour, pen, cv2.LINE_AA)
    corner = x3 - width // 2, y3 + height // 2
    cv2.putText(canvas, word, corner, cv2.FONT_HERSHEY_SIMPLEX, scale, colour, pen, cv2.LINE_AA)


def _pen(canvas: Picture) -> int:
    """Return a line width [px] in proportion to the size of a picture."""
    height, width = canvas.shape[:2]
    return max(1, min(int(height), int(width)) // 500)
