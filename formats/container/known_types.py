"""Definitions of message types for bags that carry none (rosbag2's sqlite3 storage before ROS 2 Iron)."""

from __future__ import annotations

from typing import Any

from . import known_robots as robots
from . import known_tags as tags
from . import known_vehicles as vehicles
from .known_parts import PARTS

TABLES = (robots, tags, vehicles)
ROBOTS: dict[str, str] = {name: text for table in TABLES for name, text in table.TYPES.items()}
LAID_OUT: dict[str, tuple[str, ...]] = {name: texts for table in TABLES for name, texts in table.LAID_OUT.items()}
ALIGNMENT = 4  # bytes: a message may be padded at its end
RELEASES = ("LATEST", "ROS2_HUMBLE", "ROS2_FOXY")  # definitions of a type may differ between them
MAX_SAMPLE = 1 << 16  # bytes of a message that is tried: of bigger types the definition never changed


def definition(msgtype: str, sample: bytes = b"") -> str | None:
    """Return the ros2msg text of a standard or common robot message type, None for an unknown one.

    Some types gained fields from one ROS release to the next (sensor_msgs/Range its variance). Of several
    definitions the newest is returned under which `sample`, a message of the bag, is as long as it is; of some
    packages none, if none fits.
    """
    if msgtype in ROBOTS:
        return ROBOTS[msgtype] + PARTS
    if msgtype in LAID_OUT:
        texts = [text + PARTS for text in LAID_OUT[msgtype]]
        fitting = (text for text in texts if not sample or _fits(_store(msgtype, text), msgtype, sample))
        return next(fitting, None)
    known = _definitions(msgtype)
    if len(known) < 2 or not sample or len(sample) > MAX_SAMPLE:
        return next(iter(known), None)
    return next((text for text, store in known.items() if _fits(store, msgtype, sample)), next(iter(known)))


def _store(msgtype: str, text: str) -> Any:
    """Return a type store that holds the message type of this text."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(text, msgtype))
    return store


def _definitions(msgtype: str) -> dict[str, Any]:
    """Return the different definitions of a type over the ROS releases, the newest first, with their stores."""
    from rosbags.typesys import Stores, get_typestore

    found: dict[str, Any] = {}
    for release in RELEASES:
        store = get_typestore(Stores[release])
        if msgtype in store.types:
            found.setdefault(str(store.generate_msgdef(msgtype, ros_version=2)[0]), store)
    return found


def _fits(store: Any, msgtype: str, sample: bytes) -> bool:
    """Return whether a message of this definition, read and written again, has the bytes' length."""
    try:
        message = store.deserialize_cdr(sample, msgtype)
        written = len(store.serialize_cdr(message, msgtype, little_endian=sample[1:2] == b"\x01"))
    except Exception:
        return False
    return abs(len(sample) - written) < ALIGNMENT
