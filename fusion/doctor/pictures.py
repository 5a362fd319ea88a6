"""Can a camera's pictures be used, and is something red in them? A few are looked at: decoding all takes long."""

from __future__ import annotations

from collections import Counter

import numpy as np

from locfuse.fusion.camera.images import Picture, decode, messages
from locfuse.fusion.data import Stream
from locfuse.fusion.sensors.camera import CameraSettings, detector

from .finding import Finding

SAMPLE_PICTURES = 24  # looked at
MAX_BAD_SHARE = 0.5  # share of the pictures
PROBLEMS = {
    "no_colour": "are grey (mono): red needs colour",
    "unreadable": "cannot be decoded: truncated, or neither JPEG nor PNG",
    "not_whole": "are damaged inside",
    "too_large": "claim more pixels than can be held",
    "too_short": "hold less data than their size says",
    "unknown_encoding": "are of an encoding that is not read (rgb8, bgr8, rgba8, bgra8 are)",
}


def of_pictures(stream: Stream, settings: CameraSettings) -> list[Finding]:
    """Return what is odd about some pictures of a stream, evenly spread."""
    wanted = set(range(0, len(stream.t_ns), max(1, len(stream.t_ns) // SAMPLE_PICTURES)))
    decoded = [decode(message) for block in messages(stream) for row, message in block if row in wanted]
    found, total = [], len(decoded)
    for why, n in Counter(one for one in decoded if isinstance(one, str)).items():
        words = f"{n} of {total} pictures looked at {PROBLEMS[why]}"
        found.append(Finding("camera", "pictures", words, (), n > MAX_BAD_SHARE * total))
    pictures = [one for one in decoded if not isinstance(one, str)]
    sizes = Counter((p.shape[1], p.shape[0]) for p in pictures)
    if len(sizes) > 1:
        listed = ", ".join(f"{w} x {h} ({n})" for (w, h), n in sizes.most_common())
        found.append(Finding("camera", "pictures", f"they change size: {listed}; only the usual size is used"))
    usual = max(sizes, key=lambda size: (sizes[size], size), default=None)
    return found + _red([p for p in pictures if (p.shape[1], p.shape[0]) == usual], settings)


def _red(pictures: list[Picture], settings: CameraSettings) -> list[Finding]:
    """Say so where hardly any picture shows something red and upright, unless its colours are exchanged."""
    if settings.landmark is None or not pictures:
        return []
    find, n = detector(settings), len(pictures)
    shows = sum(bool(find.find(p).candidates) for p in pictures)
    if shows > (1.0 - MAX_BAD_SHARE) * n:
        return []
    exchanged = sum(bool(find.find(np.ascontiguousarray(p[..., ::-1])).candidates) for p in pictures)
    if exchanged > max(shows, MAX_BAD_SHARE * n):
        words = f"{exchanged} of {n} pictures show something upright in blue, {shows} in red: rgb is taken for bgr"
        fix = f"camera.swapped={str(not settings.swapped).lower()}"
        return [Finding("camera", "swapped", words, (fix,), True)]
    words = (
        f"nothing red and upright in {n - shows} of {n} pictures: --preview shows what counts as red, and where"
    )
    return [Finding("camera", "blind", words, (), shows == 0)]
