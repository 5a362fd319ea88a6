"""What single sensors' raw messages say: how a laser's driver writes no return, what pictures cannot be read."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from ..fusion.data import LocfuseError
from ..fusion.doctor_scan import driver
from ..fusion.oddity import Oddity
from ..fusion.robot import Robot
from ..fusion.sensors.registry import REGISTRY
from .topics import Choice, of_type

if TYPE_CHECKING:
    from ..formats.log import Log

PICTURES = 24  # looked at
WORDS = {
    "no_colour": "are grey (mono): red needs colour",
    "unreadable": "cannot be decoded: truncated, or neither JPEG nor PNG",
    "too_large": "claim more pixels than can be held",
    "too_short": "hold less data than their size says",
    "unknown_encoding": "are of an encoding that is not read (rgb8, bgr8, rgba8, bgra8 are)",
}


def raw_oddities(log: Log, robot: Robot, choice: Choice) -> list[Oddity]:
    """Return what the raw messages of laser and camera say, whether or not the log can be measured."""
    found: list[Oddity] = []
    if "lrf" in choice.topics:
        try:
            found += driver(log.stream(choice.topics["lrf"], robot.order), robot.settings("lrf"))
        except LocfuseError as e:
            found.append(Oddity("unusable", "lrf", str(e), spoils=True))
    return found + _pictures(log, robot, choice)


def _pictures(log: Log, robot: Robot, choice: Choice) -> list[Oddity]:
    topics = choice.of("camera") or tuple(of_type(log, REGISTRY["camera"].reads))
    topics = tuple(t for t in topics if log.topics[t].count)
    if len(topics) != 1:
        return []
    stream = log.stream(topics[0], robot.order)
    from ..fusion.images import decode, messages

    seen: Counter[str] = Counter()
    sizes: Counter[tuple[int, ...]] = Counter()
    total = len(stream.t_ns)
    wanted = set(range(0, total, max(1, total // PICTURES)))
    for message in (m for block in messages(stream) for row, m in block if row in wanted):
        picture = decode(message)
        if isinstance(picture, str):
            seen[picture] += 1
        else:
            sizes[picture.shape[:2]] += 1
    n = sum(seen.values()) + sum(sizes.values())
    found = [
        Oddity("pictures", "camera", f"{k} of {n} pictures looked at {WORDS.get(why, why)}", (), k > n / 2)
        for why, k in seen.items()
    ]
    if len(sizes) > 1:
        listed = ", ".join(f"{w} x {h} ({k})" for (h, w), k in sizes.most_common())
        found.append(Oddity("pictures", "camera", f"they change size: {listed}; only the usual size is used"))
    return found
